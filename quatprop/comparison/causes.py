"""What may explain an error: hypotheses, each tried on the data.

A hypothesis undoes one mistake in B and looks at what error is left. It is reported only if that
is less than a tenth of the error before; of several that do about equally well, the one that
stands first here, which is the simplest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align, mean_rotation
from quatprop.comparison.clocks import find_offset
from quatprop.comparison.figures import NS_PER_S, S_PER_H, rms
from quatprop.errors import ComparisonError
from quatprop.propagate import attitudes
from quatprop.quaternion import IDENTITY, conjugate, geodesic_angle, log, multiply
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries

    Float64 = NDArray[np.float64]

FACTOR = 10.0
"""An explanation leaves at most the error over this."""

AS_GOOD = 3.0
"""Explanations within this factor of the best are as good: the simplest is named."""

NO_ERROR = 1e-9
"""RMS error, rad, that needs no explanation."""

EXACT = 1e-12
"""RMS error, rad, below which explanations no longer differ."""

MIN_PAIRS = 10
"""Fewer pairs can be explained by almost anything."""

MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector grows with the drift."""

ISOLATED = 0.01
"""Share of the samples that may be called isolated."""

ONE_TO_ONE = 1e-3
"""Relative difference of two scales that is none."""


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


@dataclass(frozen=True, slots=True)
class Cause:
    """What explains most of an error.

    Parameters
    ----------
    name
        A short name, stable for scripts.
    sentence
        What it means.
    rms_before, rms_after
        RMS error without and with the explanation, rad.
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float


class _Tried(NamedTuple):
    name: str
    sentence: str
    error: Float64


def likely_cause(
    pairs: Pairs,
    alignment: str,
    error: Float64,
    again: Callable[[int], Pairs],
    series: tuple[AttitudeSeries, AttitudeSeries],
) -> Cause | None:
    """Return what explains an error, if something does.

    Parameters
    ----------
    pairs
        The attitudes as they were read.
    alignment
        How they were aligned: a name of :data:`quatprop.comparison.alignment.ALIGNMENTS`.
    error
        The errors after that, rad, shape ``(N,)``.
    again
        Brings the series together once more with so many ns added to B's stamps.
    series
        A and B, B in A's clock as far as it is known.
    """
    before = rms(error)
    if before <= NO_ERROR or len(pairs) < MIN_PAIRS:
        return None
    every = [
        *_misread(pairs, alignment),
        *_turned(pairs, alignment),
        *_isolated(error),
        *_multiplied(pairs, alignment),
        *_shifted(series, alignment, again),
        *_drifting(pairs, alignment),
        *_with_free_reference(pairs, alignment),
    ]
    left = [rms(tried.error) for tried in every]
    best = min(left, default=before)
    if best > before / FACTOR:
        return None
    limit = min(max(AS_GOOD * best, EXACT), before / FACTOR)
    tried, after = next(pair for pair in zip(every, left, strict=True) if pair[1] <= limit)
    return Cause(tried.name, tried.sentence, before, after)


def _aligned(pairs: Pairs, alignment: str, b: Float64) -> Float64 | None:
    """Return the errors that are left for other attitudes of B; None if they do not align."""
    try:
        found = align(alignment, pairs.a, b)
    except ComparisonError:
        return None
    return geodesic_angle(pairs.a, found.apply(b))


def _misread(pairs: Pairs, alignment: str) -> Iterator[_Tried]:
    for name, misreading in MISREADINGS.items():
        error = _aligned(pairs, alignment, misreading.undo(pairs.b))
        if error is not None:
            yield _Tried(name, misreading.meaning, error)


def _with_free_reference(pairs: Pairs, alignment: str) -> Iterator[_Tried]:
    """Try mistakes once more with free reference frames, where they were not free before."""
    if alignment in ("none", "first"):
        for name, sentence, error in (*_misread(pairs, "mean"), *_multiplied(pairs, "mean")):
            turned = f"{sentence}; besides, the reference frames are turned (--align mean)"
            yield _Tried(f"{name} and reference frame", turned, error)


def _turned(pairs: Pairs, alignment: str) -> Iterator[_Tried]:
    """Try frames that are turned by a constant rotation."""
    a, b = pairs.a, pairs.b
    if alignment in ("none", "first"):
        found = align("mean", a, b)
        yield _Tried(
            "reference frame",
            f"the reference frames are turned by {_degrees(found.reference)}; "
            "--align mean takes it out",
            geodesic_angle(a, found.apply(b)),
        )
    if alignment == "mount":
        return
    body = mean_rotation(multiply(conjugate(b), a))
    yield _Tried(
        "body frame",
        f"the body frames are turned by {_degrees(body)}; --align mount takes it out",
        geodesic_angle(a, multiply(b, body)),
    )
    try:
        both = align("mount", a, b)
    except ComparisonError:
        return
    yield _Tried(
        "both frames",
        f"the body frames are turned by {_degrees(both.mount)} and the reference frames by "
        f"{_degrees(both.reference)}; --align mount takes it out",
        geodesic_angle(a, both.apply(b)),
    )


def _degrees(q: Float64) -> str:
    return f"{np.degrees(geodesic_angle(IDENTITY, q)):.6g} deg"


def _isolated(error: Float64) -> Iterator[_Tried]:
    """Try to leave out the few worst samples."""
    few = max(int(len(error) * ISOLATED), 1)
    rest = np.sort(error)[:-few]
    count = int((error > FACTOR * max(rms(rest), EXACT)).sum())
    if 0 < count <= few:
        sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
        yield _Tried("isolated samples", sentence, rest)


def _multiplied(pairs: Pairs, alignment: str) -> Iterator[_Tried]:
    """Try steps multiplied on the other side, scaled, or with a constant rate added."""
    b = pairs.b
    left = log(_short(multiply(b[1:], conjugate(b[:-1]))))
    right = log(_short(multiply(conjugate(b[:-1]), b[1:])))
    for steps, frame, sentence in (
        (left, "body", "B multiplies on the left what A multiplies on the right"),
        (right, "inertial", "B multiplies on the right what A multiplies on the left"),
    ):
        error = _aligned(pairs, alignment, _multiplied_up(steps, b[0], frame))
        if error is not None:
            yield _Tried("side", f"{sentence}: body rates against inertial rates", error)
    true = log(_short(multiply(conjugate(pairs.a[:-1]), pairs.a[1:])))
    power = float((right**2).sum())
    scale = float((right * true).sum()) / power if power else 0.0
    if scale > 0 and abs(scale - 1) > ONE_TO_ONE:
        error = _aligned(pairs, alignment, _multiplied_up(scale * right, b[0], "body"))
        if error is not None:
            sentence = f"B turns {1 / scale:.6g} times as fast as A{_named(scale)}"
            yield _Tried("scale", sentence, error)
    seconds = np.diff(pairs.t_ns) / NS_PER_S
    bias = (right - true).sum(axis=0) / seconds.sum()
    error = _aligned(
        pairs, alignment, _multiplied_up(right - seconds[:, None] * bias, b[0], "body")
    )
    if error is not None:
        x, y, z = np.degrees(bias) * S_PER_H
        sentence = (
            f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h"
        )
        yield _Tried("rate bias", sentence, error)


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


def _shifted(
    series: tuple[AttitudeSeries, AttitudeSeries], alignment: str, again: Callable[[int], Pairs]
) -> Iterator[_Tried]:
    """Try another time offset."""
    try:
        offset = find_offset(*series)
        pairs = again(offset.ns)
    except ComparisonError:
        return
    error = _aligned(pairs, alignment, pairs.b)
    if error is not None:
        late = "late" if offset.ns < 0 else "early"
        sentence = f"B is {duration_text(abs(offset.ns))} {late}; --time-offset auto takes it out"
        yield _Tried("time offset", sentence, error)


def _drifting(pairs: Pairs, alignment: str) -> Iterator[_Tried]:
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
        begins = (
            f"from {at_first:.6g} deg on, " if at_first > FACTOR * np.degrees(rms(left)) else ""
        )
        sentence = (
            f"{begins}B drifts away at a steady {slope * S_PER_H:.6g} deg/h about an axis fixed in "
            f"the {frame} frame"
        )
        yield _Tried("drift", sentence, left)
