"""Which rows of a series are rotations, and what is done about the others.

A quaternion column may hold zeros (a reference that was never set), NaN (a fix that was lost), or
numbers that are no unit quaternion at all. They are found, located and counted; none passes for an
attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import NotRotationsError
from quatprop.kinematics.quaternion import normalize
from quatprop.series import AttitudeSeries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

UNIT_TOLERANCE = 1e-3
"""How far from 1 a length may be: numbers of three decimals come as far as this by rounding."""

ZERO = 1e-6
"""Lengths below this are zero: no direction can be had from them."""

_ROUNDING = 4e-16


@dataclass(slots=True)
class RowCounts:
    """What was found in a series.

    Parameters
    ----------
    read, used
        Rows read and given on.
    zero, not_unit, not_finite
        Rows that are no rotation, and why.
    normalized
        Rows that were scaled to unit length.
    worst
        Largest distance of a length from 1 among the rows that are neither zero nor NaN.
    first
        The first row that is no rotation, from 0; None while there is none.
    first_ns
        Its stamp, ns.
    """

    read: int = 0
    used: int = 0
    zero: int = 0
    not_unit: int = 0
    not_finite: int = 0
    normalized: int = 0
    worst: float = 0.0
    first: int | None = None
    first_ns: int | None = None

    @property
    def bad(self) -> int:
        """Rows that are no rotation."""
        return self.zero + self.not_unit + self.not_finite

    @property
    def words(self) -> str:
        """What is no rotation, why, and where the first of it is; for counts of some."""
        kinds = (
            (self.zero, "all zero"),
            (self.not_unit, f"off unit length by up to {self.worst:.3g}"),
            (self.not_finite, "absent or not finite"),
        )
        found = ", ".join(f"{count} {what}" for count, what in kinds if count)
        return (
            f"{self.bad} of {self.read} rows are no rotation ({found}), the first is row "
            f"{self.first} at {self.first_ns} ns"
        )


class RotationCheck:
    """Lets rotations pass, and refuses or drops what is none.

    Parameters
    ----------
    path
        The file, for errors.
    normalize
        Scale rows to unit length, however long they are; zeros and NaN stay what they are.
    drop
        Leave out what is no rotation instead of refusing the series.

    Attributes
    ----------
    counts
        What was found so far.
    """

    def __init__(self, path: Path | str, *, normalize: bool = False, drop: bool = False) -> None:
        self.counts = RowCounts()
        self._path = path
        self._normalize = normalize
        self._drop = drop

    def apply(self, batches: Iterable[tuple[Int64, Float64]]) -> Iterator[AttitudeSeries]:
        """Yield the rows that are rotations.

        Parameters
        ----------
        batches
            Stamps, shape ``(N,)``, int64 ns, and quaternions, shape ``(N, 4)``.

        Raises
        ------
        NotRotationsError
            Rows are no rotations. Nothing is yielded from the first of them on; all are counted
            before they are told.
        """
        for t_ns, wxyz in batches:
            good, scaled = self._sorted_out(t_ns, wxyz)
            if self.counts.bad and not self._drop:
                continue
            if good.all():
                series = AttitudeSeries(t_ns, scaled)
            else:
                series = AttitudeSeries(t_ns[good], scaled[good])
            self.counts.used += len(series)
            if len(series):
                yield series
        if self.counts.bad and not self._drop:
            raise NotRotationsError(self._path, self._reason())

    def _sorted_out(self, t_ns: Int64, wxyz: Float64) -> tuple[NDArray[np.bool_], Float64]:
        """Return which rows are rotations, and the rows, scaled if that was asked for."""
        counts = self.counts
        # Components of absurd size must be told as such, not overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
            finite = np.isfinite(length)
            zero = finite & (length < ZERO)
            off = np.abs(length - 1.0)
        good = finite & ~zero
        counts.worst = max(counts.worst, float(np.max(off, initial=0.0, where=good)))
        if self._normalize:
            scaling = good & (off > _ROUNDING)
            counts.normalized += int(np.count_nonzero(scaling))
            if scaling.any():
                wxyz = wxyz.copy()
                wxyz[scaling] = normalize(wxyz[scaling])
        else:
            not_unit = good & (off > UNIT_TOLERANCE)
            counts.not_unit += int(np.count_nonzero(not_unit))
            good &= ~not_unit
        if counts.first is None and not good.all():
            row = int(np.argmin(good))
            counts.first, counts.first_ns = counts.read + row, int(t_ns[row])
        counts.zero += int(np.count_nonzero(zero))
        counts.not_finite += int(np.count_nonzero(~finite))
        counts.read += len(t_ns)
        return good, wxyz

    def _reason(self) -> str:
        counts = self.counts
        ways = ["--normalize scales those of another length"] if counts.not_unit else []
        ways.append("--on-invalid drop leaves them out")
        return f"{counts.words}; {', '.join(ways)}"
