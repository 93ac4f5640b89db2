"""Search for the hypothesis that explains an error: the mistakes that, undone, leave least of it.

A hypothesis has at most one mistake of each kind: in reading, of a clock, in rates, in frames. Each
mistake has a penalty, so that one more has to reduce the residual clearly.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING

from quatprop.comparison.alignment import mean_rotation, rms_between
from quatprop.comparison.cause import NO_ERROR
from quatprop.comparison.clock_mistakes import drift_by_errors
from quatprop.comparison.fits import Fits
from quatprop.comparison.hypotheses import (
    CLOCKS,
    INDISTINCT,
    LIKE_CLOCK_DRIFT,
    MISREAD,
    RATE_REMEDIES,
    READINGS,
    Hypothesis,
)
from quatprop.comparison.integration_rules import integration_rules
from quatprop.comparison.misreadings import misreadings, swapped_axes
from quatprop.comparison.rate_mistakes import RATES
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, multiply
from quatprop.rendering import degrees_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


NEGLIGIBLE = 1e-4
"""Residuals below this share of the error are equally good."""

ENOUGH = 0.02
"""Residual, as a share of the error, at which no further mistakes are looked for."""

TIE = 1.05
"""Scores within this factor of the best are equal: the first hypothesis is taken."""

AS_GOOD = 1.3
"""A hypothesis whose residual is within this factor of the best is not ruled out."""

MAX_RESIDUAL = 0.25
"""Maximum residual, as a share of the error, with a misreading or an integration rule."""

MAX_LAYOUT_RESIDUAL = 0.08
"""The same with a wrong layout: there are so many that one of them resembles anything."""

CLEAR_FACTOR = 3.0
"""Another misreading of quaternions is ruled out if its residual is this many times the best."""

PLAUSIBLE = 4.0
"""A reading within this factor of the best is tried with all alignments."""


class Search(Fits):
    """The search for the hypothesis that explains the errors of two series.

    `best`, `others`: after :meth:`run`: the best fit, and the mistakes that explain as much
    `is_partial`: whether some kinds of mistakes were not tried, since the residual is small
    """

    def run(self, before: float) -> None:
        """Find the best explanation of an RMS error, rad, and the alternatives."""
        self._floor = max(NO_ERROR, NEGLIGIBLE * before)
        if not self._has_reading:
            conjugated, others = misreadings(self._whole)
            readings = [*conjugated, *swapped_axes(self._pairs_of(Hypothesis())), *others]
            self._readings = {f"{number}": each for number, each in enumerate(readings)}
        residuals = {key: self._window_residual(key) for key in ("", *self._readings)}
        most = PLAUSIBLE * min(residuals.values())
        self._plausible = [key for key in residuals if not key or residuals[key] <= most]
        hypothesis = self._best_reading(
            self._best(Hypothesis(rates="rate bias", frames=frame) for frame in self._frames)
        )
        self.is_partial = self._fit(hypothesis).rms <= ENOUGH * before
        if not self.is_partial or hypothesis.rates or hypothesis.frames == "mount":
            hypothesis = self._with_rule_or_clock(hypothesis, before)
        chosen = self._with_b_misread(hypothesis)
        if chosen and self._explains_most(chosen, before):
            self.best = self._fit(self._with_usable_remedy(chosen))
            self.others = self._alternatives(chosen)

    def _with_rule_or_clock(self, hypothesis: Hypothesis, before: float) -> Hypothesis:
        """Return a hypothesis with an integration rule or a clock error, if one fits better."""
        self._rule = integration_rules(self._pairs_of(hypothesis._replace(rates="method")))
        rules = self._variants(
            [hypothesis], rates=["method"] if self._rule else [], frames=self._frames
        )
        with_rule = self._best([hypothesis, *rules])
        rates = dict.fromkeys(("", hypothesis.rates, "rate bias"))
        with_clock = self._variants([hypothesis], clock=CLOCKS, rates=rates, frames=self._frames)
        best = self._best([with_rule, *with_clock])
        # With equal timestamps, a rule is more likely than an offset of one interval or half.
        most = max(AS_GOOD * self._fit(best).rms, ENOUGH * before)
        is_rule = with_rule != hypothesis and self._fit(with_rule).rms <= most
        return with_rule if self._same_stamps and is_rule else best

    def _with_usable_remedy(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return a hypothesis that does not change A's rates if A may have been misread."""
        best = self._fit(hypothesis)
        keys = [key for key, each in self._readings.items() if each.name == "conjugate"]
        conjugated = [hypothesis._replace(reading=key) for key in keys]
        if hypothesis.reading and self._readings[hypothesis.reading].name == "rate sign":
            read = min(conjugated, key=lambda each: self._fit(each).rms)
            if self._fit(read).rms <= AS_GOOD * (best.rms + self._floor):
                hypothesis, best = read, self._fit(read)
        names = {mistake.name for mistake in (*self._accepted, *best.mistakes)}
        if not RATE_REMEDIES & {mistake.name for mistake in best.mistakes}:
            return hypothesis
        if not names & MISREAD:
            least = min((self._fit(each).rms for each in conjugated), default=math.inf)
            if hypothesis.reading or least > CLEAR_FACTOR * (best.rms + self._floor):
                return hypothesis
        return self._best(
            hypothesis._replace(rates=rates)
            for rates in ("drift in body", "drift in reference", "")
        )

    def _with_b_misread(self, hypothesis: Hypothesis) -> Hypothesis | None:
        """Return the same with B misread instead of A, if it fits; None if neither is certain.

        With both frames free, a wrong layout of A cannot be told from any wrong layout of B.
        """
        best = self._fit(hypothesis)
        names = {mistake.name for mistake in best.mistakes}
        if not best.mistakes or best.mistakes[0].side != "a" or "conjugate" in names:
            return hypothesis
        keys = [key for key, each in self._readings.items() if each.side == "b"]
        of_b = self._best(
            each
            for each in self._variants([hypothesis], reading=keys, frames=self._frames)
            if each.frames != "mount" or self._readings[each.reading].name in names
        )
        ratio = self._fit(of_b).rms / (best.rms + self._floor)
        if ratio <= TIE:
            return of_b
        return None if hypothesis.frames or ratio <= CLEAR_FACTOR else hypothesis

    def _explains_most(self, hypothesis: Hypothesis, before: float) -> bool:
        """Return False if a misreading or a rule leaves too much of an error."""
        names = {mistake.name for mistake in self._fit(hypothesis).mistakes}
        if not names & {*READINGS, "method"}:
            return True
        same = [fit.rms for each, fit in self._fits.items() if each.reading == hypothesis.reading]
        residual = min(same if hypothesis.reading else [self._fit(hypothesis).rms])
        is_layout = any(name.startswith("layout") for name in names)
        return residual <= (MAX_LAYOUT_RESIDUAL if is_layout else MAX_RESIDUAL) * before

    def _best_reading(self, hypothesis: Hypothesis) -> Hypothesis:
        """Return the best variant with another reading, other rates and frames."""
        # Readings are also compared with a free reference frame: without, it may hide the best one.
        near: dict[str, Hypothesis] = {}
        frames = self._frames[: 1 + ("mean" in self._frames)]
        for frame, rates in product(frames, dict.fromkeys(("", hypothesis.rates))):
            kinds = {"reading": self._plausible, "rates": [rates], "frames": [frame]}
            tried = [*self._variants([hypothesis], **kinds)]
            most = PLAUSIBLE * min(self._fit(each).score for each in tried)
            near |= {each.reading: each for each in tried if self._fit(each).score <= most}
        hypothesis = self._best(
            self._variants(near.values(), rates=("", hypothesis.rates), frames=self._frames)
        )
        return self._best(self._variants([hypothesis], rates=RATES, frames=self._frames))

    @staticmethod
    def _variants(hypotheses: Iterable[Hypothesis], **kinds: Iterable[str]) -> Iterator[Hypothesis]:
        for hypothesis, values in product(hypotheses, product(*kinds.values())):
            yield hypothesis._replace(**dict(zip(kinds, values, strict=True)))

    def _best(self, hypotheses: Iterable[Hypothesis]) -> Hypothesis:
        """Return the first hypothesis whose score ties with the best."""
        hypotheses = list(hypotheses)
        least = min(self._fit(hypothesis).score for hypothesis in hypotheses)
        return next(each for each in hypotheses if self._fit(each).score <= TIE * least)

    def _alternatives(self, hypothesis: Hypothesis) -> list[str]:
        """Return the mistakes that explain as much, in hypotheses with no more mistakes."""
        names = {mistake.name for mistake in self.best.mistakes}
        labels: dict[str, str] = {}
        most = AS_GOOD * (self.best.rms + self._floor) - self._floor
        # An explicit mounting rotates the reference frame too.
        count = self._count(hypothesis) + (hypothesis.frames == "mount" and self._align != "mean")
        fits = {
            other: fit
            for other, fit in sorted(self._fits.items(), key=lambda tried: tried[1].rms)
            if fit.rms <= most and self._count(other) <= count
        }
        for other, fit in fits.items():
            # An estimate that can be left out explains nothing.
            less = [other._replace(**{kind: ""}) for kind in ("clock", "rates", "frames")]
            if any(each in fits for each in less if each != other):
                continue
            for mistake in fit.mistakes:
                if not any((name, mistake.name) in INDISTINCT for name in names):
                    labels.setdefault(mistake.name, mistake.label)
        if names & READINGS and not self._shows_mounting(hypothesis):
            # In rotation about one axis, reversing an axis looks like reversing all rotations.
            labels |= {
                each.name: each.label
                for each in self._readings.values()
                if each.name in {"rate sign", "conjugate", "axes"}
            }
        if "reference frame" in names:
            sides = self._pairs_of(hypothesis)
            for mistake in self._fit(hypothesis).mistakes:
                if mistake.name in {"rate bias", "scale", "drift", "method"}:
                    sides = mistake.undo(sides)
            a, b = (series.wxyz for series in sides)
            turn = mean_rotation(multiply(conjugate(b), a))
            if rms_between(a, multiply(b, turn)) <= most:
                angle = float(geodesic_angle(IDENTITY, turn))
                labels["body frame"] = f"body frames that differ by {degrees_text(angle)}"
        if names & LIKE_CLOCK_DRIFT and not hypothesis.clock:
            pairs = self._pairs_of(hypothesis)
            drift = drift_by_errors(pairs, self._aligned(hypothesis, pairs)[0])
            others = [each for each in self.best.mistakes if each.name not in LIKE_CLOCK_DRIFT]
            best, before = self.residual(self.best.mistakes), self.residual(())
            enough = max(AS_GOOD * best, ENOUGH * before)
            if drift and self.residual([drift, *others]) <= enough:
                labels[drift.name] = drift.label
        return sorted({text for name, text in labels.items() if name not in names})

    def _count(self, hypothesis: Hypothesis) -> int:
        # A mounting rotates two frames, and turns one misreading into another.
        count = len(self._fit(hypothesis).mistakes)
        return count + (hypothesis.frames == "mount" and count > 1)

    def _shows_mounting(self, hypothesis: Hypothesis) -> bool:
        with suppress(ComparisonError):
            self._aligned(hypothesis._replace(frames="mount"), self._pairs_of(hypothesis))
            return True
        return False
