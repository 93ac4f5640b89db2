"""What simulated ROS recordings share: the message's type and when a message arrives."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from quatprop.series import GyroSeries

IMU = "sensor_msgs/msg/Imu"

_TRANSPORT_NS = 1_000_000
_JITTER_NS = 100_000
_SCRAMBLE = 0x9E3779B1
"""Multiplier that spreads neighbouring integers (Knuth, The Art of Computer Programming, 6.4)."""


def arrival_ns(measured: GyroSeries) -> NDArray[np.int64]:
    """Return when each message arrives: 1 to 1.1 ms after its stamp, unevenly.

    The unevenness is a scrambled stamp, not a random number, so that it depends on neither seed
    nor batches. Up to 10 kHz messages arrive in order.
    """
    scrambled = (measured.t_ns * _SCRAMBLE & 0xFFFFFFFF) % _JITTER_NS
    arrival: NDArray[np.int64] = measured.t_ns + _TRANSPORT_NS + scrambled
    return arrival
