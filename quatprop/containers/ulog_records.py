"""Locate the records of a ULog file in one walk.

There are no checksums: a record is accepted if its content fits its kind. A message has the length
of its format and a subscribed id.

References
----------
PX4 user guide, "ULog File Format".
"""

from __future__ import annotations

import re
import struct
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.messages.ulog import message_sizes

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.arrays import Int64
    from quatprop.stores.file_source import FileSource
    from quatprop.tables.log import Losses

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
