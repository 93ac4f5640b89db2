"""Samples as ``sensor_msgs/Imu`` messages, encoded by the block."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.writers.messages.ros_records import HEADER_TIME, RosRecords
from quatprop.writers.messages.topics import ros_topic

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.series import AttitudeSeries, GyroSeries

GRAVITY = 9.80665
"""Standard gravity, m/s^2."""

ABSENT = -1.0
"""First element of a covariance whose quantity is not measured, by the definition of Imu."""

_TRANSPORT_NS = 1_000_000
_JITTER_NS = 100_000
_SCRAMBLE = 0x9E3779B1
"""Multiplier that spreads neighbouring integers (Knuth, The Art of Computer Programming, 6.4)."""


class ImuEncoder:
    """Encodes samples as messages on ``/imu``.

    The orientation is marked absent; the acceleration is that of a sensor that only rotates, in a
    reference frame whose z axis points up: the reaction to gravity.

    Parameters
    ----------
    deviation
        Standard deviation of the rates' noise, rad/s, for the covariance.
    ros1
        Whether they are encoded as in ROS 1 rather than in CDR, as in ROS 2.

    Attributes
    ----------
    topic
        The topic and its definition.
    """

    def __init__(self, deviation: float, *, ros1: bool) -> None:
        self.topic = ros_topic("/imu", "sensor_msgs/msg/Imu", ros1=ros1)
        self._records = RosRecords(
            {
                "stamp": HEADER_TIME,
                "frame": b"imu",
                "orientation": "4<f8",
                "orientation_covariance": "9<f8",
                "angular_velocity": "3<f8",
                "angular_velocity_covariance": "9<f8",
                "linear_acceleration": "3<f8",
                "linear_acceleration_covariance": "9<f8",
            },
            {
                "orientation_covariance": [ABSENT, *[0.0] * 8],
                "angular_velocity_covariance": (deviation**2 * np.eye(3)).ravel(),
            },
            ros1=ros1,
        )

    def encode(
        self, measured: GyroSeries, truth: AttitudeSeries, target: Path | str
    ) -> NDArray[np.void]:
        """Return the messages of a batch, shape ``(N,)``.

        Parameters
        ----------
        measured
            Stamps and rates.
        truth
            Attitudes at those stamps.
        target
            Where they are written, for errors.

        Raises
        ------
        OutputError
            A stamp is out of the range of ROS.
        """
        rows = self._records.stamped(measured.t_ns, target)
        rows["angular_velocity"] = measured.rate
        rows["linear_acceleration"] = _reaction(truth.wxyz)
        return rows


def arrival_ns(measured: GyroSeries) -> NDArray[np.int64]:
    """Return when each message arrives: 1 to 1.1 ms after its stamp, unevenly.

    The jitter is a scrambled stamp, not a random number, so that it depends on neither seed nor
    batches. Up to 10 kHz messages arrive in order.
    """
    scrambled = (measured.t_ns * _SCRAMBLE & 0xFFFFFFFF) % _JITTER_NS
    arrival: NDArray[np.int64] = measured.t_ns + _TRANSPORT_NS + scrambled
    return arrival


def _reaction(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the upward reaction to gravity in the body frame, m/s^2: ``q* (0, 0, g) q``."""
    w, x, y, z = wxyz.T
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return GRAVITY * np.stack(up, axis=1)
