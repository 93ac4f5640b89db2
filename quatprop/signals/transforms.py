"""Reading one pair of frames out of a topic that carries lists of transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.coalesce import coalesce_blocks
from quatprop.containers.merge import Columns
from quatprop.errors import MessageError, NoSamplesError, UsageError
from quatprop.messages.transforms import Frames, TransformDecoder
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.signals.clock import Clock
    from quatprop.signals.message_values import MessageReader


def transform_reader(
    log: MessageLog, channel: Channel, frames: Frames, clock: Clock
) -> MessageReader:
    """Return what reads the transforms between two frames, as the blocks of a channel are read.

    Its values are ``(t_ns, wxyz, position)``; any number of rows of a message.

    Parameters
    ----------
    log, channel
        Where the messages are.
    frames
        Which transforms.
    clock
        Whose time.
    """
    decoder = TransformDecoder(channel, log.path)
    decoder.frames.append(frames)

    def columns(block: MessageBlock) -> Columns:
        transforms = decoder.transforms(block)
        ours = transforms.frames == 0
        message = transforms.message[ours]
        if clock.name == "header":
            t_ns = transforms.t_ns[ours]
        else:
            t_ns = clock.ns((), block, log.path)[message]
        values = (t_ns, transforms.wxyz[ours], transforms.position[ours])
        return Columns(block.log_ns[message], values, block.not_before_ns)

    return columns


def chosen_frames(log: MessageLog, channel: Channel, wanted: str | None) -> Frames:
    """Return the pair of frames to read, after looking through the topic for all there are.

    Parameters
    ----------
    log, channel
        Where the messages are.
    wanted
        ``"child"`` or ``"parent:child"``; None for the only pair there is.

    Raises
    ------
    UsageError
        There is no such pair, or several.
    NoSamplesError
        The topic has no transforms at all.
    """
    decoder = TransformDecoder(channel, log.path)
    for block in coalesce_blocks(log.blocks(channel)):
        try:
            decoder.transforms(block)
        except MessageError as error:
            if not error.positions:
                raise
    if not decoder.frames:
        raise NoSamplesError(log.path, channel.topic)
    parent, _, child = (wanted or "").rpartition(":")
    matching = [
        frames
        for frames in decoder.frames
        if child in ("", frames.child) and parent in ("", frames.parent)
    ]
    if len(matching) == 1:
        return matching[0]
    there = listed(f"{frames.parent}:{frames.child}" for frames in matching or decoder.frames)
    what = "has several transforms:" if wanted is None else f"has, for {quoted(wanted)},"
    if not matching:
        what = f"has no transform {quoted(wanted)}, but"
    raise UsageError(
        f"{plain(log.path)}: topic {quoted(channel.topic)} {what} {there}; choose one with "
        f"{Setting('frame', 'PARENT:CHILD')}"
    )
