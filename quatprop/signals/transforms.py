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


class TransformReader:
    """Reads the transforms between two frames, as the blocks of a channel are read.

    Parameters
    ----------
    log, channel
        Where the messages are.
    frames
        Which transforms.
    clock
        Whose time.
    """

    def __init__(self, log: MessageLog, channel: Channel, frames: Frames, clock: Clock) -> None:
        self._decoder = TransformDecoder(channel, log.path)
        self._decoder.frames.append(frames)
        self._clock = clock
        self._path = log.path

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, wxyz, position)``; any number of rows of a message."""
        transforms = self._decoder.transforms(block)
        ours = transforms.frames == 0
        message = transforms.message[ours]
        if self._clock.name == "header":
            t_ns = transforms.t_ns[ours]
        else:
            t_ns = self._clock.ns((), block, self._path)[message]
        return Columns(
            block.log_ns[message],
            (t_ns, transforms.wxyz[ours], transforms.position[ours]),
            block.not_before_ns,
        )


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
