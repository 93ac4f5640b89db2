"""Propagation: composes the steps of all intervals to attitudes, tile by tile.

Tiles begin at fixed sample indices, and the tree is the same for a partly filled tile, so the bits
of the result depend neither on batches nor on later samples: the attitudes of the first samples are
those of the whole log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.errors import SeriesError
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.array_conversion import rows_of, stamps_of
from quatprop.kinematics.increments import AFTER, BEFORE, is_inertial, rotation_vectors
from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    log,
    multiply,
    normalize,
    product_scan,
    shorter,
    tile_steps,
    write_rows,
)
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import BLOCK, reblock, with_next
from quatprop.settings.quantities import LOOK_AHEAD

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike

    from quatprop.base.arrays import Float64, Int64
    from quatprop.kinematics.quaternion import Pairs, Wxyz


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


class StepComposer:
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


class Propagation(StepComposer):
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
        raise SeriesError("Expected `q0` to be a nonzero quaternion, got all zeros")
    return normalize(q)


# The kinematic equation and its inverse: quaternion rates and body or inertial rates.
#
# q' = q w_B / 2 = w_I q / 2 (eqs. 12 and 16), with a rate as a quaternion without scalar part.


def quaternion_rate(q: ArrayLike, rate: ArrayLike, *, rates: str = "body") -> Float64:
    """Return q', the derivative of an attitude with respect to time.

    `q`: attitudes wxyz body -> reference, shape ``(..., 4)``
    `rate`: angular rates, shape ``(..., 3)``, rad/s
    `rates`: frame in which the rates are resolved: ``"body"``, multiplied on the right of q, or
        ``"inertial"``, on its left
    `Returns`: shape ``(..., 4)``, 1/s

    References
    ----------
    Body rates eqs. 12 to 14; inertial rates eqs. 16 to 18.
    """
    vector = np.asarray(rate, dtype=np.float64)[..., None]
    return np.asarray((rate_matrix(q, rates=rates) @ vector)[..., 0])


def rate_matrix(q: ArrayLike, *, rates: str = "body") -> Float64:
    """Return the matrix M with q' = M w and, with its transpose, w = 4 M^T q'.

    `Returns`: shape ``(..., 4, 3)``

    References
    ----------
    Body rates eq. 27, inertial rates eq. 28.
    """
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    # Inertial rates multiply on the left: the cross product has the opposite sign.
    a, b, c = (-x, -y, -z) if is_inertial(rates) else (x, y, z)
    rows = [[-x, -y, -z], [w, -c, b], [c, w, -a], [-b, a, w]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) / 2


def omega_matrix(rate: ArrayLike, *, rates: str = "body") -> Float64:
    """Return the skew-symmetric matrix Omega with q' = Omega q / 2, q a column w, x, y, z.

    `Returns`: shape ``(..., 4, 4)``, rad/s

    References
    ----------
    Body rates eqs. 23 and 24, inertial rates eqs. 25 and 26.
    """
    x, y, z = np.moveaxis(np.asarray(rate, dtype=np.float64), -1, 0)
    o = np.zeros_like(x)
    a, b, c = (-x, -y, -z) if is_inertial(rates) else (x, y, z)
    rows = [[o, -x, -y, -z], [x, o, c, -b], [y, -c, o, a], [z, b, -a, o]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rate_of(q: ArrayLike, q_rate: ArrayLike, *, rates: str = "body") -> Float64:
    """Return the angular rate of an attitude and its derivative: eq. 12 or 16 solved for w.

    `q`: unit quaternions wxyz body -> reference, shape ``(..., 4)``
    `q_rate`: their derivatives, shape ``(..., 4)``, 1/s
    `rates`: frame in which to resolve the rates: ``"body"``, 2 q* q', or ``"inertial"``, 2 q' q*
    `Returns`: shape ``(..., 3)``, rad/s
    """
    inverse = conjugate(q)
    turned = multiply(q_rate, inverse) if is_inertial(rates) else multiply(inverse, q_rate)
    return 2 * turned[..., 1:]


def rates_between(t_ns: Int64, wxyz: ArrayLike, *, rates: str = "body") -> Float64:
    """Return the constant rates from each attitude to the next, by the shorter rotation.

    Propagation by the method ``start`` from the first attitude reproduces the attitudes.

    `t_ns`: increasing timestamps, shape ``(N,)``, int64, ns
    `wxyz`: unit quaternions body -> reference, shape ``(N, 4)``
    `rates`: frame in which to resolve the rates: ``"body"`` or ``"inertial"``
    `Returns`: shape ``(N - 1, 3)``, rad/s: row k is the rate from sample k to sample k + 1

    References
    ----------
    Eqs. 33 and 36 solved for the rate.
    """
    t_ns = stamps_of("t_ns", t_ns)
    q = rows_of("wxyz", wxyz, len(t_ns), 4)
    seconds = np.diff(t_ns)[:, None] / NS_PER_S
    return np.asarray(rotation_vectors_between(q, rates=rates) / seconds)


def rotation_vectors_between(wxyz: ArrayLike, *, rates: str = "body") -> Float64:
    """Return the rotation vectors from each attitude to the next, by the shorter rotation.

    `Returns`: shape ``(N - 1, 3)``, rad
    """
    q = np.asarray(wxyz, dtype=np.float64)
    before, after = q[:-1], q[1:]
    inertial = is_inertial(rates)
    step = multiply(after, conjugate(before)) if inertial else multiply(conjugate(before), after)
    return log(shorter(step))
