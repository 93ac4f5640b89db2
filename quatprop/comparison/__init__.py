"""The error between two attitude series: brought together in time, aligned, measured, explained."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from quatprop.comparison.alignment import Alignment, align
from quatprop.comparison.association import Pairs, associate, shifted
from quatprop.comparison.clocks import ClockOffset, find_offset
from quatprop.comparison.diagnosis import Cause, likely_cause
from quatprop.comparison.statistics import (
    ErrorFigures,
    WindowFigures,
    drift_deg_h,
    error_figures,
    errors_of,
    window_figures,
)
from quatprop.errors import ComparisonError, UsageError
from quatprop.kinematics.quaternion import IDENTITY, geodesic_angle, normalize
from quatprop.series import AttitudeSeries, blocks
from quatprop.text import quoted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]

UNIT_LENGTH = 1e-3
"""Difference from unit length that is remarked on; decimals of a text file stay below it."""

SMALL = 0.5
"""Error, rad, below which it makes sense to ask for the sign of a quaternion."""

_ANGLE = re.compile(r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(rad|deg)", re.ASCII)


@dataclass(frozen=True, slots=True)
class Settings:
    """How to compare.

    Parameters
    ----------
    align
        One of :data:`quatprop.comparison.alignment.ALIGNMENTS`.
    match, max_dt_ns, min_matched
        As for :func:`quatprop.comparison.association.associate`.
    time_offset
        Added to B's stamps, ns, or ``"auto"``.
    window_ns
        Also compare the rotations over windows of this length, ns.
    tolerance
        Largest error that passes, rad.
    """

    align: str = "none"
    match: str | None = None
    max_dt_ns: int | None = None
    min_matched: float = 0.5
    time_offset: int | Literal["auto"] = 0
    window_ns: int | None = None
    tolerance: float | None = None


@dataclass(frozen=True, slots=True)
class Place:
    """A pair, so that it can be found.

    Parameters
    ----------
    t_ns
        Its time in A's clock, ns.
    at, index
        Which sample of which series: ``"A"`` or ``"B"``, from 0, in order of time.
    error_rad
        Its error, rad.
    """

    t_ns: int
    at: str
    index: int
    error_rad: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """What a comparison found.

    Parameters
    ----------
    pairs
        The attitudes that were compared, as they were read.
    alignment
        What B was turned by.
    error
        Geodesic errors of the pairs, rad, shape ``(N,)``.
    offset
        How the time offset was found; None where it was given.
    offset_ns
        What was added to B's stamps, ns.
    figures, drift_deg_h, worst, window
        The figures of the errors.
    tolerance, exceeded
        The largest error that passes, rad, and the first pair above it.
    cause
        What explains the error, where something does and the tolerance was not kept or not given.
    remarks
        What else is to be said.
    """

    pairs: Pairs
    alignment: Alignment
    error: Float64
    offset: ClockOffset | None
    offset_ns: int
    figures: ErrorFigures
    drift_deg_h: float | None
    worst: Place
    window: WindowFigures | None
    tolerance: float | None
    exceeded: Place | None
    cause: Cause | None
    remarks: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether no error is above the tolerance."""
        return self.exceeded is None

    def report(self) -> dict[str, Any]:
        """Return all of it, JSON-ready; angles in rad unless their name says deg."""
        pairs, alignment = self.pairs, self.alignment
        return {
            "association": {
                "match": pairs.match,
                "at": pairs.at,
                "max_dt_ns": pairs.max_dt_ns,
                "matched": len(pairs),
                "candidates": pairs.candidates,
                "first_ns": int(pairs.t_ns[0]),
                "last_ns": int(pairs.t_ns[-1]),
            },
            "time_offset": {
                "added_to_b_ns": self.offset_ns,
                "found": asdict(self.offset) if self.offset else None,
            },
            "alignment": {
                "name": alignment.name,
                "reference_wxyz": alignment.reference.tolist(),
                "reference_rad": float(geodesic_angle(IDENTITY, alignment.reference)),
                "mount_wxyz": alignment.mount.tolist(),
                "mount_rad": float(geodesic_angle(IDENTITY, alignment.mount)),
                "mounting": asdict(alignment.mounting) if alignment.mounting else None,
            },
            "error_rad": asdict(self.figures),
            "drift_deg_h": self.drift_deg_h,
            "worst": asdict(self.worst),
            "window": asdict(self.window) if self.window else None,
            "tolerance_rad": self.tolerance,
            "passed": self.passed,
            "first_exceeding": asdict(self.exceeded) if self.exceeded else None,
            "likely_cause": asdict(self.cause) if self.cause else None,
            "remarks": list(self.remarks),
        }


def compare(a: AttitudeSeries, b: AttitudeSeries, settings: Settings | None = None) -> Comparison:
    """Measure the geodesic error between two attitude series.

    Parameters
    ----------
    a, b
        The series. They are put in order of time, and normalised.
    settings
        How to compare; None: all defaults.

    Raises
    ------
    ComparisonError
        The series cannot be compared as asked: too few pairs, no motion to align by...

    Examples
    --------
    >>> t_ns = np.arange(3) * 10_000_000
    >>> a = AttitudeSeries(t_ns, np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
    >>> b = AttitudeSeries(t_ns, -a.wxyz)
    >>> compare(a, b).figures.max
    0.0
    """
    settings = settings or Settings()
    remarks: list[str] = []
    a, b = _ordered(a, "A", remarks), _ordered(b, "B", remarks)
    offset = find_offset(a, b) if settings.time_offset == "auto" else None
    offset_ns = offset.ns if offset else int(settings.time_offset)
    b = shifted(b, offset_ns)
    associated = partial(
        associate,
        match=settings.match,
        max_dt_ns=settings.max_dt_ns,
        min_matched=settings.min_matched,
    )
    pairs = associated(a, b)
    alignment = align(settings.align, pairs.a, pairs.b)
    error, opposite = errors_of(pairs, alignment)
    place = partial(_place, pairs, error)
    limit = np.inf if settings.tolerance is None else settings.tolerance
    exceeded = place(int(np.argmax(error > limit))) if error.max() > limit else None
    remarks += _signs(pairs, opposite, error)
    cause = None
    if settings.tolerance is None or exceeded:
        cause = likely_cause(a, b, associated, settings.align, error)
    window = settings.window_ns or None
    return Comparison(
        pairs=pairs,
        alignment=alignment,
        error=error,
        offset=offset,
        offset_ns=offset_ns,
        figures=error_figures(error),
        drift_deg_h=drift_deg_h(pairs.t_ns, error),
        worst=place(int(np.argmax(error))),
        window=window and window_figures(pairs.t_ns, pairs.a, alignment.apply(pairs.b), window),
        tolerance=settings.tolerance,
        exceeded=exceeded,
        cause=cause,
        remarks=tuple(remarks),
    )


def angle_rad(text: str) -> float:
    """Return an angle such as ``"1e-9rad"`` or ``"0.1deg"`` in rad.

    Raises
    ------
    UsageError
        The text is not a number with one of these units.

    Examples
    --------
    >>> angle_rad("90deg")
    1.5707963267948966
    """
    match = _ANGLE.fullmatch(text.strip())
    value = float(match[1]) if match else math.inf
    if not match or math.isinf(value):
        raise UsageError(
            f"{quoted(text)} is not an angle; write a number with its unit, such as 1e-9rad or "
            "0.1deg"
        )
    return math.radians(value) if match[2] == "deg" else value


def _ordered(series: AttitudeSeries, name: str, remarks: list[str]) -> AttitudeSeries:
    """Return a series of unit quaternions at rising stamps; what that took is remarked on."""
    if not len(series):
        raise ComparisonError(f"{name} has no attitudes; check what was selected")
    length = np.sqrt(np.einsum("ij,ij->i", series.wxyz, series.wxyz))
    (bad,) = np.nonzero(~(np.isfinite(length) & (length > 0)))
    if len(bad):
        raise ComparisonError(
            f"{name} has {len(bad)} of {len(series)} rows that are no attitude (zero or not a "
            f"number), the first at index {bad[0]}; leave them out"
        )
    if (off := float(np.abs(length - 1).max())) > UNIT_LENGTH:
        remarks.append(f"{name} is not of unit length, by up to {off:.2g}; normalised")
    t_ns, wxyz = series.t_ns, np.empty_like(series.wxyz)
    for rows in blocks(len(wxyz)):
        wxyz[rows] = normalize(series.wxyz[rows])
    intervals = np.diff(t_ns)
    if (intervals > 0).all():
        return AttitudeSeries(t_ns, wxyz)
    _, first = np.unique(t_ns, return_index=True)
    back, repeated = int((intervals < 0).sum()), len(t_ns) - len(first)
    remarks.append(
        f"{name} was put in order of time: its stamps step back {back} times, and {repeated} "
        "repeated ones were left out"
    )
    return AttitudeSeries(t_ns[first], wxyz[first])


def _place(pairs: Pairs, error: Float64, pair: int) -> Place:
    return Place(int(pairs.t_ns[pair]), pairs.at, int(pairs.index[pair]), float(error[pair]))


def _signs(pairs: Pairs, opposite: int, error: Float64) -> list[str]:
    """Say where B is the same attitude with the opposite sign: a difference, but no error."""
    if pairs.match != "exact" or not opposite or error.max() > SMALL:
        return []
    remark = (
        f"B has the opposite sign in {opposite} of {len(pairs)} samples: q and -q are "
        "the same attitude, so this is no error"
    )
    return [remark]
