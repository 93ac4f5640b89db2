"""The row type of the vocabulary: patterns for names of columns, and their meaning."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


class Burst(NamedTuple):
    """Fields of a message with several samples; its timestamp is that of the last sample.

    `samples`: number of samples in the arrays, the oldest first
    `scale`: scale factor of the stored numbers
    `spacing`: time between samples, in the unit of the timestamps
    """

    samples: str
    scale: str
    spacing: str


class Row(NamedTuple):
    """Names of the columns of one source, and the meaning of their numbers.

    `name`: name in summaries; ``""`` if files have other names than messages, as with ROS
    `types`: message types, as ROS spells them
    `rate`, `quat`, `bias`, `force`: patterns of the components of a rate, quaternion, gyroscope
        bias and specific force
    `stamps`: timestamps, the best first: times, or numbers in the `time_unit`. In a file, the
        nanoseconds of ``sec`` or ``secs`` are in another column
    `unit`: unit of the rate and the bias; ``""``: names must declare it
    `time_unit`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; ``""``: times have their own unit
    `absent`: suffix of the column that is -1 if a quantity is absent
    `valid`: column that is false if a bias is not valid
    `position`: pattern of the components of the position of the same body, m
    `covariance`: pattern of the 9 or 36 numbers of the covariance of the attitude about the axes of
        the reference frame, rad^2; of 36, the last 3x3 block is used
    `layout`: ``"scalar-first"`` or ``"scalar-last"`` for a quaternion without named components
    `frames`: the frames that the quaternion relates, if the type fixes them
    `measured`: whether the rate is measured; estimated and commanded ones have a lower priority
    `method`: integration rule that the definition implies: ``"end"`` for averages over the interval
        before the timestamp
    `span`: integration time, in the `time_unit`, if the rate is an increment, rad, over the
        interval before the timestamp
    `burst`: fields of a message with several samples; `rate` matches the components of all
    `angles`, `angle_unit`: pattern of Euler angles, and their unit if names do not declare it
    `needs`: further columns, or the first line, that identify a file
    `file`: pattern to be found in the file name, if columns do not identify it
    `log_time`: column of the time of recording, if a file has one besides the header timestamp
    """

    name: str = ""
    types: tuple[str, ...] = ()
    rate: str = ""
    quat: str = ""
    bias: str = ""
    force: str = ""
    stamps: tuple[str, ...] = ("header.stamp",)
    unit: str = "rad/s"
    time_unit: str = ""
    absent: str = ""
    valid: str = ""
    position: str = ""
    covariance: str = ""
    layout: str = ""
    frames: str = ""
    measured: bool = True
    method: str | None = None
    span: str = ""
    burst: Burst | None = None
    angles: str = ""
    angle_unit: str = ""
    needs: tuple[str, ...] = ()
    file: str = ""
    log_time: str = ""


XYZ = r"[.\[](?P<part>[xyz012])\]?"
"""Component of a vector: a field or an array element."""
WXYZ = r"[.\[](?P<part>[wxyz0123])\]?"

RATE_PARTS = ("x|p|0|[0]|roll", "y|q|1|[1]|pitch", "z|r|2|[2]|yaw")
"""Spellings of each axis in the group ``part``."""
QUATERNION_PARTS = ("w|0", "x|1", "y|2", "z|3")
"""Spellings of each component of a quaternion in the group ``part``."""
PARTS: Mapping[str, tuple[str, ...]] = {
    "rate": RATE_PARTS,
    "quat": QUATERNION_PARTS,
    "bias": RATE_PARTS,
    "force": RATE_PARTS,
    "position": RATE_PARTS,
    "angles": ("yaw|z", "pitch|y", "roll|x"),
}
"""Field of a row -> spellings of its components."""

ABSENT = r"_covariance(?:\[0\]|_?0|\.0)"
"""First element of a ROS covariance: -1 if the quantity is absent."""

STAMPS = ("header.stamp", "stamp", "timestamp")
"""Fields that may be the timestamp of any message."""
