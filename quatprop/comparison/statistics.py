"""Statistics of errors: over the pairs, over windows, and in standard deviations."""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.kinematics.quaternion import (
    conjugate,
    geodesic_angle,
    log,
    multiply,
    reference_covariance,
    shorter,
)
from quatprop.kinematics.time_series import blocks, rms
from quatprop.settings.command_options import BY_ALL
from quatprop.timeline.stamps import GAP_FACTOR, MEDIAN_WINDOW

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64, Int64
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs
    from quatprop.kinematics.series import AttitudeSeries


S_PER_H = 3600.0

RELATIVE_FLOOR = 1e-7
"""Standard deviations below this share of the largest are rounding errors, and taken as 0."""

ROUNDING_RAD = 1e-9
"""With standard deviation 0, errors up to this are rounding errors."""


class ErrorStatistics(NamedTuple):
    """Statistics of the geodesic error over all judged pairs, rad.

    Parameters
    ----------
    max
        Largest error, rad.
    rms
        Root mean square of the errors, rad.
    mean
        Mean error, rad.
    median
        Median error, rad.
    p95
        95th percentile of the errors, rad.
    final
        Error of the last pair, rad.
    """

    max: float
    rms: float
    mean: float
    median: float
    p95: float
    final: float


@dataclass(frozen=True, slots=True)
class WindowStatistics:
    """Errors of rotations over windows of one length, independent of the reference frames.

    `window_ns`: requested length, ns
    `count`: number of windows
    `max_rad`: largest error, rad
    `rms_rad`: root mean square of the errors, rad
    `worst_ns`: start of the window with the largest error, ns
    `begins_ns`, `errors`: start of each window, ns, and its error, rad, shape ``(count,)``
    """

    window_ns: int
    count: int
    max_rad: float
    rms_rad: float
    worst_ns: int
    begins_ns: Int64 = field(compare=False, repr=False)
    errors: Float64 = field(compare=False, repr=False)


def window_statistics(pairs: Pairs, alignment: Alignment, window_ns: int) -> WindowStatistics:
    """Compare the rotations over windows that begin at every pair.

    A window ends at the first pair at least `window_ns` later. If this pair is late by more than a
    median interval, there is a gap, and the window is omitted.

    `alignment`: rotation of B; that of the reference frame has no effect
    `window_ns`: length of the windows, ns
    """
    t_ns = pairs.t_ns
    stop = np.searchsorted(t_ns, t_ns + window_ns)
    start = np.arange(len(t_ns))
    inside = stop < len(t_ns)
    start, stop = start[inside], stop[inside]
    late = t_ns[stop] - t_ns[start] - window_ns
    fits = late <= (np.median(np.diff(t_ns)) if len(late) else 0)
    start, stop = start[fits], stop[fits]
    if not len(start):
        raise ComparisonError(
            f"no two pairs are {duration_text(window_ns)} apart: they span "
            f"{duration_text(int(t_ns[-1] - t_ns[0]))}; choose a shorter {Setting('window')}"
        )
    steps = (multiply(conjugate(q[start]), q[stop]) for q in (pairs.a, alignment.apply(pairs.b)))
    error = geodesic_angle(*steps)
    return WindowStatistics(
        window_ns=window_ns,
        count=len(error),
        max_rad=float(error.max()),
        rms_rad=rms(error),
        worst_ns=int(t_ns[start[np.argmax(error)]]),
        begins_ns=t_ns[start],
        errors=error,
    )


@dataclass(frozen=True, slots=True)
class SigmaStatistics:
    """Errors e in standard deviations: the Mahalanobis distance sqrt(e' P^-1 e), P the covariance.

    An error of n standard deviations about one principal axis of P is n. If P is right, the RMS is
    near sqrt(3), since an error has three components.

    `max`: largest error, over the pairs with a standard deviation above 0; infinite if an error is
        beyond rounding where the standard deviation is 0
    `rms`: root mean square over the same pairs
    `p95`: smallest value that 95 % of the same errors do not exceed
    `final`: error of the last pair
    `max_ns`: time of the largest error, ns
    `one_sigma_rad`: angle of one standard deviation in the direction of each error, shape ``(N,)``,
        rad
    `axes_rad`: standard deviations about the body axes, shape ``(N, 3)``, rad; 0 if unknown

    References
    ----------
    P. C. Mahalanobis, On the generalised distance in statistics, Proceedings of the National
    Institute of Sciences of India 2 (1936) 49-55.
    """

    max: float
    rms: float
    p95: float
    final: float
    max_ns: int
    one_sigma_rad: Float64 = field(compare=False, repr=False)
    axes_rad: Float64 = field(compare=False, repr=False)


def sigma_statistics(
    a: AttitudeSeries, b: AttitudeSeries, pairs: Pairs, alignment: Alignment
) -> SigmaStatistics | None:
    """Return the errors in standard deviations; None if no pair has any."""
    with_covariance = [one for one in (a, b) if one.covariance is not None]
    if not with_covariance:
        return None
    mount = conjugate(alignment.mount_wxyz)
    distances, angles = np.empty((2, len(pairs)))
    is_exact, axes = np.empty(len(pairs), np.bool_), np.empty((len(pairs), 3))
    for rows in blocks(len(pairs)):
        covariance = np.zeros((len(pairs.t_ns[rows]), 3, 3))
        for one in with_covariance:
            part = _interpolated(one, pairs.t_ns[rows])
            # Errors are about A's body axes.
            covariance += reference_covariance(mount, part) if one is b else part
        is_known = np.isfinite(covariance).all(axis=(1, 2))
        covariance[~is_known] = 0.0
        axes[rows] = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        is_exact[rows] = np.trace(covariance, axis1=1, axis2=2) == 0
        if alignment.name in BY_ALL:
            # The alignment is an estimate, so no attitude is exact.
            is_known &= ~is_exact[rows]
        step = multiply(conjugate(pairs.a[rows]), alignment.apply(pairs.b[rows]))
        error = log(shorter(step))
        angles[rows] = np.linalg.norm(error, axis=1)
        distances[rows] = np.where(is_known, _distances(error, covariance), np.nan)
    # Exact attitudes without an error, such as the first, would only lower the statistics.
    counted = (distances > 0) | ~(is_exact | np.isnan(distances))
    (places,) = (counted if counted.any() else ~np.isnan(distances)).nonzero()
    if not len(places):
        return None
    sigmas = distances[places]
    one_sigma = np.divide(angles, distances, out=np.zeros(len(pairs)), where=distances > 0)
    return SigmaStatistics(
        max=float(sigmas.max()),
        rms=float(np.sqrt(np.mean(sigmas**2))),
        p95=float(np.percentile(sigmas, 95, method="inverted_cdf")),
        final=float(sigmas[-1]),
        max_ns=int(pairs.t_ns[places[sigmas.argmax()]]),
        one_sigma_rad=one_sigma,
        axes_rad=axes,
    )


def _distances(error: Float64, covariance: Float64) -> Float64:
    """Return Mahalanobis distances ``(N,)``; infinite for errors about axes of variance 0."""
    variances, axes = np.linalg.eigh(covariance)
    parts = np.einsum("nij,ni->nj", axes, error)
    is_exact = variances <= RELATIVE_FLOOR**2 * variances[:, -1:]
    squares = np.where(np.abs(parts) > ROUNDING_RAD, np.inf, 0.0)
    np.divide(parts**2, variances, out=squares, where=~is_exact)
    distances: Float64 = np.sqrt(squares.sum(axis=1))
    return distances


def _interpolated(series: AttitudeSeries, wanted_ns: Int64) -> Float64:
    """Return the covariances of a series interpolated linearly, ``(N, 3, 3)``."""
    t_ns, covariances = series.t_ns, np.asarray(series.covariance)
    wanted, given = (np.asarray(times - t_ns[0], np.float64) for times in (wanted_ns, t_ns))
    columns = covariances.reshape(-1, 9).T
    values = [np.interp(wanted, given, column) for column in columns]
    return np.stack(values, axis=1).reshape(-1, 3, 3)


# Components of attitude errors: heading, inclination, and rotations about the reference axes.
#
# Gravity makes roll and pitch observable, but not heading. The rotation from B's attitude to A's,
# resolved in the reference frame with z as the vertical, is a rotation about a level axis
# (inclination) followed by one about the vertical (heading).


class Extent(NamedTuple):
    """Largest magnitude and root mean square of an error, rad.

    `max`: largest magnitude, rad
    `rms`: root mean square, rad
    """

    max: float
    rms: float


class ErrorParts(NamedTuple):
    """Components of the errors.

    `heading`: rotation about the vertical
    `inclination`: angle between the verticals
    `about_x`: component of the rotation vector about the reference x axis
    `about_y`: component of the rotation vector about the reference y axis
    `about_z`: component of the rotation vector about the reference z axis
    """

    heading: Extent
    inclination: Extent
    about_x: Extent
    about_y: Extent
    about_z: Extent


def error_parts(pairs: Pairs, alignment: Alignment) -> ErrorParts:
    """Return the components of the errors.

    References
    ----------
    D. Laidig et al., "BROAD - A benchmark for robust inertial orientation estimation", Data 6
    (2021) 72: heading 2 atan |z / w|, inclination 2 acos sqrt(w^2 + z^2).
    """
    largest, squares = np.zeros(5), np.zeros(5)
    for rows in blocks(len(pairs)):
        step = shorter(multiply(pairs.a[rows], conjugate(alignment.apply(pairs.b[rows]))))
        w, x, y, z = step.T
        heading = 2 * np.arctan2(np.abs(z), w)
        inclination = 2 * np.arctan2(np.hypot(x, y), np.hypot(w, z))
        parts = np.column_stack([heading, inclination, np.abs(log(step))])
        largest = np.maximum(largest, parts.max(axis=0))
        squares += (parts**2).sum(axis=0)
    rms = [math.sqrt(total / len(pairs)) for total in squares.tolist()]
    return ErrorParts(*map(Extent, largest.tolist(), rms))


# Errors of pairs of attitudes, accumulated block by block: size, drift, and the worst pair.


PIECE = 16_384
"""Number of pairs measured at once: their arrays fit into the cache."""


@dataclass(frozen=True, slots=True)
class ComparedSample:
    """One pair of attitudes and its error.

    `t_ns`: its time in A's clock, ns
    `at`: the series with this sample: ``"A"`` or ``"B"``
    `index`: index of the sample, in order of time
    `error_rad`: its error, rad
    """

    t_ns: int
    at: str
    index: int
    error_rad: float


class CoveredTime:
    """The time covered by timestamps, without gaps, accumulated block by block.

    `first_ns`, `last_ns`: first and last timestamp so far, ns
    """

    def __init__(self) -> None:
        self.first_ns = self.last_ns = 0
        self._intervals: list[Int64] = []
        self._limit: float | None = None
        self._ns = 0

    @classmethod
    def between(cls, t_ns: Int64) -> Self:
        """Return the time covered by the timestamps of a series."""
        covered = cls()
        for rows in blocks(len(t_ns)):
            covered.add(t_ns[rows])
        return covered

    def add(self, t_ns: Int64) -> None:
        """Add the next timestamps, shape ``(N,)``, N > 0, ns, in rising order."""
        if not self._intervals:
            self.first_ns = self.last_ns = int(t_ns[0])
        self._intervals.append(np.diff(t_ns, prepend=np.int64(self.last_ns)))
        self.last_ns = int(t_ns[-1])
        if self._limit is not None or sum(map(len, self._intervals)) > MEDIAN_WINDOW:
            self._count()

    def _count(self) -> None:
        intervals = np.concatenate(self._intervals)
        if self._limit is None:
            # The first interval is from the first timestamp to itself.
            usual = intervals[1 : MEDIAN_WINDOW + 1]
            self._limit = GAP_FACTOR * float(np.median(usual)) if len(usual) else 0.0
        self._ns += int(intervals[intervals <= self._limit].sum())
        self._intervals = [intervals[:0]]

    def share_of(self, reference: CoveredTime) -> float:
        """Return the percentage of the time of a reference that is covered."""
        return min(100 * self.ns / reference.ns, 100.0) if reference.ns else 100.0

    @property
    def ns(self) -> int:
        """The time covered so far, ns."""
        if self._intervals:
            self._count()
        return self._ns


class ErrorAccumulator:
    """Accumulates the errors of pairs of attitudes.

    The result does not depend on how pairs are divided into blocks.

    `at`: the series whose timestamps the pairs have: ``"A"`` or ``"B"``
    `limit`: maximum error that passes, rad
    `opposite_signs`: number of pairs of quaternions with a negative dot product
    `worst`: the pair with the largest error
    `first_exceeding`: the first pair with an error above the limit
    """

    def __init__(self, at: str, alignment: Alignment, limit: float) -> None:
        self.alignment = alignment
        self.opposite_signs = 0
        self.worst = ComparedSample(0, at, 0, -1.0)
        self.first_exceeding: ComparedSample | None = None
        self.covered = CoveredTime()
        self._limit = limit
        self._errors = array("d")
        self._block_ns = np.empty(PIECE, np.int64)
        self._filled = 0
        self._total = self._squares = 0.0
        # Means of time, h, and error; sums of squares and products of the differences from them.
        self._means, self._moments = np.zeros(2), np.zeros(2)

    def __len__(self) -> int:
        return len(self._errors)

    def add(self, t_ns: Int64, index: Int64, a: Float64, b: Float64) -> None:
        """Measure the next pairs."""
        start = 0
        while start < len(t_ns):
            rows = slice(start, min(start + PIECE - self._filled, len(t_ns)))
            self._add(t_ns[rows], index[rows], a[rows], b[rows])
            start = rows.stop

    def _add(self, t_ns: Int64, index: Int64, a: Float64, b: Float64) -> None:
        if self.alignment.name != "none":
            b = self.alignment.apply(b)
        errors = geodesic_angle(a, b)
        self.opposite_signs += int(np.count_nonzero(np.einsum("ij,ij->i", a, b) < 0))

        def sample(pair: int) -> ComparedSample:
            at = self.worst.at
            return ComparedSample(int(t_ns[pair]), at, int(index[pair]), float(errors[pair]))

        worst = sample(int(np.argmax(errors)))
        if worst.error_rad > self._limit and self.first_exceeding is None:
            self.first_exceeding = sample(int(np.argmax(errors > self._limit)))
        if worst.error_rad > self.worst.error_rad:
            self.worst = worst
        self.covered.add(t_ns)
        self._errors.frombytes(errors.tobytes())
        self._block_ns[self._filled : self._filled + len(errors)] = t_ns
        self._filled += len(errors)
        if self._filled == PIECE:
            self._flush()

    def _flush(self) -> None:
        """Add the filled part of the block to the sums.

        References
        ----------
        Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm for computing sample
        variances", Stanford STAN-CS-79-773, 1979.
        """
        count, total = self._filled, len(self._errors)
        errors = np.array(self._errors[-count:])
        self._total += float(errors.sum())
        self._squares += float((errors**2).sum())
        hours = (self._block_ns[:count] - self.covered.first_ns) / (NS_PER_S * S_PER_H)
        means = np.array([hours.mean(), errors.mean()])
        hours -= means[0]
        moments = np.array([(hours**2).sum(), (hours * (errors - means[1])).sum()])
        apart = means - self._means
        self._moments += moments + apart[0] * apart * ((total - count) * count / total)
        self._means += apart * (count / total)
        self._filled = 0

    def errors(self) -> Float64:
        """Return the errors, shape ``(N,)``, rad, after the last pair."""
        if self._filled:
            self._flush()
        return np.frombuffer(self._errors)

    def statistics(self, rising: Float64, final: float) -> ErrorStatistics:
        """Return the statistics of the errors.

        `rising`: the errors, sorted, rad
        `final`: the last error, rad
        """
        last = len(rising) - 1
        below = int(0.95 * last)
        around = rising[below : below + 2]
        return ErrorStatistics(
            max=self.worst.error_rad,
            rms=math.sqrt(self._squares / len(rising)),
            mean=self._total / len(rising),
            median=float(np.median(rising[last // 2 : len(rising) // 2 + 1])),
            p95=float(np.interp(0.95 * last, below + np.arange(len(around)), around)),
            final=final,
        )

    @property
    def drift_deg_h(self) -> float | None:
        """Least squares slope of the errors over time, deg/h; None if it is undefined."""
        power, shared = self._moments.tolist()
        if power == 0.0 or self.alignment.name in BY_ALL:
            return None
        return math.degrees(shared / power)
