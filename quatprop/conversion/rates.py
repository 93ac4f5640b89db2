"""Conversion of attitudes to the rates between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.errors import TimelineError
from quatprop.kinematics.rates import rates_between
from quatprop.series import AttitudeSeries, GyroSeries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

RATES: Final = {"body-rates": "body", "inertial-rates": "inertial"}
"""Representation by rates -> the frame in which they are resolved."""

RATE_COLUMNS: Final = {
    "body-rates": ("wx_rad_s", "wy_rad_s", "wz_rad_s"),
    "inertial-rates": ("wx_ref_rad_s", "wy_ref_rad_s", "wz_ref_rad_s"),
}
"""Columns by representation: readers must not take inertial rates for body rates."""


def rate_batches(path: str, batches: Iterable[AttitudeSeries], rates: str) -> Iterator[GyroSeries]:
    """Yield the rates between attitudes, one row per attitude.

    The rate of row k is constant up to row k + 1, so that propagation by the method ``start`` from
    the first attitude reproduces the attitudes. The rate after the last attitude is unknown: its
    row repeats the previous rate, or is zero if there is none.

    `rates`: ``"body"`` or ``"inertial"``
    """
    last = AttitudeSeries(np.empty(0, np.int64), np.empty((0, 4)))
    rate = np.zeros((1, 3))
    for batch in batches:
        t_ns, wxyz = np.append(last.t_ns, batch.t_ns), np.concatenate([last.wxyz, batch.wxyz])
        wrong = np.flatnonzero(np.diff(t_ns) <= 0)
        if len(wrong):
            raise TimelineError(
                path,
                "there is no rate between two attitudes whose timestamps do not rise: "
                f"{t_ns[wrong[0]]} ns and then {t_ns[wrong[0] + 1]} ns",
            )
        if len(t_ns) > 1:
            between = rates_between(t_ns, wxyz, rates=rates)
            rate = between[-1:]
            yield GyroSeries(t_ns[:-1], between)
        last = AttitudeSeries(t_ns[-1:], wxyz[-1:])
    yield GyroSeries(last.t_ns, rate)
