"""Run `quatprop check` on a suite."""

from click.testing import CliRunner

from quatprop.cli.commands import cli


def check(suite, *options):
    """Run the command; errors come back as exit code and text."""
    return CliRunner().invoke(cli, ["check", str(suite), *map(str, options)])
