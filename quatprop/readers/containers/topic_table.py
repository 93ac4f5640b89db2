"""A topic as a table, whose columns are those of the flattened message definition."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.base.errors import MessageError, UsageError
from quatprop.base.progress import with_progress
from quatprop.base.text import Remark, Setting, plain, quoted
from quatprop.base.times import LATEST, NS_PER_S, duration_text
from quatprop.readers.containers.message_frames import FRAMES
from quatprop.readers.containers.message_series import MessageSeries
from quatprop.readers.messages.binary import first_names
from quatprop.readers.messages.blocks import DECODERS, decoder_of, to_ns
from quatprop.readers.messages.columns import take_messages
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.messages.schema import (
    MAX_ELEMENTS,
    Primitive,
    String,
    Struct,
    TextNumber,
    field_at,
    find,
    flattened,
    leaves_of,
    numeric_layout,
    refuse_list,
)
from quatprop.readers.messages.ulog_definitions import is_secondary
from quatprop.readers.tables.model import (
    Column,
    RowBatch,
    Stamp,
    Table,
    TablePart,
    TimeRange,
    merge_by_time,
    without_misfits,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from quatprop.base.arrays import AnyArray, Float64, Int64
    from quatprop.base.provenance import JsonObject
    from quatprop.readers.containers.message_source import MessageSource
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.tables.model import Convert, Group, Within

    Decode = Callable[[Sequence[MessageBlock]], RowBatch]


# Buffer the first blocks of a topic for several readers, and group small blocks.


ROOM = 1 << 23
"""Maximum bytes of buffered messages: some 20,000 of a usual topic."""

ENOUGH_MESSAGES = 1 << 13
"""Number of messages that are decoded together."""

ENOUGH_BYTES = 1 << 22
"""Maximum bytes of blocks that are decoded together: they stay in the processor's cache."""


@dataclass(slots=True)
class _Node:
    """A node of a linked list of blocks; `following` is None until the next block is read."""

    following: tuple[MessageBlock, _Node] | None = None


class FirstBlocks:
    """The blocks of a channel, read once for all iterators that begin while the buffer has room.

    Those that go on in step share the later blocks, too. A later iterator reads the log again.
    """

    def __init__(self, log: MessageSource, channel: Channel) -> None:
        self._log, self._channel = log, channel
        self._first: _Node | None = None
        self._rest: Iterator[MessageBlock] = iter(())
        self._room = self._turn = 0

    def __iter__(self) -> Iterator[MessageBlock]:
        """Iterate over all blocks, from the first on."""
        if self._first is None:
            self._first, self._room = _Node(), ROOM
            self._rest = self._read(self._turn)
        return _blocks_from(self._first, self._rest)

    def _read(self, turn: int) -> Iterator[MessageBlock]:
        try:
            for block in self._log.blocks(self._channel):
                if self._turn != turn:
                    yield block
                    continue
                # Compacting does not pay if the buffer has few other bytes.
                size = int((block.ends - block.starts).sum())
                held = block if 2 * size > len(block.data) else block.compacted()
                self._room -= len(held.data)
                yield held
                if self._room < 0 and self._turn == turn:
                    self.release()
        except Exception:
            # A later iterator would take the blocks before the error for all blocks.
            self.release()
            raise

    def release(self) -> None:
        """Drop the buffer: the next iterator reads the log again."""
        # The iterator refers to this object: the cycle would wait for the garbage collector.
        self._first, self._rest, self._turn = None, iter(()), self._turn + 1


def _blocks_from(node: _Node, rest: Iterator[MessageBlock]) -> Iterator[MessageBlock]:
    """Yield blocks; `itertools.tee` would keep up to 57 that all iterators are past."""
    while True:
        if node.following is None:
            block = next(rest, None)
            if block is None:
                return
            node.following = block, _Node()
        block, node = node.following
        yield block


def decoded_together(blocks: Iterable[MessageBlock]) -> Iterator[list[MessageBlock]]:
    """Yield groups of blocks that are decoded together, since each call takes time.

    The first block is alone, for callers that read only the beginning; each further group has about
    twice as many messages as the one before.
    """
    group: list[MessageBlock] = []
    messages = size = enough = 0
    for block in blocks:
        group.append(block)
        messages += len(block)
        size += len(block.data)
        if messages >= enough or size >= ENOUGH_BYTES:
            yield group
            enough = min(ENOUGH_MESSAGES, 2 * messages)
            group, messages, size = [], 0, 0
    if group:
        yield group


CLOCK_STEP_NS = 100_000_000
"""Larger clock errors, ns, are corrected by a step; time services slew smaller ones."""

TEXT_ENCODINGS = ("cdr", "ros1")
"""Encodings whose transform lists and strings are read; strings of JSON are read, too."""


class TopicTable(Table):
    """A topic as a table.

    `series`: the frames or publishers of the messages to read; empty: all messages are of one
    `series_fields`: paths of the frames in each message; empty without one
    """

    is_typed = True
    series: tuple[str, ...] = ()
    series_fields: tuple[str, ...] = ()

    def __init__(self, log: MessageSource, channel: Channel) -> None:
        self.log = log
        self.channel = channel
        self.blocks = FirstBlocks(log, channel)
        self._fields: dict[str, Group | None] = {}
        self._groups: dict[Group, tuple[list[str], list[int]]] = {}
        self.path = log.path
        self.name = channel.topic
        self.type = channel.type_name
        self.kind = log.kind
        self.log_clocks = ("log", "publish") if log.has_publish_time else ("log",)
        self.is_decodable = channel.encoding in DECODERS
        self.is_secondary = is_secondary(channel)

    def __str__(self) -> str:
        """Return topic, type, and the encoding if it is not supported."""
        encoding = f", encoded as {self.channel.encoding or 'nothing known'}, which is not read"
        return f"{self.name} ({self.type}{'' if self.is_decodable else encoding})"

    def are_decoded_with(self, columns: Group, others: Group) -> bool:
        """Return whether columns can be decoded wherever others can: they are before them."""
        return self.channel.encoding in TEXT_ENCODINGS and max(columns) < min(others)

    def may_contain(self, types: Iterable[str]) -> bool:
        """Return whether the text of the definition has the name of one of some types."""
        return any(name.rpartition("/")[2].encode() in self.channel.schema for name in types)

    @cached_property
    def root(self) -> Struct:
        """The message type; raises SchemaError if the definition cannot be read."""
        return message_type(self.channel, self.path)

    @cached_property
    def columns(self) -> list[Column]:
        """The numbers outside sequences; grows by fields that are named."""
        return [*flattened(self.root).columns]

    @property
    def parts(self) -> tuple[TablePart, ...]:
        """The structs outside sequences."""
        return flattened(self.root).parts

    @cached_property
    def matches(self) -> dict[object, Any]:  # type: ignore[override]
        """A cache of searches in the columns, shared by topics of one definition."""
        return flattened(self.root).matches

    @cached_property
    def _column_numbers(self) -> dict[str, int]:
        return {column.text: k for k, column in enumerate(self.columns)}

    def columns_of(self, name: str) -> Group | None:
        """Return the columns of a field; empty if not a few numbers, None if it is unknown."""
        if name not in self._fields:
            self._fields[name] = self._columns_below(name)
        return self._fields[name]

    def _columns_below(self, name: str) -> Group | None:
        kind = find(self.root, name)
        if kind is None:
            return None
        if self.channel.encoding == "json":
            from quatprop.readers.messages.json import has_order

            if not has_order(kind):
                return ()
        leaves = [*islice(leaves_of(name, kind), MAX_ELEMENTS + 1)]
        if len(leaves) > MAX_ELEMENTS or not all(isinstance(one, Primitive) for _, one in leaves):
            return ()
        return tuple(self._column(own, one) for own, one in leaves if isinstance(one, Primitive))

    def _column(self, name: str, kind: Primitive) -> int:
        if name not in self._column_numbers:
            self._column_numbers[name] = len(self.columns)
            self.columns.append(Column(name, name, code=kind.code))
        return self._column_numbers[name]

    def holds_text(self, group: Group) -> bool:
        """Return whether the numbers of some columns are written as text."""
        return any(isinstance(find(self.root, self.columns[k].text), TextNumber) for k in group)

    def field_of(self, group: Group) -> str:
        """Return the fields of a group as settings name them: a vector by its own name."""
        return ",".join(self.fields_of(group)[0])

    def refuse_unknown(self, name: str) -> None:
        """Raise an error, which lists the fields, if a field does not exist or is a list."""
        field_at(self.root, name, self.path)
        refuse_list(self.root, name, self.path)

    def fields_of(self, group: Group) -> tuple[list[str], list[int]]:
        """Return the fields to decode for a group of columns, and the group's positions in them.

        A vector is one field; positions are empty if the group has its order.
        """
        if group not in self._groups:
            self._groups[group] = self._fields_below(group)
        return self._groups[group]

    def _fields_below(self, group: Group) -> tuple[list[str], list[int]]:
        names = [self.columns[k].text for k in group]
        parent = names[0][: max(names[0].rfind("."), names[0].rfind("["), 0)]
        shape = numeric_layout(find(self.root, parent)) if parent and len(group) > 1 else None
        if shape is None or shape[1] != len(group):
            return names, []
        below = self.columns_of(parent) or ()
        if {*below} != {*group}:
            return names, []
        return [parent], [] if below == group else [below.index(k) for k in group]

    def of_series(self, series: str | None, frame: str | None, field: str) -> TopicTable:
        """Return the table, or that of the messages of chosen frames or publishers."""
        if frame is not None:
            raise UsageError(
                f"{plain(self.path)}: the messages of topic {quoted(self.name)} are no transforms, "
                f"so {quoted(frame)} cannot be chosen; omit {Setting('frame')}"
            )
        if series is None:
            return self
        chosen = copy(self)
        chosen.first = None
        chosen.series = tuple(series.split(","))
        chosen.series_fields = self.frame_fields(field)
        return chosen

    def frame_fields(self, field: str) -> tuple[str, ...]:
        """Return the frames in the innermost struct around a field with any: its own, its body's.

        One of them may be missing.
        """
        levels = field.split(",", maxsplit=1)[0].split(".")[:-1]
        for count in range(len(levels), -1, -1):
            above = "".join(f"{level}." for level in levels[:count])
            found = (
                [above + name for name in names if self._is_text(above + name)] for names in FRAMES
            )
            if own := tuple(names[0] for names in found if names):
                return own
        return ()

    def _is_text(self, name: str) -> bool:
        return isinstance(find(self.root, name), String | TextNumber)

    def texts(self, name: str) -> list[str]:
        """Return the distinct values of a text in the first messages; empty if not readable."""
        block = next(filter(len, self._chosen(self.blocks)), None)
        if block is None or not self._is_text(name):
            return []
        if self.channel.encoding == "json":
            from quatprop.readers.messages.json import first_texts

            return first_texts(block, name)
        is_read = self.channel.encoding in TEXT_ENCODINGS
        return first_names(self.channel, block, self.root, name, self.path) if is_read else []

    def row_count(self) -> int | None:
        """Return the number of messages that the log states."""
        return self.channel.count

    def read(  # noqa: PLR0913, PLR0917  # what is read, and of which rows
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
        watched: str = "",
        beside: Group = (),
    ) -> Iterator[RowBatch]:
        """Yield batches in the order of the log times, if these are recorded."""
        # It refers to the buffered blocks behind the rows that were inspected.
        self.first = None
        decode = self.decoder([stamp], (*groups, beside) if beside else groups)
        if isinstance(within, TimeRange):
            blocks = with_progress(self.log.blocks(self.channel, within), None)
        else:
            blocks = with_progress(iter(self.blocks), self.row_count())
        if watched:
            fields = self.frame_fields(watched)
            blocks = MessageSeries(self, fields, self.series).watched(blocks)
        else:
            blocks = self._chosen(blocks)
        together = decoded_together(blocks)
        batches = (self._decoded(lambda own: convert(decode(own)), own) for own in together)
        return self.in_order(batches)

    def _chosen(self, blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
        """Return the messages of the chosen series."""
        if not self.series:
            return iter(blocks)
        return MessageSeries(self, self.series_fields, self.series).chosen(blocks)

    def in_order(self, batches: Iterable[RowBatch]) -> Iterator[RowBatch]:
        """Return batches in the order of the log times, if these are recorded."""
        return merge_by_time([batches]) if self.log.has_log_time else filter(len, batches)

    def recorded_span(self) -> TimeRange | None:
        """Return the topic's range of log times by the log's index; None without one."""
        return self.log.recorded_span(self.channel)

    def peek(
        self, stamps: Sequence[Stamp], groups: Sequence[Group], *, is_strict: bool = False
    ) -> Iterator[RowBatch]:
        """Yield times and groups of columns of all messages, the first block by itself."""
        decode = self.decoder(stamps, groups)
        for blocks in decoded_together(self._chosen(self.blocks)):
            yield (
                decode(blocks) if is_strict else without_misfits(decode, blocks, _without_positions)
            )

    def release(self) -> None:
        """Drop all buffered rows and blocks."""
        self.first = None
        self.blocks.release()

    def decoder(self, stamps: Sequence[Stamp], groups: Sequence[Group]) -> Decode:
        """Return a function that decodes times and groups of columns from blocks."""
        times = [self.columns[k].text for stamp in stamps for k in stamp.columns]
        wanted = [self.fields_of(group) for group in groups]
        fields = [*times, *(name for names, _ in wanted for name in names)]
        decoder = decoder_of(self.channel, fields, self.path)

        def decode(blocks: Sequence[MessageBlock]) -> RowBatch:
            arrays = iter(decoder.columns(*blocks))
            values: list[AnyArray] = [
                self.ns(stamp, [*islice(arrays, len(stamp.columns))], blocks) for stamp in stamps
            ]
            for group, (names, positions) in zip(groups, wanted, strict=True):
                own = [*islice(arrays, len(names))]
                values.append(own[0] if len(group) == 1 else as_rows(own, positions))
            return RowBatch(log_ns_of(blocks), tuple(values), blocks[-1].watermark_ns)

        return decode

    def ns(self, stamp: Stamp, fields: Sequence[AnyArray], blocks: Sequence[MessageBlock]) -> Int64:
        """Return the time of every message of blocks, shape ``(N,)``, int64 ns."""
        if stamp.clock == "log":
            return log_ns_of(blocks)
        if stamp.clock == "publish":
            publish_ns = np.concatenate([block.publish_ns for block in blocks])
            return np.where(publish_ns < 0, LATEST, publish_ns)
        names = [self.columns[k].text for k in stamp.columns]
        if fields[1:] and len(fields[1]) and fields[1].max() >= NS_PER_S:
            self.remark_on_fraction(names[1], f"{Setting('clock', 'log')}")
        return to_ns(fields, stamp.units, names, self.path)

    def _decoded(self, decode: Decode, blocks: Sequence[MessageBlock]) -> RowBatch:
        """Return the rows of blocks, without messages that cannot be decoded."""
        for log_ns in (block.log_ns for block in blocks if self.log.has_log_time):
            if (log_ns[1:] < log_ns[:-1]).any():
                self._remark_on_step(log_ns)
        return without_misfits(decode, blocks, self._leave_out)

    def _leave_out(self, blocks: Sequence[MessageBlock], error: MessageError) -> list[MessageBlock]:
        """Return blocks without undecodable messages, which are recorded as losses."""
        # Counted by block, so that reading a block again adds nothing.
        for bad in take_messages(blocks, np.array(error.positions)):
            first_ns, reason = int(bad.log_ns[0]), str(error.reason)
            self.log.losses.note(f"topic {self.name}", reason, len(bad), part=first_ns)
        return _without_positions(blocks, error)

    def _remark_on_step(self, log_ns: Int64) -> None:
        """Add a remark if log times step back as far as after the clock was set."""
        if np.diff(log_ns).min() < -CLOCK_STEP_NS:
            self.remark(
                "log-times-back",
                f"the log times of topic {quoted(self.name)} go backwards by more than "
                f"{duration_text(CLOCK_STEP_NS)}: was the recorder's clock set back? "
                "samples are used in the order of their log times",
            )

    def provenance(self) -> JsonObject:
        """Return the provenance of the messages, if this package wrote them."""
        return self.log.provenance(self.name)

    def remark(self, code: str, text: str) -> None:
        """Append a remark on the log."""
        self.log.remarks = [*(one for one in self.log.remarks if one != text), Remark(code, text)]


def _without_positions(blocks: Sequence[MessageBlock], error: MessageError) -> list[MessageBlock]:
    """Return blocks without undecodable messages; at least one block."""
    every = np.arange(sum(map(len, blocks)))
    return take_messages(blocks, np.delete(every, error.positions)) or [blocks[-1].at(every[:0])]


def log_ns_of(blocks: Sequence[MessageBlock]) -> Int64:
    """Return the log time of each message in some blocks, shape ``(N,)``, int64 ns."""
    return np.concatenate([block.log_ns for block in blocks])


def as_rows(fields: list[AnyArray], positions: Sequence[int] = ()) -> Float64:
    """Return one field of rows, or several of numbers, as a new float64 array ``(N, k)``.

    Its columns are contiguous, as computations on rows need them.

    `positions`: numbers of the row to return, in this order; empty for all
    """
    stacked = fields[0] if len(fields) == 1 else np.stack(fields).T
    with np.errstate(invalid="ignore"):  # a damaged log may have float32 NaNs that signal
        if not positions:
            return np.array(stacked, dtype=np.float64, order="F")
        rows = np.empty((len(stacked), len(positions)), np.float64, order="F")
        for column, position in enumerate(positions):
            rows[:, column] = stacked[:, position]
        return rows
