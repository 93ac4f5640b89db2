"""Binary messages (CDR, ROS 1, ULog), decoded a block at a time into columns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.messages.columns import MessageBytes, MixedError, TooShortError, follow
from quatprop.messages.compiler import NotPlannedError, compile_plan
from quatprop.messages.definitions import message_type
from quatprop.messages.placement import ROS1, XCDR1, XCDR2, Placement
from quatprop.messages.schema import Primitive, numbers_at
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray, Int64, Intp
    from quatprop.containers.base import Channel, MessageBlock
    from quatprop.messages.plan import Plan

PACKED = ("ros1", "ulog")
"""Encodings without alignment."""

ENCAPSULATIONS: Mapping[int, tuple[Placement, str]] = {
    0x0000: (XCDR1, ">"),
    0x0001: (XCDR1, "<"),
    0x0006: (XCDR2, ">"),
    0x0007: (XCDR2, "<"),
    # As in the drafts of XTypes and in RTPS 2.3, which some writers follow.
    0x0010: (XCDR2, ">"),
    0x0011: (XCDR2, "<"),
}
"""Placement and byte order by the first two bytes of a CDR message, read as big endian.

In the other encapsulations fields carry tags or sizes, which plans do not support.
"""


def _identifiers(block: MessageBlock) -> Int64:
    """Return the first two bytes of CDR messages as numbers; 0 for those without all four."""
    starts = np.where(block.ends - block.starts < XCDR1.header, -1, block.starts)
    first, second = (block.data[starts + k].astype(np.int64) for k in (0, 1))
    return np.where(starts < 0, 0, first << 8 | second)


class BinaryDecoder:
    """Takes the same fields out of every message of a channel.

    `channel`: Whose messages, with their definition
    `field_paths`: Dotted paths of the wanted fields; a struct or fixed array of equal numbers is
        one column of rows
    """

    def __init__(self, channel: Channel, field_paths: Sequence[str], path: Path | str) -> None:
        self.channel = channel
        self.path = path
        self._root = message_type(channel, path)
        self._ways = []
        self._empty: list[AnyArray] = []
        for field_path in field_paths:
            way, kind, number, count = numbers_at(channel, self._root, field_path, path)
            self._ways.append(way)
            empty_shape = (0,) if isinstance(kind, Primitive) else (0, count)
            self._empty.append(np.empty(empty_shape, number.code))
        self._plans: dict[Placement, Plan] = {}
        # A definition without a plan is an error before the first message is read.
        self._plan(ROS1 if channel.encoding in PACKED else XCDR1)

    def columns(self, block: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages of a block.

        `Returns`: One for each path: shape ``(N,)`` for a number, ``(N, k)`` for a row of `k`, of
            the field's own type in native byte order. They may be strided, never views of the block
        """
        try:
            return self._columns(block)
        except TooShortError as error:
            raise self._too_short(block, error.positions) from None

    def _columns(self, block: MessageBlock) -> list[AnyArray]:
        if not len(block) or not self._ways:
            return self._empty_columns(len(block))
        placement, order = self._encoding(block)
        messages = MessageBytes.of(block, order, placement.header)
        messages.require(placement.header)
        try:
            return follow(self._plan(placement), messages, len(self._ways))
        except MixedError:
            return self._mixed(block)

    def _mixed(self, block: MessageBlock) -> list[AnyArray]:
        """Return the columns of messages in several encapsulations, each decoded by itself."""
        identifiers = _identifiers(block)
        if not set(identifiers.tolist()) <= ENCAPSULATIONS.keys():
            raise self._not_plain(block)
        mixed = self._empty_columns(len(block))
        for identifier in np.unique(identifiers):
            same = np.flatnonzero(identifiers == identifier)
            try:
                parts = self._columns(block.at(same))
            except TooShortError as error:
                raise TooShortError(same[error.positions]) from None
            for column, part in zip(mixed, parts, strict=True):
                column[same] = part
        return mixed

    def _empty_columns(self, count: int) -> list[AnyArray]:
        return [np.empty((count, *empty.shape[1:]), empty.dtype) for empty in self._empty]

    def _encoding(self, block: MessageBlock) -> tuple[Placement, str]:
        """Return how the first message is encoded."""
        if self.channel.encoding in PACKED:
            return ROS1, "<"
        begin, end = int(block.starts[0]), int(block.ends[0])
        if end - begin < XCDR1.header:
            raise TooShortError(np.flatnonzero(block.ends - block.starts < XCDR1.header))
        identifier = int(block.data[begin]) << 8 | int(block.data[begin + 1])
        if identifier in ENCAPSULATIONS:
            return ENCAPSULATIONS[identifier]
        raise self._not_plain(block)

    def _not_plain(self, block: MessageBlock) -> MessageError | UnsupportedLogError:
        """Return the error for encapsulations that are not read: of some messages, or of all."""
        identifiers = _identifiers(block)
        bad = np.flatnonzero(~np.isin(identifiers, list(ENCAPSULATIONS)))
        identifier = int(identifiers[bad[0]])
        reason = (
            f"messages of topic {quoted(self.channel.topic)} are encapsulated as "
            f"0x{identifier:04x}, which is not read; record with plain CDR"
        )
        if len(bad) < len(block):
            return MessageError(self.path, reason, bad.tolist())
        return UnsupportedLogError(self.path, reason)

    def _plan(self, placement: Placement) -> Plan:
        if placement not in self._plans:
            try:
                self._plans[placement] = compile_plan(self._root, tuple(self._ways), placement)
            except NotPlannedError as error:
                raise SchemaError(
                    self.path, f"topic {quoted(self.channel.topic)}: {error}"
                ) from None
        return self._plans[placement]

    def _too_short(self, block: MessageBlock, positions: Intp) -> MessageError:
        first = int(positions[0])
        size = int(block.ends[first] - block.starts[first])
        others = f" and {len(positions) - 1} others" if len(positions) > 1 else ""
        return MessageError(
            self.path,
            f"the message of topic {quoted(self.channel.topic)} recorded at "
            f"{block.log_ns[first]} ns{others} ends, after {size} bytes, before the wanted field "
            f"of {quoted(self.channel.type_name)}; the log is damaged or its definition is not "
            "that of its messages",
            positions.tolist(),
        )
