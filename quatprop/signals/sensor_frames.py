"""The frames of a sensor, in the headers of its messages."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.kept_blocks import blocks_of
from quatprop.messages.cursor import first_names
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import String, find
from quatprop.signals.message_values import channels_of

if TYPE_CHECKING:
    from quatprop.containers.base import MessageLog
    from quatprop.signals.signal import RateSignal

ENCODINGS = ("cdr", "ros1")
"""Encodings whose lists of transforms and names of frames are read."""


def sensor_frames(log: MessageLog, source: RateSignal) -> list[str]:
    """Return the frames of the first messages with rates, in the innermost header.

    There are none where messages do not name it.
    """
    levels = source.field.split(",")[0].split(".")[:-1]
    names = [
        ".".join((*levels[:count], "header", "frame_id")) for count in range(len(levels), -1, -1)
    ]
    for channel in channels_of(log, source.name):
        if channel.type_name != source.type_name or channel.encoding not in ENCODINGS:
            continue
        root = message_type(channel, log.path)
        for name in names:
            block = next((block for block in blocks_of(log, channel) if len(block)), None)
            if block is not None and isinstance(find(root, name), String):
                frames = first_names(channel, block, root, name, log.path)
                if any(frames):
                    return list(map(bare_frame, frames))
    return []


def bare_frame(frame: str) -> str:
    """Return the name of a frame as tf2 has it: tf began them with a slash."""
    return frame.removeprefix("/")
