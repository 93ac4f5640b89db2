"""What a row of the vocabulary has: names of columns as patterns, and what their numbers are."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


class Burst(NamedTuple):
    """Columns that say how many samples a message holds; its stamp is that of the last one.

    `samples`: how many elements of the three arrays are samples, the oldest first
    `scale`: what the stored numbers are multiplied by
    `spacing`: the time between samples, in the unit of the row's stamps
    """

    samples: str
    scale: str
    spacing: str


class Row(NamedTuple):
    """How one source names its columns, and what its numbers are.

    `name`: what summaries call it; ``""`` where files have other names than messages, as of ROS
    `types`: the message types, as ROS spells them
    `rate`, `quat`, `bias`, `force`: patterns of the components of a rate, a quaternion, a
        gyroscope's bias, a specific force
    `stamps`: its time, the best first: times, or numbers in the `time_unit`. In a file a column
        ``sec`` or ``secs`` has its nanoseconds in a column beside it
    `unit`: of the rate and the bias; ``""`` where names must declare it
    `time_unit`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; ``""`` where times say it themselves
    `absent`: what follows the name of a quantity in that of a column that is -1 where it is absent
    `valid`: the column that is false where a bias is not valid
    `position`: pattern of the components of the position that belongs to the quaternion, m
    `covariance`: pattern of the 9 or 36 numbers of the quaternion's covariance about the axes of
        the reference frame, rad^2; of 36 the last block counts
    `layout`: ``"scalar-first"`` or ``"scalar-last"`` of a quaternion whose components have no names
    `frames`: which frames the quaternion relates, where the type fixes them
    `measured`: whether a gyroscope measured the rate; what is estimated or commanded does not
        compete
    `method`: the integration rule that fits the rate, where its definition says what samples are:
        ``"end"`` for averages over the interval that ends at the stamp
    `span`: the integration time of the sensor, in the `time_unit`, where the rate is an increment,
        rad, over the interval that ends at the stamp
    `burst`: where a message has many samples; the pattern of the rate is that of all their
        components
    `angles`, `angle_unit`: pattern of Euler angles, and their unit where names do not declare it
    `needs`: further columns, or the first line, by which a file is recognised
    `file`: pattern found in the name of a file, where columns alone are not enough
    `log_time`: the column of the time of recording, if a file has one beside the message's own
        stamp
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
"""The components of a vector: parts or elements."""
WXYZ = r"[.\[](?P<part>[wxyz0123])\]?"

RATE_PARTS = ("x|p|0|[0]|roll", "y|q|1|[1]|pitch", "z|r|2|[2]|yaw")
"""What the group ``part`` of each axis may be."""
QUATERNION_PARTS = ("w|0", "x|1", "y|2", "z|3")
"""What the group ``part`` of each component of a quaternion may be."""
PARTS: Mapping[str, tuple[str, ...]] = {
    "rate": RATE_PARTS,
    "quat": QUATERNION_PARTS,
    "bias": RATE_PARTS,
    "force": RATE_PARTS,
    "position": RATE_PARTS,
    "angles": ("yaw|z", "pitch|y", "roll|x"),
}
"""The same by the field of a row."""

ABSENT = r"_covariance(?:\[0\]|_?0|\.0)"
"""The first number of a covariance of ROS: -1 where the quantity is absent."""

STAMPS = ("header.stamp", "stamp", "timestamp")
"""Where a message may have its time, whatever its type."""
