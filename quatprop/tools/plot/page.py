"""A report with a picture as one self-contained HTML file, for light and dark screens and print."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from quatprop.plotting.draw import inline_svg
from quatprop.text import plain
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.plotting.picture import Page
    from quatprop.rendering import Row


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
    style, script = (_resource(f"page.{suffix}") for suffix in ("css", "js"))
    digest = b64encode(sha256(script.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(page.title)}</title>",
        f"<style>\n{style}</style>",
        "</head>",
        "<body>",
        "<main>",
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
        f'<script type="module">{script}</script>',
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def _resource(name: str) -> str:
    return files("quatprop.plotting").joinpath(name).read_text("utf-8")


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
