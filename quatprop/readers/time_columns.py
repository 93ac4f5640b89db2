"""The time of rows in a file: a clock, a counter of samples, or a sample rate."""

from __future__ import annotations

import math
import re
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.readers import clocks
from quatprop.readers.clocks import (
    ambiguous_time,
    are_two_clocks,
    best_clock,
    clock_at,
    clocks_of,
    fraction_unit,
    refuse_unknown_beside_arrival,
    utc_offset_ns,
    with_fraction,
)
from quatprop.readers.numbered_series import numbered_series
from quatprop.readers.odd_clocks import (
    ABSENT,
    are_intervals,
    counts_rows,
    gps_time,
    intervals,
    may_be_time,
    named_as_units,
    refuse_sparse_times,
    remark_on_sum,
    rising_numbers,
    ticks_at,
    unit_of_time,
)
from quatprop.readers.tables.model import Stamp
from quatprop.readers.tables.table_log import OTHER_DATES, counting, numbers_of
from quatprop.readers.tables.time_units import is_time_unit
from quatprop.readers.tables.turns import ALL, Watched, alternating
from quatprop.readers.vocabulary import SENSOR

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from fractions import Fraction

    from quatprop.readers.matching import ColumnMatcher, Found
    from quatprop.readers.tables.model import Group
    from quatprop.readers.tables.table_log import Counting
    from quatprop.readers.vocabulary import Row

    Series = tuple[tuple[int, str], ...]


# Interleaved series in the rows of one table: several sensors, or several kinds of records.
#
# A column of labels shows them: a few values that alternate. Text in any column can be a label;
# whole numbers only in a column without a name, or with the name of a label.


_MOST_LABELS = 16
_LONGEST_LABEL = 60
_LONGEST_TURN = 32
"""Maximum mean run length of a text label: a state, such as walking, lasts longer."""
_LONGEST_UNNAMED_TURN = 4
_FEWEST_RUNS = 8
"""Fewest runs of labels that begin late, in a column whose name does not tell what they are."""
_SMALL = 16
"""Whole numbers below may be labels; 25 and 26 may be temperatures."""

_NUMBERED = r".*(?:id|no|num|number|index|serial|mac|address|port|instance)"
_INTEGER = re.compile(r"[+-]?\d+")
_NUMBER = re.compile(r"(?i)[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:e[+-]?\d+)?|[+-]?inf(?:inity)?")


class Labels(NamedTuple):
    """The cells of a column in the first rows.

    `cells`: text of each row
    `kinds`: distinct labels, sorted; empty if they are not labels
    """

    cells: tuple[str, ...]
    kinds: tuple[str, ...]


def labels_of(cells: Sequence[object]) -> Labels:
    """Return the labels of a column; no kinds if there are too many, or decimal numbers."""
    texts = tuple(f"{cell}".strip() for cell in cells)
    kinds = sorted({*texts})
    present = [kind for kind in kinds if kind.lower() not in ABSENT]
    are_labels = len(present) <= _MOST_LABELS and all(
        len(kind) <= _LONGEST_LABEL and (_INTEGER.fullmatch(kind) or not _NUMBER.fullmatch(kind))
        for kind in present
    )
    return Labels(texts, tuple(present) if are_labels else ())


def take_turns(key: str, cells: Sequence[str]) -> tuple[str, ...]:
    """Return the labels of a column that alternate; empty if all rows are of one series."""
    return turns_in(key, [(label, len([*rows])) for label, rows in groupby(cells)])


def turns_in(key: str, runs: Sequence[tuple[str, int]]) -> tuple[str, ...]:
    """Return the labels of a column that alternate, by the number of rows of each run."""
    present = [run for run in runs if run[0].lower() not in ABSENT]
    turns = alternating(present)
    if not turns:
        return ()
    mean = sum(rows for _, rows in runs) / len(present)
    is_named = re.fullmatch(SENSOR, key) is not None
    if not all(map(_INTEGER.fullmatch, turns)):
        return turns if is_named or mean <= _LONGEST_TURN else ()
    is_small = all(0 <= int(label) < _SMALL for label in turns)
    if not (is_small or (is_named and re.fullmatch(_NUMBERED, key))):
        return ()
    return turns if is_named or (key.isdecimal() and mean <= _LONGEST_UNNAMED_TURN) else ()


def _turn_late(key: str, runs: Sequence[tuple[str, int]]) -> tuple[str, ...]:
    """Return the labels that alternate behind the first rows, where a state may flicker once."""
    is_named = re.fullmatch(SENSOR, key) is not None
    are_labels = labels_of([label for label, _ in runs]).kinds
    return turns_in(key, runs) if are_labels and (is_named or len(runs) >= _FEWEST_RUNS) else ()


def _may_be_numbered(key: str) -> bool:
    """Return whether whole numbers in a column may be labels, by its name or without one."""
    return key.isdecimal() or re.fullmatch(SENSOR, key) is not None


class SeriesChoice:
    """Chooses one of the series of a table.

    `table`: the columns and the settings
    `numbers`: columns of numbers to read
    `other`: further columns without labels
    """

    def __init__(
        self, table: ColumnMatcher, numbers: Collection[int], other: Collection[int]
    ) -> None:
        self._table = table
        self._numbers = tuple(numbers)
        self._wanted: str | None = table.selection.series
        self._time = tuple(other)
        labelled = {
            k: is_number
            for k, is_number in table.table.label_columns().items()
            if k not in {*numbers, *other}
        }
        # Without the setting, whole numbers in other columns are not labels.
        self._candidates = [
            k
            for k, is_number in labelled.items()
            if self._wanted or not is_number or _may_be_numbered(table.columns[k].key)
        ]
        self._others = [k for k, is_number in labelled.items() if is_number]
        self._labels: dict[int, Labels] = {}
        self._merged: Collection[int] = ()

    def chosen(self) -> Series:
        """Return the columns and labels that select the rows to read; empty: all rows."""
        if not self._candidates and self._wanted is None:
            self._check_others()
            return ()
        self._labels = self._read_labels(self._candidates)
        if self._wanted is None:
            turning = self._turning(())
            if turning:
                raise self._undeclared(turning)
            self._check_others()
            return ()
        if self._wanted == ALL and not self._columns_with(ALL):
            self._note_all(self._turning(()))
            return ()
        series = self._resolved(self._wanted)
        if turning := self._turning(series):
            raise self._undeclared(turning)
        return series

    def _check_others(self) -> None:
        """Refuse or name whole numbers of an unknown name that tell sensors apart."""
        found = numbered_series(self._table, self._others, self._numbers, self._time)
        if found is None:
            return
        k, labels, is_certain = found
        if is_certain:
            raise self._undeclared({k: labels}, is_named=True)
        choice = Setting("series", f"{self._table.as_option(k)}={labels[0]}")
        self._table.remark(
            "numbers-alternate",
            f"the numbers {listed(labels)} in column {self._table.names((k,))} alternate; if they "
            f"are sensors, choose one, such as {choice}",
        )

    def watched(self, series: Series) -> tuple[Watched, ...]:
        """Return the columns whose labels must not take turns in the rows of a series."""
        chosen = {k for k, _ in series}
        return tuple(
            Watched(k, partial(_turn_late, self._table.columns[k].key), partial(self._late, k))
            for k in self._candidates
            if k not in chosen and k not in self._merged and self._may_hold_labels(k)
        )

    def _may_hold_labels(self, k: int) -> bool:
        """Return whether the first cells of a column are labels, or all missing."""
        cells, kinds = self._labels[k]
        key = self._table.columns[k].key
        if kinds and all(map(_INTEGER.fullmatch, kinds)) and not _may_be_numbered(key):
            return False
        return bool(kinds or (cells and all(cell.lower() in ABSENT for cell in cells)))

    def _late(self, k: int, labels: tuple[str, ...], row: int) -> None:
        """Refuse series that take turns from a row on, unless all are wanted."""
        if self._wanted != ALL:
            raise self._undeclared({k: labels}, row)
        self._table.table.remark("series-merged", self._merging(k, labels, row))

    def _read_labels(self, columns: Sequence[int]) -> dict[int, Labels]:
        """Return the labels of columns in the first rows with all numbers to read."""
        rows = self._table.table.head((*columns, *self._numbers))
        count = len(columns)
        whole = [
            row
            for row in rows
            if not any(f"{cell}".strip().lower() in ABSENT for cell in row[count:])
        ]
        return {k: labels_of([row[place] for row in whole]) for place, k in enumerate(columns)}

    def _turning(self, series: Series) -> Mapping[int, tuple[str, ...]]:
        """Return the columns whose labels alternate in the rows of a series."""
        kept = [
            all(label == wanted for label, (_, wanted) in zip(row, series, strict=True))
            for row in zip(*(self._labels[k].cells for k, _ in series), strict=True)
        ]
        chosen = {k for k, _ in series}
        found = {}
        for k, labels in self._labels.items():
            if k in chosen or not labels.kinds[1:]:
                continue
            cells = labels.cells
            if series:
                cells = tuple(cell for cell, is_kept in zip(cells, kept, strict=True) if is_kept)
            if turns := take_turns(self._table.columns[k].key, cells):
                found[k] = turns
        return found

    def _columns_with(self, label: str) -> list[tuple[int, str]]:
        """Return the columns with a label, and its spelling."""
        return [
            (k, kind)
            for k, labels in self._labels.items()
            for kind in labels.kinds
            if kind == label or (kind.lower() == label.lower() and label not in labels.kinds)
        ]

    def _resolved(self, wanted: str) -> Series:
        if found := self._only_column(wanted):
            return (found,)
        series = []
        for part in wanted.split(","):
            name, equals, label = (text.strip() for text in part.rpartition("="))
            if not equals:
                found = self._only_column(part.strip())
                if found is None:
                    raise self._not_there(part.strip())
                series.append(found)
                continue
            k = self._table.position(name, "series")
            if k not in self._labels:
                self._labels |= self._read_labels([*self._labels, k])
            same = (kind for kind in self._labels[k].kinds if kind.lower() == label.lower())
            is_spelled = label in self._labels[k].kinds
            series.append((k, label if is_spelled else next(same, label)))
        return tuple(series)

    def _only_column(self, label: str) -> tuple[int, str] | None:
        found = self._columns_with(label)
        if len(found) < 2:  # noqa: PLR2004  # ambiguous from here on
            return found[0] if found else None
        turning = [one for one in found if one[0] in self._turning(())]
        if len(turning) == 1:
            return turning[0]
        names = self._table.names([k for k, _ in found])
        raise UsageError(
            f"{plain(self._table.path)}: {Setting('series', plain(label))} is in several columns, "
            f"{names}; name one with {Setting('series', f'COLUMN={plain(label)}')}"
        )

    def _not_there(self, label: str) -> UsageError:
        there = [
            f"{listed(kinds)} in column {self._table.names((k,))}"
            for k, kinds in self._turning(()).items()
        ]
        known = f"there are {' and '.join(there)}" if there else "no labels take turns in it"
        return UsageError(
            f"{plain(self._table.path)}: no column has the series {quoted(label)} in the first "
            f"rows; {known}; to read one that begins later, name its column with "
            f"{Setting('series', f'COLUMN={plain(label)}')}"
        )

    def _undeclared(
        self, turning: Mapping[int, tuple[str, ...]], row: int = 0, *, is_named: bool = False
    ) -> Exception:
        """Return the error for series that take turns, from a row on or in the first rows.

        `is_named`: whether the way out names the column, too
        """
        k, labels = next(iter(turning.items()))
        name = self._table.names((k,)) + (f" from row {row} on" if row else "")
        if self._table.setting == "bias":
            return UnsupportedLogError(
                self._table.path,
                f"the rows of several series, {listed(labels)} in column {name}, take turns; write "
                "each to its own file",
            )
        wanted = self._wanted or ""
        before = "" if wanted in {"", ALL} else f"{plain(wanted)},"
        are_plain = all(re.fullmatch(r"[\w.+-]+", label) for label in labels)
        if row or is_named:  # the labels are not in the first rows
            before += f"{self._table.as_option(k)}="
        choices = "|".join(f"{before}{label}" for label in labels) if are_plain else "VALUE"
        return UndeclaredError(
            self._table.path,
            f"which series to read, of {listed(labels)} that take turns in column {name},",
            (f"{Setting('series', choices)}, or if all rows are of one sensor, with "
                f"{Setting('series', ALL)}"),
        )  # fmt: skip

    def _note_all(self, turning: Mapping[int, tuple[str, ...]]) -> None:
        self._merged = turning.keys()
        for k, labels in turning.items():
            self._table.remark("series-merged", self._merging(k, labels))

    def _merging(self, k: int, labels: Sequence[str], row: int = 0) -> str:
        """Return the remark on series that are read as one."""
        from_row = f" from row {row} on" if row else ""
        return (
            f"the rows of {listed(labels)} in column {self._table.names((k,))} take turns{from_row}"
            ", and are read as those of one series, as requested"
        )


_INSTANT = r"(?i)(?!.*(?:period|delta|diff|step|interval|duration|exposure|latency|delay|dt)).*"
"""Names of columns with a unit of time that may be the time, not a duration."""

_NO_COLUMN = "none"


def time_in_file(matcher: ColumnMatcher, found: Found, marks: Group, row: Row) -> Stamp:
    """Return the timestamp of a quantity in a file; see `choose_time` in `stamps`."""
    numbers = (*found.sets[0], *marks)
    stamp = _source(matcher, row, numbers)
    time, steady = stamp.columns, stamp.sample_rate
    choice = SeriesChoice(matcher, numbers, time)
    series = choice.chosen()
    if both := set(numbers) & set(time):
        raise UsageError(
            f"{plain(matcher.path)}: {matcher.names(both)} cannot be both the time and one of "
            f"{Setting(matcher.setting)}; name other columns, or the time with "
            f"{Setting('time_col')}",
        )
    if _holds_text(matcher, time):
        raise _unreadable_dates(matcher, time)
    if time and steady is None:
        refuse_sparse_times(matcher, time, numbers)
    if time and steady is None and _needs_rate(matcher, time[0]):
        raise UndeclaredError(
            matcher.path,
            f"the rate of the counter {matcher.names(time)}",
            Setting("sample_rate", "HZ"),
        )
    units = ("ns",) * len(time)
    if time[1:]:
        units = stamp.units if stamp.units[1:] else ("s", fraction_unit(matcher, time[1]))
    elif time and steady is None:
        units = (unit_of_time(matcher, stamp),)
    if stamp.is_summed:
        remark_on_sum(matcher, time)
    matcher.refuse_undeclared()
    rate = "" if steady is None else f"{float(steady):g} Hz"
    clock = " at ".join(filter(None, (matcher.spelled(time), rate)))
    offset_ns = sum(utc_offset_ns(matcher, k) for k in time)
    watched = choice.watched(series)
    return Stamp(time, units, clock, steady, offset_ns, series, watched, stamp.is_summed)


def _holds_text(matcher: ColumnMatcher, time: Group) -> bool:
    """Return whether a time is unreadable text, such as dates with names of months."""
    if any(matcher.notes.units.get(k) == OTHER_DATES for k in time):
        return True
    if not time or matcher.declared(time[:1]) or matcher.selection.time_unit is not None:
        return False
    cells = [row[0] for row in matcher.first_rows(time[:1])]
    return bool(cells) and bool(np.isnan(numbers_of(cells)).all())


def _needs_rate(matcher: ColumnMatcher, k: int) -> bool:
    """Return whether a column counts samples, so a sample rate is needed."""
    is_counter = re.fullmatch(clocks.COUNTER, matcher.columns[k].key) is not None
    return is_counter and not (matcher.selection.time_unit or matcher.declared((k,)))


def _unreadable_dates(matcher: ColumnMatcher, time: Group) -> UnsupportedLogError:
    """Return the error for a time that is text, perhaps in two columns."""
    dates = sorted(k for k, unit in matcher.notes.units.items() if unit == OTHER_DATES)
    are = dates if matcher.selection.time_col is None and {*time} <= {*dates} else time
    return UnsupportedLogError(
        matcher.path,
        f"{matcher.names(are)} {'hold' if are[1:] else 'holds'} {OTHER_DATES}; write them as "
        f"2023-11-14T22:13:20.5{' in one column' if are[1:] else ''}, name another column "
        f"with {Setting('time_col', 'C')}, or count rows at a steady rate with "
        f"{Setting('sample_rate', 'HZ')}",
    )


def _source(matcher: ColumnMatcher, row: Row, numbers: Group) -> Stamp:
    """Return the time columns with their implied units, or a counter or sample rate."""
    name, sample_rate = matcher.selection.time_col, matcher.selection.sample_rate
    if sample_rate is not None:
        if not (math.isfinite(sample_rate) and sample_rate > 0):
            raise UsageError(f"{Setting('sample_rate')} {sample_rate} is not a rate above 0 Hz")
        return _counted(matcher, name, sample_rate, numbers, row)
    if name is not None:
        return _named_time(matcher, name, row)
    return _recognised(matcher, row, numbers)


def _recognised(matcher: ColumnMatcher, row: Row, numbers: Group) -> Stamp:
    """Return the time columns that are recognised by name, unit or content."""
    found = clocks_of(matcher, row, numbers)
    by_unit = [k for k in matcher.matching(_INSTANT) if is_time_unit(matcher.columns[k].unit)]
    by_unit = [k for k in by_unit if may_be_time(matcher, k)]
    if not any(clock.is_readable for clock in found):
        if by_gps := gps_time(matcher):
            return Stamp(*by_gps)
        units = dict.fromkeys(by_unit, "") or named_as_units(matcher, numbers)
        if len(units) == 1:
            return Stamp(tuple(units), tuple(units.values()))
    steady = matcher.notes.sample_rate
    counter = _counter(matcher, numbers) if steady is not None else ()
    others = sorted({*by_unit} - {k for clock in found for k in clock.columns})
    unnamed = [clock_at(matcher, k, clocks.EPOCH, "", 0) for k in others]
    best = found and best_clock(matcher, found, unnamed, has_rate=steady is not None)
    if best:
        refuse_unknown_beside_arrival(matcher, best, found)
        if steady is not None and best.units == ("",) and counts_rows(matcher, best.columns[0]):
            return _counted_by_clock(matcher, best.columns, steady)
        # A numeric clock takes precedence over a declared rate.
        if best.rank < clocks.TEXT or not (counter or (steady and not best.is_readable)):
            return Stamp(best.columns, best.units[:1])
    if steady is not None:
        return _at_rate(matcher, numbers, counter, steady)
    if summed := intervals(matcher, numbers):
        return Stamp(summed, is_summed=True)
    likely = (rf".*[._](?:{clocks.TIME})", r".*(?:time|stamp|sec|clock|date).*", ".*")
    no_time = {*numbers, *matcher.matching(clocks.COUNTER)}
    candidates = ([k for k in matcher.matching(name) if k not in no_time] for name in likely)
    raise ambiguous_time(matcher, by_unit or next(filter(None, candidates), []))


def _counted_by_clock(matcher: ColumnMatcher, time: Group, rate: float) -> Stamp:
    """Return the time by whole numbers in a column named as a clock, at a stated rate."""
    matcher.remark(
        "counter-at-rate",
        f"the whole numbers in {matcher.names(time)} count samples, at the {rate:g} Hz that the "
        "file states",
    )
    return Stamp(time, sample_rate=rate)


# What the user names.


def _named_time(matcher: ColumnMatcher, name: str, row: Row) -> Stamp:
    """Return the time column that the user named, with the fraction of its seconds."""
    parts = name.split(",")
    if len(parts) == 2 and not matcher.has(name):  # noqa: PLR2004
        time: Group = tuple(matcher.position(part, "time_col") for part in parts)
    else:
        first = matcher.position(name, "time_col")
        time = with_fraction(matcher, first)
        if time[1:] and are_two_clocks(matcher, *time):
            time = (first,)
    k = time[0]
    if not time[1:] and are_intervals(matcher, k):
        return Stamp(time, ("",), is_summed=True)
    by_gps = gps_time(matcher) if time[1:] else None
    if by_gps is not None and by_gps[0] == time:
        return Stamp(*by_gps)
    if any(k in matcher.matching(pattern) for pattern in row.stamps):
        return Stamp(time, (row.time_unit,))
    column = clocks.original(matcher, k)
    _, implied, _ = clocks.named_clock(column.key, ()) or (0, "", 0)
    return Stamp(time, (implied or column.unit,))


# Counted samples.


def _counted(
    matcher: ColumnMatcher, name: str | None, rate: Fraction | float, numbers: Group, row: Row
) -> Stamp:
    """Return the time by a counter, named or the only one, or by counting rows."""
    given = Setting("sample_rate", f"{float(rate):g}")
    if name is None:
        counter = _counter(matcher, numbers)
        if counter:
            matcher.remark(
                "counter-used",
                f"{given} is the rate of the counter {matcher.names(counter)}, which also counts "
                f"lost samples; to count rows, give {Setting('time_col', _NO_COLUMN)} too"
            )  # fmt: skip
        stamp = _at_rate(matcher, numbers, counter, rate)
        _remark_on_unused(matcher, stamp, numbers, row)
        return stamp
    if name == _NO_COLUMN and not matcher.has(name):
        return Stamp(sample_rate=rate)
    k = matcher.position(name, "time_col")
    if re.fullmatch(f"{clocks.COUNTER}|{clocks.INDEX}", matcher.columns[k].key):
        return Stamp((k,), sample_rate=rate)
    by_ticks = ticks_at(matcher, k, rate)
    if by_ticks is None:
        raise UsageError(
            f"{plain(matcher.path)}: {matcher.names((k,))} does not count samples or ticks, so "
            f"that {Setting('time_col')} and {Setting('sample_rate')} contradict each other; give "
            "one"
        )
    return by_ticks


def _remark_on_unused(matcher: ColumnMatcher, stamp: Stamp, numbers: Group, row: Row) -> None:
    """Name the timestamps beside rows or samples that are counted."""
    given = Setting("sample_rate", f"{float(stamp.sample_rate or 0):g}")
    what = "the samples" if stamp.columns else "the rows"
    if unused := clocks_of(matcher, row, ()):
        names = matcher.names(min(unused, key=lambda clock: clock.priority).columns)
        said = f"the timestamps in {names} are not used"
    elif ticking := rising_numbers(matcher, (*numbers, *stamp.columns)):
        said = f"the numbers in {matcher.names(ticking[:1])} are not used"
        if not matcher.declared(ticking[:1]):
            as_ticks = Setting("time_col", matcher.as_option(ticking[0]))
            said += f"; if they are ticks at this rate, give {as_ticks} too"
    else:
        return
    matcher.remark("stamps-unused", f"{given} counts {what}; {said}")


def _counter(matcher: ColumnMatcher, numbers: Group) -> Group:
    """Return the first column that counts samples, or nothing."""
    counters = _countings(matcher, clocks.COUNTER, numbers)
    return tuple(k for k, counting in counters.items() if counting.is_by_one)[:1]


def _countings(matcher: ColumnMatcher, pattern: str, numbers: Group) -> dict[int, Counting]:
    """Return the columns of some names that count, and how."""
    columns = [k for k in matcher.matching(pattern) if k not in numbers]
    cells = zip(*matcher.first_rows(columns), strict=True) if columns else ()
    found = zip(columns, map(counting, map(numbers_of, cells)), strict=False)
    return {k: how for k, how in found if how is not None}


def _at_rate(
    matcher: ColumnMatcher, numbers: Group, counter: Group, rate: Fraction | float
) -> Stamp:
    """Return the time of samples at a rate, and remark on unused counters."""
    stamp = Stamp(counter, sample_rate=rate)
    if counter:
        return stamp
    given = Setting("sample_rate", f"{float(rate):g}")
    for k, how in _countings(matcher, clocks.COUNTER, numbers).items():
        use = Setting("time_col", matcher.as_option(k))
        counts = f"the counter {matcher.names((k,))}, which usually steps by {how.step},"
        if how.has_gaps:
            raise UndeclaredError(
                matcher.path,
                f"whether {counts} counts samples",
                (f"{use} and {given} if it does, or {Setting('time_col', _NO_COLUMN)} and "
                     f"{given} to count rows"),
            )  # fmt: skip
        matcher.remark("counter-unused", f"{counts} is not used; to use it, give {use} and {given}")
        return stamp
    for k, how in _countings(matcher, clocks.INDEX, numbers).items():
        if how.has_gaps:
            use = Setting("time_col", matcher.as_option(k))
            matcher.remark(
                "index-gaps",
                f"{matcher.names((k,))} passes over numbers, as if samples were lost, but rows "
                f"are counted; to count by it, give {use} and {given}"
            )  # fmt: skip
            break
    return stamp
