"""Write a simulated log and its true attitudes.

Tables have timestamps in ns and rates in rad/s as ``t_ns,wx,wy,wz``. Containers have
``sensor_msgs/Imu`` on ``/imu``: the header timestamp is the sampling time, the log time the
arrival, a little later.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError, UsageError
from quatprop.progress import with_progress
from quatprop.provenance import as_json
from quatprop.simulation.gyroscope import Gyroscope, record
from quatprop.simulation.motion import Shape, motion_named
from quatprop.text import listed, quoted
from quatprop.writers import open_messages, open_table, open_writer
from quatprop.writers.attitudes import AttitudeWriter, attitude_messages, column_table
from quatprop.writers.formats import GENERAL_KINDS, WRITERS, kind_of
from quatprop.writers.messages.kinds import Message
from quatprop.writers.messages.ros_messages import ABSENT, RosEncoder
from quatprop.writers.targets import is_stdout, refuse_overlap

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64, Records
    from quatprop.series import AttitudeSeries


IDENTITY = (1.0, 0.0, 0.0, 0.0)


def truth_beside(target: Path | str, kind: str | None = None) -> str | None:
    """Return the default path of the truth: the log's name with ``.truth.csv``.

    The truth of a Parquet log is Parquet as well; that of stdout, or of a folder without a name, is
    not written.
    """
    if is_stdout(target) or not Path(target).name:
        return None
    kind = kind_of(target, kind, GENERAL_KINDS)
    suffix = ".truth.parquet" if kind == "parquet" else ".truth.csv"
    path = Path(target)
    return str(path.with_name((path.name if kind.startswith("rosbag2") else path.stem) + suffix))


def simulate(  # noqa: PLR0913  # a complete recording
    target: Path | str,
    motion: str,
    shape: Shape,
    gyroscope: Gyroscope,
    *,
    q0: tuple[float, ...] = IDENTITY,
    kind: str | None = None,
    compression: str | None = None,
    truth: Path | str | None = None,
) -> None:
    """Write a log of a motion, and its true attitudes.

    `truth`: path of the true attitudes, scalar-first; None to omit them
    """
    refuse_overlap([], [str(target), None if truth is None else str(truth)])
    provenance = _provenance(motion, shape, gyroscope, q0)
    with ExitStack() as stack:
        log = stack.enter_context(
            open_log_writer(target, kind, deviation=gyroscope.deviation, compression=compression)
        )
        attitudes = [stack.enter_context(open_writer(truth))] if truth is not None else []
        recorded = record(motion_named(motion, shape), gyroscope, q0)
        for series in with_progress(recorded, gyroscope.samples, len):
            for writer in (log, *attitudes):
                writer.write(series)
        for writer in attitudes:
            writer.finish(provenance)
        # Logs of messages have no provenance, like those of recorders.
        log.finish({} if WRITERS[kind_of(target, kind)].encodings else provenance)
        for writer in (*attitudes, log):
            writer.publish()


def _provenance(
    motion: str, shape: Shape, gyroscope: Gyroscope, q0: tuple[float, ...]
) -> dict[str, object]:
    """Return the parameters, JSON-ready; without a version, so that the bytes are the same."""
    return {
        "simulated": motion,
        "motion": as_json(shape),
        "gyroscope": as_json(gyroscope),
        "convention": {
            "attitude": "body to reference: v_ref = q v_body q*",
            "product": "Hamilton, ij = k",
            "rates": "body, rad/s",
            "layout": "scalar-first",
            "q0_wxyz": list(q0),
        },
    }


RATE_COLUMNS = ("wx", "wy", "wz")

DEFAULT_COMPRESSIONS = {"rosbag2-mcap": "none"}
"""Compressions of recorders that differ from the default of the attitude writer."""

GRAVITY = 9.80665
"""Standard gravity, m/s^2."""

_TRANSPORT_NS = 1_000_000
_JITTER_NS = 100_000
_HASH_MULTIPLIER = 0x9E3779B1
"""Multiplier of Fibonacci hashing (Knuth, The Art of Computer Programming, 6.4)."""


class ImuEncoder(RosEncoder):
    """Encodes samples as messages on ``/imu``.

    The orientation is marked as unknown; the acceleration is the reaction to gravity of a sensor
    that only rotates, in a reference frame whose z axis points up.

    `deviation`: standard deviation of the rates' noise, rad/s, for the covariance
    `ros1`: whether in the encoding of ROS 1 rather than CDR, of ROS 2
    """

    def __init__(self, deviation: float, *, ros1: bool) -> None:
        constants = {
            "covariance": np.reshape(ABSENT, (3, 3)),
            "rate_covariance": (deviation**2 * np.eye(3)).ravel(),
        }
        super().__init__(Message("Imu", "/imu", child="imu"), ros1=ros1, constants=constants)

    def encode(self, series: AttitudeSeries, target: Path | str) -> Records:
        """Return the messages of a batch of true attitudes and measured rates, shape ``(N,)``."""
        rows = self._stamped(series.t_ns, target)
        rows["rate"], rows["acceleration"] = series.rate, _reaction(series.wxyz)
        return rows


def arrival_ns(t_ns: Int64) -> Int64:
    """Return the arrival time of each message: 1 to 1.1 ms after its timestamp, with jitter.

    The jitter is a hash of the timestamp, not a random number, so that it depends on neither seed
    nor batches. Up to 10 kHz messages arrive in order.
    """
    return t_ns + _TRANSPORT_NS + (t_ns * _HASH_MULTIPLIER & 0xFFFFFFFF) % _JITTER_NS


def _reaction(wxyz: Float64) -> Float64:
    """Return the upward reaction to gravity in the body frame, m/s^2: ``q* (0, 0, g) q``."""
    w, x, y, z = wxyz.T
    up = (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y))
    return GRAVITY * np.stack(up, axis=1)


def open_log_writer(
    target: Path | str,
    kind: str | None = None,
    *,
    deviation: float = 0.0,
    compression: str | None = None,
) -> AttitudeWriter:
    """Open a writer of a simulated log.

    `target`: path, or ``"-"`` for stdout
    `kind`: one of :data:`quatprop.writers.GENERAL_KINDS`; None takes it from the suffix of `target`
    `deviation`: standard deviation of the rates' noise, rad/s, for the messages' covariance
    `compression`: ``"none"``, ``"lz4"``, ``"zstd"`` or ``"bz2"``; None for the kind's default
    """
    kind = kind_of(target, kind, GENERAL_KINDS)
    if kind not in GENERAL_KINDS:
        raise OutputError(
            target, f"kind {quoted(kind)} holds attitudes only; choose {listed(GENERAL_KINDS)}"
        )
    compressions = WRITERS[kind].compressions
    if compression not in (None, *compressions):
        raise UsageError(
            f"a {kind} log cannot be compressed with {quoted(compression)}; "
            f"choose {listed(compressions)}"
        )
    if WRITERS[kind].columns:
        return column_table(open_table(target, RATE_COLUMNS, kind), lambda series: series.rate)
    encoder = ImuEncoder(deviation, ros1="ros1" in WRITERS[kind].encodings)
    compression = compression or DEFAULT_COMPRESSIONS.get(kind)
    container = open_messages(target, kind, encoder.topic, compression)
    return attitude_messages(container, encoder, target, lambda series: arrival_ns(series.t_ns))
