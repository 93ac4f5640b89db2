"""The error between attitude series in time: tolerance, first sample above it, worst sample."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.summary import comparison_rows, criterion_text, sigma_text, with_names
from quatprop.plot.accumulators import ERROR, Accumulator
from quatprop.plot.page import FactTable, Page
from quatprop.plot.picture import Group, Mark, PlottedFile, picture
from quatprop.plot.target import MADE_BY, PictureFile
from quatprop.rendering import degrees_text, file_names, loss_lines
from quatprop.text import plain
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from quatprop.comparison.meter import ComparedSample
    from quatprop.comparison.result import Comparison
    from quatprop.plot.picture import Picture
    from quatprop.rendering import Spell
    from quatprop.signals.attitude_input import ReadAttitudes

DIGITS = 4
"""Of the angles in a picture."""

MATCHES = {
    "exact": "pairs of equal stamps",
    "nearest": "pairs nearest in time",
    "interpolate": "pairs, interpolated in time",
}
"""How attitudes were matched -> what the pairs are."""


class ComparedFile(NamedTuple):
    """A series and its error against a reference.

    Parameters
    ----------
    name
        Name of the file.
    operand
        The series.
    comparison
        Its comparison with the reference.
    """

    name: str
    operand: ReadAttitudes
    comparison: Comparison


class ErrorPicture(PictureFile):
    """The error between two series on its way to a file; see :class:`PictureFile`."""

    def draw(self, a: ReadAttitudes, b: ReadAttitudes, comparison: Comparison) -> None:
        """Draw the comparison of A with B, and put the picture in its place."""
        name, reference = file_names([a.input.path, b.input.path])
        if name == reference:
            # Two topics of one log.
            name, reference = (f"{name} {plain(side.signal.name)}" for side in (a, b))
        self.commit(error_page([ComparedFile(name, a, comparison)], reference, b, self.spell))


def error_page(
    files: Sequence[ComparedFile], reference_name: str, reference: ReadAttitudes, spell: Spell
) -> Page:
    """Return the page on the errors of series against one reference.

    Parameters
    ----------
    files
        The series and their errors, at least one.
    reference_name
        Name of the reference.
    reference
        The series that all were compared with.
    spell
        Writes a sentence that may mention settings.
    """
    names = ", ".join(file.name for file in files)
    title = f"error of {names} against {reference_name}"
    first = files[0].comparison
    facts = (
        f"geodesic angle, alignment {first.alignment.name}{_offset(first)}, {_matched(first)}",
        "" if len(files) > 1 else _sizes(first),
    )
    warnings = tuple(_warnings(files, reference, spell))
    lines = [_plotted(file) for file in files]
    if len(files) == 1:
        lines += _beside(first)
    lines += [line for file in files for line in _sigma_tolerance(file, single=len(files) == 1)]
    drawn = picture(lines, title, facts, warnings[:2])
    return Page(
        heading=title,
        lead=tuple(_verdict(file) for file in files),
        picture=_marked(drawn, files),
        warnings=warnings,
        tables=tuple(
            FactTable(
                f"{file.name} against {reference_name}",
                tuple(comparison_rows(file.operand, reference, file.comparison, spell)),
            )
            for file in files
        ),
        made_by=MADE_BY,
    )


def _plotted(file: ComparedFile) -> PlottedFile:
    comparison = file.comparison
    return _line(file.name, comparison.t_ns, comparison.errors, _sizes(comparison))


def _beside(comparison: Comparison) -> Iterator[PlottedFile]:
    """Yield the error over windows, if any, and the size that the series expect of the error."""
    if (window := comparison.window) is not None:
        text = f"max {degrees_text(window.max_rad, DIGITS)}, from where each begins"
        name = f"over {duration_text(window.window_ns)}"
        yield _line(name, window.begins_ns, window.errors, text)
    if (sigmas := comparison.sigmas) is not None:
        text = f"the final error is {sigma_text(sigmas.final)}"
        line = _line("expected (1 sigma)", comparison.t_ns, sigmas.one_sigma_rad, text)
        yield replace(line, band=True)


def _sigma_tolerance(file: ComparedFile, *, single: bool) -> Iterator[PlottedFile]:
    """Yield the largest error that a tolerance in sigma allows, in the direction of each error."""
    for criterion in file.comparison.criteria:
        sigmas, is_largest = file.comparison.sigmas, criterion.setting in {"tol", "max_sigma"}
        if sigmas and criterion.unit == "sigma" and is_largest:
            name = f"tolerance ({criterion.limit:g} sigma{'' if single else f', {file.name}'})"
            angles = criterion.limit * sigmas.one_sigma_rad
            text = f"the largest is {sigma_text(criterion.value)}"
            yield _line(name, file.comparison.t_ns, angles, text)


def _line(
    name: str, t_ns: NDArray[np.int64], angles: NDArray[np.float64], text: str
) -> PlottedFile:
    accumulated = Accumulator(ERROR)
    accumulated.add(t_ns, np.degrees(angles)[None])
    median = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0
    group = Group(ERROR, accumulated.reduced(), GAP_FACTOR * median or None)
    return PlottedFile(name, (group,), text)


def _marked(drawn: Picture, files: Sequence[ComparedFile]) -> Picture:
    """Draw the tolerance; for a single series also the first sample above it, and the worst."""
    (panel,) = drawn.panels
    comparison = files[0].comparison
    tolerance, first = comparison.tolerance_rad, comparison.first_exceeding
    worst = comparison.worst
    level = None
    if tolerance is not None:
        level = (math.degrees(tolerance), f"tolerance {degrees_text(tolerance, DIGITS)}")
    marks: tuple[Mark, ...] = ()
    if len(files) == 1:
        start_ns, above = drawn.starts[0], "first above the tolerance"
        text = f"worst: {degrees_text(worst.error_rad, DIGITS)}"
        if first == worst:
            text = f"{above}, and {text}"
        marks = (_mark(worst, start_ns, "worst", text),)
        if first is not None and first != worst:
            marks = (_mark(first, start_ns, "first", above), *marks)
    return replace(drawn, panels=(replace(panel, level=level, marks=marks),))


def _mark(sample: ComparedSample, start_ns: int, sign: str, text: str) -> Mark:
    seconds = (sample.t_ns - start_ns) * 1e-9
    return Mark(seconds, math.degrees(sample.error_rad), f"{text} at {seconds:.6g} s", sign)


def _sizes(comparison: Comparison) -> str:
    largest, rms = comparison.error_rad.max, comparison.error_rad.rms
    return f"max {degrees_text(largest, DIGITS)}, RMS {degrees_text(rms, DIGITS)}"


def _matched(comparison: Comparison) -> str:
    return f"{len(comparison.t_ns):,} {MATCHES[comparison.association.match]}"


def _offset(comparison: Comparison) -> str:
    """Return how far the reference was shifted in time, if it was."""
    offset_ns = comparison.time_offset.added_to_b_ns
    return f", reference {duration_text(offset_ns)} later" if offset_ns else ""


def _verdict(file: ComparedFile) -> str:
    comparison, text = file.comparison, f"{file.name}: {_sizes(file.comparison)}"
    if comparison.tolerance_rad is None:
        return text
    relation = "within" if comparison.first_exceeding is None else "above"
    return f"{text}; {relation} the tolerance of {degrees_text(comparison.tolerance_rad, DIGITS)}"


def _warnings(
    files: Sequence[ComparedFile], reference: ReadAttitudes, spell: Spell
) -> Iterator[str]:
    for name, operand, comparison in files:
        named = partial(with_names, a=name, b="the reference")
        if first := comparison.first_exceeding:
            yield (
                f"{name} is above the tolerance, first at sample {first.index} of "
                f"{named(first.at)}, "
                f"{first.t_ns} ns: {degrees_text(first.error_rad, DIGITS)}"
            )
        for criterion in comparison.criteria:
            if not criterion.passed and (criterion.setting, criterion.unit) != ("tol", "rad"):
                yield f"{name}: {named(criterion_text(criterion, comparison))}"
        if cause := comparison.likely_cause:
            for each in filter(None, (cause, cause.also)):
                yield f"{name}: likely cause ({each.name}): {named(spell(each.advice))}"
        yield from (f"{name}: {named(spell(remark))}" for remark in comparison.remarks)
        yield from _operand_warnings(operand, spell)
    yield from _operand_warnings(reference, spell)


def _operand_warnings(operand: ReadAttitudes, spell: Spell) -> Iterator[str]:
    path = operand.input.path
    yield from (f"{path}: {spell(remark)}" for remark in operand.signal.remarks)
    if operand.counts.invalid:
        yield f"{path}: {operand.counts.invalid} invalid quaternions were left out"
    yield from (f"{path}: {line}" for line in loss_lines(operand.losses))
