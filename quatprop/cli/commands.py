"""The commands, each in a module that is imported when the command is run."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli import FAILED
from quatprop.cli.help import write_section
from quatprop.cli.interruption import INTERRUPTED, MESSAGE, interruptible
from quatprop.text import did_you_mean, spelling
from quatprop.version import __version__

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMMANDS = {
    "info": "Show what a log holds: every source of body rates.",
    "propagate": "Turn the body rates of one log into its attitude series.",
    "batch": "Turn the body rates of many logs into attitude series.",
    "convert": "Write an attitude series in another layout, convention, form or format.",
    "compare": "Measure the error between two attitude series.",
    "calibrate": "Estimate the calibration of a gyroscope from a reference attitude.",
    "plot": "Plot rates, attitudes, or the error relative to a reference series.",
    "noise": "Measure the noise of a gyroscope while it is at rest.",
    "check": "Compare recorded logs with references, as a regression test.",
    "simulate": "Write a log whose true attitude is known.",
    "completion": "Print the script that completes names in bash, zsh or fish.",
}
"""Every command with its one-line help, so that ``--help`` imports none of them."""


class Unusable(click.ClickException):
    """Wrong usage or unreadable input: one sentence, exit code 2."""

    exit_code = FAILED


class Commands(click.Group):
    """A group that imports a command on first use."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import and return one command."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"quatprop.cli.{cmd_name}").command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; if there is none, suggest a similar name."""
        if (name := args[0]) not in COMMANDS and not ctx.resilient_parsing:
            hint = did_you_mean(name, COMMANDS, "quatprop --help lists the commands")
            raise click.UsageError(f"No such command {name!r}{hint}", ctx)
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem[str]]:
        """Return the commands from the table, without importing them."""
        from click.shell_completion import CompletionItem

        if incomplete.startswith("-"):
            return click.Command.shell_complete(self, ctx, incomplete)
        found = ((name, text) for name, text in COMMANDS.items() if name.startswith(incomplete))
        return [CompletionItem(name, help=text) for name, text in found]

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; convert errors to a sentence and an exit code."""
        from quatprop.settings.spelling import in_options

        with spelling(in_options):
            try:
                with interruptible():
                    return super().invoke(ctx)
            except BrokenPipeError:
                # The reader of stdout has ended, as in `| head`.
                ctx.exit(0)
            except KeyboardInterrupt:
                click.echo(MESSAGE, err=True)
                ctx.exit(INTERRUPTED)
            except (click.exceptions.NoArgsIsHelpError, click.Abort, click.exceptions.Exit):
                raise
            except click.ClickException as error:
                raise Unusable(error.format_message()) from None
            except Exception as error:
                from quatprop.errors.third_party import as_user_error

                if (known := as_user_error(error)) is None:
                    raise
                raise Unusable(str(known)) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """List the commands from the table."""
        write_section(formatter, "Commands", COMMANDS.items(), max(map(len, COMMANDS)))


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120},
    epilog="quatprop COMMAND --help shows examples and options of a command.",
)
@click.version_option(__version__, message="quatprop %(version)s")
def cli() -> None:
    """Turn recorded gyroscope logs into attitude.

    Reads body rates from MCAP, ROS 1 and ROS 2 bags, PX4 ULog, CSV, Parquet and other tables,
    applies the exact constant-rate step of each sample, q[k+1] = q[k] * dq[k] (Hamilton product,
    attitude body to reference, dq = exp(w dt / 2)), and writes unit quaternions.
    """
