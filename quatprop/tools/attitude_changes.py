"""Changes of attitudes: to the rates between them, relative to another body, about other axes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import Loss, TimelineError
from quatprop.base.rendering import count_text
from quatprop.base.text import Remark, plain
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import rates_between
from quatprop.kinematics.quaternion import conjugate, from_matrix, multiply, rotate
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.attitude_input import AttitudeInput, load_attitudes
from quatprop.settings.reading import AttitudeSelection
from quatprop.stores.objects import split_topic
from quatprop.timeline.stamps import GAP_FACTOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64


# Conversion of attitudes to the rates between them.


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


# Attitudes of a body relative to another one, such as the angle of a joint.


class RelativeTo:
    """Makes attitudes relative to those of another body, which are held in memory.

    `own`: the attitudes that are converted, of which invalid ones are treated alike
    """

    def __init__(self, source: str, own: AttitudeInput) -> None:
        path, topic = split_topic(source)
        wanted = AttitudeInput(
            path,
            selection=AttitudeSelection(topic=topic),
            normalize=own.normalize,
            drop=own.drop,
            side="relative_to",
        )
        loaded = load_attitudes(wanted)
        self._source, self._other = source, loaded.series
        self.losses, steps = [*loaded.losses], np.diff(self._other.t_ns)
        if dropped := loaded.counts.invalid:
            reason = count_text(dropped, "invalid quaternion")
            self.losses.append(Loss(plain(source), reason, dropped))
        if (steps <= 0).any():
            raise TimelineError(path, "its timestamps do not increase; sort the rows by time")
        # Whether the interval before each attitude is usable: not a gap, and not before the first.
        gap_ns = GAP_FACTOR * np.median(steps) if len(steps) else 0
        self._near = np.insert(steps <= gap_ns, 0, values=False)
        self._omitted = 0

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield q_other* q at times between attitudes of the other series."""
        t_ns, used = self._other.t_ns, 0
        for series in batches:
            after = np.searchsorted(t_ns, series.t_ns).clip(0, len(t_ns) - 1)
            is_known = (t_ns[after] == series.t_ns) | (self._near[after] & (series.t_ns < t_ns[-1]))
            used += (count := int(np.count_nonzero(is_known)))
            self._omitted += len(series) - count
            yield series[is_known].relative_to(self._other)
        if self._omitted and not used:
            reason = "it has no attitudes at these times; are both on the same clock?"
            raise TimelineError(self._source, reason)

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on the omitted rows, if there are any."""
        if self._omitted:
            where = "before, after or in a gap of the attitudes of"
            text = f"omitted {count_text(self._omitted, 'row')} {where} {plain(self._source)}"
            yield Remark("not-covered", text)


# Change of the reference axes and of the body axes of attitudes.


class AxisChange(NamedTuple):
    """The rotations from old to new axes, v_new = M v_old.

    `reference`, `body`: rotation matrices M, shape ``(3, 3)``
    """

    reference: Float64
    body: Float64

    @classmethod
    def from_settings(cls, left: str | None, right: str | None) -> AxisChange:
        """Return the change of axes of two settings; None for no change."""
        unchanged = "1,0,0,0"
        return cls(*(mounting(axes or unchanged, "rotation") for axes in (left, right)))

    def mixes(self, axes: str) -> bool:
        """Return whether a new axis of the ``"body"`` or ``"reference"`` is along no old one."""
        change: Float64 = self.body if axes == "body" else self.reference
        return bool((np.abs(change).max(axis=0) < 1 - 1e-12).any())

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield attitudes q' = L q R*, and positions and covariances in the new axes."""
        left, right = from_matrix(self.reference), conjugate(from_matrix(self.body))
        for series in batches:
            position, covariance = series.position, series.covariance
            yield replace(
                series,
                wxyz=multiply(multiply(left, series.wxyz), right),
                position=None if position is None else rotate(left, position),
                covariance=None if covariance is None else self.body @ covariance @ self.body.T,
            )
