"""Fewer attitudes out, or attitudes at other times: exact under the method that propagated them.

Nothing is interpolated between attitudes. Between two samples the method says how the body turns,
so the attitude at a time in between is the one before it times the step over the part of the
interval that has passed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from quatprop.kinematics.increments import METHODS, NANOSECONDS
from quatprop.kinematics.quaternion import conjugate, exp, multiply
from quatprop.series import AttitudeSeries, GyroSeries

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from fractions import Fraction

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

NS_PER_S = 1_000_000_000

PIECE = 1 << 17
"""Times at once: memory is bounded, and products with the period of steady ones fit in 64 bits."""


def every(series: Iterable[AttitudeSeries], step: int) -> Iterator[AttitudeSeries]:
    """Yield every `step`-th attitude, beginning with the first.

    Parameters
    ----------
    series
        Attitudes in batches; the result does not depend on where they end.
    step
        At least 1.
    """
    passed = 0
    for batch in series:
        chosen = slice(-passed % step, None, step)
        passed += len(batch)
        if len(kept := batch.t_ns[chosen]):
            yield AttitudeSeries(kept, batch.wxyz[chosen])


class Times(Protocol):
    """The times at which attitudes are wanted."""

    def up_to(self, first_ns: int, last_ns: int) -> Iterator[Int64]:
        """Yield the wanted times from the last call's `last_ns` on, up to and with this one.

        Parameters
        ----------
        first_ns
            The first sample of the stretch; earlier times have no attitude.
        last_ns
            The last sample read so far.
        """


class Steady:
    """A fixed number of times a second, counted from the first sample.

    Parameters
    ----------
    rate
        Times a second, Hz. The k-th time is k / rate, rounded down to the ns: no drift builds up.
    """

    def __init__(self, rate: Fraction) -> None:
        self._rate, self._per = rate.numerator, rate.denominator * NS_PER_S
        self._origin: int | None = None
        self._next = 0

    def up_to(self, first_ns: int, last_ns: int) -> Iterator[Int64]:
        """Yield the next times; see :class:`Times`."""
        if self._origin is None:
            self._origin = first_ns
        first = max(self._next, -(-(first_ns - self._origin) * self._rate // self._per))
        # floor(k per / rate) <= t is k < (t + 1) rate / per.
        stop = max(first, -(-(last_ns - self._origin + 1) * self._rate // self._per))
        self._next = stop
        for start in range(first, stop, PIECE):
            yield self._times(start, min(start + PIECE, stop))

    def _times(self, start: int, stop: int) -> Int64:
        # The start with Python's integers; only the rest has to fit in 64 bits.
        whole, rest = divmod(start * self._per, self._rate)
        ahead = np.arange(stop - start, dtype=np.int64) * self._per + rest
        return (self._origin or 0) + whole + ahead // self._rate


class Listed:
    """Times that are given.

    Parameters
    ----------
    t_ns
        Stamps, shape ``(N,)``, int64 ns, in order.
    """

    def __init__(self, t_ns: Int64) -> None:
        self._t_ns = t_ns
        self._next = 0

    def up_to(self, first_ns: int, last_ns: int) -> Iterator[Int64]:
        """Yield the next times; see :class:`Times`."""
        first = max(self._next, int(np.searchsorted(self._t_ns, first_ns)))
        stop = max(first, int(np.searchsorted(self._t_ns, last_ns, side="right")))
        self._next = stop
        for start in range(first, stop, PIECE):
            yield self._t_ns[start : min(start + PIECE, stop)]


def at_times(
    propagated: Iterable[tuple[GyroSeries, AttitudeSeries]],
    times: Times,
    *,
    method: str,
    rates: str,
) -> Iterator[AttitudeSeries]:
    """Yield attitudes at the wanted times of one stretch.

    Parameters
    ----------
    propagated
        The samples in order of time, batch by batch, with their attitudes.
    times
        When attitudes are wanted.
    method, rates
        How they were propagated.

    Yields
    ------
    AttitudeSeries
        Attitudes at the wanted times between the first sample and the last; none elsewhere.
    """
    first_ns = None
    last: tuple[GyroSeries, AttitudeSeries] | None = None
    for block, attitudes in propagated:
        first_ns = int(block.t_ns[0]) if first_ns is None else first_ns
        gyro, attitude = _after(last, block, attitudes)
        last = _tail(gyro, attitude)
        for wanted in times.up_to(first_ns, int(gyro.t_ns[-1])):
            yield AttitudeSeries(wanted, _between(gyro, attitude.wxyz, wanted, method, rates))


def _tail(gyro: GyroSeries, attitude: AttitudeSeries) -> tuple[GyroSeries, AttitudeSeries]:
    return (
        gyro[-1:],
        AttitudeSeries(attitude.t_ns[-1:], attitude.wxyz[-1:]),
    )


def _after(
    last: tuple[GyroSeries, AttitudeSeries] | None, gyro: GyroSeries, attitude: AttitudeSeries
) -> tuple[GyroSeries, AttitudeSeries]:
    """Put the last sample of the batch before in front."""
    if last is None:
        return gyro, attitude
    joined = GyroSeries.joined([last[0], gyro])
    wxyz = np.concatenate([last[1].wxyz, attitude.wxyz])
    return joined, AttitudeSeries(joined.t_ns, wxyz)


def _between(gyro: GyroSeries, wxyz: Float64, wanted: Int64, method: str, rates: str) -> Float64:
    """Return the attitudes at wanted times within the samples, ``(M, 4)``."""
    before = np.searchsorted(gyro.t_ns, wanted, side="right") - 1
    after = np.minimum(before + 1, len(gyro) - 1)
    passed = (wanted - gyro.t_ns[before]) / NANOSECONDS
    whole = (gyro.t_ns[after] - gyro.t_ns[before]) / NANOSECONDS
    sign = -1.0 if rates == "inertial" else 1.0
    ruling = sign * gyro.rate[before].T, sign * gyro.rate[after].T
    share = np.divide(passed, whole, out=np.zeros_like(whole), where=whole > 0)
    lasted = passed
    if gyro.span_ns is not None:
        # Of an increment only the whole is known: within it the rate is taken as constant.
        method, lasted = "end", share * (gyro.span_ns[after] / NANOSECONDS)
    elif method == "coning":
        # A rate that is linear in time has got part of the way to the next sample's.
        ruling = ruling[0], ruling[0] + share * (ruling[1] - ruling[0])
    steps = exp(METHODS[method](*ruling, lasted).T)
    if rates == "inertial":
        turned = conjugate(multiply(conjugate(wxyz[before]), steps))
    else:
        turned = multiply(wxyz[before], steps)
    # At a sample itself the attitude is the sample's, to the bit.
    exactly: Float64 = np.where((passed == 0)[:, None], wxyz[before], turned)
    return exactly
