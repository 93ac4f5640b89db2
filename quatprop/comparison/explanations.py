"""Explanations of an error: which mistakes, undone together, leave least of it.

An explanation undoes at most one mistake of each kind: in reading, of a clock, in rates, in frames.
Every mistake has a price, the share of the error that may remain when it is undone beside the
others; the explanation that leaves least at its price is the best.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING

from quatprop.comparison.alignment import mean_rotation
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.fits import Fits, rms_between
from quatprop.comparison.integration_rules import integration_rules
from quatprop.comparison.misreadings import axes, misreadings
from quatprop.comparison.plans import CLOCKS, CONTAINED, MISREAD, RATE_REMEDIES, READINGS, Undoings
from quatprop.comparison.rate_mistakes import RATES
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, multiply
from quatprop.rendering import degrees_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


NEGLIGIBLE = 1e-4
"""Share of the error below which explanations are equally good."""

ENOUGH = 0.02
"""Share of the error that may remain where no more mistakes are looked for at once."""

TIE = 1.05
"""Explanations within this factor of the best are as good: the first of them is taken."""

AS_GOOD = 1.3
"""Within this factor of the best, an explanation is not ruled out."""

SHOWN = 0.25
"""Share of the error that a misreading or an integration rule may leave: most of it is theirs."""

OF_LAYOUTS = 0.08
"""The same of a wrong layout: there are so many that one of them resembles anything."""

CLEARLY = 3.0
"""Within this factor of the best, another misreading of quaternions is not ruled out."""

PROMISING = 4.0
"""Within this factor of the best, a reading is tried with all alignments."""

ROUNDS = 2
"""How often every kind of mistake is looked for, beside those that were found."""


class Search(Fits):
    """The search for what explains the errors of two series.

    `best`, `others`: the best explanation, and what explains as much; once it has run
    `is_open`: whether kinds of mistakes were left out, since little of the error remains
    """

    def run(self, before: float) -> None:
        """Find the best explanation of an RMS error, rad, and what else explains as much."""
        self._floor = max(NO_ERROR, NEGLIGIBLE * before)
        if not self._is_read:
            opposite, others = misreadings(self._whole)
            readings = [*opposite, *axes(self._read(Undoings())), *others]
            self._readings = {f"{number}": each for number, each in enumerate(readings)}
        left = {key: self._over_windows(key) for key in ("", *self._readings)}
        most = PROMISING * min(left.values())
        self._promising = [key for key in left if not key or left[key] <= most]
        plan = self._least(Undoings(rates="rate bias", frames=frame) for frame in self._frames)
        for _ in range(ROUNDS):
            plan = last = self._read_and_aligned(plan)
            self.is_open = self._fit(plan).rms <= ENOUGH * before
            if self.is_open and not plan.rates and plan.frames != "mount":
                break
            self._rules = integration_rules(self._read(last._replace(clock="", rates="method")))
            rules = self._varied(
                [last], clock=[""], rates=["method"] if self._rules else [], frames=self._frames
            )
            ruled = self._least([last, *rules])
            rates = dict.fromkeys(("", last.rates, "rate bias"))
            some = self._varied([last], clock=CLOCKS, rates=rates, frames=self._frames)
            plan = self._least([ruled, *some])
            # Where stamps are the same, the rule is the simpler reason for an interval or a half.
            most = max(AS_GOOD * self._fit(plan).rms, ENOUGH * before)
            if self._same_stamps and ruled != last and self._fit(ruled).rms <= most:
                plan = ruled
            if plan == last:
                break
        of_b = self._of_b(plan)
        if of_b and self._is_shown(of_b, before):
            self.best = self._fit(self._deliverable(of_b))
            self.others = self._alternatives(of_b)

    def _deliverable(self, plan: Undoings) -> Undoings:
        """Return a plan that leaves A's rates alone where A may be read the wrong way."""
        best = self._fit(plan)
        keys = [key for key, each in self._readings.items() if each.name == "conjugate"]
        opposite = [plan._replace(reading=key) for key in keys]
        if plan.reading and self._readings[plan.reading].name == "rate sign":
            read = min(opposite, key=lambda each: self._fit(each).rms)
            if self._fit(read).rms <= AS_GOOD * (best.rms + self._floor):
                plan, best = read, self._fit(read)
        names = {undoing.name for undoing in (*self._known, *best.undone)}
        if not RATE_REMEDIES & {undoing.name for undoing in best.undone}:
            return plan
        if not names & MISREAD:
            least = min((self._fit(each).rms for each in opposite), default=math.inf)
            if plan.reading or least > CLEARLY * (best.rms + self._floor):
                return plan
        return self._least(
            plan._replace(rates=rates) for rates in ("drift in body", "drift in reference", "")
        )

    def _of_b(self, plan: Undoings) -> Undoings | None:
        """Return a plan that reads B otherwise instead of A, if that explains as much.

        A wrong layout turns both frames: where these are free, it is any of them in A as in B.
        """
        best = self._fit(plan)
        names = {undoing.name for undoing in best.undone}
        if not best.undone or best.undone[0].side != "a" or "conjugate" in names:
            return plan
        keys = [key for key, each in self._readings.items() if each.side == "b"]
        of_b = self._least(
            each
            for each in self._varied([plan], reading=keys, frames=self._frames)
            if each.frames != "mount" or self._readings[each.reading].name in names
        )
        more = self._fit(of_b).rms / (best.rms + self._floor)
        if more <= TIE:
            return of_b
        return None if plan.frames or more <= CLEARLY else plan

    def _is_shown(self, plan: Undoings, before: float) -> bool:
        """Tell whether a misreading or a rule explains most of an error."""
        names = {undoing.name for undoing in self._fit(plan).undone}
        fits = [fit.rms for each, fit in self._fits.items() if each.reading == plan.reading]
        with_it = min(fits if plan.reading else [self._fit(plan).rms])
        is_layout = any(name.startswith("layout") for name in names)
        most = (OF_LAYOUTS if is_layout else SHOWN) * before
        return not names & {*READINGS, "method"} or with_it <= most

    def _read_and_aligned(self, plan: Undoings) -> Undoings:
        """Return the best plan with another reading, other rates and frames."""
        # Readings are also compared with free frames: those that differ may hide which is right.
        near: dict[str, Undoings] = {}
        frames = self._frames[: 1 + ("mean" in self._frames)]
        for frame, rates in product(frames, dict.fromkeys(("", plan.rates))):
            kinds = {"reading": self._promising, "rates": [rates], "frames": [frame]}
            tried = [*self._varied([plan], **kinds)]
            most = PROMISING * min(self._fit(each).score for each in tried)
            near |= {each.reading: each for each in tried if self._fit(each).score <= most}
        plan = self._least(self._varied(near.values(), rates=("", plan.rates), frames=self._frames))
        return self._least(self._varied([plan], rates=RATES, frames=self._frames))

    @staticmethod
    def _varied(plans: Iterable[Undoings], **kinds: Iterable[str]) -> Iterator[Undoings]:
        for plan, values in product(plans, product(*kinds.values())):
            yield plan._replace(**dict(zip(kinds, values, strict=True)))

    def _least(self, plans: Iterable[Undoings]) -> Undoings:
        """Return the first of the plans whose explanation is as good as the best."""
        plans = list(plans)
        least = min(self._fit(plan).score for plan in plans)
        return next(plan for plan in plans if self._fit(plan).score <= TIE * least)

    def _alternatives(self, plan: Undoings) -> list[str]:
        """Return which mistakes explain as much, with no more of them."""
        names = {undoing.name for undoing in self.best.undone}
        found: dict[str, str] = {}
        most = AS_GOOD * (self.best.rms + self._floor) - self._floor
        # A mounting that is named turns the reference frame too.
        count = self._count(plan) + (plan.frames == "mount" and self._align != "mean")
        for other, fit in sorted(self._fits.items(), key=lambda tried: tried[1].rms):
            if fit.rms <= most and self._count(other) <= count:
                for undoing in fit.undone:
                    if not any((name, undoing.name) in CONTAINED for name in names):
                        found.setdefault(undoing.name, undoing.other)
        if names & READINGS and not self._shows_mounting(plan):
            # About one axis, an axis that is reversed reverses all rotations.
            found |= {
                each.name: each.other
                for each in self._readings.values()
                if each.name in {"rate sign", "conjugate", "axes"}
            }
        if "reference frame" in names:
            sides = self._read(plan)
            for undoing in self._fit(plan).undone:
                if undoing.name in {"rate bias", "scale", "drift", "method"}:
                    sides = undoing.apply(sides)
            a, b = (series.wxyz for series in sides)
            turn = mean_rotation(multiply(conjugate(b), a))
            if rms_between(a, multiply(b, turn)) <= most:
                angle = float(geodesic_angle(IDENTITY, turn))
                found["body frame"] = f"body frames that differ by {degrees_text(angle)}"
        return sorted({text for name, text in found.items() if name not in names})

    def _count(self, plan: Undoings) -> int:
        # A mounting turns two frames, and makes one misreading of another.
        count = len(self._fit(plan).undone)
        return count + (plan.frames == "mount" and count > 1)

    def _shows_mounting(self, plan: Undoings) -> bool:
        with suppress(ComparisonError):
            self._aligned(plan._replace(frames="mount"), self._read(plan))
            return True
        return False
