"""Decode binary messages (CDR, ROS 1, ULog) into columns, several blocks at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.base.text import quoted
from quatprop.readers.messages.columns import (
    MessageBytes,
    MixedError,
    TooShortError,
    follow,
    take_messages,
)
from quatprop.readers.messages.compiler import (
    ROS1,
    XCDR1,
    XCDR2,
    NotPlannedError,
    Placement,
    compile_plan,
)
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.messages.schema import (
    Primitive,
    String,
    Struct,
    Type,
    key_path_of,
    numeric_layout_at,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Bool, Int64, Intp
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.messages.compiler import Plan


PACKED = ("ros1", "ulog")
"""Encodings without alignment."""

ENCAPSULATIONS: Mapping[int, tuple[Placement, str]] = {
    0x0000: (XCDR1, ">"),
    0x0001: (XCDR1, "<"),
    0x0006: (XCDR2, ">"),
    0x0007: (XCDR2, "<"),
    # These are of the drafts of XTypes and of RTPS 2.3; some writers use them.
    0x0010: (XCDR2, ">"),
    0x0011: (XCDR2, "<"),
}
"""Placement and byte order by the first two bytes of a CDR message, read as big endian.

Fields of the other encapsulations have tags or sizes, which plans do not support.
"""


def encapsulations_of(blocks: Sequence[MessageBlock]) -> Int64:
    """Return the encapsulation identifiers of CDR messages; 0 for those shorter than 4 bytes."""
    identifiers = []
    for block in blocks:
        starts = np.where(block.ends - block.starts < XCDR1.header, -1, block.starts)
        first, second = (block.data[starts + k].astype(np.int64) for k in (0, 1))
        identifiers.append(np.where(starts < 0, 0, first << 8 | second))
    return np.concatenate(identifiers)


class BinaryDecoder:
    """Decodes the same fields of every message of a channel.

    `channel`: the channel to decode, with its definition
    `field_paths`: dotted paths of the wanted fields; a struct or fixed array of numbers of one type
        gives a column of rows
    """

    def __init__(self, channel: Channel, field_paths: Sequence[str], path: Path | str) -> None:
        self.channel = channel
        self.path = path
        self._root = message_type(channel, path)
        self._key_paths = []
        self._empty: list[AnyArray] = []
        for field_path in field_paths:
            key_path, kind, number, count = numeric_layout_at(channel, self._root, field_path, path)
            self._key_paths.append(key_path)
            empty_shape = (0,) if isinstance(kind, Primitive) else (0, count)
            self._empty.append(np.empty(empty_shape, number.code))
        self._plans: dict[Placement, Plan] = {}
        # Compiled here, so that a definition without a plan fails before a message is read.
        self._plan(ROS1 if channel.encoding in PACKED else XCDR1)

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks.

        `Returns`: one array per path: shape ``(N,)`` for a number, ``(N, k)`` for a row of `k`, of
            the field's own type in native byte order. They may be strided, never views of a block
        """
        try:
            return self._columns([block for block in blocks if len(block)])
        except TooShortError as error:
            raise self._too_short(blocks, error.positions) from None

    def _columns(self, blocks: Sequence[MessageBlock]) -> list[AnyArray]:
        if not blocks or not self._key_paths:
            return self._empty_columns(0)
        placement, order = self._encoding(blocks)
        messages = MessageBytes.of(blocks, order, placement.header)
        messages.require(placement.header)
        try:
            return follow(self._plan(placement), messages, len(self._key_paths))
        except MixedError:
            return self._mixed(blocks)

    def _mixed(self, blocks: Sequence[MessageBlock]) -> list[AnyArray]:
        """Decode messages of several encapsulations, one encapsulation after another."""
        identifiers = encapsulations_of(blocks)
        if not set(identifiers.tolist()) <= ENCAPSULATIONS.keys():
            raise self._unsupported(identifiers)
        mixed = self._empty_columns(len(identifiers))
        for identifier in np.unique(identifiers):
            same = np.flatnonzero(identifiers == identifier)
            try:
                parts = self._columns(take_messages(blocks, same))
            except TooShortError as error:
                raise TooShortError(same[error.positions]) from None
            for column, part in zip(mixed, parts, strict=True):
                column[same] = part
        return mixed

    def _empty_columns(self, count: int) -> list[AnyArray]:
        return [np.empty((count, *empty.shape[1:]), empty.dtype) for empty in self._empty]

    def _encoding(self, blocks: Sequence[MessageBlock]) -> tuple[Placement, str]:
        """Return the placement and the byte order of the first message."""
        if self.channel.encoding in PACKED:
            return ROS1, "<"
        first = blocks[0]
        begin, end = int(first.starts[0]), int(first.ends[0])
        if end - begin < XCDR1.header:
            sizes = np.concatenate([block.ends - block.starts for block in blocks])
            raise TooShortError(np.flatnonzero(sizes < XCDR1.header))
        identifier = int(first.data[begin]) << 8 | int(first.data[begin + 1])
        if identifier in ENCAPSULATIONS:
            return ENCAPSULATIONS[identifier]
        raise self._unsupported(encapsulations_of(blocks))

    def _unsupported(self, identifiers: Int64) -> MessageError | UnsupportedLogError:
        """Return the error for unsupported encapsulations, of some messages or of all."""
        bad = np.flatnonzero(~np.isin(identifiers, list(ENCAPSULATIONS)))
        reason = (
            f"messages of topic {quoted(self.channel.topic)} are encapsulated as "
            f"0x{int(identifiers[bad[0]]):04x}, which is not read; record with plain CDR"
        )
        if len(bad) < len(identifiers):
            return MessageError(self.path, reason, bad.tolist())
        return UnsupportedLogError(self.path, reason)

    def _plan(self, placement: Placement) -> Plan:
        if placement not in self._plans:
            try:
                self._plans[placement] = compile_plan(self._root, tuple(self._key_paths), placement)
            except NotPlannedError as error:
                raise SchemaError(
                    self.path, f"topic {quoted(self.channel.topic)}: {error}"
                ) from None
        return self._plans[placement]

    def _too_short(self, blocks: Sequence[MessageBlock], positions: Intp) -> MessageError:
        (first,) = take_messages(blocks, positions[:1])
        size = int(first.ends[0] - first.starts[0])
        others = f" and {len(positions) - 1} others" if len(positions) > 1 else ""
        return MessageError(
            self.path,
            f"the message of topic {quoted(self.channel.topic)} recorded at "
            f"{first.log_ns[0]} ns{others} ends, after {size} bytes, before the wanted field "
            f"of {quoted(self.channel.type_name)}; the log is damaged or its definition does not "
            "match its messages",
            positions.tolist(),
        )


# Cursors over several messages, for values that plans do not reach: lists and strings.


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


def name_at(cursor: Cursor, root: Struct, field_path: str) -> Names:
    """Return a string field of each message of a cursor at the beginning of the messages."""
    here: Type = root
    for key in key_path_of(field_path) or ():
        if not isinstance(here, Struct):
            raise SkipError
        place = [name for name, _ in here.fields].index(str(key))
        for _, kind in here.fields[:place]:
            cursor.skip(kind)
        _, here = here.fields[place]
    return cursor.name()


def first_names(
    channel: Channel, block: MessageBlock, root: Struct, field_path: str, path: Path | str
) -> list[str]:
    """Return the distinct values of a string field in the first messages of a block.

    Empty if the field is in or behind a list, or if messages are damaged.

    `field_path`: dotted path, such as ``"imu.header.frame_id"``
    """
    try:
        cursor = cursors_of(channel, block.at(np.arange(min(len(block), _FIRST))), path)[0]
        names = name_at(cursor, root, field_path)
    except (TooShortError, SkipError):
        return []
    texts: list[str] = []
    rows = np.arange(len(names.begin))
    while len(rows):
        texts.append(names.text(block, int(rows[0])))
        rows = rows[~names.are(texts[-1], block, rows)]
    return texts
