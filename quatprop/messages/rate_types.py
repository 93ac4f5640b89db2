"""The table of message types that carry body rates.

A row says where the rate is, in what unit, which field is its stamp and what marks it as absent,
and beside it where orientation and specific force are. A new type is a new row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from quatprop.messages.stamps import Stamp

if TYPE_CHECKING:
    from collections.abc import Mapping


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
        The key of :data:`quatprop.kinematics.increments.METHODS` that fits what the sensor does,
        where the definition says what that is: ``"end"`` for an average over the interval that
        ends at the stamp.
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
