"""Sensitivity of the final attitude to the integration rule and to the sampling.

The final attitude is computed by two more propagations: with the next better rule, and with every
second sample. The first shows the error of the rule. The second also reveals a sample rate that is
too low for all rules, when they agree on a wrong attitude.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.kinematics.propagate import FinalAttitude
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.kinematics.quintic import steps_and_lengths, windows_over
from quatprop.series import GyroSeries
from quatprop.settings.choices import CORRECT_CONING

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64


NEXT_BETTER: Final = {
    "start": "mean",
    "end": "mean",
    "mean": "coning",
    "coning": "cubic",
    "cubic": "coning",
    "quintic": "cubic",
}
"""The rule with which each is compared: of the next higher order, or else the next lower."""


class Sensitivity:
    """The final attitudes of another method, and with every second sample.

    `next_method`: the other method; known after the last sample
    """

    def __init__(self, q0: Float64, method: str, rates: str) -> None:
        self._q0, self._method, self._rates = q0, method, rates
        self._ends = [q0, q0]
        self._is_quintic = False
        self.next_method: str | None = None

    def begin(self, *, restart: bool) -> None:
        """Begin a segment: at q0 again, or at the current attitudes."""
        self._starts = [self._q0, self._q0] if restart else self._ends
        self._is_quintic = self._is_quintic and not restart
        self._runs: list[FinalAttitude] = []
        self._sparse = Decimator()

    def add(self, block: GyroSeries) -> None:
        """Add the next samples: a block of :func:`quatprop.series.blocks.reblock`."""
        if not self._runs:
            integrated = block.is_integrated(self._method)
            end = integrated and self._method not in CORRECT_CONING
            self.next_method = "coning" if end else NEXT_BETTER[self._method]
            methods = (self.next_method, self._method)
            kinds = (_BelowQuintic if self._method == "quintic" else FinalAttitude, FinalAttitude)
            self._runs = [
                kind(q0, method, self._rates)
                for kind, q0, method in zip(kinds, self._starts, methods, strict=True)
            ]
        other, sparse = self._runs
        other.add(block)
        sparse.add(self._sparse.kept(block))

    def finish(self) -> None:
        """End the segment."""
        self._runs[1].add(self._sparse.rest)
        self._ends = [run.end() for run in self._runs]
        if isinstance(self._runs[0], _BelowQuintic):
            self._is_quintic |= self._runs[0].is_quintic
            self.next_method = "cubic" if self._is_quintic else "coning"

    def angles(self, final: ArrayLike) -> tuple[float, float]:
        """Return the angles between the final attitude and the two others, rad.

        `final`: the attitude of the method itself at the last sample, wxyz, shape ``(4,)``
        """
        method_rad, sampling_rad = geodesic_angle(np.asarray(final), np.array(self._ends)).tolist()
        return method_rad, sampling_rad


class _BelowQuintic(FinalAttitude):
    """The final attitude by ``cubic``, or ``coning`` over intervals where ``quintic`` is ``cubic``.

    `is_quintic`: whether ``quintic`` has differed from ``cubic`` over any interval so far
    """

    is_quintic = False

    def _rotation_vectors(self, samples: GyroSeries, method: str) -> Float64:
        rotvec = super()._rotation_vectors(samples, method)
        usable = windows_over(*steps_and_lengths(samples.t_ns, samples.integration_time_ns)).usable
        self.is_quintic |= bool(usable.any())
        if not usable.all():
            rotvec[~usable] = super()._rotation_vectors(samples, "coning")[~usable]
        return rotvec


class Decimator:
    """Drops every second sample of a segment, but not the last.

    Averages and increments are combined over two intervals: only the rotation of the axis within
    them is lost.

    `rest`: the last sample so far, if it was dropped; else empty
    """

    def __init__(self) -> None:
        self._count = 0
        self._held: GyroSeries | None = None
        self.rest = GyroSeries(np.zeros(0, np.int64), np.zeros((0, 3)))

    def kept(self, block: GyroSeries) -> GyroSeries:
        """Return the samples of the next block that are kept."""
        if block.integration_time_ns is None and not block.is_interval_average:
            # The samples are independent, so they are a view.
            sparse = block[self._count % 2 :: 2]
            self._count += len(block)
            self.rest = block[len(block) - (self._count + 1) % 2 :]
            return sparse
        samples, first = block, 0
        if self._held is not None:
            # The first of these was returned with the previous block.
            samples, first = GyroSeries.joined([self._held, block]), 2
        last = (len(samples) - 1) // 2 * 2
        self._held, self.rest = samples[last:], samples[last + 1 :]
        return self._joined(samples[: last + 1], samples[first : last + 1 : 2])

    @staticmethod
    def _joined(samples: GyroSeries, sparse: GyroSeries) -> GyroSeries:
        """Return the kept samples with the averages over both of their intervals."""
        lengths = (
            np.diff(samples.t_ns)
            if samples.integration_time_ns is None
            else samples.integration_time_ns[1:]
        )
        moves = np.diff(samples.t_ns) > 0
        lengths = np.where(moves, lengths, 0)
        both = lengths[0::2] + lengths[1::2]
        weighted = samples.rate[1:] * lengths[:, None]
        total = weighted[0::2] + weighted[1::2]
        rate, integration_time_ns = sparse.rate.copy(), sparse.integration_time_ns
        count = len(both)
        np.divide(total, both[:, None], out=rate[len(rate) - count :], where=both[:, None] > 0)
        if integration_time_ns is not None:
            integration_time_ns = np.concatenate(
                [integration_time_ns[: len(integration_time_ns) - count], both]
            )
        return GyroSeries(sparse.t_ns, rate, integration_time_ns, sparse.is_interval_average)
