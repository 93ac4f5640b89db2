"""The error between attitude series in time: tolerance, first sample above it, worst sample."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.comparison.statistics import FIGURES
from quatprop.plot.accumulators import ERROR, Sketch
from quatprop.plot.names import lost_text, names_of
from quatprop.plot.page import Page, Table
from quatprop.plot.picture import Group, Mark, Part, instant_text, picture
from quatprop.plot.target import MADE_BY, PictureFile
from quatprop.text import plain
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.comparison import Comparison, Place
    from quatprop.plot.picture import Picture
    from quatprop.signals.attitude_input import LoadedAttitudes

MATCHES = {
    "exact": "pairs of equal stamps",
    "nearest": "pairs nearest in time",
    "interpolate": "pairs, interpolated in time",
}
"""How pairs were found -> what they are."""


class Compared(NamedTuple):
    """A series and its error against another.

    Parameters
    ----------
    name
        What the series is called.
    operand
        Where it is from.
    found
        Its error.
    """

    name: str
    operand: LoadedAttitudes
    found: Comparison


class ErrorPicture(PictureFile):
    """The error between two series on its way to a file; see :class:`PictureFile`."""

    def draw(self, a: LoadedAttitudes, b: LoadedAttitudes, found: Comparison) -> None:
        """Draw what a comparison of A with B has found, and put it in its place."""
        name, against = names_of([a.input.path, b.input.path])
        if name == against:
            # Two topics of one log.
            name, against = (f"{name} {plain(side.signal.name)}" for side in (a, b))
        self.commit(error_page([Compared(name, a, found)], against, b))


def error_page(every: Sequence[Compared], against: str, reference: LoadedAttitudes) -> Page:
    """Return the report on the errors of series against one reference.

    Parameters
    ----------
    every
        At least one.
    against
        What the reference is called.
    reference
        Where it is from.
    """
    several = len(every) > 1
    names = ", ".join(one.name for one in every)
    title = f"error of {names} against {against}"
    first = every[0].found
    facts = (
        f"geodesic angle, alignment {first.alignment.name}{_clock(first)}, {_matched(first)}",
        "" if several else _figures_text(first),
    )
    warnings = tuple(_warnings(every, reference))
    parts = [_part(one) for one in every]
    drawn = picture(parts, title=title, facts=facts, notes=warnings[:2])
    return Page(
        heading=title,
        lead=tuple(_verdict(one) for one in every),
        picture=_marked(drawn, every),
        warnings=warnings,
        tables=tuple(Table(f"{one.name} against {against}", tuple(_rows(one))) for one in every),
        made_by=MADE_BY,
    )


def _part(one: Compared) -> Part:
    t_ns, sketch = one.found.pairs.t_ns, Sketch(ERROR)
    sketch.add(t_ns, np.degrees(one.found.error)[None])
    median = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0
    group = Group(ERROR, sketch.reduced(), GAP_FACTOR * median or None)
    return Part(one.name, (group,), _figures_text(one.found))


def _marked(drawn: Picture, every: Sequence[Compared]) -> Picture:
    """Draw the tolerance; of an only series also where it is first above it, and worst."""
    (row,) = drawn.rows
    tolerance = every[0].found.tolerance
    level = None
    if tolerance is not None:
        level = (math.degrees(tolerance), f"tolerance {_degrees(tolerance)}")
    marks: tuple[Mark, ...] = ()
    if len(every) == 1:
        found, start_ns = every[0].found, drawn.starts[0]
        first = "first above the tolerance"
        words = f"worst: {_degrees(found.worst.error_rad)}"
        if found.exceeded == found.worst:
            words = f"{first}, and {words}"
        marks = (_mark(found.worst, start_ns, "worst", words),)
        if found.exceeded not in (None, found.worst):
            marks = (_mark(found.exceeded, start_ns, "first", first), *marks)
    return replace(drawn, rows=(replace(row, level=level, marks=marks),))


def _mark(place: Place, start_ns: int, sign: str, words: str) -> Mark:
    seconds = (place.t_ns - start_ns) * 1e-9
    return Mark(seconds, math.degrees(place.error_rad), f"{words} at {seconds:.6g} s", sign)


def _figures_text(found: Comparison) -> str:
    return f"max {_degrees(found.figures.max)}, RMS {_degrees(found.figures.rms)}"


def _matched(found: Comparison) -> str:
    return f"{len(found.pairs):,} {MATCHES[found.pairs.match]}"


def _clock(found: Comparison) -> str:
    """Return how far the reference was moved in time, if it was."""
    return f", reference {duration_text(found.offset_ns)} later" if found.offset_ns else ""


def _degrees(angle: float) -> str:
    return f"{math.degrees(angle):.4g} deg"


def _verdict(one: Compared) -> str:
    found, said = one.found, f"{one.name}: {_figures_text(one.found)}"
    if found.tolerance is None:
        return said
    judged = "within" if found.passed else "above"
    return f"{said}; {judged} the tolerance of {_degrees(found.tolerance)}"


def _warnings(every: Sequence[Compared], reference: LoadedAttitudes) -> Iterator[str]:
    for one in every:
        found = one.found
        if found.exceeded is not None:
            yield f"{one.name} is above the tolerance, first {_place(found.exceeded)}"
        if found.cause is not None:
            yield f"{one.name}: likely cause ({found.cause.name}): {found.cause.sentence}"
        yield from (f"{one.name}: {remark}" for remark in found.remarks)
        yield from _of_operand(one.operand)
    yield from _of_operand(reference)


def _of_operand(operand: LoadedAttitudes) -> Iterator[str]:
    path = operand.input.path
    yield from (f"{path}: {remark}" for remark in operand.signal.remarks)
    if operand.counts.invalid:
        yield f"{path}: {operand.counts.invalid} rows are invalid quaternions and were left out"
    yield from (f"{path}: {words}" for words in lost_text(operand.losses))


def _place(place: Place) -> str:
    return f"at sample {place.index} of {place.at}, {place.t_ns} ns: {_degrees(place.error_rad)}"


def _rows(one: Compared) -> Iterator[tuple[str, str]]:
    found, report = one.found, one.found.report()
    yield "file", _operand_text(one.operand)
    yield "matched", f"{_matched(found)}, of {found.pairs.candidates:,} samples"
    yield "time", f"{instant_text(int(found.pairs.t_ns[0]))}, {duration_text(_span(found))}"
    yield "time offset", f"{duration_text(found.offset_ns)} added to the stamps of the other"
    yield "alignment", _alignment(report["alignment"])
    for key, name in FIGURES.items():
        angle = report["error_rad"][key]
        yield name, f"{math.degrees(angle):.6g} deg ({angle:.6g} rad)"
    if found.drift_deg_h is not None:
        yield "drift", f"{found.drift_deg_h:+.6g} deg/h"
    yield "worst", _place(found.worst)
    if found.tolerance is not None:
        yield "tolerance", f"{_degrees(found.tolerance)}: {'kept' if found.passed else 'not kept'}"
    if found.exceeded is not None:
        yield "first above it", _place(found.exceeded)


def _span(found: Comparison) -> int:
    return int(found.pairs.t_ns[-1] - found.pairs.t_ns[0])


def _alignment(alignment: dict[str, Any]) -> str:
    said = f"{alignment['name']}: reference frame turned by {_degrees(alignment['reference_rad'])}"
    if alignment["mounting"]:
        said += f", body frame by {_degrees(alignment['mount_rad'])}"
    return said


def _operand_text(operand: LoadedAttitudes) -> str:
    source = operand.signal
    named = " ".join(text for text in (source.name, source.type_name) if text)
    meant = f"{source.meaning.convention} {source.meaning.direction}"
    return f"{operand.input.path} ({operand.kind}): {named}; {meant}, {source.layout}"
