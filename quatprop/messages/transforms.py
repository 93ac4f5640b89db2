"""Decode TF messages: lists of transforms between named frames.

Decoding plans only reach fields that every message has, not the elements of a list. So the lists
are decoded here: the first transform of all messages, then the second, and so on. The message type
has never changed; the definition that a log carries is checked against it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import MessageError, SchemaError
from quatprop.messages.columns import TooShortError
from quatprop.messages.cursor import Cursor, Names, cursors_of
from quatprop.messages.definitions import message_type
from quatprop.messages.placement import ROS1
from quatprop.messages.schema import Primitive, Sequence, Struct, Type, find, numeric_layout
from quatprop.text import quoted
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.messages.blocks import Channel, MessageBlock


_TRANSLATION_AND_ROTATION = Primitive("f8"), 3 + 4


class Frames(NamedTuple):
    """The two frames of a transform, which is the attitude of the child in the parent."""

    parent: str
    child: str


class Transforms(NamedTuple):
    """The transforms of a block, in the order of messages and, within each, of its list.

    `message`: position of its message in the block, shape ``(N,)``, int64
    `t_ns`: header timestamps, shape ``(N,)``, int64 ns
    `frames`: index of its frames in :attr:`TransformDecoder.frames`, shape ``(N,)``, int64
    `wxyz`: rotations child -> parent, shape ``(N, 4)``, float64
    `position`: positions of the child in the parent, shape ``(N, 3)``, float64, m
    """

    message: Int64
    t_ns: Int64
    frames: Int64
    wxyz: Float64
    position: Float64


class TransformDecoder:
    """Decodes the transforms in the messages of a channel.

    `frames`: all pairs of frames so far, in order of appearance
    """

    def __init__(self, channel: Channel, path: Path | str) -> None:
        self.frames: list[Frames] = []
        self._channel = channel
        self._path = path
        if not _is_list_of_transforms(message_type(channel, path)):
            raise SchemaError(
                path,
                f"topic {quoted(channel.topic)} is of type {quoted(channel.type_name)}, but the "
                "definition that the log carries does not describe a list of transforms",
            )

    def transforms(self, block: MessageBlock) -> Transforms:
        """Return all transforms of a block."""
        none = np.empty(0, np.int64)
        elements = [Transforms(none, none, none, np.empty((0, 4)), np.empty((0, 3)))]
        try:
            for cursor in cursors_of(self._channel, block, self._path):
                elements += self._elements(cursor)
        except TooShortError as error:
            raise MessageError(
                self._path,
                f"the message of topic {quoted(self._channel.topic)} recorded at "
                f"{block.log_ns[error.positions[0]]} ns ends before its list of transforms; "
                "the log is damaged",
                error.positions.tolist(),
            ) from None
        columns = [np.concatenate(parts) for parts in zip(*elements, strict=True)]
        # A stable sort keeps the order of the elements within each message.
        order = np.argsort(columns[0], kind="stable")
        return Transforms(*(column[order] for column in columns))

    def _elements(self, cursor: Cursor) -> Iterator[Transforms]:
        """Yield the first transform of every list, then the second, and so on."""
        left = cursor.numbers("u4").astype(np.int64)
        while True:
            # Every element takes bytes, so a wrong count reaches the end of its message.
            cursor.keep(left > 0)
            left = left[left > 0] - 1
            if not len(left):
                return
            yield self._element(cursor)

    def _element(self, cursor: Cursor) -> Transforms:
        if cursor.placement is ROS1:
            cursor.numbers("u4")  # the sequence number, which ROS 2 does not have
        unsigned = cursor.placement is ROS1
        t_ns = cursor.numbers("u4" if unsigned else "i4").astype(np.int64) * NS_PER_S
        t_ns += cursor.numbers("u4")
        frames = self._frames(cursor.block, cursor.name(), cursor.name())
        values = cursor.numbers("f8", _TRANSLATION_AND_ROTATION[1])
        wxyz = values[:, [6, 3, 4, 5]].astype(np.float64)
        position = values[:, :3].astype(np.float64)
        return Transforms(cursor.messages, t_ns, frames, wxyz, position)

    def _frames(self, block: MessageBlock, parent: Names, child: Names) -> Int64:
        """Return the index of each pair of names, adding new pairs."""
        frames = np.full(len(parent.begin), -1)
        number = 0
        while len(waiting := np.flatnonzero(frames < 0)):
            if number == len(self.frames):
                row = int(waiting[0])
                self.frames.append(Frames(parent.text(block, row), child.text(block, row)))
            pair = self.frames[number]
            same = parent.are(pair.parent, block, waiting)
            same &= child.are(pair.child, block, waiting)
            frames[waiting[same]] = number
            number += 1
        return frames


def _is_list_of_transforms(root: Struct) -> bool:
    match root.fields:
        case ((_, Sequence(element=Struct() as element)),):
            return (
                _names(element) == ["header", "child_frame_id", "transform"]
                and _names(find(element, "transform.rotation")) == list("xyzw")
                and numeric_layout(find(element, "transform")) == _TRANSLATION_AND_ROTATION
            )
    return False


def _names(kind: Type | None) -> list[str]:
    return [name for name, _ in kind.fields] if isinstance(kind, Struct) else []
