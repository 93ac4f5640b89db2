"""``sensor_msgs/Imu`` messages by the block: columns in, encoded messages out.

With a frame name of fixed length every message has the same bytes in the same places, so a
block of messages is one array of records, filled a column at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.series import AttitudeSeries, GyroSeries

TOPIC = "/imu"
FRAME = b"imu"
GRAVITY = 9.80665
"""Standard gravity, m/s^2."""

ABSENT = -1.0
"""First element of a covariance whose quantity is not measured, by the definition of Imu."""

_VALUES = [
    ("orientation", "<f8", 4),
    ("orientation_covariance", "<f8", 9),
    ("angular_velocity", "<f8", 3),
    ("angular_velocity_covariance", "<f8", 9),
    ("linear_acceleration", "<f8", 3),
    ("linear_acceleration_covariance", "<f8", 9),
]

# ROS 1 packs its fields. CDR has a header of four bytes, ends strings with a zero that counts, and
# aligns float64 to 8 from after its header: with this frame name they happen to be.
_ROS1 = np.dtype(
    [
        ("seq", "<u4"),
        ("sec", "<u4"),
        ("nanosec", "<u4"),
        ("length", "<u4"),
        ("frame", "S3"),
        *_VALUES,
    ]
)
_CDR = np.dtype(
    [
        ("header", "S4"),
        ("sec", "<i4"),
        ("nanosec", "<u4"),
        ("length", "<u4"),
        ("frame", "S4"),
        *_VALUES,
    ]
)
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"
_NS_PER_S = 1_000_000_000


def ros1_messages(
    measured: GyroSeries, truth: AttitudeSeries, deviation: float, first: int
) -> NDArray[np.void]:
    """Return messages as ROS 1 encodes them, shape ``(N,)``; as :func:`cdr_messages`."""
    rows = np.zeros(len(measured), _ROS1)
    rows["seq"] = np.arange(first, first + len(measured))
    rows["length"] = len(FRAME)
    return _messages(rows, measured, truth, deviation)


def cdr_messages(measured: GyroSeries, truth: AttitudeSeries, deviation: float) -> NDArray[np.void]:
    """Return messages as ROS 2 encodes them, shape ``(N,)``.

    The orientation is marked absent; the acceleration is that of a sensor that only turns, in a
    reference whose z axis points up: the reaction to gravity.

    Parameters
    ----------
    measured
        Stamps and rates.
    truth
        Attitudes at those stamps.
    deviation
        Standard deviation of the rates' noise, rad/s, for the covariance.
    """
    rows = np.zeros(len(measured), _CDR)
    rows["header"] = _CDR_LITTLE_ENDIAN
    rows["length"] = len(FRAME) + 1
    return _messages(rows, measured, truth, deviation)


def _messages(
    rows: NDArray[np.void], measured: GyroSeries, truth: AttitudeSeries, deviation: float
) -> NDArray[np.void]:
    rows["sec"], rows["nanosec"] = np.divmod(measured.t_ns, _NS_PER_S)
    rows["frame"] = FRAME
    rows["orientation_covariance"][:, 0] = ABSENT
    rows["angular_velocity"] = measured.rate
    rows["angular_velocity_covariance"][:, ::4] = deviation**2
    rows["linear_acceleration"] = _reaction(truth.wxyz)
    return rows


def _reaction(wxyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the upward reaction to gravity in the body frame, m/s^2: ``q* (0, 0, g) q``."""
    w, x, y, z = wxyz.T
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return GRAVITY * np.stack(up, axis=1)
