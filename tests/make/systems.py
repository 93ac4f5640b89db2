"""Features of some systems only: tests that need them are skipped elsewhere."""

import os
import signal
import sys

import pytest

IS_POSIX = sys.platform != "win32" and hasattr(signal, "setitimer") and hasattr(os, "mkfifo")

on_posix = pytest.mark.skipif(not IS_POSIX, reason="signals, pipes and locks of POSIX")

SIGKILL = getattr(signal, "SIGKILL", signal.SIGTERM)
SIGHUP = getattr(signal, "SIGHUP", signal.SIGTERM)
