"""The likely causes of an error: mistakes that are undone, and judged by what that takes away.

An explanation undoes at most one mistake of each kind: in reading, of a clock, in rates, in frames.
Every mistake has a price, the share of the error that may remain when it is undone beside the
others; the explanation that leaves least at its price is the best. Of that, the fewest mistakes are
claimed whose remedies take most of the error away, from the series as they are compared.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import combinations, permutations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align, mean_rotation
from quatprop.comparison.association import associate
from quatprop.comparison.cause import NO_ERROR, Cause, isolated_samples
from quatprop.comparison.clocks import coarse_offset
from quatprop.comparison.integration_rules import by_other_rule, integration_rules
from quatprop.comparison.undoings import (
    Sides,
    Undoing,
    axes,
    clocks,
    drift,
    frames,
    misreadings,
    rate_bias,
    scale,
)
from quatprop.comparison.windows import common_beginning
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, multiply
from quatprop.rendering import degrees_text
from quatprop.series import AttitudeSeries
from quatprop.series.blocks import rms
from quatprop.settings import METHODS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.settings import ComparisonSettings

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""

MOST = 0.5
"""Share of an error that may remain without its cause."""

PRICES = {
    "axes": 0.4,
    "scale": 0.3,
    "clock drift": 0.4,
    "reference frame": 0.35,
    "body frame": 0.35,
    "rate bias": 0.2,
    "drift": 0.2,
}
"""Mistake -> share of the error that may remain when it is undone; of others, MOST."""

NEGLIGIBLE = 1e-4
"""Share of the error below which explanations are equally good."""

ENOUGH = 0.02
"""Share of the error that may remain where no more mistakes are looked for at once."""

TIE = 1.05
"""Explanations within this factor of the best are as good: the first of them is taken."""

AS_GOOD = 1.3
"""Within this factor of the best, an explanation is not ruled out."""

PROMISING = 4.0
"""Within this factor of the best, a reading is tried with all alignments."""

SEARCHED = 1_000
"""Pairs in which explanations are compared, about; what is claimed is measured in all."""

SCREENED = 3_000
"""Samples from which the integration rule is told."""

CONTAINED = {
    ("axes", "body frame"),
    ("reference frame", "body frame"),
    ("body frame", "reference frame"),
    ("clock drift", "time offset"),
    ("time offset", "clock drift"),
}
"""Mistakes of which the second is no alternative to the first: it has as much, or is a part."""

ROUNDS = 2
TWICE = 2.0
RATES_NAMES={'rate bias','scale','drift','method'}

CLOCKS = ("time offset", "clock drift")
RATES = ("", "rate bias", "scale", "biased scale and rate bias", "drift in body", "drift in reference")


class Plan(NamedTuple):
    """Which mistakes are undone, by their keys; empty where none is of that kind."""

    reading: str = ""
    clock: str = ""
    rates: str = ""
    frames: str = ""


class Explanation(NamedTuple):
    """What is undone, and the RMS error that remains, rad, over its price."""

    undone: tuple[Undoing, ...]
    rms: float
    score: float


NOTHING = Explanation((), math.inf, math.inf)
"""What cannot be tried."""


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
    first = Diagnosis(sides, settings, added_ns)
    claim = _claim(first, "")
    if claim is None:
        return None
    cause, undone = claim
    if first.is_open or len(undone) < len(first.best.undone):
        also = _claim(Diagnosis(sides, settings, added_ns, undone), cause.name)
        cause = cause._replace(also=also and also[0])
    if len(associate(a, b, settings)) < len(error):
        ends = min(series.t_ns[-1] for series in sides), max(series.t_ns[0] for series in sides)
        cause = cause._replace(part_ns=int(ends[0] - ends[1]))
    return cause


def _claim(diagnosis: Diagnosis, known: str) -> tuple[Cause, tuple[Undoing, ...]] | None:
    """Return the fewest mistakes of the best explanation that take most of the error away."""
    before = diagnosis.judged(())
    if not NO_ERROR < before < math.inf:
        return None
    diagnosis.search()
    best, others = diagnosis.best, diagnosis.others
    for size in range(1, len(best.undone) + 1):
        subsets = combinations(best.undone, size)
        after, undone = min(
            ((diagnosis.judged(some), some) for some in subsets), key=lambda tried: tried[0]
        )
        if after > MOST * before:
            continue
        name = undone[0].name
        if name == known:
            return None
        sentence = "; also, ".join(undoing.sentence for undoing in undone)
        if others:
            sentence += f"; this motion does not distinguish it from {' or '.join(others)}"
        sentence += (
            f"; without it the RMS error goes from {degrees_text(before, 4)} to "
            f"{degrees_text(after, 4)}"
        )
        remedy = "; and also, ".join(undoing.remedy for undoing in undone)
        return Cause(name, sentence, before, after, remedy), undone
    return None


class Diagnosis:
    """The search for what explains the errors of two series.

    `undone`: mistakes that are known, and undone first
    """

    def __init__(
        self,
        sides: Sides,
        settings: ComparisonSettings,
        added_ns: int,
        undone: Sequence[Undoing] = (),
    ) -> None:
        self._settings = settings
        self._known = undone
        self._align = settings.align
        for undoing in undone:
            sides, self._align = undoing.apply(sides), undoing.align or self._align
        self._offset_given = added_ns
        self._whole = sides
        self._sides = Sides(*common_beginning(*sides))
        self._pairs: dict[tuple[str, str], Sides] = {}
        self._fits: dict[Plan, Explanation] = {}
        self._clocks: dict[str, tuple[Undoing | None, Undoing | None]] = {}
        self._readings: dict[str, Undoing] = {}
        self._rules: Undoing | None = None
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
            return _rms(pairs.a, align(name, pairs.a, pairs.b).apply(pairs.b))
        return math.inf

    def search(self) -> None:
        """Find the best explanation, and what else explains as much."""
        before = self._fit(Plan())
        self._floor = max(NO_ERROR, NEGLIGIBLE * before.rms)
        self._fits.clear()
        sign, *others = misreadings()
        readings = [sign, *axes(self._read(Plan())), *others]
        self._readings = {f"{number}": each for number, each in enumerate(readings)}
        plan = self._least(Plan(rates="rate bias", frames=frame) for frame in self._frames)
        for _ in range(ROUNDS):
            readings = [plan._replace(reading=key) for key in ("", *self._readings)]
            least = min(self._fit(each).score for each in readings)
            near = [each for each in readings if self._fit(each).score <= PROMISING * least]
            plan = self._least(self._varied(near, rates=("", plan.rates), frames=self._frames))
            plan = self._least(self._varied([plan], rates=RATES, frames=self._frames))
            self.is_open = self._fit(plan).rms <= ENOUGH * before.rms
            if self.is_open:
                break
            last = plan
            rules = self._likely_rules(plan)
            plan = self._least([last, *self._varied([last], clock=[""], rates=rules, frames=self._frames)])
            some = self._varied([last], clock=CLOCKS, rates=("", last.rates), frames=self._frames)
            plan = self._least([plan, *some])
            if plan == last:
                break
        self.best = self._fit(plan)
        sides = self._read(plan)
        for undoing in self.best.undone:
            if undoing.name in RATES_NAMES: sides = undoing.apply(sides)
        self._fitted_sides = sides
        self.others = self._alternatives()

    @staticmethod
    def _varied(plans: Iterable[Plan], **kinds: Iterable[str]) -> Iterator[Plan]:
        for plan, values in product(plans, product(*kinds.values())):
            yield plan._replace(**dict(zip(kinds, values, strict=True)))

    def _least(self, plans: Iterable[Plan]) -> Plan:
        """Return the first of the plans whose explanation is as good as the best."""
        plans = list(plans)
        least = min(self._fit(plan).score for plan in plans)
        return next(plan for plan in plans if self._fit(plan).score <= TIE * least)

    def _alternatives(self) -> list[str]:
        """Return which mistakes explain as much, with no more of them."""
        names = {undoing.name for undoing in self.best.undone}
        found: dict[str, str] = {}
        most = AS_GOOD * (self.best.rms + self._floor) - self._floor
        for other in sorted(self._fits.values(), key=lambda each: each.rms):
            new = [undoing for undoing in other.undone if undoing.name not in names]
            if other.rms <= most and len(other.undone) <= len(self.best.undone):
                for undoing in new:
                    if not any((name, undoing.name) in CONTAINED for name in names):
                        found.setdefault(undoing.name, undoing.other)
        if "reference frame" in names:
            a, b = (series.wxyz for series in self._fitted_sides)
            turn = mean_rotation(multiply(conjugate(b), a))
            if _rms(a, multiply(b, turn)) <= most:
                angle = float(geodesic_angle(IDENTITY, turn))
                found["body frame"] = f"body frames that differ by {degrees_text(angle)}"
        return sorted({*found.values()})

    def _likely_rules(self, plan: Plan) -> list[str]:
        """Return the key of the integration rules that explain most of the beginning."""
        sides = self._read(plan._replace(clock=""))
        turns = geodesic_angle(sides.a.wxyz[:-1], sides.a.wxyz[1:])
        begin = int(np.argmax(np.add.reduceat(turns, np.arange(0, len(turns), SCREENED)))) * SCREENED
        few = Sides(*(series[begin : begin + SCREENED] for series in sides))
        tried = {}
        for rules in permutations(METHODS, 2):
            if (a := by_other_rule(few.a, *rules)) is not None:
                tried[rules] = _rms(a.wxyz, align("mean", a.wxyz, few.b.wxyz).apply(few.b.wxyz))
        least = min(tried.values(), default=math.inf)
        likely = [rules for rules, left in tried.items() if left <= TWICE * least + NO_ERROR]
        if not likely or math.isinf(least):
            return []
        self._rules = integration_rules(sorted(likely, key=lambda rules: tried[rules]), few.a)
        return ["method"]

    def _read(self, plan: Plan) -> Sides:
        """Return pairs with a reading and a clock, as series of the same stamps."""
        key = plan.reading, plan.clock
        if key not in self._pairs:
            # Where no clock is wrong, the pairs are read otherwise: they are interpolated once.
            sides = self._pairs["", ""] if not plan.clock and any(key) else self._sides
            for undoing in self._undone(plan):
                sides = undoing.apply(sides)
            if plan.clock or not any(key):
                pairs = associate(*sides, self._settings)
                sides = Sides(*(AttitudeSeries(pairs.t_ns, q) for q in (pairs.a, pairs.b)))
            self._pairs[key] = sides
        return self._pairs[key]

    def _undone(self, plan: Plan) -> Iterator[Undoing]:
        """Yield a reading and a clock."""
        if plan.reading:
            yield self._readings[plan.reading]
        if plan.clock:
            if plan.reading not in self._clocks:
                self._clocks[plan.reading] = self._clocks_of(plan.reading)
            undoing = self._clocks[plan.reading][CLOCKS.index(plan.clock)]
            if undoing is None:
                raise ComparisonError("the motion shows no offset")
            yield undoing

    def _clocks_of(self, reading: str) -> tuple[Undoing | None, Undoing | None]:
        sides = self._readings[reading].apply(self._sides) if reading else self._sides
        coarse_ns = 0
        with suppress(ComparisonError):
            coarse_ns, _ = coarse_offset(*sides)
        offset, change = clocks(sides, coarse_ns, self._offset_given)
        return None if self._settings.time_offset == "auto" else offset, change

    def _fit(self, plan: Plan) -> Explanation:
        if plan not in self._fits:
            self._fits[plan] = NOTHING
            with suppress(ComparisonError):
                self._fits[plan] = self._fitted(plan)
        return self._fits[plan]

    def _fitted(self, plan: Plan) -> Explanation:
        sides = self._read(plan)
        undone = [*self._undone(plan)]
        alignment, left = self._aligned(plan, sides)
        for kind in plan.rates.split(" and "):
            if not kind:
                continue
            undoing = self._rates(kind, sides, alignment, undone)
            if undoing is None:
                return NOTHING
            undone.append(undoing)
            sides = undoing.apply(sides)
            alignment, left = self._aligned(plan, sides)
        if plan.frames:
            undone.append(frames(self._align, alignment))
        price = math.prod(PRICES.get(undoing.name, MOST) for undoing in undone)
        if plan.frames == "mount" and self._align != "mean":
            price *= PRICES["reference frame"]  # it rotates both
        return Explanation(tuple(undone), left, (left + self._floor) / price)

    def _aligned(self, plan: Plan, sides: Sides) -> tuple[Alignment, float]:
        some = slice(None, None, max(len(sides.a) // SEARCHED, 1))
        a, b = (series.wxyz[some] for series in sides)
        alignment = align(plan.frames or self._align, a, b)
        return alignment, _rms(a, alignment.apply(b))

    def _rates(
        self, kind: str, sides: Sides, alignment: Alignment, undone: list[Undoing]
    ) -> Undoing | None:
        match kind:
            case "rate bias":
                mounts = [each.mount for each in (*self._known, *undone) if each.mount is not None]
                return rate_bias(sides, alignment.mount_wxyz, mounts[0] if mounts else None)
            case "scale":
                return scale(sides, alignment.mount_wxyz)
            case "biased scale":
                return scale(sides, alignment.mount_wxyz, biased=True)
            case "drift in body" | "drift in reference":
                return drift(sides, alignment, kind.removeprefix("drift in "))
            case _:
                return self._rules


def _rms(a: Float64, b: Float64) -> float:
    return rms(geodesic_angle(a, b))
