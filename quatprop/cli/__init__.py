"""The command line.

Exit codes: 0 done; 1 a comparison or check failed; 2 wrong usage or unreadable input; 3 done, but
with data lost; 130 interrupted. This module imports almost nothing, so that Ctrl-C is handled from
the start.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from importlib import import_module
from typing import NoReturn

ERROR_EXIT = 2
"""Exit code for wrong usage, unreadable input and outputs that cannot be written."""

COMPLETE = "_QUATPROP_COMPLETE"
"""Environment variable set by shells for completion."""

NEW_OBJECTS = 100_000
"""Threshold of the garbage collector: imports create many objects, none of which is garbage."""


def main() -> NoReturn:
    """Run the command line and end the process with its exit code.

    The cleanup of the interpreter, a tenth of a short run, is skipped: when a command ends, files
    are closed and threads have ended. Profilers, which report at exit, call :func:`run`.
    """
    code: object = 0
    try:
        run()
    except SystemExit as end:
        code = end.code
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except OSError:
        code = code or ERROR_EXIT
    os._exit(code if isinstance(code, int) else bool(code))


def run() -> None:
    """Run the command line; raises SystemExit with the exit code."""
    gc.set_threshold(NEW_OBJECTS)
    # Matrices are 3 x 3 here, and the idle threads of OpenBLAS are busy waiting.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from quatprop.cli.interruption import handle_signals

    handle_signals()
    from quatprop.base.own_process import keep_freed_memory
    from quatprop.cli.commands import cli

    keep_freed_memory()

    if COMPLETE in os.environ:
        import_module("quatprop.cli.completion")  # in place of click's
    try:
        cli(prog_name="quatprop")
    except OSError as error:
        # Of --help and --version, or of stderr itself; all others are reported by the group.
        with suppress(OSError):
            sys.stderr.write(f"Error: standard output cannot be written: {error.strerror}\n")
        sys.exit(ERROR_EXIT)
