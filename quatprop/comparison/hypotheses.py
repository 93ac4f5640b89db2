"""What an error may come from: hypotheses, each of which undoes one mistake in B.

Each is tried on the data, and gives the errors that are left.
"""

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
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries

    Float64 = NDArray[np.float64]

CLEAR = 10.0
"""What is this many times larger than what is left besides is not by chance."""

EXACT = 1e-12
"""RMS error, rad, below which explanations no longer differ."""

MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector grows with the drift."""

ISOLATED = 0.01
"""Share of the samples that may be called isolated."""


class Misreading(NamedTuple):
    """Numbers taken for what they are not.

    Parameters
    ----------
    order
        Which of B's components, as they were read, are w, x, y and z.
    conjugated
        Whether B is also the conjugate.
    meaning
        What went wrong.
    """

    order: list[int]
    conjugated: bool
    meaning: str

    def undo(self, q: Float64) -> Float64:
        """Return what the numbers should have been."""
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
    "layout and conjugate": Misreading([3, 0, 1, 2], True, f"{_LAST}; besides, {_CONJUGATE}"),
    "layout-first and conjugate": Misreading(
        [1, 2, 3, 0], True, f"{_FIRST}; besides, {_CONJUGATE}"
    ),
}
"""Every misreading by its name."""

SCALES = {
    2.0: "a factor 1/2 is missing in one of them",
    180 / np.pi: "one of them took degrees for radians",
}
"""Ratios of rates that have a name."""

NAMED = 0.02
"""Relative difference of a measured ratio from a named one: gyroscopes are no better calibrated."""


class Tried(NamedTuple):
    """A hypothesis and what it leaves.

    Parameters
    ----------
    name
        A short name, stable for scripts.
    sentence
        What it means.
    error
        The errors that are left, rad.
    """

    name: str
    sentence: str
    error: Float64


def errors_left(pairs: Pairs, alignment: str, b: Float64) -> Float64 | None:
    """Return the errors that are left for other attitudes of B; None if they do not align."""
    try:
        found = align(alignment, pairs.a, b)
    except ComparisonError:
        return None
    return geodesic_angle(pairs.a, found.apply(b))


def misread(pairs: Pairs, alignment: str) -> Iterator[Tried]:
    """Try numbers that were taken for others: layouts and conjugates."""
    for name, misreading in MISREADINGS.items():
        error = errors_left(pairs, alignment, misreading.undo(pairs.b))
        if error is not None:
            yield Tried(name, misreading.meaning, error)


def with_free_reference(pairs: Pairs, alignment: str) -> Iterator[Tried]:
    """Try mistakes once more with free reference frames, where they were not free before."""
    if alignment in ("none", "first"):
        for name, sentence, error in (*misread(pairs, "mean"), *multiplied(pairs, "mean")):
            turned = f"{sentence}; besides, the reference frames are turned (--align mean)"
            yield Tried(f"{name} and reference frame", turned, error)


def turned(pairs: Pairs, alignment: str) -> Iterator[Tried]:
    """Try frames that are turned by a constant rotation."""
    a, b = pairs.a, pairs.b
    if alignment in ("none", "first"):
        found = align("mean", a, b)
        yield Tried(
            "reference frame",
            f"the reference frames are turned by {_degrees(found.reference)}; "
            "--align mean takes it out",
            geodesic_angle(a, found.apply(b)),
        )
    if alignment == "mount":
        return
    body = mean_rotation(multiply(conjugate(b), a))
    yield Tried(
        "body frame",
        f"the body frames are turned by {_degrees(body)}; --align mount takes it out",
        geodesic_angle(a, multiply(b, body)),
    )
    try:
        both = align("mount", a, b)
    except ComparisonError:
        return
    yield Tried(
        "both frames",
        f"the body frames are turned by {_degrees(both.mount)} and the reference frames by "
        f"{_degrees(both.reference)}; --align mount takes it out",
        geodesic_angle(a, both.apply(b)),
    )


def _degrees(q: Float64) -> str:
    return f"{np.degrees(geodesic_angle(IDENTITY, q)):.6g} deg"


def isolated(error: Float64) -> Iterator[Tried]:
    """Try to leave out the few worst samples."""
    few = max(int(len(error) * ISOLATED), 1)
    rest = np.sort(error)[:-few]
    count = int((error > CLEAR * max(rms(rest), EXACT)).sum())
    if 0 < count <= few:
        sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
        yield Tried("isolated samples", sentence, rest)


def multiplied(pairs: Pairs, alignment: str) -> Iterator[Tried]:
    """Try steps multiplied on the other side, scaled, or with a constant rate added."""
    b = pairs.b
    if alignment == "mount":
        try:
            b = align(alignment, pairs.a, b).apply(b)
        except ComparisonError:
            return
    left = log(_short(multiply(b[1:], conjugate(b[:-1]))))
    right = log(_short(multiply(conjugate(b[:-1]), b[1:])))
    true = log(_short(multiply(conjugate(pairs.a[:-1]), pairs.a[1:])))
    for name, sentence, steps, frame in (
        _side("left", "right", left, "body"),
        _side("right", "left", right, "inertial"),
        _scaled(right, true),
        _biased(right, true, np.diff(pairs.t_ns) / NS_PER_S),
    ):
        error = errors_left(pairs, alignment, _multiplied_up(steps, b[0], frame))
        if error is not None:
            yield Tried(name, sentence, error)


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


def _scaled(found: Float64, true: Float64) -> _Steps:
    power, common = float((found**2).sum()), float((found * true).sum())
    scale = common / power if common > 0 else 1.0
    sentence = f"B turns {1 / scale:.6g} times as fast as A{_named(scale)}"
    return _Steps("scale", sentence, scale * found, "body")


def _biased(found: Float64, true: Float64, seconds: Float64) -> _Steps:
    bias = (found - true).sum(axis=0) / seconds.sum()
    x, y, z = np.degrees(bias) * S_PER_H
    sentence = f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h"
    return _Steps("rate bias", sentence, found - seconds[:, None] * bias, "body")


def _short(q: Float64) -> Float64:
    return np.asarray(q * np.where(q[:, :1] < 0, -1.0, 1.0))


def _multiplied_up(steps: Float64, q0: Float64, frame: str) -> Float64:
    """Return the attitudes from steps, rotation vectors, multiplied up from q0."""
    seconds = np.arange(len(steps) + 1) * int(NS_PER_S)
    return attitudes(seconds, np.concatenate([steps, np.zeros((1, 3))]), q0=q0, rates=frame)


def _named(scale: float) -> str:
    ratio = max(scale, 1 / scale)
    for known, meaning in SCALES.items():
        if abs(ratio / known - 1) < NAMED:
            return f": {meaning}"
    return ""


def late(
    a: AttitudeSeries,
    b: AttitudeSeries,
    alignment: str,
    associated: Callable[[AttitudeSeries, AttitudeSeries], Pairs],
) -> Iterator[Tried]:
    """Try another time offset."""
    try:
        offset = find_offset(a, b)
        pairs = associated(a, shifted(b, offset.ns))
    except ComparisonError:
        return
    error = errors_left(pairs, alignment, pairs.b)
    if error is not None:
        late = "late" if offset.ns < 0 else "early"
        sentence = f"B is {duration_text(abs(offset.ns))} {late}; --time-offset auto takes it out"
        yield Tried("time offset", sentence, error)


def drifting(pairs: Pairs, alignment: str) -> Iterator[Tried]:
    """Try an error that grows steadily, in the body or in the reference frame."""
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
        left = np.asarray(np.linalg.norm(vectors - design @ fit, axis=1))
        at_first, slope = np.degrees(np.linalg.norm(fit, axis=1))
        begins = f"from {at_first:.6g} deg on, " if at_first > CLEAR * np.degrees(rms(left)) else ""
        sentence = (
            f"{begins}B drifts away at a steady {slope * S_PER_H:.6g} deg/h about an axis fixed in "
            f"the {frame} frame"
        )
        yield Tried("drift", sentence, left)
