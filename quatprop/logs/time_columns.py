"""The time of a table: the best of its clocks, a counter of samples, or a sample rate."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.logs import clocks
from quatprop.logs.clock_choice import ClockMatcher, goodness, is_readable
from quatprop.logs.series import SeriesChoice
from quatprop.tables.base import OTHER_DATES
from quatprop.tables.column_names import TIME_UNITS, as_option
from quatprop.tables.counters import counting
from quatprop.tables.model import Stamp
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from fractions import Fraction

    from quatprop.logs.clocks import Clock
    from quatprop.logs.rows import Row
    from quatprop.settings.selection import SignalSelection
    from quatprop.tables.counters import Counting
    from quatprop.tables.model import Table

    Positions = tuple[int, ...]

_INSTANT = r"(?!.*(?:period|delta|diff|step|interval|duration|exposure|latency|delay|dt)).*"
"""Names of columns that may be the time where a unit says that they are one."""

_NO_COLUMN = "none"


class TimeSource(NamedTuple):
    """Where the time of each row comes from.

    `columns`: Those of the stamps or of the counter; none where rows are counted
    `sample_rate`: samples a second, Hz, where they are counted
    `implied_unit`: the unit by convention; ``""`` where there is none
    """

    columns: tuple[int, ...] = ()
    sample_rate: Fraction | float | None = None
    implied_unit: str = ""


class TimeMatcher(ClockMatcher):
    """Finds the time of some columns of a table.

    `selection`: what the user chose
    `setting`: the setting that names the columns, such as ``"rate_cols"``
    """

    def __init__(self, table: Table, selection: SignalSelection, setting: str) -> None:
        super().__init__(table, selection)
        self.setting = setting
        self.counted = "the rows"

    def stamp(self, numbers: Positions, row: Row) -> tuple[Stamp, Table]:
        """Return the time of some columns, which may be a sample rate, and the rows to read."""
        time, sample_rate, implied = self._time(row, numbers)
        series = SeriesChoice(self, numbers, time).chosen()
        if both := set(numbers) & set(time):
            raise UsageError(
                f"{plain(self.path)}: {self.names(both)} cannot be both the time and one of "
                f"{Setting(self.setting)}; name other columns, or the time with "
                f"{Setting('time_col')}",
            )
        if self._holds_text(time):
            raise self._unreadable_dates(time)
        if time and sample_rate is None and self._needs_rate(time[0]):
            raise UndeclaredError(
                self.path,
                f"the rate of the counter {self.names(time)}",
                Setting("sample_rate", "HZ"),
            )
        units = ("ns", "ns")
        if time[1:]:
            units = ("s", self.fraction_unit(time[1]))
        elif time and sample_rate is None:
            units = (self.unit("time", time, TIME_UNITS, implied), "ns")
        if self.unknown:
            unknown, ways = (" and ".join(f"{part}" for part in parts)
                             for parts in zip(*self.unknown, strict=True))  # fmt: skip
            raise UndeclaredError(self.path, unknown, ways, several=len(self.unknown) > 1)
        clock = self.spelled(time)
        if sample_rate is not None:
            clock = (
                f"{clock} at {float(sample_rate):g} Hz" if clock else f"{float(sample_rate):g} Hz"
            )
        offset_ns = sum(map(self.utc_offset_ns, time))
        stamp = Stamp(time, units[: len(time)], clock, sample_rate, offset_ns)
        return stamp, self.table.of_series(series)

    def _holds_text(self, time: Positions) -> bool:
        """Return whether a time is text that cannot be read, such as dates with names of months."""
        if any(self.notes.units.get(k) == OTHER_DATES for k in time):
            return True
        if not time or self.declared(time[:1]) or self.selection.time_unit is not None:
            return False
        cells = [row[0] for row in self.head(time[:1])[: clocks.FIRST_ROWS]]
        return bool(cells) and bool(np.isnan(clocks.numbers_of(cells)).all())

    def _needs_rate(self, k: int) -> bool:
        """Return whether a column counts samples, and is no time by itself."""
        is_counter = re.fullmatch(clocks.COUNTER, self.columns[k].key) is not None
        return is_counter and not (self.selection.time_unit or self.declared((k,)))

    def _unreadable_dates(self, time: Positions) -> UnsupportedLogError:
        """Return the error for a time that is text, perhaps in two columns of dates and times."""
        dates = sorted(k for k, unit in self.notes.units.items() if unit == OTHER_DATES)
        are = dates if self.selection.time_col is None and {*time} <= {*dates} else time
        return UnsupportedLogError(
            self.path,
            f"{self.names(are)} {'hold' if are[1:] else 'holds'} {OTHER_DATES}; write them as "
            f"2023-11-14T22:13:20.5{' in one column' if are[1:] else ''}, name another column "
            f"with {Setting('time_col', 'C')}, or count rows at a steady rate with "
            f"{Setting('sample_rate', 'HZ')}",
        )

    def unused_stamps(self, row: Row) -> Positions:
        """Return the time columns that are there although rows are counted at a sample rate."""
        if self.selection.sample_rate is None or self.selection.time_col is not None:
            return ()
        others = self.clocks_of(row, ())
        return min(others, key=goodness).columns if others else ()

    def _time(self, row: Row, numbers: Positions) -> TimeSource:
        name, sample_rate = self.selection.time_col, self.selection.sample_rate
        if sample_rate is not None:
            if not (math.isfinite(sample_rate) and sample_rate > 0):
                raise UsageError(f"{Setting('sample_rate')} {sample_rate} is not a rate above 0 Hz")
            return self._counted(name, sample_rate, numbers)
        if name is not None:
            return TimeSource(self._named_time(name), None, self._implied_unit(name, row))
        found = self.clocks_of(row, numbers)
        by_unit = [k for k in self.matching(_INSTANT) if self.columns[k].unit in TIME_UNITS]
        if len(by_unit) == 1 and not any(map(is_readable, found)):
            return TimeSource(tuple(by_unit))
        steady = self.notes.sample_rate
        others = {*by_unit} - {k for clock in found for k in clock.columns}
        if found and (others or steady is not None) and self.stand_still(found):
            instead = self._instead_of_stopped(found, sorted(others))
            if instead is not None:
                return instead
            found = [] if steady is not None else found
        counter = self._counter(numbers) if steady is not None else ()
        if found:
            best = self.best(found)
            self.refuse_unknown_beside_arrival(best, found)
            # A rate that is only stated is no better than a clock of numbers.
            if best.rank < clocks.TEXT or not (counter or (steady and not is_readable(best))):
                return TimeSource(best.columns, None, best.units[0])
        if steady is not None:
            self._note_unused_counters(numbers, counter, steady)
            return TimeSource(counter, steady)
        likely = (rf".*[._](?:{clocks.TIME})", r".*(?:time|stamp|sec|clock|date).*", ".*")
        no_time = {*numbers, *self.matching(clocks.COUNTER)}
        candidates = ([k for k in self.matching(name) if k not in no_time] for name in likely)
        raise self.ambiguous_time(by_unit or next(filter(None, candidates), []))

    def _instead_of_stopped(self, found: list[Clock], others: list[int]) -> TimeSource | None:
        """Return the only other column in a unit of time that moves, if clocks stand still."""
        stopped = [k for clock in found for k in clock.columns]
        moving = [k for k in others if not self.stand_still([self._clock(k, clocks.EPOCH, "", 0)])]
        used = f"those in {self.names(moving)} are" if len(moving) == 1 else "the sample rate is"
        if len(moving) == 1 or self.notes.sample_rate is not None:
            self.overruled.append(
                f"the times in {self.names(stopped)} are all the same; {used} used"
            )
        return TimeSource(tuple(moving)) if len(moving) == 1 else None

    # What the user names.

    def _named_time(self, name: str) -> Positions:
        """Return the time column that the user names, or those of seconds and their fraction."""
        parts = name.split(",")
        if len(parts) == 2 and name not in (column.text.strip() for column in self.columns):  # noqa: PLR2004
            return tuple(self.position(part, "time_col") for part in parts)
        first = self.position(name, "time_col")
        fraction = self.fraction(first)
        return (
            (first,)
            if fraction is None or self.are_two_clocks(first, fraction)
            else (first, fraction)
        )

    def _implied_unit(self, name: str, row: Row) -> str:
        """Return the unit of a named time column by convention or by its name."""
        k = self._named_time(name)[0]
        if any(k in self.matching(pattern) for pattern in row.stamps):
            return row.time_unit
        return (clocks.named_clock(self.columns[k].key, ()) or ("", "", ""))[1]

    # Counted samples.

    def _counted(
        self, name: str | None, sample_rate: Fraction | float, numbers: Positions
    ) -> TimeSource:
        """Return the counter that the user names, or the only one, or none: rows are counted."""
        if name is None:
            counter = self._counter(numbers)
            if counter:
                self.counted = "the samples"
                self.overruled.append(
                    f"{Setting('sample_rate', f'{float(sample_rate):g}')} is that of the counter "
                    f"{self.names(counter)}, which also counts lost samples; to count rows, give "
                    f"{Setting('time_col', _NO_COLUMN)} too"
                )
            self._note_unused_counters(numbers, counter, sample_rate)
            return TimeSource(counter, sample_rate)
        if name == _NO_COLUMN and name not in (column.text.strip() for column in self.columns):
            return TimeSource((), sample_rate)
        k = self.position(name, "time_col")
        if re.fullmatch(f"{clocks.COUNTER}|{clocks.INDEX}", self.columns[k].key) is None:
            raise UsageError(
                f"{Setting('time_col')} and {Setting('sample_rate')} contradict each other; give "
                "one",
            )  # fmt: skip
        return TimeSource((k,), sample_rate)

    def _counter(self, numbers: Positions) -> Positions:
        """Return the first column that counts samples; none where there is none."""
        counters = self._countings(clocks.COUNTER, numbers)
        return tuple(k for k, counting in counters.items() if counting.is_by_one)[:1]

    def _countings(self, pattern: str, numbers: Positions) -> dict[int, Counting]:
        """Return the columns of some names that count, and how."""
        columns = [k for k in self.matching(pattern) if k not in numbers]
        rows = self.head(columns)[: clocks.FIRST_ROWS] if columns else []
        found = zip(columns, (counting(clocks.numbers_of(c)) for c in zip(*rows, strict=True)),
                    strict=False)  # fmt: skip
        return {k: how for k, how in found if how is not None}

    def _note_unused_counters(
        self, numbers: Positions, counter: Positions, sample_rate: Fraction | float
    ) -> None:
        """Note what else may count samples where rows are counted."""
        if counter:
            return
        rate = Setting("sample_rate", f"{float(sample_rate):g}")
        names = [column.text for column in self.columns]
        for k, how in self._countings(clocks.COUNTER, numbers).items():
            use = Setting("time_col", as_option(names, k))
            counts = f"the counter {self.names((k,))}, which usually steps by {how.step},"
            if how.has_gaps:
                raise UndeclaredError(
                    self.path,
                    f"whether {counts} counts samples",
                    (f"{use} and {rate} if it does, or {Setting('time_col', _NO_COLUMN)} and "
                         f"{rate} to count rows"),
                )  # fmt: skip
            self.overruled.append(f"{counts} is not used; to use it, give {use} and {rate}")
            return
        for k, how in self._countings(clocks.INDEX, numbers).items():
            if how.has_gaps:
                use = Setting("time_col", as_option(names, k))
                self.overruled.append(
                    f"{self.names((k,))} passes over numbers, as if samples were lost, but rows "
                    f"are counted; to count by it, give {use} and {rate}"
                )
                return
