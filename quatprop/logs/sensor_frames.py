"""The frames of a sensor: in its messages, and its mounting by the transforms of its own log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.conditioning.mounting import FrameMounting
from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import (
    IDENTITY,
    UNIT_TOLERANCE,
    conjugate,
    multiply,
    normalize,
    rotation_matrix,
)
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from quatprop.arrays import Float64
    from quatprop.logs.signals.signal import RateSignal
    from quatprop.tables.log import Log

    RotationGraph = dict[str, dict[str, Float64]]
    """Of each frame the rotations from it to its neighbours."""

STATIC_TOPIC = "tf_static"
"""The last part of the name of topics with transforms that never change."""

GIVEN = Setting("mount", "W,X,Y,Z|x,-y,-z")
"""A mounting that the log need not know."""


def sensor_frames(source: RateSignal) -> list[str]:
    """Return the frames of the first messages with rates, in the innermost header.

    There are none where messages do not name it.
    """
    levels = source.field.split(",")[0].split(".")[:-1]
    for match in source.matches:
        for count in range(len(levels), -1, -1):
            frames = match.table.texts(".".join((*levels[:count], "header", "frame_id")))
            if any(frames):
                return list(map(bare_frame, frames))
    return []


def bare_frame(frame: str) -> str:
    """Return the name of a frame as tf2 has it: tf began them with a slash."""
    return frame.removeprefix("/")


def frame_mounting(log: Log | None, source: RateSignal, frame: str) -> FrameMounting:
    """Return the mounting from the frame of a sensor to another, through the static transforms.

    `log`, `source`: the log and its rates; the sensor's frame is that in the header of its first
        message
    `frame`: whose axes are the body's
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
    """Return the rotations between neighbouring frames; of several for a frame the last counts."""
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
