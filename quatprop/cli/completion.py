"""``quatprop completion``: the script for a shell, and names in the log on the line."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click
from click.shell_completion import CompletionItem, FishComplete, ZshComplete

from quatprop.cli import COMPLETE
from quatprop.cli.help import SIDES, Command
from quatprop.settings.rotations import FILE_SETTINGS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from quatprop.logs.signals.choice import Candidate
    from quatprop.tables.log import Log

NAMED = {"topic", "rate_field", "quat_field", "rate_cols", "quat_cols", "time_col"}
"""Settings with a name in the log as value."""

EXAMPLES = (
    "quatprop completion bash",
    "quatprop completion zsh",
    "quatprop completion fish",
)


@click.command(cls=Command, examples=EXAMPLES, grouped=False, no_args_is_help=True)
@click.argument("shell", type=click.Choice(("bash", "zsh", "fish")))
def command(shell: str) -> None:
    """Print the script that completes commands, options, files, topics and columns in a shell.

    Write it where the shell looks for it:

    \b
    bash  ~/.local/share/bash-completion/completions/quatprop
    zsh   ~/.zfunc/_quatprop, with ~/.zfunc in fpath
    fish  ~/.config/fish/completions/quatprop.fish

    bash needs its package bash-completion for that. Without it, put this into ~/.bashrc:
    source <(quatprop completion bash)
    """
    from quatprop.cli.bash_completion import Bash
    from quatprop.cli.commands import cli

    script = {"bash": Bash, "zsh": ZshComplete, "fish": FishComplete}[shell]
    click.echo(script(cli, {}, "quatprop", COMPLETE).source())


def values(name: str, takes: str, ctx: click.Context, incomplete: str) -> list[CompletionItem[str]]:
    """Return the possible values of a setting: words, files, or names in the log on the line.

    `takes`: the value in help, such as ``"X,Y,Z|static[:nearest|:interpolate]|FILE"``
    """
    base, _, side = name.rpartition("_")
    setting = base if side in SIDES else name
    found = [CompletionItem(word) for word in _words(takes) if word.startswith(incomplete)]
    if setting in FILE_SETTINGS and re.search("FILE|PATH", takes):
        found.append(CompletionItem(incomplete, type="file"))
    log = _log(ctx, side) if setting in NAMED else None
    if log is None:
        return found
    # In a list of columns, the last is completed.
    done, comma, begun = incomplete.rpartition(",") if setting.endswith("_cols") else ("", "", "")
    begun = begun if comma else incomplete
    # Line breaks and tabs would end a value, and terminals execute control characters.
    names = (
        name
        for name in _names_in(log, setting, ctx)
        if name and name.isprintable() and name not in done.split(",")
    )
    return found + [CompletionItem(done + comma + name) for name in names if name.startswith(begun)]


def _words(takes: str) -> Iterator[str]:
    """Yield the literal words of a value, which are in lower case."""
    pattern = r"(?:^|\|)([a-z-]+)(?=[|[]|$)(\[[^]]*)?"
    for word, endings in re.findall(pattern, takes):
        yield word
        yield from (word + ending for ending in re.findall(":[a-z]+", endings))


def _log(ctx: click.Context, side: str) -> str | None:
    """Return the log that the options of a side are for; the first of several."""
    # click has parsed the arguments for --topic=NAME, but not for -t NAME, whose value is missing.
    logs: list[Any] = list(ctx.args)
    for parameter in ctx.command.params:
        given = ctx.params.get(str(parameter.name))
        if isinstance(parameter, click.Argument) and given:
            logs += given if isinstance(given, tuple) else [given]
    if side == "ref":
        logs = [ctx.params.get("reference")]
    place = 1 if side == "b" else 0
    return logs[place] if len(logs) > place and logs[place] != "-" else None


def _names_in(path: str, setting: str, ctx: click.Context) -> list[str]:
    """Return topics, fields or columns of a log; empty if it cannot be read."""
    from quatprop.errors import QuatpropError
    from quatprop.logs.open_log import open_log
    from quatprop.stores.log_names import split_topic
    from quatprop.stores.objects import is_address

    if is_address(path):
        return []
    try:
        path, ctx.params["topic"] = split_topic(path, ctx.params.get("topic"))
        with open_log(path, ctx.params.get("kind")) as log:
            if setting.endswith(("_cols", "_col")):
                files = (table for table in log.tables() if not table.is_typed)
                return [column.text for table in files for column in table.columns]
            return list(dict.fromkeys(filter(None, _in_messages(log, setting, ctx))))
    except (QuatpropError, OSError):
        return []


def _in_messages(log: Log, setting: str, ctx: click.Context) -> Iterator[str]:
    """Yield topics, or fields, of the signals that the command reads."""
    from quatprop.errors import LogError
    from quatprop.logs.signals.attitudes import attitude_candidates
    from quatprop.logs.signals.rates import rate_candidates
    from quatprop.settings.selection import AttitudeSelection, RateSelection

    options = {str(option.name) for option in ctx.command.params}
    kinds: Mapping[str, tuple[Callable[..., Iterable[Candidate[Any]]], Any]] = {
        "rate_field": (rate_candidates, RateSelection),
        "quat_field": (attitude_candidates, AttitudeSelection),
    }
    topic = ctx.params.get("topic") if setting in kinds else None
    for field, (candidates, selection) in kinds.items():
        if setting in kinds.keys() - {field} or not any(name.startswith(field) for name in options):
            continue
        with suppress(LogError):
            for candidate in candidates(log, selection(topic=topic)):
                yield candidate.field if setting in kinds else candidate.topic
