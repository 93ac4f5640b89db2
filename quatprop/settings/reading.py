"""The settings for reading a log: their names, and how their values are parsed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime, timedelta
from fractions import Fraction
from os import PathLike
from typing import Annotated, Any, Literal, NamedTuple, Self, TypedDict

from quatprop.base.text import Setting
from quatprop.base.times import Instant
from quatprop.settings.bias import GivenBias, StaticBias
from quatprop.settings.parsers import (
    MATRIX_COLUMNS,
    Choice,
    InMemory,
    Keyword,
    column_list,
    flag,
    frequency,
    keywords_of,
    length,
    moment,
    path,
    text,
)
from quatprop.settings.quantities import (
    CLOCKS,
    CONVENTIONS,
    DIRECTIONS,
    EULER_SEQUENCES,
    LAYOUTS,
    RATE_UNITS,
    TIME_UNITS,
    ClockName,
    Convention,
    Direction,
    EulerSequence,
    Layout,
    RateUnit,
    TimeUnit,
)
from quatprop.stores.kinds import READERS


def text_or_number(value: object) -> str:
    """Return a name that may be given as a number."""
    return text(str(value))


OPTION_NAMES = {"kind": "from", "representation": "as", "extra_columns": "with"}
"""Settings whose name as an option or a key of a suite is a Python keyword -> that name."""


Start = Annotated[
    str | int | datetime | None,
    Keyword(
        moment,
        "Use {log} from here: RFC 3339, ns, +10s from its first or -30s from its last sample.",
        "all",
        "TIME",
        "Time range",
        common=True,
    ),
]
End = Annotated[str | int | datetime | None, Keyword(
    moment, f"Use {{log}} up to here; as {Setting('start')}.", "all", "TIME", "Time range",
    common=True)]  # fmt: skip


class SelectOptions(TypedDict, total=False):
    """Keywords that choose a topic and its time base."""

    # fmt: off
    kind: Annotated[str | None, Keyword(
        Choice(*READERS), "Kind of {log}.", "detected from content, then suffix", "KIND")]
    topic: Annotated[str | None, Keyword(
        text, "Topic of {log}.", "the only one with {signal}", "NAME", common=True)]
    msg_path: Annotated[str | PathLike[str] | None, Keyword(
        path,
        "Message definitions for {log}: a .msg file, or a folder of them.",
        "those in or next to the log", "PATH")]
    clock: Annotated[ClockName | None, Keyword(
        Choice(*CLOCKS), "Timestamp source.", "header if the message has one, else log")]
    time_field: Annotated[str | None, Keyword(
        text, "Message field of {log} that is the time.", "the header timestamp", "A.B")]
    time_col: Annotated[str | int | None, Keyword(
        text_or_number, f"Time column of {{log}}, by name or number from 0; two "
        "(SEC,NANOSEC, SEC,USEC or SEC,MSEC) of one timestamp; none counts rows at "
        f"{Setting('sample_rate')}; a column of intervals, such as dt, is summed.", "from the "
        "header", "C|none")]
    time_unit: Annotated[TimeUnit | None, Keyword(
        Choice(*TIME_UNITS), "Unit of the time in {log}.", "as the log says")]
    sample_rate: Annotated[float | Fraction | str | None, Keyword(
        frequency,
        "Sample rate of {log}, a table without timestamps, or counts per second of its sample "
        f"counter or of the ticks in {Setting('time_col')}, Hz.", takes="HZ")]
    series: Annotated[str | int | None, Keyword(
        text_or_number, "Which of the series in {log}: a label in its rows or "
        "in the names of its columns, or a frame or publisher of its messages; all reads the rows "
        "of all as one.",
        "the only one there is", "VALUE|COLUMN=VALUE|all")]
    # fmt: on


class RateOptions(SelectOptions, total=False):
    """Keywords that select the rates to read, besides those of :class:`SelectOptions`."""

    # fmt: off
    rate_field: Annotated[str | None, Keyword(
        text, "Message field that is the rate.", "known from the message type", "A.B.C")]
    rate_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("X,Y,Z"), "Rate columns of a table; by name or number from 0.",
        "from the header", "X,Y,Z", common=True)]
    rate_unit: Annotated[RateUnit | None, Keyword(
        Choice(*RATE_UNITS), "Unit of the rates.", "as the log says", common=True)]
    # fmt: on


RegularTime = Annotated[bool | None, Keyword(
    flag, "Replace timestamps that jitter about a steady clock, as times of arrival, rounded ones "
    "and those of packets of samples do, by the times of that clock. Gaps stay, as whole numbers "
    "of its intervals; timestamps without such a clock are refused.", "timestamps as they are",
    group="Timestamps")]  # fmt: skip

InSequence = Annotated[bool | None, Keyword(
    flag, "Read several files one after another, in the order in which they are named, each from "
    "one interval after the end of the one before: for clocks that begin anew in each.",
    "in the order of their times", group="Timestamps")]  # fmt: skip


# fmt: off
OnBackwards = Annotated[Literal["error", "drop", "sort"] | None, Keyword(
    Choice("error", "drop", "sort"), "Timestamps that go backwards: refuse, drop until the "
    "clock has caught up, or sort (holds the log in memory); drop and sort discard "
    "timestamps that are far ahead of later ones.", "error", group="Timestamps",
    common=True)]
OnNonfinite = Annotated[Literal["error", "drop", "hold"] | None, Keyword(
    Choice("error", "drop", "hold"), "Rates that are NaN or infinite: refuse, drop, or hold "
    "the previous rate.", "error", group="Timestamps")]
MaxGap = Annotated[float | str | timedelta | None, Keyword(
    length, "Intervals longer than this count as gaps.", "10 median intervals", "DUR",
    "Timestamps")]
# fmt: on


class ReadOptions(RateOptions, total=False):
    """Keywords of :func:`quatprop.read_rates`, besides those of :class:`RateOptions`."""

    regular_time: RegularTime
    in_sequence: InSequence


class SeriesOptions(SelectOptions, total=False):
    """Keywords that select the attitudes to read, besides those of :class:`SelectOptions`."""

    # fmt: off
    quat_field: Annotated[str | None, Keyword(
        text, "Message field of {log} that is the quaternion.", "known from the message type",
        "A.B.C")]
    quat_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("A,B,C[,D]", *MATRIX_COLUMNS), f"Columns of the quaternion in {{log}} in the "
        f"order in which they are stored, by name or number from 0; or of three angles, with "
        f"{Setting('from_euler')}; or of a matrix row by row, 9, or 12 with the position."
        ,
        "from the header", "A,B,C[,D]")]
    frame: Annotated[str | None, Keyword(
        text, "Which transform of {log}, if it is a list of them.", "the only one there is",
        "[PARENT:]CHILD")]
    from_layout: Annotated[Layout | None, Keyword(
        Choice(*LAYOUTS), "Order of the quaternion in {log}.",
        "from names, definitions or metadata; required if none of them states it")]
    from_convention: Annotated[Convention | None, Keyword(
        Choice(*CONVENTIONS), "Convention of {log}.", "from metadata, else hamilton")]
    from_direction: Annotated[Direction | None, Keyword(
        Choice(*DIRECTIONS), "Which coordinates {log} transforms into which.",
        "from metadata, else body-to-ref")]
    from_angle_unit: Annotated[Literal["rad", "deg"] | None, Keyword(
        Choice("rad", "deg"), "Unit of angles in {log}, a table of yaw, pitch, roll or rotation "
        "vectors.", "from names; required if they do not state it")]
    from_euler: Annotated[EulerSequence | None, Keyword(
        Choice(*EULER_SEQUENCES), "Sequence of the angles in {log}: xyz turns about x, the new y "
        "and the newest z. yaw, pitch and roll are about z, y and x.", "zyx, or from names")]
    # fmt: on


class AttitudeOptions(SeriesOptions, total=False):
    """Keywords of :func:`quatprop.read_attitudes`, besides those of :class:`SeriesOptions`."""

    # fmt: off
    normalize: Annotated[bool | None, Keyword(
        flag, "Scale quaternions to unit length.", "refuse those off by more than 0.001")]
    on_invalid: Annotated[Literal["error", "drop"] | None, Keyword(
        Choice("error", "drop"),
        "Invalid quaternions (zero, NaN, marked absent, not of unit length): refuse or drop.",
        "error")]
    start: Start
    end: End
    # fmt: on


class NoiseOptions(RateOptions, total=False):
    """Keywords of :func:`quatprop.noise`, besides those of :class:`RateOptions`."""

    start: Start
    end: End
    on_backwards: OnBackwards
    on_nonfinite: OnNonfinite
    max_gap: MaxGap
    in_sequence: InSequence


class PlotOptions(RateOptions, SeriesOptions, total=False):
    """Keywords of :func:`quatprop.plot`, besides those of both base classes."""

    start: Start
    end: End


NOISE = keywords_of(NoiseOptions)
"""Settings of a measurement of noise: name -> its row."""

PLOT = keywords_of(PlotOptions)
"""Settings for reading the files of a picture: name -> its row."""

READ_RATES = keywords_of(RateOptions)
"""Settings for reading rates: name -> its row."""

RATES_IN_MEMORY = keywords_of(ReadOptions)
"""The same, and the handling of timestamps of rates that are only read."""

ONE_SERIES = keywords_of(SeriesOptions)
"""Settings of each series if several are read: name -> its row."""

READ_ATTITUDES = keywords_of(AttitudeOptions)
"""Settings for reading attitudes: name -> its row."""

CHECKS = {name: READ_ATTITUDES[name] for name in ("normalize", "on_invalid")}
"""Settings for checking attitudes, common to several series: name -> its row."""


# Which samples of a log to read.


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSelection:
    """Which topic to read, and which time base; None means "not given".

    A field is the setting of its name in :class:`SelectOptions`, parsed; likewise in the records
    that inherit from this one.
    """

    topic: str | None = None
    msg_path: str | None = None
    clock: str | None = None
    time_field: str | None = None
    time_col: str | None = None
    time_unit: str | None = None
    sample_rate: Fraction | float | None = None
    series: str | None = None

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> Self:
        """Return a selection from the values for its fields; missing ones are not given."""
        given = {field.name: values.get(field.name) for field in fields(cls)}
        return cls(**{name: value for name, value in given.items() if value is not None})


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSelection(SignalSelection):
    """Which body rates to read: the settings of :class:`RateOptions`, and three that say more.

    `accel_cols`: the columns of the specific force next to the rates, in any unit
    `rates`: ``"body"`` or ``"inertial"``: the frame in which they are resolved
    `in_sequence`: whether several files are set one after another, whatever their times
    """

    rate_field: str | None = None
    rate_cols: tuple[str, str, str] | None = None
    rate_unit: str | None = None
    accel_cols: tuple[str, str, str] | None = None
    rates: str | None = field(default=None, compare=False)  # the same by default as when given
    in_sequence: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSelection(SignalSelection):
    """Which attitudes to read, and what they mean: the settings of :class:`SeriesOptions`."""

    quat_field: str | None = None
    quat_cols: tuple[str, ...] | None = None
    frame: str | None = None
    from_layout: str | None = None
    from_convention: str | None = None
    from_direction: str | None = None
    from_angle_unit: str | None = None
    from_euler: str | None = None

    @classmethod
    def like(cls, other: SignalSelection) -> Self:
        """Return a selection of attitudes with the topic and the time base of another one."""
        return cls(**{f.name: getattr(other, f.name) for f in fields(SignalSelection)})


class GyroCorrection(NamedTuple):
    """Corrections of the rates; None: not applied.

    `bias`: constant bias to subtract
    `static`: bias from the mean over a stationary period
    `bias_from`: bias from a series: a file, a topic of the log, or in memory
    `calibration`: path of a calibration; see
        :func:`.read_calibration`. Another bias replaces its own
    `mount`: rotation from sensor to body axes; see :func:`mounting`; or ``"tf:FRAME"``
    `rates`: frame in which the rates are resolved, ``"body"`` or ``"inertial"``; the mounting does
        not rotate the latter
    `start`, `end`: time range to use, ends included
    """

    bias: GivenBias | None = None
    static: StaticBias | None = None
    bias_from: str | InMemory | None = None
    calibration: str | None = None
    mount: str | None = None
    rates: str = "body"
    start: Instant | None = None
    end: Instant | None = None

    @property
    def interpolates(self) -> bool:
        """Whether the bias is interpolated between stationary periods."""
        return self.static is not None and self.static.between == "interpolate"

    @property
    def looks_ahead(self) -> bool:
        """Whether the log must be read once before it is propagated."""
        origins = {instant.origin for instant in (self.start, self.end) if instant is not None}
        return self.static is not None or bool(origins - {"clock"})
