"""Accumulate the rates, attitudes and errors of a picture while they are read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conventions import Signs
from quatprop.conventions.representations import euler_angles
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.plotting.lines import TURN, Unwrap
from quatprop.plotting.reduction import Reduced, Reduction
from quatprop.settings.quantities import RATES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries, GyroSeries

ZERO = 1e-6
"""Norms below this are zero: no rotation can be computed from them."""

SMALL = 1e-6
"""Rotation for numerical derivatives, rad; its effect is linear."""


class Quantity(NamedTuple):
    """A quantity that a panel of a picture shows over time.

    `name`, `unit`: label of its axis; no unit is ``""``
    `axis`: its colour in a picture of one file: ``"x"``, ``"y"``, ``"z"``, ``"w"``, or ``""``
    `wraps`: whether it is an angle, in deg, that wraps at half a turn
    `least`: a series that varies by less is drawn as a constant
    `scale`: range of its axis in either direction if the series is zero
    `is_error`: whether it should be zero: its standard deviation is drawn about zero
    `shown_above`: it has a panel only if it exceeds this value; None for always
    """

    name: str
    unit: str
    axis: str = ""
    wraps: bool = False
    least: float = 0.0
    scale: float = 1.0
    is_error: bool = False
    height: float = 1.0
    shown_above: float | None = None


ROUNDING_DEG = 1e-6

MINUS = "\N{MINUS SIGN}"

NORM_DIGITS = 1e-6
"""Norm errors up to this are due to rounding in text files."""

NORM_ERROR = Quantity(f"norm error |q| {MINUS} 1", "", shown_above=NORM_DIGITS)

SIGMA_BAND = "1 sigma shaded"

EXPECTED = Quantity("1 sigma error", "deg", shown_above=0.0)
"""The angle of an error of one standard deviation about all three axes."""

ANGLES = (
    Quantity("yaw", "deg", "z", wraps=True, least=ROUNDING_DEG),
    Quantity("pitch", "deg", "y", least=ROUNDING_DEG),
    Quantity("roll", "deg", "x", wraps=True, least=ROUNDING_DEG),
    EXPECTED,
    NORM_ERROR,
)
"""An attitude as q = q_z(yaw) q_y(pitch) q_x(roll)."""

COMPONENTS = (*(Quantity(f"q{axis}", "", axis) for axis in "wxyz"), EXPECTED, NORM_ERROR)
"""An attitude as its quaternion."""

ERROR = (
    Quantity("geodesic error", "deg", height=2.0),
    *(Quantity(f"error {axis}", "deg", axis, least=1e-12, is_error=True) for axis in "xyz"),
)
"""The angle of an error, and its rotation vector about the body axes."""


class Group(NamedTuple):
    """Quantities with the same timestamps.

    `reduced`: their reduced samples, then their standard deviations, if known
    `gap_limit_ns`: intervals longer than this are gaps, ns; None for no gaps
    """

    quantities: tuple[Quantity, ...]
    reduced: Reduced
    gap_limit_ns: int | None = None


class Accumulator:
    """Quantities of a picture, reduced while samples are read.

    `has_sigmas`: whether there are standard deviations
    """

    def __init__(self, quantities: tuple[Quantity, ...], *, has_sigmas: bool = False) -> None:
        self.quantities = quantities
        self.has_sigmas = has_sigmas
        self._reduction = Reduction(len(quantities) * (2 if has_sigmas else 1))

    def add(self, t_ns: Int64, values: Float64, sigmas: Float64 | None = None) -> None:
        """Add samples: stamps ``(N,)``, ns; values, and sigmas if any, ``(quantities, N)``."""
        self._reduction.add(t_ns, values if sigmas is None else np.concatenate([values, sigmas]))

    def group(self, gap_limit_ns: int | None) -> Group:
        """Return the reduced quantities; longer intervals than this are gaps, ns."""
        return Group(self.quantities, self._reduction.result(), gap_limit_ns)


class RateAccumulator(Accumulator):
    """Angular rates."""

    def __init__(self, unit: str) -> None:
        super().__init__(tuple(Quantity(f"rate {axis}", unit, axis) for axis in "xyz"))
        self._scale = 1.0 / RATES[unit]

    def passing(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Accumulate batches, and yield them unchanged."""
        for batch in batches:
            with np.errstate(over="ignore", invalid="ignore"):  # numbers of a damaged log
                drawn = batch.rate.T * self._scale
            self.add(batch.t_ns, drawn)
            yield batch


class AttitudeAccumulator(Accumulator):
    """Attitudes, as angles or as components, and their norm error.

    `components`: draw the components of the quaternion, with a continuous sign, instead of yaw,
        pitch and roll
    `unwrap`: draw yaw and roll beyond half a turn, without wrapping
    `invalid`: number of invalid quaternions: zero, or not finite
    `knows_sigmas`: whether any standard deviation was above zero
    `norm_error`: largest deviation from unit length
    """

    def __init__(
        self, *, components: bool = False, unwrap: bool = False, has_sigmas: bool = False
    ) -> None:
        angles = tuple(angle._replace(wraps=angle.wraps and not unwrap) for angle in ANGLES)
        super().__init__(COMPONENTS if components else angles, has_sigmas=has_sigmas)
        self._signs = Signs("continuous") if components else None
        self._unwrap = Unwrap(2)
        self.invalid, self.knows_sigmas = 0, False
        self.norm_error = 0.0

    def _add_attitudes(self, t_ns: Int64, wxyz: Float64, covariance: Float64 | None) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
        good = np.isfinite(length) & (length > ZERO)
        self.invalid += len(good) - int(np.count_nonzero(good))
        self.norm_error = max(
            self.norm_error, float(np.max(np.abs(length - 1), initial=0.0, where=good))
        )
        values = np.full((len(self.quantities), len(t_ns)), np.nan)
        values[-1] = np.where(good, length - 1, np.nan)
        sigmas = np.full(values.shape, np.nan) if self.has_sigmas else None
        if sigmas is not None and covariance is not None:
            sigmas[:-2, good] = self._sigmas(wxyz[good], covariance[good])
            values[-2] = np.degrees(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))
            self.knows_sigmas |= bool((values[-2] > 0).any())
        if self._signs is not None:
            drawn = self._signs.applied(wxyz[good]).T
        else:
            drawn = self._drawn(wxyz[good])
            drawn[[0, 2]] = self._unwrap.applied(drawn[[0, 2]])
        values[:-2, good] = drawn
        self.add(t_ns, values, sigmas)

    def _drawn(self, wxyz: Float64) -> Float64:
        """Return components, or angles in deg, without continuity, shape ``(values, N)``."""
        if self._signs is not None:
            return wxyz.T
        return np.degrees(euler_angles("zyx", wxyz)).T

    def _sigmas(self, wxyz: Float64, covariance: Float64) -> Float64:
        """Return standard deviations of these values, to first order, shape ``(values, N)``."""
        drawn, change = self._drawn(wxyz), []
        for axis in np.eye(3):
            steps = self._drawn(multiply(wxyz, exp(SMALL * axis))) - drawn
            change.append((steps - TURN * np.rint(steps / TURN)) / SMALL)
        with np.errstate(invalid="ignore"):
            variance = np.einsum("ivn,nij,jvn->vn", change, covariance, change)
            return np.asarray(np.sqrt(np.minimum(variance, (TURN / 2) ** 2)))

    def passing(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Accumulate attitudes of any norm, and yield them unchanged."""
        for batch in batches:
            self._add_attitudes(batch.t_ns, batch.wxyz, batch.covariance)
            yield batch
