"""The picture of a cross-check: a matrix of sources, and the pair that differs most, repaired."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.relation import predicted
from quatprop.tools.crosscheck.pair import DEG
from quatprop.tools.crosscheck.pairs import most_active_part
from quatprop.tools.crosscheck.result import COMPARED
from quatprop.tools.plot.figure import MAX_NOTES
from quatprop.tools.plot.picture import Accumulator, Matrix, Page, PlottedFile, Quantity, picture

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.estimation.relation import Relation
    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.analysis import Analysis
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.result import CrossCheck

EXCERPT: Final = 20.0
"""Length of the part of a log that is drawn, s."""


def page_of(analysis: Analysis, logs: Sequence[str]) -> Page | None:
    """Return the picture of a cross-check of logs; None if no sources were compared."""
    result = analysis.result
    compared = [pair for pair in result.pairs if pair.fit is not None and pair.status in COMPARED]
    if not compared:
        return None
    worst = max(compared, key=lambda pair: _shares(pair)[0])
    halves = "below the diagonal as recorded, above it repaired; grey: not compared"
    facts = (
        f"differences of rates in % of the motion: {halves}",
        "panels: the two that differ most as recorded, one fitted to the other",
    )
    notes = [f"{one.level}, {one.source}: {one.text}" for one in result.findings]
    if len(notes) > MAX_NOTES:
        notes[MAX_NOTES - 1 :] = [f"and {len(notes) - MAX_NOTES + 1} more findings"]
    drawn = picture([*_overlaid(analysis, worst)])
    return Page(
        title=f"{result.headline}: {', '.join(logs)}",
        facts=facts,
        lead=facts,
        picture=drawn._replace(matrix=_matrix(result, compared)),
        warnings=tuple(notes),
        tables=(),
    )


def _shares(pair: Pair) -> tuple[float, float]:
    """Return the differences as recorded and once repaired, as shares of the motion."""
    fit = pair.stated or pair.fit
    if fit is None:
        return math.nan, math.nan
    return pair.before / max(fit.motion, 1e-9), fit.noise / max(fit.motion, 1e-9)


def _matrix(result: CrossCheck, compared: Sequence[Pair]) -> Matrix:
    names = [one.name for one in result.sources]
    shares = np.full((len(names), len(names)), np.nan)
    for pair in compared:
        first, second = sorted(names.index(name) for name in pair.names)
        shares[second, first], shares[first, second] = _shares(pair)
    faulty = {one.source for one in result.findings if one.level == "fault"}
    alarming = [bool(faulty & {one.name, one.device}) for one in result.sources]
    return Matrix(tuple(names), shares, tuple(alarming))


def _overlaid(analysis: Analysis, pair: Pair) -> Iterator[PlottedFile]:
    """Yield the rates of both sources of a pair, those of A as B has them, for a picture."""
    fit = pair.stated or pair.fit
    a, b = (analysis.turning[name] for name in pair.names)
    if fit is None:
        return
    begin = _excerpt(a, b, fit, pair)
    own, other = b.mean_rate(fit.axes_b, begin, fit.length), predicted(a, b, fit, begin)
    middle_ns = np.rint((begin + fit.length / 2) * NS_PER_S).astype(np.int64)
    t_ns = analysis.zeros_ns[pair.b.name] + middle_ns
    for name, values in ((pair.b.name, own), (f"{pair.a.name}, fitted", other)):
        quantities = [Quantity(f"rate {axis}", "deg/s", axis) for axis in "xyz"]
        shown = np.flatnonzero(fit.shown)
        drawn = Accumulator(tuple(quantities[k] for k in shown))
        drawn.add(t_ns, values.T[shown] / DEG)
        yield PlottedFile(name, (drawn.group(None),))


def _excerpt(a: Turning, b: Turning, fit: Relation, pair: Pair) -> Float64:
    """Return the beginnings of windows where both turn most, or about a change, s."""
    first = max(b.seconds[0], a.seconds[0] - fit.offset)
    last = min(b.seconds[-1], a.seconds[-1] - fit.offset) - fit.length
    moved = a._replace(seconds=a.seconds - fit.offset)
    begin = pair.change.at - EXCERPT / 2 if pair.change else most_active_part(moved, b, EXCERPT)[0]
    begin = max(first, min(begin, last - EXCERPT))
    return np.arange(begin, min(begin + EXCERPT, last), max(a.interval, b.interval))
