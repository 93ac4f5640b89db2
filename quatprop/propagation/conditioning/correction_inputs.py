"""Forces, orientation, biases and mounting, as recorded with the rates of a log."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.kinematics.conventions import FrameMounting
from quatprop.kinematics.quaternion import (
    IDENTITY,
    UNIT_TOLERANCE,
    conjugate,
    multiply,
    normalize,
    rotation_matrix,
)
from quatprop.propagation.conditioning.accelerations import specific_forces
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.matching import beside
from quatprop.readers.tables.turns import bare_frame
from quatprop.settings.reading import AttitudeSelection, GyroCorrection, RateSelection

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.base.arrays import Float64
    from quatprop.propagation.conditioning.biases import BiasSeries
    from quatprop.propagation.conditioning.static_period import Rows
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import AttitudeSignal, RateSignal
    from quatprop.readers.tables.model import Log

    RotationGraph = dict[str, dict[str, Float64]]
    """Frame -> rotation to each neighbouring frame."""


FROM_TRANSFORMS = "tf:"
"""Prefix of a mounting from the transforms of the log."""


class GyroCorrectionInputs(NamedTuple):
    """Inputs from a log besides its rates; None if absent or not needed.

    `force`: reads timestamps and specific forces, shape ``(N, 3)``, any unit, sensor axes
    `orientation`: reads timestamps and recorded orientations, wxyz body -> reference, ``(N, 4)``
    `mounting`: the mounting from the transforms of the log
    """

    force: Callable[[], Rows] | None = None
    orientation: Callable[[], Rows] | None = None
    biases: BiasSeries | None = None
    mounting: FrameMounting | None = None
    topic: str = ""


def correction_inputs(
    recording: Recording, source: RateSignal, wanted: GyroCorrection
) -> GyroCorrectionInputs:
    """Return what the corrections of rates need besides them."""
    log, selection = recording.log, recording.selection
    biases = mounting = None
    if wanted.bias_from is not None:
        from quatprop.propagation.conditioning.biases import read_biases

        biases = read_biases(wanted.bias_from, recording)
    if wanted.mount is not None and wanted.mount.startswith(FROM_TRANSFORMS):
        mounting = frame_mounting(log, source, wanted.mount.removeprefix(FROM_TRANSFORMS))
    if log is None:
        return GyroCorrectionInputs(biases=biases, mounting=mounting)
    return GyroCorrectionInputs(
        force=lambda: _force(recording, source),
        orientation=lambda: _orientation(log, source, selection),
        biases=biases,
        mounting=mounting,
        topic=source.name,
    )


def _force(recording: Recording, source: RateSignal) -> Rows:
    """Yield specific forces; none if there are none that can be read."""
    try:
        yield from specific_forces(recording, source) or ()
    except (LogError, UsageError):
        if recording.selection.accel_cols is not None:
            raise
        return


def _orientation(log: Log, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield the orientation recorded in the log, unless it was never set."""
    try:
        own = own_orientation(log, source, selection)
    except (LogError, UsageError):
        return
    if not own.placeholder:
        for series in QuaternionCheck(log.path, drop=True).apply(own.rows()):
            yield series.t_ns, series.wxyz


def own_orientation(log: Log, source: RateSignal, selection: RateSelection) -> AttitudeSignal:
    """Return the orientation in the same messages or rows as the rates, on the same clock."""
    from quatprop.readers.attitude_signals import choose_attitudes

    wanted = AttitudeSelection.like(selection)
    for match in source.matches:
        if match.table.is_typed:
            field = next((own.field for own in beside(match, "quat")), None)
            clock = match.stamp.clock if selection.time_field is None else wanted.clock
            wanted = replace(wanted, topic=source.name, quat_field=field, clock=clock)
            break
    return choose_attitudes(log, wanted)


# The frame of a sensor in its messages, and its mounting from the transforms of the log.


STATIC_TOPIC = "tf_static"
"""Last part of the names of topics with static transforms."""

GIVEN = Setting("mount", "W,X,Y,Z|x,-y,-z")
"""A mounting that does not need the log."""


def sensor_frames(source: RateSignal) -> list[str]:
    """Return the frames in the innermost header of the first messages with rates; may be empty."""
    levels = source.field.split(",")[0].split(".")[:-1]
    for match in source.matches:
        for count in range(len(levels), -1, -1):
            frames = match.table.texts(".".join((*levels[:count], "header", "frame_id")))
            if any(frames):
                return list(map(bare_frame, frames))
    return []


def frame_mounting(log: Log | None, source: RateSignal, frame: str) -> FrameMounting:
    """Return the mounting from a sensor's frame to another frame, by the static transforms.

    `source`: the rates; the header of their first message names the sensor's frame
    `frame`: the frame of the body
    """
    if log is None or not any(match.table.is_typed for match in source.matches):
        mount = Setting("mount", f"tf:{frame}")
        raise UsageError(f"{mount} needs a log of messages with /tf_static")
    sensor, wanted = next(iter(sensor_frames(source)), ""), bare_frame(frame)
    if not sensor:
        raise UsageError(
            f"{plain(log.path)}: messages of topic {quoted(source.name)} do not name the frame of "
            f"their sensor; give {GIVEN}"
        )
    graph = _rotation_graph(log)
    paths: dict[str, tuple[Float64, tuple[str, ...]]] = {sensor: (IDENTITY, (sensor,))}
    waiting = [sensor]
    while waiting and wanted not in paths:
        here = waiting.pop(0)
        wxyz, frames = paths[here]
        for other, step in graph.get(here, {}).items():
            if other not in paths:
                # v_other = step v_here step*, v_here = wxyz v_sensor wxyz*.
                paths[other] = multiply(step, wxyz), (*frames, other)
                waiting.append(other)
    if wanted not in paths:
        known = f"they lead from it to {listed(sorted(paths.keys() - {sensor}))}"
        if len(paths) == 1:
            known = f"there are {listed(sorted(graph))}"
        raise UsageError(
            f"{plain(log.path)}: no static transforms lead from the frame {quoted(sensor)} of the "
            f"sensor to {quoted(frame)}; {known if graph else 'the log has none'}"
        )
    wxyz, frames = paths[wanted]
    return FrameMounting(rotation_matrix(normalize(wxyz)), frames)


def _rotation_graph(log: Log) -> RotationGraph:
    """Return the rotations between neighbouring frames; the last transform of a frame counts."""
    parents: dict[str, tuple[str, Float64]] = {}
    for table in log.tables():
        if table.name.rpartition("/")[2] != STATIC_TOPIC:
            continue
        for frames, wxyz in table.transforms(GIVEN):
            parent, child = map(bare_frame, frames)
            if abs(float(np.linalg.norm(wxyz)) - 1) > UNIT_TOLERANCE:
                raise UsageError(
                    f"{plain(log.path)}: the transform from {quoted(child)} to {quoted(parent)} "
                    f"on {quoted(table.name)} is not a rotation"
                )
            parents[child] = parent, wxyz
    graph: RotationGraph = {}
    for child, (parent, wxyz) in parents.items():
        graph.setdefault(child, {})[parent] = wxyz
        graph.setdefault(parent, {})[child] = conjugate(wxyz)
    return graph
