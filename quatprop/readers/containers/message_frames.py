"""Frames in the messages of a topic, read from every message.

They hardly ever change, so blocks are compared with the bytes of the last frame, and read only
where they differ.
"""

from __future__ import annotations

import json
import re
from functools import reduce
from operator import getitem
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from quatprop.base.errors import UnsupportedLogError
from quatprop.base.guarded_text import ContentError, read_json
from quatprop.readers.messages.binary import SkipError, cursors_of, name_at
from quatprop.readers.messages.columns import TooShortError, raw_messages
from quatprop.readers.messages.schema import key_path_of
from quatprop.readers.tables.turns import bare_frame

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Int64
    from quatprop.readers.containers.message_source import MessageSource
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.messages.schema import Struct


FRAMES = (
    ("header.frame_id", "frame_id", "header.frameId", "frameId"),
    ("child_frame_id", "body_frame_id", "childFrameId", "bodyFrameId"),
)
"""Names of the frame in a struct, and of the frame of a body that moves in it."""

PAIR_SEPARATOR = ":"
"""Stands between the names of the two."""


class Topic(Protocol):
    """A topic whose messages are read; see :class:`.TopicTable`."""

    log: MessageSource
    channel: Channel
    path: Path
    name: str

    @property
    def root(self) -> Struct:
        """The message type."""

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the log."""


class _Known(NamedTuple):
    """A frame as it is stored; `offset`: of its bytes in each message."""

    offset: int
    stored: bytes
    number: int


class MessageFrames:
    """Reads the frames of all messages of a topic, several in one message as one name.

    `names`: all frames so far, in order of appearance
    """

    def __init__(self, topic: Topic, fields: Sequence[str]) -> None:
        self.names: list[str] = []
        self._fields = [_FieldFrames(topic, field) for field in fields]
        self._latest: tuple[int, ...] = ()
        self._numbers = np.empty(0, np.int64)

    def numbers(self, block: MessageBlock) -> Int64:
        """Return the index of each frame in `names`, or of the only one; -1: not readable."""
        fields = [field.numbers(block) for field in self._fields]
        same = tuple(int(one[0]) for one in fields) if all(len(one) == 1 for one in fields) else ()
        if same and same == self._latest:
            return self._numbers
        own = np.broadcast_arrays(*fields)
        sets, of_rows = np.unique(np.stack(own), axis=1, return_inverse=True)
        firsts = np.unique(of_rows, return_index=True)[1]
        numbers = np.full(len(firsts), -1)
        # In order of appearance.
        for k in np.argsort(firsts).tolist():
            pairs = zip(self._fields, sets[:, k].tolist(), strict=True)
            known = [field.names[number] for field, number in pairs if number >= 0]
            if known:
                name = PAIR_SEPARATOR.join(known) if any(known) else ""
                if name not in self.names:
                    self.names.append(name)
                numbers[k] = self.names.index(name)
        found: Int64 = numbers[of_rows]
        # Most blocks are as the one before.
        self._latest, self._numbers = same, found
        return found


class _FieldFrames:
    """Reads the frames in one field; `names`: as they come, as tf2 spells them."""

    def __init__(self, topic: Topic, field: str) -> None:
        self.names: list[str] = []
        self._topic, self._field = topic, field
        self._is_json = topic.channel.encoding == "json"
        self._known: _Known | None = None
        self._is_readable = True

    def numbers(self, block: MessageBlock) -> Int64:
        """Return the index of each frame in `names`, or of the only one; -1: not readable."""
        if self._known is not None and self._is_same(block, self._known):
            return np.array([self._known.number])
        if not self._is_readable:
            return np.array([-1])
        numbers = np.full(len(block), -1)
        for rows, frame in self._frames(block):
            name = bare_frame(frame)
            if name not in self.names:
                self.names.append(name)
            numbers[rows] = self.names.index(name)
        return numbers

    def _frames(self, block: MessageBlock) -> Iterator[tuple[Int64, str]]:
        """Yield the frames of a block, each with its messages; damaged messages have none."""
        if self._is_json:
            return self._json(block)
        if self._topic.channel.encoding == "protobuf":
            from quatprop.readers.messages.protobuf import texts_of

            return texts_of(self._topic.channel, self._field, block)
        return self._binary(block)

    def _is_same(self, block: MessageBlock, known: _Known) -> bool:
        """Return whether all messages have the frame."""
        offset, stored, _ = known
        if self._is_json:
            return all(raw.count(stored) == 1 for raw in raw_messages(block))
        size, count = len(stored), len(block)
        shortest = (block.ends - block.starts)[: 1 if block.stride else None].min()
        if shortest < offset + size:
            return False
        kind = np.dtype((np.void, size))
        if block.stride:
            at = int(block.starts[0]) + offset
            window = np.ndarray((count,), kind, block.data, at, (block.stride,))
        else:
            every = np.ndarray((len(block.data) - size + 1,), kind, block.data, 0, (1,))
            window = every[block.starts + offset]
        return window.tobytes() == stored * count

    def _binary(self, block: MessageBlock) -> Iterator[tuple[Int64, str]]:
        """Yield the frames of a block, each with its messages; damaged messages have none."""
        topic, kept = self._topic, np.arange(len(block))
        while True:
            part = block.at(kept)
            try:
                cursors = cursors_of(topic.channel, part, topic.path)
                found = [(c.messages, name_at(c, topic.root, self._field)) for c in cursors]
                break
            except TooShortError as error:
                kept = np.delete(kept, error.positions)
            except (SkipError, UnsupportedLogError):
                self._is_readable = False
                return
        for messages, names in found:
            waiting = np.arange(len(messages))
            while len(waiting):
                row = int(waiting[0])
                frame, begin = names.text(part, row), int(names.begin[row])
                same = names.are(frame, part, waiting)
                yield kept[messages[waiting[same]]], frame
                waiting = waiting[~same]
                # With the length before it.
                stored = part.data[begin - 4 : begin + int(names.length[row])].tobytes()
                offset = begin - 4 - int(part.starts[messages[row]])
                self._known = _Known(offset, stored, self.names.index(bare_frame(frame)))

    def _json(self, block: MessageBlock) -> Iterator[tuple[Int64, str]]:
        *_, key = path = key_path_of(self._field) or ()
        for row, raw in enumerate(raw_messages(block)):
            try:
                frame = reduce(getitem, path, read_json(raw))
            except (LookupError, TypeError, ContentError):
                continue
            if not isinstance(frame, str):
                continue
            yield np.array([row]), frame
            name = rf'"{re.escape(str(key))}"\s*:\s*'.encode()
            found = re.findall(name + re.escape(json.dumps(frame)).encode(), raw)
            if len(found) == len(re.findall(name, raw)) == 1:
                self._known = _Known(0, found[0], self.names.index(bare_frame(frame)))
