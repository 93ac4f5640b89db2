"""The settings of ``compare``, ``convert`` and ``calibrate``."""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from fractions import Fraction
from os import PathLike
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, TypedDict, Unpack, get_args

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, quoted, shown
from quatprop.base.times import Instant
from quatprop.settings import parse_all
from quatprop.settings.parsers import (
    Choice,
    Keyword,
    Rotated,
    column_names,
    flag,
    frequency,
    keywords_of,
    length,
    moment,
    mounting,
    number,
    parts_of,
    path,
    signed_duration,
    text,
)
from quatprop.settings.quantities import (
    CONVENTIONS,
    DIRECTIONS,
    RAD_PER_UNIT,
    RATES,
    RATIOS,
    SIGNS,
    Convention,
    Direction,
    Sign,
    quantity,
    quantity_of,
)
from quatprop.settings.reading import AttitudeOptions, End, OnBackwards, OnNonfinite, Start

Alignment: TypeAlias = Literal["none", "first", "yaw", "mean", "mount"]
ALIGNMENTS: tuple[str, ...] = get_args(Alignment)
"""How B is aligned before the comparison."""

BY_ALL = {"yaw", "mean", "mount"}
"""Alignments by all pairs: with one, the error of a constant drift first falls, then rises."""

ERROR_LIMITS = (
    *("tol", "rms_tol", "final_tol", "p95_tol", "window_tol", "window_rms_tol"),
    *("tol_heading", "tol_inclination", "max_sigma"),
)
"""Settings that limit the error itself; others limit its drift and the coverage."""

AlignRange: TypeAlias = Literal["all", "judged"]
ALIGN_RANGES: tuple[str, ...] = get_args(AlignRange)
"""The pairs by which B is aligned: all that were matched, or those that are judged."""

Matching: TypeAlias = Literal["exact", "nearest", "interpolate"]
MATCHES: tuple[str, ...] = get_args(Matching)
"""How attitudes are matched in time: equal timestamps, the nearest sample, interpolation."""

DEG_H_PER_UNIT = {"deg/h": 1.0, "deg/s": 3600.0, "rad/s": 3600 * 180 / math.pi}
"""Unit of a drift -> deg/h."""


@dataclass(frozen=True, slots=True)
class Sigmas:
    """A limit on an error in standard deviations: its Mahalanobis distance from 0."""

    count: float

    def __str__(self) -> str:
        return f"{self.count:g}sigma"


class InstantRange(NamedTuple):
    """A time range, ends included."""

    start: Instant
    end: Instant

    def __str__(self) -> str:
        return f"{self.start}..{self.end}"


@dataclass(frozen=True, slots=True)
class ComparisonSettings:
    """How to compare two attitude series A and B.

    `tol`, `rms_tol`, `final_tol`, `p95_tol`: limits on the largest, RMS, final and 95th percentile
        geodesic error, rad or in standard deviations; None: no limit
    `window_tol`, `window_rms_tol`: limits on the largest and RMS error of rotations over windows,
        rad
    `tol_heading`, `tol_inclination`: limits on the error about the reference z axis, and on the
        angle between the z axes, rad
    `drift_tol`: limit on the magnitude of the drift, deg/h; not with an alignment by all pairs
    `min_coverage`: minimum percentage of the time and of the samples of B that must be compared
    `max_sigma`: limit on the largest error in standard deviations, in addition to `tol` in rad
    `align`: one of :data:`ALIGNMENTS`
    `align_range`: one of :data:`ALIGN_RANGES`
    `time_offset`: added to B's timestamps, ns, or ``"auto"``: estimated from the angular speeds
    `match`: one of :data:`MATCHES`; None: see
        :func:`quatprop.comparison.association.associate`
    `max_dt`: maximum distance of a sample from its partner, ns; None: depends on the median
        interval
    `min_matched`: percentage of the samples in the common time that must be matched, 0 to 100
    `window`: also compare the rotations over windows of this length, ns; None: no windows
    `judge`: time ranges of the pairs that are judged; empty: all pairs
    `start`, `end`: the part of both series that is compared, ends included
    `rate`: rate at which A and B are interpolated, Hz; None: see `match`
    """

    tol: float | Sigmas | None = None
    rms_tol: float | Sigmas | None = None
    final_tol: float | Sigmas | None = None
    p95_tol: float | Sigmas | None = None
    window_tol: float | None = None
    window_rms_tol: float | None = None
    tol_heading: float | None = None
    tol_inclination: float | None = None
    drift_tol: float | None = None
    min_coverage: float | None = None
    max_sigma: Sigmas | None = None
    align: str = "none"
    align_range: str = "all"
    time_offset: int | Literal["auto"] = 0
    match: str | None = None
    max_dt: int | None = None
    min_matched: float = 50.0
    window: int | None = None
    judge: tuple[InstantRange, ...] = ()
    start: Instant | None = None
    end: Instant | None = None
    rate: Fraction | None = None

    def __post_init__(self) -> None:
        for name in ("window_tol", "window_rms_tol"):
            if getattr(self, name) is not None and not self.window:
                raise UsageError(
                    f"{Setting(name)} needs windows; give their length with {Setting('window')}"
                )
        if self.rate is not None and self.match not in {None, "interpolate"}:
            raise UsageError(f"{Setting('rate')} requires {Setting('match', 'interpolate')}")
        if self.drift_tol is not None and self.align in BY_ALL:
            raise UsageError(
                f"{Setting('drift_tol')} needs {Setting('align', 'none|first')}: an alignment by "
                f"all pairs ({Setting('align', self.align)}) removes part of the drift"
            )

    @property
    def smallest_limit_rad(self) -> float:
        """The smallest limit on an error, rad; infinite without a limit."""
        limits = (getattr(self, name) for name in ERROR_LIMITS)
        return min((each for each in limits if isinstance(each, float | int)), default=math.inf)

    @property
    def is_limited(self) -> bool:
        """Whether there is a limit on an error."""
        return any(getattr(self, name) is not None for name in (*ERROR_LIMITS, "drift_tol"))

    @property
    def in_parts(self) -> bool:
        """Whether errors in heading and inclination are reported."""
        return self.align == "yaw" or (self.tol_heading, self.tol_inclination) != (None, None)

    @property
    def limit_rad(self) -> float:
        """Maximum error that passes, rad; infinite without a limit."""
        return self.tol if isinstance(self.tol, float | int) else math.inf


angle_rad = quantity_of(RAD_PER_UNIT, "an angle", "1e-9rad or 0.1deg")
"""Return an angle in rad: a number in rad, or text such as ``"1e-9rad"`` or ``"0.1deg"``."""


def error_limit(value: object) -> float | Sigmas:
    """Return a limit on an error: an angle, in rad or with a unit, or text such as ``"3sigma"``."""
    if isinstance(value, Sigmas):
        return value
    if isinstance(value, str) and value.rstrip().endswith("sigma"):
        return Sigmas(quantity(value, {"sigma": 1.0}, "an error in standard deviations", "3sigma"))
    return quantity(value, RAD_PER_UNIT, "an angle", "1e-9rad or 0.1deg, or in sigma: 3sigma")


def time_offset_ns(value: object) -> int | Literal["auto"]:
    """Return a signed duration, ns, as :func:`signed_duration` reads it; or ``"auto"``."""
    if value == "auto":
        return "auto"
    return signed_duration(value)


def _percentage(value: object) -> float:
    percentage = number(value)
    if not 0 <= percentage <= 100:  # noqa: PLR2004  # percent
        raise UsageError(f"{quoted(value)} is not a percentage from 0 to 100")
    return percentage


def time_ranges(value: object) -> tuple[InstantRange, ...]:
    """Return time ranges from text such as ``"+10s..+20s,+30s..+40s"`` or pairs of instants."""
    ranges = []
    for part in value.split(",") if isinstance(value, str) else _items(value):
        ends = part.split("..") if isinstance(part, str) else _items(part)
        if len(ends) != 2:  # noqa: PLR2004  # start and end
            raise UsageError(f"{shown(part)} is not a time range; write START..END, as +10s..+20s")
        first, last = (end.strip() if isinstance(end, str) else end for end in ends)
        ranges.append(InstantRange(moment(first), moment(last)))
    return tuple(ranges)


def _items(value: object) -> list[object]:
    return list(value) if isinstance(value, Iterable) else [value]


def _sigmas(value: object) -> Sigmas:
    if isinstance(value, Sigmas):
        return value
    if (parsed := number(value)) <= 0:
        raise UsageError(f"{shown(value)} is not a number above 0")
    return Sigmas(parsed)


drift_deg_h = quantity_of(DEG_H_PER_UNIT, "a drift", "10deg/h")
"""Return a drift in deg/h: a number in deg/h, or text such as ``"10deg/h"``."""


class CompareOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.compare`: text with units, or numbers in rad, s or percent."""

    # fmt: off
    tol: Annotated[float | str | None, Keyword(
        error_limit, "Maximum error allowed, such as 1e-9rad or 0.1deg, or 3sigma if a series has "
        "standard deviations. "
        f"{Setting('rms_tol')}, {Setting('final_tol')} and {Setting('p95_tol')} take the same.",
        "none, all pass", "ANGLE", "Limits", common=True)]
    rms_tol: Annotated[float | str | None, Keyword(
        error_limit, "Maximum RMS error allowed.", takes="ANGLE", group="Limits")]
    final_tol: Annotated[float | str | None, Keyword(
        error_limit, "Maximum final error allowed.", takes="ANGLE", group="Limits")]
    p95_tol: Annotated[float | str | None, Keyword(
        error_limit, "Maximum 95th percentile of the error allowed.", takes="ANGLE",
        group="Limits")]
    window_tol: Annotated[float | str | None, Keyword(
        angle_rad, f"Maximum error over windows allowed; with {Setting('window')}.",
        takes="ANGLE", group="Limits")]
    window_rms_tol: Annotated[float | str | None, Keyword(
        angle_rad, f"Maximum RMS error over windows allowed; with {Setting('window')}.",
        takes="ANGLE", group="Limits")]
    tol_heading: Annotated[float | str | None, Keyword(
        angle_rad, "Maximum heading error allowed: about the z axis of the reference frame.",
        takes="ANGLE", group="Limits")]
    tol_inclination: Annotated[float | str | None, Keyword(
        angle_rad, "Maximum inclination error allowed: the angle between the z axes.",
        takes="ANGLE", group="Limits")]
    drift_tol: Annotated[float | str | None, Keyword(
        drift_deg_h, f"Maximum drift allowed, in either direction, such as 10deg/h; with "
        f"{Setting('align', 'none|first')}.", takes="DRIFT", group="Limits")]
    min_coverage: Annotated[float | None, Keyword(
        _percentage,
        "Minimum share of {log}, of its time and of its samples, that must be compared.",
        "25 of the time of either series if an error is limited", "PERCENT", "Limits")]
    max_sigma: Annotated[float | None, Keyword(
        _sigmas,
        "Maximum error allowed, in standard deviations (Mahalanobis distance), in addition to "
        "one in rad or deg.", takes="N", group="Limits")]
    align: Annotated[Alignment, Keyword(
        Choice(*ALIGNMENTS),
        "How {log} is aligned first: not at all; its reference frame by the first pair, by the "
        "mean of all pairs, or in heading only (yaw); or its reference and body frames (mount), "
        "estimated from the motion.", group="Alignment", common=True)]
    align_range: Annotated[AlignRange, Keyword(
        Choice(*ALIGN_RANGES),
        f"Which pairs {Setting('align')} uses with {Setting('judge')}: all matched ones, or "
        "those that are judged.", "all", group="Alignment")]
    time_offset: Annotated[float | str | timedelta, Keyword(
        time_offset_ns,
        "Added to the timestamps of {log}, such as -12ms; auto estimates it from the "
        "angular speeds, together with the lag of the integration rule.", takes="DUR|auto",
        group="Alignment", common=True)]
    match: Annotated[Matching | None, Keyword(
        Choice(*MATCHES),
        "How attitudes are matched: equal timestamps, nearest, or interpolated at the "
        "timestamps of the series with the longer intervals.",
        f"exact if at least half have equal timestamps, else nearest with {Setting('max_dt')}, "
        "else "
        f"interpolate", group="Alignment")]
    max_dt: Annotated[float | str | timedelta | None, Keyword(
        length, f"Maximum time between samples that are matched or interpolated between. "
        f"Without {Setting('match')}, it also selects nearest instead of interpolate.",
        "half the median interval to the nearest, 10 to interpolate", "DUR", "Alignment")]
    min_matched: Annotated[float | None, Keyword(
        _percentage, "Percentage of the shorter series that must be matched.", "50", "PERCENT",
        "Alignment")]
    window: Annotated[float | str | timedelta | None, Keyword(
        length, "Also compare the rotations over windows of this length.", takes="DUR",
        group="Alignment", common=True)]
    judge: Annotated[str | Collection[Any] | None, Keyword(
        time_ranges,
        "Judge only these times, such as +10s..+20s,+45s..-5s; +10s counts from the first pair, "
        f"-5s from the last. {{log}} is aligned by all pairs, unless {Setting('align_range')} says "
        "otherwise.", "all", "START..END,...", "Alignment")]
    start: Annotated[str | int | datetime | None, Keyword(
        moment, "Compare from here on: RFC 3339 or ns of A's clock, +10s from A's first or -30s "
        "from its last attitude. A and B are cut before they are aligned and matched; "
        f"{Setting('judge')} cuts the errors alone.", "all", "TIME", "Time range", common=True)]
    end: Annotated[str | int | datetime | None, Keyword(
        moment, f"Compare up to here; as {Setting('start')}.", "all", "TIME", "Time range",
        common=True)]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency, "Rate at which the error is judged: both are interpolated to times counted from "
        "the start of A, but not across gaps. Both are held in memory.",
        "that of the series with the longer intervals", "HZ", "Alignment")]
    # fmt: on


COMPARE = keywords_of(CompareOptions)
"""Settings of a comparison: name -> its keyword."""


def comparison_settings(**options: Unpack[CompareOptions]) -> ComparisonSettings:
    """Return settings from numbers (rad, s) or text with units."""
    return ComparisonSettings(**parse_all(options, COMPARE))


# The keywords of a conversion.


ROTATION = "W,X,Y,Z|x,-y,-z|rpy:R,P,Y|ned-to-enu|frd-to-flu"


class ConvertOptions(AttitudeOptions, total=False):
    """Keywords of :func:`quatprop.convert` besides those of :class:`AttitudeOptions`."""

    # fmt: off
    convention: Annotated[Convention | None, Keyword(
        Choice(*CONVENTIONS), "Convention of OUT.", "hamilton", group="Output", common=True)]
    direction: Annotated[Direction | None, Keyword(
        Choice(*DIRECTIONS), "Which coordinates OUT transforms into which.", "body-to-ref",
        group="Output", common=True)]
    sign: Annotated[Sign | None, Keyword(
        Choice(*SIGNS), "Sign of q, as q and -q are the same attitude: keep leaves it; continuous "
        "takes the one nearer to the previous row; positive takes w >= 0 (for half turns, w = 0, "
        "the first component that is not zero is positive).", "keep", group="Output", common=True)]
    left: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "From the reference axes of {log} to the reference axes of OUT: a quaternion with "
        "v_new = r v_old r*, the old axes that become x, y and z, fixed-axis angles (deg), or a "
        "name. Positions are rotated as well.", "no rotation", ROTATION, "Output", common=True)]
    right: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "From the body axes of {log} to the body axes of OUT, in the same way: q_out = LEFT q_in "
        "RIGHT*. Covariances are rotated as well.", "no rotation", ROTATION, "Output", common=True)]
    relative_to: Annotated[str | PathLike[str] | None, Keyword(
        path, "Write the attitude of the body of {log} in the axes of another, q_FILE* q, such as "
        "the angle of a joint: FILE (FILE:TOPIC) holds the attitudes of the other body against the "
        "same reference, and is interpolated in time.", "the reference", "FILE", "Output",
        common=True)]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency, "Output rate: the attitudes of {log} are interpolated by polynomials "
        "through six of them, not across gaps; holds them in memory.", "as they are", "HZ",
        "Output", common=True)]
    keep: Annotated[str | Collection[str] | None, Keyword(
        column_names, "Carry these columns of numbers along from {log} to a table, by name.",
        "none", "A,B,...", "Output")]
    seconds: Annotated[bool | None, Keyword(
        flag, "Also write a column seconds: the time since the first attitude, s; to a table.",
        group="Output")]
    list_column: Annotated[str | None, Keyword(
        text, "Write the attitude as one column of lists of this name, such as observation.state, "
        "in parquet or feather.", "a column each", "NAME", "Output")]
    # fmt: on


CONVERT = keywords_of(ConvertOptions)
"""All keywords of a conversion, with those of reading: name -> row."""

TERMS = {name: row for name, row in CONVERT.items() if name not in keywords_of(AttitudeOptions)}
"""The keywords of the conversion only."""


# The settings of a calibration.


class ParameterGroup(NamedTuple):
    """Parameters of one kind.

    `axes`: one name for each
    `prior`: standard deviation that is assumed before: rad/s, a ratio, rad or s; None: depends
    `units`: those in which it can be given
    `factor`, `unit`: those in which values are shown
    """

    axes: tuple[str, ...]
    prior: float | None
    units: dict[str, float]
    factor: float
    unit: str


TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

# fmt: off
GROUPS = {
    "bias": ParameterGroup(("x", "y", "z"), math.radians(2), RATES, 180 / math.pi, "deg/s"),
    "scale": ParameterGroup(("x", "y", "z"), 0.03, RATIOS, 100.0, "%"),
    "misalignment": ParameterGroup(
        ("xy", "xz", "yz"), math.radians(2), RAD_PER_UNIT, 180 / math.pi, "deg"),
    "mount": ParameterGroup(
        ("x", "y", "z"), math.radians(20), RAD_PER_UNIT, 180 / math.pi, "deg"),
    "offset": ParameterGroup(
        ("",), None, TIMES, 1e3, "ms, added in the middle of the reference"),
    "drift": ParameterGroup(
        ("",), 50e-6, RATIOS, 1e6, "ppm, by which that offset grows with time"),
}
"""Parameters that can be estimated; the priors are those of usual MEMS gyroscopes and crystals."""
# fmt: on


def estimated(value: object) -> tuple[str, ...]:
    """Return which parameters to estimate: text such as ``"bias,mount"``, ``"all"``, or names."""
    names = [Choice(*GROUPS, "all")(str(name).strip()) for name in parts_of(value)]
    return tuple(name for name in GROUPS if name in names or "all" in names)


def priors(value: object) -> dict[str, float]:
    """Return standard deviations of groups: text such as ``"scale=1%,bias=0.1deg/s"``, or a dict.

    `Returns`: group -> rad/s, a ratio, rad or s
    """
    items = value.items() if isinstance(value, Mapping) else map(_name_and_size, parts_of(value))
    found = {}
    for name, size in items:
        group = Choice(*GROUPS)(str(name).strip())
        example = f"1{next(iter(GROUPS[group].units))}"
        found[group] = quantity(
            size, GROUPS[group].units, f"a standard deviation of {group}", example
        )
        if not found[group]:
            raise UsageError(
                f"a prior of 0 would hold {group}; leave it out of {Setting('estimate')}"
            )
    return found


def _name_and_size(part: object) -> tuple[str, str]:
    name, equals, size = str(part).partition("=")
    if not equals:
        raise UsageError(f"{shown(part)} is not NAME=SIZE, such as scale=1%")
    return name, size.strip()


class CalibrateOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.calibrate`."""

    # fmt: off
    estimate: Annotated[str | Collection[str] | None, Keyword(
        estimated, "Parameters to estimate: bias, scale, misalignment (of the sensor axes among "
        "themselves), mount (the rotation from sensor to body), offset and drift of the "
        "clock; or all. Parameters that the motion does not show are listed as unknown.", "all",
        "NAMES", "Options")]
    window: Annotated[float | str | timedelta | None, Keyword(
        length, "Length of the windows over which rotations are compared.",
        "the one of 0.1 to 5 s that shows the parameters best", "DUR", "Options")]
    time_offset: Annotated[float | str | timedelta | None, Keyword(
        time_offset_ns, "Added to the timestamps of the reference beforehand; the estimate "
        "begins there. auto finds it from the rotation rates.", "auto if the offset is "
        "estimated, else 0", "DUR|auto", "Options")]
    prior: Annotated[str | Mapping[str, float | str] | None, Keyword(
        priors, "Standard deviations that are assumed before: of each name of "
        f"{Setting('estimate')}. A parameter not known to half of it is not determined.",
        "bias=2deg/s,scale=3%,misalignment=2deg,mount=20deg,drift=50ppm, and one interval for the "
        "offset", "NAME=SIZE,...", "Options")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting, f"Sensor-to-body rotation that is known beforehand, as for {Setting('mount')} of "
        "propagate; the estimate begins there.", "the same axes", "W,X,Y,Z|x,-y,-z|...",
        "Options")]
    # fmt: on
    start: Start
    end: End
    on_backwards: OnBackwards
    on_nonfinite: OnNonfinite


CALIBRATE = keywords_of(CalibrateOptions)
"""How a calibration is estimated: name -> its row."""
