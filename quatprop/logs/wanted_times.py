"""Times at which attitudes are requested: the timestamps of a file or of a topic of the log."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    UndeclaredError,
    UsageError,
)
from quatprop.logs.attitude_input import errors_of
from quatprop.logs.clocks.stamps import choose_time
from quatprop.logs.matching.find import Found
from quatprop.logs.matching.matcher import ColumnMatcher
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.rates import choose_rates
from quatprop.logs.vocabulary.sources import GENERIC
from quatprop.settings.selection import AttitudeSelection, RateSelection, SignalSelection
from quatprop.stores.log_names import split_topic
from quatprop.stores.objects import is_address
from quatprop.tables.column_names import TIME_UNITS, parse_name
from quatprop.tables.timestamps import from_text
from quatprop.text import Setting, plain, quoted
from quatprop.times import absolute_ns

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Int64
    from quatprop.tables.log import Log
    from quatprop.tables.model import Table

NARROW = 2
"""Maximum number of columns of a text table that only lists times."""


def stamps_in(
    source: str, log: Log | None = None, selection: SignalSelection | None = None
) -> Int64:
    """Return the sorted timestamps of a file or of a topic, ``(N,)``, int64 ns.

    `log`: an open log that can be read again; None for rates in memory
    `selection`: how its rates were selected
    """
    path, topic = split_topic(source)
    is_file = Path(path).exists() or is_address(path)
    tables = log.tables(source) if log is not None and not is_file else ()
    if not is_file and not tables:
        raise UsageError(
            f"{Setting('at')} {plain(source)}: no such file is there"
            + (", and the log has no such topic" if log is not None else "")
        )
    with errors_of("at"):
        if is_file:
            stamps = [*_of_file(path, topic)]
        else:
            clock = None if selection is None else selection.clock
            stamps = [*_of_table(tables[0], SignalSelection(clock=clock))]
    return np.sort(np.concatenate([np.zeros(0, np.int64), *stamps]))


def _of_file(path: str, topic: str | None) -> Iterator[Int64]:
    if topic is None and (t_ns := _narrow_table(path)) is not None:
        yield t_ns
        return
    with open_log(path) as opened:
        try:
            attitudes = choose_attitudes(opened, AttitudeSelection(topic=topic))
            yield from [t_ns for t_ns, _ in attitudes.rows()]
        except (NoAttitudesError, NoSuchTopicError, UndeclaredError) as error:
            try:
                rates = choose_rates(opened, RateSelection(topic=topic))
                yield from [batch.t_ns for batch in rates.batches()]
            except (NoRatesError, NoSuchTopicError, UndeclaredError):
                tables = opened.tables(topic)
                if isinstance(error, UndeclaredError) or len(tables) != 1:
                    raise error from None
                try:
                    yield from _of_table(tables[0], SignalSelection())
                except (LogError, UsageError):
                    # Without timestamps, the first error is more helpful.
                    raise error from None


def _of_table(table: Table, selection: SignalSelection) -> Iterator[Int64]:
    """Yield the timestamps of a table, whatever its other columns."""
    found = Found(table, GENERIC, table.parts[0], ((),))
    stamp, table = choose_time(ColumnMatcher(found, selection, "at"), found)
    for rows in table.read(stamp, (), lambda rows: rows):
        yield rows.values[0]


def _narrow_table(path: str) -> Int64 | None:
    """Return the timestamps in the first column of a narrow text table; None if it is not one."""
    if Path(path).suffix.lower() not in {".csv", ".txt"} or not Path(path).is_file():
        return None
    with Path(path).open(encoding="utf-8-sig", errors="replace") as file:
        lines = ((number, line.strip()) for number, line in enumerate(file, 1))
        rows = [(number, line.split(",")) for number, line in lines if line]
    if not rows or len(rows[0][1]) > NARROW:
        return None
    first = rows[0][1][0].strip()
    has_header = not any(character.isdecimal() for character in first)
    header = parse_name(first)
    unit = header.unit if has_header else ""
    if has_header and not (unit in TIME_UNITS or re.fullmatch("t|.*(time|stamp).*", header.key)):
        return None
    stamps = [_stamp(path, number, cells[0].strip(), unit) for number, cells in rows[has_header:]]
    return np.array(stamps, np.int64)


def _stamp(path: str, number: int, cell: str, unit: str) -> int:
    """Return a timestamp, ns; without a unit, the cell is a date or whole ns."""
    try:
        if unit:
            return from_text(cell, unit)
        if (t_ns := absolute_ns(cell)) is not None:
            return t_ns
    except (ValueError, UsageError):
        pass
    raise LogError(
        path,
        f"line {number}: {quoted(cell)} is not a timestamp; write RFC 3339 or whole ns, or name "
        "the "
        "column with its unit, as t_s",
    )
