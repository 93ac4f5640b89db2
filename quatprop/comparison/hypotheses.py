"""Hypotheses about the cause of an error: each undoes one mistake in B, and is tried out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align, mean_rotation
from quatprop.comparison.association import shifted
from quatprop.comparison.clocks import find_offset
from quatprop.comparison.statistics import NS_PER_S, S_PER_H, rms
from quatprop.errors import ComparisonError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, log, multiply
from quatprop.rendering import degrees_text
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries

    Float64 = NDArray[np.float64]

CLEAR = 10.0
"""A quantity this many times larger than the rest is significant."""

EXACT = 1e-12
"""RMS error, rad, below which hypotheses are equally good."""

MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector is proportional to the drift."""

ISOLATED = 0.01
"""Share of the samples that may be isolated errors."""


class Misreading(NamedTuple):
    """Quaternion components read in the wrong order or direction.

    Parameters
    ----------
    order
        Which of B's components, as they were read, are w, x, y and z.
    conjugated
        Whether B is also the conjugate.
    meaning
        What the mistake was, in a sentence.
    """

    order: list[int]
    conjugated: bool
    meaning: str

    def undo(self, q: Float64) -> Float64:
        """Return the quaternions as they should have been read."""
        return conjugate(q[:, self.order]) if self.conjugated else q[:, self.order]


_CONJUGATE = (
    "B is the conjugate of A: one of them is reference to body instead of body to reference, or "
    "JPL read as Hamilton"
)
_LAST = "B is scalar-last and was read as scalar-first, or A the other way round"
_FIRST = "B is scalar-first and was read as scalar-last, or A the other way round"

MISREADINGS = {
    "conjugate": Misreading([0, 1, 2, 3], True, _CONJUGATE),
    "layout": Misreading([3, 0, 1, 2], False, _LAST),
    "layout-first": Misreading([1, 2, 3, 0], False, _FIRST),
    "layout and conjugate": Misreading([3, 0, 1, 2], True, f"{_LAST}; also, {_CONJUGATE}"),
    "layout-first and conjugate": Misreading([1, 2, 3, 0], True, f"{_FIRST}; also, {_CONJUGATE}"),
}
"""Name -> misreading."""

SCALES = {
    2.0: "a factor 1/2 is missing in one of them",
    180 / np.pi: "one of them took degrees for radians",
}
"""Ratio of rates -> the mistake that gives it."""

SCALE_TOLERANCE = 0.02
"""Relative difference from such a ratio; gyroscopes are not calibrated much better."""


class Hypothesis(NamedTuple):
    """A possible cause and the error that remains without it.

    Parameters
    ----------
    name
        A short name, stable for scripts.
    sentence
        What it means.
    remaining
        The errors that remain, rad, shape ``(N,)``.
    remedy
        The setting that takes the error out, where one does.
    """

    name: str
    sentence: str
    remaining: Float64
    remedy: Setting | None = None


def remaining_errors(pairs: Pairs, alignment: str, b: Float64) -> Float64 | None:
    """Return the errors of B with other attitudes, rad; None if those cannot be aligned."""
    try:
        return geodesic_angle(pairs.a, align(alignment, pairs.a, b).apply(b))
    except ComparisonError:
        return None


def misreadings(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try wrong layouts and conjugates."""
    for name, misreading in MISREADINGS.items():
        error = remaining_errors(pairs, alignment, misreading.undo(pairs.b))
        if error is not None:
            yield Hypothesis(name, misreading.meaning, error)


def with_reference_aligned(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try mistakes together with a rotated reference frame, where it was not aligned before."""
    if alignment in ("none", "first"):
        for mistake in (*misreadings(pairs, "mean"), *propagations(pairs, "mean")):
            yield Hypothesis(
                f"{mistake.name} and reference frame",
                f"{mistake.sentence}; also, the reference frames differ",
                mistake.remaining,
            )


def frame_rotations(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try frames that differ by a constant rotation."""
    a, b = pairs.a, pairs.b
    if alignment in ("none", "first"):
        mean = align("mean", a, b)
        yield Hypothesis(
            "reference frame",
            f"the reference frames differ by {degrees_text(mean.reference_rad)}",
            geodesic_angle(a, mean.apply(b)),
            Setting("align", "mean"),
        )
    if alignment == "mount":
        return
    body = mean_rotation(multiply(conjugate(b), a))
    angle = float(geodesic_angle(IDENTITY, body))
    yield Hypothesis(
        "body frame",
        f"the body frames differ by {degrees_text(angle)}",
        geodesic_angle(a, multiply(b, body)),
        Setting("align", "mount"),
    )
    try:
        both = align("mount", a, b)
    except ComparisonError:
        return
    yield Hypothesis(
        "both frames",
        f"the body frames differ by {degrees_text(both.mount_rad)} and the reference frames by "
        f"{degrees_text(both.reference_rad)}",
        geodesic_angle(a, both.apply(b)),
        Setting("align", "mount"),
    )


def isolated_samples(error: Float64) -> Iterator[Hypothesis]:
    """Try to leave out the few worst samples."""
    few = max(int(len(error) * ISOLATED), 1)
    rest = np.sort(error)[:-few]
    count = int((error > CLEAR * max(rms(rest), EXACT)).sum())
    if 0 < count <= few:
        sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
        yield Hypothesis("isolated samples", sentence, rest)


def propagations(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try steps of B multiplied on the other side, scaled, or with a constant rate subtracted."""
    b = pairs.b
    if alignment == "mount":
        try:
            b = align(alignment, pairs.a, b).apply(b)
        except ComparisonError:
            return
    left = log(_short(multiply(b[1:], conjugate(b[:-1]))))
    right = log(_short(multiply(conjugate(b[:-1]), b[1:])))
    of_a = log(_short(multiply(conjugate(pairs.a[:-1]), pairs.a[1:])))
    for name, sentence, steps, frame in (
        _side("left", "right", left, "body"),
        _side("right", "left", right, "inertial"),
        _scaled(right, of_a),
        _biased(right, of_a, np.diff(pairs.t_ns) / NS_PER_S),
    ):
        error = remaining_errors(pairs, alignment, _propagated(steps, b[0], frame))
        if error is not None:
            yield Hypothesis(name, sentence, error)


class _Steps(NamedTuple):
    """Steps that B should have taken, rotation vectors, and the frame they are resolved in."""

    name: str
    sentence: str
    steps: Float64
    frame: str


def _side(of_b: str, of_a: str, steps: Float64, frame: str) -> _Steps:
    sentence = (
        f"B multiplies on the {of_b} what A multiplies on the {of_a}: body rates against inertial "
        "rates"
    )
    return _Steps("side", sentence, steps, frame)


def _scaled(of_b: Float64, of_a: Float64) -> _Steps:
    power, common = float((of_b**2).sum()), float((of_b * of_a).sum())
    scale = common / power if common > 0 else 1.0
    sentence = f"B turns {1 / scale:.6g} times as fast as A{_scale_meaning(scale)}"
    return _Steps("scale", sentence, scale * of_b, "body")


def _biased(of_b: Float64, of_a: Float64, seconds: Float64) -> _Steps:
    bias = (of_b - of_a).sum(axis=0) / seconds.sum()
    x, y, z = np.degrees(bias) * S_PER_H
    sentence = f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h"
    return _Steps("rate bias", sentence, of_b - seconds[:, None] * bias, "body")


def _short(q: Float64) -> Float64:
    return np.asarray(q * np.where(q[:, :1] < 0, -1.0, 1.0))


def _propagated(steps: Float64, q0: Float64, frame: str) -> Float64:
    """Return the attitudes from q0 on after steps, rotation vectors."""
    seconds = np.arange(len(steps) + 1) * int(NS_PER_S)
    return attitudes(seconds, np.concatenate([steps, np.zeros((1, 3))]), q0=q0, rates=frame)


def _scale_meaning(scale: float) -> str:
    ratio = max(scale, 1 / scale)
    for named, meaning in SCALES.items():
        if abs(ratio / named - 1) < SCALE_TOLERANCE:
            return f": {meaning}"
    return ""


def time_offsets(
    a: AttitudeSeries,
    b: AttitudeSeries,
    alignment: str,
    match: Callable[[AttitudeSeries, AttitudeSeries], Pairs],
) -> Iterator[Hypothesis]:
    """Try another time offset."""
    try:
        offset = find_offset(a, b)
        pairs = match(a, shifted(b, offset.ns))
    except ComparisonError:
        return
    error = remaining_errors(pairs, alignment, pairs.b)
    if error is not None:
        late = "late" if offset.ns < 0 else "early"
        sentence = f"B is {duration_text(abs(offset.ns))} {late}"
        yield Hypothesis("time offset", sentence, error, Setting("time_offset", "auto"))


def steady_drifts(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try an error that grows at a constant rate, in the body or in the reference frame."""
    try:
        b = align(alignment, pairs.a, pairs.b).apply(pairs.b)
    except ComparisonError:
        return
    seconds = (pairs.t_ns - pairs.t_ns[0]) / NS_PER_S
    design = np.stack([np.ones_like(seconds), seconds], axis=1)
    for frame, between in (
        ("body", multiply(conjugate(pairs.a), b)),
        ("reference", multiply(b, conjugate(pairs.a))),
    ):
        vectors = log(_short(between))
        if np.abs(vectors).max() > MAX_RAMP:
            continue
        fit, *_ = np.linalg.lstsq(design, vectors, rcond=None)
        remaining = np.asarray(np.linalg.norm(vectors - design @ fit, axis=1))
        at_first, slope = np.degrees(np.linalg.norm(fit, axis=1))
        begins = (
            f"from {at_first:.6g} deg on, " if at_first > CLEAR * np.degrees(rms(remaining)) else ""
        )
        sentence = (
            f"{begins}B drifts away at a steady {slope * S_PER_H:.6g} deg/h about an axis fixed in "
            f"the {frame} frame"
        )
        yield Hypothesis("drift", sentence, remaining)
