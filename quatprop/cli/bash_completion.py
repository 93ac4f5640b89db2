"""Completion in bash, with values quoted, so that bash does not execute them.

click's own script splits and expands values, and inserts them unquoted. Here, bash passes the part
of the line that it will replace, and gets a quoted value that it inserts unchanged.
"""

from __future__ import annotations

import os
import re
from typing import NamedTuple

from click.shell_completion import BashComplete, add_completion_class

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
