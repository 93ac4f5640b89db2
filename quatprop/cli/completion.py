"""``quatprop completion``: the script for a shell, and names in the log on the line."""

from __future__ import annotations

import os
import re
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.shell_completion import (
    BashComplete,
    CompletionItem,
    FishComplete,
    ZshComplete,
    add_completion_class,
)

from quatprop.cli import COMPLETE
from quatprop.cli.commands import SIDES, Command
from quatprop.settings.parsers import FILE_SETTINGS

if TYPE_CHECKING:
    from collections.abc import Iterator


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
    from quatprop.base.errors import QuatpropError
    from quatprop.base.places import is_address
    from quatprop.propagation.survey import columns_in, signals_in

    if is_address(path):
        return []
    kind, is_field = ctx.params.get("kind"), setting in {"rate_field", "quat_field"}
    options = [str(option.name) for option in ctx.command.params]
    try:
        if setting.endswith(("_cols", "_col")):
            return columns_in(path, kind)
        topic = ctx.params.get("topic") if is_field else None
        signals = signals_in(
            path,
            kind,
            topic,
            rates=setting != "quat_field" and any(n.startswith("rate_field") for n in options),
            attitudes=setting != "rate_field" and any(n.startswith("quat_field") for n in options),
        )
    except (QuatpropError, OSError):
        return []
    names = (field if is_field else topic for topic, field in signals)
    return list(dict.fromkeys(filter(None, names)))


# Completion in bash, with values quoted, so that bash does not execute them.
#
# click's own script splits and expands values, and inserts them unquoted. Here, bash passes the
# part of the line that it will replace, and gets a quoted value that it inserts unchanged.


_SCRIPT = """\
%(complete_func)s() {
    local response item
    response=$(env COMP_LINE="${COMP_LINE:0:COMP_POINT}" COMP_REPLACED="$2" \\
        %(complete_var)s=bash_complete "$1")
    COMPREPLY=()
    while IFS= read -r item; do
        case $item in
            plain,*) COMPREPLY+=("${item#plain,}") ;;
            file,*) compopt -o default ;;
            dir,*) compopt -o dirnames ;;
        esac
    done <<< "$response"
}

complete -o nosort -F %(complete_func)s %(prog_name)s
"""

_PIECE = re.compile(
    r"""(?P<gap>[ \t\n]+)"""
    r"""|\\(?P<escaped>.?)"""
    r"""|'(?P<single>[^']*)(?P<single_end>'?)"""
    r"""|"(?P<double>(?:[^"\\]|\\.)*)\\?(?P<double_end>"?)"""
    r"""|(?P<bare>[^ \t\n\\'"]+)""",
    re.DOTALL,
)
"""The pieces of a line; a quote may be open at its end."""


class _Word(NamedTuple):
    """A word of a line.

    `quote`: the quote that is open at its end, or empty
    `expands`: whether bash would expand a part of it, or it has operators
    """

    text: str = ""
    quote: str = ""
    expands: bool = False


def words_of(line: str) -> list[_Word]:
    r"""Return the words of a line up to the cursor; the last may be empty, or not yet complete."""
    words = [_Word()]
    for piece in _PIECE.finditer(line):
        kind, quote = str(piece.lastgroup), ""
        if kind == "gap":
            words.append(_Word())
            continue
        text = piece[kind]
        expands = kind == "bare" and bool(re.search("[$`<>|&;()]", text))
        if kind == "single_end":
            text, quote = piece["single"], "" if text else "'"
        elif kind == "double_end":
            quote = "" if text else '"'
            text = re.sub(r'\\([\\"$`])', r"\1", piece["double"])
            expands = bool(re.search("[$`]", re.sub(r"\\.", "", piece["double"])))
        last = words[-1]
        words[-1] = _Word(last.text + text, quote, last.expands or expands)
    return words


def quoted_in(quote: str, text: str) -> str:
    r"""Return the rest of a word escaped for bash, after an open quote or none."""
    if not quote:
        return re.sub(r"([^\w@%+=:,./-])", r"\\\1", text)
    if quote == "'":
        inserted = text.replace("'", r"'\''")
    else:
        # An exclamation mark is special in double quotes, even after a backslash.
        inserted = re.sub(r'([\\"$`])', r"\\\1", text).replace("!", r'"\!"')
    # If this begins with a quote, bash replaces the open quote by it.
    return inserted + quote if inserted[:1] != quote else quote + inserted + quote


@add_completion_class
class Bash(BashComplete):
    """Completes the word before the cursor."""

    source_template = _SCRIPT

    def complete(self) -> str:
        """Return the possible values, one per line."""
        # Without these variables, the script is click's own, which would execute values.
        line, replaced = (os.environ.get(name, "") for name in ("COMP_LINE", "COMP_REPLACED"))
        *words, begun = words_of(line)
        if not words or begun.expands or not line.endswith(replaced):
            return ""
        kept = words_of(line[: len(line) - len(replaced)])[-1]
        option, equals, _ = begun.text.partition("=") if begun.text[:1] == "-" else ("", "", "")
        lines = []
        for item in self.get_completions([word.text for word in words[1:]], begun.text):
            value = option + equals + item.value if equals else item.value
            if item.type == "plain" and value.startswith(kept.text):
                lines.append(f"plain,{quoted_in(kept.quote, value[len(kept.text) :])}")
            elif item.type != "plain":
                lines.append(f"{item.type},")
        return "\n".join(lines)
