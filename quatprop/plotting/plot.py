"""Draw files into a picture: all of ``quatprop plot``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.comparison.compare import compare
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.plotting.errors import ComparedFile, error_page
from quatprop.plotting.figure import STYLE, Style
from quatprop.plotting.files import FileView, View, view_file
from quatprop.plotting.picture import Page, picture
from quatprop.plotting.target import PictureFile
from quatprop.rendering import file_names, loss_lines
from quatprop.text import spelled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.comparison.settings import ComparisonSettings


def plot(  # noqa: PLR0913  # what the command line gives
    files: Sequence[tuple[str, View]],
    output: str,
    reference: AttitudeInput | None,
    settings: ComparisonSettings,
    *,
    style: Style = STYLE,
    command: str = "",
) -> tuple[list[str], Sequence[str], bool]:
    """Draw files into a picture.

    `files`: paths, at least one, and what to draw of each; ``"-"`` is CSV on stdin
    `reference`: draw the error of each file against this series instead; None: what is in the files
    """
    inputs = [*(path for path, _ in files), None if reference is None else reference.path]
    with PictureFile(output, inputs, style=style, command=command) as target:
        if reference is None:
            views = [view_file(path, view) for path, view in files]
            page = _page(views)
            named = zip(page.tables, views, strict=True)
            lines = [f"{name}: {one.samples}" for (name, _), one in named]
            data_lost = any(one.losses for one in views)
        else:
            page, data_lost = _error_page(files, reference, settings)
            lines = list(page.lead)
        target.commit(page)
    return lines, page.warnings, data_lost


def _page(views: list[FileView]) -> Page:
    """Return the page on files, each as it is."""
    several = len(views) > 1
    names = file_names((view.plotted.label, view.source) for view in views)
    files = [
        # Its detail has the topic.
        view.plotted._replace(label=name.removesuffix(f" {view.source}"))
        for view, name in zip(views, names, strict=True)
    ]
    meanings = dict.fromkeys(view.meaning for view in views)
    facts = ("; ".join(meanings), "; ".join(view.samples for view in views))
    return Page(
        title=f"{len(views)} files: {', '.join(names)}" if several else files[0].name,
        facts=facts,
        lead=facts,
        picture=picture(files),
        warnings=tuple(
            f"{name}: {remark}" if several else remark
            for name, view in zip(names, views, strict=True)
            for remark in (*map(spelled, view.remarks), *loss_lines(view.losses))
        ),
        tables=[(file.name, view.facts) for file, view in zip(files, views, strict=True)],
    )


def _error_page(
    files: Sequence[tuple[str, View]], wanted: AttitudeInput, settings: ComparisonSettings
) -> tuple[Page, bool]:
    """Return the page on the errors of files against a reference, and whether data was lost."""
    reference = load_attitudes(wanted)
    operands = [
        load_attitudes(AttitudeInput(path, view.kind, view.attitudes, drop=True))
        for path, view in files
    ]
    names = file_names((one.input.path, one.signal.name) for one in (*operands, reference))
    compared = [
        ComparedFile(name, operand, compare(operand.series, reference.series, settings))
        for name, operand in zip(names, operands, strict=False)
    ]
    page = error_page(compared, names[-1], reference)
    left_out = any(file.operand.data_lost or file.comparison.left_out for file in compared)
    return page, reference.data_lost or left_out
