"""A report with a picture as one self-contained HTML file, for light and dark screens and print."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Self

from quatprop.base import __version__
from quatprop.base.errors import OutputError
from quatprop.base.places import is_stdout, is_stream, without_secret
from quatprop.base.provenance import as_json
from quatprop.base.text import plain
from quatprop.propagation.report import digest_of_input
from quatprop.tools.plot.figure import STYLE, Style, inline_svg, render, require_matplotlib
from quatprop.writers.atomic import OutputFile
from quatprop.writers.targets import output_errors, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.rendering import Row
    from quatprop.tools.plot.picture import Page


HINT = (
    "Drag over a time range to zoom in, double-click to see all; drag with Shift or use the arrow "
    "keys to pan, + and \N{MINUS SIGN} to zoom."
)
"""How to zoom into the picture of a page."""

REDUCED = (
    " Only the extremes of each short interval are drawn: plot a part of it to zoom in further."
)
"""Additional hint for a long series."""


def html(page: Page, made_by: str, inputs: Iterable[Row]) -> str:
    """Return a report as the text of an HTML file.

    Text from files is escaped, so it is never markup. Browsers run only the script of the page, and
    load nothing.
    """
    svg, numbers = inline_svg(page)
    limits = f'data-limits="{escape(numbers)}"'
    back = f'<p class="back"><a href="{escape(page.back)}">all cases</a></p>'
    body = [
        "<main>",
        *([back] if page.back else []),
        f"<h1>{_text(page.title)}</h1>",
        *(f"<p>{_text(line)}</p>" for line in page.lead),
        *_warnings(page.warnings),
        f'<figure role="img" tabindex="0" aria-label="{_description(page)}" {limits}>',
        svg,
        "</figure>",
        f'<p class="hint" hidden>{HINT}{REDUCED if page.picture.bin_s else ""}</p>',
        *(line for table in (*page.tables, ("Made from", inputs)) for line in _table(*table)),
        "</main>",
        f"<footer>{_text(made_by)}<br>quatprop {__version__}</footer>",
    ]
    return document(page.title, body, script=_resource("page.js"))


def document(title: str, body: Iterable[str], *, script: str = "", style: str = "") -> str:
    """Return a page in the look of all pages, which loads nothing and runs one script at most.

    `title`: text; `body`: lines of markup
    `style`: further rules
    """
    digest = b64encode(sha256(script.encode()).digest()).decode()
    scripts = f"; script-src 'sha256-{digest}'" if script else ""
    policy = f"default-src 'none'; style-src 'unsafe-inline'{scripts}"
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(title)}</title>",
        f"<style>\n{_resource('page.css')}{style}</style>",
        "</head>",
        "<body>",
        *body,
        *([f'<script type="module">{script}</script>'] if script else []),
        "</body>",
        "</html>",
    ]
    return "\n".join(lines) + "\n"


def _resource(name: str) -> str:
    return files("quatprop.tools.plot").joinpath(name).read_text("utf-8")


def _text(text: str) -> str:
    """Return text escaped for a page: no markup, no unprintable characters."""
    return escape(plain(text))


def _warnings(warnings: tuple[str, ...]) -> list[str]:
    if not warnings:
        return []
    items = [f"<li>{_text(warning)}</li>" for warning in warnings]
    return ['<ul class="warnings" aria-label="Warnings">', *items, "</ul>"]


def _table(heading: str, facts: Iterable[Row]) -> list[str]:
    rows = [
        f'<tr><th scope="row">{_text(name)}</th><td>{_text(text)}</td></tr>' for name, text in facts
    ]
    return [f"<h2>{_text(heading)}</h2>", "<table>", *rows, "</table>"]


def _description(page: Page) -> str:
    """Return a description of the picture, for screen readers."""
    names = ", ".join(panel.quantity.name for panel in page.picture.panels)
    return _text(f"{page.title}: {names} against time")


# The file of a picture: its suffix gives the kind, and it is published only when complete.


KINDS = {".png": "png", ".svg": "svg", ".pdf": "pdf", ".html": "html", ".htm": "html"}
"""Suffix -> kind of picture."""


class PictureFile:
    """A picture or a page that is being written to a file.

    `target`: the file; the suffix determines the kind
    `inputs`, `outputs`: other files that the run reads and writes, refused as the target
    `style`: size of the picture; a page has its own size
    `command`: the command that a page names as its origin
    """

    def __init__(
        self,
        target: str,
        inputs: Iterable[str | None],
        outputs: Iterable[str | None] = (),
        *,
        style: Style = STYLE,
        command: str = "",
    ) -> None:
        self._style, self._command = style, command
        self._inputs = [name for name in dict.fromkeys(inputs) if name]
        self._kind = kind_of(target)
        require_matplotlib()
        refuse_overlap(self._inputs, [*outputs, target])
        self._output = OutputFile(target)

    def commit(self, page: Page) -> None:
        """Draw the picture, or the page around it, and publish it."""
        if self._kind == "html":
            content = html(page, self._command, map(_contents, self._inputs)).encode()
        else:
            content = render(page, self._kind, self._style)
        with output_errors(self._output.target):
            self._output.stream.write(content)
        self._output.commit()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._output.discard()


def _contents(path: str) -> Row:
    """Return the name of a file, and its size and digests."""
    facts = as_json(digest_of_input(path))
    named = (("sha256", "SHA-256"), ("etag", "ETag"))
    known = [f"{name} {facts[key]}" for key, name in named if facts.get(key)]
    size = "not recorded" if facts["bytes"] is None else f"{facts['bytes']:,} bytes"
    return "stdin" if path == "-" else without_secret(path), ", ".join([size, *known])


def kind_of(target: str) -> str:
    """Return the kind of a picture by the suffix of its name."""
    if is_stdout(target) or is_stream(target):
        raise OutputError(target, "a plot is written to a file; name one that ends in .png")
    kind = KINDS.get(Path(target).suffix.lower())
    if kind is None:
        raise OutputError(
            target,
            "the suffix is not an image format; use .png, .svg or .pdf, or .html for a report",
        )
    return kind
