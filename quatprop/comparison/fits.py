"""What is left of the errors of two series when some mistakes are undone."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.alignment import Alignment, align, find_mounting, kabsch
from quatprop.comparison.association import associate
from quatprop.comparison.clock_mistakes import clocks
from quatprop.comparison.clocks import coarse_offset
from quatprop.comparison.plans import (
    CLOCKS,
    NOTHING,
    PRICE,
    PRICES,
    READINGS,
    Explanation,
    Undoings,
)
from quatprop.comparison.rate_mistakes import rate_mistake
from quatprop.comparison.undoing import Sides, Undoing, frames
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
"""Pairs in which explanations are compared, at least; what is claimed is measured in all."""

MAX_TURN = 0.1
"""Rotation, rad, from one of these pairs to the next: rates are changed as if it were small."""

WINDOWS = 40
"""Windows, about, that follow one another where readings are compared by rotations over them."""

MIN_SAMPLES = 100
"""Fewer samples show no clock."""


class Fits:
    """What plans leave of the errors of two series; each is tried once.

    `added_ns`: what was added to B's timestamps already, ns
    `known`: mistakes that are undone first
    """

    def __init__(
        self,
        sides: Sides,
        settings: ComparisonSettings,
        added_ns: int,
        known: Sequence[Undoing] = (),
    ) -> None:
        self._settings, self._added_ns, self._known = settings, added_ns, known
        self._align = settings.align
        for undoing in known:
            sides, self._align = undoing.apply(sides), undoing.align or self._align
        self._whole = sides
        same = np.isin(sides.a.t_ns, sides.b.t_ns)
        self._same_stamps = 2 * int(same.sum()) > len(same)
        self._sides = Sides(*common_beginning(*sides))
        pairs = associate(*self._sides, settings)
        self._full = Sides(*(AttitudeSeries(pairs.t_ns, q) for q in (pairs.a, pairs.b)))
        turn = max(
            float(np.percentile(geodesic_angle(q[1:], q[:-1]), 99)) for q in (pairs.a, pairs.b)
        )
        stride = int(max(1, min(len(pairs) / SEARCHED, MAX_TURN / max(turn, 1e-9))))
        self._few = Sides(*(each[::stride] for each in self._full))
        self._pairs: dict[tuple[str, str, bool, bool], Sides] = {}
        self._mounts: dict[tuple[str, str], Float64 | None] = {}
        self._clocks: dict[tuple[str, bool], tuple[Undoing | None, Undoing | None]] = {}
        self._fits: dict[Undoings, Explanation] = {}
        self._readings: dict[str, Undoing] = {}
        self._rules: Undoing | None = None
        self._is_read = any(undoing.name in READINGS for undoing in known)
        self._floor, self.is_open, self.best = 0.0, False, NOTHING
        self.others: list[str] = []
        above = {"mean": ("mount",), "mount": ()}.get(self._align, ("mean", "mount"))
        self._frames = ("", *above)

    def judged(self, undone: Iterable[Undoing]) -> float:
        """Return the RMS error that is left in the whole series, rad."""
        sides, name = self._whole, self._align
        for undoing in undone:
            sides, name = undoing.apply(sides), undoing.align or name
        with suppress(ComparisonError):
            pairs = associate(*sides, self._settings)
            return rms_between(pairs.a, align(name, pairs.a, pairs.b).apply(pairs.b))
        return math.inf

    def _read(self, plan: Undoings) -> Sides:
        """Return pairs with a reading and a clock, as series of the same stamps."""
        is_full = plan.rates == "method"
        key = plan.reading, plan.clock, bool(plan.clock) and self._is_turned(plan), is_full
        if key not in self._pairs:
            sides = self._full if is_full else self._few
            if plan.clock:
                sides = Sides(sides.a, self._sides.b)
            for undoing in self._undone(plan):
                sides = undoing.apply(sides)
            if plan.clock:
                sides = paired(sides, self._settings)
            self._pairs[key] = sides
        return self._pairs[key]

    def _over_windows(self, reading: str) -> float:
        """Return what a reading leaves of rotations over windows, rad, RMS.

        Whatever the frames, the biases, and the mounting are.
        """
        sides = self._read(Undoings(reading))
        length = max(len(sides.a) // WINDOWS, 1)
        y, x = (
            centred(total[length:] - total[:-length])
            for total in (np.cumsum(rotation_vectors_between(q.wxyz), axis=0) for q in sides)
        )
        return rms(y - x @ kabsch(x, y)[0].T) + self._floor

    def _undone(self, plan: Undoings) -> Iterator[Undoing]:
        """Yield a reading and a clock."""
        if plan.reading:
            yield self._readings[plan.reading]
        if plan.clock:
            key = plan.reading, self._is_turned(plan)
            if key not in self._clocks:
                self._clocks[key] = self._clocks_of(*key)
            undoing = self._clocks[key][CLOCKS.index(plan.clock)]
            if undoing is None:
                raise ComparisonError("the motion shows no offset")
            yield undoing

    def _is_turned(self, plan: Undoings) -> bool:
        return "mount" in {plan.frames, self._align}

    def _clocks_of(self, reading: str, turned: bool) -> tuple[Undoing | None, Undoing | None]:
        sides = self._readings[reading].apply(self._sides) if reading else self._sides
        if min(map(len, sides)) < MIN_SAMPLES:
            return None, None
        coarse_ns = 0
        with suppress(ComparisonError):
            coarse_ns, _ = coarse_offset(*sides)
        begin_ns = int(self._whole.b.t_ns[0])
        offset, change = clocks(sides, begin_ns, coarse_ns, self._added_ns, turned=turned)
        return None if self._settings.time_offset == "auto" else offset, change

    def _fit(self, plan: Undoings) -> Explanation:
        if plan not in self._fits:
            self._fits[plan] = NOTHING
            with suppress(ComparisonError):
                self._fits[plan] = self._fitted(plan)
        return self._fits[plan]

    def _fitted(self, plan: Undoings) -> Explanation:
        sides = self._read(plan)
        undone = [*self._undone(plan)]
        alignment, left = self._aligned(plan, sides)
        for kind in plan.rates.split(" and "):
            if not kind:
                continue
            turned = [each.mount for each in (*self._known, *undone) if each.mount is not None]
            undoing = (
                self._rules
                if kind == "method"
                else rate_mistake(kind, sides, alignment, turned[0] if turned else None)
            )
            if undoing is None:
                return NOTHING
            undone.append(undoing)
            sides = undoing.apply(sides)
            alignment, left = self._aligned(plan, sides)
        if plan.frames:
            undone.append(frames(self._aligned(Undoings(), sides)[0], alignment))
        price = math.prod(PRICES.get(undoing.name, PRICE) for undoing in undone)
        if plan.frames == "mount" and self._align != "mean":
            price *= PRICES["reference frame"]  # it rotates both
        return Explanation(tuple(undone), left, (left + self._floor) / price)

    def _aligned(self, plan: Undoings, sides: Sides) -> tuple[Alignment, float]:
        some = slice(None, None, max(len(sides.a) // SEARCHED, 1))
        a, b = (series.wxyz[some] for series in sides)
        name = plan.frames or self._align
        if name == "mount":
            # Rotations between samples show it, and hardly what goes wrong slowly.
            key = plan.reading, plan.clock
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
    """Return both series at the stamps at which they are compared."""
    pairs = associate(*sides, settings)
    return Sides(*(AttitudeSeries(pairs.t_ns, wxyz) for wxyz in (pairs.a, pairs.b)))


def rms_between(a: Float64, b: Float64) -> float:
    """Return the RMS angle between attitudes, rad."""
    return rms(geodesic_angle(a, b))
