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
from quatprop.comparison.explanations import ENOUGH, Search
from quatprop.comparison.undoing import Sides, Undoing
from quatprop.rendering import degrees_text
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.series import AttitudeSeries

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""

LITTLE = 0.1
"""An RMS error below this share of the limit on the worst error needs no second cause."""

MAX_CLAIMS = 3
"""Causes at most, each of what is left after those before it."""

AXES, RATES = {"axes", "rate sign", "side"}, {"rate bias", "scale"}
"""Mistakes in the axes of rates, and in the rates about these axes."""

FRAMES = {"reference frame", "body frame"}
"""Mistakes that hide all others, however much of the error is theirs."""

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
    `added_ns`: what was added to B's timestamps, ns
    """
    if len(error) < MIN_PAIRS or rms(error) <= NO_ERROR:
        return None
    if outliers := isolated_samples(error):
        return outliers
    limit = settings.tol if isinstance(settings.tol, float) else 0.0
    part_ns = None
    if len(associate(a, b, settings)) < len(error):
        part_ns = int(min(a.t_ns[-1], b.t_ns[-1]) - max(a.t_ns[0], b.t_ns[0]))
    cause = None
    for claim in reversed([*_claims(Sides(a, b), settings, added_ns, LITTLE * limit)]):
        cause = claim._replace(also=cause, part_ns=part_ns)
    return cause


def _claims(
    sides: Sides, settings: ComparisonSettings, added_ns: int, enough: float
) -> Iterator[Cause]:
    """Yield causes, each of which explains most of what those before it leave.

    `enough`: RMS error, rad, that needs no other cause
    """
    known: tuple[Undoing, ...] = ()
    for _ in range(MAX_CLAIMS):
        search = Search(sides, settings, added_ns, known)
        before = search.judged(())
        if not NO_ERROR < before < math.inf:
            return
        search.run(before)
        undone, after = _fewest(search, before)
        names = {each.name for each in undone}
        if not undone or names & {each.name for each in known}:
            return
        yield _described(undone, search.others, before, after)
        if not names <= FRAMES:
            enough = max(enough, ENOUGH * before)
        is_all = len(undone) == len(search.best.undone) and not search.is_open
        # A rule leaves the rates at one end open, which looks like a frame.
        if is_all or "method" in names or after <= enough:
            return
        known += undone


def _fewest(search: Search, before: float) -> tuple[tuple[Undoing, ...], float]:
    """Return the fewest mistakes of the best explanation that take most of an error away.

    What is wrong with rates is not undone before what is wrong with their axes.
    """
    best = search.best.undone
    axes = [each for each in best if each.name in AXES]
    for size in range(1, len(best) + 1):
        tried = {
            search.judged(some): some
            for some in combinations(best, size)
            if not {each.name for each in some} & RATES or all(each in some for each in axes)
        }
        if tried and min(tried) <= MOST * before:
            return tried[min(tried)], min(tried)
    return (), before


def _described(
    undone: tuple[Undoing, ...], others: list[str], before: float, after: float
) -> Cause:
    sentence = "; also, ".join(undoing.sentence for undoing in undone)
    if others:
        sentence += f"; this motion does not distinguish it from {' or '.join(others)}"
    from_to = " to ".join(degrees_text(error, 4) for error in (before, after))
    sentence += f"; undoing it reduces the RMS error from {from_to}"
    remedy = "; and also, ".join(undoing.remedy for undoing in undone)
    name = " and ".join(undoing.name for undoing in undone)
    return Cause(name, sentence, before, after, remedy)
