"""The part of an attitude series within a time range."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

from quatprop.conditioning.time_range import (
    Ends,
    EndsFinder,
    absolute_range,
    clipped,
    idle_remarks,
    length_text,
    pause_remarks,
)
from quatprop.series import AttitudeSeries
from quatprop.timeline.outliers import marked

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.conditioning import GyroCorrection
    from quatprop.logs.signals.signal import AttitudeSignal, Rows
    from quatprop.text import Remark


class AttitudePart:
    """The attitudes of a signal within a time range, ends included.

    `outside`: number of rows before and after it
    """

    def __init__(self, source: AttitudeSignal, part: GyroCorrection) -> None:
        self._source = source
        self._part = part
        self._ends = Ends(0, 0)
        self.outside = [0, 0]

    def read(self, **wanted: bool) -> Rows:
        """Read the rows of the part, as :meth:`AttitudeSignal.read`; each call starts again."""
        rows, part = self._source.read(**wanted), self._part
        return rows if part.start is None and part.end is None else self._inside(rows)

    def _inside(self, rows: Rows) -> Iterator[tuple[Any, ...]]:
        if self._part.looks_ahead:
            finder = EndsFinder()
            for t_ns, outliers, _ in marked((t for t, _ in self._source.rows()), lambda t: t):
                finder.add(t_ns[~outliers])
            self._ends = finder.ends()
        self.outside[:] = 0, 0
        numbered = ((AttitudeSeries(*row), row[0]) for row in rows)
        start_ns, end_ns = absolute_range(self._part, self._ends)
        for series, _ in clipped(numbered, self._part, start_ns, end_ns, self.outside):
            yield tuple(getattr(series, field.name) for field in fields(series))

    @property
    def length(self) -> str:
        """Length of the series as text if the range is relative to its ends, after reading."""
        return length_text(self._part, self._ends)

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on the time range, after reading."""
        yield from pause_remarks(self._part, self._ends)
        yield from idle_remarks(self._part, *self.outside)
