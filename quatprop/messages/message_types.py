"""The table of message types: where each has its rate, orientation, acceleration and stamp.

A new message type is a new row of :data:`MESSAGE_TYPES`. ROS messages name the components of a
quaternion, so their order in storage does not matter; px4_msgs stores arrays, scalar first by
definition.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.conventions.layout import SCALAR_FIRST, SCALAR_LAST, Layout
from quatprop.messages.schema import ros_name
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
        What the stored numbers are multiplied by.
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


class RateField(NamedTuple):
    """A body rate in a message; paths are dotted.

    Parameters
    ----------
    fields
        One path of three numbers x, y, z, or three paths of one.
    unit
        ``"rad/s"``, one that a name declares, or None where only the user can know.
    absent
        A number that is -1 where the rate is absent.
    stamps
        Its time, the nearest first; empty in the table, and where the message has none.
    measured
        Whether a gyroscope measured it; estimated or commanded velocities do not compete with one.
    method
        The key of :data:`quatprop.kinematics.increments.METHODS` that fits the sensor, where the
        definition says what its samples are: ``"end"`` for an average over the interval that ends
        at the stamp.
    span
        Integration time of the sensor, where the field is an increment, in rad instead of rad/s,
        over the interval that ends at the stamp.
    burst
        For messages with many samples each.
    """

    fields: tuple[str, ...]
    unit: str | None = "rad/s"
    absent: str | None = None
    stamps: tuple[Stamp, ...] = ()
    measured: bool = True
    method: str | None = None
    span: Stamp | None = None
    burst: Burst | None = None

    @property
    def name(self) -> str:
        """The field as the setting ``rate_field`` takes it."""
        return ",".join(self.fields)


class OrientationField(NamedTuple):
    """A quaternion in a message; paths are dotted.

    Parameters
    ----------
    name
        A struct with fields w, x, y, z, or an array of four numbers.
    layout
        Order in storage; None where only the user can know.
    absent
        A number that is -1 where the orientation is absent.
    frames
        Which frames it relates, where the type fixes them.
    position
        Three numbers x, y, z, m: the position that belongs to it.
    covariance
        Its covariance about the axes of the reference frame, rad^2: nine numbers, or 36 with the
        position's first.
    fields
        Paths of the numbers: one of four in the order of `layout`, or w, x, y, z; empty in the
        table.
    stamps
        Its time, the nearest first; empty in the table, and where the message has none.
    """

    name: str
    layout: Layout | None = SCALAR_LAST
    absent: str | None = None
    frames: str = ""
    position: str | None = None
    covariance: str | None = None
    fields: tuple[str, ...] = ()
    stamps: tuple[Stamp, ...] = ()


class AccelerationField(NamedTuple):
    """A specific force in a message, m/s^2; paths are dotted.

    Parameters
    ----------
    name
        Three numbers x, y, z.
    absent
        A number that is -1 where it is absent.
    """

    name: str
    absent: str | None = None


class SignalFields(NamedTuple):
    """What a message type carries; None where it has no such field.

    Parameters
    ----------
    rate, orientation, acceleration
        The fields, relative to the message.
    stamps
        Where its time may be, the best first; versions of a type differ.
    """

    rate: RateField | None = None
    orientation: OrientationField | None = None
    acceleration: AccelerationField | None = None
    stamps: tuple[Stamp, ...] = (Stamp.of_time("header.stamp"),)


_SENT = Stamp(("timestamp",), "us")
_SAMPLED = (Stamp(("timestamp_sample",), "us"),)
_FRD_TO_NED = OrientationField("q", SCALAR_FIRST, frames="FRD body to NED reference")
_ROS_POSE_WITH_COVARIANCE = OrientationField(
    "pose.pose.orientation", position="pose.pose.position", covariance="pose.covariance"
)
_FOXGLOVE_STAMP = (Stamp.of_time("timestamp"),)
_FOXGLOVE_POSE = OrientationField("pose.orientation", position="pose.position")

TRANSFORM_LISTS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types that consist of one list of ``geometry_msgs/TransformStamped``."""

MESSAGE_TYPES: Mapping[str, SignalFields] = {
    "sensor_msgs/msg/Imu": SignalFields(
        rate=RateField(("angular_velocity",), absent="angular_velocity_covariance[0]"),
        orientation=OrientationField(
            "orientation", absent="orientation_covariance[0]", covariance="orientation_covariance"
        ),
        acceleration=AccelerationField("linear_acceleration", "linear_acceleration_covariance[0]"),
    ),
    "geometry_msgs/msg/QuaternionStamped": SignalFields(orientation=OrientationField("quaternion")),
    "geometry_msgs/msg/PoseStamped": SignalFields(
        orientation=OrientationField("pose.orientation", position="pose.position")
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": SignalFields(
        orientation=_ROS_POSE_WITH_COVARIANCE
    ),
    "geometry_msgs/msg/TransformStamped": SignalFields(
        orientation=OrientationField("transform.rotation", position="transform.translation")
    ),
    "geometry_msgs/msg/TwistStamped": SignalFields(
        rate=RateField(("twist.angular",), measured=False)
    ),
    "geometry_msgs/msg/TwistWithCovarianceStamped": SignalFields(
        rate=RateField(("twist.twist.angular",), measured=False)
    ),
    "nav_msgs/msg/Odometry": SignalFields(
        rate=RateField(("twist.twist.angular",), measured=False),
        orientation=_ROS_POSE_WITH_COVARIANCE,
    ),
    "foxglove_msgs/msg/FrameTransform": SignalFields(
        orientation=OrientationField("rotation", position="translation"), stamps=_FOXGLOVE_STAMP
    ),
    "foxglove_msgs/msg/Odometry": SignalFields(
        rate=RateField(("angular_velocity",), measured=False),
        orientation=_FOXGLOVE_POSE,
        stamps=_FOXGLOVE_STAMP,
    ),
    "foxglove_msgs/msg/PoseInFrame": SignalFields(
        orientation=_FOXGLOVE_POSE, stamps=_FOXGLOVE_STAMP
    ),
    "px4_msgs/msg/SensorCombined": SignalFields(
        rate=RateField(("gyro_rad",), method="end"),
        acceleration=AccelerationField("accelerometer_m_s2"),
        stamps=(_SENT,),
    ),
    "px4_msgs/msg/SensorGyro": SignalFields(rate=RateField(("x", "y", "z")), stamps=_SAMPLED),
    "px4_msgs/msg/SensorGyroFifo": SignalFields(
        rate=RateField(("x", "y", "z"), burst=Burst("samples", Stamp(("dt",), "us"), "scale")),
        stamps=_SAMPLED,
    ),
    "px4_msgs/msg/VehicleAngularVelocity": SignalFields(rate=RateField(("xyz",)), stamps=_SAMPLED),
    "px4_msgs/msg/VehicleAttitude": SignalFields(
        orientation=_FRD_TO_NED, stamps=(*_SAMPLED, _SENT)
    ),
    "px4_msgs/msg/VehicleImu": SignalFields(
        rate=RateField(("delta_angle",), span=Stamp(("delta_angle_dt",), "us")), stamps=_SAMPLED
    ),
    "px4_msgs/msg/VehicleOdometry": SignalFields(
        rate=RateField(("angular_velocity",), measured=False),
        orientation=_FRD_TO_NED._replace(position="position"),
        stamps=(*_SAMPLED, _SENT),
    ),
}
"""Fields by message type, relative to the message."""


def fields_of_type(type_name: str) -> SignalFields | None:
    """Return the row of a type, however ROS or Foxglove spell it; None where there is none."""
    name = ros_name(type_name)
    return MESSAGE_TYPES.get(name.replace("foxglove/", "foxglove_msgs/"))
