"""The keywords of a simulation, and the motion and gyroscope that they define."""

from collections.abc import Collection, Mapping
from datetime import datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypedDict, get_args

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, shown
from quatprop.settings.bias import bias_rad_s
from quatprop.settings.parsers import (
    Choice,
    Keyword,
    Parser,
    count,
    frequency,
    keywords_of,
    length,
    moment,
    number,
    number_list,
)
from quatprop.settings.quantities import NOISE_DENSITIES, RATE_WALKS, quantity_of
from quatprop.writers.formats import GENERAL_KINDS

if TYPE_CHECKING:
    from quatprop.tools.simulation import Gyroscope, Shape

MotionName: TypeAlias = Literal["rest", "spin", "coning", "tumbling", "random-walk"]
"""The keys of :data:`quatprop.tools.simulation.MOTIONS`; repeated, so that help is fast."""

SHAPED_BY = {
    "frequency": ("spin", "coning", "tumbling"),
    "axis": ("spin",),
    "angle": ("coning", "tumbling"),
    "spin_frequency": ("tumbling",),
    "walk": ("random-walk",),
}
"""The motions to which each setting applies."""

DEFAULT_DURATION_NS = 20_000_000_000


def _exact(value: object) -> Fraction:
    """Return a number as an exact fraction: 0.1 is one tenth."""
    try:
        return Fraction(str(value))
    except (ValueError, ZeroDivisionError):
        raise UsageError(f"{shown(value)} is not a number") from None


def _moment(value: object) -> int:
    """Return an absolute time in ns."""
    given = moment(value)
    if given.origin != "clock":
        raise UsageError(
            f"{shown(value)} is not a time; write RFC 3339 (2024-01-31T12:00:00Z) or integer "
            "nanoseconds"
        )
    return given.ns


def _in_radians(units: Mapping[str, float], noun: str, examples: str) -> Parser:
    """Return a parser of a number with a unit, or without one in the first of the units."""
    parse = quantity_of(units, noun, examples)

    def parsed(value: object) -> Any:
        try:
            size = number(value)
        except UsageError:
            return parse(value)
        if size < 0:
            raise UsageError(f"{shown(value)} is below 0")
        return parse(size)

    return parsed


def _seed(value: object) -> int:
    """Return an integer that is not negative."""
    if str(value) == "0":
        return 0
    try:
        return count(value)
    except UsageError:
        raise UsageError(f"{shown(value)} is not a whole number from 0 on") from None


class SimulateOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.simulate`."""

    # fmt: off
    motion: Annotated[MotionName, Keyword(
        Choice(*get_args(MotionName)), "Motion of the body.", "spin", preset=True)]
    rate: Annotated[float | Fraction | str, Keyword(
        frequency, "Samples per second.", "100", "HZ", preset=True)]
    duration: Annotated[float | str | timedelta | None, Keyword(
        length, "How long, such as 20s or 1h; the last sample is just before it.", "20s", "DUR")]
    samples: Annotated[int | None, Keyword(
        count, "Number of samples, instead of a duration.", "from the duration", "N")]
    start: Annotated[str | int | datetime | None, Keyword(
        _moment, "Time of the first sample, RFC 3339 or ns.", "2023-11-14T22:13:20Z", "TIME")]
    seed: Annotated[int | None, Keyword(
        _seed, "Seed of noise and random walk: the same seed gives the same log.", "0", "N")]
    noise: Annotated[float | str | None, Keyword(
        _in_radians(NOISE_DENSITIES, "a noise density", "0.2deg/sqrt(h)"),
        "Angle random walk, in rad/s/sqrt(Hz) or with its unit, such as 0.2deg/sqrt(h).", "0",
        "X")]
    bias: Annotated[Collection[float] | str | None, Keyword(
        bias_rad_s, "Constant error of the rates, in rad/s or with a unit: 0.1,0.2,0.3deg/s.",
        "0,0,0", "X,Y,Z")]
    q0: Annotated[Collection[float] | str, Keyword(
        number_list("W,X,Y,Z"), "True attitude at the first sample, body to reference, scalar "
        "first.", "1,0,0,0", "W,X,Y,Z", preset=True)]
    frequency: Annotated[float | Fraction | str | None, Keyword(
        _exact,
        "Revolutions per second: of a spin, of coning, of the precession of tumbling.", "0.5",
        "HZ")]
    axis: Annotated[Collection[float] | str | None, Keyword(
        number_list("X,Y,Z"), "Axis of a spin in the body.", "0,0,1", "X,Y,Z")]
    angle: Annotated[float | Fraction | str | None, Keyword(
        _exact, "Half-angle of the cone, or nutation angle of tumbling.", "10", "DEG")]
    spin_frequency: Annotated[float | Fraction | str | None, Keyword(
        _exact, "Revolutions per second of a tumbling body about its own axis.", "0.2", "HZ")]
    walk: Annotated[float | str | None, Keyword(
        _in_radians(RATE_WALKS, "a rate random walk", "5deg/s/sqrt(s)"),
        "Random walk of the rate, in rad/s/sqrt(s) or with its unit.", "0.1", "X")]
    # fmt: on


SIMULATE = keywords_of(SimulateOptions)
"""The keywords of a simulation: name -> row."""


def simulated(values: Mapping[str, Any]) -> "tuple[str, Shape, Gyroscope, tuple[float, ...]]":
    """Return motion, its parameters, gyroscope and first attitude from parsed settings."""
    from quatprop.tools.simulation import Gyroscope, Shape, samples_in

    given = {name: value for name, value in values.items() if value is not None}
    motion, rate = given.get("motion", "spin"), given.get("rate", Fraction(100))
    for name, motions in SHAPED_BY.items():
        if motion not in motions and name in given:
            whose = Setting("motion", " or ".join(motions))
            raise UsageError(f"{Setting(name)} requires {whose}")
    if "samples" in given and "duration" in given:
        raise UsageError(
            f"{Setting('samples')} and {Setting('duration')} exclude each other; give one of them"
        )
    count = given.get("samples") or samples_in(given.get("duration", DEFAULT_DURATION_NS), rate)
    shape = Shape(**{name: given[name] for name in (*SHAPED_BY, "seed") if name in given})
    parts: dict[str, Any] = {
        name: given[name] for name in ("noise", "bias", "seed") if name in given
    }
    if "start" in given:
        parts["start_ns"] = given["start"]
    return motion, shape, Gyroscope(rate, count, **parts), given.get("q0", (1.0, 0.0, 0.0, 0.0))


# fmt: off
LOG_FORMAT = {
    "--to kind": Keyword(
        Choice(*GENERAL_KINDS), f"Kind of the log: {', '.join(GENERAL_KINDS)}.",
        "from the suffix, else a ROS 2 bag", "FORMAT"),
    "--compression": Keyword(
        Choice("none", "lz4", "zstd", "bz2"), "Compression of a message log.",
        "zstd for mcap, else none"),
}
# fmt: on
"""Format of the log on the command line: names of an option -> its keyword."""
