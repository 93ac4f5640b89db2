"""Series of messages on one topic: by frame and by publisher, chosen and watched to the last."""

from __future__ import annotations

import json
import re
from functools import partial, reduce
from operator import getitem
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from quatprop.base.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.base.guarded_text import ContentError, read_json
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.readers.messages.binary import SkipError, cursors_of, name_at
from quatprop.readers.messages.columns import TooShortError, raw_messages
from quatprop.readers.messages.schema import key_path_of
from quatprop.readers.tables.turns import ALL, LabelWatch, Run, Watched, alternating, bare_frame

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Int64
    from quatprop.readers.containers.message_log import MessageLog
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.messages.schema import Struct


class Topic(Protocol):
    """A topic whose messages are read; see :class:`.TopicTable`."""

    log: MessageLog
    channel: Channel
    path: Path
    name: str

    @property
    def root(self) -> Struct:
        """The message type."""

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the log."""


# Frames of messages. They hardly ever change, so blocks are compared with the bytes of the last
# frame, and read only where they differ.


class _Known(NamedTuple):
    """A frame as it is stored; `offset`: of its bytes in each message."""

    offset: int
    stored: bytes
    number: int


class MessageFrames:
    """Reads the frames in the headers of all messages of a topic.

    `names`: all frames so far, in order of appearance
    """

    def __init__(self, topic: Topic, field: str) -> None:
        self.names: list[str] = []
        self._topic, self._field = topic, field
        self._is_json = topic.channel.encoding == "json"
        self._known: _Known | None = None
        self._is_readable = True

    def numbers(self, block: MessageBlock) -> Int64:
        """Return the index of each frame in `names`, or of the only one; -1: not readable."""
        if self._known is not None and self._is_same(block, self._known):
            return np.array([self._known.number])
        if not self._is_readable:
            return np.array([-1])
        numbers = np.full(len(block), -1)
        for rows, frame in self._json(block) if self._is_json else self._binary(block):
            name = bare_frame(frame)
            if name not in self.names:
                self.names.append(name)
            numbers[rows] = self.names.index(name)
        return numbers

    def _is_same(self, block: MessageBlock, known: _Known) -> bool:
        """Return whether all messages have the frame."""
        offset, stored, _ = known
        if self._is_json:
            return all(raw.count(stored) == 1 for raw in raw_messages(block))
        size, count = len(stored), len(block)
        shortest = (block.ends - block.starts)[: 1 if block.stride else None].min()
        if shortest < offset + size:
            return False
        kind = np.dtype((np.void, size))
        if block.stride:
            at = int(block.starts[0]) + offset
            window = np.ndarray((count,), kind, block.data, at, (block.stride,))
        else:
            every = np.ndarray((len(block.data) - size + 1,), kind, block.data, 0, (1,))
            window = every[block.starts + offset]
        return window.tobytes() == stored * count

    def _binary(self, block: MessageBlock) -> Iterator[tuple[Int64, str]]:
        """Yield the frames of a block, each with its messages; damaged messages have none."""
        topic, kept = self._topic, np.arange(len(block))
        while True:
            part = block.at(kept)
            try:
                cursors = cursors_of(topic.channel, part, topic.path)
                found = [(c.messages, name_at(c, topic.root, self._field)) for c in cursors]
                break
            except TooShortError as error:
                kept = np.delete(kept, error.positions)
            except (SkipError, UnsupportedLogError):
                self._is_readable = False
                return
        for messages, names in found:
            waiting = np.arange(len(messages))
            while len(waiting):
                row = int(waiting[0])
                frame, begin = names.text(part, row), int(names.begin[row])
                same = names.are(frame, part, waiting)
                yield kept[messages[waiting[same]]], frame
                waiting = waiting[~same]
                # With the length before it.
                stored = part.data[begin - 4 : begin + int(names.length[row])].tobytes()
                offset = begin - 4 - int(part.starts[messages[row]])
                self._known = _Known(offset, stored, self.names.index(bare_frame(frame)))

    def _json(self, block: MessageBlock) -> Iterator[tuple[Int64, str]]:
        *_, key = path = key_path_of(self._field) or ()
        for row, raw in enumerate(raw_messages(block)):
            try:
                frame = reduce(getitem, path, read_json(raw))
            except (LookupError, TypeError, ContentError):
                continue
            if not isinstance(frame, str):
                continue
            yield np.array([row]), frame
            name = rf'"{re.escape(str(key))}"\s*:\s*'.encode()
            found = re.findall(name + re.escape(json.dumps(frame)).encode(), raw)
            if len(found) == len(re.findall(name, raw)) == 1:
                self._known = _Known(0, found[0], self.names.index(bare_frame(frame)))


class MessageSeries:
    """One reading of the messages of a topic: those of the chosen series.

    If watched, series that take turns among them are refused, and a change is remarked on.

    `field`: path of the frame in each message; ``""`` without one
    `wanted`: chosen frames and publishers; :data:`.ALL` for those of all
    """

    def __init__(self, topic: Topic, field: str, wanted: Sequence[str]) -> None:
        self._topic, self._wanted = topic, tuple(wanted)
        self._publishers: Mapping[int, str] = topic.log.publishers(topic.channel)
        self._frames = MessageFrames(topic, field) if field else None
        self._first_ns: dict[str, int] = {}
        self._kept = self._others = 0
        given = {bare_frame(label) for label in wanted if label != ALL}
        own = {id_: bare_frame(name) for id_, name in self._publishers.items()}
        self._of_publishers = [id_ for id_, name in own.items() if name in given]
        self._of_frames = given - {*own.values()}

    def chosen(self, blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
        """Yield the messages of the chosen series."""
        return (block for block, *_ in self._parts(blocks))

    def watched(self, blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
        """Yield the messages of the chosen series, and watch those."""
        frames, publishers = (
            LabelWatch(Watched(0, alternating, partial(self._refuse, what)))
            for what in ("in the frames", "as publishers")
        )
        for block, numbers, ids in self._parts(blocks):
            if self._frames is not None:
                frames.see(self._runs(block, numbers, self._frames.names))
            if ids is not None:
                publishers.see(self._runs(block, ids, self._publishers))
            self._kept += len(block)
            yield block
        for watch in (frames, publishers):
            watch.judge()
        self._say_what_changed()
        self._say_what_was_left_out()

    def _parts(
        self, blocks: Iterable[MessageBlock]
    ) -> Iterator[tuple[MessageBlock, Int64, Int64 | None]]:
        """Yield the chosen messages of blocks, with the numbers of frames and publishers."""
        for every in blocks:
            block, numbers = every, np.array([-1])
            if self._of_publishers and block.publishers is not None:
                block = block.at(np.isin(block.publishers, self._of_publishers))
            if self._frames is not None and len(block):
                numbers = self._frames.numbers(block)
                if self._of_frames:
                    names = self._frames.names
                    own = [k for k, name in enumerate(names) if name in self._of_frames]
                    is_wanted = np.isin(numbers, own)
                    if not is_wanted.all():
                        block = block.at(np.broadcast_to(is_wanted, len(block)))
                        numbers = numbers[is_wanted]
            self._others += len(every) - len(block)
            if len(block):
                ids = None if len(self._publishers) < 2 else block.publishers  # noqa: PLR2004
                yield block, numbers, ids

    def _runs(
        self, block: MessageBlock, numbers: Int64, names: Sequence[str] | Mapping[int, str]
    ) -> Iterator[Run]:
        """Yield the runs of labels in a block, and note when each label begins."""
        begins = [0, *(np.flatnonzero(np.diff(numbers)) + 1).tolist()]
        for begin, end in zip(begins, [*begins[1:], len(block)], strict=True):
            if (number := int(numbers[begin])) >= 0:
                name = names[number]
                self._first_ns.setdefault(name, int(block.log_ns[begin]))
                yield Run(name, end - begin, self._kept + begin)

    def _refuse(self, what: str, labels: tuple[str, ...], _row: int) -> None:
        """Refuse series that take turns, unless all are wanted."""
        topic, begin_ns = self._topic, max(self._first_ns[label] for label in labels)
        turning = f"{listed(labels)} that take turns {what} of topic {quoted(topic.name)}"
        if ALL in self._wanted:
            text = f"the messages of {turning} from {begin_ns} ns on are read as those of one "
            topic.remark("series-merged", f"{text}series, as requested")
            return
        before = "".join(f"{plain(label)}," for label in self._wanted)
        plainly = [label for label in labels if re.fullmatch(r"[\w.+/-]+", label)]
        choices = "|".join(before + label for label in plainly) or "VALUE"
        raise UndeclaredError(
            topic.path,
            f"which series to read, of {turning} from {begin_ns} ns on,",
            (f"{Setting('series', choices)}, or if all messages are of one sensor, with "
                f"{Setting('series', ALL)}"),
        )  # fmt: skip

    def _say_what_changed(self) -> None:
        """Remark on a frame that changes; its axes may differ."""
        names = self._frames.names if self._frames is not None else []
        names = [name for name in names if name in self._first_ns]
        if len(names) > 1 and ALL not in self._wanted:
            first, *later = names
            then = " and ".join(f"{quoted(each)} at {self._first_ns[each]} ns" for each in later)
            self._topic.remark(
                "several-frames",
                f"the frame of topic {quoted(self._topic.name)} changes from {quoted(first)} to "
                f"{then}: if their axes differ, the rates are mixed; read the messages of one with "
                f"{Setting('series', first or later[0])}",
            )

    def _say_what_was_left_out(self) -> None:
        topic, wanted = self._topic, [label for label in self._wanted if label != ALL]
        if wanted and not self._kept:
            names = [*self._publishers.values(), *(self._frames.names if self._frames else ())]
            raise UsageError(
                f"{plain(topic.path)}: no message of topic {quoted(topic.name)} is of the series "
                f"{listed(wanted)}; there are {listed(dict.fromkeys(names))}"
            )
        if self._others:
            topic.remark(
                "other-series",
                f"{self._others} messages of other series than {listed(wanted)} were not read",
            )
