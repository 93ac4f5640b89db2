"""Choose the timestamp of messages, or the time columns of a file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.base.errors import SchemaError, TimelineError, UndeclaredError, UsageError
from quatprop.base.text import Setting, plain, quoted
from quatprop.readers.clock_difference import against_recorded, stamps_and_log_times, unsteady_text
from quatprop.readers.matching import FIRST_ROWS, first_batch
from quatprop.readers.messages.blocks import NANOSECONDS, SECONDS
from quatprop.readers.tables.model import Stamp
from quatprop.readers.vocabulary import STAMPS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.arrays import AnyArray
    from quatprop.readers.matching import ColumnMatcher, Found
    from quatprop.readers.tables.model import Group, RowBatch, Table
    from quatprop.readers.vocabulary import Row


def stamp_at(table: Table, place: str, unit: str | None = None) -> Stamp | None:
    """Return the timestamp in a field: a time, seconds and nanoseconds, or a number in a unit."""
    columns = table.columns_of(place) or ()
    codes = "".join(table.columns[k].code[0] for k in columns)
    names = [table.columns[k].text.removeprefix(place + ".") for k in columns]
    match [*codes]:
        case ["M"]:
            return Stamp(columns, ("ns",))
        case [_] if unit:
            return Stamp(columns, (unit,))
        case ["i" | "u", "i" | "u"] if names[0] in SECONDS and names[1] in NANOSECONDS:
            return Stamp(columns, ("s", "ns"))
    return None


def place_of(table: Table, stamp: Stamp) -> str:
    """Return the dotted path of a timestamp."""
    name = table.columns[stamp.columns[0]].text
    return name if len(stamp.columns) == 1 else name.rpartition(".")[0]


def stamps_of(found: Found) -> list[Stamp]:
    """Return the timestamps of columns: those of the vocabulary, then the innermost header's."""
    table, row = found.table, found.row
    stamps = [stamp_at(table, found.part.prefix + name, row.time_unit) for name in row.stamps]
    name = table.columns[found.sets[0][0]].text if found.sets[0] else ""
    levels = [name[: dot.end()] for dot in re.finditer(r"\.", name)]
    for prefix in (*reversed(levels), ""):
        around = (stamp_at(table, prefix + place) for place in STAMPS)
        stamps.append(next(filter(None, around), None))
    return [*dict.fromkeys(filter(None, stamps))]


def choose_time(
    matcher: ColumnMatcher, found: Found, marks: Group = (), row: Row | None = None
) -> tuple[Stamp, Table]:
    """Return the timestamp of a quantity, which may be a sample rate, and the table to read.

    `row`: vocabulary of the table; that of `found` differs if the user named other columns
    """
    if not found.table.log_clocks:
        from quatprop.readers.time_columns import time_in_file

        return time_in_file(matcher, found, marks, row or found.row), found.table
    matcher.refuse_undeclared()
    selection = matcher.selection
    frame = getattr(selection, "frame", None)
    table = found.table.of_series(selection.series, frame, found.field)
    return message_stamp(matcher, found._replace(table=table)), table


def message_stamp(matcher: ColumnMatcher, found: Found) -> Stamp:
    """Return the timestamp of messages: as selected, else a header timestamp, else the log time.

    Of several, the first one that was set: that is not zero in all rows.
    """
    table, selection = found.table, matcher.selection
    stamps = stamps_of(found)
    has_stamp = bool(stamps) or selection.time_field is not None
    if selection.clock == "header" and not has_stamp:
        others = Setting("clock", "|".join(table.log_clocks))
        raise UsageError(
            f"{plain(table.path)}: messages of topic {quoted(table.name)} have no header "
            "timestamp; "
            f"choose {others} or name the timestamp with {Setting('time_field')}"
        )
    if selection.clock == "publish" and "publish" not in table.log_clocks:
        raise UsageError(
            f"{plain(table.path)}: a log of kind {table.kind} does not record when messages were "
            f"published; choose {Setting('clock', 'header|log' if has_stamp else 'log')}"
        )
    clock = selection.clock or ("header" if has_stamp else "log")
    if clock != "header":
        return Stamp(clock=clock)
    if selection.time_field is not None:
        stamps = [_named_stamp(table, selection.time_field, selection.time_unit)]
    first = first_batch(table, stamps)
    for stamp in stamps:
        if not are_all((row.values[0] for row in first.read([stamp], ())), 0):
            if stamp is not stamps[0]:
                zero, used = (quoted(place_of(table, one)) for one in (stamps[0], stamp))
                remark = f"the timestamps in {zero} are all zero; those in {used} are used"
                matcher.remark("stamp-unset", remark)
            if selection.clock is None:
                _remark_on_recorded(matcher, first.read([stamp], ()))
            return stamp
    raise TimelineError(
        table.path,
        f"all header timestamps of topic {quoted(table.name)} are zero; for the time of recording "
        f"choose {Setting('clock', 'log')}",
    )


def _remark_on_recorded(matcher: ColumnMatcher, batches: Iterable[RowBatch]) -> None:
    """Remark on header timestamps that contradict log times which are steady."""
    if (found := against_recorded(*stamps_and_log_times(batches, FIRST_ROWS))) is not None:
        stamps = f"the header timestamps of topic {quoted(matcher.table.name)}"
        text = f"{unsteady_text(found, stamps, 'its log times')}, use {Setting('clock', 'log')}"
        if found.are_shared:
            matcher.remark("shared-stamps", text)
        else:
            matcher.remark("unlike-log-times", text)


def _named_stamp(table: Table, place: str, unit: str | None) -> Stamp:
    table.refuse_unknown(place)
    if (stamp := stamp_at(table, place, unit)) is not None:
        return stamp
    if len(table.columns_of(place) or ()) == 1:
        raise UndeclaredError(
            table.path,
            f"the unit of the time in field {quoted(place)}",
            Setting("time_unit", "s|ms|us|ns"),
        )
    raise SchemaError(
        table.path,
        f"field {quoted(place)} of {quoted(table.type)} is not a time; "
        "name a time of seconds and nanoseconds, or a number",
    )


def are_all(batches: Iterable[AnyArray], value: object, limit: int | None = None) -> bool:
    """Return whether there are several rows, and all have one value.

    `batches`: rows, shape ``(N, ...)``; read up to the first other value
    `limit`: maximum number of rows to read; None: all
    """
    count = 0
    for rows in batches:
        if (rows != value).any():
            return False
        count += len(rows)
        if limit is not None and count >= limit:
            break
    return count > 1
