"""Draw files into a picture: all of ``quatprop plot``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.comparison.compare import compare
from quatprop.errors import SeriesError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.plotting.errors import ComparedFile, error_page, errors_over_time
from quatprop.plotting.figure import STYLE, Style
from quatprop.plotting.files import FileView, View, view_file, view_series
from quatprop.plotting.picture import Page, Picture, picture
from quatprop.plotting.target import PictureFile
from quatprop.rendering import file_names, loss_lines
from quatprop.series import AttitudeSeries
from quatprop.text import spelled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.series import GyroSeries


def plot(  # noqa: PLR0913  # what the command line gives
    files: Sequence[tuple[str, View]],
    output: str,
    reference: AttitudeInput | None,
    settings: ComparisonSettings,
    *,
    style: Style = STYLE,
    command: str = "",
) -> tuple[list[str], Page, bool]:
    """Draw files into a picture.

    `files`: paths, at least one, and what to draw of each; ``"-"`` is CSV on stdin
    `reference`: draw the error of each file against this series; None to draw the files
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
    return lines, page, data_lost


def read_picture(
    sources: Sequence[str | GyroSeries | AttitudeSeries],
    view: View,
    reference: str | AttitudeSeries | None,
    settings: ComparisonSettings,
) -> tuple[Picture, Sequence[str], bool]:
    """Return a picture of files and of series, remarks, and whether data is lost.

    `reference`: draw the error of each against these attitudes
    """
    labels = [
        one if isinstance(one, str) else f"series {number}" for number, one in enumerate(sources, 1)
    ]
    if reference is None:
        views = [
            view_file(one, view) if isinstance(one, str) else view_series(label, one, view)
            for one, label in zip(sources, labels, strict=True)
        ]
        page = _page(views)
        return page.picture, page.warnings, any(one.losses for one in views)
    truth, lost = _attitudes(reference, View())
    errors = []
    for one, name in zip(sources, file_names((label, "") for label in labels), strict=True):
        series, loses = _attitudes(one, view)
        errors.append(errors_over_time(name, compare(series, truth, settings)))
        lost |= loses
    return picture(errors), (), lost


def _attitudes(source: object, view: View) -> tuple[AttitudeSeries, bool]:
    """Return attitudes of a file or in memory, and whether data were lost."""
    if isinstance(source, str):
        loaded = load_attitudes(AttitudeInput(source, view.kind, view.attitudes, drop=True))
        return loaded.series, loaded.data_lost
    if not isinstance(source, AttitudeSeries):
        raise SeriesError(f"Expected attitudes, got {type(source).__name__}")
    return source, False


def _page(views: list[FileView]) -> Page:
    """Return the page on files, without a reference."""
    several = len(views) > 1
    names = file_names((view.plotted.label, view.source) for view in views)
    files = [
        # The detail contains the topic.
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
