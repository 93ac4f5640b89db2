"""What a user may set about reading and propagating a log: every name, and how its value is read.

The names are those of the library's keywords. The command line spells them as options
(``on_gap`` is ``--on-gap``), a suite as keys (``on-gap``). Each has one row in a class of keywords
here: the types that the library takes, and the parser, which takes a value as text, as TOML has it,
or as Python has it. Nothing heavy is imported, so that ``quatprop --help`` is quick.
"""

from collections.abc import Collection, Mapping, Sequence
from datetime import datetime, timedelta
from fractions import Fraction
from os import PathLike
from typing import Annotated, TypedDict

from quatprop.settings.parsers import (
    Choice,
    Parser,
    bias,
    columns,
    count,
    flag,
    frequency,
    initial_attitude,
    length,
    moment,
    mounting,
    number,
    path,
    text,
)
from quatprop.settings.quantities import NOISE_DENSITIES, RATE_WALKS, RATES, RATIOS, quantity_of

KINDS = (
    *("mcap", "bag", "db3", "rosbag2", "ulog"),
    *("parquet", "feather", "npy", "npz", "hdf5", "jsonl", "tum", "kitti", "csv"),
)
"""The keys of :data:`quatprop.log_kinds.READERS`."""

LAYOUTS = ("scalar-first", "scalar-last", "wxyz", "xyzw")
RATE_UNITS = ("rad/s", "deg/s")
TIME_UNITS = ("s", "ms", "us", "ns")
CLOCKS = ("header", "log", "publish")
METHODS = ("start", "end", "mean", "coning", "cubic")
FRAMES = ("body", "inertial")
EULER_SEQUENCES = (
    *("zyx", "xyz", "xzy", "yxz", "yzx", "zxy"),
    *("zxz", "zyz", "xyx", "xzx", "yxy", "yzy"),
)
"""Axes of intrinsic rotations in their order: Tait-Bryan angles, then proper Euler angles."""
SIGMA_AXES = ("body", "reference")
CONVENTIONS = ("hamilton", "jpl")
DIRECTIONS = ("body-to-ref", "ref-to-body")
OPTION_NAMES = {"kind": "from", "representation": "as", "beside": "with"}
"""Settings whose name as an option or a key of a suite is a word of Python -> that name."""


class SelectOptions(TypedDict, total=False):
    """Keywords that choose a topic and its time base.

    Parameters
    ----------
    kind : str
        Kind of the log; by default told by its content, then by its suffix.
    topic : str
        Which topic; by default the only one that has what is read.
    msg_path : str or path
        Message definitions for a log that carries none: a ``.msg`` file, or a folder of them.
    clock : str
        Timestamp source: ``"header"``, ``"log"`` or ``"publish"``.
    time_field : str
        Field of a message that is the time, such as ``"header.stamp"``.
    time_col : str or int
        Column of a table that is the time, by name or number from 0.
    time_unit : str
        ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``.
    sample_rate : float
        Rows a second of a table without a time, Hz.
    """

    kind: Annotated[str | None, Choice(*KINDS)]
    topic: Annotated[str | None, text]
    msg_path: Annotated[str | PathLike[str] | None, path]
    clock: Annotated[str | None, Choice(*CLOCKS)]
    time_field: Annotated[str | None, text]
    time_col: Annotated[str | int | None, lambda value: text(str(value))]
    time_unit: Annotated[str | None, Choice(*TIME_UNITS)]
    sample_rate: Annotated[float | Fraction | str | None, frequency]


class RateOptions(SelectOptions, total=False):
    """Keywords of :func:`quatprop.read_rates`, beside those of :class:`SelectOptions`.

    Parameters
    ----------
    rate_field : str
        Field of a message, such as ``"imu.angular_velocity"``.
    rate_cols : str or sequence
        Columns of a table, by name or number from 0.
    rate_unit : str
        ``"rad/s"`` or ``"deg/s"``.
    """

    rate_field: Annotated[str | None, text]
    rate_cols: Annotated[str | Sequence[str | int] | None, columns("X,Y,Z")]
    rate_unit: Annotated[str | None, Choice(*RATE_UNITS)]


class SeriesOptions(SelectOptions, total=False):
    """Keywords that say which attitudes to read, beside those of :class:`SelectOptions`.

    Parameters
    ----------
    quat_field : str
        Field of a message that is the quaternion.
    quat_cols : str or sequence
        The four columns of a table as stored, by name or number from 0; with `from_euler` the
        three angles in the order of its letters.
    frame : str
        Of a list of transforms, ``"child"`` or ``"parent:child"``.
    from_layout : str
        ``"scalar-first"`` or ``"scalar-last"``; needed where names and metadata do not say it.
    from_convention : str
        ``"hamilton"`` (the default) or ``"jpl"``.
    from_direction : str
        ``"body-to-ref"`` (the default) or ``"ref-to-body"``.
    from_angle_unit : str
        ``"rad"`` or ``"deg"``, of Euler angles and rotation vectors.
    from_euler : str
        Sequence of Euler angles, such as ``"xyz"``: intrinsic rotations about x, the new y and the
        newest z. Columns yaw, pitch and roll are ``"zyx"`` by default, and with another sequence
        the angles about z, y and x.
    """

    quat_field: Annotated[str | None, text]
    quat_cols: Annotated[str | Sequence[str | int] | None, columns("A,B,C[,D]")]
    frame: Annotated[str | None, text]
    from_layout: Annotated[str | None, Choice(*LAYOUTS)]
    from_convention: Annotated[str | None, Choice(*CONVENTIONS)]
    from_direction: Annotated[str | None, Choice(*DIRECTIONS)]
    from_angle_unit: Annotated[str | None, Choice("rad", "deg")]
    from_euler: Annotated[str | None, Choice(*EULER_SEQUENCES)]


class AttitudeOptions(SeriesOptions, total=False):
    """Keywords of :func:`quatprop.read_attitudes`, beside those of :class:`SeriesOptions`.

    Parameters
    ----------
    normalize : bool
        Scale quaternions to unit length; by default those off by more than 0.001 are refused.
    on_invalid : str
        ``"error"`` (the default) or ``"drop"``: invalid quaternions.
    """

    normalize: Annotated[bool | None, flag]
    on_invalid: Annotated[str | None, Choice("error", "drop")]


class PropagateOptions(RateOptions, total=False):
    """Keywords of :func:`quatprop.propagate`, beside those of :class:`RateOptions`.

    Parameters
    ----------
    method : str
        Integration rule: ``"start"``, ``"end"``, ``"mean"``, ``"coning"`` or ``"cubic"``; see
        :func:`quatprop.kinematics.increments.rotation_vectors`. By default ``"end"`` where samples
        are averages or increments, else ``"start"``.
    rates : str
        Frame in which the rates are resolved: ``"body"`` (the default; steps multiply on the right)
        or ``"inertial"`` (on the left).
    q0 : sequence of float, str or path
        Attitude body to reference at the first sample: four numbers in the order of `q0_layout`;
        ``"level"``, roll and pitch from the accelerometer at rest; ``"log"``, the log's own
        orientation; or an attitude series, a path or a topic of the log. By default the identity.
    heading : float
        For ``q0="level"``: rotation about the reference's z axis, deg.
    reference_z : str
        For ``q0="level"``: where that axis points, ``"up"`` (the default) or ``"down"``.
    q0_layout : str
        ``"scalar-first"`` (the default) or ``"scalar-last"``.
    bias : sequence of float, str or path
        Subtracted from the rates, in their unit (rad/s for rates in memory); or ``"static"``, the
        mean rate over a rest of at least a second, or of DUR with ``"static:DUR"``, found in the
        whole log; or a series of biases, a file (EuRoC's ground truth, PX4's estimator_sensor_bias)
        or a topic of the log, interpolated in time.
    calibration : path
        Scale, misalignment and bias of the gyroscope: YAML or JSON with ``matrix``, 3x3, and
        ``bias``, rad/s, applied as matrix (w - bias), or kalibr's file of an IMU. A bias given
        beside it takes the place of its own.
    mount : str or sequence
        Sensor axes to body axes: signed axes such as ``"x,-y,-z"``, or a unit quaternion w, x, y, z
        with v_body = m v_sensor m*; or ``"tf:FRAME"``, the axes of a frame by the log's own
        ``/tf_static``, from the frame in the header of the rates.
    start, end : str, int or datetime
        The part of the log to use: RFC 3339 text, ns, a datetime with its zone, or relative to the
        first (``"+10s"``) or the last sample (``"-30s"``).
    on_backwards : str
        Timestamps that go backwards: ``"error"`` (the default), ``"drop"`` or ``"sort"``; both of
        these drop outliers, which are far ahead of the timestamps after them.
    on_nonfinite : str
        Rates that are NaN or infinite: ``"error"`` (the default), ``"drop"`` or ``"hold"``.
    max_gap : str, int or timedelta
        Intervals longer than this count as gaps (text such as ``"20ms"``, or ns); by default 10
        median intervals.
    on_gap : str
        ``"hold"`` (the default) propagates across a gap like over any interval, by the method,
        ``"zero"`` takes the rate across as zero, ``"split"`` begins again at q0, ``"error"``
        refuses gaps.
    every : int
        Keep every N-th attitude.
    rate : float, Fraction or str
        Attitudes at this rate, Hz, exact at those times under the method.
    at : path
        Attitudes at the stamps of this series, exact at those times.
    threads : int
        How many threads compute at a time, by default as many as there are cores; the result is
        the same.
    noise_density, bias_sigma, random_walk, scale_sigma : str or float
        Standard deviations of the gyroscope's errors: its noise density (``"0.2deg/sqrt(h)"``, or
        rad/s/sqrt(Hz)), constant bias (``"20deg/h"``, or rad/s), rate random walk
        (``"3deg/h/sqrt(h)"``, or rad/s^2/sqrt(Hz)) and scale factors (``"1000ppm"``, or a ratio).
        From them follows the uncertainty of the result, in its report.
    imu : path
        A file of Kalibr or of an Allan variance tool that states the first and the third.
    sigma : bool
        Give every attitude its covariance.
    sigma_axes : str
        For tables, the axes of the columns of standard deviations: ``"body"`` (the default) or
        ``"reference"``.
    """

    start: Annotated[str | int | datetime | None, moment]
    end: Annotated[str | int | datetime | None, moment]
    method: Annotated[str | None, Choice(*METHODS)]
    rates: Annotated[str | None, Choice(*FRAMES)]
    q0: Annotated[str | PathLike[str] | Collection[float] | None, initial_attitude]
    heading: Annotated[float | None, number]
    reference_z: Annotated[str | None, Choice("up", "down")]
    q0_layout: Annotated[str | None, Choice(*LAYOUTS)]
    bias: Annotated[str | PathLike[str] | Collection[float] | None, bias]
    calibration: Annotated[str | PathLike[str] | None, path]
    mount: Annotated[str | Collection[float] | None, mounting]
    on_backwards: Annotated[str | None, Choice("error", "drop", "sort")]
    on_nonfinite: Annotated[str | None, Choice("error", "drop", "hold")]
    max_gap: Annotated[str | int | timedelta | None, length]
    on_gap: Annotated[str | None, Choice("hold", "zero", "split", "error")]
    every: Annotated[int | None, count]
    rate: Annotated[float | Fraction | str | None, frequency]
    at: Annotated[str | PathLike[str] | None, path]
    threads: Annotated[int | None, count]
    noise_density: Annotated[
        str | float | None, quantity_of(NOISE_DENSITIES, "a noise density", "0.2deg/sqrt(h)")
    ]
    bias_sigma: Annotated[str | float | None, quantity_of(RATES, "a rate", "20deg/h")]
    random_walk: Annotated[
        str | float | None, quantity_of(RATE_WALKS, "a rate random walk", "1e-5rad/s^2/sqrt(Hz)")
    ]
    scale_sigma: Annotated[str | float | None, quantity_of(RATIOS, "a ratio", "1000ppm or 0.1%")]
    imu: Annotated[str | PathLike[str] | None, path]
    sigma: Annotated[bool | None, flag]
    sigma_axes: Annotated[str | None, Choice(*SIGMA_AXES)]


def parsers_of(options: type) -> Mapping[str, Parser]:
    """Return the parser of each keyword of a class."""
    return {name: hint.__metadata__[0] for name, hint in options.__annotations__.items()}


READ_RATES = parsers_of(RateOptions)
"""How rates are read: setting -> its parser."""

ONE_SERIES = parsers_of(SeriesOptions)
"""What has to be known of each series where several are read: setting -> its parser."""

READ_ATTITUDES = parsers_of(AttitudeOptions)
"""How attitudes are read: setting -> its parser."""

CHECKS = {name: READ_ATTITUDES[name] for name in READ_ATTITUDES if name not in ONE_SERIES}
"""How attitudes are checked, those of several series alike: setting -> its parser."""

PROPAGATE = parsers_of(PropagateOptions)
"""Everything that determines the attitudes of a log, and how many threads compute them: setting
-> its parser."""
