"""Which field of a message is an attitude, and which is its time.

Types are rows of one explicit table. ROS messages name the fields of a quaternion, so their order
in storage never matters; px4_msgs stores arrays, scalar first by definition.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST
from quatprop.errors import SchemaError
from quatprop.messages.decoders import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.known_types import KnownTypes
from quatprop.messages.schema import Struct, find, numbers
from quatprop.messages.stamps import Stamp, stamp_around
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.containers.base import Channel
    from quatprop.conventions.layout import Layout

COMPONENTS = 4
"""Numbers in a quaternion."""


@dataclass(frozen=True, slots=True)
class OrientationField:
    """Where a message has a quaternion and what belongs to it, as dotted paths.

    Parameters
    ----------
    quaternion
        A struct with fields w, x, y, z, or an array of four numbers.
    layout
        Order in storage.
    stamps
        Where its time may be, the best first; versions of a type differ.
    absent
        A number that is -1 where the orientation is absent.
    frames
        Which frames it relates, where the type fixes them.
    """

    quaternion: str
    layout: Layout | None = SCALAR_LAST
    stamps: tuple[Stamp, ...] = (Stamp.of_time("header.stamp"),)
    absent: str | None = None
    frames: str = ""


@dataclass(frozen=True, slots=True)
class FoundOrientation:
    """An attitude in the messages of one channel.

    Parameters
    ----------
    name
        The field as ``--quat-field`` takes it.
    fields
        Dotted paths of the numbers: one of four in the order of `layout`, or w, x, y, z.
    layout
        Order in storage; None where only the user can know.
    stamp
        Its time, or None where the message has none.
    absent
        A number that is -1 where the orientation is absent.
    frames
        Which frames it relates, where the type fixes them.
    """

    name: str
    fields: tuple[str, ...]
    layout: Layout | None
    stamp: Stamp | None = None
    absent: str | None = None
    frames: str = ""


_PX4 = OrientationField(
    "q",
    SCALAR_FIRST,
    (Stamp(("timestamp_sample",), "us"), Stamp(("timestamp",), "us")),
    frames="FRD body to NED reference",
)

_FOXGLOVE_STAMP = Stamp.of_time("timestamp")
_FOXGLOVE_POSE = OrientationField("pose.orientation", stamps=(_FOXGLOVE_STAMP,))
_FOXGLOVE_TRANSFORM = OrientationField("rotation", stamps=(_FOXGLOVE_STAMP,))

ORIENTATIONS: Mapping[str, OrientationField] = {
    "sensor_msgs/msg/Imu": OrientationField("orientation", absent="orientation_covariance[0]"),
    "geometry_msgs/msg/QuaternionStamped": OrientationField("quaternion"),
    "geometry_msgs/msg/PoseStamped": OrientationField("pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": OrientationField("pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": OrientationField("transform.rotation"),
    "nav_msgs/msg/Odometry": OrientationField("pose.pose.orientation"),
    "foxglove.FrameTransform": _FOXGLOVE_TRANSFORM,
    "foxglove.PoseInFrame": _FOXGLOVE_POSE,
    "foxglove_msgs/msg/FrameTransform": _FOXGLOVE_TRANSFORM,
    "foxglove_msgs/msg/PoseInFrame": _FOXGLOVE_POSE,
    "px4_msgs/msg/VehicleAttitude": _PX4,
    "px4_msgs/msg/VehicleOdometry": _PX4,
}
"""Where the quaternion is, by message type, relative to the message."""

KNOWN = KnownTypes(ORIENTATIONS)


def orientation_fields(channel: Channel, path: Path | str) -> list[FoundOrientation]:
    """Return the attitudes that messages of known types carry, or carry inside them.

    Parameters
    ----------
    channel
        A topic.
    path
        The log, for errors.

    Returns
    -------
    list of FoundOrientation
        Outermost first; empty where the encoding is not read or no known type is found.

    Raises
    ------
    SchemaError
        The definition of a known type cannot be read.
    """
    root = KNOWN.root(channel, path)
    return [] if root is None else list(_found(root))


def orientation_field_at(
    channel: Channel, quat_field: str, path: Path | str
) -> FoundOrientation | None:
    """Return the attitude that a dotted path names, or None where this channel has no such field.

    Parameters
    ----------
    channel
        A topic.
    quat_field
        Path of a struct with fields w, x, y, z, or of an array of four numbers.
    path
        The log, for errors.

    Returns
    -------
    FoundOrientation or None
        That of a known type where the path leads to it; otherwise with the stamp of the nearest
        header around it, and without a layout for an array.

    Raises
    ------
    SchemaError
        The field is there but is no quaternion.
    """
    if channel.encoding not in DECODERS:
        return None
    try:
        root = message_type(channel, path)
    except SchemaError:
        return None
    if find(root, quat_field) is None:
        return None
    known = next((found for found in _found(root) if found.name == quat_field), None)
    if known is not None:
        return known
    fields, layout = _fields(root, quat_field)
    if not fields:
        raise SchemaError(
            path,
            f"field {quoted(quat_field)} of {quoted(channel.type_name)} is no quaternion; "
            "name a field with parts w, x, y, z or an array of four numbers",
        )
    return FoundOrientation(quat_field, fields, layout, stamp_around(root, fields[0]))


def _found(root: Struct) -> Iterator[FoundOrientation]:
    """Yield the rows of known types in a message."""

    def fits(row: OrientationField, _kind: Struct, prefix: str) -> bool:
        return bool(_fields(root, prefix + row.quaternion)[0])

    return (_placed(row, root, prefix) for prefix, row in KNOWN.inside(root, fits))


def _placed(row: OrientationField, root: Struct, prefix: str) -> FoundOrientation:
    """Return a row with its paths from the root; what this version of its type lacks is None."""
    fields, layout = _fields(root, prefix + row.quaternion)
    stamps = (stamp.under(prefix) for stamp in row.stamps)
    there = (s for s in stamps if all(find(root, name) is not None for name in s.fields))
    absent = None if row.absent is None else prefix + row.absent
    return FoundOrientation(
        prefix + row.quaternion,
        fields,
        layout or row.layout,
        next(there, None) or stamp_around(root, fields[0]),
        absent if absent and find(root, absent) is not None else None,
        row.frames,
    )


def _fields(root: Struct, name: str) -> tuple[tuple[str, ...], Layout | None]:
    """Return the paths of the numbers of a quaternion and their order; none where it is none."""
    kind = find(root, name)
    found = None if kind is None else numbers(kind)
    if found is None or found[1] != COMPONENTS or found[0].code[0] != "f":
        return (), None
    if not isinstance(kind, Struct):
        return (name,), None
    order = "".join(own for own, _ in kind.fields)
    if sorted(order) != sorted("wxyz"):
        return (), None
    stored = {"wxyz": SCALAR_FIRST, "xyzw": SCALAR_LAST}.get(order)
    return tuple(f"{name}.{part}" for part in "wxyz"), stored
