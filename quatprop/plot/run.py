"""Files in, a picture out: the whole of ``quatprop plot``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from quatprop.comparison import Settings, compare
from quatprop.plot.errors import Compared, error_page
from quatprop.plot.files import View, see
from quatprop.plot.names import lost_text, names_of, noted
from quatprop.plot.page import Page, Table
from quatprop.plot.picture import picture
from quatprop.plot.target import MADE_BY, PictureFile
from quatprop.signals.attitude_input import AttitudeInput, load_attitudes
from quatprop.text import Text

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.plot.files import Seen
    from quatprop.signals.attitude_input import LoadedAttitudes

    Tick = Callable[[int], None]


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
        What to look at in the files.
    reference
        Draw the error of each file against this series instead; None: what is in the files.
    settings
        How to compare with the reference.
    """

    files: tuple[str, ...]
    output: str
    view: View = field(default_factory=View)
    reference: AttitudeInput | None = None
    settings: Settings = field(default_factory=Settings)


def plot(job: Plot, tick: Tick = lambda _samples: None) -> dict[str, Any]:
    """Draw files into a picture.

    Parameters
    ----------
    job
        What to draw.
    tick
        Called with the number of samples of a file read so far.

    Returns
    -------
    dict
        ``lines``, what each file shows; ``warnings``; ``data_lost``. JSON-ready.

    Raises
    ------
    LogError
        A file cannot be used as asked.
    OutputError
        The picture cannot be written.
    UsageError
        The files have different things to show, or matplotlib is not installed.
    ComparisonError
        A file cannot be compared with the reference.
    """
    inputs = [*job.files, None if job.reference is None else job.reference.path]
    with PictureFile(job.output, inputs) as target:
        if job.reference is None:
            seen = [see(path, job.view, tick) for path in job.files]
            page = _page(seen)
            lines = [f"{one.name}: {one.samples}" for one in seen]
            lost = any(one.losses for one in seen)
        else:
            page, operands = _against(job, job.reference)
            lines = list(page.lead)
            lost = any(operand.data_lost for operand in operands)
        target.commit(page)
    return {"lines": lines, "warnings": list(page.warnings), "data_lost": lost}


def _page(seen: list[Seen]) -> Page:
    """Return the report on files, each as it is."""
    several = len(seen) > 1
    warnings = tuple(
        Text(f"{one.part.label}: ", remark) if several else remark
        for one in seen
        for remark in (*one.remarks, *lost_text(one.losses))
    )
    meanings = list(dict.fromkeys(one.meaning for one in seen))
    names = names_of(one.path for one in seen)
    facts = ("; ".join(meanings), "; ".join(one.samples for one in seen))
    title = seen[0].name
    if several:
        title = f"{len(seen)} files: {', '.join(names)}"
    parts = [replace(one.part, label=name) for one, name in zip(seen, names, strict=True)]
    return Page(
        heading=title,
        lead=facts,
        picture=picture(parts, title=title, facts=facts, notes=noted(warnings)),
        warnings=warnings,
        tables=tuple(Table(one.name, one.facts) for one in seen),
        made_by=MADE_BY,
    )


def _against(job: Plot, reference: AttitudeInput) -> tuple[Page, list[LoadedAttitudes]]:
    """Return the report on the errors of files against a reference, and all that was read."""
    known = load_attitudes(reference)
    names = names_of([*job.files, reference.path])
    every = []
    for path, name in zip(job.files, names, strict=False):
        reading = AttitudeInput(path, job.view.kind, job.view.attitudes, drop=True)
        operand = load_attitudes(reading)
        every.append(Compared(name, operand, compare(operand.series, known.series, job.settings)))
    page = error_page(every, names[-1], known)
    return page, [*(one.operand for one in every), known]
