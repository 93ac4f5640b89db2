"""Rates that are marked as absent by a covariance of -1, and those that a user names all the same.

Drivers mark what they do measure, too: every /gps/imu of NovAtel's has finite rates beside a -1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.kept_blocks import blocks_of
from quatprop.containers.merge import Columns
from quatprop.errors import MessageError, TimelineError
from quatprop.messages.decoders import decoder_of
from quatprop.signals.clock import are_all
from quatprop.signals.message_values import ABSENT, as_rows, group_decoder, without_absent
from quatprop.text import Setting, Text, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import AnyArray, Bool, Float64
    from quatprop.containers.base import Channel, Log, MessageBlock, MessageLog
    from quatprop.messages.message_types import RateField
    from quatprop.signals.clock import Clock
    from quatprop.signals.message_values import MessageReader
    from quatprop.tables.base import TableLog
    from quatprop.tables.matching.choose import ColumnMatch


def refuse_marked_messages(log: MessageLog, channel: Channel, field: RateField) -> None:
    """Refuse finite rates that all messages of a channel mark as absent; reads up to another one.

    Raises
    ------
    TimelineError
        They are, and the sentence names the setting that reads them.
    """
    if field.absent is not None and are_all(_marked_finite(log, channel, field), value=True):
        where = f"topic {quoted(channel.topic)}"
        raise _refusal(log, where, Setting("rate_field", field.name))


def _marked_finite(log: MessageLog, channel: Channel, field: RateField) -> Iterator[Bool]:
    decoder = decoder_of(channel, [*field.fields, field.absent or ""], log.path)
    for block in blocks_of(log, channel):
        try:
            *fields, mark = decoder.columns(block)
        except MessageError as error:
            if not error.positions:
                raise
            continue  # messages that do not fit are noted when they are read for good
        yield (mark == ABSENT) & np.isfinite(as_rows(list(fields))).all(axis=1)


def refuse_marked_rows(log: TableLog, columns: ColumnMatch) -> None:
    """Refuse finite rates that all rows of a table mark as absent.

    Raises
    ------
    TimelineError
        They are, and the sentence names the setting that reads them.
    """
    if not columns.timed.numbers[3:]:
        return

    def marked(numbers: AnyArray) -> Bool:
        return np.asarray((numbers[:, 3] == ABSENT) & np.isfinite(numbers[:, :3]).all(axis=1))

    first = [[_number(cell) for cell in row] for row in log.head(columns.timed.numbers)]
    if not first or not marked(np.array(first)).all():
        return
    from quatprop.tables.matching.column_names import as_option

    # Of text on stdin the first rows have to do.
    is_once = str(log.path) == "-"
    if is_once or are_all((marked(n) for _, n in log.rows(columns.timed)), value=True):
        names = log.columns()
        named = ",".join(as_option(names, k) for k in columns.timed.numbers[:3])
        setting = Setting("rate_cols", named)
        raise _refusal(log, f"column {quoted(names[columns.timed.numbers[3]])}", setting)


def _number(cell: object) -> float:
    try:
        return float(f"{cell}".replace(",", "."))
    except ValueError:
        return np.nan


def _refusal(log: Log, where: str, setting: Setting) -> TimelineError:
    return TimelineError(
        log.path,
        f"all rates are marked as absent, by a covariance of -1 in {where}; if they are measured "
        f"all the same, read them with {setting}",
    )


def rates_of_rows(
    log: TableLog, columns: ColumnMatch, numbers: Float64, *, is_named: bool
) -> Float64:
    """Return the rates of rows; NaN where they are marked as absent, unless they are named."""
    rate, marks = numbers[:, :3], numbers[:, 3:].T
    if not is_named:
        return without_absent(rate, marks)
    for k, mark in zip(columns.timed.numbers[3:], marks, strict=True):
        _note_marked(log, rate, mark, f"column {quoted(log.columns()[k])}")
    return rate


def named_reader(
    log: MessageLog, channel: Channel, field: RateField, clock: Clock
) -> MessageReader:
    """Return what reads rates as they are, and remarks on those that are marked as absent."""
    decode = group_decoder(log, channel, clock, field.fields, [field.absent])

    def columns(block: MessageBlock) -> Columns:
        t_ns, (fields, (mark,)) = decode(block)
        rate = as_rows(fields)
        _note_marked(log, rate, mark, f"topic {quoted(channel.topic)}")
        return Columns(block.log_ns, (t_ns, rate), block.not_before_ns)

    return columns


def _note_marked(log: Log, rates: Float64, mark: AnyArray, where: str) -> None:
    """Remark on finite rates that are read although they are marked as absent."""
    is_absent = mark == ABSENT
    if not is_absent.any() or not np.isfinite(rates[is_absent]).all(axis=1).any():
        return
    remark = Text(
        f"rates that a covariance of -1 in {where} marks as absent are read all the same, as asked "
        "for"
    )
    if remark not in log.remarks:
        log.remarks = [*log.remarks, remark]
