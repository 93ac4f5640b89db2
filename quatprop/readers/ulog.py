"""PX4 ULog files: messages of every topic instance, packed one behind the other.

A file is a row of records: two bytes of length, one of kind, the content. Their borders are found
once, in one walk; what the messages mean is read like that of any other container.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import mmap
import re
import struct
from array import array
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import DamagedLogError, MessageError, UnreadableLogError, UnsupportedLogError
from quatprop.messages.decoders import decoder_of
from quatprop.messages.ulog import px4_name
from quatprop.readers.base import Channel, Closing, Loss, MessageBlock
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

HEADER_SIZE = 16
"""Magic, version and start time."""

BLOCK = 65_536
"""Messages in a block."""

SYNC = bytes.fromhex("2f731320250cbb12")
"""Content of records that are there to be found again behind damage."""

_HEAD = struct.Struct("<HB")
_FLAGS = struct.Struct("<8s8s3Q")
_FORMAT, _SUBSCRIPTION, _DATA = b"FAD"
_KINDS = frozenset(b"BFIMPQARDLCSO")
_WORD = re.compile(r"\w+")


@dataclass(slots=True)
class _Records:
    """What a walk over the records found."""

    formats: dict[str, str] = field(default_factory=dict)
    subscriptions: dict[int, tuple[str, int]] = field(default_factory=dict)
    offsets: array[int] = field(default_factory=lambda: array("q"))
    damage: list[Loss] = field(default_factory=list)


class UlogLog(Closing):
    """A ULog file; see :class:`quatprop.readers.base.MessageLog`.

    Topics are named ``sensor_combined/0``: the message and which of its instances.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    UnreadableLogError
        The file may not be read.
    UnsupportedLogError
        It uses a feature that is not known.
    DamagedLogError
        It ends within its header.
    """

    kind = "ulog"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[Loss] = []
        try:
            with path.open("rb") as file:
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except OSError as error:
            raise UnreadableLogError(path, f"{error.strerror}; check the path") from error
        if len(self._map) < HEADER_SIZE:
            raise DamagedLogError(path, "it ends within its header; was it copied whole?")
        records = self._walked()
        self.losses += records.damage
        self._data = np.frombuffer(self._map, np.uint8)
        self._offsets = np.array(records.offsets, np.int64)
        self._ids = _u2(self._data, self._offsets + _HEAD.size)
        self._channels = self._found(records)

    def _walked(self) -> _Records:
        """Follow the records, of the file as it was and of what was appended to it."""
        records = _Records()
        ends = [*self._appended(), len(self._map)]
        for start, end in zip([HEADER_SIZE, *ends], ends, strict=False):
            _walk(self._map, start, end, records)
        return records

    def _appended(self) -> list[int]:
        """Return where data was appended, from the flags, which come first if at all."""
        size, kind = _head(self._map, HEADER_SIZE)
        if kind != ord("B") or size < _FLAGS.size:
            return []
        if HEADER_SIZE + _HEAD.size + size > len(self._map):
            return []
        _, incompatible, *offsets = _FLAGS.unpack_from(self._map, HEADER_SIZE + _HEAD.size)
        if incompatible[0] & ~1 or any(incompatible[1:]):
            raise UnsupportedLogError(
                self.path,
                f"it uses features of ULog that this version does not know (flags "
                f"{incompatible.hex()}); convert it with a newer tool",
            )
        return [offset for offset in sorted(offsets) if HEADER_SIZE < offset < len(self._map)]

    def _found(self, records: _Records) -> dict[Channel, list[int]]:
        """Return the ids of each channel; one that was left and taken up again may have two."""
        ids: dict[Channel, list[int]] = {}
        for id_, (name, instance) in sorted(records.subscriptions.items()):
            channel = Channel(
                topic=f"{name}/{instance}",
                type_name=px4_name(name),
                encoding="ulog",
                schema_encoding="ulog",
                schema=_definition(name, records.formats),
            )
            ids.setdefault(channel, []).append(id_)
        return ids

    def channels(self) -> list[Channel]:
        """Return every topic instance, in order of topic."""
        known, counts = np.unique(self._ids, return_counts=True)
        count_of = dict(zip(known.tolist(), counts.tolist(), strict=True))
        every = [
            replace(channel, count=sum(count_of.get(one, 0) for one in ids))
            for channel, ids in self._channels.items()
        ]
        return sorted(every, key=lambda channel: channel.topic)

    def blocks(self, channel: Channel) -> Iterator[MessageBlock]:
        """Yield the messages of one topic instance in the order of the file.

        Parameters
        ----------
        channel
            One of :meth:`channels`.

        Yields
        ------
        MessageBlock
            Log and publish times are the messages' own time stamps.
        """
        stamps = decoder_of(channel, ["timestamp"], self.path)
        chosen = self._offsets[np.isin(self._ids, self._channels.get(channel, []))]
        for start in range(0, len(chosen), BLOCK):
            offsets = chosen[start : start + BLOCK]
            begin = offsets + _HEAD.size
            sizes = _u2(self._data, offsets)
            # The id of the subscription is no part of the message.
            block = MessageBlock(self._data, begin + 2, begin + sizes, begin, begin)
            try:
                (timestamp,) = stamps.columns(block)
            except MessageError as error:
                self._lose(Loss(f"topic {channel.topic}", error.reason, len(offsets)))
                continue
            log_ns = timestamp.astype(np.int64) * NS_PER_UNIT["us"]
            yield MessageBlock(self._data, block.starts, block.ends, log_ns, log_ns)

    def _lose(self, loss: Loss) -> None:
        """Note a loss once, however often the log is read."""
        if loss not in self.losses:
            self.losses.append(loss)

    def provenance(self, topic: str) -> dict[str, Any]:  # noqa: ARG002  # of the protocol
        """Return nothing: this format has no place for it."""
        return {}

    def close(self) -> None:
        """Let go of the file; it stays mapped until the last block is gone."""
        del self._data


def _head(data: mmap.mmap, position: int) -> tuple[int, int]:
    """Return length and kind of a record; of none where the file ends."""
    if position + _HEAD.size > len(data):
        return 0, 0
    size, kind = _HEAD.unpack_from(data, position)
    return size, kind


def _walk(data: mmap.mmap, position: int, end: int, records: _Records) -> None:
    """Follow records by their lengths; behind damage go on at the next mark, if there is one."""
    note, unpack, size_of_head = records.offsets.append, _HEAD.unpack_from, _HEAD.size
    while position + size_of_head <= end:
        size, kind = unpack(data, position)
        begin, after = position + size_of_head, position + size_of_head + size
        if kind == _DATA and size > 1 and after <= end:
            note(position)
        elif kind not in _KINDS or after > end:
            found = data.find(SYNC, position, end)
            last = end if found < 0 else found + len(SYNC)
            reason = f"its records cannot be followed for {last - position} bytes"
            records.damage.append(Loss(f"byte {position}", reason))
            after = last
        elif kind == _FORMAT:
            name, _, fields = data[begin:after].decode("utf-8", "replace").partition(":")
            records.formats[name] = fields
        elif kind == _SUBSCRIPTION and size > _HEAD.size:
            instance, id_ = struct.unpack_from("<BH", data, begin)
            name = data[begin + 3 : after].decode("utf-8", "replace")
            records.subscriptions[id_] = (name, instance)
        position = after
    if position < end:
        records.damage.append(Loss(f"byte {position}", "the last record is cut off"))


def _definition(name: str, formats: dict[str, str]) -> bytes:
    """Return the definition of a message and of all types inside it, a line each."""
    needed = [name] if name in formats else []
    for one in needed:
        inside = dict.fromkeys(_WORD.findall(formats[one]))
        needed += [other for other in inside if other in formats and other not in needed]
    return "\n".join(f"{one}:{formats[one]}" for one in needed).encode()


def _u2(data: NDArray[np.uint8], positions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return little endian numbers of two bytes."""
    return data[positions] | data[positions + 1].astype(np.int64) << 8
