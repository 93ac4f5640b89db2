"""Quantities with units, as data sheets and users write them: units, and the parser of all."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from quatprop.base.errors import UsageError
from quatprop.base.text import shown
from quatprop.settings.parsers import Parser, number, parts_of

if TYPE_CHECKING:
    from collections.abc import Mapping


RAD_PER_UNIT = {
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": math.pi / 180,
    "arcmin": math.pi / 180 / 60,
    "arcsec": math.pi / 180 / 3600,
}
"""Radians in each unit of an angle."""

SCALED_RATE_UNITS = {
    "mrad/s": ("rad/s", 1e-3),
    "mdeg/s": ("deg/s", 1e-3),
    "mdps": ("deg/s", 1e-3),
    "deg/h": ("deg/s", 1 / 3600),
    "deg/hr": ("deg/s", 1 / 3600),
    "\u00b0/h": ("deg/s", 1 / 3600),
    "rpm": ("deg/s", 6.0),
}
"""Units that are converted to another one, and their factors."""

_DEG = math.pi / 180

NOISE_DENSITIES = {
    "rad/s/sqrt(Hz)": 1.0,
    "rad/sqrt(s)": 1.0,
    "rad/sqrt(h)": 1 / 60,
    "deg/s/sqrt(Hz)": _DEG,
    "deg/sqrt(s)": _DEG,
    "deg/sqrt(h)": _DEG / 60,
    "deg/h/sqrt(Hz)": _DEG / 3600,
    "mdeg/s/sqrt(Hz)": _DEG / 1000,
}
"""rad/s/sqrt(Hz) in each unit of a noise density."""

RATES = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": _DEG,
    "mdeg/s": _DEG / 1000,
    "deg/h": _DEG / 3600,
}
"""rad/s in each unit of a rate."""

RATE_WALKS = {
    "rad/s^2/sqrt(Hz)": 1.0,
    "rad/s/sqrt(s)": 1.0,
    "rad/s/sqrt(h)": 1 / 60,
    "deg/s^2/sqrt(Hz)": _DEG,
    "deg/s/sqrt(s)": _DEG,
    "deg/s/sqrt(h)": _DEG / 60,
    "deg/h/sqrt(h)": _DEG / 3600 / 60,
}
"""rad/s^2/sqrt(Hz) in each unit of a rate random walk."""

RATIOS = {"%": 1e-2, "ppm": 1e-6}
"""Value of each unit of a ratio."""

LARGEST = 1e30
"""Maximum value, in SI units: fourth powers of larger ones overflow."""

_QUANTITY = r"(?a)((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(\D.*)"

PER_INCH = {"mm": 25.4, "cm": 2.54, "in": 1.0}
SMALLEST_IN, LARGEST_IN = 1.0, 100.0
"""Width and height of a picture, inches."""


def quantity(value: object, units: Mapping[str, float], noun: str, examples: str) -> float:
    """Return a number in the unit whose factor is 1: text with a unit, or a number in that.

    `units`: units and their factors
    """
    size = _size(value, units, noun, examples)
    if size > LARGEST:
        raise UsageError(f"{shown(value)} is larger than {noun} can be")
    return size


def _size(value: object, units: Mapping[str, float], noun: str, examples: str) -> float:
    if not isinstance(value, str):
        if (parsed := number(value)) < 0:
            raise UsageError(f"{shown(value)} is below 0")
        return parsed
    match = re.fullmatch(_QUANTITY, str(value).strip())
    if not match or match[2] not in units:
        sentence = f"{shown(value)} is not {noun}; write a number with its unit, such as"
        raise UsageError(f"{sentence} {examples}")
    # Degrees as in other programs, to the last bit.
    if match[2] == "deg":
        return math.radians(float(match[1]))
    return float(match[1]) * units[match[2]]


def quantity_of(units: Mapping[str, float], noun: str, examples: str) -> Parser:
    """Return a parser of quantities; see :func:`quantity`."""
    return partial(quantity, units=units, noun=noun, examples=examples)


def angles(value: object) -> tuple[float, ...]:
    """Return one angle, or three, rad."""
    parts = parts_of(value)
    if len(parts) not in {1, 3}:
        raise UsageError(f"{shown(value)} is neither one angle nor ROLL,PITCH,YAW")
    parse = quantity_of(RAD_PER_UNIT, "an angle", "0.5deg or 5mrad")
    return tuple(parse(part) for part in parts)


def picture_size(value: object) -> tuple[float, float | None]:
    """Return the width and height of a picture in inches; the height is None if not given."""
    number = r"(\d+\.?\d*)"
    found = re.fullmatch(rf"{number}(?:x{number})?(mm|cm|in)", str(value), re.ASCII)
    if found is not None:
        unit = PER_INCH[found[3]]
        width = float(found[1]) / unit
        height = float(found[2]) / unit if found[2] else None
        sizes = (width,) if height is None else (width, height)
        if all(SMALLEST_IN <= size <= LARGEST_IN for size in sizes):
            return width, height
    raise UsageError(f"{shown(value)} is not a size from 1in to 100in; write 90mm or 16x9cm")


# Names that settings accept, for the type checkers of users and for parsers.


Layout: TypeAlias = Literal["scalar-first", "scalar-last", "wxyz", "xyzw"]
LAYOUTS: tuple[str, ...] = get_args(Layout)
RateUnit: TypeAlias = Literal["rad/s", "deg/s"]
RATE_UNITS: tuple[str, ...] = get_args(RateUnit)
TimeUnit: TypeAlias = Literal["s", "ms", "us", "ns", "100ns"]
TIME_UNITS: tuple[str, ...] = get_args(TimeUnit)
ClockName: TypeAlias = Literal["header", "log", "publish"]
CLOCKS: tuple[str, ...] = get_args(ClockName)
Method: TypeAlias = Literal["start", "end", "mean", "coning", "cubic", "quintic"]
METHODS: tuple[str, ...] = get_args(Method)
LOOK_AHEAD = {"cubic", "quintic"}
"""Methods that use samples after an interval."""
CORRECT_CONING = {"coning", *LOOK_AHEAD}
"""Methods that correct averages and increments for coning."""
Frame: TypeAlias = Literal["body", "inertial"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""Frames of rates: steps of body rates multiply on the right, of inertial rates on the left."""
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
