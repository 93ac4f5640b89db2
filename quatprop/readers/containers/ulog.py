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
from quatprop.readers.containers.topics import TopicLog
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
# There are no checksums: a record is accepted if its content fits its kind. A message has the
# length of its format and a subscribed id.
#
# Reference: PX4 user guide, "ULog File Format".


WINDOW = 1 << 22
"""Bytes that are read at a time; a record has at most 65,538."""

SYNC = bytes.fromhex("2f731320250cbb12")
"""Content of synchronisation records, behind which the walk resumes after damage."""

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
    `padded_sizes`, without or with the padding of their format, or are among the accepted `odd`.
    """

    losses: Losses
    numbers: list[int] = field(default_factory=lambda: list(range(_IDS)))
    bare_sizes: list[int] = field(default_factory=lambda: [_NEVER] * _IDS)
    padded_sizes: dict[int, int] = field(default_factory=dict)
    sizes_by_id: Int64 = field(default_factory=lambda: np.full(_IDS, _NEVER))
    formats: dict[str, str] = field(default_factory=dict)
    redefined: dict[str, int] = field(default_factory=dict)
    subscriptions: dict[int, tuple[str, int]] = field(default_factory=dict)
    offsets: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("H"))
    ids: array[int] = field(default_factory=lambda: array("i"))
    dropouts: list[tuple[int, int]] = field(default_factory=list)
    odd: set[tuple[int, int]] = field(default_factory=set)

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
        self.bare_sizes[id_] = self.sizes_by_id[id_] = 2 + bare
        self.padded_sizes[id_] = 2 + padded


def walk_records(source: FileSource, position: int, end: int, records: Records) -> None:
    """Walk records by their lengths; after damage resume at the next that is recognised."""
    while position + HEAD.size <= end:
        data = source.read(position, min(WINDOW, end - position))
        if len(data) < HEAD.size:
            break
        size = _add_records(data, position, records)
        if not size:
            position = _without_overrun(source, position, records)
            after = _after_damage(source, position, end, records)
            reason = f"its records cannot be followed for {after - position} bytes"
            if source.read(position, len(_MAGIC)) == _MAGIC:
                follow = "bytes follow the log and are not read; was another joined to it?"
                reason = f"{after - position} {follow}"
            records.losses.note(f"byte {position}", reason)
            size = after - position
        position += size
    if position < end:
        records.losses.note(f"byte {position}", "the last record is cut off")


def _add_records(data: bytes, base: int, records: Records) -> int:
    """Add records up to the first that is damaged or incomplete; return their total bytes."""
    unpack, size_of_head, end = _HEAD_AND_ID.unpack_from, HEAD.size, len(data)
    offset, size_note, id_note = records.offsets.append, records.sizes.append, records.ids.append
    bare_sizes, numbers = records.bare_sizes, records.numbers
    padded = data + bytes(_HEAD_AND_ID.size)
    position, last = 0, end - size_of_head
    while position <= last:
        size, kind, id_ = unpack(padded, position)
        after = position + size_of_head + size
        if after > end:
            break
        if kind == _DATA and size > 1:
            if size != bare_sizes[id_] and not _is_accepted(data, position, records):
                break
            offset(base + position)
            size_note(size)
            id_note(numbers[id_])
        elif kind not in _KINDS or not _KINDS[kind](
            content := data[position + size_of_head : after]
        ):
            if not _is_isolated(data, position, records):
                break
            count = 1 if size in bare_sizes else None
            records.losses.note(f"byte {base + position}", "a record is of no known kind", count)
        elif kind == _FORMAT:
            records.define(content, base + position)
        elif kind == _SUBSCRIPTION:
            records.subscribe(content)
        elif kind == _DROPOUT:
            records.dropouts.append((base + position, content[0] | content[1] << 8))
        position = after
    return position


def _is_accepted(data: bytes, position: int, records: Records) -> bool:
    """Return whether a message of unexpected length or id is accepted."""
    size, _, id_ = struct.unpack_from("<HBH", data, position)
    other = records.padded_sizes.get(id_, _NEVER)
    if other not in {size, _ANY} and (id_, size) not in records.odd:
        if not _is_isolated(data, position, records):
            return False
        records.odd.add((id_, size))
    return True


def _is_isolated(data: bytes, position: int, records: Records) -> bool:
    """Return whether a record follows an odd one and no message is inside it."""
    after = position + HEAD.size + HEAD.unpack_from(data, position)[0]
    inside = _first_message(data[position : after + HEAD.size], records.sizes_by_id)
    return inside < 0 and SYNC not in data[position:after] and _is_record(data, after, records)


def _is_record(data: bytes, position: int, records: Records) -> bool:
    """Return whether a record may begin at `position`; True near the end of the data."""
    if position + HEAD.size + 2 > len(data):
        return True
    size, kind, id_ = struct.unpack_from("<HBH", data, position)
    if kind == _DATA:
        return size in {records.bare_sizes[id_], records.padded_sizes.get(id_)}
    content = data[position + HEAD.size : position + HEAD.size + size]
    return kind in _KINDS and len(content) == size and bool(_KINDS[kind](content))


def _without_overrun(source: FileSource, position: int, records: Records) -> int:
    """Drop the last message if another file begins inside it; return where to continue."""
    begin = records.offsets[-1] if records.offsets else position
    if _MAGIC not in source.read(begin, position - begin + len(_MAGIC) - 1):
        return position
    for values in (records.offsets, records.sizes, records.ids):
        values.pop()
    return begin


def _after_damage(source: FileSource, position: int, end: int, records: Records) -> int:
    """Return where the walk can resume; `end` if nowhere.

    That is behind a synchronisation record, which many files do not have, or at a message that has
    the length of its format; but not in another file that follows, whose subscriptions differ.
    """
    while True:
        data = source.read(position, min(WINDOW, end - position))
        sync, message = data.find(SYNC), _first_message(data, records.sizes_by_id)
        places = {
            data.find(_MAGIC): end,
            sync: position + sync + len(SYNC),
            message: position + message,
        }
        if found := [place for place in places if place >= 0]:
            return places[min(found)]
        if len(data) < WINDOW:
            return end
        position += len(data) - len(SYNC) + 1  # a match may extend over the border


def _first_message(data: bytes, sizes: Int64) -> int:
    """Return the offset of the first message of correct length, behind the first byte; or -1."""
    numbers = np.frombuffer(data, np.uint8).astype(np.uint16)
    pairs = numbers[:-1] | numbers[1:] << 8
    kinds = 1 + np.flatnonzero(numbers[3:-2] == _DATA)
    found = kinds[sizes[pairs[kinds + 3]] == pairs[kinds]]
    return int(found[0]) if len(found) else -1


HEADER_SIZE = 16
"""Bytes of magic, version and start time."""

BLOCK = 65_536
"""Maximum number of messages in a block."""

_FLAGS = struct.Struct("<8s8s3Q")


class UlogLog(TopicLog):
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
