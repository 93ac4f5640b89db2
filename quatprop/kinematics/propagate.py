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
from quatprop.kinematics.increments import (
    AFTER,
    BEFORE,
    is_inertial,
    rotation_vectors,
    steps_and_lengths,
    windows_over,
)
from quatprop.kinematics.quaternion import (
    IDENTITY,
    LEVELS,
    PADDING,
    compose_pairs,
    conjugate,
    geodesic_angle,
    log,
    multiply,
    normalize,
    product_loop,
    product_scan,
    shorter,
    tile_steps,
    unit,
    write_rows,
)
from quatprop.kinematics.series import BLOCK, AttitudeSeries, GyroSeries, reblock, with_next
from quatprop.settings.quantities import CORRECT_CONING, LOOK_AHEAD

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike, NDArray

    from quatprop.base.arrays import Float64, Int64, Intp
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


class _StepComposer:
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


class Propagation(_StepComposer):
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


class FinalAttitude(_StepComposer):
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


# Sensitivity of the attitudes to the integration rule and to the sampling.
#
# They are computed by two more propagations: with the next better rule, and with every second
# sample. The first shows the error of the rule. The second also reveals a sample rate that is too
# low for all rules, when they agree on a wrong attitude. The largest difference counts: at the last
# sample, a body that turns to and fro may be where all agree.


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
        """Add the next samples: a block of :func:`quatprop.kinematics.series.reblock`.

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
