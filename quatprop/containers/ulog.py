"""PX4 ULog files.

A file is a sequence of records: two bytes of length, one byte of kind, the content. They are
located in one walk when the file is opened.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.base import Channel, Losses, MessageBlock, MessageLog, by_topic
from quatprop.containers.file_source import FileSource, source_of
from quatprop.errors import DamagedLogError, MessageError, UnsupportedLogError, os_reason
from quatprop.messages.decoders import decoder_of
from quatprop.messages.ulog import definition_text, px4_name
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.arrays import Int64

HEADER_SIZE = 16
"""Magic, version and start time."""

BLOCK = 65_536
"""Messages in a block."""

_WINDOW = 1 << 22
"""Bytes that are read at a time; a record has less than 65,539."""

SYNC = bytes.fromhex("2f731320250cbb12")
"""Content of synchronisation records, behind which reading resumes after damage."""

_MAGIC = b"ULog\x01\x12\x35"
_HEAD = struct.Struct("<HB")
_FLAGS = struct.Struct("<8s8s3Q")
_FORMAT, _SUBSCRIPTION, _DATA, _DROPOUT = b"FADO"
_KINDS = frozenset(b"BFIMPQARDLCSO")
_IDS = 1 << 16


@dataclass(slots=True)
class _Records:
    """The result of a walk over the records.

    A subscription has the number of its id, or one of its own where the id had another topic
    before; `numbers` has that of each id at the end of the walk.
    """

    losses: Losses
    numbers: list[int] = field(default_factory=lambda: list(range(_IDS)))
    formats: dict[str, str] = field(default_factory=dict)
    subscriptions: dict[int, tuple[str, int]] = field(default_factory=dict)
    offsets: array[int] = field(default_factory=lambda: array("q"))
    sizes: array[int] = field(default_factory=lambda: array("H"))
    ids: array[int] = field(default_factory=lambda: array("i"))
    dropouts: list[tuple[int, int]] = field(default_factory=list)


class UlogLog(MessageLog):
    """A ULog file; see :class:`quatprop.containers.base.MessageLog`.

    Topics are named ``sensor_combined/0``: the message and its instance.

    Parameters
    ----------
    log
        The file.

    Raises
    ------
    UnreadableLogError
        The file may not be read.
    UnsupportedLogError
        It uses a feature that is not supported.
    DamagedLogError
        It ends within its header.
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
        places = (records.offsets, records.sizes, records.ids)
        self._offsets, self._sizes, self._ids = (np.array(place, np.int64) for place in places)
        self._channels = _ids_by_channel(records)

    def _walk(self) -> _Records:
        """Follow the records of the file and of the data appended to it."""
        if self._source.size < HEADER_SIZE:
            raise DamagedLogError(self.path, "it ends within its header; was it copied whole?")
        records = _Records(self.losses)
        ends = [*self._appended(), self._source.size]
        for start, end in zip([HEADER_SIZE, *ends], ends, strict=False):
            _walk(self._source, start, end, records)
        if records.dropouts:
            total_ms = sum(duration for _, duration in records.dropouts)
            place = f"{len(records.dropouts)} dropouts, first at byte {records.dropouts[0][0]}"
            self.losses.note(place, f"the recorder lost all messages for {total_ms} ms in total")
        return records

    def _appended(self) -> list[int]:
        """Return where data was appended, from the flags at the beginning, if there are any."""
        length = _HEAD.size + _FLAGS.size
        begin = self._source.read(HEADER_SIZE, length).ljust(length, b"\0")
        size, kind = _HEAD.unpack_from(begin)
        if kind != ord("B") or size < _FLAGS.size:
            return []
        _, incompatible, *offsets = _FLAGS.unpack_from(begin, _HEAD.size)
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise UnsupportedLogError(
                self.path,
                f"it uses features of ULog that this version does not know (flags "
                f"{incompatible.hex()}); convert it with a newer tool",
            )
        return [offset for offset in sorted(offsets) if HEADER_SIZE < offset < self._source.size]

    def channels(self) -> list[Channel]:
        """Return every topic instance, in order of topic."""
        found = self._channels.items()
        highest = max((max(ids) for _, ids in found), default=0)
        counts = np.bincount(self._ids, minlength=highest + 1)
        return by_topic(replace(one, count=int(counts[ids].sum())) for one, ids in found)

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one topic instance in the order of the file.

        Log and publish times are the messages' own time stamps.
        """
        stamps = decoder_of(channel, ["timestamp"], self.path)
        selected = np.flatnonzero(np.isin(self._ids, self._channels.get(channel, [])))
        for places in self._windows(selected):
            block = self._block(places)
            try:
                (timestamp,) = stamps.columns(block)
            except MessageError as error:
                lost = list(error.positions)
                reason = "it ends before its time stamp; the log is damaged"
                self.losses.note(f"topic {channel.topic}", reason, len(lost), int(places[0]))
                block = block.at(np.delete(np.arange(len(block)), lost))
                (timestamp,) = stamps.columns(block)
            log_ns = timestamp.astype(np.int64) * NS_PER_UNIT["us"]
            yield replace(block, log_ns=log_ns, publish_ns=log_ns)

    def _windows(self, selected: Int64) -> Iterator[Int64]:
        """Split messages into parts of bounded number and extent."""
        while len(selected):
            offsets = self._offsets[selected[:BLOCK]]
            count = max(1, int(offsets.searchsorted(offsets[0] + _WINDOW)))
            yield selected[:count]
            selected = selected[count:]

    def _block(self, places: Int64) -> MessageBlock:
        """Read messages; those beyond a file that has become shorter are noted as lost."""
        offsets, sizes = self._offsets[places], self._sizes[places]
        base = int(offsets[0])
        data, reason = b"", "the file has become shorter"
        try:
            data = self._source.read(base, int(offsets[-1] + sizes[-1]) + _HEAD.size - base)
        except OSError as error:
            reason = os_reason(error)
        begin = offsets - base + _HEAD.size
        ends = begin + sizes
        whole = int(ends.searchsorted(len(data), "right"))
        if whole < len(places):
            self.losses.note(f"byte {base + len(data)}", reason, len(places) - whole)
        # The subscription id before the message is not part of it.
        begin, ends = begin[:whole] + 2, ends[:whole]
        return MessageBlock(np.frombuffer(data, np.uint8), begin, ends, begin, begin)

    def close(self) -> None:
        """Close the file."""
        self._source.close()


def _ids_by_channel(records: _Records) -> dict[Channel, list[int]]:
    """Return the ids of each channel; one that was unsubscribed and subscribed again has two."""
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


def _walk(source: FileSource, position: int, end: int, records: _Records) -> None:
    """Follow records by their lengths; after damage resume at the next that is recognised."""
    while position + _HEAD.size <= end:
        data = source.read(position, min(_WINDOW, end - position))
        if len(data) < _HEAD.size:
            break
        size = _add_records(data, position, records)
        if not size:
            position = _without_swallowed(source, position, records)
            after = _after_damage(source, position, end, records)
            reason = f"its records cannot be followed for {after - position} bytes"
            records.losses.note(f"byte {position}", reason)
            size = after - position
        position += size
    if position < end:
        records.losses.note(f"byte {position}", "the last record is cut off")


def _add_records(data: bytes, base: int, records: _Records) -> int:
    """Add records up to the first that is damaged or not whole; return their bytes."""
    unpack, size_of_head = _HEAD.unpack_from, _HEAD.size
    offset, size_note, id_note = records.offsets.append, records.sizes.append, records.ids.append
    position, last, numbers = 0, len(data) - size_of_head, records.numbers
    while position <= last:
        size, kind = unpack(data, position)
        begin, after = position + size_of_head, position + size_of_head + size
        if after > len(data) or kind not in _KINDS:
            break
        if kind == _DATA:
            if size > 1:
                offset(base + position)
                size_note(size)
                id_note(numbers[data[begin] | data[begin + 1] << 8])
        elif kind == _FORMAT:
            name, _, fields = data[begin:after].decode("utf-8", "replace").partition(":")
            records.formats[name] = fields
        elif kind == _SUBSCRIPTION and size > _HEAD.size:
            instance, id_ = struct.unpack_from("<BH", data, begin)
            topic = data[begin + 3 : after].decode("utf-8", "replace"), instance
            if records.subscriptions.get(numbers[id_], topic) != topic:
                numbers[id_] = _IDS + len(records.subscriptions)
            records.subscriptions[numbers[id_]] = topic
        elif kind == _DROPOUT and size > 1:
            records.dropouts.append((base + position, data[begin] | data[begin + 1] << 8))
        position = after
    return position


def _without_swallowed(source: FileSource, position: int, records: _Records) -> int:
    """Drop the last message if it was cut off where another file begins; return where it began."""
    begin = records.offsets[-1] if records.offsets else position
    if _MAGIC not in source.read(begin, position - begin + len(_MAGIC) - 1):
        return position
    for values in (records.offsets, records.sizes, records.ids):
        values.pop()
    return begin


def _after_damage(source: FileSource, position: int, end: int, records: _Records) -> int:
    """Return where records can be followed again; `end` if nowhere.

    That is behind a synchronisation record, of which many files have none, or at a message of a
    topic that came before the damage, with the same length; but not in another file that follows,
    which has subscriptions of its own.
    """
    sizes = np.full(_IDS + len(records.subscriptions), -1)
    sizes[np.array(records.ids, np.int64)] = records.sizes
    sizes = sizes[records.numbers]
    while position < end:
        data = source.read(position, min(_WINDOW, end - position))
        sync, message = data.find(SYNC), _first_message(data, sizes)
        places = {
            data.find(_MAGIC): end,
            sync: position + sync + len(SYNC),
            message: position + message,
        }
        if found := [place for place in places if place >= 0]:
            return places[min(found)]
        if len(data) < _WINDOW:
            break
        position += len(data) - len(SYNC) + 1  # it may lie across the border
    return end


def _first_message(data: bytes, sizes: Int64) -> int:
    """Return where a message begins, behind the first byte, with the length of its id; or -1."""
    numbers = np.frombuffer(data, np.uint8).astype(np.uint16)
    pairs = numbers[:-1] | numbers[1:] << 8
    kinds = 1 + np.flatnonzero(numbers[3:-2] == _DATA)
    found = kinds[sizes[pairs[kinds + 3]] == pairs[kinds]]
    return int(found[0]) if len(found) else -1
