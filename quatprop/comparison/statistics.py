"""Statistics of an error in time: how large it is, and how fast it grows."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, multiply
from quatprop.series import blocks
from quatprop.text import Setting
from quatprop.times import duration_text

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64


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
    begins_ns, errors
        Where each window begins, ns, and its error, rad, shape ``(count,)``.
    """

    window_ns: int
    count: int
    max_rad: float
    rms_rad: float
    worst_ns: int
    begins_ns: Int64 = field(compare=False, repr=False)
    errors: Float64 = field(compare=False, repr=False)


def rms(error: Float64) -> float:
    """Return the root of the mean square."""
    squares = sum(float((error[rows] ** 2).sum()) for rows in blocks(len(error)))
    return math.sqrt(squares / len(error))


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
    fits = late <= (np.median(np.diff(t_ns)) if len(late) else 0)
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
        begins_ns=t_ns[start],
        errors=error,
    )


def _rotations(q: Float64, start: Int64, stop: Int64) -> Float64:
    return multiply(conjugate(q[start]), q[stop])
