"""Channels and blocks of encoded messages, as containers yield them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from quatprop.base.errors import MessageError, UnsupportedLogError
from quatprop.base.text import Setting, listed, quoted
from quatprop.base.times import NS_PER_UNIT
from quatprop.readers.tables.model import NO_BOUND
from quatprop.stores.file_source import ranges_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.base.arrays import AnyArray, Int64


_GAP = 256
"""Gaps up to this many bytes are copied with the messages: record heads, small other messages."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic with one message type; it may have several connections or files.

    `type_name`: message type as the log spells it, ROS names normalised to ``package/msg/Name``
    `encoding`: message encoding: ``"cdr"``, ``"ros1"``, ``"ulog"``, ``"json"``, ``"protobuf"``
    `schema_encoding`: language of the definition: ``"ros1msg"``, ``"ros2msg"``, ``"ros2idl"``,
        ``"jsonschema"``, ``"protobuf"``, or ``""`` if the log has none
    `schema`: the definition as the log has it; empty if it has none. ROS definitions that differ
        only in comments and white space are equal: recorders copy them from their own files
    `count`: number of messages, if known without reading them; not compared
    `sample`: a message, for encodings whose messages name their fields; empty if none was read; not
        compared
    """

    topic: str
    type_name: str
    encoding: str
    schema_encoding: str = ""
    schema: bytes = field(default=b"", compare=False)
    count: int | None = field(default=None, compare=False)
    sample: bytes = field(default=b"", compare=False)
    _definition: bytes = field(init=False, repr=False, default=b"")

    def __post_init__(self) -> None:
        """Store the definition in the form that is compared."""
        is_lines = self.schema_encoding in {"ros1msg", "ros2msg"}
        definition = _without_comments(self.schema) if is_lines else self.schema
        object.__setattr__(self, "_definition", definition)


@lru_cache(maxsize=256)
def _without_comments(definition: bytes) -> bytes:
    """Return the lines of a definition without comments and superfluous white space."""
    lines = (line.partition(b"#")[0].split() for line in definition.splitlines())
    return b"\n".join(b" ".join(line) for line in lines if line)


def by_topic(channels: Iterable[Channel]) -> list[Channel]:
    """Return channels sorted by topic, then by type."""
    return sorted(channels, key=lambda channel: (channel.topic, channel.type_name))


@dataclass(frozen=True, slots=True, eq=False)
class MessageBlock:
    """Messages of one channel in one buffer, usually a chunk.

    Message ``k`` is ``data[starts[k]:ends[k]]``.

    `data`: the buffer, shape ``(B,)``, uint8
    `starts`, `ends`: offsets of the first byte and behind the last byte, shape ``(N,)``, int64
    `log_ns`, `publish_ns`: log and publish times, shape ``(N,)``, int64 ns. Containers without
        publish times repeat the log times. Publish times are negative after the year 2262; they may
        be a view of `data`
    `watermark_ns`: no later block of this iteration holds a message with an earlier log time
    `publishers`: number of each message's publisher, shape ``(N,)``; None: there is only one
    `stride`: distance between messages of one length, bytes, if it is known to be constant; else 0
    """

    data: NDArray[np.uint8]
    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    publish_ns: NDArray[np.int64]
    watermark_ns: int = NO_BOUND
    stride: int = 0
    publishers: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.starts)

    def at(self, chosen: NDArray[np.generic]) -> MessageBlock:
        """Return the messages at some positions, or those of a mask."""
        starts, ends = self.starts[chosen], self.ends[chosen]
        log_ns, publish_ns = self.log_ns[chosen], self.publish_ns[chosen]
        publishers = None if self.publishers is None else self.publishers[chosen]
        return MessageBlock(
            self.data, starts, ends, log_ns, publish_ns, self.watermark_ns, publishers=publishers
        )

    def without(self, positions: Sequence[int]) -> MessageBlock:
        """Return the messages except those at some positions."""
        return self.at(np.delete(np.arange(len(self)), positions))

    def compacted(self) -> MessageBlock:
        """Return a copy without the bytes between the messages."""
        if not len(self):
            return self
        ranges = ranges_of(self.starts, self.ends, _GAP)
        return replace(
            self,
            data=ranges.of(self.data),
            starts=self.starts - ranges.moved,
            ends=self.ends - ranges.moved,
            publish_ns=self.publish_ns.copy(),
            stride=0,
        )


# Message encodings and their decoders.


DECODERS: Final[dict[str, str]] = {
    "cdr": "quatprop.readers.messages.binary:BinaryDecoder",
    "ros1": "quatprop.readers.messages.binary:BinaryDecoder",
    "ulog": "quatprop.readers.messages.binary:BinaryDecoder",
    "json": "quatprop.readers.messages.json:JsonDecoder",
    "protobuf": "quatprop.readers.messages.protobuf:ProtobufDecoder",
}
"""``"module:Class"`` of the decoder by message encoding; imported when a channel is decoded."""


class FieldDecoder(Protocol):
    """Decodes the same fields of every message of a channel."""

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks.

        `Returns`: one array per path: shape ``(N,)`` for a number, ``(N, k)`` for a row of `k`
        """


def decoder_of(channel: Channel, field_paths: Sequence[str], path: Path | str) -> FieldDecoder:
    """Return a decoder of some fields of a channel."""
    if channel.encoding not in DECODERS:
        raise UnsupportedLogError(
            path,
            f"topic {quoted(channel.topic)} is encoded as {quoted(channel.encoding)}; "
            f"this version reads {listed(DECODERS)}",
        )
    module, _, name = DECODERS[channel.encoding].partition(":")
    decoder: FieldDecoder = getattr(import_module(module), name)(channel, field_paths, path)
    return decoder


# Times in messages: field names, and conversion to exact int64 nanoseconds.


SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
"""Names of the two fields of a time, in ROS 1, ROS 2 and related systems."""


def to_ns(
    columns: Sequence[AnyArray], units: Sequence[str], names: Sequence[str], path: Path | str
) -> Int64:
    """Return times in ns, shape ``(N,)``, from one column, or from seconds and nanoseconds.

    `columns`: shape ``(N,)`` each: integers, float64, or objects that are integers and decimals.
        The nanoseconds may be more than a second
    `units`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"`` of each; ``"ns"`` of the second
    """
    first, scale = columns[0], NS_PER_UNIT[units[0]]
    limit = np.iinfo(np.int64).max // scale
    bad: list[int] = []
    if first.dtype == np.object_:
        bad = [row for row, value in enumerate(first) if not -limit < value < limit]
    elif first.dtype.kind == "f" or first.dtype.itemsize == np.dtype(np.int64).itemsize:
        # In this form the condition refuses NaN, too.
        bad = np.flatnonzero(~((first > -limit) & (first < limit))).tolist()
    if bad:
        raise MessageError(
            path,
            (
                f"the time {first[bad[0]]} {units[0]} in {listed(names)} does not fit in 64 bits "
                f"of nanoseconds; choose {Setting('clock', 'log')} or another "
                f"{Setting('time_field')}"
            ),
            bad,
        )
    t_ns = _scaled(first, scale)
    for nanoseconds in columns[1:]:
        np.add(t_ns, nanoseconds, out=t_ns, dtype=np.int64, casting="unsafe")
    return t_ns


def _scaled(column: AnyArray, scale: int) -> Int64:
    t_ns: Int64
    if column.dtype == np.object_:
        whole = [int((Decimal(value) * scale).to_integral_value()) for value in column]
        t_ns = np.array(whole, np.int64)
    elif column.dtype.kind == "f":
        seconds = np.floor(column).astype(np.int64)
        t_ns = seconds * scale
        t_ns += np.rint((column - seconds) * scale).astype(np.int64)
    else:
        t_ns = np.multiply(column, scale, dtype=np.int64, casting="unsafe")
    return t_ns
