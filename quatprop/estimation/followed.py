"""The part of a gyroscope's motion that a reference follows.

A planar reference does not roll and pitch, whatever the body does. About such an axis its error is
the motion itself: a scale that explains it would be -100 %.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.times import NS_PER_S
from quatprop.estimation.cells import cells_of_attitudes, cells_of_rates
from quatprop.estimation.model import FollowedMotion

if TYPE_CHECKING:
    from quatprop.base.arrays import Bool, Float64
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries

LENGTHS_NS: Final = (100_000_000, 250_000_000, 600_000_000, 1_500_000_000, 5_000_000_000)
"""Lengths of the cells: noise hides motion in short ones, and drift in long ones."""

MIN_SHARE: Final = 0.5
"""A reference that shows less than this share of a rotation does not follow it."""

SIGNIFICANT: Final = 4.0
"""Standard deviations by which the share differs from chance."""

ABOVE_NOISE: Final = 3.0
"""What turns this many times as far as by noise is motion."""

USUAL: Final = 0.75
"""Share of the changes of the rates that shows in which ratio they are on several axes."""

MIN_TURN: Final = np.radians(0.2)
"""Minimum rotation that is mentioned, rad."""

AGREED: Final = 0.9
"""Minimum correlation of two measurements of one rotation, in units that may differ."""

OF_ANOTHER_UNIT: Final = 1.5
"""Rates this many times too large or too small are of another unit: no gyroscope is so far off."""

TINY: Final = np.finfo(float).tiny

MAX_LOOKED_AT: Final = 100_000
"""Samples, from the start, from which the noise of the rates is estimated."""


class Followed(NamedTuple):
    """The motion about three axes.

    `axes`: principal axes of the reference's motion, as columns in body axes, shape ``(3, 3)``
    `share`: share of the rotation about each that the reference shows, shape ``(3,)``; 0 by chance
    `agreement`: correlation of both about each, shape ``(3,)``
    `turn_rad`: how far the gyroscope turns back and forth about each, RMS, shape ``(3,)``, rad
    `moves`: whether this is more than noise, shape ``(3,)``
    """

    axes: Float64
    share: Float64
    agreement: Float64
    turn_rad: Float64
    moves: Float64

    @property
    def factor(self) -> float:
        """By what the rates have to be multiplied where both agree; 1 if that is about right."""
        agreed = self.share[self.agreement > AGREED]
        if not len(agreed) or ((agreed > 1 / OF_ANOTHER_UNIT) & (agreed < OF_ANOTHER_UNIT)).any():
            return 1.0
        return float(agreed.max())

    @property
    def seen(self) -> FollowedMotion:
        """The followed motion; all errors count if the body turns about no other axis."""
        motion = (self.axes * (self.share >= MIN_SHARE)) @ self.axes.T
        others = [k for k in range(3) if k not in self.unseen]
        return FollowedMotion(motion, self.axes.T[others] if self.unseen else np.eye(3))

    @property
    def unseen(self) -> list[int]:
        """The axes about which the body turns, and the reference does not follow."""
        moves = self.moves.astype(bool) & (self.turn_rad > MIN_TURN)
        return [k for k in range(3) if self.share[k] < MIN_SHARE and moves[k]]

    @property
    def tilt(self) -> float:
        """Mean square of the rotation that the reference does not follow, rad^2."""
        return float(sum(self.turn_rad[k] ** 2 for k in self.unseen))


def follow(rates: GyroSeries, reference: AttitudeSeries, offset_ns: int, turn: Float64) -> Followed:
    """Return what a reference follows of a motion.

    `offset_ns`: added to the timestamps of the reference, ns
    `turn`: matrix from the axes of the rates to those of the reference, shape ``(3, 3)``
    """
    both = []
    for length_ns in LENGTHS_NS:
        b = cells_of_attitudes(reference, length_ns)
        a = cells_of_rates(rates, length_ns, b.start_ns + offset_ns)
        first = (a.start_ns - b.start_ns - offset_ns) // length_ns
        (at_b,) = np.nonzero(b.known)
        at_a = at_b - first
        inside = (at_a >= 0) & (at_a < len(a))
        at_a, at_b = at_a[inside], at_b[inside]
        at_a, at_b = at_a[a.known[at_a]], at_b[a.known[at_a]]
        if len(at_a) > 3:  # noqa: PLR2004  # an axis each
            both.append((a.rate[at_a] @ turn.T, b.rate[at_b], length_ns / NS_PER_S))
    if not both:
        return Followed(np.eye(3), np.ones(3), *np.zeros((3, 3)))
    _, axes = np.linalg.eigh(np.sum([y.T @ y / len(y) for _, y, _ in both], axis=0))
    share, agreement, angle, moves = np.zeros((4, 3))
    density = noise_density(rates)
    for x, y, _ in both:
        by_rates, shown = x @ axes, y @ axes
        product, power = (by_rates * shown).sum(axis=0), (by_rates**2).sum(axis=0) + TINY
        correlation = product / np.sqrt(power * ((shown**2).sum(axis=0) + TINY))
        better = (correlation > agreement) & (correlation > SIGNIFICANT / np.sqrt(len(x)))
        share = np.where(better, product / power, share)
        agreement = np.where(better, correlation, agreement)
    for x, _, length_s in both:
        # Of most neighbouring cells: a bias that changes slowly, or once, is not motion.
        steps = _alone(np.diff(x @ axes, axis=0), share >= MIN_SHARE)
        changes = np.quantile(np.abs(steps), USUAL, axis=0) / 1.1503
        spread = changes / np.sqrt(2) * length_s
        angle = np.maximum(angle, spread)
        moves = np.maximum(moves, spread > ABOVE_NOISE * density * np.sqrt(length_s))
    return Followed(axes, share, agreement, angle, moves)


def _alone(steps: Float64, follows: Bool) -> Float64:
    """Return changes of rates less what those that are followed explain: axes are not aligned.

    Twice, the second time without those that it explains least: a bias may jump.
    """
    rest, usual = steps.copy(), np.ones(len(steps), np.bool_)
    for _ in range(2):
        known = steps[:, follows]
        by = np.linalg.lstsq(known[usual], steps[usual][:, ~follows], rcond=None)[0]
        rest[:, ~follows] = steps[:, ~follows] - known @ by
        size = np.linalg.norm(rest[:, ~follows], axis=1)
        usual = size <= np.quantile(size, USUAL)
    return rest


def noise_density(rates: GyroSeries) -> float:
    """Return the density of the white noise of rates, by third differences, rad/s/sqrt(Hz)."""
    some = rates[:MAX_LOOKED_AT]
    changes = np.median(np.abs(np.diff(some.rate, n=3, axis=0)), axis=0) / 0.6745
    interval_s = float(np.median(np.diff(some.t_ns))) / NS_PER_S
    # of white noise, the variance of third differences is 20 times that of the samples
    return float(np.sqrt((changes**2).mean() / 20 * interval_s))
