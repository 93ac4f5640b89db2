"""Statistics of an error in time: how large it is, and how fast it grows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, multiply
from quatprop.series import blocks
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs

    Int64 = NDArray[np.int64]
    Float64 = NDArray[np.float64]

NS_PER_S = 1e9
S_PER_H = 3600.0


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Size of an error, rad.

    Parameters
    ----------
    max, rms, mean, median, p95
        Over all pairs; p95 is the 95th percentile.
    final
        Of the last pair.
    """

    max: float
    rms: float
    mean: float
    median: float
    p95: float
    final: float


@dataclass(frozen=True, slots=True)
class WindowStatistics:
    """Errors of the rotations over windows of one length, which frames and drift do not affect.

    Parameters
    ----------
    window_ns
        The length asked for, ns.
    count
        How many windows.
    max_rad, rms_rad
        Size of their errors, rad.
    worst_ns
        Where the worst begins, ns.
    """

    window_ns: int
    count: int
    max_rad: float
    rms_rad: float
    worst_ns: int


def geodesic_errors(pairs: Pairs, alignment: Alignment) -> tuple[Float64, int]:
    """Return the errors of pairs, and how many of them have quaternions of opposite signs.

    Parameters
    ----------
    pairs
        Attitudes of A and B at the same times.
    alignment
        How B is rotated.

    Returns
    -------
    error : ndarray
        Geodesic angles, rad, shape ``(N,)``.
    opposite : int
        Pairs of which the dot product is negative.
    """
    error, opposite = np.empty(len(pairs)), 0
    for rows in blocks(len(pairs)):
        a, b = pairs.a[rows], alignment.apply(pairs.b[rows])
        error[rows] = geodesic_angle(a, b)
        opposite += int(np.count_nonzero(np.einsum("ij,ij->i", a, b) < 0))
    return error, opposite


def error_statistics(error: Float64) -> ErrorStatistics:
    """Return the statistics of errors, rad, shape ``(N,)`` with at least one."""
    return ErrorStatistics(
        max=float(error.max()),
        rms=rms(error),
        mean=float(error.mean()),
        median=float(np.median(error)),
        p95=float(np.percentile(error, 95)),
        final=float(error[-1]),
    )


def rms(error: Float64) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt((error**2).mean()))


def drift_deg_h(t_ns: Int64, error: Float64) -> float | None:
    """Return the least squares slope of errors (rad) in time, deg/h; None if stamps are equal."""
    hours = (t_ns - t_ns[0]) / (NS_PER_S * S_PER_H)
    hours -= hours.mean()
    power = float((hours**2).sum())
    if power == 0.0:
        return None
    return float(np.degrees((hours * (error - error.mean())).sum() / power))


def window_statistics(t_ns: Int64, a: Float64, b: Float64, window_ns: int) -> WindowStatistics:
    """Compare the rotations over windows that begin at every pair.

    A window ends at the first pair that is `window_ns` later or more; where that is more than a
    median interval too late, there is a gap, and no window.

    Parameters
    ----------
    t_ns
        Times, shape ``(N,)``, rising.
    a, b
        Unit quaternions wxyz in the same body frame, shape ``(N, 4)``; their reference frames do
        not matter.
    window_ns
        Length of the windows, ns.

    Raises
    ------
    ComparisonError
        No two pairs are so far apart.
    """
    stop = np.searchsorted(t_ns, t_ns + window_ns)
    start = np.arange(len(t_ns))
    inside = stop < len(t_ns)
    start, stop = start[inside], stop[inside]
    late = t_ns[stop] - t_ns[start] - window_ns
    fits = late <= np.median(np.diff(t_ns))
    start, stop = start[fits], stop[fits]
    if not len(start):
        raise ComparisonError(
            f"no two pairs are {duration_text(window_ns)} apart: they span "
            f"{duration_text(int(t_ns[-1] - t_ns[0]))}; choose a shorter ",
            Setting("window"),
        )
    error = geodesic_angle(_rotations(a, start, stop), _rotations(b, start, stop))
    return WindowStatistics(
        window_ns=window_ns,
        count=len(error),
        max_rad=float(error.max()),
        rms_rad=rms(error),
        worst_ns=int(t_ns[start[np.argmax(error)]]),
    )


def _rotations(q: Float64, start: Int64, stop: Int64) -> Float64:
    return multiply(conjugate(q[start]), q[stop])
