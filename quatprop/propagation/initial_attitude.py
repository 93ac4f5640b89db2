"""The initial attitude: given, from gravity, from the log itself, or from another series."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, QuatpropError, UsageError
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Remark, Setting, plain, quoted
from quatprop.kinematics.propagate import unit_q0
from quatprop.kinematics.quaternion import (
    IDENTITY,
    UNIT_TOLERANCE,
    conjugate,
    exp,
    from_matrix,
    geodesic_angle,
    multiply,
    rotation_matrix,
)
from quatprop.kinematics.series import AttitudeSeries
from quatprop.settings.parsers import InMemory

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log


LEVEL_NS = 1_000_000_000
"""Gravity is averaged over this time from the first sample on."""

ROUNDING = 1e-12
"""Scatter relative to the mean that is due to rounding alone."""

UPSIDE_DOWN = -0.5
"""Cosine of the angle between the z axes of body and reference, below which it is upside down."""

STEADY = 0.05
"""Largest scatter of the specific force at rest, relative to its mean."""


@dataclass(frozen=True, slots=True)
class InitialAttitude:
    """The initial attitude of a propagation, or its source.

    `source`: ``"level"``, ``"log"``, or an attitude series: a path, a topic of the log or a series
        in memory; ``""`` for `wxyz`
    `wxyz`: the attitude body -> reference, if it is given
    `heading`: for ``"level"``: rotation about the z axis of the reference frame, rad
    `down`: for ``"level"``: whether the reference's z axis points down, as in north-east-down;
        None: as the type of the rates has it, or else up
    """

    source: str | InMemory = ""
    wxyz: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    heading: float = 0.0
    down: bool | None = None

    @property
    def origin(self) -> str:
        """The origin of the attitude, for the report."""
        if self.source == "level":
            axis = "down" if self.down else "up"
            return f"level, reference z {axis}, heading {math.degrees(self.heading):.6g} deg"
        return str(self.source) or ("identity" if self == InitialAttitude() else "given")

    def __post_init__(self) -> None:
        length = math.hypot(*self.wxyz)
        if length:
            unit_q0(self.wxyz)
        if abs(length - 1) > UNIT_TOLERANCE:
            remedy = "scale it to 1" if length else "the identity is 1,0,0,0"
            raise UsageError(
                f"{Setting('q0')} {','.join(map(repr, self.wxyz))} has the length {length:.6g}, "
                f"so it is not an attitude; {remedy}",
            )


class LogContext(NamedTuple):
    """The recording of a propagation, and its settings.

    `mount`: sensor axes to body axes, shape ``(3, 3)``, also for accelerations and orientations;
        None if they are equal
    `mount_frames`: the frames from the sensor's to the body's, if it is by static transforms
    `rates`: ``"body"`` or ``"inertial"``: the frame in which rates are resolved
    `in_order`: whether samples are used in the order of the log, without sorting
    `first_ns`: the original timestamp of the first sample that is propagated, ns; None if it was
        not changed
    """

    recording: Recording
    source: RateSignal
    mount: Float64 | None
    mount_frames: tuple[str, ...] = ()
    rates: str = "body"
    in_order: bool = True
    first_ns: int | None = None


class FirstAttitude(NamedTuple):
    """The initial attitude and its uncertainty.

    `wxyz`: unit quaternion body -> reference, shape ``(4,)``
    `noise`: variances of roll, pitch and yaw due to measurement noise, rad^2; None if they are not
        known
    """

    wxyz: Float64
    noise: tuple[float, float, float] | None = None

    def covariance(self, sigma: tuple[float, ...] | None) -> Float64 | None:
        """Return the covariance of small rotations about body axes, ``(3, 3)``, rad^2, if known.

        `sigma`: standard deviation about every axis, or those of roll, pitch and yaw, rad; None
            if not given
        """
        if sigma is not None and len(sigma) == 1:
            return sigma[0] ** 2 * np.eye(3)
        variances = self.noise if sigma is None else [each**2 for each in sigma]
        if variances is None:
            return None
        turn = rotation_matrix(self.wxyz)
        roll = math.atan2(turn[2, 1], turn[2, 2])
        # The axes of roll, pitch and yaw in body axes.
        axes = np.array([[1, 0, 0], [0, math.cos(roll), -math.sin(roll)], turn[2]])
        return np.asarray(axes.T * variances @ axes)


def first_attitude(
    wanted: InitialAttitude, context: LogContext, first: GyroSeries
) -> FirstAttitude:
    """Return the attitude at the first sample that is propagated.

    `first`: the first samples that are propagated, in body axes, after the handling of their
        timestamps
    """
    first_ns = int(first.t_ns[0])
    # Other data in the messages of the rates have the original timestamps.
    logged_ns = first_ns if context.first_ns is None else context.first_ns
    log = context.recording.log
    if wanted.source == "level" and log is not None:
        _refuse_motion(first, log)
        force, variance = _force(log, context, logged_ns)
        wxyz = level(force, wanted.heading, down=bool(wanted.down))
        if wanted.down is None:
            context.recording.other_remarks += _upside_down(wxyz)
        # Constant accelerations are due to a coarse sensor, not an exact one.
        known = variance > ROUNDING**2 * float(force @ force)
        return FirstAttitude(wxyz, _level_noise(force, variance) if known else None)
    if not wanted.source:
        return FirstAttitude(unit_q0(wanted.wxyz))
    return FirstAttitude(_recorded(wanted.source, context, first, logged_ns))


def _recorded(
    wanted: str | InMemory, context: LogContext, first: GyroSeries, logged_ns: int
) -> Float64:
    """Return the attitude of the log or of another series at the first sample.

    `logged_ns`: the original timestamp in the log
    """
    from quatprop.propagation.other_logs import attitude_at, attitude_in, first_orientation
    from quatprop.propagation.q0_check import OverlappingAttitudes, q0_remarks

    recording, first_ns = context.recording, int(first.t_ns[0])
    overlap, turn = OverlappingAttitudes(first.t_ns), IDENTITY
    if isinstance(wanted, InMemory):
        series = wanted.value
        if not isinstance(series, AttitudeSeries):
            raise UsageError(f"{Setting('q0')}: {type(series).__name__} has no attitudes")
        batches = overlap.watched([series])
        wxyz = attitude_in(batches, first_ns, "q0", recording.other_remarks)
    elif wanted in {"level", "log"}:
        if (log := recording.log) is None:
            raise UsageError(f"{Setting('q0', wanted)} needs a log, not rates in memory")
        wxyz = first_orientation(log, context.source, recording, logged_ns, overlap)
        turn = _from_sensor(log, context)
    else:
        wxyz, frame = attitude_at(wanted, first_ns, recording, overlap)
        turn = _from_frame(frame, context)
    wxyz = unit_q0(wxyz)
    # Corrected timestamps are not those of the orientations beside them.
    if wanted != "log" or logged_ns == first_ns:
        force = _felt(context, logged_ns) if overlap.are_headings else None
        recording.other_remarks += q0_remarks(
            first,
            overlap.turned(turn),
            context.rates,
            context.source.unit,
            context.mount,
            is_of_log=wanted == "log",
            force=force,
        )
    return wxyz if turn is IDENTITY else multiply(wxyz, turn)


def _felt(context: LogContext, first_ns: int) -> Float64 | None:
    """Return the mean specific force from a timestamp on, body axes, if the body is at rest."""
    recording = context.recording
    known = len(recording.other_remarks)
    force = None
    with suppress(QuatpropError):
        if recording.log is not None and not recording.is_stream and context.rates == "body":
            force, _ = _force(recording.log, context, first_ns)
    del recording.other_remarks[known:]
    return force


def _from_sensor(log: Log, context: LogContext) -> Float64:
    """Return the rotation from the body to the frame of the log's own orientation, wxyz."""
    if (mount := context.mount) is None:
        return IDENTITY
    from quatprop.propagation.plausibility import is_of_body

    if is_of_body(log, context.source, context.recording.selection, mount):
        text = (
            "the log's own orientation agrees with the rates only once these are turned into the "
            "axes of the body: it is taken as that of the body, and not turned"
        )
        context.recording.other_remarks.append(Remark("q0-of-body", text))
        return IDENTITY
    # Usually it is that of the sensor: v_ref = q_log v_sensor, v_body = m v_sensor.
    return conjugate(from_matrix(mount))


def _from_frame(frame: str, context: LogContext) -> Float64:
    """Return the rotation from the body to a frame, if static transforms relate them, wxyz.

    `frame`: its name; empty if it is not known
    """
    from quatprop.propagation.conditioning.frames import SAME, StaticTransforms, sensor_frame

    log = context.recording.log
    if log is None or context.rates != "body":
        return IDENTITY
    # A mounting that the user gives leads to the body, whatever its name.
    sensor = sensor_frame(context.source) if context.mount is None else ""
    body = (*context.mount_frames[-1:], sensor)[0]
    if "" in {frame, body} or frame == body:
        return IDENTITY
    found = None
    with suppress(LogError, UsageError):
        static = StaticTransforms(log)
        found = static.rotation(body, frame)
    of_frame = f"the initial attitude is that of {quoted(frame)}, and the rates are about axes of"
    if found is None:
        text = f"{of_frame} {quoted(body)}: if these differ, give {Setting('mount')}"
        context.recording.other_remarks.append(Remark("q0-of-other-frame", text))
    elif (angle := float(geodesic_angle(found[0], IDENTITY))) > SAME:
        static.remark_on_others(found[1])
        mount = Setting("mount", f"tf:{frame}")
        text = (
            f"{of_frame} {quoted(body)}: it is turned by {degrees_text(angle, 3)}, by the static "
            f"transforms of the log; for the attitudes of {quoted(frame)} use {mount}"
        )
        context.recording.other_remarks.append(Remark("q0-turned", text))
        return found[0]
    return IDENTITY


def level(force: Float64, heading: float, *, down: bool) -> Float64:
    """Return the attitude of a body at rest from its specific force.

    `force`: specific force in body axes, shape ``(3,)``, any unit; at rest it points up
    `heading`: rotation about the z axis of the reference frame, rad, applied last
    `Returns`: wxyz, body -> reference, shape ``(4,)``: the roll and pitch that bring the force
        upright, then the heading
    """
    x, y, z = -force if down else force
    roll, pitch = math.atan2(y, z), math.atan2(-x, math.hypot(y, z))
    turns = exp(np.array([[0.0, 0.0, heading], [0.0, pitch, 0.0], [roll, 0.0, 0.0]]))
    return multiply(turns[0], multiply(turns[1], turns[2]))


def _upside_down(wxyz: Float64) -> list[Remark]:
    """Return a remark on a level attitude whose body z axis points far below the horizon."""
    if rotation_matrix(wxyz)[2, 2] > UPSIDE_DOWN:
        return []
    text = (
        f"{Setting('q0', 'level')} takes z up, and accelerations at rest that point up: the body "
        "begins upside down. If the z axis of the sensor points down (FRD), or the accelerations "
        "are those of gravity, which point down (as of iOS; z is up all the same), use "
        f"{Setting('reference_z', 'down')}; if it is mounted so, turn it with {Setting('mount')}"
    )
    return [Remark("level-upside-down", text)]


def _level_noise(force: Float64, variance: float) -> tuple[float, float, float]:
    """Return the variances of roll, pitch and yaw of :func:`level`, rad^2.

    `force`: mean specific force in body axes, shape ``(3,)``, any unit
    `variance`: of each of its components, due to noise
    """
    _, y, z = force
    # With the x axis upright the roll is undetermined.
    roll = variance / max(y * y + z * z, variance * 3 / math.pi**2) if variance else 0.0
    return roll, variance / float(force @ force), 0.0


def _refuse_motion(first: GyroSeries, log: Log) -> None:
    from quatprop.propagation.conditioning.static_period import AT_REST

    rate = first.rate[first.t_ns <= first.t_ns[0] + LEVEL_NS]
    scatter = float(np.sqrt(((rate - rate.mean(axis=0)) ** 2).sum(axis=1).mean()))
    if not scatter <= AT_REST:
        raise UsageError(
            f"{plain(log.path)} does not start at rest (its rates scatter by {scatter:.3g} rad/s "
            "in the first second), so gravity does not show the attitude; choose "
            f"{Setting('start')} at rest, or give {Setting('q0')}",
        )


def _force(log: Log, context: LogContext, first_ns: int) -> tuple[Float64, float]:
    """Return the mean specific force over the second from a timestamp on, body axes, ``(3,)``.

    The second value is the variance of its components due to noise.
    """
    from quatprop.propagation.conditioning.accelerations import specific_forces

    found = specific_forces(context.recording, context.source)
    if found is None:
        raise LogError(
            log.path, f"it has no accelerations to take roll and pitch from; give {Setting('q0')}"
        )
    last_ns = first_ns + LEVEL_NS
    parts = []
    for t_ns, force in found.rows:
        if context.in_order and t_ns[0] > last_ns:
            break
        parts.append(force[(t_ns >= first_ns) & (t_ns <= last_ns)])
    forces = np.concatenate(parts) if parts else np.zeros((0, 3))
    if len(forces) and not np.isfinite(forces).any():
        raise LogError(
            log.path,
            "the accelerations next to its rates are absent, and roll and pitch are taken from "
            f"them; give {Setting('q0')}",
        )
    forces = forces[np.isfinite(forces).all(axis=1)]
    mean = forces.mean(axis=0) if len(forces) else np.zeros(3)
    size = float(np.linalg.norm(mean))
    scatter = float(np.sqrt(((forces - mean) ** 2).sum(axis=1).mean())) if len(forces) else 0.0
    if size == 0.0 or scatter > STEADY * size:
        raise UsageError(
            f"{plain(log.path)}: the accelerations of the first second do not show gravity "
            f"alone; choose {Setting('start')} at rest, or give {Setting('q0')}",
        )
    in_body = mean if context.mount is None else context.mount @ mean
    return in_body, scatter**2 / 3 / len(forces)


# Remove the rotation of the Earth from attitudes relative to a frame on the ground.


RAD_S = 7.292115e-5
"""The rate of the Earth's rotation, rad/s (WGS 84)."""


class EarthRate(NamedTuple):
    """The rotation of a reference frame on the ground relative to an inertial frame.

    A gyroscope measures relative to the inertial frame. The frames agree at the first sample, so
    the attitudes relative to the ground are q_ground(t) = exp(-w (t - t_0) / 2) q(t). The factor
    is exact, since w is constant in both frames.

    `latitude`: deg, positive in the north
    `azimuth`: of the reference's x axis, deg clockwise from north; None: x points east if z is up,
        north if z is down
    `down`: whether the reference's z axis points down; None: as for :class:`InitialAttitude`
    """

    latitude: float
    azimuth: float | None = None
    down: bool | None = None

    @property
    def rate(self) -> Float64:
        """The angular rate of the reference frame in its own axes, shape ``(3,)``, rad/s."""
        azimuth = self.azimuth
        if azimuth is None:
            azimuth = 0.0 if self.down else 90.0
        x, latitude = np.radians([azimuth, self.latitude])
        to_y = -np.sin(x) if self.down else np.sin(x)
        north, up = np.cos(latitude), np.sin(latitude)
        turn = np.array([north * np.cos(x), north * to_y, -up if self.down else up])
        # The computed cosine of 90 deg is not exactly zero.
        return RAD_S * np.where(np.abs(turn) < 1e-15, 0.0, turn)  # noqa: PLR2004

    def against_ground(self, wxyz: Float64, t_ns: Int64, first_ns: int) -> Float64:
        """Return attitudes relative to the ground, ``(N, 4)``; the frames agree at `first_ns`."""
        seconds = (t_ns - first_ns) * 1e-9
        return multiply(exp(-seconds[:, None] * self.rate), wxyz)

    def subtract_earth_rate(
        self, batches: Iterable[AttitudeSeries], first_ns: int
    ) -> Iterator[AttitudeSeries]:
        """Yield attitudes relative to the ground."""
        for series in batches:
            yield replace(series, wxyz=self.against_ground(series.wxyz, series.t_ns, first_ns))
