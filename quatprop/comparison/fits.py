"""Fit hypotheses to the error between two series: the residual when the mistakes are undone."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.alignment import (
    Alignment,
    align,
    aligned_rms,
    find_mounting,
    kabsch,
    rms_between,
)
from quatprop.comparison.association import associate, is_mostly_exact
from quatprop.comparison.clock_mistakes import clock_mistakes
from quatprop.comparison.clocks import coarse_offset
from quatprop.comparison.hypotheses import (
    CLOCKS,
    NO_FIT,
    PENALTIES,
    PENALTY,
    READINGS,
    Fit,
    Hypothesis,
)
from quatprop.comparison.mistakes import Mistake, Sides, frame_mistake
from quatprop.comparison.rate_mistakes import rate_mistake
from quatprop.comparison.windows import centred, common_beginning
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import geodesic_angle, multiply
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.series import AttitudeSeries
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.comparison.settings import ComparisonSettings

SEARCHED = 500
"""Minimum number of pairs in the search; causes that are reported are verified on all pairs."""

MAX_TURN = 0.1
"""Maximum rotation between these pairs, rad: changes of rates assume small rotations."""

WINDOWS = 40
"""Approximate number of consecutive windows over which readings are compared."""

MIN_SAMPLES = 100
"""Minimum number of samples from which a clock error is estimated."""


class Fits:
    """Fits of hypotheses to the error between two series; each is evaluated once.

    `added_ns`: time already added to B's timestamps, ns
    `accepted`: mistakes that are undone first
    """

    def __init__(
        self,
        sides: Sides,
        settings: ComparisonSettings,
        added_ns: int,
        accepted: Sequence[Mistake] = (),
    ) -> None:
        self._settings, self._added_ns, self._accepted = settings, added_ns, accepted
        self._align = settings.align
        for mistake in accepted:
            sides, self._align = mistake.undo(sides), mistake.align or self._align
        self._whole = sides
        same = np.isin(sides.a.t_ns, sides.b.t_ns)
        self._same_stamps = is_mostly_exact(int(same.sum()), len(same))
        self._sides = Sides(*common_beginning(*sides))
        pairs = associate(*self._sides, settings)
        self._all_pairs = Sides(*(AttitudeSeries(pairs.t_ns, q) for q in (pairs.a, pairs.b)))
        turn = max(
            float(np.percentile(geodesic_angle(q[1:], q[:-1]), 99)) for q in (pairs.a, pairs.b)
        )
        stride = int(max(1, min(len(pairs) / SEARCHED, MAX_TURN / max(turn, 1e-9))))
        self._subset = Sides(*(each[::stride] for each in self._all_pairs))
        self._pairs: dict[tuple[str, str, bool, bool], Sides] = {}
        self._mounts: dict[tuple[str, str], Float64 | None] = {}
        self._clocks: dict[tuple[str, bool], tuple[Mistake | None, Mistake | None]] = {}
        self._fits: dict[Hypothesis, Fit] = {}
        self._readings: dict[str, Mistake] = {}
        self._rule: Mistake | None = None
        self._has_reading = any(mistake.name in READINGS for mistake in accepted)
        self._floor, self.is_partial, self.best = 0.0, False, NO_FIT
        self.others: list[str] = []
        above = {"mean": ("mount",), "mount": ()}.get(self._align, ("mean", "mount"))
        self._frames = ("", *above)

    def residual(self, mistakes: Iterable[Mistake]) -> float:
        """Return the RMS error of the whole series with mistakes undone, rad."""
        sides, name = self._whole, self._align
        for mistake in mistakes:
            sides, name = mistake.undo(sides), mistake.align or name
        with suppress(ComparisonError):
            pairs = associate(*sides, self._settings)
            return aligned_rms(name, pairs.a, pairs.b)
        return math.inf

    def _pairs_of(self, hypothesis: Hypothesis) -> Sides:
        """Return pairs with the reading and the clock undone, as series with equal timestamps."""
        use_all = hypothesis.rates == "method"
        is_turned = bool(hypothesis.clock) and self._is_turned(hypothesis)
        key = hypothesis.reading, hypothesis.clock, is_turned, use_all
        if key not in self._pairs:
            sides = self._all_pairs if use_all else self._subset
            if hypothesis.clock:
                sides = Sides(sides.a, self._sides.b)
            for mistake in self._reading_and_clock(hypothesis):
                sides = mistake.undo(sides)
            if hypothesis.clock:
                sides = paired(sides, self._settings)
            self._pairs[key] = sides
        return self._pairs[key]

    def _window_residual(self, reading: str) -> float:
        """Return the RMS residual of rotations over windows with a reading undone, rad.

        It is independent of the reference frames, constant biases and the mounting.
        """
        sides = self._pairs_of(Hypothesis(reading))
        length = max(len(sides.a) // WINDOWS, 1)
        y, x = (
            centred(total[length:] - total[:-length])
            for total in (np.cumsum(rotation_vectors_between(q.wxyz), axis=0) for q in sides)
        )
        return rms(y - x @ kabsch(x, y)[0].T) + self._floor

    def _reading_and_clock(self, hypothesis: Hypothesis) -> Iterator[Mistake]:
        """Yield the mistakes in reading and of a clock."""
        if hypothesis.reading:
            yield self._readings[hypothesis.reading]
        if hypothesis.clock:
            key = hypothesis.reading, self._is_turned(hypothesis)
            if key not in self._clocks:
                self._clocks[key] = self._clocks_of(*key)
            mistake = self._clocks[key][CLOCKS.index(hypothesis.clock)]
            if mistake is None:
                raise ComparisonError("the motion shows no offset")
            yield mistake

    def _is_turned(self, hypothesis: Hypothesis) -> bool:
        return "mount" in {hypothesis.frames, self._align}

    def _clocks_of(self, reading: str, turned: bool) -> tuple[Mistake | None, Mistake | None]:
        sides = self._readings[reading].undo(self._sides) if reading else self._sides
        if min(map(len, sides)) < MIN_SAMPLES:
            return None, None
        coarse_ns = 0
        with suppress(ComparisonError):
            coarse_ns, _ = coarse_offset(*sides)
        begin_ns = int(self._whole.b.t_ns[0])
        offset, change = clock_mistakes(sides, begin_ns, coarse_ns, self._added_ns, turned=turned)
        return None if self._settings.time_offset == "auto" else offset, change

    def _fit(self, hypothesis: Hypothesis) -> Fit:
        if hypothesis not in self._fits:
            self._fits[hypothesis] = NO_FIT
            with suppress(ComparisonError):
                self._fits[hypothesis] = self._evaluated(hypothesis)
        return self._fits[hypothesis]

    def _evaluated(self, hypothesis: Hypothesis) -> Fit:
        sides = self._pairs_of(hypothesis)
        mistakes = [*self._reading_and_clock(hypothesis)]
        alignment, residual = self._aligned(hypothesis, sides)
        for kind in hypothesis.rates.split(" and "):
            if not kind:
                continue
            turned = [each.mount for each in (*self._accepted, *mistakes) if each.mount is not None]
            mistake = (
                self._rule
                if kind == "method"
                else rate_mistake(kind, sides, alignment, turned[0] if turned else None)
            )
            if mistake is None:
                return NO_FIT
            mistakes.append(mistake)
            sides = mistake.undo(sides)
            alignment, residual = self._aligned(hypothesis, sides)
        if hypothesis.frames:
            mistakes.append(frame_mistake(self._aligned(Hypothesis(), sides)[0], alignment))
        penalty = math.prod(PENALTIES.get(mistake.name, PENALTY) for mistake in mistakes)
        if hypothesis.frames == "mount" and self._align != "mean":
            penalty *= PENALTIES["reference frame"]  # it rotates both
        return Fit(tuple(mistakes), residual, (residual + self._floor) / penalty)

    def _aligned(self, hypothesis: Hypothesis, sides: Sides) -> tuple[Alignment, float]:
        some = slice(None, None, max(len(sides.a) // SEARCHED, 1))
        a, b = (series.wxyz[some] for series in sides)
        name = hypothesis.frames or self._align
        if name == "mount":
            # Relative rotations show it, and slow errors hardly affect them: found once.
            key = hypothesis.reading, hypothesis.clock
            if key not in self._mounts:
                self._mounts[key] = None
                self._mounts[key], _ = find_mounting(a, b)
            mount = self._mounts[key]
            if mount is None:
                raise ComparisonError("the motion shows no mounting")
            turned = multiply(b, mount)
            alignment = Alignment(name, align("mean", a, turned).reference_wxyz, mount)
        else:
            alignment = align(name, a, b)
        return alignment, rms_between(a, alignment.apply(b))


def paired(sides: Sides, settings: ComparisonSettings) -> Sides:
    """Return both series at the timestamps at which they are compared."""
    pairs = associate(*sides, settings)
    return Sides(*(AttitudeSeries(pairs.t_ns, wxyz) for wxyz in (pairs.a, pairs.b)))
