"""Rates to attitudes: every step multiplied up, tile by tile.

A sequential loop of q[k+1] = q[k] dq[k] (eq. 36) is slow in numpy, one sample at a time. But the
product is associative, so a tile of samples is multiplied up as a tree: neighbouring steps are
joined to steps over two intervals, those to steps over four, and so on; then the attitudes between
are filled in on the way back. Every level is a handful of numpy calls, and rounding errors grow
with the depth of the tree instead of its width.

Inside, a quaternion w + xi + yj + zk is a pair of complex numbers, a = w + xi and b = y + zi,
arrays ``(2, n)``: the product (a c - b d*, a d + b c*) then takes four complex multiplications.

Tiles begin at fixed sample indices, so the result is the same to the bit however the samples
arrived.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.errors import SeriesError, UsageError
from quatprop.kinematics.increments import rotation_vectors, rule_of
from quatprop.kinematics.quaternion import IDENTITY, conjugate, half_angle, normalize
from quatprop.series import BLOCK, AttitudeSeries, GyroSeries, reblock
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike, NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]
    Pairs = NDArray[np.complex128]

FRAMES: Final = ("body", "inertial")
"""Where rates may be resolved: body rates multiply on the right, inertial rates on the left."""

TILE: Final = BLOCK // 8
"""Samples multiplied up together: few enough for the L2 cache, many enough for cheap calls."""

SERIAL: Final = 8
"""So few steps are multiplied up by a loop: faster than more levels, but errors add along it."""


def propagate(
    batches: Iterable[GyroSeries],
    *,
    q0: ArrayLike = IDENTITY,
    method: str = "start",
    rates: str = "body",
) -> Iterator[AttitudeSeries]:
    """Multiply a stream of rates up to attitudes.

    Parameters
    ----------
    batches
        Samples in order of time, in batches of any size. The result does not depend on where
        batches end.
    q0
        Attitude body -> reference at the first sample, wxyz, shape ``(4,)``; it is normalised.
    method
        Which samples rule an interval: a key of :data:`quatprop.kinematics.increments.METHODS`.
    rates
        The frame in which the rates are resolved: ``"body"`` multiplies on the right,
        q[k+1] = q[k] dq[k]; ``"inertial"`` multiplies on the left, q[k+1] = dq[k] q[k].

    Returns
    -------
    iterator of AttitudeSeries
        Unit quaternions body -> reference, in blocks: one attitude for every sample, the first of
        them q0. Nothing where there are no samples.

    Raises
    ------
    SeriesError
        `q0` is not a quaternion that can be normalised, or, while iterating, an attitude is not
        finite.
    UsageError
        No such method or frame.

    References
    ----------
    Body rates eqs. 32, 35 and 36; inertial rates eq. 33.
    """
    run = Propagation(q0, method, rates)
    return (AttitudeSeries(block.t_ns, run.advance(block)) for block in reblock(batches))


def attitudes(
    t_ns: Int64,
    rate: Float64,
    *,
    q0: ArrayLike = IDENTITY,
    method: str = "start",
    rates: str = "body",
) -> Float64:
    """Multiply rates in memory up to attitudes: :func:`propagate` without a stream, bit for bit.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``, int64, ns.
    rate
        Angular rates, shape ``(N, 3)``, rad/s.
    q0, method, rates
        As for :func:`propagate`.

    Returns
    -------
    ndarray
        Unit quaternions wxyz body -> reference, shape ``(N, 4)``; the first is q0.

    Raises
    ------
    SeriesError
        The arrays do not fit, `q0` is not a quaternion, or an attitude is not finite.
    UsageError
        No such method or frame.

    Examples
    --------
    A quarter of a turn about z in half a second:

    >>> t_ns = np.array([0, 500_000_000])
    >>> attitudes(t_ns, np.array([[0, 0, np.pi], [0, 0, np.pi]])).round(6)
    array([[1.      , 0.      , 0.      , 0.      ],
           [0.707107, 0.      , 0.      , 0.707107]])
    """
    # The C library hands memory back to the system after every tile, and asks for it again page by
    # page, until it has seen one large array freed. This costs nothing, and saves a third.
    np.empty((BLOCK, 4))
    return Propagation(q0, method, rates).advance(GyroSeries(t_ns, rate))


class Propagation:
    """What is carried from tile to tile: the last sample and the last attitude.

    Parameters
    ----------
    q0, method, rates
        As for :func:`propagate`.

    Notes
    -----
    Inertial rates need no product of their own. The conjugate of q[k+1] = dq[k] q[k] is
    q*[k+1] = q*[k] dq*[k], so the conjugate attitude is propagated, with the opposite rate.
    """

    def __init__(self, q0: ArrayLike, method: str, rates: str) -> None:
        if rates not in FRAMES:
            raise UsageError(f"there is no frame {quoted(rates)}; choose one of {listed(FRAMES)}")
        rule_of(method)
        self._method = method
        self._inertial = rates == "inertial"
        q0 = unit_q0(q0)
        self._attitude: Pairs = (conjugate(q0) if self._inertial else q0).view(np.complex128)
        self._sample: GyroSeries | None = None
        self._count = 0

    def advance(self, series: GyroSeries) -> Float64:
        """Return the attitudes of the next samples, wxyz, shape ``(N, 4)``.

        Parameters
        ----------
        series
            Samples that follow the last ones: a block of :func:`quatprop.series.reblock`, so that
            tiles begin at fixed sample indices.

        Raises
        ------
        SeriesError
            An attitude is not finite.
        """
        rows = np.empty((len(series), 4))
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(series), TILE):
                stop = start + TILE
                self._advance_tile(self._with_previous(series, start, stop), rows[start:stop])
        if len(series):
            self._sample = series[np.array([len(series) - 1])]
        return rows

    def _advance_tile(self, samples: GyroSeries, rows: Float64) -> None:
        rate = 0.0 - samples.rate if self._inertial else samples.rate
        steps = _steps(rotation_vectors(samples.t_ns, rate, self._method, samples.span_ns))
        _write_rows(_product_scan(self._attitude, steps)[:, 1:], rows)
        self._attitude = rows[-1].copy().view(np.complex128)
        if not np.isfinite(rows[-1]).all():
            first = self._count + int(np.isfinite(rows).all(axis=1).argmin())
            raise SeriesError(
                f"The attitude of sample {first} is not finite; rates must be finite, and their "
                "squares too"
            )
        self._count += len(rows)
        if self._inertial:
            for component in rows.T[1:]:
                # Not a negation: that would write zeros as -0.
                np.subtract(0.0, component, out=component)

    def _with_previous(self, series: GyroSeries, start: int, stop: int) -> GyroSeries:
        """Return the samples of a tile and the one before them."""
        if start:
            return series[start - 1 : stop]
        # Before the very first sample comes itself: a step of no time leads to it.
        return GyroSeries.joined([self._sample or series[:1], series[:stop]])


def unit_q0(q0: ArrayLike) -> Float64:
    """Return an initial attitude wxyz, ``(4,)``, scaled to unit length.

    Raises
    ------
    SeriesError
        It is not four finite numbers with a direction.
    """
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


def _steps(rotvec: Float64) -> Pairs:
    """Return the unit quaternions of rotation vectors ``(n, 3)`` (eq. 35)."""
    x, y, z = rotvec.T
    cosine, ratio = half_angle(x * x + y * y + z * z)
    steps = np.empty((2, len(x)), np.complex128)
    a, b = steps
    a.real = cosine
    np.multiply(x, ratio, out=a.imag)
    np.multiply(y, ratio, out=b.real)
    np.multiply(z, ratio, out=b.imag)
    return steps


def _product_scan(first: Pairs, steps: Pairs) -> Pairs:
    """Return the attitudes ``(2, n + 1)`` that `n` steps lead through from the first, ``(2,)``."""
    count = steps.shape[1]
    if count <= SERIAL:
        return _product_loop(first, steps)
    even, odd = steps[:, 0::2], steps[:, 1::2]
    double = np.empty_like(odd)
    _multiply(even[:, : odd.shape[1]], odd, out=double)
    every_other = _product_scan(first, double)
    every = np.empty((2, count + 1), np.complex128)
    every[:, 0::2] = every_other
    _multiply(every_other[:, : even.shape[1]], even, out=every[:, 1::2])
    return every


def _product_loop(first: Pairs, steps: Pairs) -> Pairs:
    """Return the same as :func:`_product_scan`, one step after the other."""
    a, b = first.tolist()
    passed = [(a, b)]
    for c, d in steps.T.tolist():
        a, b = a * c - b * d.conjugate(), a * d + b * c.conjugate()
        passed.append((a, b))
    return np.array(passed).T.copy()


def _multiply(p: Pairs, q: Pairs, out: Pairs) -> None:
    """Write the Hamilton products p q: a c - b d* and a d + b c*."""
    (a, b), (c, d), (left, right) = p, q, out
    np.multiply(a, c, out=left)
    term = d.conj()
    term *= b
    left -= term
    np.multiply(a, d, out=right)
    np.conjugate(c, out=term)
    term *= b
    right += term


def _write_rows(pairs: Pairs, rows: Float64) -> None:
    """Write pairs ``(2, n)`` as rows wxyz ``(n, 4)`` of unit length."""
    a, b = pairs
    components = (a.real, a.imag, b.real, b.imag)
    squares = np.zeros(len(rows))
    for component in components:
        squares += np.square(component)
    # 1/sqrt(s), where s differs from 1 by rounding errors only.
    scale = 1.5 - 0.5 * squares
    for component, column in zip(components, rows.T, strict=True):
        np.multiply(component, scale, out=column)
