"""Draw files into a picture: all of ``quatprop plot``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from quatprop.comparison.compare import compare
from quatprop.comparison.settings import ComparisonSettings
from quatprop.plot.draw import STYLE, Style
from quatprop.plot.errors import ComparedFile, error_page
from quatprop.plot.files import view_file
from quatprop.plot.page import FactTable, Page
from quatprop.plot.picture import picture
from quatprop.plot.target import MADE_BY, PictureFile, notes_of
from quatprop.plot.view import View
from quatprop.rendering import file_names, loss_lines
from quatprop.signals.attitude_input import AttitudeInput, load_attitudes

if TYPE_CHECKING:
    from quatprop.plot.view import FileView
    from quatprop.rendering import Spell
    from quatprop.signals.attitude_input import ReadAttitudes


@dataclass(frozen=True, slots=True)
class Plot:
    """What to draw.

    Parameters
    ----------
    files
        Paths, at least one; ``"-"`` is CSV on stdin.
    output
        Where the picture goes.
    view
        What to draw of the files.
    reference
        Draw the error of each file against this series instead; None: what is in the files.
    settings
        How to compare with the reference.
    style
        How large the picture is.
    """

    files: tuple[str, ...]
    output: str
    view: View = field(default_factory=View)
    reference: AttitudeInput | None = None
    settings: ComparisonSettings = field(default_factory=ComparisonSettings)
    style: Style = STYLE


@dataclass(frozen=True, slots=True)
class PlotSummary:
    """What was drawn.

    Parameters
    ----------
    lines
        What each file shows.
    warnings
        What a reader should know.
    data_lost
        Whether something of a file could not be read or used.
    """

    lines: tuple[str, ...]
    warnings: tuple[str, ...]
    data_lost: bool


def plot(job: Plot, spell: Spell = str) -> PlotSummary:
    """Draw files into a picture.

    Parameters
    ----------
    job
        What to draw.
    spell
        Writes a sentence that may mention settings.

    Raises
    ------
    LogError
        A file cannot be used with this selection.
    OutputError
        The picture cannot be written.
    UsageError
        The files have different quantities, or matplotlib is not installed.
    ComparisonError
        A file cannot be compared with the reference.
    """
    inputs = [*job.files, None if job.reference is None else job.reference.path]
    with PictureFile(job.output, inputs, spell=spell, style=job.style) as target:
        if job.reference is None:
            views = [view_file(path, job.view) for path in job.files]
            page = _page(views, spell)
            lines = tuple(f"{view.name}: {view.samples}" for view in views)
            data_lost = any(view.losses for view in views)
        else:
            page, operands = _error_page(job, job.reference, spell)
            lines = page.lead
            data_lost = any(operand.data_lost for operand in operands)
        target.commit(page)
    return PlotSummary(lines, page.warnings, data_lost)


def _page(views: list[FileView], spell: Spell) -> Page:
    """Return the page on files, each as it is."""
    several = len(views) > 1
    warnings = tuple(
        f"{view.plotted.label}: {remark}" if several else remark
        for view in views
        for remark in (*map(spell, view.remarks), *loss_lines(view.losses))
    )
    names = file_names(view.path for view in views)
    meanings = dict.fromkeys(view.meaning for view in views)
    facts = ("; ".join(meanings), "; ".join(view.samples for view in views))
    title = f"{len(views)} files: {', '.join(names)}" if several else views[0].name
    files = [replace(view.plotted, label=name) for view, name in zip(views, names, strict=True)]
    return Page(
        heading=title,
        lead=facts,
        picture=picture(files, title, facts, notes_of(warnings)),
        warnings=warnings,
        tables=tuple(FactTable(view.name, view.facts) for view in views),
        made_by=MADE_BY,
    )


def _error_page(job: Plot, wanted: AttitudeInput, spell: Spell) -> tuple[Page, list[ReadAttitudes]]:
    """Return the page on the errors of files against a reference, and all series."""
    reference = load_attitudes(wanted)
    names = file_names([*job.files, wanted.path])
    files = []
    for path, name in zip(job.files, names, strict=False):
        operand = load_attitudes(AttitudeInput(path, job.view.kind, job.view.attitudes, drop=True))
        comparison = compare(operand.series, reference.series, job.settings)
        files.append(ComparedFile(name, operand, comparison))
    page = error_page(files, names[-1], reference, spell)
    return page, [*(file.operand for file in files), reference]
