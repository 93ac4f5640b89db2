"""The choice of a clock among the columns of a table."""

from __future__ import annotations

import re
from itertools import takewhile
from typing import TYPE_CHECKING

from quatprop.errors import UndeclaredError, UsageError
from quatprop.logs import clocks
from quatprop.logs.clocks import Clock
from quatprop.logs.columns import TableColumns
from quatprop.logs.vocabulary import GENERIC
from quatprop.tables.base import OTHER_DATES
from quatprop.tables.column_names import TIME_UNITS, as_option, whole_key
from quatprop.text import Setting, listed, plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64
    from quatprop.logs.rows import Row

    Positions = tuple[int, ...]

_PARTS_OF_A_SECOND = "|".join(name for unit in ("ms", "us", "ns") for name in TIME_UNITS[unit])


class ClockMatcher(TableColumns):
    """Finds the clocks of a table; takes the parameters of :class:`TableColumns`."""

    def clocks_of(self, row: Row, numbers: Positions) -> list[Clock]:
        """Return the columns that may be the time, those that can be read if there are any."""
        keys = [self.columns[k].key for k in numbers]
        found: dict[int, Clock] = {}
        for place, pattern in enumerate(self._conventional(row)):
            for k in self.matching(pattern):
                found.setdefault(k, self._clock(k, clocks.CONVENTION, row.time_unit, place))
        if self.selection.clock is None:
            for k, column in enumerate(self.columns):
                named = clocks.named_clock(column.key, keys)
                if k in found or k in numbers or not (named or k in self.notes.units):
                    continue
                rank, unit, place = named or (clocks.EPOCH, "", len(clocks.CLOCKS))
                if re.fullmatch(row.log_time or "(?!)", column.key):
                    rank = clocks.ARRIVAL
                found[k] = self._clock(k, rank, unit, place)
        # T (K) beside t (s) is a temperature.
        units = {"", *TIME_UNITS}
        every = list(found.values())
        by_unit = [clock for clock in every if {*clock.units} <= {*units, OTHER_DATES}] or every
        return self._nearest([*filter(is_readable, by_unit)] or by_unit, keys)

    def _conventional(self, row: Row) -> tuple[str, ...]:
        """Return the patterns of the time columns of a convention, for the chosen clock."""
        match self.selection.clock:
            case None:
                return () if row is GENERIC else row.stamps
            case "header":
                return tuple(pattern for pattern in row.stamps if pattern != row.log_time)
            case "log" if row.log_time:
                return (row.log_time,)
            case clock:
                raise UsageError(
                    f"{plain(self.path)}: this table has no {clock} time; choose the column with "
                    f"{Setting('time_col')}",
                )

    def _clock(self, k: int, rank: int, implied_unit: str, place: int) -> Clock:
        unit = OTHER_DATES if k in self.notes.texts else self.declared((k,)) or implied_unit
        zoned = self.notes.dates.get(k)
        offset = self.utc_offset_ns(k)
        if zoned is not None or unit == OTHER_DATES:
            rank = max(rank, clocks.TEXT if zoned or offset else clocks.LOCAL)
        return Clock((k,), rank, place, (unit,), bool(zoned), offset)

    def utc_offset_ns(self, k: int) -> int:
        """Return the offset of local text from UTC that the header states, ns; else 0."""
        is_local = self.notes.dates.get(k) is False
        return clocks.stated_offset_ns(self.columns[k].unit) if is_local else 0

    def refuse_unknown_beside_arrival(self, best: Clock, found: list[Clock]) -> None:
        """Refuse to take the time of arrival where another column may be the sensor's own."""
        if best.rank == clocks.ARRIVAL:
            unknown = {*self.matching(rf".*[._]{clocks.TIME}")}
            if unknown := unknown - {k for clock in found for k in clock.columns}:
                raise self.ambiguous_time([*best.columns, *sorted(unknown)])

    def _nearest(self, found: list[Clock], keys: list[str]) -> list[Clock]:
        """Return clocks without those that, of one kind, are further from what was sampled."""

        def distance(clock: Clock) -> int:
            key = self.columns[clock.columns[0]].key
            return -max((_shared(key, name) for name in keys), default=0)

        kinds = {(clock.rank, clock.place) for clock in found}
        nearest = {
            kind: min(distance(c) for c in found if (c.rank, c.place) == kind) for kind in kinds
        }
        return [c for c in found if distance(c) == nearest[c.rank, c.place]]

    def best(self, found: list[Clock]) -> Clock:
        """Return the best clock that moves, and note what another one says."""
        found = [self._with_fraction(clock) for clock in sorted(found, key=goodness)]
        fractions = {k for clock in found for k in clock.columns[1:]}
        found = [clock for clock in found if clock.columns[0] not in fractions]
        if len(found) == 1 or not any(map(is_readable, found)):
            return found[0]
        times = self._first_times(found)
        moving = [clock for clock in found if not clocks.stands_still(times[clock])] or found
        best, *others = moving
        used = times[best]
        if best is not found[0]:
            self.overruled.append(
                f"the times in {self.names(found[0].columns)} are all the same; those in "
                f"{self.names(best.columns)} are used"
            )
        for other in others:
            theirs = times[other]
            if used is None or theirs is None:
                if goodness(best) == goodness(other):
                    raise self.ambiguous_time([best.columns[0], other.columns[0]])
                continue
            differ = clocks.difference(used, theirs)
            if differ is None:
                continue
            is_rival = best.rank == other.rank != clocks.CONVENTION
            if differ.largest_ns and (is_rival or goodness(best) == goodness(other)):
                apart = duration_text(differ.largest_ns)
                why = f", which differ by up to {apart} beyond a constant"
                raise self.ambiguous_time([best.columns[0], other.columns[0]], why)
            self._note_difference(best, other, differ)
        return best

    def stand_still(self, found: list[Clock]) -> bool:
        """Return whether all clocks have the same time in all of the first rows."""
        return all(map(clocks.stands_still, self._first_times(found).values()))

    def _note_difference(self, best: Clock, other: Clock, differ: clocks.Difference) -> None:
        names = self.names(other.columns), self.names(best.columns)
        sentence = clocks.difference_text(*names, differ)
        column = as_option([column.text for column in self.columns], other.columns[0])
        self.overruled.append(
            f"{sentence}; to use them, name them with {Setting('time_col', column)}"
        )

    def _first_times(self, found: list[Clock]) -> dict[Clock, Float64 | None]:
        columns = [k for clock in found for k in clock.columns]
        rows = self.head(columns)[: clocks.FIRST_ROWS]
        cells = dict(zip(columns, zip(*rows, strict=True), strict=True)) if rows else {}
        return {
            clock: clocks.first_times([cells[k] for k in clock.columns], clock) if rows else None
            for clock in found
        }

    # Seconds and their fraction.

    def _with_fraction(self, clock: Clock) -> Clock:
        """Return a clock of seconds with the column of their fractions, if there is one."""
        first = clock.columns[0]
        fraction = self.fraction(first)
        if fraction is None:
            return clock
        if self.are_two_clocks(first, fraction):
            if self.declared((first,)) and self.declared((fraction,)):
                return clock
            raise self.ambiguous_time((first, fraction))
        units = ("s", self.fraction_unit(fraction))
        return clock._replace(columns=(first, fraction), units=units)

    def fraction(self, first: int) -> int | None:
        """Return the column of fractions of seconds that belongs to one of whole seconds."""
        first_key = whole_key(self.columns[first].text)
        match = re.fullmatch(r"(.*[._])?(?:secs?|seconds?)|(.*[._])s", first_key)
        if not match:
            return None
        key = re.compile(re.escape(match[1] or match[2] or "") + f"(?:{_PARTS_OF_A_SECOND})")
        others = (k for k, one in enumerate(self.columns) if key.fullmatch(whole_key(one.text)))
        return next(others, None)

    def ambiguous_time(self, candidates: Sequence[int], why: str = "") -> UndeclaredError:
        """Return the error for columns that all may be the time, and why none of them is taken."""
        names = listed(self.columns[k].text for k in candidates)
        what, way = f"the time column (one of {names}{why})", f"{Setting('time_col', 'C')}"
        if not candidates:
            what = "the time column"
        elif len(candidates) == 1:
            column = as_option([column.text for column in self.columns], candidates[0])
            what, way = f"whether {names} is the time", f"{Setting('time_col', column)}"
            if self.declared((candidates[0],)) not in TIME_UNITS:
                way = f"{way} and {Setting('time_unit', '|'.join(TIME_UNITS))}"
        steady = f"or {Setting('sample_rate', 'HZ')} for rows at a steady rate"
        return UndeclaredError(self.path, what, f"{way}, {steady}")


def _shared(a: str, b: str) -> int:
    """Return how many words of two names are the same from the beginning."""
    pairs = zip(*(re.split(r"[._]", name) for name in (a, b)), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def is_readable(clock: Clock) -> bool:
    """Return whether a clock is not one of dates that can be read in several ways."""
    return OTHER_DATES not in clock.units


def goodness(clock: Clock) -> tuple[int, int]:
    """Return what is lowest of the best clock."""
    return clock.rank, clock.place
