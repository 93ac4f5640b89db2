"""What passes by, kept as far as a picture needs it: rates, attitudes, errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conventions import Signs, euler_zyx
from quatprop.plot.lines import Continuous
from quatprop.plot.reduction import Reduction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from quatprop.plot.reduction import Reduced
    from quatprop.series import AttitudeSeries, GyroSeries

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

ZERO = 1e-6
"""Lengths below this are zero: no direction can be had from them."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """One row of a picture: what is drawn against time.

    Parameters
    ----------
    name, unit
        What its axis says; no unit is ``""``.
    axis
        Which colour it has where colours tell axes: ``"x"``, ``"y"``, ``"z"``, ``"w"``, or
        ``""``.
    turns
        Whether it is an angle that goes around, in deg.
    least
        Less than this is rounding: a series that varies by less is drawn as a constant.
    scale
        How far its axis reaches either way where it is zero all along.
    """

    name: str
    unit: str
    axis: str = ""
    turns: bool = False
    least: float = 0.0
    scale: float = 1.0


ROUNDING_DEG = 1e-6

MINUS = "\N{MINUS SIGN}"

NORM_ERROR = Quantity(f"norm error |q| {MINUS} 1", "", least=1e-15, scale=1e-15)

ANGLES = (
    Quantity("yaw", "deg", "z", turns=True, least=ROUNDING_DEG),
    Quantity("pitch", "deg", "y", least=ROUNDING_DEG),
    Quantity("roll", "deg", "x", turns=True, least=ROUNDING_DEG),
    NORM_ERROR,
)
"""An attitude as q = q_z(yaw) q_y(pitch) q_x(roll)."""

COMPONENTS = (*(Quantity(f"q{axis}", "", axis) for axis in "wxyz"), NORM_ERROR)
"""An attitude as its quaternion."""

ERROR = (Quantity("geodesic error", "deg"),)


def rates_in(unit: str) -> tuple[Quantity, ...]:
    """Return the rows of angular rates in a unit."""
    return tuple(Quantity(f"rate {axis}", unit, axis) for axis in "xyz")


class Sketch:
    """Rows of a picture that grow with the samples that pass.

    Parameters
    ----------
    rows
        What is kept of each sample.
    """

    def __init__(self, rows: tuple[Quantity, ...]) -> None:
        self.rows = rows
        self._reduction = Reduction(len(rows))

    def add(self, t_ns: Int64, values: Float64) -> None:
        """Take samples: stamps ``(N,)``, int64 ns, and values ``(rows, N)``."""
        self._reduction.add(t_ns, values)

    def reduced(self) -> Reduced:
        """Return what is to be drawn."""
        return self._reduction.result()


class RateSketch(Sketch):
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
        """Yield the batches as they are, having sketched them."""
        for batch in batches:
            self.add(batch.t_ns, batch.rate.T * self._scale)
            yield batch


class AttitudeSketch(Sketch):
    """Attitudes, as angles or as components, and how far they are from unit length.

    Parameters
    ----------
    components
        Draw the components of the quaternion, of q and -q the one nearer to the one before,
        instead of yaw, pitch and roll.

    Attributes
    ----------
    absent
        Rows that were no attitude: zero, or not finite.
    worst
        Largest distance from unit length.
    """

    def __init__(self, *, components: bool = False) -> None:
        super().__init__(COMPONENTS if components else ANGLES)
        self._signs = Signs("continuous") if components else None
        self._turning = Continuous(2)
        self.absent = 0
        self.worst = 0.0

    def add_rows(self, t_ns: Int64, wxyz: Float64) -> None:
        """Take attitudes, shape ``(N, 4)``, of any length."""
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
        good = np.isfinite(length) & (length > ZERO)
        self.absent += len(good) - int(np.count_nonzero(good))
        self.worst = max(self.worst, float(np.max(np.abs(length - 1), initial=0.0, where=good)))
        values = np.full((len(self.rows), len(t_ns)), np.nan)
        values[-1] = np.where(good, length - 1, np.nan)
        if self._signs is not None:
            values[:-1, good] = self._signs.applied(wxyz[good]).T
        else:
            values[:-1, good] = np.degrees(euler_zyx(wxyz[good])).T
            values[[0, 2]] = self._turning.applied(values[[0, 2]])
        self.add(t_ns, values)

    def passing(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the batches as they are, having sketched them."""
        for batch in batches:
            self.add_rows(batch.t_ns, batch.wxyz)
            yield batch
