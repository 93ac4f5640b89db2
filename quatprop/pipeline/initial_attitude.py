"""The attitude to begin from: given, from gravity, from the log itself, or from another series."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from quatprop.conditioning.static_detection import AT_REST
from quatprop.errors import LogError, UsageError
from quatprop.kinematics.propagate import unit_q0
from quatprop.kinematics.quaternion import UNIT_TOLERANCE, conjugate, exp, from_matrix, multiply
from quatprop.messages.signal_fields import fields_beside
from quatprop.signals.clock import choose_clock
from quatprop.signals.interpolation import attitude_at, first_orientation
from quatprop.signals.message_values import FieldReader, channels_of, timed_values
from quatprop.tables.base import is_table
from quatprop.tables.matching.choose import match_rates
from quatprop.tables.matching.column_names import parse_name
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.series import GyroSeries
    from quatprop.signals.signal import RateSignal
    from quatprop.tables.base import TableLog

    Float64 = NDArray[np.float64]
    Rows = Iterator[tuple[NDArray[Any], ...]]

LEVEL_NS = 1_000_000_000
"""Gravity is averaged over this time from the first sample on."""

STEADY = 0.05
"""Specific force that scatters by more than this share of its mean is not gravity alone."""

_ACCELERATION = re.compile(
    r"(?:.*\.)?(?:a_rs_s_|acc(?:el(?:eration|erometer)?)?[ _]?|linear_acceleration\.|"
    r"accelerometer_m_s2\[?|a)(?P<axis>[xyz012])\]?",
    re.IGNORECASE,
)
"""Columns of specific force, by their name without a unit."""


@dataclass(frozen=True, slots=True)
class InitialAttitude:
    """Where a propagation begins.

    Parameters
    ----------
    source
        ``"level"``, ``"log"``, or the path of an attitude series; ``""`` for `wxyz`.
    wxyz
        The attitude body -> reference, where it is given.
    heading
        For ``"level"``: rotation about the reference's z axis, rad.
    down
        For ``"level"``: whether the reference's z axis points down, as in north-east-down.

    Raises
    ------
    SeriesError, UsageError
        `wxyz` is not a unit quaternion.
    """

    source: str = ""
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    heading: float = 0.0
    down: bool = False

    def __post_init__(self) -> None:
        unit_q0(self.wxyz)
        length = math.hypot(*self.wxyz)
        if abs(length - 1) > UNIT_TOLERANCE:
            raise UsageError(
                Setting("q0"),
                f" {','.join(map(repr, self.wxyz))} has the length {length:.6g}, so it is not an "
                "attitude; scale it to 1",
            )


class Recording(NamedTuple):
    """The log that is propagated, and how.

    Parameters
    ----------
    log
        Open, and able to be read again; None for rates in memory.
    source, selection
        Its rates, and how they were chosen.
    mount
        Sensor axes to body axes, shape ``(3, 3)``, for accelerometer and orientation too; None
        for the same.
    in_order
        Whether samples are used in the order of the log, not sorted.
    """

    log: MessageLog | TableLog | None
    source: RateSignal
    selection: RateSelection
    mount: Float64 | None
    in_order: bool = True


def first_attitude(wanted: InitialAttitude, recording: Recording, first: GyroSeries) -> Float64:
    """Return the attitude at the first sample that is propagated.

    Parameters
    ----------
    wanted
        Where to take it from.
    recording
        Where the samples come from.
    first
        The first samples that are propagated, in body axes: those that the timestamp handling
        leaves, so that the attitude is that of the first one.

    Returns
    -------
    ndarray
        Unit quaternion body -> reference, shape ``(4,)``.

    Raises
    ------
    UsageError
        The log does not begin at rest.
    LogError
        The log has no accelerations, or the other series, or the log's own orientation, does not
        reach to the first sample.
    """
    if not wanted.source:
        return unit_q0(wanted.wxyz)
    log, mount = recording.log, recording.mount
    first_ns = int(first.t_ns[0])
    if wanted.source not in {"level", "log"}:
        return unit_q0(attitude_at(wanted.source, first_ns))
    if log is None:
        raise UsageError(Setting("q0", wanted.source), " needs a log, not rates in memory")
    if wanted.source == "log":
        wxyz = unit_q0(first_orientation(log, recording.source, first_ns))
        # The orientation is that of the sensor: v_ref = q_log v_sensor, v_body = m v_sensor.
        return wxyz if mount is None else multiply(wxyz, conjugate(from_matrix(mount)))
    _refuse_motion(first, log)
    force = _force(log, recording, first_ns)
    return level(force if mount is None else mount @ force, wanted.heading, down=wanted.down)


def level(force: Float64, heading: float = 0.0, *, down: bool = False) -> Float64:
    """Return the attitude of a body at rest from the specific force it feels.

    Parameters
    ----------
    force
        Specific force in body axes, shape ``(3,)``, any unit; at rest it points up.
    heading
        Rotation about the reference's z axis, rad, applied last.
    down
        Whether the reference's z axis points down.

    Returns
    -------
    ndarray
        wxyz, body -> reference, shape ``(4,)``: the shortest turn that brings the force upright in
        roll and pitch, then the heading.

    Examples
    --------
    >>> level(np.array([0.0, 0.0, 9.81]))
    array([1., 0., 0., 0.])
    """
    x, y, z = -force if down else force
    roll, pitch = math.atan2(y, z), math.atan2(-x, math.hypot(y, z))
    turns = exp(np.array([[0.0, 0.0, heading], [0.0, pitch, 0.0], [roll, 0.0, 0.0]]))
    return multiply(turns[0], multiply(turns[1], turns[2]))


def _refuse_motion(first: GyroSeries, log: MessageLog | TableLog) -> None:
    rate = first.rate[first.t_ns <= first.t_ns[0] + LEVEL_NS]
    scatter = float(np.sqrt(((rate - rate.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if not scatter <= AT_REST:
        raise UsageError(
            f"{quoted(log.path)} does not begin at rest (its rates scatter by {scatter:.3g} rad/s "
            "in the first second), so gravity does not show the attitude; choose ",
            Setting("start"),
            " at rest, or give ",
            Setting("q0"),
        )


def _force(log: MessageLog | TableLog, recording: Recording, first_ns: int) -> Float64:
    """Return the mean specific force over the first second from a stamp on, shape ``(3,)``."""
    source, selection = recording.source, recording.selection
    if is_table(log):
        rows = _table_forces(log, selection)
    else:
        rows = _message_forces(cast("MessageLog", log), source, selection)
    last_ns = first_ns + LEVEL_NS
    parts = []
    for t_ns, force in rows:
        if recording.in_order and t_ns[0] > last_ns:
            break
        parts.append(force[(t_ns >= first_ns) & (t_ns <= last_ns)])
    forces = np.concatenate(parts) if parts else np.zeros((0, 3))
    forces = forces[np.isfinite(forces).all(axis=1)]
    mean = forces.mean(axis=0) if len(forces) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    scatter = float(np.sqrt(((forces - mean) ** 2).sum(axis=1).mean())) if len(forces) else 0.0
    if size == 0.0 or scatter > STEADY * size:
        raise UsageError(
            f"{quoted(log.path)}: the accelerations of the first second do not show gravity alone; "
            "choose ",
            Setting("start"),
            " at rest, or give ",
            Setting("q0"),
        )
    return mean


def _message_forces(log: MessageLog, source: RateSignal, selection: RateSelection) -> Rows:
    for channel in channels_of(log, source.name):
        if channel.type_name != source.type_name:
            continue
        beside = fields_beside(channel, source.field, log.path)
        if beside.rate is None or beside.acceleration is None:
            continue
        name, absent = beside.acceleration
        clock = choose_clock(log, channel, beside.rate.stamps, selection)
        reading = FieldReader(log, channel, clock, [name], [absent])
        rows: Rows = timed_values(log, channel, reading)
        return rows
    raise _no_accelerations(log)


def _table_forces(log: TableLog, selection: RateSelection) -> Rows:
    axes: dict[int, int] = {}
    for position, name in enumerate(log.columns()):
        if match := _ACCELERATION.fullmatch(parse_name(name).key):
            axes.setdefault("xyz012".index(match["axis"]) % 3, position)
    if len(axes) != 3:  # noqa: PLR2004  # axes
        raise _no_accelerations(log)
    timed = match_rates(log, selection).timed
    rows: Rows = log.rows(replace(timed, numbers=tuple(axes[axis] for axis in range(3))))
    return rows


def _no_accelerations(log: MessageLog | TableLog) -> LogError:
    return LogError(
        log.path, "it has no accelerations to take roll and pitch from; give ", Setting("q0")
    )
