"""The frame of a sensor in its messages, and its mounting from the transforms of the log."""

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
    """Frame -> rotation to each neighbouring frame."""

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


def bare_frame(frame: str) -> str:
    """Return the name of a frame in tf2, without the leading slash of tf."""
    return frame.removeprefix("/")


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
