"""The likely causes of an error.

Every cause was tested: undoing it removes most of the error of the series that are compared. Of the
best hypothesis, the smallest subset of mistakes that does so is reported.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import TYPE_CHECKING

from quatprop.comparison.association import associate
from quatprop.comparison.cause import NO_ERROR, Cause, isolated_samples
from quatprop.comparison.mistakes import Mistake, Sides
from quatprop.comparison.search import ENOUGH, Search
from quatprop.rendering import degrees_text
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.series import AttitudeSeries

MIN_PAIRS = 10
"""Minimum number of pairs; fewer can be explained by almost anything."""

LITTLE = 0.1
"""RMS error, as a share of the limit on the largest error, that needs no further cause."""

MAX_CLAIMS = 3
"""Maximum number of causes, each of the residual of those before it."""

FRAMES = {"reference frame", "body frame"}
"""Mistakes that may hide all others, whatever their share of the error."""

MAX_SHARE = 0.5
"""Maximum residual of a cause, as a share of the error."""


def likely_cause(
    a: AttitudeSeries,
    b: AttitudeSeries,
    settings: ComparisonSettings,
    error: Float64,
    added_ns: int = 0,
) -> Cause | None:
    """Return the likely cause of an error, or None.

    `error`: the errors, rad, shape ``(N,)``, in rising order
    `added_ns`: time added to B's timestamps, ns
    """
    if rms(error) <= NO_ERROR:
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
    """Yield causes, each of which explains most of the residual of those before it.

    `enough`: RMS error, rad, that needs no further cause
    """
    accepted: tuple[Mistake, ...] = ()
    for _ in range(MAX_CLAIMS):
        search = Search(sides, settings, added_ns, accepted)
        before = search.residual(())
        if not NO_ERROR < before < math.inf:
            return
        search.run(before)
        mistakes, after = _fewest(search, before)
        names = {each.name for each in mistakes}
        if not mistakes or names & {each.name for each in accepted}:
            return
        yield _described(mistakes, search.others, before, after)
        if not names <= FRAMES:
            enough = max(enough, ENOUGH * before)
        is_all = len(mistakes) == len(search.best.mistakes) and not search.is_partial
        # A rule does not determine the rate at one end; its error would look like that of a frame.
        if is_all or "method" in names or after <= enough:
            return
        accepted += mistakes


def _fewest(search: Search, before: float) -> tuple[tuple[Mistake, ...], float]:
    """Return the smallest subset of the best hypothesis that removes most of an error."""
    best = search.best.mistakes
    for size in range(1, len(best) + 1):
        tried = {search.residual(some): some for some in combinations(best, size)}
        if min(tried) <= MAX_SHARE * before:
            return tried[min(tried)], min(tried)
    return (), before


def _described(
    mistakes: tuple[Mistake, ...], others: list[str], before: float, after: float
) -> Cause:
    sentence = "; also, ".join(mistake.sentence for mistake in mistakes)
    if others:
        sentence += f"; this motion does not distinguish it from {' or '.join(others)}"
    if after <= NO_ERROR:
        sentence += f"; undoing it removes the RMS error of {degrees_text(before, 4)}"
    else:
        from_to = " to ".join(degrees_text(error, 4) for error in (before, after))
        sentence += f"; undoing it reduces the RMS error from {from_to}"
    remedy = "; and also, ".join(mistake.remedy for mistake in mistakes)
    name = " and ".join(mistake.name for mistake in mistakes)
    return Cause(name, sentence, before, after, remedy)
