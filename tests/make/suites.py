"""Run `quatprop check` on a suite."""

from make.commands import run


def check(suite, *options):
    """Run the command; errors come back as exit code and text."""
    return run("check", suite, *options)
