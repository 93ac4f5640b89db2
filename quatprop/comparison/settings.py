"""How two attitude series are compared: the settings, and the texts in which users write them."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, TypedDict, Unpack

from quatprop.errors import UsageError
from quatprop.settings import parsers_of
from quatprop.settings.parsers import Choice, duration, length, number
from quatprop.settings.quantities import RAD_PER_UNIT, quantity, quantity_of
from quatprop.settings.values import parse_all
from quatprop.text import Setting, quoted, shown

ALIGNMENTS = ("none", "first", "mean", "mount")
"""Which frames of B are rotated before the comparison."""

BY_ALL = {"mean", "mount"}
"""Alignments by all pairs: the error of a steady drift falls to its middle, and then rises."""

MATCHES = ("exact", "nearest", "interpolate")
"""How attitudes are matched in time: equal stamps, the nearest sample, slerp."""

DEG_H_PER_UNIT = {"deg/h": 1.0, "deg/s": 3600.0, "rad/s": 3600 * 180 / math.pi}
"""deg/h in each unit of a drift."""


@dataclass(frozen=True, slots=True)
class Sigmas:
    """A limit on an error in its standard deviations: its Mahalanobis distance from 0."""

    count: float

    def __str__(self) -> str:
        return f"{self.count:g}sigma"


@dataclass(frozen=True, slots=True)
class ComparisonSettings:
    """How to compare two attitude series A and B.

    Parameters
    ----------
    tol, rms_tol, final_tol, p95_tol
        Largest worst, RMS, final and 95th percentile geodesic error that passes, rad or in
        standard deviations; None: every error passes.
    window_tol, window_rms_tol
        The same for the worst and the RMS error of the rotations over windows, rad.
    drift_tol
        Largest drift in either direction that passes, deg/h; not with an alignment by all pairs.
    min_coverage
        Least percentage of the reference, B, that must be compared: of its time and its samples.
    max_sigma
        Largest error that passes, in standard deviations, where `tol` is in rad.
    align
        One of :data:`ALIGNMENTS`.
    time_offset
        Added to B's stamps, ns, or ``"auto"``: estimated from the angular speeds.
    match
        One of :data:`MATCHES`; None: chosen as :func:`quatprop.comparison.association.associate`
        describes.
    max_dt
        How far a sample may be from its partner, ns; None: depends on the median interval.
    min_matched
        Percentage of the samples in the common time that must be matched, 0 to 100.
    window
        Also compare the rotations over windows of this length, ns; None: no windows.

    Raises
    ------
    UsageError
        A limit on errors over windows is given, and no window; or one on the drift, and an
        alignment of :data:`BY_ALL`.
    """

    tol: float | Sigmas | None = None
    rms_tol: float | Sigmas | None = None
    final_tol: float | Sigmas | None = None
    p95_tol: float | Sigmas | None = None
    window_tol: float | None = None
    window_rms_tol: float | None = None
    drift_tol: float | None = None
    min_coverage: float | None = None
    max_sigma: Sigmas | None = None
    align: str = "none"
    time_offset: int | Literal["auto"] = 0
    match: str | None = None
    max_dt: int | None = None
    min_matched: float = 50.0
    window: int | None = None

    def __post_init__(self) -> None:
        for name in ("window_tol", "window_rms_tol"):
            if getattr(self, name) is not None and not self.window:
                raise UsageError(
                    f"{Setting(name)} needs windows; give their length with {Setting('window')}"
                )
        if self.drift_tol is not None and self.align in BY_ALL:
            raise UsageError(
                f"{Setting('drift_tol')} needs {Setting('align', 'none|first')}: an alignment by "
                f"all pairs ({Setting('align', self.align)}) takes out part of the drift"
            )

    @property
    def limit_rad(self) -> float:
        """The largest error that passes, rad."""
        return self.tol if isinstance(self.tol, float | int) else math.inf


angle_rad = quantity_of(RAD_PER_UNIT, "an angle", "1e-9rad or 0.1deg")
"""Return an angle in rad: a number in rad, or text such as ``"1e-9rad"`` or ``"0.1deg"``."""


def error_limit(value: object) -> float | Sigmas:
    """Return a limit on an error: an angle as of :data:`angle_rad`, or text such as ``"3sigma"``.

    Raises
    ------
    UsageError
        The value is neither.

    Examples
    --------
    >>> error_limit("2.5 sigma"), error_limit("90deg")
    (Sigmas(count=2.5), 1.5707963267948966)
    """
    if isinstance(value, Sigmas):
        return value
    if isinstance(value, str) and value.rstrip().endswith("sigma"):
        return Sigmas(quantity(value, {"sigma": 1.0}, "an error in standard deviations", "3sigma"))
    return quantity(value, RAD_PER_UNIT, "an angle", "1e-9rad or 0.1deg, or in sigma: 3sigma")


def time_offset_ns(value: object) -> int | Literal["auto"]:
    """Return a signed duration in ns: whole ns, text such as ``"-12ms"``, or ``"auto"``.

    Raises
    ------
    UsageError
        The value is neither.

    Examples
    --------
    >>> time_offset_ns("-12ms"), time_offset_ns("auto")
    (-12000000, 'auto')
    """
    if value == "auto":
        return "auto"
    if isinstance(value, str) and value.startswith("-"):
        return -duration(value[1:])
    return duration(value.removeprefix("+") if isinstance(value, str) else value)


def _percentage(value: object) -> float:
    percentage = number(value)
    if not 0 <= percentage <= 100:  # noqa: PLR2004  # percent
        raise UsageError(f"{quoted(value)} is not a percentage from 0 to 100")
    return percentage


def _sigmas(value: object) -> Sigmas:
    if isinstance(value, Sigmas):
        return value
    if (parsed := number(value)) <= 0:
        raise UsageError(f"{shown(value)} is not a number above 0")
    return Sigmas(parsed)


drift_deg_h = quantity_of(DEG_H_PER_UNIT, "a drift", "10deg/h")
"""Return a drift in deg/h: a number in deg/h, or text such as ``"10deg/h"``."""


class CompareOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.compare`, as for :class:`ComparisonSettings`.

    Angles may be texts with a unit, such as ``"0.1deg"``, durations such as ``"-12ms"``.
    """

    tol: Annotated[float | str | None, error_limit]
    rms_tol: Annotated[float | str | None, error_limit]
    final_tol: Annotated[float | str | None, error_limit]
    p95_tol: Annotated[float | str | None, error_limit]
    window_tol: Annotated[float | str | None, angle_rad]
    window_rms_tol: Annotated[float | str | None, angle_rad]
    drift_tol: Annotated[float | str | None, drift_deg_h]
    min_coverage: Annotated[float | None, _percentage]
    max_sigma: Annotated[float | None, _sigmas]
    align: Annotated[str, Choice(*ALIGNMENTS)]
    time_offset: Annotated[int | str, time_offset_ns]
    match: Annotated[str | None, Choice(*MATCHES)]
    max_dt: Annotated[int | str | None, length]
    min_matched: Annotated[float | None, _percentage]
    window: Annotated[int | str | None, length]


COMPARE = parsers_of(CompareOptions)
"""How two series are compared: setting -> its parser, which takes text or a Python value."""


def comparison_settings(**options: Unpack[CompareOptions]) -> ComparisonSettings:
    """Return settings from numbers (rad, ns) or texts with units.

    Raises
    ------
    UsageError
        There is no such setting, or its value cannot be used.

    Examples
    --------
    >>> comparison_settings(tol="90deg", time_offset="-12ms").time_offset
    -12000000
    """
    return ComparisonSettings(**parse_all(options, COMPARE))
