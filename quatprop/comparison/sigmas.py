"""Errors in standard deviations: whether they are as large as the series themselves expect."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from quatprop.kinematics.quaternion import conjugate, log, multiply
from quatprop.series import blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Pairs
    from quatprop.series import AttitudeSeries

    Float64 = NDArray[np.float64]
    Int64 = NDArray[np.int64]

RELATIVE_FLOOR = 1e-9
"""Standard deviations below this share of the largest are taken as that: no attitude is known
better about one axis than about another by more."""


@dataclass(frozen=True, slots=True)
class SigmaStatistics:
    """Errors e in standard deviations, sqrt(e' P^-1 e / 3): near 1 where the covariance P is right.

    Parameters
    ----------
    max, rms, p95
        Over the pairs that have a covariance; p95 is the 95th percentile.
    final
        Of the last of them.
    expected_rad
        The size that the covariances expect of each error, sqrt(trace P), shape ``(N,)``, rad.
    """

    max: float
    rms: float
    p95: float
    final: float
    expected_rad: Float64 = field(compare=False, repr=False)


def sigma_statistics(
    a: AttitudeSeries, b: AttitudeSeries, pairs: Pairs, alignment: Alignment
) -> SigmaStatistics | None:
    """Return the errors of pairs in standard deviations; None where no pair has any.

    Parameters
    ----------
    a, b
        The series, in order of time. Where both have covariances they are independent.
    pairs
        Attitudes of A and B at the same times.
    alignment
        How B is rotated.
    """
    known = [(one.t_ns, one.covariance) for one in (a, b) if one.covariance is not None]
    squares, traces = [np.zeros(0)], [np.zeros(0)]
    for rows in blocks(len(pairs) if known else 0):
        covariance = np.zeros((len(pairs.t_ns[rows]), 3, 3))
        for t_ns, covariances in known:
            covariance += _interpolated(t_ns, covariances, pairs.t_ns[rows])
        trace = np.trace(covariance, axis1=1, axis2=2)
        traces.append(trace)
        # The first attitude is exact.
        uncertain = trace > 0
        aligned = alignment.apply(pairs.b[rows])
        step = multiply(conjugate(pairs.a[rows]), aligned)[uncertain]
        error = log(step * np.where(step[:, :1] < 0, -1.0, 1.0))
        floor = RELATIVE_FLOOR**2 * trace[uncertain, None, None] * np.eye(3)
        weighted = np.linalg.solve(covariance[uncertain] + floor, error[..., None])[..., 0]
        squares.append(np.einsum("ij,ij->i", error, weighted) / 3)
    sigmas = np.sqrt(np.concatenate(squares))
    if not len(sigmas):
        return None
    return SigmaStatistics(
        max=float(sigmas.max()),
        rms=float(np.sqrt(np.mean(sigmas**2))),
        p95=float(np.percentile(sigmas, 95)),
        final=float(sigmas[-1]),
        expected_rad=np.sqrt(np.concatenate(traces)),
    )


def _interpolated(t_ns: Int64, covariances: Float64, wanted_ns: Int64) -> Float64:
    """Return covariances at wanted times, ``(N, 3, 3)``, linear in between."""
    wanted, known = (np.asarray(times - t_ns[0], np.float64) for times in (wanted_ns, t_ns))
    columns = covariances.reshape(-1, 9).T
    values = [np.interp(wanted, known, column) for column in columns]
    return np.stack(values, axis=1).reshape(-1, 3, 3)
