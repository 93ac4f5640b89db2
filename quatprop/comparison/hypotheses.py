"""Hypotheses about the cause of an error: each undoes one mistake in B, and is tried out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.alignment import align, mean_rotation
from quatprop.comparison.statistics import NS_PER_S, S_PER_H, rms
from quatprop.errors import ComparisonError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import IDENTITY, conjugate, geodesic_angle, log, multiply
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.rendering import degrees_text
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64
    from quatprop.comparison.association import Pairs


CLEAR = 10.0
"""A quantity this many times larger than the rest is significant."""

EXACT = 1e-12
"""RMS error, rad, below which hypotheses are equally good."""

MAX_RAMP = 2.0
"""Error, rad, up to which its rotation vector is proportional to the drift."""

FRAME_AND_BIAS = "rate bias and reference frame"
"""Name of the two together."""

ISOLATED = 0.01
"""Share of the samples that may be isolated errors."""


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


def constant_rotations(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try frames that differ by a constant rotation."""
    if alignment in ("none", "first"):
        mean = align("mean", pairs.a, pairs.b)
        yield Hypothesis(
            "reference frame",
            f"the reference frames differ by {degrees_text(mean.reference_rad)}",
            geodesic_angle(pairs.a, mean.apply(pairs.b)),
            Setting("align", "mean"),
        )
    if alignment != "mount":
        body = mean_rotation(multiply(conjugate(pairs.b), pairs.a))
        angle = float(geodesic_angle(IDENTITY, body))
        yield Hypothesis(
            "body frame",
            f"the body frames differ by {degrees_text(angle)}",
            geodesic_angle(pairs.a, multiply(pairs.b, body)),
            Setting("align", "mount"),
        )


def isolated_samples(error: Float64) -> Iterator[Hypothesis]:
    """Try to leave out the few worst samples, the last of errors in rising order."""
    few = max(int(len(error) * ISOLATED), 1)
    rest = error[:-few]
    count = int((error > CLEAR * max(rms(rest), EXACT)).sum())
    if 0 < count <= few:
        sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
        yield Hypothesis("isolated samples", sentence, rest)


def rate_biases(pairs: Pairs, alignment: str) -> Iterator[Hypothesis]:
    """Try a constant rate subtracted from B's steps; also with the reference frames aligned."""
    b = pairs.b
    if alignment == "mount":
        try:
            b = align(alignment, pairs.a, b).apply(b)
        except ComparisonError:
            return
    of_a, of_b = rotation_vectors_between(pairs.a), rotation_vectors_between(b)
    seconds = np.diff(pairs.t_ns) / NS_PER_S
    bias = (of_b - of_a).sum(axis=0) / seconds.sum()
    x, y, z = np.degrees(bias) * S_PER_H
    sentence = f"B's body rates are larger than A's by a constant {x:.4g}, {y:.4g}, {z:.4g} deg/h"
    unbiased = _propagated(of_b - seconds[:, None] * bias, b[0])
    error = remaining_errors(pairs, alignment, unbiased)
    if error is not None:
        yield Hypothesis("rate bias", sentence, error)
    if alignment in ("none", "first"):
        mean = align("mean", pairs.a, unbiased)
        frames = f"the reference frames differ by {degrees_text(mean.reference_rad, 4)}; also, "
        error = geodesic_angle(pairs.a, mean.apply(unbiased))
        yield Hypothesis(FRAME_AND_BIAS, frames + sentence, error, Setting("align", "mean"))


def _short(q: Float64) -> Float64:
    return np.asarray(q * np.where(q[:, :1] < 0, -1.0, 1.0))


def _propagated(steps: Float64, q0: Float64) -> Float64:
    """Return the attitudes from q0 on after steps, rotation vectors."""
    seconds = np.arange(len(steps) + 1) * int(NS_PER_S)
    return attitudes(seconds, np.concatenate([steps, np.zeros((1, 3))]), q0=q0)


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
