"""The integration rules: from rates and times to rotation vectors.

Interval k lies between the samples k and k + 1. Its rotation vector is the axis times the angle of
the body's rotation in it, resolved in the body frame at its start.

Sensors that integrate return the integral of the rate over an interval, or its average, instead.
This is not integrated again: about a fixed axis it is the rotation vector, and in general
``coning`` and ``cubic`` add the effect of the rotating axis, from the neighbouring intervals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.errors import UsageError
from quatprop.kinematics.cubic import cross, curvature, curvature_of_averages
from quatprop.kinematics.quintic import quintic, quintic_of_averages, steps_and_lengths
from quatprop.settings.choices import CORRECT_CONING, FRAMES, LOOK_AHEAD
from quatprop.text import listed, quoted
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.arrays import Float64, Int64

    Rule = Callable[[Float64, Float64, Float64], Float64]


def _start(before: Float64, after: Float64, dt: Float64) -> Float64:  # noqa: ARG001  # one signature
    return np.multiply(before, dt, out=_like(before))


def _end(before: Float64, after: Float64, dt: Float64) -> Float64:  # noqa: ARG001  # one signature
    return np.multiply(after, dt, out=_like(after))


def _mean(before: Float64, after: Float64, dt: Float64) -> Float64:
    rotvec = np.add(before, after, out=_like(before))
    rotvec *= dt / 2
    return rotvec


def _coning(before: Float64, after: Float64, dt: Float64) -> Float64:
    # The rate is linear between the samples, so its direction changes and rotations do not commute:
    # mean dt + dt^2/12 w_k x w_k+1. The term is the first of the Magnus series; the next is of
    # fifth order in dt.
    u, v = _start(before, after, dt), _end(before, after, dt)
    rotvec = np.add(u, v, out=_like(u))
    rotvec *= 0.5
    term = cross(u, v)
    term /= 12
    rotvec += term
    return rotvec


RULES: Final[dict[str, Rule]] = {
    "start": _start,
    "end": _end,
    "mean": _mean,
    "coning": _coning,
    "cubic": _coning,
    "quintic": _coning,
}
"""Integration rules. Arguments are the rates at the start and at the end of intervals, ``(3, M)``,
rad/s, and their lengths, ``(M,)``, s; the result is rotation vectors, ``(3, M)``, rad. For
``cubic``, :mod:`quatprop.kinematics.cubic` adds the terms of neighbouring samples; ``quintic`` is
``cubic`` if :mod:`quatprop.kinematics.quintic` has too few of them."""


def is_inertial(rates: str) -> bool:
    """Return whether rates are resolved in the inertial frame.

    `rates`: one of :data:`quatprop.settings.FRAMES`
    """
    if rates not in FRAMES:
        raise UsageError(f"there is no frame {quoted(rates)}; choose one of {listed(FRAMES)}")
    return rates == "inertial"


def rotation_vectors(
    t_ns: Int64,
    rate: Float64,
    method: str = "start",
    integration_time_ns: Int64 | None = None,
    *,
    is_interval_average: bool = False,
) -> Float64:
    """Return the rotation vectors between neighbouring samples.

    `t_ns`: timestamps, shape ``(N,)``, int64, ns. Intervals are differences of integers, so they
        are exact for any epoch
    `rate`: angular rates, shape ``(N, 3)``, rad/s, resolved in the body frame. For rates w resolved
        in the inertial frame, -w are body rates of the reference as seen from the body
    `method`: a key of :data:`RULES`: ``"start"``, the rate from k to k + 1 is that of sample k;
        ``"end"``, that of sample k + 1; ``"mean"``, the average of the two; ``"coning"``, linear
        between the two, mean dt + dt^2/12 w_k x w_k+1: of fourth order where the rate is linear, of
        second order elsewhere; ``"cubic"``, a cubic through the samples k - 1 to k + 2, of fourth
        order, see :func:`quatprop.kinematics.cubic.curvature`; ``"quintic"``, a quintic through
        the samples k - 2 to k + 3, of sixth order, see :mod:`quatprop.kinematics.quintic`
    `integration_time_ns`: for increments: the integration time of each, shape ``(N,)``, int64, ns,
        as in :class:`quatprop.series.GyroSeries`. The rotation in interval k is then the increment
        theta_k of sample k + 1, whatever the length of the interval; zero at a repeated timestamp,
        which is that of a repeated message
    `is_interval_average`: whether rates are averages over the intervals that end at their
        timestamps: theta_k is then the rate of sample k + 1 times the length of the interval. For
        increments with ``"start"``, ``"mean"`` and ``"end"``, and averages with ``"end"``, the
        rotation vector is theta_k. ``"coning"`` adds theta_k-1 x theta_k / 12, and is of third
        order; ``"cubic"`` adds (theta_k-1 x theta_k + theta_k x theta_k+1) / 24, and is of fourth
        order. The weights are those of equal intervals; see
        :func:`quatprop.kinematics.cubic.curvature_of_averages`. ``"quintic"`` is of sixth order
    `Returns`: rotation vectors, shape ``(N - 1, 3)``, rad; each of the three columns is contiguous

    References
    ----------
    Eq. 7; a constant rate over the interval as in eqs. 32 to 36.
    """
    if integration_time_ns is not None or (is_interval_average and method not in {"start", "mean"}):
        return _integrated(t_ns, rate.T, method, integration_time_ns).T
    dt = (t_ns[1:] - t_ns[:-1]) / NS_PER_S
    rotvec = RULES[method](rate[:-1].T, rate[1:].T, dt)
    if method in LOOK_AHEAD:
        rotvec += curvature(t_ns, rate.T).rotation(dt)
    if method == "quintic":
        quintic(t_ns, rate.T).replace(rotvec, dt)
    return rotvec.T


def _integrated(
    t_ns: Int64, rate: Float64, method: str, integration_time_ns: Int64 | None
) -> Float64:
    """Return the rotation vectors of averages or increments, ``(3, N - 1)``, rad."""
    average = rate[:, 1:]
    dt = steps_and_lengths(t_ns, integration_time_ns)[1] / NS_PER_S
    rotvec = _end(rate[:, :-1], average, dt)
    if method in CORRECT_CONING:
        curvature = curvature_of_averages(
            t_ns, rate, integration_time_ns, causal=method == "coning"
        )
        rotvec += curvature.rotation_of_averages(average, dt)
    if method == "quintic":
        quintic_of_averages(t_ns, rate, integration_time_ns).replace(rotvec, dt)
    return rotvec


def _like(rows: Float64) -> Float64:
    """Return an empty array ``(3, M)`` in C order, rather than that of the transposed input."""
    return np.empty(rows.shape)
