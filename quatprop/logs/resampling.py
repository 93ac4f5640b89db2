"""Interpolate an attitude series at a constant rate."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import TimelineError
from quatprop.kinematics.interpolation import interpolate
from quatprop.kinematics.resample import PIECE, Steady, with_columns
from quatprop.rendering import count_text
from quatprop.series import AttitudeSeries
from quatprop.text import Remark, Setting
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from fractions import Fraction


class Resampling:
    """Interpolates an attitude series, held in memory, at a constant rate.

    `rate`: output rate, Hz, from the first attitude on
    `floor_rad`: approximate largest interpolation error so far, rad
    """

    def __init__(self, path: str, rate: Fraction) -> None:
        self._path = path
        self._times = Steady(rate)
        self._gaps = self._gap_ns = 0
        self.floor_rad = 0.0

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the interpolated attitudes with their other columns; none within gaps."""
        parts = list(batches)
        if not parts:
            return
        series = AttitudeSeries.joined(parts)
        steps = np.diff(series.t_ns)
        if len(wrong := np.flatnonzero(steps <= 0)):
            raise TimelineError(
                self._path,
                "there is no attitude between two whose timestamps do not rise: "
                f"{series.t_ns[wrong[0]]} ns and then {series.t_ns[wrong[0] + 1]} ns; omit "
                f"{Setting('rate')}",
            )
        self._gap_ns = GAP_FACTOR * int(np.median(steps)) if len(steps) else 0
        cuts = np.flatnonzero(steps > self._gap_ns) + 1
        self._gaps = len(cuts)
        for start, stop in zip([0, *cuts], [*cuts, len(series)], strict=True):
            yield from self._between(series[int(start) : int(stop)])

    def _between(self, series: AttitudeSeries) -> Iterator[AttitudeSeries]:
        """Yield the interpolated attitudes of a stretch without gaps."""
        self._times.refuse_excess(series.t_ns)
        wanted = list(self._times.up_to(int(series.t_ns[0]), int(series.t_ns[-1])))
        if not wanted:
            return
        t_ns = np.concatenate(wanted)
        # The only time within a single sample is its own.
        wxyz = series.wxyz.copy()
        if len(series) > 1:
            wxyz, floor_rad = interpolate(series, t_ns)
            self.floor_rad = max(self.floor_rad, floor_rad)
        # Samples at these times are kept exactly: interpolation normalises.
        at = np.searchsorted(series.t_ns, t_ns)
        known = series.t_ns[at] == t_ns
        wxyz[known] = series.wxyz[at[known]]
        for first in range(0, len(t_ns), PIECE):
            rows = slice(first, first + PIECE)
            yield with_columns(series, t_ns[rows], wxyz[rows], "body")

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on gaps, if there are any."""
        if self._gaps:
            yield Remark(
                "gaps-kept",
                f"no attitudes are interpolated across {count_text(self._gaps, 'gap')} longer than "
                f"{duration_text(self._gap_ns)}",
            )
