"""Count and locate invalid quaternions of a series; refuse, drop or normalise them.

A quaternion column may hold zeros (a reference that was never set), NaN (no fix), or other numbers
that are not a unit quaternion. None of them is used as an attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import NotRotationsError
from quatprop.kinematics.quaternion import UNIT_TOLERANCE, normalize
from quatprop.series import AttitudeSeries
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.arrays import Bool, Float64, Int64


ZERO = 1e-6
"""Lengths below this count as zero."""

_ROUNDING = 4e-16


@dataclass(slots=True)
class QuaternionCounts:
    """Valid and invalid rows of a series.

    `read`, `used`: rows read, and valid rows
    `zero`, `not_unit`, `not_finite`: invalid rows, by reason
    `normalized`: rows scaled to unit length
    `worst`: largest deviation from unit length, except in rows of zeros or NaN
    `first`: index of the first invalid row; None: none so far
    `first_ns`: its timestamp, ns
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
    def invalid(self) -> int:
        """Number of rows that are not unit quaternions."""
        return self.zero + self.not_unit + self.not_finite

    @property
    def summary(self) -> str:
        """Text with the number of invalid rows, the reasons, and the first of them."""
        kinds = (
            (self.zero, "all zero"),
            (self.not_unit, f"off unit length by up to {self.worst:.3g}"),
            (self.not_finite, "absent or not finite"),
        )
        reasons = ", ".join(f"{count} {what}" for count, what in kinds if count)
        return (
            f"{self.invalid} of {self.read} rows are invalid quaternions ({reasons}), the first is "
            f"row {self.first} at {self.first_ns} ns"
        )


class QuaternionCheck:
    """Passes on unit quaternions, and refuses or drops others.

    `normalize`: scale rows of nonzero length to unit length; zeros and NaN stay invalid
    `drop`: omit invalid rows instead of refusing the series
    `counts`: valid and invalid rows so far
    """

    def __init__(self, path: Path | str, *, normalize: bool = False, drop: bool = False) -> None:
        self.counts = QuaternionCounts()
        self._path = path
        self._normalize = normalize
        self._drop = drop

    def apply(
        self, batches: Iterable[tuple[Int64, Float64, *tuple[Any, ...]]]
    ) -> Iterator[AttitudeSeries]:
        """Yield the valid rows.

        `batches`: timestamps, shape ``(N,)``, int64 ns, quaternions, shape ``(N, 4)``, and possibly
            further arguments of :class:`quatprop.series.AttitudeSeries`
        """
        for t_ns, wxyz, *beside in batches:
            valid, scaled = self._valid(t_ns, wxyz)
            if not valid.any() or (self.counts.invalid and not self._drop):
                continue
            series = AttitudeSeries(t_ns, scaled, *beside)
            if not valid.all():
                series = series[valid]
            self.counts.used += len(series)
            yield series
        if self.counts.invalid and not self._drop:
            raise NotRotationsError(self._path, self._reason())

    def _valid(self, t_ns: Int64, wxyz: Float64) -> tuple[Bool, Float64]:
        """Return which rows are valid, and the rows, scaled if requested."""
        counts = self.counts
        # Huge components are reported as invalid, so they may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
            finite = np.isfinite(length)
            zero = finite & (length < ZERO)
            off = np.abs(length - 1.0)
        valid = finite & ~zero
        counts.worst = max(counts.worst, float(np.max(off, initial=0.0, where=valid)))
        if self._normalize:
            scaling = valid & (off > _ROUNDING)
            counts.normalized += int(np.count_nonzero(scaling))
            if scaling.any():
                wxyz = wxyz.copy()
                wxyz[scaling] = normalize(wxyz[scaling])
        else:
            not_unit = valid & (off > UNIT_TOLERANCE)
            counts.not_unit += int(np.count_nonzero(not_unit))
            valid &= ~not_unit
        if counts.first is None and not valid.all():
            row = int(np.argmin(valid))
            counts.first, counts.first_ns = counts.read + row, int(t_ns[row])
        counts.zero += int(np.count_nonzero(zero))
        counts.not_finite += int(np.count_nonzero(~finite))
        counts.read += len(t_ns)
        return valid, wxyz

    def _reason(self) -> str:
        counts = self.counts
        if counts.not_finite == counts.read:
            return (
                f"none of {counts.read} rows holds an attitude (they are absent, not finite or no "
                "rotations); if the log holds body rates, propagate them first"
            )
        scaling = f"{Setting('normalize')} scales quaternions of another length, "
        ways = f"{scaling if counts.not_unit else ''}{Setting('on_invalid', 'drop')}"
        return f"{counts.summary}; {ways} omits them"
