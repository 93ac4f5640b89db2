"""Cursors over several messages, for values that plans do not reach: lists and strings."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UnsupportedLogError
from quatprop.messages.binary import ENCAPSULATIONS, encapsulations_of
from quatprop.messages.columns import TooShortError
from quatprop.messages.placement import ROS1, XCDR1, Placement
from quatprop.messages.schema import Primitive, String, Struct, Type, key_path_of
from quatprop.text import quoted

if TYPE_CHECKING:
    from pathlib import Path

    from quatprop.arrays import AnyArray, Bool, Int64, Intp
    from quatprop.messages.blocks import Channel, MessageBlock

_FIRST = 200
"""Number of messages that :func:`first_names` reads."""


class SkipError(Exception):
    """A value cannot be skipped: it is a list, or its type has no definition."""


class Names(NamedTuple):
    """Offset and length of a string in each message, without a terminating zero."""

    begin: Int64
    length: Int64

    def text(self, block: MessageBlock, row: int) -> str:
        """Return the string of one message."""
        begin = int(self.begin[row])
        name = bytes(block.data[begin : begin + int(self.length[row])])
        return name.decode(errors="surrogateescape")

    def are(self, name: str, block: MessageBlock, rows: Intp) -> Bool:
        """Return in which of some messages the string equals `name`."""
        wanted = np.frombuffer(name.encode(errors="surrogateescape"), np.uint8)
        same: Bool = self.length[rows] == len(wanted)
        text = block.data[self.begin[rows[same]][:, None] + np.arange(len(wanted))]
        same[same] = (text == wanted).all(axis=1)
        return same


class Cursor:
    """A position in each of several messages, all at the same field."""

    def __init__(
        self, block: MessageBlock, messages: Int64, placement: Placement, order: str
    ) -> None:
        self.block = block
        self.messages = messages
        self.placement = placement
        self._order = order
        self._origin = block.starts[messages] + placement.header
        self._at = self._origin.copy()
        self._ends = block.ends[messages]

    def keep(self, chosen: Bool) -> None:
        """Continue with some of the messages."""
        if not chosen.all():
            self.messages = self.messages[chosen]
            self._origin, self._at = self._origin[chosen], self._at[chosen]
            self._ends = self._ends[chosen]

    def numbers(self, code: str, count: int = 1) -> AnyArray:
        """Read a number, shape ``(N,)``, or several, ``(N, count)``."""
        kind = np.dtype(self._order + code)
        alignment = min(kind.itemsize, self.placement.alignment)
        self._at = self._at + (self._origin - self._at) % alignment
        begin = self._advance(kind.itemsize * count)
        places = begin[:, None] + np.arange(kind.itemsize * count)
        taken: AnyArray = self.block.data[places].view(kind)
        return taken[:, 0] if count == 1 else taken

    def name(self) -> Names:
        """Read a string."""
        length = self.numbers("u4").astype(np.int64)
        begin = self._advance(length)
        if self.placement is not ROS1:
            # CDR counts the terminating zero; some writers omit it from an empty string.
            length = length - (length > 0)
        return Names(begin, length)

    def skip(self, kind: Type) -> None:
        """Skip a number, a string or a struct of them."""
        match kind:
            case Primitive():
                self.numbers(kind.code)
            case String():
                self.name()
            case Struct():
                for _, part in kind.fields:
                    self.skip(part)
            case _:
                raise SkipError

    def _advance(self, size: int | Int64) -> Int64:
        begin = self._at
        self._at = begin + size
        short = self._at > self._ends
        if short.any():
            raise TooShortError(self.messages[short])
        return begin


def cursors_of(channel: Channel, block: MessageBlock, path: Path | str) -> list[Cursor]:
    """Return one cursor per encapsulation in a block."""
    if channel.encoding == "ros1":
        return [Cursor(block, np.arange(len(block)), ROS1, "<")]
    short = np.flatnonzero(block.ends - block.starts < XCDR1.header)
    if len(short):
        raise TooShortError(short)
    identifiers = encapsulations_of([block])
    cursors = []
    for identifier in sorted({*identifiers.tolist()}):
        placement, order = ENCAPSULATIONS.get(identifier, (None, ""))
        if placement is not XCDR1:
            raise UnsupportedLogError(
                path,
                f"messages of topic {quoted(channel.topic)} are encapsulated as "
                f"0x{identifier:04x}, in which lists of transforms are not read; "
                "record with plain CDR",
            )
        cursors.append(Cursor(block, np.flatnonzero(identifiers == identifier), placement, order))
    return cursors


def first_names(
    channel: Channel, block: MessageBlock, root: Struct, field_path: str, path: Path | str
) -> list[str]:
    """Return the distinct values of a string field in the first messages of a block.

    Empty if the field is in or behind a list, or if messages are damaged.

    `field_path`: dotted path, such as ``"imu.header.frame_id"``
    """
    try:
        cursor = cursors_of(channel, block.at(np.arange(min(len(block), _FIRST))), path)[0]
        here: Type = root
        for key in key_path_of(field_path) or ():
            if not isinstance(here, Struct):
                return []
            place = [name for name, _ in here.fields].index(str(key))
            for _, kind in here.fields[:place]:
                cursor.skip(kind)
            _, here = here.fields[place]
        names = cursor.name()
    except (TooShortError, SkipError):
        return []
    texts: list[str] = []
    rows = np.arange(len(names.begin))
    while len(rows):
        texts.append(names.text(block, int(rows[0])))
        rows = rows[~names.are(texts[-1], block, rows)]
    return texts
