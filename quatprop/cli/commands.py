"""The commands, each in a module that is imported when the command is run."""

from __future__ import annotations

import os
import re
from importlib import import_module
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from quatprop.base import __version__
from quatprop.base.text import did_you_mean, nearest, spelling
from quatprop.cli import ERROR_EXIT
from quatprop.cli.interruption import INTERRUPTED, MESSAGE, interruptible

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from click.shell_completion import CompletionItem


# Commands with help in groups of options: the common ones, or all.


ALL = "quatprop.help.all"
"""Key in ``Context.meta``: whether help shows every option."""

OPTION_WIDTH = 25
"""Width of the column of options; for a longer one, help begins on the next line."""

OWN = "Options"
"""Title of options without a group, which only one command has."""

GROUPS = (
    *("Input", "Time range", "Rates", "Initial attitude", "Integration", "Timestamps"),
    *("Uncertainty", "Limits", "Alignment", "Output", "Execution", "Display"),
)
"""Titles of groups, in order of appearance."""

SIDES = ("a", "b", "ref")
"""Suffixes of options for one of several inputs, each with its own group."""


class GroupedOption(click.Option):
    """An option with its group; `common`: whether short help shows it."""

    def __init__(self, *args: Any, group: str, common: bool, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.group = group
        self.common = common

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the parsed value; ``none`` unsets an option of a configuration."""
        choices = getattr(self.type, "choices", ())
        # --time-col none counts rows.
        is_value = "none" in choices or self.name == "time_col"
        is_preset = isinstance(self.default, str)
        can_be_none = getattr(self.type, "can_be_none", False)
        if value == "none" and can_be_none and not is_preset and not is_value:
            return None
        return super().type_cast_value(ctx, value)


def brief(names: str, text: str) -> tuple[str, str]:
    """Return the help record of an option with the first clause of its help, and its default."""
    clause, bracket, default = text.partition("  [")
    clause = re.split(r"[.:;] ", clause + " ")[0].rstrip(" .")
    return names, clause if default.startswith("default: none") else clause + bracket + default


class Command(click.Command):
    """A command whose help has groups of options, and examples.

    `examples`: command lines that run one after another in an empty folder
    `grouped`: whether help groups the options
    """

    allow_extra_args = True  # they are refused here

    def __init__(
        self, *args: Any, examples: Sequence[str], grouped: bool = True, **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self.examples = examples
        self._grouped = grouped

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Add ``--help-all``, even if help already shows all options."""
        return [*super().get_params(ctx), _HELP_ALL]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse arguments; suggest a remedy for an unknown option or one argument too many."""
        try:
            if not ctx.resilient_parsing:
                self._refuse_two_topics(ctx, args)
            surplus = super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            names = [name for p in self.get_params(ctx) for name in p.opts if name[:2] == "--"]
            # With two inputs, -t has become --topic-a and --topic-b.
            meant = "--topic" if error.option_name == "-t" else error.option_name
            hint = self._option_meant(meant, names)
            raise click.UsageError(f"No such option {error.option_name!r}{hint}", ctx) from None
        if surplus and not ctx.resilient_parsing:
            taken = " ".join(self.collect_usage_pieces(ctx)[1:])
            raise click.UsageError(
                f"unexpected argument {surplus[0]!r}; {ctx.info_name} takes {taken}: run it once "
                "for each",
                ctx,
            )
        return surplus

    @staticmethod
    def _option_meant(name: str, names: Sequence[str]) -> str:
        """Return the end of a sentence that suggests an option, or both of a pair for A and B."""
        near = nearest(name, names)
        of_a, of_b = f"{near}"[:-1] + "a", f"{near}"[:-1] + "b"
        if near in {of_a, of_b} and {of_a, of_b} <= {*names}:
            return f"; did you mean '{of_a}' or '{of_b}'?"
        return did_you_mean(name, names)

    def _refuse_two_topics(self, ctx: click.Context, args: list[str]) -> None:
        """Refuse a repeated topic, of which click would silently take the last."""
        _, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter in {*order}:
            given = order.count(parameter)
            if str(parameter.name).startswith("topic") and given > 1:
                raise click.UsageError(
                    f"{parameter.opts[-1]} is given {given} times, and one topic is read; run the "
                    "command once for each",
                    ctx,
                )

    def invoke(self, ctx: click.Context) -> None:
        """Run the command and exit with the code that it returns."""
        ctx.exit(super().invoke(ctx) or 0)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples, and the options by group."""
        with formatter.section(styled("Examples", bold=True)):
            for line in self.examples:
                # Long lines continue below, with a backslash.
                room = formatter.width - (4 if len(line) > formatter.width else 0)
                parts = wrap(line, room, break_long_words=False, break_on_hyphens=False)
                formatter.write("  {}\n".format(" \\\n    ".join(parts)))
        every = ctx.meta.get(ALL) or not self._grouped
        groups: dict[str, list[tuple[str, str]]] = {OWN: [], **{title: [] for title in GROUPS}}
        for option in self.get_params(ctx):
            record = option.get_help_record(ctx) if isinstance(option, click.Option) else None
            # Options of click itself show help.
            title, common = "Display", True
            if isinstance(option, GroupedOption):
                title, common = option.group, option.common
            title = title if self._grouped else OWN
            if record is not None and (every or common or title == OWN):
                groups.setdefault(title, []).append(record if every else brief(*record))
        for title, rows in groups.items():
            if rows:
                write_section(formatter, title, rows)


def write_section(
    formatter: click.HelpFormatter,
    title: str,
    rows: Iterable[tuple[str, str]],
    first: int = OPTION_WIDTH,
) -> None:
    """Write a heading and two columns; `first`: width of the first one."""
    with formatter.section(styled(title, bold=True)):
        cells = [(styled(name.ljust(first), fg="cyan"), text) for name, text in rows]
        formatter.write_dl(cells, col_max=first)


def styled(text: str, **style: Any) -> str:
    """Return text in colour or bold, unless NO_COLOR is set."""
    return text if os.environ.get("NO_COLOR") else click.style(text, **style)


def _show_all(ctx: click.Context, _parameter: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[ALL] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


_HELP_ALL = click.Option(
    ["--help-all"],
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_all,
    help="Show all options and exit.",
)


COMMANDS = {
    "info": "List the sources of body rates and of attitudes in a log.",
    "propagate": "Turn the body rates of one log into its attitude series.",
    "batch": "Turn the body rates of many logs into attitude series.",
    "convert": "Write an attitude series in another layout, convention, form or format.",
    "compare": "Measure the error between two attitude series.",
    "calibrate": "Estimate the calibration of a gyroscope from a reference attitude.",
    "crosscheck": "Compare every source of rotation in logs with every other.",
    "plot": "Plot rates, attitudes, or the error relative to a reference series.",
    "noise": "Measure the noise of a gyroscope while it is at rest.",
    "check": "Compare recorded logs with references, as a regression test.",
    "simulate": "Write a log whose true attitude is known.",
    "completion": "Print the script that completes names in bash, zsh or fish.",
}
"""Every command with its one-line help, so that ``--help`` imports none of them."""


class Unusable(click.ClickException):
    """Wrong usage or unreadable input: one sentence, exit code 2."""

    exit_code = ERROR_EXIT


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
        from quatprop.settings import in_options

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
                from quatprop.base.errors import as_user_error

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
    attitude body to reference, dq = exp(w dt / 2)), and writes the attitudes as quaternions.
    """
