"""Propagation: composes the steps of all intervals to attitudes, tile by tile.

Tiles begin at fixed sample indices, and the tree is the same for a partly filled tile, so the bits
of the result depend neither on batches nor on later samples: the attitudes of the first samples are
those of the whole log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.errors import SeriesError
from quatprop.kinematics.increments import is_inertial, rotation_vectors
from quatprop.kinematics.product import (
    LEVELS,
    compose_pairs,
    product_loop,
    product_scan,
    tile_steps,
    unit,
    write_rows,
)
from quatprop.kinematics.quaternion import IDENTITY, conjugate, normalize
from quatprop.kinematics.quintic import AFTER, BEFORE
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.series.blocks import BLOCK, reblock, with_next
from quatprop.settings.choices import LOOK_AHEAD

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64, Int64
    from quatprop.kinematics.product import Pairs, Wxyz

TILE: Final = BLOCK // 4
"""Steps composed together: few enough for a large L2 cache, many enough to amortise calls."""


def attitudes(
    t_ns: Int64,
    rate: Float64,
    *,
    q0: ArrayLike = IDENTITY,
    method: str = "start",
    rates: str = "body",
) -> Float64:
    """Return the attitudes of rates in memory.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns
    `rate`: angular rates, shape ``(N, 3)``, rad/s
    `Returns`: unit quaternions wxyz body -> reference, shape ``(N, 4)``; the first is q0

    References
    ----------
    Body rates eqs. 32, 35 and 36; inertial rates eq. 33.
    """
    return Propagation(q0, method, rates).advance(GyroSeries(t_ns, rate))


class _Composition:
    """Computes the steps of consecutive tiles, and holds the current attitude.

    Notes
    -----
    Inertial rates need no product of their own. The conjugate of q[k+1] = dq[k] q[k] is
    q*[k+1] = q*[k] dq*[k], so the conjugate attitude is propagated, with the opposite rate.
    """

    def __init__(self, q0: ArrayLike, method: str, rates: str) -> None:
        self._inertial = is_inertial(rates)
        self._method = method
        q0 = unit_q0(q0)
        self._attitude: Wxyz = tuple((conjugate(q0) if self._inertial else q0).tolist())
        self._before: list[GyroSeries] = []

    def _steps(
        self, series: GyroSeries, following: GyroSeries | None
    ) -> Iterator[tuple[slice, Pairs]]:
        """Yield the slices of tiles, and the steps to their samples, ``(2, n)``."""
        # The first sample is its own predecessor, so that the step to it has zero length.
        previous = GyroSeries.joined(self._before)[-BEFORE:] if self._before else series[:1]
        for start in range(0, len(series), TILE):
            stop = min(start + TILE, len(series))
            # The samples before and after a tile on which its steps depend.
            parts = [series[max(start - BEFORE, 0) : stop + AFTER]]
            first = BEFORE
            if not start:
                parts.insert(0, previous)
                first = len(previous)
            if stop == len(series) and following is not None:
                parts.append(following[:AFTER])
            samples = GyroSeries.joined(parts)
            if self._inertial:
                samples = samples.with_rate(0.0 - samples.rate)
            rotvec = self._rotation_vectors(samples, self._method)
            yield slice(start, stop), tile_steps(rotvec[first - 1 :][: stop - start])
        self._before = [previous, series[-BEFORE:]]

    def _rotation_vectors(self, samples: GyroSeries, method: str) -> Float64:
        return rotation_vectors(
            samples.t_ns,
            samples.rate,
            method,
            samples.integration_time_ns,
            is_interval_average=samples.is_interval_average,
        )


class Propagation(_Composition):
    """Propagates a stream of rates to attitudes.

    `q0`: attitude body -> reference at the first sample, wxyz, shape ``(4,)``; it is normalised
    `method`: integration rule: one of :data:`quatprop.settings.METHODS`
    `rates`: the frame in which the rates are resolved: ``"body"`` multiplies on the right, q[k+1] =
        q[k] dq[k]; ``"inertial"`` multiplies on the left, q[k+1] = dq[k] q[k]

    References
    ----------
    Body rates eqs. 32, 35 and 36; inertial rates eq. 33.
    """

    def __init__(self, q0: ArrayLike, method: str, rates: str) -> None:
        super().__init__(q0, method, rates)
        self._count = 0

    def run(self, batches: Iterable[GyroSeries]) -> Iterator[tuple[GyroSeries, AttitudeSeries]]:
        """Yield the samples in blocks, with their attitudes."""
        look_ahead = self._method in LOOK_AHEAD
        for block, following in with_next(reblock(batches), look_ahead=look_ahead):
            yield block, AttitudeSeries(block.t_ns, self.advance(block, following))

    def advance(self, series: GyroSeries, following: GyroSeries | None = None) -> Float64:
        """Return the attitudes of the next samples, wxyz, shape ``(N, 4)``.

        `following`: the samples after these, of which methods that look ahead use the first; None
            if there are none
        """
        rows = np.empty((4, len(series))).T  # faster by column, here and in writers
        with np.errstate(over="ignore", invalid="ignore"):
            for tile, steps in self._steps(series, following):
                self._fill_tile(steps, rows[tile])
        return rows

    def _fill_tile(self, steps: Pairs, rows: Float64) -> None:
        write_rows(product_scan(self._attitude, steps)[:, 1 : len(rows) + 1], rows)
        self._attitude = tuple(rows[-1].tolist())
        # Values that are not finite spread to all components and to all later attitudes.
        if not np.isfinite(rows[-1, 0]):
            first = self._count + int(np.isfinite(rows[:, 0]).argmin())
            raise SeriesError(
                f"the attitude of sample {first} is not finite; rates must be finite, and their "
                "squares too"
            )
        self._count += len(rows)
        if self._inertial:
            for component in rows.T[1:]:
                # Not a negation, which would change 0.0 to -0.0.
                np.subtract(0.0, component, out=component)


class FinalAttitude(_Composition):
    """Computes only the attitude at the last sample, in less than half the time of all."""

    def __init__(self, q0: ArrayLike, method: str, rates: str) -> None:
        super().__init__(q0, method, rates)
        self._held: GyroSeries | None = None

    def add(self, series: GyroSeries) -> None:
        """Add the next samples: a block, as for :meth:`Propagation.advance`."""
        if not len(series):
            return
        if self._method not in LOOK_AHEAD:
            self._advance(series, None)
            return
        if self._held is not None:
            self._advance(self._held, series)
        self._held = series

    def end(self) -> Float64:
        """Return the attitude at the last sample, wxyz, shape ``(4,)``."""
        if self._held is not None:
            self._advance(self._held, None)
        wxyz = np.array(self._attitude)
        return conjugate(wxyz) if self._inertial else wxyz

    def _advance(self, series: GyroSeries, following: GyroSeries | None) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            # Many calls on short arrays are slow: high in the tree, all tiles are one array.
            parts = [compose_pairs(steps, 3) for _, steps in self._steps(series, following)]
            steps = compose_pairs(np.concatenate(parts, axis=1), LEVELS - 3)
            for start in range(0, steps.shape[1], TILE >> LEVELS):
                tile = steps[:, start : start + (TILE >> LEVELS)]
                self._attitude = unit(product_loop(self._attitude, tile)[-1])


def unit_q0(q0: ArrayLike) -> Float64:
    """Return an initial attitude wxyz, ``(4,)``, scaled to unit length."""
    try:
        q = np.asarray(q0, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SeriesError(f"Expected `q0` to be four numbers w, x, y, z, got {q0!r}") from error
    if q.shape != (4,):
        raise SeriesError(f"Expected `q0` to have shape (4,), got {q.shape}")
    if not np.isfinite(q).all():
        raise SeriesError(f"Expected `q0` to be finite, got {q.tolist()}")
    if not q.any():
        raise SeriesError("Expected `q0` to have a direction, got all zeros")
    return normalize(q)
