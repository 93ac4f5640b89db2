"""Invalid quaternions of a series, refused, dropped or normalised; recorded uncertainty.

A quaternion column may hold zeros (a reference that was never set), NaN (no fix), or other numbers
that are not a unit quaternion. None of them is used as an attitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, NotRotationsError
from quatprop.base.provenance import entry_of
from quatprop.base.text import Setting
from quatprop.kinematics.quaternion import (
    UNIT_TOLERANCE,
    conjugate,
    normalize,
    reference_covariance,
)
from quatprop.kinematics.series import SIGMA_COLUMNS, AttitudeSeries
from quatprop.readers.matching import matching

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from quatprop.base.arrays import Bool, Float64, Int64
    from quatprop.base.provenance import JsonObject
    from quatprop.readers.matching import Match
    from quatprop.readers.tables.model import Group, Table


ZERO = 1e-6
"""Lengths below this count as zero."""

_ROUNDING = 4e-16


@dataclass(slots=True)
class QuaternionCounts:
    """Valid and invalid rows of a series.

    `samples_read`: rows read
    `samples_used`: valid rows
    `zero`: invalid rows whose four numbers are zero
    `not_unit`: invalid rows of another length than 1
    `not_finite`: invalid rows with NaN or infinity
    `normalized`: rows scaled to unit length
    `worst`: largest deviation from unit length, except in rows of zeros or NaN
    `first`: index of the first invalid row; None: none so far
    `first_ns`: timestamp of the first invalid row, ns
    """

    samples_read: int = 0
    samples_used: int = 0
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
    def reasons(self) -> str:
        """Text with the number of rows that are invalid for each reason."""
        kinds = (
            (self.zero, "all zero"),
            (self.not_unit, f"off unit length by up to {self.worst:.3g}"),
            (self.not_finite, "absent or not finite"),
        )
        return ", ".join(f"{count} {what}" for count, what in kinds if count)

    @property
    def summary(self) -> str:
        """Text with the number of invalid rows, the reasons, and the first of them."""
        return (
            f"{self.invalid} of {self.samples_read} rows are invalid quaternions ({self.reasons}), "
            f"the first is row {self.first} at {self.first_ns} ns"
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
            further arguments of :class:`quatprop.kinematics.series.AttitudeSeries`
        """
        for t_ns, wxyz, *rest in batches:
            valid, scaled = self._valid(t_ns, wxyz)
            if not valid.any() or (self.counts.invalid and not self._drop):
                continue
            series = AttitudeSeries(t_ns, scaled, *rest)
            if not valid.all():
                series = series[valid]
            self.counts.samples_used += len(series)
            yield series
        if self.counts.invalid and not self._drop:
            raise self.refusal()

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
            counts.first, counts.first_ns = counts.samples_read + row, int(t_ns[row])
        counts.zero += int(np.count_nonzero(zero))
        counts.not_finite += int(np.count_nonzero(~finite))
        counts.samples_read += len(t_ns)
        return valid, wxyz

    def refusal(self) -> NotRotationsError:
        """Return the error for invalid rows; of those that were dropped, if there are no others."""
        return NotRotationsError(self._path, self._reason())

    def _reason(self) -> str:
        counts = self.counts
        if counts.not_finite == counts.samples_read:
            return (
                f"none of {counts.samples_read} rows holds an attitude (they are absent, not "
                "finite or no rotations); if the log holds body rates, propagate them first"
            )
        ways = []
        if counts.not_unit:
            ways.append(f"{Setting('normalize')} scales quaternions of another length")
        if not self._drop:
            ways.append(f"{Setting('on_invalid', 'drop')} omits them")
        return "; ".join(filter(None, [counts.summary, ", ".join(ways)]))


# Recorded uncertainty of attitudes: covariances or standard deviations.


CONSTANT_MESSAGES = 20_000
"""Number of messages after which an orientation that is still the identity counts as never set, and
an unchanged covariance as a constant."""

SIZES = (9, 36)
"""Number of elements of the covariance of an orientation, and of a pose."""


class CovarianceColumns(NamedTuple):
    """The columns of the uncertainty of attitudes.

    `columns`: one group, or empty
    `axes`: axes of the errors: ``"reference"`` or ``"body"``
    `are_sigmas`: whether they are standard deviations, rad, instead of a covariance, rad^2
    `own`: whether quatprop wrote them
    """

    table: Table
    columns: tuple[Group, ...] = ()
    axes: str = "reference"
    are_sigmas: bool = False
    own: bool = False

    def in_body_axes(self, rows: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
        """Yield rows with the last column converted to covariances about body axes.

        They have shape ``(N, 3, 3)``, rad^2, or are None if unknown. The first two columns of a row
        are timestamps and quaternions.
        """
        if self.are_sigmas:
            rows = self._of_sigmas(rows)
        else:
            rows = _known(self.table, rows, may_be_constant=self.own)
        for t_ns, wxyz, *others, covariance in rows:
            if covariance is not None and self.axes == "reference":
                # Quaternions may still be invalid.
                with np.errstate(over="ignore", invalid="ignore"):
                    covariance = reference_covariance(conjugate(wxyz), covariance)  # noqa: PLW2901
            yield t_ns, wxyz, *others, covariance

    def _of_sigmas(self, rows: Iterator[tuple[Any, ...]]) -> Iterator[tuple[Any, ...]]:
        read = 0
        for t_ns, wxyz, *others, sigmas in rows:
            good = _checked(self.table, sigmas, wxyz, t_ns, read)
            yield t_ns, wxyz, *others, good[:, :, None] ** 2 * np.eye(3)
            read += len(t_ns)


def covariance_beside(match: Match, provenance: JsonObject) -> CovarianceColumns:
    """Return the columns of the uncertainty of matched attitudes."""
    table = match.table
    matrix = tuple(k for k, _ in matching(table, match.part, match.row.covariance))
    if len(matrix) in SIZES:
        return CovarianceColumns(table, (matrix,), own=bool(provenance))
    keys = [column.key for column in table.columns]
    if not {*SIGMA_COLUMNS} <= {*keys}:
        return CovarianceColumns(table)
    sigmas = tuple(keys.index(name) for name in SIGMA_COLUMNS)
    axes = entry_of(provenance, "uncertainty", dict).get("columns_axes")
    axes = "reference" if axes == "reference" else "body"
    return CovarianceColumns(table, (sigmas,), axes, are_sigmas=True)


def _known(
    table: Table, rows: Iterator[tuple[Any, ...]], *, may_be_constant: bool
) -> Iterator[tuple[Any, ...]]:
    """Yield rows with their covariances, NaN if unknown.

    They are None if the first messages all have the same covariance: if it is zero, it was not set,
    else it is a constant of the driver, not the uncertainty of each attitude.
    """
    first: list[tuple[Any, ...]] = []
    count, varies = 0, False
    while not varies and count < CONSTANT_MESSAGES and (batch := next(rows, None)) is not None:
        first.append(batch)
        count += len(batch[0])
        constant = 0.0 if may_be_constant else first[0][-1][:1]
        varies = bool((batch[-1] != constant).any())
    if not varies and first and first[0][-1][:1].any():
        table.remark(
            "constant-covariance",
            f"the covariance of the orientation does not change in {count} messages, so it is "
            "treated as a constant of the driver, not as the uncertainty of each attitude",
        )
    in_part = 0
    for *row, numbers in chain(first, rows):
        if not varies:
            yield (*row, None)
            continue
        size = math.isqrt(numbers.shape[1])
        of_rotation = numbers.reshape(-1, size, size)[:, -3:, -3:]
        variances = np.diagonal(of_rotation, axis1=1, axis2=2)
        is_known = np.isfinite(of_rotation).all(axis=(1, 2)) & (variances >= 0).all(axis=1)
        in_part += int(np.count_nonzero(~is_known & (variances > 0).any(axis=1)))
        of_rotation[~is_known] = np.nan
        yield (*row, of_rotation)
    if in_part:
        table.remark(
            "partial-covariance",
            f"{in_part} messages have incomplete covariances, which are treated as unknown",
        )


def _checked(table: Table, sigmas: Float64, wxyz: Float64, t_ns: Int64, first: int) -> Float64:
    """Return standard deviations, after checking them; `first`: number of the first row."""
    # A row without an attitude needs no standard deviations.
    has_attitude = np.isfinite(wxyz).all(axis=1, keepdims=True)
    sigmas = np.where(has_attitude, sigmas, 0.0)
    # Unknown ones are written as three NaN.
    is_unknown = np.isnan(sigmas).all(axis=1, keepdims=True)
    is_usable = is_unknown | (np.isfinite(sigmas) & (sigmas >= 0))
    if not is_usable.all():
        row, axis = np.argwhere(~is_usable)[0]
        raise LogError(
            table.path,
            f"{SIGMA_COLUMNS[axis]} is {sigmas[row, axis]:g} in row {first + row} at "
            f"{t_ns[row]} ns, which is not a standard deviation; correct it, or omit "
            f"the columns {', '.join(SIGMA_COLUMNS)}",
        )
    return sigmas
