"""The command line: options in, exit code out.

Exit codes: 0 done; 1 a comparison or check failed; 2 wrong usage or unreadable input; 3 done, but
with data lost; 130 interrupted. This module imports next to nothing, so that Ctrl-C is handled from
the start.
"""

from __future__ import annotations

import gc
import os
import sys
from importlib import import_module
from typing import NoReturn

FAILED = 2
"""Exit code of wrong usage, unreadable input and outputs that cannot be written."""

COMPLETE = "_QUATPROP_COMPLETE"
"""Environment variable: set by shells that ask what a word could be."""

NEW_OBJECTS = 100_000
"""After so many new objects garbage is looked for: modules make many, and none of it is garbage."""


def main() -> NoReturn:
    """Run the command line and end the process with its exit code.

    Without the interpreter's tidying up, which takes a tenth of a short run: files are closed and
    threads have ended when a command has. Profilers, which report then, call :func:`run`.
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
        code = code or FAILED
    os._exit(code if isinstance(code, int) else bool(code))


def run() -> None:
    """Run the command line; it exits with its code."""
    gc.set_threshold(NEW_OBJECTS)
    # Matrices are 3 x 3 here, and the threads that NumPy starts for larger ones wait in a loop.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from quatprop.cli.interruption import handle_signals

    handle_signals()
    from quatprop.cli.commands import cli
    from quatprop.concurrency import keep_freed_memory

    keep_freed_memory()

    if COMPLETE in os.environ:
        import_module("quatprop.cli.bash_completion")  # in place of click's
    try:
        cli(prog_name="quatprop")
    except OSError:
        # Not even stderr can be written to; every other error has become a sentence before.
        sys.exit(FAILED)
