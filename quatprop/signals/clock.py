"""The time base of a channel's values: the header stamp, the log time or the publish time."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.containers.base import LATEST, Channel, MessageBlock, MessageLog
from quatprop.containers.kept_blocks import blocks_of
from quatprop.errors import MessageError, TimelineError, UndeclaredError, UsageError
from quatprop.messages.decoders import decoder_of
from quatprop.messages.stamps import Stamp, time_field_at
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray, Int64
    from quatprop.selection import SignalSelection


class Clock(NamedTuple):
    """Time base of a channel's values.

    Parameters
    ----------
    name
        ``"header"``, ``"log"`` or ``"publish"``.
    stamp
        The field of the message, for a header clock.
    remarks
        What is unusual about it.
    """

    name: str
    stamp: Stamp | None = None
    remarks: tuple[str, ...] = ()

    @property
    def fields(self) -> tuple[str, ...]:
        """The fields of the stamp; none for the other clocks."""
        return self.stamp.fields if self.stamp else ()

    def ns(self, fields: Sequence[AnyArray], block: MessageBlock, path: Path | str) -> Int64:
        """Return the time of every message of a block, shape ``(N,)``, int64 ns.

        Parameters
        ----------
        fields
            The fields of the stamp, as decoded; empty for the other clocks.
        block
            The messages.
        path
            The log, for errors.
        """
        if self.stamp is not None:
            return self.stamp.ns(fields, path)
        if self.name == "log":
            return block.log_ns
        return np.where(block.publish_ns < 0, LATEST, block.publish_ns)


def choose_clock(
    log: MessageLog,
    channel: Channel,
    stamps: Sequence[Stamp],
    selection: SignalSelection,
    *,
    has_stamp: bool = False,
) -> Clock:
    """Return the time base to read: as selected, else the header stamp, else the log time.

    Parameters
    ----------
    log, channel
        Where the messages are.
    stamps
        The stamps that belong to the values, the nearest first. One that is zero in all messages
        was never set: then the next is used.
    selection
        Its `clock`, `time_field` and `time_unit` count.
    has_stamp
        Whether the values have stamps of their own, such as those in a list of transforms.

    Raises
    ------
    UsageError
        A header stamp or a publish time is asked for and there is none.
    UndeclaredError
        The unit of a time field is not declared.
    TimelineError
        All header stamps are zero.
    """
    has_stamp = has_stamp or bool(stamps) or selection.time_field is not None
    if selection.clock == "header" and not has_stamp:
        others = Setting("clock", "log|publish" if log.has_publish_time else "log")
        raise UsageError(
            f"{quoted(log.path)}: messages of topic {quoted(channel.topic)} have no header stamp; "
            f"choose {others} or name the stamp with {Setting('time_field')}"
        )
    if selection.clock == "publish" and not log.has_publish_time:
        raise UsageError(
            f"{quoted(log.path)}: a log of kind {log.kind} does not record when messages were "
            f"published; choose {Setting('clock', 'header|log' if has_stamp else 'log')}"
        )
    name = selection.clock or ("header" if has_stamp else "log")
    if name != "header":
        return Clock(name)
    if selection.time_field is not None:
        stamp = time_field_at(channel, selection.time_field, selection.time_unit, log.path)
        if stamp is None:
            raise UndeclaredError(
                log.path,
                f"the unit of the time in field {quoted(selection.time_field)}",
                Setting("time_unit", "s|ms|us|ns"),
            )
        stamps = (stamp,)
    for stamp in stamps:
        if not are_all(_stamps_alone(log, channel, stamp), 0):
            remark = (
                f"the stamps in {quoted(stamps[0].place)} are all zero; those in "
                f"{quoted(stamp.place)} are used"
            )
            return Clock(name, stamp, () if stamp is stamps[0] else (remark,))
    if stamps:
        raise zero_stamps(log, channel)
    return Clock(name)


def zero_stamps(log: MessageLog, channel: Channel) -> TimelineError:
    """Return the error for messages whose stamps were never set."""
    return TimelineError(
        log.path,
        f"all header stamps of topic {quoted(channel.topic)} are zero; for the time of recording "
        f"choose {Setting('clock', 'log')}",
    )


def are_all(batches: Iterable[AnyArray], value: object, limit: int | None = None) -> bool:
    """Tell whether several rows all have one value; reads up to the first other one.

    Parameters
    ----------
    batches
        Rows, shape ``(N, ...)``.
    value
        What each is compared with.
    limit
        So many rows are enough; None is all.
    """
    count = 0
    for rows in batches:
        if (rows != value).any():
            return False
        count += len(rows)
        if limit is not None and count >= limit:
            break
    return count > 1


def _stamps_alone(log: MessageLog, channel: Channel, stamp: Stamp) -> Iterator[Int64]:
    """Yield the stamps of one channel in no order, without noting what cannot be read."""
    decoder = decoder_of(channel, stamp.fields, log.path)
    for block in blocks_of(log, channel):
        try:
            yield stamp.ns(decoder.columns(block), log.path)
        except MessageError as error:
            if not error.positions:
                raise
            # Messages that do not fit are noted when they are read for good.
            yield np.ones(1, np.int64)
