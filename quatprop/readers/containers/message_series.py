"""Series of messages on one topic: by frame and by publisher, chosen and watched to the last."""

from __future__ import annotations

import re
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import UndeclaredError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.readers.containers.message_frames import PAIR_SEPARATOR, MessageFrames
from quatprop.readers.tables.model import SeriesRead
from quatprop.readers.tables.turns import ALL, LabelWatch, Run, Watched, alternating, bare_frame

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.base.arrays import Int64
    from quatprop.readers.containers.message_frames import Topic
    from quatprop.readers.messages.blocks import MessageBlock


class MessageSeries:
    """One reading of the messages of a topic: those of the chosen series.

    If watched, series that take turns among them are refused, and a change is remarked on.

    `fields`: paths of the frames in each message; empty without one
    `wanted`: chosen frames and publishers; :data:`.ALL` for those of all
    """

    def __init__(self, topic: Topic, fields: Sequence[str], wanted: Sequence[str]) -> None:
        self._topic, self._wanted = topic, tuple(label.strip() for label in wanted)
        self._publishers: Mapping[int, str] = topic.log.publishers(topic.channel)
        self._frames = MessageFrames(topic, fields) if fields else None
        self._first_ns: dict[str, int] = {}
        self._kept = self._others = 0
        own = {id_: bare_frame(name) for id_, name in self._publishers.items()}
        given = {bare_frame(label) for label in self._wanted}
        self._of_publishers = [id_ for id_, name in own.items() if name in given]
        others = [one for one in wanted if bare_frame(one.strip()) not in {ALL, *own.values()}]
        # The name of a frame may contain commas.
        joined = (",".join(others[k:end]) for k, end in combinations(range(len(others) + 1), 2))
        self._of_frames = {bare_frame(label.strip()) for label in joined}

    def chosen(self, blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
        """Yield the messages of the chosen series."""
        return (block for block, *_ in self._parts(blocks))

    def watched(self, blocks: Iterable[MessageBlock]) -> Iterator[MessageBlock]:
        """Yield the messages of the chosen series, and watch those."""
        of_frames, of_publishers = (
            LabelWatch(Watched(0, alternating, partial(self._refuse, what)))
            for what in ("in the frames", "as publishers")
        )
        for block, numbers, ids in self._parts(blocks):
            if self._frames is not None:
                of_frames.see(self._runs(block, numbers, self._frames.names))
            if ids is not None:
                of_publishers.see(self._runs(block, ids, self._publishers))
            self._kept += len(block)
            yield block
        for watch in (of_frames, of_publishers):
            watch.judge()
        every = self._frames.names if self._frames is not None else []
        frames = [name for name in every if name in self._first_ns]
        read = SeriesRead(self._kept, frames, [*self._publishers.values(), *every])
        log, name = self._topic.log, self._topic.name
        log.series_read = {**log.series_read, (name, self._wanted): read}
        self._say_what_changed(frames)
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
                    own = [k for k, name in enumerate(names) if self._is_wanted(name)]
                    is_wanted = np.isin(numbers, own)
                    if not is_wanted.all():
                        block = block.at(np.broadcast_to(is_wanted, len(block)))
                        numbers = numbers[is_wanted]
            self._others += len(every) - len(block)
            if len(block):
                ids = None if len(self._publishers) < 2 else block.publishers  # noqa: PLR2004
                yield block, numbers, ids

    def _is_wanted(self, name: str) -> bool:
        """Return whether a frame is chosen, or the one of a body or the one that it moves in."""
        return not self._of_frames.isdisjoint((name, *name.split(PAIR_SEPARATOR)))

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
        plainly = [label for label in labels if re.fullmatch(r"[\w.+/:-]+", label)]
        choices = "|".join(before + label for label in plainly) or "VALUE"
        raise UndeclaredError(
            topic.path,
            f"which series to read, of {turning} from {begin_ns} ns on,",
            (f"{Setting('series', choices)}, or if all messages are of one sensor, with "
                f"{Setting('series', ALL)}"),
        )  # fmt: skip

    def _say_what_changed(self, names: Sequence[str]) -> None:
        """Remark on a frame that changes; its axes may differ."""
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
        if wanted and not self._kept and (known := self._known_in_all()) is not None:
            raise UsageError(
                f"{plain(topic.path)}: no message of topic {quoted(topic.name)} is of the series "
                f"{listed(wanted)}; there are {listed(known)}"
            )
        if self._others:
            topic.remark(
                "other-series",
                f"{self._others} messages of other series than {listed(wanted)} were not read",
            )

    def _known_in_all(self) -> list[str] | None:
        """Return the series in all files of the log; None if chosen ones are or may be there."""
        log, key = self._topic.log, (self._topic.name, self._wanted)
        parts = [part for part in log.joined or (log,) if part.tables(self._topic.name)]
        read = [part.series_read[key] for part in parts if key in part.series_read]
        if len(read) < len(parts) or any(one.messages for one in read):
            return None
        return [*dict.fromkeys(name for one in read for name in one.known)]
