"""The likely causes of an error.

What is claimed was tried: remedies, applied to the series as they are compared, take most of the
error away. Of the best explanation, the fewest mistakes are claimed that do so.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

from quatprop.comparison.association import associate
from quatprop.comparison.cause import NO_ERROR, Cause, isolated_samples
from quatprop.comparison.explanations import Search
from quatprop.comparison.undoing import Sides, Undoing
from quatprop.rendering import degrees_text
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.series import AttitudeSeries

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""

LITTLE = 0.1
"""An RMS error below this share of the limit on the worst error needs no second cause."""

MOST = 0.5
"""Share of an error that may remain without its cause."""


def likely_cause(
    a: AttitudeSeries,
    b: AttitudeSeries,
    settings: ComparisonSettings,
    error: Float64,
    added_ns: int = 0,
) -> Cause | None:
    """Return what explains an error, if something does.

    `error`: the errors, rad, shape ``(N,)``, in rising order
    `added_ns`: what was added to B's stamps, ns
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    if outliers := isolated_samples(error):
        return outliers
    sides = Sides(a, b)
    first = Search(sides, settings, added_ns)
    claim = _claim(first)
    if claim is None:
        return None
    cause, undone = claim
    # A rule leaves the rates at one end open, which looks like a frame.
    limit = settings.tol if isinstance(settings.tol, float) else 0.0
    is_whole = cause.name == "method" or cause.rms_after <= LITTLE * limit
    if not is_whole and (first.is_open or len(undone) < len(first.best.undone)):
        also = _claim(Search(sides, settings, added_ns, undone))
        if also and also[0].name != cause.name:
            cause = cause._replace(also=also[0])
    if len(associate(a, b, settings)) < len(error):
        part_ns = min(a.t_ns[-1], b.t_ns[-1]) - max(a.t_ns[0], b.t_ns[0])
        cause = cause._replace(part_ns=int(part_ns))
    return cause


def _claim(search: Search) -> tuple[Cause, tuple[Undoing, ...]] | None:
    """Return the fewest mistakes of the best explanation that take most of the error away."""
    before = search.judged(())
    if not NO_ERROR < before < math.inf:
        return None
    search.run()
    for size in range(1, len(search.best.undone) + 1):
        subsets = list(combinations(search.best.undone, size))
        left = [search.judged(undone) for undone in subsets]
        after = min(left)
        if after <= MOST * before:
            undone = subsets[left.index(after)]
            return _described(undone, search.others, before, after), undone
    return None


def _described(
    undone: tuple[Undoing, ...], others: list[str], before: float, after: float
) -> Cause:
    sentence = "; also, ".join(undoing.sentence for undoing in undone)
    if others:
        sentence += f"; this motion does not distinguish it from {' or '.join(others)}"
    from_to = " to ".join(degrees_text(error, 4) for error in (before, after))
    sentence += f"; undoing it takes the RMS error from {from_to}"
    remedy = "; and also, ".join(undoing.remedy for undoing in undone)
    return Cause(undone[0].name, sentence, before, after, remedy)
