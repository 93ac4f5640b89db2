"""A stationary period, and the bias estimated from it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.text import Remark, Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.conditioning.quantisation import Levels


AT_REST = 0.05
"""Maximum scatter of rates at rest, rad/s."""

ORDINARY_CHANGE = math.radians(0.1)
"""Change of the bias between stationary periods, rad/s, that needs no remark: that of MEMS
gyroscopes changes by hundredths of a deg/s as they warm up. The sigma of the bias includes it."""

SAME = 1e-6
"""Scatter, as a share of the mean, that is only rounding."""

WIDENS = 3.0
"""Difference of means, in standard errors, above which it increases the sigma of the bias."""


class OtherRest(NamedTuple):
    """The other stationary period with the most different mean rate.

    `first_ns`, `last_ns`: first and last timestamp, ns
    `difference_rad_s`: difference of the mean rate on the worst axis, rad/s
    """

    first_ns: int
    last_ns: int
    difference_rad_s: float


class StaticPeriod(NamedTuple):
    """A period of a log in which the sensor was at rest.

    `first_ns`, `last_ns`: first and last timestamp, ns
    `samples`: number of samples
    `mean_rad_s`: mean rate, which is the bias, shape ``(3,)``, rad/s
    `scatter_rad_s`: RMS deviation of the rates from the mean, over all three axes, rad/s
    `noisiest_rad_s`: RMS deviation on the axis where it is largest, rad/s
    `steady`: signals that confirm it: ``"rate"``, ``"accelerometer"``, ``"orientation"``
    `searched_first_ns`, `searched_last_ns`: part of the log that was searched, ns: all of it, even
        if only a part is propagated
    `other`: the stationary period that differs most, by more than noise; None: none differs
    `spread_rad_s`: uncertainty of the bias from the different means of other periods, on the worst
        axis, rad/s
    `levels`: quantisation levels of the axes with noise below the step
    """

    first_ns: int
    last_ns: int
    samples: int
    mean_rad_s: Float64
    scatter_rad_s: float
    noisiest_rad_s: float
    steady: tuple[str, ...]
    searched_first_ns: int
    searched_last_ns: int
    other: OtherRest | None
    spread_rad_s: float
    levels: tuple[Levels, ...] = ()

    @property
    def span_s(self) -> float:
        """Duration, s."""
        return (self.last_ns - self.first_ns) / NS_PER_S

    @property
    def noise_density(self) -> float:
        """Noise density of the rates, rad/s/sqrt(Hz)."""
        coarsest = max((each.step for each in self.levels), default=0.0)
        # Of three axes that are equally noisy, one scatters most by chance.
        noisiest = self.noisiest_rad_s / (1 + WIDENS / math.sqrt(2 * self.samples))
        scatter = max(self.scatter_rad_s / math.sqrt(3), noisiest, coarsest / math.sqrt(12))
        return scatter * math.sqrt(self.span_s / (self.samples - 1))

    def bias_sigma(self, density: float) -> float:
        """Return the standard deviation of the mean due to noise and quantisation, rad/s.

        `density`: noise density, rad/s/sqrt(Hz)
        """
        return math.hypot(density / math.sqrt(self.span_s), self.quantisation_rad_s)

    @property
    def quantisation_rad_s(self) -> float:
        """Standard deviation of the bias due to quantisation, of the worst axis, rad/s."""
        return max((each.sigma for each in self.levels), default=0.0)

    @property
    def hides_errors(self) -> bool:
        """Whether all rates are equal, and the quantisation step is unknown."""
        rounding = SAME * float(np.linalg.norm(self.mean_rad_s))
        return not self.levels and self.scatter_rad_s <= rounding

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on the period."""
        found = {
            "rest-moves": self._moves(),
            "rest-unconfirmed": self._unconfirmed(),
            "rests-differ": self._differs(),
            "rest-coarse": self._coarse(),
            "rest-one-value": self._one_value(),
        }
        return tuple(Remark(code, text) for code, text in found.items() if text)

    def _moves(self) -> str:
        if self.scatter_rad_s <= AT_REST:
            return ""
        return (
            f"the rates from {self.first_ns} to {self.last_ns} ns, from which the bias is "
            f"estimated, scatter by {self.scatter_rad_s:.3g} rad/s: the body moves there"
        )

    def _unconfirmed(self) -> str:
        degrees = np.degrees(np.linalg.norm(self.mean_rad_s))
        if self.steady != ("rate",) or not degrees:
            return ""
        return (
            "no accelerometer and no orientation confirms the stationary period that the bias "
            f"is estimated from: a steady rotation at {degrees:.3g} deg/s would look the same"
        )

    def _differs(self) -> str:
        # The mean of either rest is off by what the step of the rates hides.
        by_steps = WIDENS * math.sqrt(2) * self.quantisation_rad_s
        if self.other is None or self.other.difference_rad_s <= max(ORDINARY_CHANGE, by_steps):
            return ""
        degrees = math.degrees(self.other.difference_rad_s)
        way = Setting("bias", f"static@{self.other.first_ns}..{self.other.last_ns}")
        return (
            f"the mean rate at rest from {self.first_ns} to {self.last_ns} ns differs by "
            f"{degrees:.3g} deg/s from the mean of another rest, {way}: the bias changed "
            "between the two, or the body turned steadily in one of them"
        )

    def _coarse(self) -> str:
        sigma = self.quantisation_rad_s
        if sigma <= self.scatter_rad_s / math.sqrt(3 * self.samples):
            return ""
        step = math.degrees(max(each.step for each in self.levels))
        return (
            f"the rates are in steps of up to {step:.3g} deg/s, and the stationary period shows "
            f"hardly more than one: the bias is known only to {math.degrees(sigma):.2g} deg/s "
            "(1 sigma)"
        )

    def _one_value(self) -> str:
        if not self.hides_errors:
            return ""
        return (
            f"the rates do not change from {self.first_ns} to {self.last_ns} ns, from where the "
            "bias is taken, and the log shows no step in which they are given: how well the bias "
            "is known, and with it the attitude, is unknown"
        )
