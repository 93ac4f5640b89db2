"""Interleaved series in the rows of one table: several sensors, or several kinds of records.

A column of labels shows them: a few values that alternate. Text in any column can be a label; whole
numbers only in a column without a name, or with the name of a label.
"""

from __future__ import annotations

import re
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UndeclaredError, UnsupportedLogError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.readers.odd_clocks import ABSENT
from quatprop.readers.tables.table_log import numbers_of
from quatprop.readers.tables.turns import ALL, Watched, alternating
from quatprop.readers.vocabulary import SENSOR
from quatprop.timeline.stamps import are_steady

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group

    Series = tuple[tuple[int, str], ...]


_MOST_LABELS = 16
_LONGEST_LABEL = 60
_LONGEST_TURN = 32
"""Maximum mean run length of a text label: a state, such as walking, lasts longer."""
_LONGEST_UNNAMED_TURN = 4
_FEWEST_RUNS = 8
"""Fewest runs of labels that begin late, in a column whose name does not tell what they are."""
_SMALL = 16
"""Whole numbers below may be labels; 25 and 26 may be temperatures."""

_BODY = (
    r"(?:subject|participant|patient|person|user|athlete|player|animal|rider|driver"
    r"|sensor|device)(?:_?(?:id|name|no|num|number|index|label))?"
)
"""Names of columns that tell whose rates a row has, or which sensor took them."""

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


def _no_turns(_: Sequence[tuple[str, int]]) -> tuple[str, ...]:
    """Return no labels that alternate."""
    return ()


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
        choice = self._setting(f"{self._table.as_option(k)}={labels[0]}")
        self._table.remark(
            "numbers-alternate",
            f"the numbers {listed(labels)} in column {self._table.names((k,))} alternate; if they "
            f"are sensors, choose one, such as {choice}",
        )

    def watched(self, series: Series) -> tuple[Watched, ...]:
        """Return the columns whose labels must not take turns in the rows of a series."""
        chosen = {k for k, _ in series}
        watched = []
        for k in dict.fromkeys((*self._candidates, *self._others)):
            key = self._table.columns[k].key
            if k in chosen or k in self._merged:
                continue
            is_of_body = self._wanted != ALL and re.fullmatch(_BODY, key)
            changed = partial(self._changed, k) if is_of_body else None
            may_turn = k in self._candidates and self._may_hold_labels(k)
            if may_turn or changed:
                turns = partial(_turn_late, key) if may_turn else _no_turns
                watched.append(Watched(k, turns, partial(self._late, k), changed))
        return tuple(watched)

    def _changed(self, k: int, before: str, after: str, row: int) -> None:
        """Remark on rows of another body, or another sensor, from a row on."""
        choice = self._setting(f"{self._table.as_option(k)}={before}")
        self._table.table.remark(
            "label-changes",
            f"the rows are of {quoted(before)} in column {self._table.names((k,))}, and from row "
            f"{row} on of {quoted(after)}, and are read as those of one body; to read those of "
            f"the first, choose {choice}",
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
        choices: list[str] = []
        for part in wanted.split(","):
            # Commas may be part of a label.
            if choices and "=" not in part and not self._columns_with(part.strip()):
                choices[-1] += f",{part}"
            else:
                choices.append(part)
        series = []
        for choice in map(str.strip, choices):
            if found := self._only_column(choice):
                series.append(found)
                continue
            name, equals, label = (text.strip() for text in choice.partition("="))
            if not equals:
                raise self._not_there(choice)
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
            f"{names}; name one with {self._setting(f'COLUMN={plain(label)}')}"
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
            f"{self._setting(f'COLUMN={plain(label)}')}"
        )

    def _setting(self, *choices: str) -> str:
        """Return the setting that chooses rows, besides the columns that it has chosen."""
        before = "".join(f"{plain(label)}," for label in self._table.set_labels)
        return Setting("series", "|".join(f"{before}{choice}" for choice in choices))

    def _undeclared(
        self, turning: Mapping[int, tuple[str, ...]], row: int = 0, *, is_named: bool = False
    ) -> Exception:
        """Return the error for series that take turns, from a row on or in the first rows.

        `is_named`: whether the way out names the column, too
        """
        if self._table.set_labels[1:]:
            self._table.refuse_undeclared()  # of one set of columns at first
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
        choices = [f"{before}{label}" for label in labels] if are_plain else ["VALUE"]
        return UndeclaredError(
            self._table.path,
            f"which series to read, of {listed(labels)} that take turns in column {name},",
            (f"{self._setting(*choices)}, or if all rows are of one sensor, with "
                f"{self._setting(ALL)}"),
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


# Whole numbers in a column of any name, which the rates and the times of the rows tell apart.


_FEWEST_ROWS = 40
_MOST_SENSORS = 16
_APART = 4
"""Rates of two sensors differ by this many times as much as those of one from row to row."""
_SHARE = 0.8
"""Smallest part of the rows of other sensors that repeat a time or step back."""


class Numbered(NamedTuple):
    """A column whose numbers take turns as sensors would.

    `is_certain`: whether both the rates and the times alternate as the numbers do
    """

    column: int
    labels: tuple[str, ...]
    is_certain: bool


def numbered_series(
    matcher: ColumnMatcher, candidates: Iterable[int], numbers: Group, time: Group
) -> Numbered | None:
    """Return the first column of whole numbers that tells sensors apart; None: none does.

    `numbers`, `time`: the columns of the rates and of the time. Without rates, all rows are read:
        the times of several sensors do not contradict each other
    """
    columns = [*candidates] if numbers else []
    rows = matcher.first_rows((*columns, *numbers, *time)) if columns else []
    if len(rows) < _FEWEST_ROWS:
        return None
    cells = [numbers_of(column) for column in zip(*rows, strict=True)]
    rates = np.stack(cells[len(columns) : len(columns) + len(numbers)], 1)
    is_whole = np.isfinite(rates).all(1)
    rates, times = rates[is_whole], cells[-1][is_whole] if time else np.empty(0)
    has_times = bool(time) and bool(np.isfinite(times).all())
    for k, values in zip(columns, cells, strict=False):
        labels = values[is_whole]
        if not (len(labels) >= _FEWEST_ROWS and _take_turns(labels)):
            continue
        by_rates = _differ(rates, labels)
        if by_rates or (has_times and _share_times(times, labels)):
            # A phase of the motion alternates on a steady clock, as its rates do.
            is_certain = by_rates and has_times and not are_steady(times)
            return Numbered(k, tuple(f"{label:.0f}" for label in np.unique(labels)), is_certain)
    return None


def _take_turns(labels: Float64) -> bool:
    if not np.isfinite(labels).all() or (labels % 1).any():
        return False
    starts = np.flatnonzero(np.diff(labels, prepend=labels[0] + 1))
    kinds = np.unique(labels)
    runs = [(f"{labels[start]:.0f}", 1) for start in starts]
    is_few = 1 < len(kinds) <= _MOST_SENSORS and len(labels) <= _LONGEST_UNNAMED_TURN * len(starts)
    return is_few and len(alternating(runs)) == len(kinds)


def _differ(rates: Float64, labels: Float64) -> bool:
    """Return whether the rates change more from one number to the next than from row to row."""
    between = np.diff(rates, axis=0)[np.diff(labels) != 0]
    own = [np.diff(rates[labels == label], axis=0) for label in np.unique(labels)]
    within = np.concatenate(own)
    return _rms(between) > _APART * _rms(within) > 0


def _rms(steps: Float64) -> float:
    return float(np.sqrt(np.mean(steps**2))) if len(steps) else 0.0


def _share_times(times: Float64, labels: Float64) -> bool:
    """Return whether the times rise for each number, and repeat or step back among them."""
    kinds = np.unique(labels)
    rise = all((np.diff(times[labels == kind]) > 0).all() for kind in kinds)
    shared = np.count_nonzero(np.diff(times) <= 0)
    return rise and bool(shared >= _SHARE * (1 - 1 / len(kinds)) * (len(times) - 1))
