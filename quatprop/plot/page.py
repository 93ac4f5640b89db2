"""A report as one HTML file: opens anywhere, loads nothing, in light and in dark."""

from __future__ import annotations

import re
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, NamedTuple

from quatprop.plot.draw import inline_svg
from quatprop.plot.palette import BLACK, DARK
from quatprop.text import plain

if TYPE_CHECKING:
    from quatprop.plot.picture import Picture
    from quatprop.text import Text


class Table(NamedTuple):
    """Facts under a heading.

    Parameters
    ----------
    heading
        What they are about.
    rows
        Name and text of each.
    """

    heading: str
    rows: tuple[tuple[str, str], ...]


class Page(NamedTuple):
    """What a report says.

    Parameters
    ----------
    heading
        Its title.
    lead
        What it comes to, in a line or two.
    picture
        The picture.
    warnings
        What looks wrong.
    tables
        The facts.
    made_by
        Name and version of what made it.
    """

    heading: str
    lead: tuple[str, ...]
    picture: Picture
    warnings: tuple[str | Text, ...]
    tables: tuple[Table, ...]
    made_by: str


STYLE = """
:root { color-scheme: light dark; --page: #ffffff; --ink: #222222; --faint: #5c5c5c;
  --edge: #d8d8d8; --alarm: #b04a00; --alarm-page: #fff4ec; }
@media (prefers-color-scheme: dark) { :root { --page: #16181b; --ink: #e6e6e6; --faint: #a8a8a8;
  --edge: #3a3d42; --alarm: #ff9a57; --alarm-page: #2b2019; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 62rem; background: var(--page);
  color: var(--ink); font: 1rem/1.5 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: 0 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.1rem; margin: 2rem 0 .4rem; overflow-wrap: anywhere; }
p { margin: 0 0 .25rem; overflow-wrap: anywhere; }
footer { color: var(--faint); font-size: .85rem; margin-top: 2.5rem; }
figure { margin: 1.25rem 0 0; overflow-x: auto; }
figure svg { display: block; width: 100%; min-width: 34rem; height: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { text-align: left; vertical-align: top; padding: .3rem .6rem .3rem 0;
  border-bottom: 1px solid var(--edge); overflow-wrap: anywhere; }
th { width: 10rem; font-weight: 600; color: var(--faint); }
td { font-variant-numeric: tabular-nums; }
.warnings { margin: 1.25rem 0 0; padding: .7rem 1rem .7rem 2.2rem; background: var(--alarm-page);
  border-left: .3rem solid var(--alarm); }
@media (max-width: 36rem) { th { width: 6.5rem; } body { padding-top: 1rem; } }
@media print { :root { --page: #ffffff; --ink: #000000; --faint: #444444; --edge: #bbbbbb;
  --alarm: #b04a00; --alarm-page: #ffffff; } body { max-width: none; padding: 0; font-size: 10pt; }
  figure { overflow: visible; break-inside: avoid; } figure svg { min-width: 0;
  max-height: 18cm; } tr, h2 { break-inside: avoid; } h2 { break-after: avoid; } }
"""


def html(page: Page) -> str:
    """Return a report as the text of an HTML file.

    Everything that comes from files is text in it, never markup.
    """
    light, dark = _colours()
    style = (
        f"{STYLE}:root {{ {light} }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n"
    )
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(page.heading)}</title>",
        f"<style>{style}</style>",
        "</head>",
        "<body>",
        "<main>",
        f"<h1>{_text(page.heading)}</h1>",
        *(f"<p>{_text(line)}</p>" for line in page.lead),
        *_warnings(page.warnings),
        f'<figure role="img" tabindex="0" aria-label="{_text(_spoken(page.picture))}">',
        # What the page says around it, the picture need not say again.
        _with_variables(inline_svg(replace(page.picture, title="", facts=(), notes=()))),
        "</figure>",
        *(line for table in page.tables for line in _table(table)),
        "</main>",
        f"<footer>{_text(page.made_by)}</footer>",
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def _text(text: str | Text) -> str:
    """Return text as it may stand in a page: nothing in it is markup or unprintable."""
    return escape(plain(text))


def _warnings(warnings: tuple[str | Text, ...]) -> list[str]:
    if not warnings:
        return []
    said = [f"<li>{_text(warning)}</li>" for warning in warnings]
    return ['<ul class="warnings" aria-label="Warnings">', *said, "</ul>"]


def _table(table: Table) -> list[str]:
    rows = [
        f'<tr><th scope="row">{_text(name)}</th><td>{_text(text)}</td></tr>'
        for name, text in table.rows
    ]
    return [f"<h2>{_text(table.heading)}</h2>", "<table>", *rows, "</table>"]


def _spoken(picture: Picture) -> str:
    """Return what the picture shows, for whoever does not see it."""
    names = ", ".join(row.quantity.name for row in picture.rows)
    return f"{picture.title}: {names} against time"


def _variable(colour: str) -> str:
    return f"--c{colour[1:].lower()}"


def _colours() -> tuple[str, str]:
    """Return what the colours of the picture are in light and in dark."""
    light = " ".join(f"{_variable(colour)}: {colour};" for colour in DARK)
    dark = " ".join(f"{_variable(colour)}: {other};" for colour, other in DARK.items())
    return light, dark


def _with_variables(svg: str) -> str:
    """Let the page say what the colours of a picture are."""
    for colour in DARK:
        used = f"var({_variable(colour)})"
        svg = re.sub(rf"(?<=: ){colour}\b", used, svg, flags=re.IGNORECASE)
    # A rule for all elements would be one for all of the page.
    svg = svg.replace('<style type="text/css">*{', '<style type="text/css">figure svg *{', 1)
    # Text without a colour is black by default.
    black = f"var({_variable(BLACK)})"
    return svg.replace("<svg ", f'<svg style="fill: {black}" ', 1)
