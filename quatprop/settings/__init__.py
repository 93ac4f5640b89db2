"""What a user may set about a propagation: every name, and how its value is read.

The names are those of the library's keywords. The command line spells them as options
(``on_gap`` is ``--on-gap``), a suite as keys (``on-gap``). Each has one parser here, which takes a
value as text, as TOML has it, or as Python has it. Nothing heavy is imported, so that
``quatprop --help`` is quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypedDict

from quatprop.errors import UsageError
from quatprop.settings.parsers import (
    Choice,
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
from quatprop.text import Setting, did_you_mean, listed, quoted

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from datetime import datetime, timedelta
    from fractions import Fraction
    from os import PathLike

    from quatprop.settings.parsers import Parser

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


class SelectOptions(TypedDict, total=False):
    """Keywords that choose a topic and its time base."""

    kind: str
    topic: str
    msg_path: str | PathLike[str]
    clock: str
    time_field: str
    time_col: str | int
    time_unit: str
    sample_rate: float | Fraction | str


class RateOptions(SelectOptions, total=False):
    """Keywords of :func:`quatprop.read_rates`."""

    rate_field: str
    rate_cols: str | Sequence[str | int]
    rate_unit: str


class AttitudeOptions(SelectOptions, total=False):
    """Keywords of :func:`quatprop.read_attitudes`."""

    quat_field: str
    quat_cols: str | Sequence[str | int]
    frame: str
    from_layout: str
    from_convention: str
    from_direction: str
    from_angle_unit: str
    from_euler: str
    normalize: bool
    on_invalid: str


class PropagateOptions(RateOptions, total=False):
    """Keywords of :func:`quatprop.propagate`; each is documented there."""

    method: str
    rates: str
    q0: str | PathLike[str] | Sequence[float]
    heading: float
    reference_z: str
    q0_layout: str
    bias: str | PathLike[str] | Sequence[float]
    calibration: str | PathLike[str]
    mount: str | Sequence[float]
    start: str | int | datetime
    end: str | int | datetime
    on_backwards: str
    on_nonfinite: str
    max_gap: str | int | timedelta
    on_gap: str
    every: int
    rate: float | Fraction | str
    at: str | PathLike[str]
    threads: int
    noise_density: str | float
    bias_sigma: str | float
    random_walk: str | float
    scale_sigma: str | float
    imu: str | PathLike[str]
    sigma: bool
    sigma_axes: str


def parse_all(
    options: Mapping[str, object], parsers: Mapping[str, Parser] | None = None
) -> dict[str, Any]:
    """Return settings by name with their parsed values; None counts as not given.

    Parameters
    ----------
    options
        Names and values.
    parsers
        The settings there are; None for :data:`PROPAGATE`.

    Raises
    ------
    UsageError
        There is no such setting, or a value cannot be used; the sentence names the setting.
    """
    parsers = PROPAGATE if parsers is None else parsers
    values = {}
    refuse_unknown(options, parsers)
    for name, value in options.items():
        if value is None:
            continue
        try:
            values[name] = parsers[name](value)
        except UsageError as error:
            raise UsageError(f"{Setting(name)}: ", error.text) from error
    return values


OTHER_NAMES = {"as": "representation", "from": "kind", "with": "beside"}
"""Options whose names are words of Python -> the keyword."""


def refuse_unknown(options: Iterable[str], names: Collection[str]) -> None:
    """Refuse keywords that a function has not, and name the one that was probably meant.

    Parameters
    ----------
    options
        The keywords that were given.
    names
        Those that there are.

    Raises
    ------
    UsageError
        One of them is unknown.
    """
    for name in options:
        if name in names:
            continue
        keyword = OTHER_NAMES.get(name.rstrip("_"))
        if name == "euler_unit" and "beside" in names:
            way_out = "; it is part of a representation's name, such as 'euler-zyx-deg'"
        elif keyword in names:
            way_out = f"; did you mean {quoted(keyword)}?"
        else:
            way_out = did_you_mean(name, names, f"there are {listed(names)}")
        raise UsageError(f"there is no setting {quoted(name)}{way_out}")


def as_text(name: str, value: object, parsed: object) -> str | bool:
    """Return the value of a setting as a configuration has it.

    Parameters
    ----------
    name
        A key of :data:`PROPAGATE`.
    value, parsed
        As it was given, and what its parser made of it.

    Examples
    --------
    >>> as_text("max_gap", 200_000_000, 200_000_000), as_text("bias", [0.1, 0, 0], (0.1, 0.0, 0.0))
    ('200000000ns', '0.1,0.0,0.0')
    """
    if isinstance(value, str | bool):
        return value
    if isinstance(parsed, tuple):
        return ",".join(map(str, parsed))
    if name == "scale_sigma" and isinstance(parsed, float):
        return f"{parsed * 1e6}ppm"
    return f"{parsed}{SI_UNITS.get(name, '')}"


SI_UNITS = {
    "max_gap": "ns",
    "noise_density": "rad/s/sqrt(Hz)",
    "bias_sigma": "rad/s",
    "random_walk": "rad/s^2/sqrt(Hz)",
}
"""Units of settings whose values are written with one."""

SELECT: Mapping[str, Parser] = {
    "topic": text,
    "msg_path": path,
    "clock": Choice(*CLOCKS),
    "time_field": text,
    "time_col": lambda value: text(str(value)),
    "time_unit": Choice(*TIME_UNITS),
    "sample_rate": frequency,
}
"""Which topic and which time: setting -> its parser."""

SELECT_RATES: Mapping[str, Parser] = {
    **SELECT,
    "rate_field": text,
    "rate_cols": columns("X,Y,Z"),
    "rate_unit": Choice(*RATE_UNITS),
}
"""Which rates of a log: setting -> its parser."""

SELECT_ATTITUDES: Mapping[str, Parser] = {
    **SELECT,
    "quat_field": text,
    "quat_cols": columns("A,B,C[,D]"),
    "frame": text,
    "from_layout": Choice(*LAYOUTS),
    "from_convention": Choice(*CONVENTIONS),
    "from_direction": Choice(*DIRECTIONS),
    "from_angle_unit": Choice("rad", "deg"),
    "from_euler": Choice(*EULER_SEQUENCES),
}
"""Which attitudes of a log, and what their numbers mean: setting -> its parser."""

ONE_SERIES: Mapping[str, Parser] = {"kind": Choice(*KINDS), **SELECT_ATTITUDES}
"""What has to be known of each series where several are read: setting -> its parser."""

CHECK_ATTITUDES: Mapping[str, Parser] = {
    "normalize": flag,
    "on_invalid": Choice("error", "drop"),
}
"""What is done about invalid quaternions: setting -> its parser."""

READ_ATTITUDES: Mapping[str, Parser] = {**ONE_SERIES, **CHECK_ATTITUDES}
"""How attitudes are read: setting -> its parser."""

READ_RATES: Mapping[str, Parser] = {"kind": Choice(*KINDS), **SELECT_RATES}
"""How rates are read: setting -> its parser."""

PROPAGATE: Mapping[str, Parser] = {
    **READ_RATES,
    "start": moment,
    "end": moment,
    "method": Choice(*METHODS),
    "rates": Choice(*FRAMES),
    "q0": initial_attitude,
    "heading": number,
    "reference_z": Choice("up", "down"),
    "q0_layout": Choice(*LAYOUTS),
    "bias": bias,
    "calibration": path,
    "mount": mounting,
    "on_backwards": Choice("error", "drop", "sort"),
    "on_nonfinite": Choice("error", "drop", "hold"),
    "max_gap": length,
    "on_gap": Choice("hold", "zero", "split", "error"),
    "every": count,
    "rate": frequency,
    "at": path,
    "threads": count,
    "noise_density": quantity_of(NOISE_DENSITIES, "a noise density", "0.2deg/sqrt(h)"),
    "bias_sigma": quantity_of(RATES, "a rate", "20deg/h"),
    "random_walk": quantity_of(RATE_WALKS, "a rate random walk", "1e-5rad/s^2/sqrt(Hz)"),
    "scale_sigma": quantity_of(RATIOS, "a ratio", "1000ppm or 0.1%"),
    "imu": path,
    "sigma": flag,
    "sigma_axes": Choice(*SIGMA_AXES),
}
"""Everything that determines the attitudes of a log, and how many threads compute them: setting
-> its parser."""
