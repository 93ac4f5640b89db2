"""How two attitude series are compared: the settings, and the texts in which users write them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from quatprop.errors import UsageError
from quatprop.settings import Choice, duration, number
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

ALIGNMENTS = ("none", "first", "mean", "mount")
"""Which frames of B are rotated before the comparison."""

MATCHES = ("exact", "nearest", "interpolate")
"""How attitudes are matched in time: equal stamps, the nearest sample, slerp."""

_ANGLE = re.compile(r"((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(rad|deg)", re.ASCII)


@dataclass(frozen=True, slots=True)
class ComparisonSettings:
    """How to compare two attitude series A and B.

    Parameters
    ----------
    tol
        Largest geodesic error that passes, rad; None: every error passes.
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
    """

    tol: float | None = None
    align: str = "none"
    time_offset: int | Literal["auto"] = 0
    match: str | None = None
    max_dt: int | None = None
    min_matched: float = 50.0
    window: int | None = None


def angle_rad(value: object) -> float:
    """Return an angle in rad: a number in rad, or text such as ``"1e-9rad"`` or ``"0.1deg"``.

    Raises
    ------
    UsageError
        The text is not a number with one of these units.

    Examples
    --------
    >>> angle_rad("90deg")
    1.5707963267948966
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    match = _ANGLE.fullmatch(str(value).strip())
    parsed = float(match[1]) if match else math.inf
    if not match or math.isinf(parsed):
        raise UsageError(
            f"{quoted(value)} is not an angle; write a number with its unit, such as 1e-9rad or "
            "0.1deg"
        )
    return math.radians(parsed) if match[2] == "deg" else parsed


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


COMPARE: Mapping[str, Callable[[object], Any]] = {
    "tol": angle_rad,
    "align": Choice(*ALIGNMENTS),
    "time_offset": time_offset_ns,
    "match": Choice(*MATCHES),
    "max_dt": duration,
    "min_matched": _percentage,
    "window": duration,
}
"""How two series are compared: setting -> its parser, which takes text or a Python value."""


class CompareOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.compare`, as for :class:`ComparisonSettings`.

    Angles may be texts with a unit, such as ``"0.1deg"``, durations such as ``"-12ms"``.
    """

    tol: float | str | None
    align: str
    time_offset: int | str
    match: str | None
    max_dt: int | str | None
    min_matched: float | None
    window: int | str | None


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
    values: dict[str, Any] = {}
    for name, value in options.items():
        if name not in COMPARE:
            raise UsageError(f"there is no setting {quoted(name)}; choose from {listed(COMPARE)}")
        if value is not None:
            values[name] = COMPARE[name](value)
    return ComparisonSettings(**values)
