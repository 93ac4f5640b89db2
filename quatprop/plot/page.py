"""A page around a picture as one HTML file: loads nothing; for light and dark screens and print."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple

from quatprop.plot.draw import inline_svg
from quatprop.text import plain

if TYPE_CHECKING:
    from quatprop.plot.picture import Picture
    from quatprop.rendering import Row


class FactTable(NamedTuple):
    """Facts under a heading.

    Parameters
    ----------
    heading
        Its title.
    rows
        Label and text of each.
    """

    heading: str
    rows: tuple[Row, ...]


class Page(NamedTuple):
    """A page around a picture.

    Parameters
    ----------
    heading
        Its title.
    lead
        The result, in a line or two.
    picture
        The picture.
    warnings
        What a reader should know.
    tables
        Details.
    made_by
        Name and version of the program.
    """

    heading: str
    lead: tuple[str, ...]
    picture: Picture
    warnings: tuple[str, ...]
    tables: tuple[FactTable, ...]
    made_by: str


def html(page: Page) -> str:
    """Return a report as the text of an HTML file.

    Everything that comes from files is text in it, never markup.
    """
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(page.heading)}</title>",
        f"<style>\n{files('quatprop.plot').joinpath('page.css').read_text('utf-8')}</style>",
        "</head>",
        "<body>",
        "<main>",
        f"<h1>{_text(page.heading)}</h1>",
        *(f"<p>{_text(line)}</p>" for line in page.lead),
        *_warnings(page.warnings),
        f'<figure role="img" tabindex="0" aria-label="{_text(_description(page.picture))}">',
        # Title, facts and notes stand on the page already.
        inline_svg(replace(page.picture, title="", facts=(), notes=())),
        "</figure>",
        *(line for table in page.tables for line in _table(table)),
        "</main>",
        f"<footer>{_text(page.made_by)}</footer>",
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def _text(text: str) -> str:
    """Return text escaped for a page: no markup, no unprintable characters."""
    return escape(plain(text))


def _warnings(warnings: tuple[str, ...]) -> list[str]:
    if not warnings:
        return []
    items = [f"<li>{_text(warning)}</li>" for warning in warnings]
    return ['<ul class="warnings" aria-label="Warnings">', *items, "</ul>"]


def _table(table: FactTable) -> list[str]:
    rows = [
        f'<tr><th scope="row">{_text(name)}</th><td>{_text(text)}</td></tr>'
        for name, text in table.rows
    ]
    return [f"<h2>{_text(table.heading)}</h2>", "<table>", *rows, "</table>"]


def _description(picture: Picture) -> str:
    """Return what the picture shows, for screen readers."""
    names = ", ".join(panel.quantity.name for panel in picture.panels)
    return f"{picture.title}: {names} against time"
