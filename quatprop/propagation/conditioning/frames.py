"""Frames of sensors and bodies in messages, and the rotations between them by /tf_static."""

from __future__ import annotations

from itertools import chain, pairwise
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.kinematics.conventions import FrameMounting
from quatprop.kinematics.quaternion import (
    IDENTITY,
    UNIT_TOLERANCE,
    conjugate,
    geodesic_angle,
    multiply,
    normalize,
    rotation_matrix,
)
from quatprop.readers.containers.message_frames import FRAMES
from quatprop.readers.matching import first_batch, scalar_column
from quatprop.readers.tables.turns import bare_frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import Match
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log, Table

    FrameRotation = tuple[Float64, tuple[str, ...]]
    """Rotation wxyz from the first of some frames to the last, v_last = q v_first q*."""


STATIC_TOPIC = "tf_static"
"""Last part of the names of topics with static transforms."""

GIVEN = Setting("mount", "W,X,Y,Z|x,-y,-z")
"""A mounting that does not need the log."""

SAME = 1e-5
"""rad: rotations that differ by less are one that was rounded."""


def mount_text(wxyz: Float64) -> str:
    """Return the rotation of a mounting as its setting gives it."""
    return ",".join(f"{part:.12g}" for part in wxyz)


def sensor_frame(source: RateSignal) -> str:
    """Return the frame about whose axes the first rates are; empty if it is not known."""
    return next(filter(None, map(frame_of, source.matches)), "")


def frame_of(match: Match) -> str:
    """Return the frame about whose axes the first messages of a sensor are; empty if unknown."""
    return _frame_around(match.table, match.field, FRAMES)


DEVICES = ("gyro_device_id", "device_id")
"""Fields of PX4 with the number of the gyroscope."""


def devices_of(match: Match) -> set[int]:
    """Return the numbers of the gyroscopes in the first messages, as PX4 gives them."""
    table = match.table
    for columns in (scalar_column(table, match.part, name) for name in DEVICES):
        if columns and table.is_typed and table.columns[columns[0]].code[0] in "iu":
            batches = first_batch(table, [match.stamp]).read([match.stamp], [columns])
            rows = next(iter(batches), None)
            return set() if rows is None else {*rows.values[-1].ravel().tolist()} - {0}
    return set()


def body_frame(match: Match) -> str:
    """Return the frame whose attitude the first messages of a topic have; empty if not known."""
    # The header of an attitude names its reference, that of a sensor the sensor.
    is_of_sensor = match.row.rate != "" and match.row.measured
    return _frame_around(match.table, match.field, FRAMES if is_of_sensor else FRAMES[1:])


def _frame_around(table: Table, field: str, names: Sequence[Sequence[str]]) -> str:
    """Return the frame in the innermost struct around a field that has any, of bodies first."""
    levels = field.split(",", maxsplit=1)[0].split(".")[:-1]
    for count in range(len(levels), -1, -1):
        for name in chain.from_iterable(reversed(names)):
            frames = table.texts(".".join((*levels[:count], name)))
            if any(frames):
                return bare_frame(frames[0])
    return ""


def frame_mounting(log: Log | None, source: RateSignal, frame: str) -> FrameMounting:
    """Return the mounting from a sensor's frame to another frame, by the static transforms.

    `source`: the rates; the header of their first message names the sensor's frame
    `frame`: the frame of the body
    """
    if log is None or not any(match.table.is_typed for match in source.matches):
        mount = Setting("mount", f"tf:{frame}")
        raise UsageError(f"{mount} needs a log of messages with /tf_static")
    sensor, wanted = sensor_frame(source), bare_frame(frame)
    if not sensor:
        raise UsageError(
            f"{plain(log.path)}: messages of topic {quoted(source.name)} do not name the frame of "
            f"their sensor; give {GIVEN}"
        )
    static = StaticTransforms(log)
    if (found := static.rotation(sensor, wanted)) is None:
        known = static.known_from(sensor)
        raise UsageError(
            f"{plain(log.path)}: no static transforms lead from the frame {quoted(sensor)} of the "
            f"sensor to {quoted(frame)}; {known}"
        )
    static.remark_on_others(found[1], is_mount=True)
    return FrameMounting(rotation_matrix(found[0]), found[1])


class StaticTransforms:
    """The rotations between frames by the static transforms of a log; the last of a frame counts.

    As in tf2, where a later transform replaces an earlier one.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._of_child: dict[str, list[tuple[str, Float64]]] = {}
        self._tables: list[Table] = []
        for table in log.tables():
            if table.name.rpartition("/")[2] == STATIC_TOPIC:
                self._tables.append(table)
                for (parent, child), wxyz in table.transforms(GIVEN):
                    self._add(table, bare_frame(parent), bare_frame(child), wxyz)
        self._steps: dict[str, dict[str, Float64]] = {}
        for child, known in self._of_child.items():
            parent, wxyz = known[-1]
            self._steps.setdefault(child, {})[parent] = wxyz
            self._steps.setdefault(parent, {})[child] = conjugate(wxyz)

    def _add(self, table: Table, parent: str, child: str, wxyz: Float64) -> None:
        if abs(float(np.linalg.norm(wxyz)) - 1) > UNIT_TOLERANCE:
            raise UsageError(
                f"{plain(self._log.path)}: the transform from {quoted(child)} to {quoted(parent)} "
                f"on {quoted(table.name)} is not a rotation"
            )
        known = self._of_child.setdefault(child, [])
        # They are often repeated, as by each part of a recording.
        same = (k for k, one in enumerate(known) if one[0] == parent and _are_same(one[1], wxyz))
        if (k := next(same, None)) is not None:
            del known[k]
        known.append((parent, wxyz))

    def rotation(self, begin: str, end: str) -> FrameRotation | None:
        """Return the rotation from one frame to another; None if no transforms lead there."""
        return self._rotations(begin, end).get(end)

    def _rotations(self, begin: str, end: str = "") -> dict[str, FrameRotation]:
        """Return the rotations from a frame to others, until the end is reached."""
        found: dict[str, FrameRotation] = {begin: (IDENTITY, (begin,))}
        waiting = [begin]
        while waiting and end not in found:
            here = waiting.pop(0)
            wxyz, frames = found[here]
            for other, step in self._steps.get(here, {}).items():
                if other not in found:
                    # v_other = step v_here step*, v_here = wxyz v_begin wxyz*.
                    found[other] = normalize(multiply(step, wxyz)), (*frames, other)
                    waiting.append(other)
        return found

    def known_from(self, frame: str) -> str:
        """Return the frames to which transforms lead, for an error."""
        if not self._steps:
            return "the log has none"
        if others := self._rotations(frame).keys() - {frame}:
            return f"they lead from it to {listed(sorted(others))}"
        return f"there are {listed(sorted(self._steps))}"

    def remark_on_others(self, frames: Sequence[str], *, is_mount: bool = False) -> None:
        """Remark on a rotation along frames that other messages contradict.

        `is_mount`: whether it is that of the mounting, which an option can replace
        """
        pairs = [*pairwise(frames)]
        for child, parent in (*pairs, *(pair[::-1] for pair in pairs)):
            known = [q for name, q in self._of_child.get(child, ()) if name == parent]
            if len(known) > 1:
                *others, used = known
                apart = max(float(geodesic_angle(q, used)) for q in others)
                way_to_other = ""
                if is_mount:
                    mount = normalize(self._along(pairs, (child, parent), others[-1]))
                    remedy = Setting("mount", mount_text(mount))
                    way_to_other = f", and the one before it with {remedy}"
                table = self._tables[0]
                table.remark(
                    "transforms-differ",
                    f"messages on {quoted(table.name)} contain {len(known)} rotations from "
                    f"{quoted(child)} to {quoted(parent)}, up to {degrees_text(apart, 3)} apart; "
                    f"the last one is used{way_to_other}",
                )

    def _along(
        self, pairs: Sequence[tuple[str, str]], changed: tuple[str, str], other: Float64
    ) -> Float64:
        """Return the rotation along frames, with another one for a child and its parent."""
        wxyz = IDENTITY
        for pair in pairs:
            step = self._steps[pair[0]][pair[1]]
            if {*pair} == {*changed}:
                step = other if pair == changed else conjugate(other)
            wxyz = multiply(step, wxyz)
        return wxyz


def _are_same(p: Float64, q: Float64) -> bool:
    return float(geodesic_angle(p, q)) < SAME
