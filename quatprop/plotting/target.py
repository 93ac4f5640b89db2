"""The file of a picture: its suffix gives the kind, and it is published only when complete."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Self

from quatprop.errors import OutputError
from quatprop.pipeline.report import digest_of_input
from quatprop.plotting.draw import render, require_matplotlib
from quatprop.plotting.figure import STYLE, Style
from quatprop.plotting.page import html
from quatprop.provenance import as_json
from quatprop.stores.objects import without_secret
from quatprop.writers.atomic import OutputFile
from quatprop.writers.targets import is_stdout, is_stream, output_errors, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.plotting.picture import Page
    from quatprop.rendering import Row

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
