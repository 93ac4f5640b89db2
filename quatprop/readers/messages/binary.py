"""Decode binary messages (CDR, ROS 1, ULog) into columns, several blocks at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.messages.columns import MessageBytes, MixedError, TooShortError, follow, take_messages
from quatprop.messages.compiler import NotPlannedError, compile_plan
from quatprop.messages.definitions import message_type
from quatprop.messages.placement import ROS1, XCDR1, XCDR2, Placement
from quatprop.messages.schema import Primitive, numeric_layout_at
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray, Int64, Intp
    from quatprop.messages.blocks import Channel, MessageBlock
    from quatprop.messages.plan import Plan

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
