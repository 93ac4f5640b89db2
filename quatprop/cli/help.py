"""Commands with help in groups of options: the common ones, or all."""

from __future__ import annotations

import os
import re
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from quatprop.text import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

ALL = "quatprop.help.all"
"""Key in ``Context.meta``: whether help shows every option."""

FIRST = 25
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
    said, bracket, default = text.partition("  [")
    said = re.split(r"[.:;] ", said + " ")[0].rstrip(" .")
    return names, said if default.startswith("default: none") else said + bracket + default


class Command(click.Command):
    """A command whose help has groups of options, and examples.

    `examples`: command lines that run in a clone of the project, one after another
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
        """Parse arguments; say the way out for an unknown option or one argument too many."""
        try:
            if not ctx.resilient_parsing:
                self._refuse_two_topics(ctx, args)
            surplus = super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            names = [name for p in self.get_params(ctx) for name in p.opts if name[:2] == "--"]
            # With two inputs, -t has become --topic-a and --topic-b.
            meant = "--topic" if error.option_name == "-t" else error.option_name
            hint = did_you_mean(meant, names)
            raise click.UsageError(f"No such option {error.option_name!r}{hint}", ctx) from None
        if surplus and not ctx.resilient_parsing:
            taken = " ".join(self.collect_usage_pieces(ctx)[1:])
            raise click.UsageError(
                f"unexpected argument {surplus[0]!r}; {ctx.info_name} takes {taken}: run it once "
                "for each",
                ctx,
            )
        return surplus

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
    formatter: click.HelpFormatter, title: str, rows: Iterable[tuple[str, str]], first: int = FIRST
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
