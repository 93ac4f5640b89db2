"""Search for the hypothesis that explains an error: the mistakes that, undone, leave least of it.

A hypothesis has at most one mistake of each kind: in reading, of a clock, in rates, in frames. Each
mistake has a penalty, so that one more has to reduce the residual clearly.
"""

from __future__ import annotations

import math
from contextlib import suppress
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.rendering import degrees_text
from quatprop.comparison.alignment import (
    Alignment,
    align,
    align_pairs,
    between_gaps,
    centred,
    common_beginning,
    find_mounting,
    kabsch,
    mean_rotation,
    rms_between,
)
from quatprop.comparison.association import associate, is_mostly_exact
from quatprop.comparison.clock_offset import coarse_offset
from quatprop.comparison.mistakes import (
    NO_ERROR,
    Mistake,
    Sides,
    frame_mistake,
    integration_rules,
    misreadings,
    swapped_axes,
)
from quatprop.comparison.rate_mistakes import RATES, clock_mistakes, drift_by_errors, rate_mistake
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, multiply
from quatprop.kinematics.series import AttitudeSeries
from quatprop.kinematics.time_series import rms

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.comparison.association import JudgedPairs
    from quatprop.settings.command_options import ComparisonSettings


# Hypotheses about an error: combinations of mistakes, and the penalty of each.


PENALTIES = {
    "axes": 0.4,
    "scale": 0.3,
    "clock drift": 0.4,
    "reference frame": 0.45,
    "body frame": 0.45,
    "rate bias": 0.27,
    "drift": 0.25,
}
"""Mistake -> share to which it must reduce the residual; smaller for those that fit anything."""

PENALTY = 0.5
"""The same for all other mistakes."""

CLOCKS = ("time offset", "clock drift")

INDISTINCT = {
    ("axes", "body frame"),
    ("reference frame", "body frame"),
    ("body frame", "reference frame"),
    ("clock drift", "time offset"),
}
"""Pairs whose second is not an alternative to the first, but equivalent, or a part of it."""

MISREAD = {
    *("conjugate", "layout", "layout-first"),
    *("layout and conjugate", "layout-first and conjugate"),
}
"""Misread quaternions of one series."""

READINGS = {*MISREAD, "axes", "rate sign", "side"}
"""Mistakes without parameters; a hypothesis has at most one."""

RATE_REMEDIES = {"rate bias", "scale", "method"}
"""Mistakes whose remedy is to propagate again."""

LIKE_CLOCK_DRIFT = {"rate bias", "scale", "drift"}
"""Mistakes that make the same error as a clock drift if the body turns steadily."""


class Hypothesis(NamedTuple):
    """Which mistakes were made, by their keys; empty for none of that kind."""

    reading: str = ""
    clock: str = ""
    rates: str = ""
    frames: str = ""


class Fit(NamedTuple):
    """How well a hypothesis explains an error.

    `mistakes`: the mistakes, with their estimated parameters
    `rms`: RMS error that remains when they are undone, rad
    `score`: the same divided by the penalties; the smallest is the best
    """

    mistakes: tuple[Mistake, ...]
    rms: float
    score: float


NO_FIT = Fit((), math.inf, math.inf)
"""The fit of a hypothesis that cannot be tested."""


# Fit hypotheses to the error between two series: the residual when the mistakes are undone.


SEARCHED = 500
"""Minimum number of pairs in the search; causes that are reported are verified on all pairs."""

MAX_TURN = 0.1
"""Maximum rotation between these pairs, rad: changes of rates assume small rotations."""

WINDOWS = 40
"""Approximate number of consecutive windows over which readings are compared."""

MIN_SAMPLES = 100
"""Minimum number of samples from which a clock error is estimated."""


BEGINS_EQUAL = 0.3
"""First error, as a share of a difference of frames, that rules it out: A begins as B does."""


class Fits:
    """Fits of hypotheses to the error between two series; each is evaluated once.

    `added_ns`: time already added to B's timestamps, ns
    `accepted`: mistakes that are undone first
    `part`: the pairs that are judged; None: all
    """

    def __init__(
        self,
        sides: Sides,
        settings: ComparisonSettings,
        added_ns: int,
        accepted: Sequence[Mistake] = (),
        part: JudgedPairs | None = None,
    ) -> None:
        self._settings, self._added_ns, self._accepted = settings, added_ns, accepted
        self._align = settings.align
        for mistake in accepted:
            sides, self._align = mistake.undo(sides), mistake.align or self._align
        self._whole, self._part = sides, part
        same = np.isin(sides.a.t_ns, sides.b.t_ns)
        self._same_stamps = is_mostly_exact(int(same.sum()), len(same))
        of_a, of_b = sides.a, sides.b
        if part is not None:
            of_a, of_b = part.judged_samples(of_a), part.judged_samples(of_b)
        self._sides = Sides(*common_beginning(of_a, of_b))
        self._all_pairs = paired(self._sides, settings, self._sides.a)
        turn = max(
            float(np.percentile(geodesic_angle(each.wxyz[1:], each.wxyz[:-1]), 99))
            for each in (self._all_pairs.a, self._all_pairs.b)
        )
        count = len(self._all_pairs.a)
        stride = int(max(1, min(count / SEARCHED, MAX_TURN / max(turn, 1e-9))))
        self._subset = self._all_pairs.thinned(stride)
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
        """Return the RMS error of the judged part with mistakes undone, rad."""
        sides, name = self._whole, self._align
        for mistake in mistakes:
            sides, name = mistake.undo(sides), mistake.align or name
        with suppress(ComparisonError):
            return rms_of(sides, self._settings, name, self._part)
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
                sides = paired(sides, self._settings, self._sides.a)
            self._pairs[key] = sides
        return self._pairs[key]

    def _window_residual(self, reading: str) -> float:
        """Return the RMS residual of rotations over windows with a reading undone, rad.

        It is independent of the reference frames, constant biases and the mounting.
        """
        sides = self._pairs_of(Hypothesis(reading))
        totals = [np.cumsum(steps, axis=0) for steps in sides.steps()[:2]]
        length = max(len(totals[0]) // WINDOWS, 1)
        y, x = (centred(total[length:] - total[:-length]) for total in totals)
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
        if min(len(sides.a), len(sides.b)) < MIN_SAMPLES:
            return None, None
        coarse_ns = 0
        with suppress(ComparisonError):
            coarse_ns, _ = coarse_offset(sides.a, sides.b)
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
        if hypothesis.frames == "mean" and self._align == "none":
            beginning = geodesic_angle(sides.a.wxyz[0], sides.b.wxyz[0])
            if beginning <= BEGINS_EQUAL * alignment.reference_rad:
                return NO_FIT
        if hypothesis.frames:
            mistakes.append(frame_mistake(self._aligned(Hypothesis(), sides)[0], alignment))
        penalty = math.prod(PENALTIES.get(mistake.name, PENALTY) for mistake in mistakes)
        if hypothesis.frames == "mount" and self._align != "mean":
            penalty *= PENALTIES["reference frame"]  # it rotates both
        return Fit(tuple(mistakes), residual, (residual + self._floor) / penalty)

    def _aligned(self, hypothesis: Hypothesis, sides: Sides) -> tuple[Alignment, float]:
        sides = sides.thinned(max(len(sides.a) // SEARCHED, 1))
        a, b = sides.a.wxyz, sides.b.wxyz
        name = hypothesis.frames or self._align
        if name == "mount":
            # Relative rotations show it, and slow errors hardly affect them: found once.
            key = hypothesis.reading, hypothesis.clock
            if key not in self._mounts:
                self._mounts[key] = None
                self._mounts[key], _ = find_mounting(a, b, sides.crossing)
            mount = self._mounts[key]
            if mount is None:
                raise ComparisonError("the motion shows no mounting")
            a, turned = sides.mended(mount).a.wxyz, multiply(b, mount)
            alignment = Alignment(name, align("mean", a, turned).reference_wxyz, mount)
        else:
            a = sides.mended().a.wxyz
            alignment = align(name, a, b)
        return alignment, rms_between(a, alignment.apply(b))


def paired(sides: Sides, settings: ComparisonSettings, whole: AttitudeSeries) -> Sides:
    """Return both series at the timestamps at which they are compared.

    `whole`: A with all its timestamps, which show its gaps
    """
    pairs = associate(sides.a, sides.b, settings)
    crossing = between_gaps(pairs.t_ns, whole.t_ns, sides.b.t_ns)
    a, b = (AttitudeSeries(pairs.t_ns, wxyz) for wxyz in (pairs.a, pairs.b))
    return Sides(a, b, crossing)


def rms_of(
    sides: Sides, settings: ComparisonSettings, name: str, part: JudgedPairs | None = None
) -> float:
    """Return the RMS error over the judged samples, rad.

    `name`: how B is aligned
    """
    a, b = sides.a, sides.b
    if part is not None and (settings.align_range == "judged" or name == "none"):
        a, b, part = part.judged_samples(a), part.judged_samples(b), None
    pairs = associate(a, b, settings)
    rows = slice(None) if part is None else part.contains(pairs.t_ns)
    aligned = align_pairs(name, pairs, a, b).apply(pairs.b)
    return rms_between(pairs.a[rows], aligned[rows])


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

        With both frames free, a wrong layout of A looks the same as any wrong layout of B.
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
            a, b = (series.wxyz for series in sides.mended()[:2])
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
