"""Options from tables: what help says of each, and the parser of its value.

An option that is a setting of the library takes its name and its parser from there, and means the
same everywhere; what help says of it is in :data:`HELP`. What a command has beside them is in a
table of its own, for :func:`own_options`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

import click

from quatprop.cli.spelling import option as option_name
from quatprop.cli.types import PATH, OneOf, ParamType, Parsed
from quatprop.settings.parsers import Choice, Parser, flag
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from quatprop.signals.attitude_input import AttitudeInput

    Command = TypeVar("Command", bound=Callable[..., Any])
    Option = Callable[[Any], Any]
    """Gives a command an option."""

HELP = {
    "kind": "KIND  Kind of {log}: {names}.  [default: told by its content, then by its suffix]",
    "topic": "NAME  Topic of {log}.  [default: the only one with {signal}]",
    "msg_path": "PATH  Message definitions for {log}: a .msg file, or a folder of them.  "
    "[default: those in the log or beside it]",
    "clock": "Timestamp source.  [default: header where the message has one, else log]",
    "time_field": "A.B  Message field of {log} that is the time.  [default: the header stamp]",
    "time_col": "C  Time column of {log}, by name or number from 0; two (SEC,NANOSEC, "
    "SEC,USEC or SEC,MSEC) of one stamp.  [default: by the header]",
    "time_unit": "Unit of the time in {log}.  [default: as the log says]",
    "sample_rate": "HZ  Rows a second of {log}, a table without a time.  [default: none]",
    "rate_field": "A.B.C  Message field that is the rate.  [default: known from the message type]",
    "rate_cols": "X,Y,Z  Rate columns of a table; by name or number from 0.  [default: by the "
    "header]",
    "rate_unit": "Unit of the rates.  [default: as the log says]",
    "quat_field": "A.B.C  Message field of {log} that is the quaternion.  [default: known from "
    "the message type]",
    "quat_cols": "A,B,C[,D]  Columns of the quaternion in {log} in the order in which they are "
    "stored, by name or number from 0; or of three angles, with --from-euler.  [default: by the "
    "header]",
    "frame": "[PARENT:]CHILD  Which transform of {log}, where it is a list of them.  [default: "
    "the only one there is]",
    "from_layout": "Order of the quaternion in {log}.  [default: by names, definitions or "
    "metadata; required where none of them says it]",
    "from_convention": "Convention of {log}.  [default: by metadata, else hamilton]",
    "from_direction": "Which coordinates {log} turns into which.  [default: by metadata, else "
    "body-to-ref]",
    "from_angle_unit": "Unit of angles in {log}, a table of yaw, pitch, roll or rotation "
    "vectors.  [default: by names; required where they do not say it]",
    "from_euler": "Sequence of the angles in {log}: xyz turns about x, the new y and the newest "
    "z. yaw, pitch and roll are about z, y and x.  [default: zyx, or by names]",
    "normalize": "Scale quaternions to unit length.  [default: refuse those off by more than "
    "0.001]",
    "on_invalid": "Invalid quaternions (zero, NaN, marked absent, not of unit length): refuse or "
    "leave out.  [default: error]",
    "method": "Integration rule: the rate over an interval is that of the sample at its start, of "
    "the one at its end, their mean, linear between them (coning), or a cubic through four "
    "samples (cubic). Coning and cubic also correct averages and increments for coning.  "
    "[default: start; end where the log's samples are averages or increments]",
    "rates": "Frame the rates are resolved in: body multiplies right, inertial left.  [default: "
    "body]",
    "q0": "W,X,Y,Z|level|log|FILE|TOPIC  First attitude, body-to-ref: four numbers; level, roll "
    "and pitch from gravity at rest; log, the orientation beside the rates; or FILE, an attitude "
    "series, or TOPIC of the log, at that time.  [default: identity]",
    "heading": "DEG  For --q0 level: rotation about the reference's z axis.  [default: 0]",
    "reference_z": "For --q0 level: where the reference's z axis points (down for "
    "north-east-down).  [default: up]",
    "q0_layout": "Order of the four numbers of --q0.  [default: scalar-first]",
    "bias": "X,Y,Z|static[:DUR]|FILE|TOPIC  Subtracted from the rates; in --rate-unit. static "
    "takes the mean rate over a rest of at least DUR (1s), found in the whole log by rate, "
    "accelerometer and orientation; FILE or TOPIC is a series of biases, interpolated in time.  "
    "[default: none]",
    "calibration": "FILE  Scale, misalignment and bias of the gyroscope: YAML or JSON with matrix "
    "(3x3) and bias (rad/s), applied as matrix (w - bias), or kalibr's file of an IMU.  [default: "
    "none]",
    "mount": "W,X,Y,Z|x,-y,-z|tf:FRAME  Sensor axes to body axes: a quaternion, the sensor axes "
    "that become x, y and z, or those of a frame by the log's own /tf_static.  [default: the same]",
    "start": "TIME  Use {log} from here: RFC 3339, ns, +10s from its first or -30s from its last "
    "sample.  [default: all]",
    "end": "TIME  Use {log} up to here; as --start.  [default: all]",
    "on_backwards": "Timestamps that go backwards: refuse, drop until the clock has caught up, or "
    "sort (holds the log in memory); drop and sort leave out timestamps that are far ahead of "
    "those after them.  [default: error]",
    "on_nonfinite": "Rates that are NaN or infinite: refuse, drop, or hold the previous rate.  "
    "[default: error]",
    "max_gap": "DUR  Intervals longer than this count as gaps.  [default: 10 median intervals]",
    "on_gap": "What to do about gaps: hold propagates across like over any interval, by --method, "
    "and warns; zero takes the rate across as zero; split begins again at --q0; error refuses.  "
    "[default: hold]",
    "every": "N  Write every N-th attitude only.  [default: all]",
    "rate": "HZ  Rate of the attitudes: exact at its times under the method.  [default: at the "
    "samples]",
    "at": "FILE  Write attitudes at the stamps of this series of attitudes or rates, exact under "
    "the method; times outside the log are left out.  [default: at the samples]",
    "threads": "N  Threads that compute at a time; the output is the same for any number.  "
    "[default: the cores of this machine]",
    "noise_density": "X  Noise of the gyroscope (angle random walk), such as 0.2deg/sqrt(h) or "
    "1.7e-4rad/s/sqrt(Hz), for the uncertainty of the result.  [default: by --imu or --bias "
    "static]",
    "bias_sigma": "X  Standard deviation of its constant bias, such as 20deg/h; a bias "
    "instability counts as this.  [default: by --bias static, else 0]",
    "random_walk": "X  Rate random walk of its bias, such as 1e-5rad/s^2/sqrt(Hz) or "
    "3deg/h/sqrt(h).  [default: by --imu, else 0]",
    "scale_sigma": "X  Standard deviation of its scale factors, such as 1000ppm or 0.1%.  "
    "[default: 0]",
    "imu": "FILE.yaml  Noise density and random walk from a file: Kalibr's, or that of an Allan "
    "variance tool.  [default: none]",
    "sigma": "Write the standard deviations of every attitude: columns sigma_x, sigma_y, sigma_z "
    "in rad, covariances in messages that have them.",
    "sigma_axes": "Axes of those columns.  [default: body]",
    "tol": "ANGLE  Largest error that passes, such as 1e-9rad or 0.1deg, or 3sigma where a series "
    "has standard deviations; so for the next three.  [default: none, all pass]",
    "rms_tol": "ANGLE  Largest RMS error that passes.  [default: none]",
    "final_tol": "ANGLE  Largest final error that passes.  [default: none]",
    "p95_tol": "ANGLE  Largest 95th percentile of the error that passes.  [default: none]",
    "window_tol": "ANGLE  Largest error over windows that passes; with --window.  [default: none]",
    "window_rms_tol": "ANGLE  Largest RMS error over windows that passes; with --window.  "
    "[default: none]",
    "drift_tol": "DRIFT  Largest drift that passes, in either direction, such as 10deg/h; "
    "with --align none or first.  [default: none]",
    "min_coverage": "PERCENT  Least part of {log}, of its time and of its samples, that must be "
    "compared.  [default: none]",
    "max_sigma": "N  Largest error that passes, in standard deviations (Mahalanobis distance), "
    "beside one in rad or deg.  [default: none]",
    "align": "How {log} is rotated first: not at all; its reference frame, by the first pair or "
    "by the mean of all; or its reference and body frame (mount), from the motion.  [default: "
    "none]",
    "time_offset": "DUR|auto  Added to the stamps of {log}, such as -12ms; auto estimates it from "
    "the angular speeds.  [default: none]",
    "match": "How attitudes are matched: equal stamps, the nearest, or interpolated ones (slerp), "
    "at the stamps of the series with the longer intervals.  [default: exact where at least half "
    "have equal stamps, else nearest if there is --max-dt, else interpolate]",
    "max_dt": "DUR  Largest distance in time of samples that are matched or interpolated "
    "between.  [default: half the median interval to the nearest, 10 to interpolate]",
    "min_matched": "PERCENT  Percentage of the shorter series that must be matched.  [default: 50]",
    "window": "DUR  Also compare the rotations over windows of this length.  [default: none]",
}
"""What help says of a setting: its value, unless that is a choice or a flag, two spaces, and what
it does. ``{log}`` is what the command calls its input, ``{signal}`` rates or attitudes; ``{names}``
are the choices."""


def setting_options(
    parsers: Mapping[str, Parser],
    *,
    log: str = "LOG",
    signal: str = "rates",
    side: str = "",
    prefix: str = "",
) -> list[Option]:
    """Return the options for settings.

    Parameters
    ----------
    parsers
        Settings and their parsers, such as :data:`quatprop.settings.PROPAGATE`.
    log, signal
        What help calls the input, and what is read of it.
    side
        Ends the names of the options, such as ``"a"`` for ``--topic-a``, and after an underscore
        the keywords.
    prefix
        Begins the help of each.
    """
    options = []
    for name, parser in parsers.items():
        short = "-t " if name == "topic" and not side else ""
        names = f"{short}{option_name(Setting(name), side)} {name}_{side}".rstrip("_")
        choices = ", ".join(getattr(parser, "names", ()))
        text = HELP[name].format(log=log, signal=signal, names=choices)
        options.append(_option(names, parser, text, prefix=prefix))
    return options


def own_options(
    texts: Mapping[str, str],
    kinds: Mapping[str, Parser | ParamType] | None = None,
    defaults: Mapping[str, object] | None = None,
) -> list[Option]:
    """Return the options of one command.

    Parameters
    ----------
    texts
        Names as click takes them, between blanks -> what help says, as in :data:`HELP`.
    kinds
        Names -> the type or the parser of the value, where that is not a path. An option without
        a value is a flag.
    defaults
        Names -> the default, which help shows; without one it is None, or said in the text.
    """
    kinds, defaults = kinds or {}, defaults or {}
    return [
        _option(names, kinds.get(names), text, defaults.get(names)) for names, text in texts.items()
    ]


def _option(
    names: str,
    kind: Parser | ParamType | None,
    text: str,
    default: object = None,
    prefix: str = "",
) -> Option:
    """Return an option; its text begins with what help calls the value, and two spaces."""
    value, _, rest = text.partition("  ")
    if " " in value:
        value, rest = "", text
    if kind is flag or not (kind or value):
        return click.option(*names.split(), is_flag=True, help=prefix + rest)
    if isinstance(kind, Choice):
        kind = OneOf(kind.names)
    elif kind is not None and not isinstance(kind, click.ParamType):
        kind = Parsed(kind, value)
    return click.option(
        *names.split(),
        type=kind or PATH,
        metavar=value or None,
        default=default,
        show_default=default is not None,
        help=prefix + rest,
    )


REPORT = {
    "--report": "PATH|-  Write a JSON report: source, conventions, counts, policies, version.  "
    "[default: none]",
}
PLOT = {
    "--plot": "PIC  Draw a picture: .png, .svg, .pdf, or .html for a report with the picture in "
    "it.  [default: none]",
}
QUIET = {"-q --quiet": "No summary; errors only."}
JSON = {"--json as_json": "JSON on stdout instead of text."}


def with_options(
    *options: Sequence[Option] | dict[str, str],
) -> Callable[[Command], Command]:
    """Return a decorator that gives a command these options, or those of texts, in this order."""
    every: list[Option] = []
    for some in options:
        every += own_options(some) if isinstance(some, dict) else some

    def decorated(command: Command) -> Command:
        for option in reversed(every):
            command = option(command)
        return command

    return decorated


def refuse_stdin_twice(*paths: str | None) -> None:
    """Refuse to read several series from stdin: what is read first leaves nothing."""
    if paths.count("-") > 1:
        raise click.UsageError("stdin can be read only once; name files for the others")


def input_of(
    path: str, chosen: Mapping[str, Any], *, side: str = "", drop: bool = False
) -> AttitudeInput:
    """Return which attitudes to read, from the options of a command.

    Parameters
    ----------
    path
        The log or table.
    chosen
        The options.
    side
        Which side of a comparison, as for :func:`setting_options`.
    drop
        Leave out invalid quaternions, where the command has no option for it.
    """
    from quatprop.settings import READ_ATTITUDES
    from quatprop.signals.attitude_input import attitude_input

    keys = {name: f"{name}_{side}" if f"{name}_{side}" in chosen else name
            for name in READ_ATTITUDES}  # fmt: skip
    options = {name: chosen[key] for name, key in keys.items() if key in chosen}
    return attitude_input(path, {"on_invalid": "drop" if drop else None, **options}, side)
