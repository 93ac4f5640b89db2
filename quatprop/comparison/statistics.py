"""Statistics of errors: over the pairs, over windows, and in standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.comparison.settings import BY_ALL
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, log, multiply, shorter
from quatprop.kinematics.uncertainty import reference_covariance
from quatprop.series.blocks import blocks, rms
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries


S_PER_H = 3600.0

RELATIVE_FLOOR = 1e-7
"""Standard deviations below this share of the largest are rounding errors, and taken as 0."""

ROUNDING_RAD = 1e-9
"""With standard deviation 0, errors up to this are rounding errors."""


class ErrorStatistics(NamedTuple):
    """Statistics of the geodesic error over all judged pairs, rad.

    Parameters
    ----------
    max, rms, mean, median
        Largest, root mean square, mean and median error, rad.
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
    `max_rad`, `rms_rad`: largest and RMS error, rad
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

    `max`, `rms`, `p95`: over the pairs with a standard deviation above 0; p95 is the smallest value
        that 95 % of the errors do not exceed. Infinite if an error is beyond rounding and its
        standard deviation is 0
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
