"""Hypotheses about the cause of an error: each undoes one mistake in B, and is tried out."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align, mean_rotation
from quatprop.comparison.statistics import S_PER_H
from quatprop.errors import ComparisonError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    geodesic_angle,
    log,
    multiply,
    shorter,
)
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.rendering import degrees_text
from quatprop.series.blocks import rms
from quatprop.text import Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs


CLEAR = 10.0
"""A quantity this many times larger than the rest is significant."""

EXACT = 1e-12
"""RMS error, rad, below which hypotheses are equally good."""

MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector is proportional to the drift."""

NOTICEABLE = 0.9
"""Share of an error that may remain without what is called its likely cause."""

ISOLATED = 0.01
"""Share of the samples that may be isolated errors."""


LEVEL = 1e-3
"""Share of a rotation that may be about a level axis where it is one of the heading."""

ALIGN_MEAN = Setting("align", "mean")


class Cause(NamedTuple):
    """What explains most of an error.

    `name`: a short name, stable for scripts
    `rms_before`, `rms_after`: RMS error without and with the explanation, rad
    `remedy`: the setting that takes the error out of the comparison, or with which to read or
        propagate
    `window_ns`: where the cause was found in rotations over windows, their length, ns: the RMS
        errors are those of the rotations, less a constant rate. None: they are those of the
        attitudes
    `also`: a second cause, of which the first hides the effect
    `total_before`, `total_after`: RMS errors of the attitudes without and with the explanation,
        rad, where it was found in rotations over windows and they are known
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float
    remedy: str | None = None
    window_ns: int | None = None
    also: Cause | None = None
    total_before: float | None = None
    total_after: float | None = None

    def leaves(self, share: float) -> bool:
        """Return whether more than this share of the attitudes' error remains without it."""
        if self.total_before is None or self.total_after is None:
            return False
        return self.total_after > share * self.total_before

    @property
    def explains_little(self) -> bool:
        """Whether the error of the attitudes is known to be nearly the same without it."""
        return self.leaves(NOTICEABLE)

    @property
    def advice(self) -> str:
        """The sentence with the remedy; not for a regression, which the remedy would hide."""
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence


def causes_of_errors(pairs: Pairs, alignment: str, before: float) -> Iterator[Cause]:
    """Yield what may explain the errors, and how much of them remains without it.

    `before`: the RMS error, rad
    """
    a, b = pairs.a, pairs.b
    aligned = align(alignment, a, b).apply(b)
    frame_is_free = alignment in ("none", "first", "yaw")
    if frame_is_free:
        # Heading is none of the error where it was taken out.
        turned = aligned if alignment == "yaw" else b
        mean = align("mean", a, turned)
        sentence = f"the reference frames differ by {degrees_text(mean.reference_rad)}"
        yield Cause(
            "reference frame",
            sentence,
            before,
            _rms(a, mean.apply(turned)),
            _frame_remedy(alignment, mean),
        )
    if alignment != "mount":
        body = mean_rotation(multiply(conjugate(b), a))
        angle = degrees_text(float(geodesic_angle(IDENTITY, body)))
        remedy = f"{Setting('align', 'mount')} takes it out"
        sentence = f"the body frames differ by {angle}"
        yield Cause("body frame", sentence, before, _rms(a, multiply(b, body)), remedy)
    bias, unbiased = _without_bias(pairs, aligned if alignment == "mount" else b)
    with suppress(ComparisonError):
        yield Cause("rate bias", bias, before, aligned_rms(alignment, a, unbiased))
    if frame_is_free:
        mean = align("mean", a, unbiased)
        angle = degrees_text(mean.reference_rad, 4)
        sentence = f"the reference frames differ by {angle}; also, {bias}"
        remedy, after = f"{ALIGN_MEAN} takes the frames out", _rms(a, mean.apply(unbiased))
        yield Cause("rate bias and reference frame", sentence, before, after, remedy)
    yield from _steady_drifts(pairs, aligned, before)


def _frame_remedy(alignment: str, mean: Alignment) -> str | None:
    """Return how reference frames are aligned; with the heading alone free, a tilt is an error."""
    if alignment == "yaw":
        return None
    _, x, y, _ = mean.reference_wxyz
    heading = math.hypot(x, y) < LEVEL * math.sin(mean.reference_rad / 2)
    setting = Setting("align", "yaw") if heading else ALIGN_MEAN
    return f"{setting} takes it out"


def _rms(a: Float64, b: Float64) -> float:
    return rms(geodesic_angle(a, b))


def aligned_rms(alignment: str, a: Float64, b: Float64) -> float:
    """Return the RMS error of attitudes that are aligned, rad."""
    return _rms(a, align(alignment, a, b).apply(b))


def isolated_samples(error: Float64) -> Cause | None:
    """Return a few outliers as the cause, if they are; the errors are in rising order."""
    few = max(int(len(error) * ISOLATED), 1)
    rest = rms(error[:-few])
    count = int((error > CLEAR * max(rest, EXACT)).sum())
    sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
    return Cause("isolated samples", sentence, rms(error), rest) if 0 < count <= few else None


def _without_bias(pairs: Pairs, b: Float64) -> tuple[str, Float64]:
    """Subtract a constant rate from B's steps; return what it is, and the attitudes."""
    of_a, of_b = rotation_vectors_between(pairs.a), rotation_vectors_between(b)
    seconds = np.diff(pairs.t_ns) / NS_PER_S
    bias = (of_b - of_a).sum(axis=0) / seconds.sum()
    x, y, z = np.degrees(bias) * S_PER_H
    sentence = f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h"
    # Steps of one second, by the rates that begin them.
    t_ns = np.arange(len(b)) * NS_PER_S
    rate = np.append(of_b - seconds[:, None] * bias, np.zeros((1, 3)), axis=0)
    return sentence, attitudes(t_ns, rate, q0=b[0])


def _steady_drifts(pairs: Pairs, b: Float64, before: float) -> Iterator[Cause]:
    """Try an error that grows at a constant rate, in the body or in the reference frame."""
    seconds = (pairs.t_ns - pairs.t_ns[0]) / NS_PER_S
    design = np.stack([np.ones_like(seconds), seconds], axis=1)
    for frame, between in (
        ("body", multiply(conjugate(pairs.a), b)),
        ("reference", multiply(b, conjugate(pairs.a))),
    ):
        vectors = log(shorter(between))
        if np.abs(vectors).max() > MAX_RAMP:
            continue
        fit, *_ = np.linalg.lstsq(design, vectors, rcond=None)
        after = rms(np.asarray(np.linalg.norm(vectors - design @ fit, axis=1)))
        at_first, slope = np.degrees(np.linalg.norm(fit, axis=1))
        begins = f"from {at_first:.6g} deg on, " if at_first > CLEAR * np.degrees(after) else ""
        sentence = (
            f"{begins}B drifts away at a steady {slope * S_PER_H:.6g} deg/h about an axis fixed in "
            f"the {frame} frame"
        )
        yield Cause("drift", sentence, before, after)
