"""The kinematic equation and its inverse: quaternion rates and body or inertial rates.

q' = q w_B / 2 = w_I q / 2 (eqs. 12 and 16), with a rate as a quaternion without scalar part.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.kinematics.increments import is_inertial
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.series.columns import rows_of, stamps_of
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64, Int64


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
