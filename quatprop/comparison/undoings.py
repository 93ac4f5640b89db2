"""Mistakes, and how each is undone in a series: read, propagated or timed otherwise.

A was propagated, if one of the two was, and B is what it is compared with; where either may be
wrong, it is undone in A, and the remedy names both ways.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import permutations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.association import shifted
from quatprop.comparison.clock_error import ClockError, clock_errors
from quatprop.comparison.statistics import S_PER_H
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, log, multiply, rotate, shorter
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.rendering import degrees_text
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.alignment import Alignment
    from quatprop.series import AttitudeSeries


class Sides(NamedTuple):
    """The series A and B."""

    a: AttitudeSeries
    b: AttitudeSeries


class Undoing(NamedTuple):
    """A mistake and how it is undone.

    `other`: what it is called where another mistake explains as much
    `apply`: returns A and B without it
    `align`: the alignment that undoes it, where one does
    `mount`: the matrix by which it turns A's rates, where the remedy is a mounting: a bias is
        subtracted before that
    """

    name: str
    other: str
    sentence: str
    remedy: str
    apply: Callable[[Sides], Sides]
    align: str = ""
    mount: Float64 | None = None


# --- reading


CONJUGATE = (
    "B is the conjugate of A: the direction (reference to body) or the JPL convention of one of "
    "them was not taken into account"
)
AS_READ = [0, 1, 2, 3]
LAYOUTS = {"layout": [3, 0, 1, 2], "layout-first": [1, 2, 3, 0]}
"""Which components, as they were read, are w, x, y and z of B, where it is scalar-last or A is
scalar-first, and the other way round."""

SIGNED_AXES = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ),
    key=lambda matrix: -np.trace(matrix),
)[1:-1]
"""Matrices of all orders and signs of axes, those with the fewest changes first; without the one
that changes nothing, and the one that reverses everything."""

SAME_FIT = 1e-3
"""Orders and signs that fit as well, as a share: the motion does not show the axis of change."""


def misreadings() -> Iterator[Undoing]:
    """Yield wrong layouts, directions and conventions, and rates resolved in another frame."""

    def read(side: str, order: list[int], *, opposite: bool) -> Callable[[Sides], Sides]:
        def apply(sides: Sides) -> Sides:
            series = getattr(sides, side)
            wxyz = np.ascontiguousarray(series.wxyz[:, order])
            wxyz = conjugate(wxyz) if opposite else wxyz
            return sides._replace(**{side: replace(series, wxyz=wxyz)})

        return apply

    sign = "the rates of A and B have opposite signs"
    yield Undoing("rate sign", "rates of the opposite sign", sign, _scaled(-1), _with_rates(-1.0))
    for side in "ba":
        direction = f"{Setting('from_direction', 'ref-to-body', side)} or "
        direction += Setting("from_convention", "jpl", side)
        way = f"if it is {side.upper()}, read it with "
        other = "a wrong direction or JPL convention"
        yield Undoing(
            "conjugate", other, CONJUGATE, way + direction, read(side, AS_READ, opposite=True)
        )
        for name, order in LAYOUTS.items():
            last = (name == "layout") == (side == "b")
            own, taken = ("last", "first") if last else ("first", "last")
            said = f"{side.upper()} is scalar-{own} and was read as scalar-{taken}"
            layout = Setting("from_layout", f"scalar-{own}", side)
            numbers = order if side == "b" else np.argsort(order).tolist()
            apply = read(side, numbers, opposite=False)
            yield Undoing(name, "a wrong layout", said, way + layout, apply)
            yield Undoing(
                f"{name} and conjugate",
                f"a wrong layout with {other}",
                f"{said}; also, {CONJUGATE}",
                f"{way}{layout} and {direction}",
                read(side, numbers, opposite=True),
            )
    for own, wanted in (("inertial", "body"), ("body", "inertial")):
        yield Undoing(
            "side",
            "body rates taken for inertial rates",
            "what multiplies on the left in one of A and B multiplies on the right in the other: "
            "body rates against inertial rates",
            _if_propagated("rates", wanted, own),
            _on_other_side(own, wanted),
        )


def axes(sides: Sides) -> Iterator[Undoing]:
    """Yield the best orders and signs of axes, right- and left-handed."""
    of_a, of_b = (rotation_vectors_between(series.wxyz) for series in sides)
    common = of_a.T @ of_b
    for handed in (1.0, -1.0):
        kept = [matrix for matrix in SIGNED_AXES if np.linalg.det(matrix) * handed > 0]
        fits = np.array([float((matrix * common).sum()) for matrix in kept])
        # y = M x, x in B's axes and y in A's.
        matrix = kept[int(np.argmax(fits >= fits.max() - SAME_FIT * abs(fits.max())))]
        sentence = f"the body axes x, y, z of A are {_signed(matrix)} of B"
        mounts = _signed(matrix.T), _signed(matrix)
        if handed > 0:
            remedy = _if_propagated("mount", *(mount.replace(" ", "") for mount in mounts))
        else:
            sentence += ", which is left-handed: an axis is reversed, or two are swapped"
            remedy = (
                f"if A was propagated, take its rates as {mounts[0]}; if B was, take its rates as "
                f"{mounts[1]}"
            )
        undone, mount = _with_rates(matrix.T), matrix.T if handed > 0 else None
        yield Undoing("axes", "swapped or reversed axes", sentence, remedy, undone, mount=mount)


def _signed(matrix: Float64) -> str:
    signs = [("-" if row.sum() < 0 else "") + "xyz"[np.argmax(np.abs(row))] for row in matrix]
    return ", ".join(signs)


def _if_propagated(setting: str, a: str, b: str) -> str:
    """Return how either series may be propagated to arrive at the other: one may be a truth."""
    of_a, of_b = Setting(setting, a), Setting(setting, b)
    return f"if A was propagated, propagate it with {of_a}; if B was, with {of_b}"


# --- rates


def recomposed(series: AttitudeSeries, steps: Float64, rates: str = "body") -> AttitudeSeries:
    """Return a series with other rotations from sample to sample."""
    # Steps of one second, by the rates that begin them.
    t_ns = np.arange(len(series)) * NS_PER_S
    rate = np.append(steps, np.zeros((1, 3)), axis=0)
    return replace(series, wxyz=attitudes(t_ns, rate, q0=series.wxyz[0], rates=rates))


def _with_rates(factor: Float64 | float, less: Float64 | float = 0.0) -> Callable[[Sides], Sides]:
    """Return what multiplies A's rates, by a matrix or a number, and subtracts a rate, rad/s."""
    matrix = np.asarray(factor) * (1 if np.ndim(factor) else np.eye(3))

    def apply(sides: Sides) -> Sides:
        seconds = np.diff(sides.a.t_ns)[:, None] / NS_PER_S
        steps = rotation_vectors_between(sides.a.wxyz) @ matrix.T - seconds * less
        return sides._replace(a=recomposed(sides.a, steps))

    return apply


def _on_other_side(own: str, wanted: str) -> Callable[[Sides], Sides]:
    def apply(sides: Sides) -> Sides:
        steps = rotation_vectors_between(sides.a.wxyz, rates=own)
        return sides._replace(a=recomposed(sides.a, steps, wanted))

    return apply


def _scaled(factor: float) -> str:
    return (
        f"if A was propagated, multiply its rates by {factor:.6g}; if B was, multiply its rates by "
        f"{1 / factor:.6g}"
    )


SCALES = {
    2.0: (": a factor 1/2 is missing in one of them", ""),
    180 / np.pi: (
        ": one of them took degrees for radians",
        f" (see {Setting('rate_unit', 'rad/s|deg/s')})",
    ),
}
"""Ratio of rates -> the mistake that gives it, and the setting."""

SCALE_TOLERANCE = 0.03
"""Relative difference from such a ratio; gyroscopes are not calibrated much better."""

MIN_WINDOWS = 100
"""Windows of which rates are compared, about."""


def scale(sides: Sides, mount: Float64, *, biased: bool = False) -> Undoing | None:
    """Return the ratio of rates; `biased`: whatever constant rate there is besides."""
    of_a, of_b, seconds = _steps(sides, mount)
    stride = max(len(of_a) // MIN_WINDOWS, 1)
    first = np.arange(0, len(of_a), stride)
    y, x, time = (np.add.reduceat(each, first) for each in (of_a, of_b, seconds))
    if biased:
        y, x = (each - time * each.sum(axis=0) / time.sum() for each in (y, x))
    # A's rates have the noise of a gyroscope, and B's attitudes any: it is in no square.
    power, shared = float((y * y).sum()), float((x * y).sum())
    if not power > 0 or not shared > 0:
        return None
    factor = float(f"{shared / power:.6g}")
    ratio = max(factor, 1 / factor)
    near = (SCALES[named] for named in SCALES if abs(ratio / named - 1) < SCALE_TOLERANCE)
    meaning, where = next(near, ("", ""))
    return Undoing(
        "scale",
        f"rates that differ by a factor of {ratio:.6g}",
        f"B turns {factor:.6g} times as fast as A{meaning}",
        _scaled(factor) + where,
        _with_rates(factor),
    )


def rate_bias(sides: Sides, mount: Float64, sensor: Float64 | None = None) -> Undoing:
    """Return the constant rate that one has more than the other.

    `sensor`: the matrix by which A's rates are turned after their bias is subtracted
    """
    of_a, of_b, seconds = _steps(sides, mount)
    bias = (of_a - of_b).sum(axis=0) / seconds.sum()
    x, y, z = np.degrees(-bias) * S_PER_H
    of_a = bias if sensor is None else sensor.T @ bias
    biases = [",".join(f"{v:.9g}" for v in each) for each in (of_a, rotate(mount, -bias))]
    return Undoing(
        "rate bias",
        "a constant rate between them",
        f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h",
        f"{_if_propagated('bias', *biases)}, in rad/s, beside any other",
        _with_rates(1.0, bias),
    )


def _steps(sides: Sides, mount: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the rotations from pair to pair of A and of B, in A's body axes, and their times."""
    of_b = rotate(conjugate(mount), rotation_vectors_between(sides.b.wxyz))
    return rotation_vectors_between(sides.a.wxyz), of_b, np.diff(sides.a.t_ns)[:, None] / NS_PER_S


MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector is proportional to the drift."""


def drift(sides: Sides, alignment: Alignment, frame: str) -> Undoing | None:
    """Return an error that grows at a constant rate about an axis fixed in a frame of B."""
    body, aligned = frame == "body", alignment.apply(sides.b.wxyz)
    between = (conjugate(sides.a.wxyz), aligned) if body else (aligned, conjugate(sides.a.wxyz))
    vectors = log(shorter(multiply(*between)))
    if np.abs(vectors).max() > MAX_RAMP:
        return None
    seconds = (sides.a.t_ns - sides.a.t_ns[0]) / NS_PER_S
    design = np.stack([np.ones_like(seconds), seconds], axis=1)
    (_, slope), *_ = np.linalg.lstsq(design, vectors, rcond=None)
    if body:
        slope = rotate(alignment.mount_wxyz, slope)
    else:
        slope = rotate(conjugate(alignment.reference_wxyz), slope)

    def apply(sides: Sides) -> Sides:
        since = (sides.b.t_ns - sides.b.t_ns[0])[:, None] / NS_PER_S
        back = exp(-since * slope)
        q = sides.b.wxyz
        return sides._replace(
            b=replace(sides.b, wxyz=multiply(q, back) if body else multiply(back, q))
        )

    each = np.degrees(slope) * S_PER_H
    size = float(np.linalg.norm(each))
    x, y, z = (f"{v:.6g}" for v in each)
    return Undoing(
        "drift",
        f"a steady drift of {size:.4g} deg/h in the {frame} frame",
        f"B drifts away at a steady {size:.6g} deg/h about an axis fixed in the {frame} frame",
        f"turn B back by {x}, {y}, {z} deg/h about the axes x, y, z of its {frame} frame",
        apply,
    )


# --- clocks


def clocks(
    sides: Sides, coarse_ns: int, given_ns: int
) -> tuple[Undoing | None, Undoing | None]:
    """Return the offset of B's clock, and how much faster or slower it is, where motion shows it.

    `coarse_ns`: about the offset, ns
    `given_ns`: what was added to B's stamps already, ns
    """
    found = clock_errors(*sides, coarse_ns)
    if found is None:
        return None, None
    offset, change, first_ns = found
    return (
        _offset(offset, coarse_ns, given_ns) if math.isfinite(offset.std) else None,
        _clock_drift(change, coarse_ns, int(sides.b.t_ns[0]) - first_ns) if math.isfinite(change.std) else None,
    )


def _offset(clock: ClockError, coarse_ns: int, given_ns: int) -> Undoing:
    offset_ns = coarse_ns + round(clock.seconds * NS_PER_S)
    late = "late" if offset_ns < 0 else "early"
    amount = _rounded(abs(offset_ns), round(clock.std * NS_PER_S))
    setting = Setting("time_offset", f"{(offset_ns + given_ns) / 1e6:.9g}ms")
    return Undoing(
        "time offset",
        f"a time offset of {duration_text(abs(offset_ns))}",
        f"B is {amount} {late}",
        f"{setting} takes it out",
        lambda sides: sides._replace(b=shifted(sides.b, offset_ns)),
    )


def _clock_drift(clock: ClockError, coarse_ns: int, begin_ns: int) -> Undoing:
    """`begin_ns`: B's first stamp, from where the times of the clock's error begin, ns."""
    at_first = np.array((begin_ns + coarse_ns) / NS_PER_S)
    first_ms = 1e3 * float(clock.at(at_first)) + coarse_ns / 1e6
    ppm, std = abs(clock.ratio) * 1e6, max(clock.std * 1e6, 0.01)
    digits = max(1 - math.floor(math.log10(std)), 0)
    pace = "slow" if clock.ratio > 0 else "fast"
    moved, span = (
        duration_text(round(value * NS_PER_S))
        for value in (round(abs(clock.ratio) * clock.span, 4), round(clock.span, 1))
    )

    def apply(sides: Sides) -> Sides:
        since = sides.b.t_ns - sides.b.t_ns[0]
        added = np.rint(first_ms * 1e6 + clock.ratio * since).astype(np.int64)
        return sides._replace(b=shifted(sides.b, added))

    return Undoing(
        "clock drift",
        f"clocks that differ by {ppm:.3g} ppm",
        f"B's clock is {pace} by {ppm:.{digits}f} +- {std:.{digits}f} ppm against A's: the offset "
        f"between their timestamps changes by {moved} in {span}",
        f"add {first_ms:.6g} ms to B's stamps, and {clock.ratio * 1e6:.6g} ppm of the time since "
        "its first",
        apply,
    )


def _rounded(amount_ns: int, std_ns: int) -> str:
    """Return a duration with its uncertainty, to two digits of that."""
    if not std_ns or std_ns * 1_000_000 < amount_ns:
        return duration_text(amount_ns)
    digits = max(len(str(std_ns)) - 2, 0)
    amount, std = (duration_text(round(value, -digits)) for value in (amount_ns, std_ns))
    return f"{amount} +- {std}"


# --- frames

LEVEL = 1e-3
"""Share of a rotation that may be about a level axis where it is one of the heading."""


def frames(asked: str, alignment: Alignment) -> Undoing:
    """Return other frames than those that the alignment asked for lets free."""
    reference, body = (degrees_text(a) for a in (alignment.reference_rad, alignment.mount_rad))
    name, wanted = alignment.name, alignment.name
    if name == "mean":
        _, x, y, _ = alignment.reference_wxyz
        level = math.hypot(x, y) < LEVEL * math.sin(alignment.reference_rad / 2)
        wanted = "yaw" if level and asked in {"none", "first"} else "mean"
    sentence = f"the reference frames differ by {reference}"
    if name == "mount":
        others = f", and the reference frames by {reference}" if asked != "mean" else ""
        sentence = f"the body frames differ by {body}{others}"
    return Undoing(
        "body frame" if name == "mount" else "reference frame",
        f"{'body' if name == 'mount' else 'reference'} frames that differ by "
        f"{body if name == 'mount' else reference}",
        sentence,
        f"{Setting('align', wanted)} takes it out",
        lambda sides: sides,
        wanted,
    )
