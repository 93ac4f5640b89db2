"""What a user may set about reading and propagating a log: every name, and how its value is read.

The names are those of the library's keywords. The command line spells them as options
(``on_gap`` is ``--on-gap``), a suite as keys (``on-gap``). Each has one row in a class of keywords
here: the types that the library takes, the parser, which takes a value as text, as TOML has it, or
as Python has it, and what help and documents say. Nothing heavy is imported, so that ``quatprop
--help`` is quick.
"""

from collections.abc import Collection, Sequence
from datetime import datetime, timedelta
from fractions import Fraction
from os import PathLike
from typing import Annotated, Any, Literal, Protocol, TypeAlias, TypedDict, get_args

from quatprop.settings.error_options import ErrorOptions
from quatprop.settings.keyword import Keyword, keywords_of
from quatprop.settings.parsers import (
    Choice,
    column_list,
    count,
    flag,
    frequency,
    initial_attitude,
    length,
    moment,
    mounting,
    number,
    path,
    place,
    text,
    times,
)
from quatprop.settings.static_bias import bias
from quatprop.stores.kinds import READERS
from quatprop.text import Setting


class Rotated(Protocol):
    """A rotation, such as scipy's."""

    def as_matrix(self) -> Any:
        """Return its matrix, shape ``(3, 3)``."""


class Timed(Protocol):
    """A series of rates or of attitudes."""

    @property
    def t_ns(self) -> Any:
        """Its stamps, shape ``(N,)``, ns."""


Layout: TypeAlias = Literal["scalar-first", "scalar-last", "wxyz", "xyzw"]
LAYOUTS: tuple[str, ...] = get_args(Layout)
RateUnit: TypeAlias = Literal["rad/s", "deg/s"]
RATE_UNITS: tuple[str, ...] = get_args(RateUnit)
TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns"]
TIME_UNITS: tuple[str, ...] = get_args(TimeUnit)
ClockName: TypeAlias = Literal["header", "log", "publish"]
CLOCKS: tuple[str, ...] = get_args(ClockName)
Method: TypeAlias = Literal["start", "end", "mean", "coning", "cubic", "quintic"]
METHODS: tuple[str, ...] = get_args(Method)
LOOK_AHEAD = {"cubic", "quintic"}
"""Methods for which samples after an interval count."""
CORRECT_CONING = {"coning", *LOOK_AHEAD}
"""Methods that add to averages and increments how the axis has turned."""
Frame: TypeAlias = Literal["body", "inertial"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""Where rates may be resolved: body rates multiply on the right, inertial rates on the left."""
EulerSequence: TypeAlias = Literal[
    "zyx", "xyz", "xzy", "yxz", "yzx", "zxy", "zxz", "zyz", "xyx", "xzx", "yxy", "yzy"
]
EULER_SEQUENCES: tuple[str, ...] = get_args(EulerSequence)
"""Axes of intrinsic rotations in their order: Tait-Bryan angles, then proper Euler angles."""
Convention: TypeAlias = Literal["hamilton", "jpl"]
CONVENTIONS: tuple[str, ...] = get_args(Convention)
Direction: TypeAlias = Literal["body-to-ref", "ref-to-body"]
DIRECTIONS: tuple[str, ...] = get_args(Direction)
Sign: TypeAlias = Literal["keep", "continuous", "positive"]
SIGNS: tuple[str, ...] = get_args(Sign)
OPTION_NAMES = {"kind": "from", "representation": "as", "extra_columns": "with"}
"""Settings whose name as an option or a key of a suite is a word of Python -> that name."""


class SelectOptions(TypedDict, total=False):
    """Keywords that choose a topic and its time base."""

    # fmt: off
    kind: Annotated[str | None, Keyword(
        Choice(*READERS), "Kind of {log}.", "told by its content, then by its suffix", "KIND")]
    topic: Annotated[str | None, Keyword(
        text, "Topic of {log}.", "the only one with {signal}", "NAME", common=True)]
    msg_path: Annotated[str | PathLike[str] | None, Keyword(
        path, "Message definitions for {log}: a .msg file, or a folder of them.", "those in the "
        "log or beside it", "PATH")]
    clock: Annotated[ClockName | None, Keyword(
        Choice(*CLOCKS), "Timestamp source.", "header where the message has one, else log")]
    time_field: Annotated[str | None, Keyword(
        text, "Message field of {log} that is the time.", "the header stamp", "A.B")]
    time_col: Annotated[str | int | None, Keyword(
        lambda value: text(str(value)), f"Time column of {{log}}, by name or number from 0; two "
        "(SEC,NANOSEC, SEC,USEC or SEC,MSEC) of one stamp; none counts rows at "
        f"{Setting('sample_rate')}.", "by the header", "C")]
    time_unit: Annotated[TimeUnit | None, Keyword(
        Choice(*TIME_UNITS), "Unit of the time in {log}.", "as the log says")]
    sample_rate: Annotated[float | Fraction | str | None, Keyword(
        frequency, "Rows a second of {log}, a table without a time, or what its counter of samples "
        "counts a second, Hz.", takes="HZ")]
    series: Annotated[str | int | None, Keyword(
        lambda value: text(str(value)), "Which of the interleaved series in the rows of {log}, "
        "such as those of two sensors; all reads them as one.", "the only one there is",
        "VALUE|COLUMN=VALUE")]
    # fmt: on


class RateOptions(SelectOptions, total=False):
    """Keywords that say which rates to read, beside those of :class:`SelectOptions`."""

    # fmt: off
    rate_field: Annotated[str | None, Keyword(
        text, "Message field that is the rate.", "known from the message type", "A.B.C")]
    rate_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("X,Y,Z"), "Rate columns of a table; by name or number from 0.", "by the header",
        "X,Y,Z", common=True)]
    rate_unit: Annotated[RateUnit | None, Keyword(
        Choice(*RATE_UNITS), "Unit of the rates.", "as the log says", common=True)]
    # fmt: on


RegularTime = Annotated[bool | None, Keyword(
    flag, "Replace timestamps that jitter about a steady clock, as times of arrival and rounded "
    "ones do, by the times of that clock. Gaps stay, as whole numbers of its intervals; timestamps "
    "without such a clock are refused.", "timestamps as they are", group="Timestamps")]  # fmt: skip


class ReadOptions(RateOptions, total=False):
    """Keywords of :func:`quatprop.read_rates`, beside those of :class:`RateOptions`."""

    regular_time: RegularTime


class SeriesOptions(SelectOptions, total=False):
    """Keywords that say which attitudes to read, beside those of :class:`SelectOptions`."""

    # fmt: off
    quat_field: Annotated[str | None, Keyword(
        text, "Message field of {log} that is the quaternion.", "known from the message type",
        "A.B.C")]
    quat_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("A,B,C[,D]"), f"Columns of the quaternion in {{log}} in the order in which "
        f"they are stored, by name or number from 0; or of three angles, with "
        f"{Setting('from_euler')}.",
        "by the header", "A,B,C[,D]")]
    frame: Annotated[str | None, Keyword(
        text, "Which transform of {log}, where it is a list of them.", "the only one there is",
        "[PARENT:]CHILD")]
    from_layout: Annotated[Layout | None, Keyword(
        Choice(*LAYOUTS), "Order of the quaternion in {log}.", "by names, definitions or metadata; "
        "required where none of them says it")]
    from_convention: Annotated[Convention | None, Keyword(
        Choice(*CONVENTIONS), "Convention of {log}.", "by metadata, else hamilton")]
    from_direction: Annotated[Direction | None, Keyword(
        Choice(*DIRECTIONS), "Which coordinates {log} turns into which.", "by metadata, else "
        "body-to-ref")]
    from_angle_unit: Annotated[Literal["rad", "deg"] | None, Keyword(
        Choice("rad", "deg"), "Unit of angles in {log}, a table of yaw, pitch, roll or rotation "
        "vectors.", "by names; required where they do not say it")]
    from_euler: Annotated[EulerSequence | None, Keyword(
        Choice(*EULER_SEQUENCES), "Sequence of the angles in {log}: xyz turns about x, the new y "
        "and the newest z. yaw, pitch and roll are about z, y and x.", "zyx, or by names")]
    # fmt: on


class AttitudeOptions(SeriesOptions, total=False):
    """Keywords of :func:`quatprop.read_attitudes`, beside those of :class:`SeriesOptions`."""

    # fmt: off
    normalize: Annotated[bool | None, Keyword(
        flag, "Scale quaternions to unit length.", "refuse those off by more than 0.001")]
    on_invalid: Annotated[Literal["error", "drop"] | None, Keyword(
        Choice("error", "drop"), "Invalid quaternions (zero, NaN, marked absent, not of unit "
        "length): refuse or leave out.", "error")]
    # fmt: on


class RunOptions(RateOptions, total=False):
    """Keywords that determine attitudes, beside those of :class:`RateOptions`."""

    # fmt: off
    start: Annotated[str | int | datetime | None, Keyword(
        moment, "Use {log} from here: RFC 3339, ns, +10s from its first or -30s from its last "
        "sample.", "all", "TIME", "Time range", common=True)]
    end: Annotated[str | int | datetime | None, Keyword(
        moment, f"Use {{log}} up to here; as {Setting('start')}.", "all", "TIME", "Time range",
        common=True)]
    method: Annotated[Method | None, Keyword(
        Choice(*METHODS), "Integration rule: the rate over an interval is that of the sample at "
        "its start, of the one at its end, their mean, linear between them (coning), a cubic "
        "through four samples (cubic) or a quintic through six (quintic, for sensors with next to "
        "no noise). The last three also correct averages and increments for coning.",
        "start; end where the log's samples are averages or increments",
        group="Integration", common=True)]
    rates: Annotated[Frame | None, Keyword(
        Choice(*FRAMES), "Frame the rates are resolved in: body multiplies right, inertial (or "
        "reference: in the axes of the reference) left.", "body", group="Integration")]
    earth_rate: Annotated[float | Collection[float] | None, Keyword(
        place, "Take off the rotation of the Earth at this latitude, deg: attitudes against the "
        "ground. The reference is east-north-up, or north-east-down if its z axis points down; "
        "AZIMUTH is that of another x axis, deg clockwise from north.", "attitudes against a "
        "reference that does not turn", "LAT[,AZIMUTH]", "Integration")]
    q0: Annotated[
        str | PathLike[str] | Collection[float] | Rotated | Timed | None, Keyword(
        initial_attitude, "First attitude, body-to-ref: four numbers; level, roll and pitch from "
        "gravity at rest; log, the orientation beside the rates; or FILE, an attitude series, or "
        "TOPIC of the log, at that time.", "identity", "W,X,Y,Z|level|log|FILE|TOPIC", "Initial "
        "attitude", common=True)]
    heading: Annotated[float | None, Keyword(
        number, f"For {Setting('q0', 'level')}: rotation about the reference's z axis, deg, right-"
        f"handed: 90 points body x along the reference's y.", "0", "DEG", "Initial attitude")]
    reference_z: Annotated[Literal["up", "down"] | None, Keyword(
        Choice("up", "down"), f"For {Setting('q0', 'level')} and {Setting('earth_rate')}: where "
        f"the reference's z axis points (down for north-east-down).", "up", group="Initial "
        "attitude")]
    accel_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("X,Y,Z"), f"Columns of the accelerometer beside the rates, in any unit, for "
        f"{Setting('q0', 'level')} and {Setting('bias', 'static')}; by name or number from 0.",
        "by their names", "X,Y,Z", "Initial attitude")]
    q0_layout: Annotated[Layout | None, Keyword(
        Choice(*LAYOUTS), f"Order of the four numbers of {Setting('q0')}.", "scalar-first",
        group="Initial attitude")]
    bias: Annotated[str | PathLike[str] | Collection[float] | Timed | None, Keyword(
        bias, f"Subtracted from the rates; in {Setting('rate_unit')}. static takes the mean rate "
        f"over a rest of at least DUR (1s), found in the whole log by rate, accelerometer and "
        f"orientation, or over that from START to END; static:nearest that of the nearest in time, "
        f"static:interpolate what is between them; FILE or TOPIC is a series, interpolated.",
        takes="X,Y,Z|static[:nearest|:interpolate][:DUR]|static@START..END|FILE|TOPIC",
        group="Rates", common=True)]
    calibration: Annotated[str | PathLike[str] | None, Keyword(
        path, "Scale, misalignment and bias of the gyroscope: YAML or JSON with matrix (3x3) and "
        "bias (rad/s), applied as matrix (w - bias), or kalibr's file of an IMU.", takes="FILE",
        group="Rates")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting, "Sensor axes to body axes: a quaternion with v_body = m v_sensor m*, the sensor "
        "axes that become x, y and z, roll, pitch and yaw of the sensor in the body (deg, as in "
        "URDF), a name such as frd-to-flu, or those of a frame by the log's own /tf_static.", "the "
        "same", "W,X,Y,Z|x,-y,-z|rpy:R,P,Y|NAME|tf:FRAME", "Rates", common=True)]
    on_backwards: Annotated[Literal["error", "drop", "sort"] | None, Keyword(
        Choice("error", "drop", "sort"), "Timestamps that go backwards: refuse, drop until the "
        "clock has caught up, or sort (holds the log in memory); drop and sort leave out "
        "timestamps that are far ahead of those after them.", "error", group="Timestamps",
        common=True)]
    on_nonfinite: Annotated[Literal["error", "drop", "hold"] | None, Keyword(
        Choice("error", "drop", "hold"), "Rates that are NaN or infinite: refuse, drop, or hold "
        "the previous rate.", "error", group="Timestamps")]
    regular_time: RegularTime
    max_gap: Annotated[str | int | timedelta | None, Keyword(
        length, "Intervals longer than this count as gaps.", "10 median intervals", "DUR",
        "Timestamps")]
    on_gap: Annotated[Literal["hold", "zero", "split", "error"] | None, Keyword(
        Choice("hold", "zero", "split", "error"), f"What to do about gaps: hold propagates across "
        f"like over any interval, by {Setting('method')}, and warns; zero takes the rate across as "
        f"zero; split begins again at {Setting('q0')}; error refuses.", "hold", group="Timestamps",
        common=True)]
    every: Annotated[int | None, Keyword(
        count, "Write every N-th attitude only.", "all", "N", "Output")]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency, "Rate of the attitudes: exact at its times under the method.", "at the samples",
        "HZ", "Output", common=True)]
    at: Annotated[str | PathLike[str] | Timed | Collection[Any] | None, Keyword(
        times, "Write attitudes at the stamps of this series of attitudes or rates, exact under "
        "the method; times outside the log are left out.", "at the samples", "FILE", "Output")]
    threads: Annotated[int | None, Keyword(
        count, "Threads that compute at a time; the output is the same for any number.", "the "
        "cores of this machine", "N", "Execution")]
    # fmt: on


class PropagateOptions(RunOptions, ErrorOptions, total=False):
    """Keywords of :func:`quatprop.propagate`."""


READ_RATES = keywords_of(RateOptions)
"""How rates are read: name -> its row."""

RATES_IN_MEMORY = keywords_of(ReadOptions)
"""The same, and what is done to their stamps where nothing else is done to them."""

ONE_SERIES = keywords_of(SeriesOptions)
"""What has to be known of each series where several are read: name -> its row."""

READ_ATTITUDES = keywords_of(AttitudeOptions)
"""How attitudes are read: name -> its row."""

CHECKS = {name: READ_ATTITUDES[name] for name in READ_ATTITUDES if name not in ONE_SERIES}
"""How attitudes are checked, those of several series alike: name -> its row."""

PROPAGATE = keywords_of(PropagateOptions)
"""Everything that determines the attitudes of a log, and how many threads compute them: name ->
its row."""
