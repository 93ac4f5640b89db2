"""The settings for reading and propagating a log: their names, and how their values are parsed.

The names are those of the library's keywords. The command line spells them as options
(``on_gap`` is ``--on-gap``), a suite as keys (``on-gap``). Each has one row in a class of keywords
here: the types that the library accepts, the parser, which accepts text, TOML values and Python
values, and the text for help and documents. Nothing heavy is imported, so that ``quatprop --help``
is quick.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from os import PathLike
from typing import Annotated, Any, Literal, TypeAlias, TypedDict, get_args

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, did_you_mean, listed, only_last, quoted, with_settings
from quatprop.settings.bias import bias
from quatprop.settings.parsers import (
    Choice,
    Keyword,
    Parser,
    Rotated,
    Timed,
    column_list,
    count,
    flag,
    frequency,
    initial_attitude,
    keywords_of,
    mounting,
    number,
    path,
    place,
    times,
)
from quatprop.settings.quantities import (
    FRAMES,
    LAYOUTS,
    METHODS,
    NOISE_DENSITIES,
    RAD_PER_UNIT,
    RATE_WALKS,
    RATES,
    RATIOS,
    Frame,
    Layout,
    Method,
    angles,
    quantity_of,
)
from quatprop.settings.reading import (
    CHECKS,
    ONE_SERIES,
    OPTION_NAMES,
    READ_ATTITUDES,
    READ_RATES,
    End,
    InSequence,
    MaxGap,
    OnBackwards,
    OnNonfinite,
    RateOptions,
    RegularTime,
    Start,
)

# Settings for the errors of a gyroscope and the resulting uncertainty.


SigmaAxes: TypeAlias = Literal["body", "reference"]
SIGMA_AXES: tuple[str, ...] = get_args(SigmaAxes)


class ErrorOptions(TypedDict, total=False):
    """Keywords about uncertainty."""

    # fmt: off
    noise_density: Annotated[str | float | None, Keyword(
        quantity_of(NOISE_DENSITIES, "a noise density", "0.2deg/sqrt(h)"), "Noise of the gyroscope "
        "(angle random walk), such as 0.2deg/sqrt(h) or 1.7e-4rad/s/sqrt(Hz), for the uncertainty "
        "of the result.", f"from {Setting('imu')} or {Setting('bias', 'static')}", "X",
        "Uncertainty")]
    bias_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RATES, "a rate", "20deg/h"), "Standard deviation of the constant bias, such as "
        "20deg/h: how well the bias is known: the turn-on repeatability, not the bias "
        "instability.",
        f"from {Setting('bias', 'static')}, else 0", "X", "Uncertainty")]
    random_walk: Annotated[str | float | None, Keyword(
        quantity_of(RATE_WALKS, "a rate random walk", "1e-5rad/s^2/sqrt(Hz)"),
        "Rate random walk of the bias, such as 1e-5rad/s^2/sqrt(Hz) or 3deg/h/sqrt(h).",
        f"from {Setting('imu')}, "
        f"else 0", "X", "Uncertainty")]
    scale_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RATIOS, "a ratio", "1000ppm or 0.1%"),
        "Standard deviation of the scale factors, such as 1000ppm or 0.1%.", "0", "X",
        "Uncertainty")]
    misalignment_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RAD_PER_UNIT, "an angle", "5mrad"),
        "Standard deviation of the six small angles by which each sensor axis leans towards the "
        "two others, such as 5mrad; 1% of cross-axis sensitivity is 10mrad.", "0", "X",
        "Uncertainty")]
    q0_sigma: Annotated[str | float | Collection[str | float] | None, Keyword(
        angles,
        f"Standard deviation of {Setting('q0')}: one angle for every axis, or roll, pitch and "
        "yaw, such as 0.2deg,0.2deg,1deg.",
        f"from accelerometer noise after {Setting('q0', 'level')}, else 0", "X|ROLL,PITCH,YAW",
        "Uncertainty")]
    imu: Annotated[str | PathLike[str] | None, Keyword(
        path,
        "Noise density and random walk from a file in the format of kalibr or of an Allan "
        "variance tool.", takes="FILE.yaml", group="Uncertainty")]
    sigma: Annotated[bool | None, Keyword(
        flag, "Write the standard deviations of every attitude: columns sigma_x, sigma_y, sigma_z "
        "in rad, covariances in messages that have them.", group="Output", common=True)]
    sigma_axes: Annotated[SigmaAxes | None, Keyword(
        Choice(*SIGMA_AXES), "Axes of the standard deviations written by "
        f"{Setting('sigma')}.", "body", group="Uncertainty")]
    # fmt: on


class RunOptions(RateOptions, total=False):
    """Keywords that determine attitudes, besides those of :class:`RateOptions`."""

    # fmt: off
    start: Start
    end: End
    method: Annotated[Method | None, Keyword(
        Choice(*METHODS), "Integration rule: the rate over an interval is that of the sample at "
        "its start, of the one at its end, their mean, linear between them (coning), a cubic "
        "through four samples (cubic) or a quintic through six (quintic, for sensors with next to "
        "no noise). The last three also correct averages and increments for coning.",
        "start (averages: end)",
        group="Integration", common=True)]
    rates: Annotated[Frame | None, Keyword(
        Choice(*FRAMES),
        "Frame that the rates are resolved in: body multiplies on the right; inertial (or "
        "reference: the axes of the reference frame) on the left.", "body", group="Integration")]
    earth_rate: Annotated[float | Collection[float] | None, Keyword(
        place,
        "Remove the rotation of the Earth at this latitude, deg, so that attitudes are relative "
        "to the ground. The reference frame is east-north-up, or north-east-down if its z axis "
        "points down; AZIMUTH is the direction of a different x axis, deg clockwise from north.",
        "attitudes relative to an inertial reference frame", "LAT[,AZIMUTH]", "Integration")]
    q0: Annotated[
        str | PathLike[str] | Collection[float] | Rotated | Timed | None, Keyword(
        initial_attitude,
        "Initial attitude, body-to-ref: four numbers; level, roll and pitch from gravity at "
        "rest; log, the orientation recorded with the rates; or an attitude series, FILE or "
        "TOPIC of the log, at that time.", "identity",
        "W,X,Y,Z|level|log|FILE|TOPIC", "Initial "
        "attitude", common=True)]
    heading: Annotated[float | None, Keyword(
        number, f"For {Setting('q0', 'level')}: rotation about the z axis of the reference frame, "
        "deg, right-handed: 90 points body x along reference y.", "0", "DEG", "Initial attitude")]
    reference_z: Annotated[Literal["up", "down"] | None, Keyword(
        Choice("up", "down"),
        f"For {Setting('q0', 'level')} and {Setting('earth_rate')}: where the z axis of the "
        "reference frame points (down for north-east-down).", "up; of PX4 down", group="Initial "
        "attitude")]
    accel_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("X,Y,Z"), f"Accelerometer columns, in any unit, for "
        f"{Setting('q0', 'level')} and {Setting('bias', 'static')}; by name or number from 0.",
        "from their names", "X,Y,Z", "Initial attitude")]
    q0_layout: Annotated[Layout | None, Keyword(
        Choice(*LAYOUTS), f"Order of the four numbers of {Setting('q0')}.", "scalar-first",
        group="Initial attitude")]
    bias: Annotated[str | PathLike[str] | Collection[float] | Timed | None, Keyword(
        bias,
        f"Subtracted from the rates; in {Setting('rate_unit')}, or with a unit: "
        "0.1,0.2,0.3deg/s. static is the mean rate over a "
        "stationary period of at least DUR (1s), found in the whole log by rate, accelerometer "
        "and orientation, or over the time from START to END; static:nearest uses the period "
        "nearest in time, static:interpolate interpolates between periods; FILE or TOPIC is a "
        "series, interpolated.",
        takes="X,Y,Z|static[:nearest|:interpolate][:DUR]|static@START..END|FILE|TOPIC",
        group="Rates", common=True)]
    calibration: Annotated[str | PathLike[str] | None, Keyword(
        path, "Scale, misalignment and bias of the gyroscope: YAML or JSON with matrix (3x3) and "
        "bias (rad/s), applied as matrix (w - bias), or kalibr's file of an IMU.", takes="FILE",
        group="Rates")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "Sensor-to-body rotation: a quaternion with v_body = m v_sensor m*; the "
        "sensor axes that become x, y and z; roll, pitch and yaw of the sensor in the body "
        "(deg, as in URDF); a name such as frd-to-flu; or a frame in the log's own /tf_static.",
        "the "
        "same", "W,X,Y,Z|x,-y,-z|rpy:R,P,Y|ned-to-enu|frd-to-flu|tf:FRAME", "Rates", common=True)]
    on_backwards: OnBackwards
    on_nonfinite: OnNonfinite
    regular_time: RegularTime
    in_sequence: InSequence
    max_gap: MaxGap
    on_gap: Annotated[Literal["hold", "zero", "split", "error"] | None, Keyword(
        Choice("hold", "zero", "split", "error"),
        "How gaps are handled: hold integrates across the gap like any other interval, by "
        f"{Setting('method')}, and warns; zero assumes a rate of zero; split starts again at "
        f"{Setting('q0')}; error refuses.", "hold", group="Timestamps",
        common=True)]
    every: Annotated[int | None, Keyword(
        count, "Write only every N-th attitude.", "all", "N", "Output")]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency,
        "Output rate; the attitudes at these times are exact under the method.", "at the samples",
        "HZ", "Output", common=True)]
    at: Annotated[str | PathLike[str] | Timed | Collection[Any] | None, Keyword(
        times,
        "Write attitudes at the timestamps of this file (attitudes, rates, or only timestamps) "
        "or TOPIC of the log, exact under the method; times outside the log are omitted.", "at the "
        "samples", "FILE|TOPIC", "Output")]
    threads: Annotated[int | None, Keyword(
        count, "Number of threads; the output does not depend on it.", "the "
        "cores of this machine", "N", "Execution")]
    # fmt: on


class PropagateOptions(RunOptions, ErrorOptions, total=False):
    """Keywords of :func:`quatprop.propagate`."""


PROPAGATE = keywords_of(PropagateOptions)
"""Everything that determines the attitudes of a log, and the number of threads: name -> its row."""


# How interfaces spell settings: as options, ``--clock log``, or as keys of a suite.
#
# Output passes through :func:`quatprop.base.text.spelled`, for which the command line sets
# :func:`in_options` and a suite :func:`in_keys`. Keywords of the library are not changed.


LOOKUPS = {
    "at": {"start"},
    "q0": {"start"},
    "relative_to": CHECKS.keys(),
    "info": READ_RATES.keys(),
}
"""Sides whose attitudes are only looked up, and the settings that the command itself has for them;
quatprop convert has all settings."""

FLAGS = {name for name, row in {**PROPAGATE, **READ_ATTITUDES}.items() if row.parse is flag}
"""Settings that are on or off."""

OF_CHECK = {"update", "strict", "force"}
"""Options of the command check that are not keys of a case."""

_ELSEWHERE = " of quatprop convert"


def option(name: str, side: str = "") -> str:
    """Return a setting as an option, such as ``--clock``, or ``--clock-b`` of side b."""
    key = OPTION_NAMES.get(name, name).replace("_", "-")
    return f"--{key}-{side}" if side and name in ONE_SERIES else f"--{key}"


def suite_key(name: str, side: str = "") -> str:
    """Return a setting as a key of a case, such as ``clock``; B is the reference."""
    key = option(name)[2:]
    return f"reference-{key}" if side == "b" and name in ONE_SERIES else key


def in_options(text: str, side: str = "") -> str:
    """Return a sentence with options; their command is named once, after the last."""

    def spell(name: str, value: str, own: str) -> str:
        about = own or side
        if about in LOOKUPS:
            elsewhere = "" if name in {about, *LOOKUPS[about]} else _ELSEWHERE
            return f"{option(name)} {value}".rstrip() + elsewhere
        return f"{option(name, about)} {value}".rstrip()

    return only_last(with_settings(text, spell), _ELSEWHERE)


def in_keys(text: str, side: str = "") -> str:
    """Return a sentence with keys of a suite."""

    def spell(name: str, value: str, own: str) -> str:
        about = own or side
        if name not in {about, *LOOKUPS.get(about, (name,))}:
            # Attitudes that are only looked up have no keys of their own.
            return f"{option(name)} {value}".rstrip() + _ELSEWHERE
        if name in OF_CHECK:
            return option(name)
        values = " or ".join(f'"{one}"' for one in value.split("|")) if value else ""
        on = " = true" if name in FLAGS else ""
        return suite_key(name, about) + (f" = {values}" if values else on)

    return only_last(with_settings(text, spell), _ELSEWHERE)


# Values of settings: parse them together, and write them for a configuration.


def parse_all(
    options: Mapping[str, object], parsers: Mapping[str, Parser] = PROPAGATE
) -> dict[str, Any]:
    """Return settings by name with their parsed values; None counts as not given."""
    values = {}
    refuse_unknown(options, parsers)
    for name, value in options.items():
        if value is None:
            continue
        try:
            values[name] = parsers[name](value)
        except UsageError as error:
            raise UsageError(f"{Setting(name)}: {error.text}") from error
    return values


def refuse_unknown(options: Iterable[str], names: Collection[str]) -> None:
    """Refuse unknown keywords of a function, and suggest the likely one."""
    keywords = {option: keyword for keyword, option in OPTION_NAMES.items()}
    for name in options:
        if name in names:
            continue
        keyword = keywords.get(name.rstrip("_"))
        if name == "euler_unit" and "extra_columns" in names:
            remedy = "; it is part of a representation's name, such as 'euler-zyx-deg'"
        elif keyword in names:
            remedy = f"; did you mean {quoted(keyword)}?"
        else:
            remedy = did_you_mean(name, names, f"there are {listed(names)}")
        raise UsageError(f"there is no setting {quoted(name)}{remedy}")


def as_text(name: str, value: object, parsed: object) -> str | bool:
    """Return the value of a setting in the form for a configuration."""
    if isinstance(value, str | bool):
        return value
    if type(parsed) is tuple:
        return ",".join(f"{part}{SI_UNITS.get(name, '')}" for part in parsed)
    if name == "scale_sigma" and isinstance(parsed, float):
        return f"{parsed * 1e6}ppm"
    return f"{parsed}{SI_UNITS.get(name, '')}"


SI_UNITS = {
    "max_gap": "ns",
    "noise_density": "rad/s/sqrt(Hz)",
    "bias_sigma": "rad/s",
    "random_walk": "rad/s^2/sqrt(Hz)",
    "misalignment_sigma": "rad",
    "q0_sigma": "rad",
}
"""Units of settings whose values are written with a unit."""
