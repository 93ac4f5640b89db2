"""Rates, attitudes and errors, accumulated as far as a picture needs them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conventions import Signs
from quatprop.conventions.representations import euler_angles
from quatprop.plot.lines import Unwrap
from quatprop.plot.reduction import Reduction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.plot.reduction import Reduced
    from quatprop.series import AttitudeSeries, GyroSeries

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

ZERO = 1e-6
"""Norms below this are zero: no rotation can be computed from them."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """What one panel of a picture shows against time.

    Parameters
    ----------
    name, unit
        Label of its axis; no unit is ``""``.
    axis
        Its colour in a picture of one file: ``"x"``, ``"y"``, ``"z"``, ``"w"``, or
        ``""``.
    wraps
        Whether it is an angle, in deg, that wraps at half a turn.
    least
        A series that varies by less is drawn as a constant.
    scale
        Range of its axis in either direction where the series is zero.
    """

    name: str
    unit: str
    axis: str = ""
    wraps: bool = False
    least: float = 0.0
    scale: float = 1.0


ROUNDING_DEG = 1e-6

MINUS = "\N{MINUS SIGN}"

NORM_ERROR = Quantity(f"norm error |q| {MINUS} 1", "", least=1e-15, scale=1e-15)

ANGLES = (
    Quantity("yaw", "deg", "z", wraps=True, least=ROUNDING_DEG),
    Quantity("pitch", "deg", "y", least=ROUNDING_DEG),
    Quantity("roll", "deg", "x", wraps=True, least=ROUNDING_DEG),
    NORM_ERROR,
)
"""An attitude as q = q_z(yaw) q_y(pitch) q_x(roll)."""

COMPONENTS = (*(Quantity(f"q{axis}", "", axis) for axis in "wxyz"), NORM_ERROR)
"""An attitude as its quaternion."""

ERROR = (Quantity("geodesic error", "deg"),)


def rates_in(unit: str) -> tuple[Quantity, ...]:
    """Return the quantities of angular rates in a unit."""
    return tuple(Quantity(f"rate {axis}", unit, axis) for axis in "xyz")


class Accumulator:
    """Quantities of a picture, reduced while samples pass.

    Parameters
    ----------
    quantities
        What is kept of each sample.
    """

    def __init__(self, quantities: tuple[Quantity, ...]) -> None:
        self.quantities = quantities
        self._reduction = Reduction(len(quantities))

    def add(self, t_ns: Int64, values: Float64) -> None:
        """Add samples: stamps ``(N,)``, int64 ns, and values ``(quantities, N)``."""
        self._reduction.add(t_ns, values)

    def reduced(self) -> Reduced:
        """Return the reduced samples."""
        return self._reduction.result()


class RateAccumulator(Accumulator):
    """Angular rates.

    Parameters
    ----------
    unit
        Unit in which they are drawn.
    rad_s
        That unit in rad/s.
    """

    def __init__(self, unit: str, rad_s: float) -> None:
        super().__init__(rates_in(unit))
        self._scale = 1.0 / rad_s

    def passing(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the batches as they are, having accumulated them."""
        for batch in batches:
            with np.errstate(over="ignore", invalid="ignore"):  # numbers of a damaged log
                drawn = batch.rate.T * self._scale
            self.add(batch.t_ns, drawn)
            yield batch


class AttitudeAccumulator(Accumulator):
    """Attitudes, as angles or as components, and their norm error.

    Parameters
    ----------
    components
        Draw the components of the quaternion, of q and -q the one nearer to the one before,
        instead of yaw, pitch and roll.
    unwrap
        Draw yaw and roll beyond half a turn, instead of cut there.

    Attributes
    ----------
    invalid
        Invalid quaternions: zero, or not finite.
    norm_error
        Largest difference from unit length.
    """

    def __init__(self, *, components: bool = False, unwrap: bool = False) -> None:
        angles: tuple[Quantity, ...] = ANGLES
        if unwrap:
            angles = (*(replace(angle, wraps=False) for angle in ANGLES[:-1]), NORM_ERROR)
        super().__init__(COMPONENTS if components else angles)
        self._signs = Signs("continuous") if components else None
        self._unwrap = Unwrap(2)
        self.invalid = 0
        self.norm_error = 0.0

    def add_rows(self, t_ns: Int64, wxyz: Float64) -> None:
        """Add quaternions wxyz, shape ``(N, 4)``, of any norm."""
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
        good = np.isfinite(length) & (length > ZERO)
        self.invalid += len(good) - int(np.count_nonzero(good))
        self.norm_error = max(
            self.norm_error, float(np.max(np.abs(length - 1), initial=0.0, where=good))
        )
        values = np.full((len(self.quantities), len(t_ns)), np.nan)
        values[-1] = np.where(good, length - 1, np.nan)
        if self._signs is not None:
            values[:-1, good] = self._signs.applied(wxyz[good]).T
        else:
            angles = np.degrees(euler_angles("zyx", wxyz[good])).T
            angles[[0, 2]] = self._unwrap.applied(angles[[0, 2]])
            values[:-1, good] = angles
        self.add(t_ns, values)

    def passing(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the batches as they are, having accumulated them."""
        for batch in batches:
            self.add_rows(batch.t_ns, batch.wxyz)
            yield batch
