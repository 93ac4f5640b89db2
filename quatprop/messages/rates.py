"""Which field of a message is a body rate, and which is its time.

Types are rows of one explicit table. A row says where the rate is, in what unit, which field is
its stamp and what marks it as absent, and beside it where orientation and specific force are.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import SchemaError, quoted
from quatprop.messages.decoding import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import at, find, numbers, structs
from quatprop.messages.stamps import Stamp, stamp_around, stamp_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.messages.schema import Struct, Type
    from quatprop.readers.base import Channel

AXES = 3
"""Numbers in a rate."""


class Burst(NamedTuple):
    """Where a message says how many samples it holds, as dotted paths.

    The three rates are arrays then; the stamp is that of the last sample.

    Parameters
    ----------
    samples
        How many elements of the arrays are samples, the oldest first.
    spacing
        The time between them.
    scale
        The rate of a one in the arrays.
    """

    samples: str
    spacing: Stamp
    scale: str

    @property
    def fields(self) -> tuple[str, ...]:
        """All paths."""
        return (self.samples, self.scale, *self.spacing.fields)

    def under(self, prefix: str) -> Burst:
        """Return the same in a message inside another."""
        return Burst(prefix + self.samples, self.spacing.under(prefix), prefix + self.scale)


@dataclass(frozen=True, slots=True)
class RateField:
    """Where a message has a body rate and what belongs to it, as dotted paths.

    Parameters
    ----------
    rate
        One path of three numbers x, y, z, or three paths of one.
    unit
        ``"rad/s"``, or None where only the user can know.
    stamp
        Its time, or None where the message has none.
    absent
        A number that is -1 where the rate is absent.
    orientation
        Quaternion in the order x, y, z, w, body -> reference.
    orientation_absent
        A number that is -1 where the orientation is absent.
    acceleration
        Specific force x, y, z, m/s^2.
    acceleration_absent
        A number that is -1 where the specific force is absent.
    measured
        Whether this is a gyroscope; false for velocities estimated or commanded, which are not
        to be preferred to one.
    method
        The key of :data:`quatprop.increments.METHODS` that fits what the sensor does, where the
        definition says what that is: ``"end"`` for an average over the interval that ends at the
        stamp.
    span
        The time over which the sensor has integrated, where the field is an increment, in rad
        instead of rad/s, over the interval that ends at the stamp.
    burst
        For messages with many samples each.
    """

    rate: tuple[str, ...]
    unit: str | None = None
    stamp: Stamp | None = None
    absent: str | None = None
    orientation: str | None = None
    orientation_absent: str | None = None
    acceleration: str | None = None
    acceleration_absent: str | None = None
    measured: bool = True
    method: str | None = None
    span: Stamp | None = None
    burst: Burst | None = None

    @property
    def name(self) -> str:
        """The rate as ``--rate-field`` takes it."""
        return ",".join(self.rate)


_HEADER = Stamp.of_time("header.stamp")
_SAMPLED = Stamp(("timestamp_sample",), "us")
_FOXGLOVE = RateField(
    ("angular_velocity",),
    "rad/s",
    Stamp.of_time("timestamp"),
    orientation="pose.orientation",
    measured=False,
)

RATES: Mapping[str, RateField] = {
    "sensor_msgs/msg/Imu": RateField(
        ("angular_velocity",),
        "rad/s",
        _HEADER,
        absent="angular_velocity_covariance[0]",
        orientation="orientation",
        orientation_absent="orientation_covariance[0]",
        acceleration="linear_acceleration",
        acceleration_absent="linear_acceleration_covariance[0]",
    ),
    "px4_msgs/msg/SensorCombined": RateField(
        ("gyro_rad",),
        "rad/s",
        Stamp(("timestamp",), "us"),
        acceleration="accelerometer_m_s2",
        method="end",
    ),
    "px4_msgs/msg/SensorGyro": RateField(("x", "y", "z"), "rad/s", _SAMPLED),
    "px4_msgs/msg/SensorGyroFifo": RateField(
        ("x", "y", "z"),
        "rad/s",
        _SAMPLED,
        burst=Burst("samples", Stamp(("dt",), "us"), "scale"),
    ),
    "px4_msgs/msg/VehicleAngularVelocity": RateField(("xyz",), "rad/s", _SAMPLED),
    "px4_msgs/msg/VehicleImu": RateField(
        ("delta_angle",), "rad/s", _SAMPLED, span=Stamp(("delta_angle_dt",), "us")
    ),
    "px4_msgs/msg/VehicleOdometry": RateField(
        ("angular_velocity",), "rad/s", _SAMPLED, measured=False
    ),
    "geometry_msgs/msg/TwistStamped": RateField(
        ("twist.angular",), "rad/s", _HEADER, measured=False
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": RateField(
        ("twist.twist.angular",), "rad/s", _HEADER, measured=False
    ),
    "foxglove.Odometry": _FOXGLOVE,
    "foxglove_msgs/msg/Odometry": _FOXGLOVE,
    "nav_msgs/msg/Odometry": RateField(
        ("twist.twist.angular",),
        "rad/s",
        _HEADER,
        orientation="pose.pose.orientation",
        measured=False,
    ),
}
"""Where the rate is, by message type, relative to the message."""


def row_of(type_name: str) -> RateField | None:
    """Return the row of a type, or None where the table does not know it.

    Outside ROS its types go by many spellings; what counts is the package and the name.

    Examples
    --------
    >>> row_of("ros.sensor_msgs.Imu") is RATES["sensor_msgs/msg/Imu"]
    True
    """
    parts = [part for part in re.split(r"[./]|::", type_name) if part != "msg"]
    return RATES.get(type_name) or RATES.get("/msg/".join(parts[-2:]))


def rate_fields(channel: Channel, path: Path | str) -> list[RateField]:
    """Return the body rates that messages of known types carry, or carry inside them.

    Parameters
    ----------
    channel
        A topic.
    path
        The log, for errors.

    Returns
    -------
    list of RateField
        Outermost first; empty where the encoding is not read or no known type is found.

    Raises
    ------
    SchemaError
        The definition of a known type cannot be read.
    """
    if channel.encoding not in DECODERS or not _may_carry(channel):
        return []
    try:
        root = message_type(channel, path)
    except SchemaError:
        if row_of(channel.type_name) is not None:
            raise
        return []
    return list(_found(root))


def rate_field_at(channel: Channel, rate_field: str, path: Path | str) -> RateField | None:
    """Return the rate that a dotted path names, or None where this channel has no such field.

    Parameters
    ----------
    channel
        A topic.
    rate_field
        Path of three numbers, or three paths with commas between them.
    path
        The log, for errors.

    Returns
    -------
    RateField or None
        The row of a known type where the path leads to its rate; otherwise without unit, and with
        the stamp of the nearest header around it.

    Raises
    ------
    SchemaError
        The field is there but is not three numbers.
    """
    if channel.encoding not in DECODERS:
        return None
    names = tuple(name.strip() for name in rate_field.split(","))
    try:
        root = message_type(channel, path)
    except SchemaError:
        return None
    kinds = [find(root, name) for name in names]
    if None in kinds:
        return None
    known = next((row for row in _found(root) if row.rate == names), None)
    if known is not None:
        return known
    if sum(_count(kind) for kind in kinds) != AXES:
        raise SchemaError(
            path,
            f"field {quoted(rate_field)} of {quoted(channel.type_name)} is not three numbers; "
            "name a field of x, y, z or three numbers as a,b,c",
        )
    return RateField(names, stamp=stamp_around(root, names[0]))


def time_field_at(
    channel: Channel, time_field: str, unit: str | None, path: Path | str
) -> Stamp | None:
    """Return the stamp that a dotted path names.

    Parameters
    ----------
    channel
        A topic.
    time_field
        Path of a ``time`` of seconds and nanoseconds, or of one number.
    unit
        Of one number: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``; None where it is not said.
    path
        The log, for errors.

    Returns
    -------
    Stamp or None
        None where the unit of one number is not said.

    Raises
    ------
    SchemaError
        There is no such field, or it is not a time.
    """
    _, kind = at(message_type(channel, path), time_field, path)
    if (stamp := stamp_of(time_field, kind)) is not None:
        return stamp
    if _count(kind) != 1:
        raise SchemaError(
            path,
            f"field {quoted(time_field)} of {quoted(channel.type_name)} is not a time; "
            "name a time of seconds and nanoseconds, or a number",
        )
    return None if unit is None else Stamp((time_field,), unit)


def _may_carry(channel: Channel) -> bool:
    """Tell from the text of the definition whether a known type can be in it."""
    if row_of(channel.type_name) is not None:
        return True
    # No standard type that is not in the table has one inside.
    return any(name.rpartition("/")[2].encode() in channel.schema for name in RATES)


def _found(root: Struct) -> Iterator[RateField]:
    """Yield the rows of known types in a message; what is inside a known one is its own affair."""
    passed: list[str] = []
    for prefix, kind in structs(root):
        row = row_of(kind.name)
        if row is None or any(prefix.startswith(outer) for outer in passed):
            continue
        if _fits(row, kind):
            passed.append(prefix)
            yield _placed(row, root, prefix)


def _fits(row: RateField, kind: Struct) -> bool:
    """Tell whether this version of a type has the fields of its row."""
    counts = [_count(find(kind, name)) for name in row.rate]
    if row.burst is None:
        needed = row.span.fields if row.span else ()
        whole = sum(counts) == AXES
    else:
        needed = row.burst.fields
        whole = len(set(counts)) == 1 and counts[0] > 0
    return whole and all(_count(find(kind, name)) == 1 for name in needed)


def _placed(row: RateField, root: Struct, prefix: str) -> RateField:
    """Return a row with its paths from the root; what this version of its type lacks is None."""

    def there(name: str | None) -> str | None:
        found = name is not None and find(root, prefix + name) is not None
        return f"{prefix}{name}" if found else None

    stamp = row.stamp and row.stamp.under(prefix)
    if stamp is None or any(find(root, name) is None for name in stamp.fields):
        stamp = stamp_around(root, prefix + row.rate[0])
    return replace(
        row,
        rate=tuple(prefix + name for name in row.rate),
        stamp=stamp,
        absent=there(row.absent),
        orientation=there(row.orientation),
        orientation_absent=there(row.orientation_absent),
        acceleration=there(row.acceleration),
        acceleration_absent=there(row.acceleration_absent),
        span=row.span and row.span.under(prefix),
        burst=row.burst and row.burst.under(prefix),
    )


def _count(kind: Type | None) -> int:
    """Return how many equal numbers a field is, 0 where it is not."""
    found = None if kind is None else numbers(kind)
    return 0 if found is None else found[1]
