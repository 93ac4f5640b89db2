"""PX4 ULog files.

A file is a sequence of records: two bytes of length, one byte of kind, the content. They are
located in one walk when the file is opened.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers import ulog_records
from quatprop.containers.topics import TopicLog
from quatprop.containers.ulog_records import HEAD, Records, walk_records
from quatprop.errors import DamagedLogError, MessageError, UnsupportedLogError, os_reason
from quatprop.messages.blocks import Channel, MessageBlock, by_topic
from quatprop.messages.decoders import decoder_of
from quatprop.messages.ulog import definition_text, px4_name
from quatprop.stores.file_source import FileSource, source_of
from quatprop.text import quoted
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from quatprop.arrays import Int64
    from quatprop.tables.model import TimeRange

HEADER_SIZE = 16
"""Bytes of magic, version and start time."""

BLOCK = 65_536
"""Maximum number of messages in a block."""

_FLAGS = struct.Struct("<8s8s3Q")


class UlogLog(TopicLog):
    """A ULog file; see :class:`quatprop.containers.base.MessageLog`.

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
            count = max(1, int(offsets.searchsorted(offsets[0] + ulog_records.WINDOW)))
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
