"""Sensitivity of the attitudes to the integration rule and to the sampling.

They are computed by two more propagations: with the next better rule, and with every second
sample. The first shows the error of the rule. The second also reveals a sample rate that is too
low for all rules, when they agree on a wrong attitude. The largest difference counts: at the last
sample, a body that swings back and forth may be where all agree.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.kinematics.increments import steps_and_lengths, windows_over
from quatprop.kinematics.propagate import TILE, StepComposer
from quatprop.kinematics.quaternion import (
    LEVELS,
    PADDING,
    compose_pairs,
    conjugate,
    geodesic_angle,
    product_loop,
    product_scan,
    unit,
    write_rows,
)
from quatprop.kinematics.series import GyroSeries
from quatprop.settings.quantities import CORRECT_CONING, LOOK_AHEAD

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from quatprop.base.arrays import Float64, Intp
    from quatprop.kinematics.quaternion import Wxyz


NEXT_BETTER: Final = {
    "start": "mean",
    "end": "mean",
    "mean": "cubic",
    "coning": "cubic",
    "cubic": "coning",
    "quintic": "cubic",
}
"""The rule with which each is compared: of the next higher order, or else the next lower."""


class Sensitivity:
    """The attitudes of another method, and with every second sample.

    `next_method`: the other method; known after the last sample
    `angles`: the largest angles between the attitudes of the method itself and the two others, rad
    """

    def __init__(self, q0: Float64, method: str, rates: str) -> None:
        self._q0, self._method, self._rates = q0, method, rates
        self._ends = [q0, q0]
        self._is_quintic = False
        self.next_method: str | None = None
        self.angles = (0.0, 0.0)

    def begin(self, *, restart: bool) -> None:
        """Begin a segment: at q0 again, or at the current attitudes."""
        self._starts = [self._q0, self._q0] if restart else self._ends
        self._others: list[_Other] = []
        self._sparse = Decimator()

    def add(self, block: GyroSeries, wxyz: Float64) -> None:
        """Add the next samples: a block of :func:`quatprop.kinematics.time_series.reblock`.

        `wxyz`: their attitudes by the method itself
        """
        if not self._others:
            integrated = block.is_integrated(self._method)
            end = integrated and self._method not in CORRECT_CONING
            self.next_method = "coning" if end else NEXT_BETTER[self._method]
            methods = (self.next_method, self._method)
            kinds = (_BelowQuintic if self._method == "quintic" else FinalAttitude, FinalAttitude)
            self._others = [
                _Other(kind(q0, method, self._rates))
                for kind, q0, method in zip(kinds, self._starts, methods, strict=True)
            ]
        self._last = wxyz[-1:]
        other, sparse = self._others
        other.add(block, wxyz)
        sparse.add(self._sparse.kept(block), wxyz[::2])

    def finish(self) -> None:
        """End the segment."""
        if len(self._sparse.rest):
            self._others[1].add(self._sparse.rest, self._last)
        self._ends = [each.end() for each in self._others]
        by_method, by_sampling = (each.largest for each in self._others)
        self.angles = max(self.angles[0], by_method), max(self.angles[1], by_sampling)
        if isinstance(self._others[0].run, _BelowQuintic):
            self._is_quintic |= self._others[0].run.is_quintic
            self.next_method = "cubic" if self._is_quintic else "coning"


class _Other:
    """Another propagation, compared with the method itself.

    `largest`: the largest angle between their attitudes so far, rad
    """

    def __init__(self, run: FinalAttitude) -> None:
        self.run = run
        self.largest = 0.0
        self._is_first = True
        self._own: list[Float64] = []
        self._found: list[Float64] = []

    def add(self, samples: GyroSeries, wxyz: Float64) -> None:
        """Add the next samples and their attitudes by the method itself."""
        if len(self._found) > 1:
            self._compare()
        self._own.append(wxyz[marks(len(samples), is_first=self._is_first)])
        self._found.append(self.run.add(samples))
        self._is_first = False

    def end(self) -> Float64:
        """Return the attitude at the last sample."""
        self._found.append(self.run.end())
        return self._compare()

    def _compare(self) -> Float64:
        """Compare the attitudes that both have; return the last one of the other."""
        own, found = np.concatenate(self._own), np.concatenate(self._found)
        self.largest = max(self.largest, float(geodesic_angle(own[: len(found)], found).max()))
        self._own, self._found = [own[len(found) :]], []
        return np.asarray(found[-1])


class FinalAttitude(StepComposer):
    """Computes the last attitude and few others, in less than half the time of all."""

    def __init__(self, q0: ArrayLike, method: str, rates: str) -> None:
        super().__init__(q0, method, rates)
        self._held: GyroSeries | None = None
        self._is_first = True

    def add(self, series: GyroSeries) -> Float64:
        """Add the next samples, a block as for :meth:`Propagation.advance`; return attitudes.

        `Returns`: those at the :func:`marks` of these samples, or of the ones before by methods
            that look ahead, shape ``(n, 4)``
        """
        if self._method not in LOOK_AHEAD or not len(series):
            return self._advance(series, None)
        before, self._held = self._held, series
        return self._advance(series[:0] if before is None else before, series)

    def end(self) -> Float64:
        """Return the attitudes at the marks that are left."""
        held, self._held = self._held, None
        return np.zeros((0, 4)) if held is None else self._advance(held, None)

    def _advance(self, series: GyroSeries, following: GyroSeries | None) -> Float64:
        if not len(series):
            return np.zeros((0, 4))
        found, is_first, self._is_first = [], self._is_first, False
        with np.errstate(over="ignore", invalid="ignore"):
            tiles = (steps for _, steps in self._steps(series, following))
            if is_first:
                first = next(tiles)
                found.append(product_scan(self._attitude, first[:, :NEAREST]).T[1:])
                if first.shape[1] > NEAREST:
                    near = compose_pairs(first[:, NEAREST:], NEAR_LEVELS)
                    begin = _wxyz(found[-1][-1])
                    found.append(product_scan(begin, near, LEVELS - NEAR_LEVELS).T[1:])
                self._attitude = unit(_wxyz(found[-1][-1]))
            # Many calls on short arrays are slow: high in the tree, all tiles are one array.
            parts = [compose_pairs(steps, 3) for steps in tiles] or [first[:, :0]]
            far = compose_pairs(np.concatenate(parts, axis=1), LEVELS - 3)
            for start in range(0, far.shape[1], TILE >> LEVELS):
                passed = product_loop(self._attitude, far[:, start : start + (TILE >> LEVELS)])
                self._attitude = unit(passed[-1])
                found.append(np.array(passed[1:]).view(np.complex128))
            # Steps that fill up the last tile are no samples.
            wxyz = np.empty((len(marks(len(series), is_first=is_first)), 4))
            write_rows(np.concatenate(found)[: len(wxyz)].T, wxyz)
        return conjugate(wxyz) if self._inertial else wxyz


def _wxyz(pair: NDArray[np.complex128]) -> Wxyz:
    a, b = pair.tolist()
    return a.real, a.imag, b.real, b.imag


NEAREST: Final = PADDING
"""Number of the first samples whose attitudes are all computed: those of a short log."""

NEAR_LEVELS: Final = 5


def marks(count: int, *, is_first: bool) -> Intp:
    """Return the samples of a block at which :class:`FinalAttitude` gives attitudes.

    They are the first 2048 of the first block, the last of every 32 in the rest of its first tile,
    then of every 256.
    """
    nearest, near = (min(count, NEAREST), min(count, TILE)) if is_first else (0, 0)
    few, others = 1 << NEAR_LEVELS, 1 << LEVELS
    ends = [
        np.arange(1, nearest + 1),
        np.arange(nearest + few, near + few, few),
        np.arange(near + others, count + others, others),
    ]
    return np.minimum(np.concatenate(ends), count) - 1


class _BelowQuintic(FinalAttitude):
    """The attitudes by ``cubic``, or ``coning`` over intervals where ``quintic`` is ``cubic``.

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
