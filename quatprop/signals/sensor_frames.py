"""The frames of a sensor, in the headers of its messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from quatprop.signals.signal import RateSignal


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
