"""Mistakes and how to undo them: different frames, and functions that the other mistakes share.

Where either series may be wrong, A is corrected, and the remedy covers both cases.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.base.rendering import count_text, degrees_text
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.comparison.alignment import aligned_rms
from quatprop.comparison.association import interval_ns
from quatprop.kinematics.increments import rotation_vectors
from quatprop.kinematics.propagate import attitudes, rotation_vectors_between
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, rotate
from quatprop.kinematics.signed_axes import SIGNED_PERMUTATIONS, axes_text
from quatprop.kinematics.time_series import rms
from quatprop.settings.quantities import METHODS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.comparison.alignment import Alignment
    from quatprop.kinematics.series import AttitudeSeries


class Sides(NamedTuple):
    """The series A and B, whole or as pairs.

    `crossing`: which intervals between pairs are over a gap of A or B, shape ``(N - 1,)``; None:
        the series are whole
    """

    a: AttitudeSeries
    b: AttitudeSeries
    crossing: Bool | None = None

    def steps(self) -> tuple[Float64, Float64, Float64]:
        """Return the rotations of A and B between pairs, but not over gaps; the intervals, s."""
        steps = [rotation_vectors_between(series.wxyz) for series in (self.a, self.b)]
        seconds = np.diff(self.a.t_ns)[:, None] / NS_PER_S
        rows = slice(None) if self.crossing is None else ~self.crossing
        return steps[0][rows], steps[1][rows], seconds[rows]

    def mended(self, mount: Float64 = IDENTITY) -> Self:
        """Return the same with the rotations of B in place of those of A over gaps.

        `mount`: A's body -> B's body, wxyz
        """
        if self.crossing is None or not self.crossing.any():
            return self
        of_a, of_b = (rotation_vectors_between(series.wxyz) for series in (self.a, self.b))
        of_b = rotate(conjugate(mount), of_b)
        steps = np.where(self.crossing[:, None], of_b, of_a)
        return self._replace(a=recomposed(self.a, steps))

    def thinned(self, stride: int) -> Self:
        """Return one of every `stride` pairs."""
        if stride == 1:
            return self
        a, b, crossing = self.a[::stride], self.b[::stride], self.crossing
        if crossing is not None:
            gaps = np.append(0, np.cumsum(crossing))[::stride]
            crossing = np.diff(gaps) > 0
        return self._replace(a=a, b=b, crossing=crossing)


class Mistake(NamedTuple):
    """A mistake and how to undo it.

    `label`: short description, for lists of alternatives
    `undo`: returns A and B without the mistake
    `align`: the alignment that removes it, if any
    `mount`: the matrix that rotates A's rates, if the remedy is a mounting; a bias is subtracted
        before it
    `side`: ``"a"`` or ``"b"``: the series that was misread, if it is one
    """

    name: str
    label: str
    sentence: str
    remedy: str
    undo: Callable[[Sides], Sides]
    align: str = ""
    mount: Float64 | None = None
    side: str = ""


def remedy_if_propagated(setting: str, a: str, b: str) -> str:
    """Return a remedy for whichever series was propagated: the other may be a reference."""
    of_a, of_b = Setting(setting, a), Setting(setting, b)
    return f"if A was propagated, propagate it with {of_a}; if B was, with {of_b}"


def recomposed(series: AttitudeSeries, steps: Float64, rates: str = "body") -> AttitudeSeries:
    """Return a series with the rotations between samples replaced.

    `steps`: rotation vectors, shape ``(N - 1, 3)``, rad
    """
    # With intervals of one second, rates are rotation vectors.
    t_ns = np.arange(len(series)) * NS_PER_S
    rate = np.append(steps, np.zeros((1, 3)), axis=0)
    return replace(series, wxyz=attitudes(t_ns, rate, q0=series.wxyz[0], rates=rates))


def rates_changed(factor: Float64 | float, less: Float64 | float = 0.0) -> Callable[[Sides], Sides]:
    """Return a function that multiplies A's rates, and then subtracts a rate, rad/s."""
    matrix = np.asarray(factor) * (1 if np.ndim(factor) else np.eye(3))

    def undo(sides: Sides) -> Sides:
        seconds = np.diff(sides.a.t_ns)[:, None] / NS_PER_S
        steps = rotation_vectors_between(sides.a.wxyz) @ matrix.T - seconds * less
        return sides._replace(a=recomposed(sides.a, steps))

    return undo


def scaling_remedy(factor: float) -> str:
    """Return the remedy for rates that have to be multiplied by a factor."""
    return (
        f"if A was propagated, multiply its rates by {factor:.6g}; if B was, multiply its rates by "
        f"{1 / factor:.6g}"
    )


LEVEL = 1e-3
"""Maximum share of a heading rotation that is about a level axis."""


NEGLIGIBLE = 1e-9
"""Angle, rad, by which frames differ only by rounding."""


def frame_mistake(asked: Alignment, alignment: Alignment) -> Mistake:
    """Return the difference of frames that an alignment removes besides the requested one."""
    apart = geodesic_angle(asked.reference_wxyz, alignment.reference_wxyz)
    reference, body = (degrees_text(float(angle)) for angle in (apart, alignment.mount_rad))
    name, wanted = alignment.name, alignment.name
    if name == "mean":
        _, x, y, _ = alignment.reference_wxyz
        level = math.hypot(x, y) < LEVEL * math.sin(alignment.reference_rad / 2)
        wanted = "yaw" if level and asked.name in {"none", "first"} else "mean"
    sentence = f"the reference frames differ by {reference}"
    if name == "mount":
        also = asked.name != "mean" and float(apart) > NEGLIGIBLE
        others = f", and the reference frames by {reference}" if also else ""
        sentence = f"the body frames differ by {body}{others}"
    return Mistake(
        "body frame" if name == "mount" else "reference frame",
        f"{'body' if name == 'mount' else 'reference'} frames that differ by "
        f"{body if name == 'mount' else reference}",
        sentence,
        f"{Setting('align', wanted)} removes it",
        lambda sides: sides,
        wanted,
    )


# The likely cause of an error: a mistake whose remedy removes most of it.


CLEAR = 10.0
"""Errors this many times the RMS of all others are isolated."""

NO_ERROR = 1e-9
"""RMS error, rad, that is only rounding."""

ISOLATED = 0.01
"""Maximum share of samples with isolated errors."""


class Cause(NamedTuple):
    """A cause that explains most of an error.

    `name`: a short name, stable for scripts
    `sentence`: description, with the RMS error before and after the remedy
    `rms_before`: RMS error before the remedy, rad, aligned as asked
    `rms_after`: RMS error after the remedy, rad, aligned as asked; NaN if the remedy is not tested,
        for an error that an integration method states to cost
    `remedy`: settings with which to read, propagate or compare, or another correction
    `also`: a second cause, which explains most of the error that remains
    `part_ns`: length of the part of the recording that was searched and measured, ns; None: all
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float
    remedy: str
    also: Cause | None = None
    part_ns: int | None = None

    @property
    def chain(self) -> list[Cause]:
        """The cause, and the further ones."""
        return [self, *(self.also.chain if self.also else [])]

    @property
    def advice(self) -> str:
        """The sentence with the remedy; not for regression tests, where it would hide the fault."""
        return f"{self.sentence}; {self.remedy}"


def isolated_samples(error: Float64) -> Cause | None:
    """Return a few outliers as the cause, or None; `error`: sorted, rad."""
    few = max(int(len(error) * ISOLATED), 1)
    before, rest = rms(error), rms(error[:-few])
    count = int((error > CLEAR * max(rest, NO_ERROR)).sum())
    if not 0 < count <= few or (after := rms(error[:-count])) > before / CLEAR:
        return None
    sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
    return Cause(
        "isolated samples", sentence, before, after, f"omit {count_text(count, 'sample')} of B"
    )


# Mistakes without parameters: layouts, directions, signs, sides and axes.


CONJUGATE = (
    "B is the conjugate of A: the direction (reference to body) or the JPL convention of one of "
    "them was not taken into account"
)
AS_READ = [0, 1, 2, 3]
LAYOUTS = {"last": [3, 0, 1, 2], "first": [1, 2, 3, 0]}
"""True position of the scalar -> indices of w, x, y and z in quaternions read the other way."""

SIGNED_AXES = SIGNED_PERMUTATIONS[1:-1]
"""Signed permutations of the axes, those with the fewest changes first; without I and -I."""

SAME_FIT = 1e-3
"""Relative tolerance within which signed permutations fit equally well."""


def misreadings(sides: Sides) -> tuple[list[Mistake], list[Mistake]]:
    """Return wrong directions and signs, and wrong layouts and frames of rates.

    Directions come first: where the motion does not distinguish one from a sign of rates, it is
    the simpler cause, since it only concerns the quaternions that are compared.

    `sides`: the series as read; the alternative layout is the one they were not read with
    """
    sign = "the rates of A and B have opposite signs"
    rate_sign = Mistake(
        "rate sign", "rates of the opposite sign", sign, scaling_remedy(-1), rates_changed(-1.0)
    )
    of_sides = [
        [*_misread("b", sides.b.read_layout, sides.a.read_layout)],
        [*_misread("a", sides.a.read_layout, sides.b.read_layout)],
    ]
    frames = [
        Mistake(
            "side",
            "body rates treated as inertial rates",
            "one of A and B treats the rates as body-frame, the other as reference-frame",
            remedy_if_propagated("rates", wanted, own),
            _with_rates_in(own, wanted),
        )
        for own, wanted in (("inertial", "body"), ("body", "inertial"))
    ]
    conjugated = [of_side[0] for of_side in of_sides]
    return [*conjugated, rate_sign], [*of_sides[0][1:], *of_sides[1][1:], *frames]


def _misread(side: str, layout: str | None, other_layout: str | None) -> Iterator[Mistake]:
    """Yield a wrong direction, a wrong layout, and both together, of a series.

    `layout`, `other_layout`: as which it and the other series were read
    """

    def reread(order: list[int], *, conjugated: bool) -> Callable[[Sides], Sides]:
        def undo(sides: Sides) -> Sides:
            series = getattr(sides, side)
            wxyz = np.ascontiguousarray(series.wxyz[:, order])
            wxyz = conjugate(wxyz) if conjugated else wxyz
            return sides._replace(**{side: replace(series, wxyz=wxyz)})

        return undo

    direction = f"{Setting('from_direction', 'ref-to-body', side)} or "
    direction += Setting("from_convention", "jpl", side)
    remedy = f"if it is {side.upper()}, read it with "
    label = "a wrong direction or JPL convention"
    yield Mistake(
        "conjugate",
        label,
        CONJUGATE,
        remedy + direction,
        reread(AS_READ, conjugated=True),
        side=side,
    )
    # A series from memory is scalar-first by definition.
    true, assumed = ("first", "last") if layout == "scalar-last" else ("last", "first")
    name = "layout" if (true == "last") == (side == "b") else "layout-first"
    sentence = f"{side.upper()} is scalar-{true} and was read as scalar-{assumed}"
    setting = Setting("from_layout", f"scalar-{true}", side)
    undo = reread(LAYOUTS[true], conjugated=False)
    summary, remedies = sentence, remedy + setting
    if other_layout == f"scalar-{true}":
        # The opposite mistake, made with the other series, relates them in the same way.
        other = "ab".replace(side, "")
        summary += f", or {other.upper()} is scalar-{assumed} and was read as scalar-{true}"
        opposite = Setting("from_layout", f"scalar-{assumed}", other)
        remedies += f"; if it is {other.upper()}, with {opposite}"
    yield Mistake(name, "a wrong layout", summary, remedies, undo, side=side)
    yield Mistake(
        f"{name} and conjugate",
        f"a wrong layout with {label}",
        f"{sentence}; also, {CONJUGATE}",
        f"{remedy}{setting} and {direction}",
        reread(LAYOUTS[true], conjugated=True),
        side=side,
    )


def swapped_axes(sides: Sides) -> Iterator[Mistake]:
    """Yield the best right-handed and the best left-handed signed permutation of the axes."""
    of_a, of_b, _ = sides.steps()
    common = of_a.T @ of_b
    for handed in (1.0, -1.0):
        kept = [matrix for matrix in SIGNED_AXES if np.linalg.det(matrix) * handed > 0]
        fits = np.array([float((matrix * common).sum()) for matrix in kept])
        # y = M x, x in B's axes and y in A's.
        matrix = kept[int(np.argmax(fits >= fits.max() - SAME_FIT * abs(fits.max())))]
        sentence = f"the body axes x, y, z of A are {_signed(matrix)} of B"
        mounts = _signed(matrix.T), _signed(matrix)
        if handed > 0:
            remedy = remedy_if_propagated("mount", *(mount.replace(" ", "") for mount in mounts))
            remedy += ", after any other"
        else:
            sentence += ", which is left-handed: an axis is reversed, or two are swapped"
            remedy = (
                f"if A was propagated, read its rates as {mounts[0]}; if B was, read its rates as "
                f"{mounts[1]} (no option does that: the driver or the log is to be mended)"
            )
        undo, mount = rates_changed(matrix.T), matrix.T if handed > 0 else None
        yield Mistake("axes", "swapped or reversed axes", sentence, remedy, undo, mount=mount)


def _signed(matrix: Float64) -> str:
    return axes_text(matrix).replace(",", ", ")


def _with_rates_in(own: str, wanted: str) -> Callable[[Sides], Sides]:
    """Return a function that resolves A's rates in another frame."""

    def undo(sides: Sides) -> Sides:
        steps = rotation_vectors_between(sides.a.wxyz, rates=own)
        return sides._replace(a=recomposed(sides.a, steps, wanted))

    return undo


# The integration rule as a mistake: the rates that led to A by one rule, propagated by another.


RULE_ROUNDS = 6
"""Iterations that find the rates of a rule; each gains two orders of the rotation angle."""

MIN_SAMPLES = 20
"""Minimum number of samples that show an integration rule."""

SAME = 2e-3
"""Maximum difference, rad, between A's rotations and those that the rates give back."""

SCREENED = 1_500
"""Number of samples on which rules are tested: those with the most motion."""

AS_GOOD = 2.0
"""Pairs of rules with a residual within this factor of the best are not ruled out: several pairs
differ by one interval, or half of one."""


def integration_rules(sides: Sides) -> Mistake | None:
    """Return the pairs of rules that best explain an error, or None if no rule fits."""
    mended = sides.mended()
    turns = geodesic_angle(mended.a.wxyz[:-1], mended.a.wxyz[1:])
    sums = np.add.reduceat(turns, np.arange(0, len(turns), SCREENED))
    begin = int(np.argmax(sums)) * SCREENED
    a, b = (series[begin : begin + SCREENED] for series in (mended.a, mended.b))
    residuals = {}
    for rule in METHODS:
        if (rates := recovered_rates(a, rule)) is None:
            continue
        for other in METHODS:
            if other != rule:
                changed = rates.propagated(other)
                residuals[rule, other] = aligned_rms("mean", changed.wxyz, b.wxyz)
    most = AS_GOOD * min(residuals.values(), default=0.0) + NO_ERROR
    likely = sorted((left, rules) for rules, left in residuals.items() if left <= most)
    return _described([rules for _, rules in likely], a) if likely else None


def _described(likely: Sequence[tuple[str, str]], a: AttitudeSeries) -> Mistake:
    rule, other = likely[0]
    others = " or ".join(dict.fromkeys(pair[1] for pair in likely if pair[0] == rule))
    sentence = f"the same rates lead to A with method {rule}, and to B with method {others}"
    if {rule, other} == {"start", "end"}:
        amount = duration_text(interval_ns(a))
        sentence += f", or their timestamps are one interval, {amount}, apart"
    remedy = "; ".join(
        f"if A was propagated with method {rule}, propagate it with {Setting('method', other)}"
        for rule, other in {pair[0]: pair for pair in reversed(likely)}.values()
    )
    remedy += f"; if B was propagated with method {other}, with {Setting('method', rule)}"

    def undo(sides: Sides) -> Sides:
        rates = recovered_rates(sides.a, rule)
        return sides if rates is None else sides._replace(a=rates.propagated(other))

    return Mistake("method", "another integration rule", sentence, remedy, undo)


class RecoveredRates(NamedTuple):
    """Rates from which attitudes were propagated by a rule.

    `rate`: body rates, shape ``(N, 3)``, rad/s
    `remainder`: the rotations between samples minus those of the rates, shape ``(N - 1, 3)``, rad
    """

    attitudes: AttitudeSeries
    rate: Float64
    remainder: Float64

    @np.errstate(over="ignore", invalid="ignore")  # of rates that grow without bound
    def propagated(self, rule: str) -> AttitudeSeries:
        """Return the attitudes propagated by another rule."""
        steps = rotation_vectors(self.attitudes.t_ns, self.rate, rule)
        return recomposed(self.attitudes, self.remainder + steps)


@np.errstate(over="ignore", invalid="ignore")
def recovered_rates(a: AttitudeSeries, rule: str) -> RecoveredRates | None:
    """Return the rates from which an integration rule makes A; None if there are none."""
    if len(a) < MIN_SAMPLES:
        return None
    steps = rotation_vectors_between(a.wxyz)
    rate = _inverted(a.t_ns, steps, rule)
    remainder = steps - rotation_vectors(a.t_ns, rate, rule)
    if not np.abs(remainder).max() <= SAME:
        return None
    return RecoveredRates(a, rate, remainder)


def _inverted(t_ns: Int64, steps: Float64, rule: str) -> Float64:
    """Return rates, rad/s, from which a rule gives these rotations over intervals, rad.

    For ``start`` and ``end`` they are unique; for others, up to an alternating rate.
    """
    seconds = np.diff(t_ns)[:, None] / NS_PER_S
    mean = steps / seconds
    if rule in {"start", "end"}:
        return np.concatenate([mean, mean[-1:]] if rule == "start" else [mean[:1], mean])
    rate = _from_means(mean)
    for _ in range(0 if rule == "mean" else RULE_ROUNDS):
        correction = rotation_vectors(t_ns, rate, rule) - rotation_vectors(t_ns, rate, "mean")
        rate = _from_means((steps - correction) / seconds)
    return rate


def _from_means(mean: Float64) -> Float64:
    """Return the smoothest values with these means of neighbours."""
    sign = np.where(np.arange(len(mean) + 1) % 2, -1.0, 1.0)[:, None]
    values = np.zeros((len(mean) + 1, 3))
    np.cumsum(-2 * sign[:-1] * mean, axis=0, out=values[1:])
    values *= sign
    alternating = (sign[:-1] * np.diff(values, axis=0)).mean(axis=0) / 2
    return np.asarray(values + sign * alternating)
