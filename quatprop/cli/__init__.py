"""The command line: options in, exit code out.

Exit codes: 0 done; 1 a comparison or check failed; 2 wrong usage or unreadable input; 3 done, but
with data lost; 130 interrupted. This module imports next to nothing, so that Ctrl-C is handled from
the start.
"""

from __future__ import annotations

import gc
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import click

    cli: click.Group

NEW_OBJECTS = 10_000
"""After so many new objects garbage is looked for: modules make many, and none of it is garbage."""


def main() -> None:
    """Run the command line and exit with its code."""
    from quatprop.cli.interruption import handle_signals

    handle_signals()
    gc.set_threshold(NEW_OBJECTS)
    from quatprop.cli.commands import FAILED, cli

    try:
        cli(prog_name="quatprop")
    except OSError:
        # Not even stderr can be written to; every other error has become a sentence before.
        sys.exit(FAILED)


def __getattr__(name: str) -> click.Group:
    """Import the commands when they are first used."""
    if name != "cli":
        raise AttributeError(f"module 'quatprop.cli' has no attribute {name!r}")
    from quatprop.cli.commands import cli

    return cli
