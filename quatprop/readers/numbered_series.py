"""Several sensors in the rows of a table, told apart by whole numbers in a column of any name.

Numbers that alternate may be anything: the rates and the times of the rows say what they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.readers.tables.table_log import numbers_of
from quatprop.readers.tables.turns import alternating
from quatprop.timeline.stamps import are_steady

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.arrays import Float64
    from quatprop.readers.matching import ColumnMatcher
    from quatprop.readers.tables.model import Group

_FEWEST_ROWS = 40
_LONGEST_TURN = 4
"""Maximum mean number of rows in which a number stays the same."""
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

    `numbers`, `time`: the columns of the rates and of the time
    """
    columns = [*candidates]
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
    is_few = 1 < len(kinds) <= _MOST_SENSORS and len(labels) <= _LONGEST_TURN * len(starts)
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
