"""PX4 ULog files.

A file is a sequence of records: two bytes of length, one byte of kind, the content. They are
located in one walk when the file is opened.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import re
import struct
from array import array
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import DamagedLogError, MessageError, UnsupportedLogError, os_reason
from quatprop.base.text import quoted
from quatprop.base.times import NS_PER_UNIT
from quatprop.readers.containers.message_log import MessageLog
from quatprop.readers.messages.blocks import Channel, MessageBlock, by_topic, decoder_of
from quatprop.readers.messages.ulog_definitions import definition_text, message_sizes, px4_name
from quatprop.stores.file_source import FileSource, source_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from quatprop.base.arrays import Int64
    from quatprop.base.errors import Losses
    from quatprop.readers.tables.model import TimeRange


# Locate the records of a ULog file in one walk.
#
# There are no checksums: a record must fit its kind, and a message must have the length of its
# format. One record of no known kind, or of no known topic, is passed over if the next one fits.
#
# Reference: PX4 user guide, "ULog File Format".


WINDOW = 1 << 22
"""Bytes that are read at a time; a record has at most 65,538."""

SYNC = bytes.fromhex("2f731320250cbb12")
"""Content of synchronisation records."""

HEAD = struct.Struct("<HB")
_HEAD_AND_ID = struct.Struct("<HBH")
"""A head and the next two bytes, which are the id of a message."""

_MAGIC = b"ULog\x01\x12\x35"
_FORMAT, _SUBSCRIPTION, _DATA, _DROPOUT = b"FADO"
_IDS = 1 << 16
_NEVER, _ANY = -1, -2
"""Message lengths of ids without a subscription, and of formats that do not determine it."""


def _is_text(content: bytes) -> bool:
    try:
        return "\0" not in content.decode().rstrip("\0")
    except UnicodeDecodeError:
        return False


def _has_key(content: bytes) -> bool:
    """Return whether a record begins with the length, type and name of a key."""
    key = content[1 : 1 + content[0]] if content else b""
    return re.fullmatch(rb"[\w/-]+(?:\[\d+\])? [ -~]+", key) is not None


_KINDS: dict[int, Callable[[bytes], object]] = {
    ord("B"): lambda content: len(content) == 40,  # noqa: PLR2004  # flags and three offsets
    ord("I"): _has_key,
    ord("P"): _has_key,
    ord("M"): lambda content: _has_key(content[1:]),
    ord("Q"): lambda content: _has_key(content[1:]),
    ord("F"): lambda content: re.fullmatch(rb"[\w/-]+:[\t -~]*", content),
    ord("A"): lambda content: re.fullmatch(rb"[\w/-]+", content[3:]),
    ord("R"): lambda content: len(content) == 2,  # noqa: PLR2004  # an id
    ord("O"): lambda content: len(content) == 2,  # noqa: PLR2004  # milliseconds
    ord("S"): lambda content: content == SYNC,
    ord("L"): lambda content: content[:1].isdigit() and _is_text(content[9:]),
    ord("C"): lambda content: content[:1].isdigit() and _is_text(content[11:]),
}
"""Tests of the content of each kind of record but messages, which have the length of their format.

Log texts begin with their level, a digit, and their time."""


@dataclass(slots=True)
class Records:
    """The result of a walk over the records.

    A subscription has its id as its number, or a new number if the id had another topic before;
    `numbers` has the current number of each id. Messages of an id have its `bare_sizes` or its
    `padded_sizes`, without or with the padding of their format. `odd_begin`, `odd_end`: the last
    record that was passed over, with the message before it.
    """

    losses: Losses
    numbers: list[int] = field(default_factory=lambda: list(range(_IDS)))
    bare_sizes: list[int] = field(default_factory=lambda: [_NEVER] * _IDS)
    padded_sizes: dict[int, int] = field(default_factory=dict)
    formats: dict[str, str] = field(default_factory=dict)
    redefined: dict[str, int] = field(default_factory=dict)
    subscriptions: dict[int, tuple[str, int]] = field(default_factory=dict)
    offsets: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("H"))
    ids: array[int] = field(default_factory=lambda: array("i"))
    dropouts: list[tuple[int, int]] = field(default_factory=list)
    odd_begin: int = -1
    odd_end: int = -1

    def define(self, content: bytes, place: int) -> None:
        """Add a format; record where a different one of the same name is defined."""
        name, _, fields = content.decode().partition(":")
        if self.formats.setdefault(name, fields) != fields:
            self.redefined.setdefault(name, place)

    def subscribe(self, content: bytes) -> None:
        """Add a subscription."""
        instance, id_ = struct.unpack_from("<BH", content)
        topic = content[3:].decode(), instance
        if self.subscriptions.get(self.numbers[id_], topic) != topic:
            self.numbers[id_] = _IDS + len(self.subscriptions)
        self.subscriptions[self.numbers[id_]] = topic
        bare, padded = message_sizes(topic[0], self.formats) or (_ANY - 2, _ANY - 2)
        self.bare_sizes[id_], self.padded_sizes[id_] = 2 + bare, 2 + padded

    def pass_over(self, kind: int, id_: int, position: int, size: int) -> bool:
        """Return whether a record that does not fit may be passed over; note it if so.

        It may if it is a message of no known topic, or a record of no known kind, and the one
        before fits. A message of another length than its format may have a damaged length.
        """
        is_message = kind == _DATA and size > 1
        known = self.padded_sizes.get(id_, _NEVER) if is_message else _NEVER
        if not size or known >= 0 or self.odd_end == position:
            return False
        if not is_message:
            count = 1 if size in self.bare_sizes else None
            self.losses.note(f"byte {position}", "a record is of no known kind", count)
        if known != _ANY:
            self.odd_begin = self.begin_of_message(position)
            self.odd_end = position + HEAD.size + size
        return True

    def begin_of_message(self, end: int) -> int:
        """Return where the message that ends at a position begins; if none does, the position."""
        is_next = self.sizes and self.offsets[-1] + HEAD.size + self.sizes[-1] == end
        return self.offsets[-1] if is_next else end

    def drop_last_message(self) -> None:
        """Forget the last message."""
        for values in (self.offsets, self.sizes, self.ids):
            values.pop()


def walk_records(source: FileSource, position: int, end: int, records: Records) -> None:
    """Walk records by their lengths, up to a torn end; refuse other damage."""
    while position < end:
        data = source.read(position, min(WINDOW, end - position))
        size = _add_records(data, position, records)
        if not size:
            _note_end(source, position, end, records)
            return
        position += size


def _note_end(source: FileSource, position: int, end: int, records: Records) -> None:
    """Note what follows the last record as lost; refuse the log if more records may follow.

    A message directly before may be cut off as well, and go on in what follows.
    """
    is_odd = records.odd_end == position
    begin = records.odd_begin if is_odd else records.begin_of_message(position)
    before = source.read(begin, position - begin)
    head = source.read(position, len(_MAGIC))
    count, place = end - position, f"byte {position}"
    pieces = (source.read(at, min(WINDOW, end - at)) for at in range(position, end, WINDOW))
    if head == _MAGIC:
        reason = f"{count} bytes follow the log and are not read; was another joined to it?"
    elif (at := (before + head).find(_MAGIC)) >= 0:
        from quatprop.readers.tables.table_log import refuse_second_file  # of files of rows

        refuse_second_file(source.path, begin + at)
    elif len(head) < HEAD.size or (
        head[2] in {_DATA, *_KINDS} and HEAD.size + HEAD.unpack_from(head)[0] > count
    ):
        reason = "the last record is cut off"
    elif not any(map(any, pieces)):
        reason = f"its last {count} bytes are zeros"
        if before.endswith(b"\0") and not is_odd:
            records.drop_last_message()
            place = f"byte {begin}"
    else:
        raise DamagedLogError(
            source.path,
            f"{place}: its records cannot be followed from there; cut it before (head -c {begin}) "
            "to read the first part",
        )
    records.losses.note(place, reason)


def _add_records(data: bytes, base: int, records: Records) -> int:
    """Add records up to the first that does not fit or is incomplete; return their total bytes."""
    unpack, size_of_head, end = _HEAD_AND_ID.unpack_from, HEAD.size, len(data)
    offset, size_note, id_note = records.offsets.append, records.sizes.append, records.ids.append
    bare_sizes, padded_sizes = records.bare_sizes, records.padded_sizes
    numbers = records.numbers
    padded = data + bytes(_HEAD_AND_ID.size)
    position, last = 0, end - size_of_head
    while position <= last:
        size, kind, id_ = unpack(padded, position)
        after = position + size_of_head + size
        if after > end:
            break
        if kind == _DATA and size > 1:
            if (
                size != bare_sizes[id_]
                and size != padded_sizes.get(id_)
                and not records.pass_over(kind, id_, base + position, size)
            ):
                break
            offset(base + position)
            size_note(size)
            id_note(numbers[id_])
        elif kind not in _KINDS or not _KINDS[kind](
            content := data[position + size_of_head : after]
        ):
            if data.startswith(_MAGIC, position) or not records.pass_over(
                kind, id_, base + position, size
            ):
                break
        elif kind == _FORMAT:
            records.define(content, base + position)
        elif kind == _SUBSCRIPTION:
            records.subscribe(content)
        elif kind == _DROPOUT:
            records.dropouts.append((base + position, content[0] | content[1] << 8))
        position = after
    return position


HEADER_SIZE = 16
"""Bytes of magic, version and start time."""

BLOCK = 65_536
"""Maximum number of messages in a block."""

_FLAGS = struct.Struct("<8s8s3Q")


class UlogLog(MessageLog):
    """A ULog file; see :class:`quatprop.readers.containers.message_log.MessageLog`.

    Topics are named ``sensor_combined/0``: the message and its instance.
    """

    kind = "ulog"
    has_log_time = False

    def __init__(self, log: Path | FileSource) -> None:
        self._source = source_of(log)
        super().__init__(self._source.path)
        try:
            records = self._walk()
        except BaseException:
            self._source.close()
            raise
        self._redefined = records.redefined
        places = (records.offsets, records.sizes, records.ids)
        self._offsets, self._sizes, self._ids = (np.array(place, np.int64) for place in places)
        self._channels = _ids_by_channel(records)

    def _walk(self) -> Records:
        """Walk the records of the file and of the data appended to it."""
        if self._source.size < HEADER_SIZE:
            raise DamagedLogError(self.path, "it ends within its header; was it copied whole?")
        records = Records(self.losses)
        ends = [*self._appended(), self._source.size]
        for start, end in zip([HEADER_SIZE, *ends], ends, strict=False):
            walk_records(self._source, start, end, records)
        if records.dropouts:
            total_ms = sum(duration for _, duration in records.dropouts)
            place = f"{len(records.dropouts)} dropouts, first at byte {records.dropouts[0][0]}"
            self.losses.note(place, f"the recorder lost all messages for {total_ms} ms in total")
        self._note_unknown(records)
        return records

    def _note_unknown(self, records: Records) -> None:
        """Record messages whose id has no topic as lost."""
        known = list(records.subscriptions)
        (unknown,) = np.nonzero(~np.isin(np.array(records.ids, np.int64), known))
        if len(unknown):
            place = f"{len(unknown)} messages, first at byte {records.offsets[unknown[0]]}"
            self.losses.note(place, "no topic has their number", len(unknown))

    def _appended(self) -> list[int]:
        """Return the offsets of appended data, from the flags record, if there is one."""
        length = HEAD.size + _FLAGS.size
        begin = self._source.read(HEADER_SIZE, length).ljust(length, b"\0")
        size, kind = HEAD.unpack_from(begin)
        if kind != ord("B") or size < _FLAGS.size:
            return []
        _, incompatible, *offsets = _FLAGS.unpack_from(begin, HEAD.size)
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise UnsupportedLogError(
                self.path,
                f"it uses features of ULog that this version does not know (flags "
                f"{incompatible.hex()}); convert it with a newer tool",
            )
        return [offset for offset in sorted(offsets) if HEADER_SIZE < offset < self._source.size]

    def channels(self) -> list[Channel]:
        """Return all topic instances in order of topic."""
        found = self._channels.items()
        highest = max((max(ids) for _, ids in found), default=0)
        counts = np.bincount(self._ids, minlength=highest + 1)
        return by_topic(replace(one, count=int(counts[ids].sum())) for one, ids in found)

    def blocks(
        self,
        channel: Channel,
        within: TimeRange | None = None,  # noqa: ARG002  # there is no index
    ) -> Iterator[MessageBlock]:
        """Yield the messages of one topic instance in the order of the file.

        Log and publish times are the messages' own timestamps.
        """
        self._refuse_redefined(channel)
        stamps = decoder_of(channel, ["timestamp"], self.path)
        selected = np.flatnonzero(np.isin(self._ids, self._channels.get(channel, [])))
        for places in self._windows(selected):
            block = self._block(places)
            try:
                (timestamp,) = stamps.columns(block)
            except MessageError as error:
                lost, reason = error.positions, "it ends before its timestamp; the log is damaged"
                self.losses.note(f"topic {channel.topic}", reason, len(lost), int(places[0]))
                block = block.without(lost)
                (timestamp,) = stamps.columns(block)
            log_ns = timestamp.astype(np.int64) * NS_PER_UNIT["us"]
            yield replace(block, log_ns=log_ns, publish_ns=log_ns)

    def _refuse_redefined(self, channel: Channel) -> None:
        for line in channel.schema.decode().splitlines():
            name = line.partition(":")[0]
            if name in self._redefined:
                raise UnsupportedLogError(
                    self.path,
                    f"byte {self._redefined[name]}: it redefines format {quoted(name)}, so it is "
                    f"not certain what the messages of topic {quoted(channel.topic)} hold; ULog "
                    "forbids that; cut the file there and read both parts",
                )

    def _windows(self, selected: Int64) -> Iterator[Int64]:
        """Split messages into windows of bounded number and bytes."""
        while len(selected):
            offsets = self._offsets[selected[:BLOCK]]
            count = max(1, int(offsets.searchsorted(offsets[0] + WINDOW)))
            yield selected[:count]
            selected = selected[count:]

    def _block(self, places: Int64) -> MessageBlock:
        """Read messages; those beyond the end of a file that was truncated are lost."""
        offsets, sizes = self._offsets[places], self._sizes[places]
        base = int(offsets[0])
        data, reason = b"", "the file has become shorter"
        try:
            data = self._source.read(base, int(offsets[-1] + sizes[-1]) + HEAD.size - base)
        except OSError as error:
            reason = os_reason(error)
        begin = offsets - base + HEAD.size
        ends = begin + sizes
        whole = int(ends.searchsorted(len(data), "right"))
        if whole < len(places):
            self.losses.note(f"byte {base + len(data)}", reason, len(places) - whole)
        # Skip the subscription id before each message.
        begin, ends = begin[:whole] + 2, ends[:whole]
        return MessageBlock(np.frombuffer(data, np.uint8), begin, ends, begin, begin)

    def close(self) -> None:
        """Close the file."""
        self._source.close()


def _ids_by_channel(records: Records) -> dict[Channel, list[int]]:
    """Return the ids of each channel: two after it was unsubscribed and subscribed again."""
    ids: dict[Channel, list[int]] = {}
    for id_, (name, instance) in sorted(records.subscriptions.items()):
        channel = Channel(
            topic=f"{name}/{instance}",
            type_name=px4_name(name),
            encoding="ulog",
            schema_encoding="ulog",
            schema=definition_text(name, records.formats),
        )
        ids.setdefault(channel, []).append(id_)
    return ids
