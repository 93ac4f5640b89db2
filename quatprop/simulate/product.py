"""Hamilton products for the truth, in the precision of their factors.

Separate from :mod:`quatprop.kinematics.quaternion`: a truth that shares code with the propagation
would share its mistakes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def hamilton(left: NDArray[Any], right: NDArray[Any]) -> NDArray[Any]:
    """Return ``left right``, wxyz, ij = k; shapes ``(..., 4)`` broadcast.

    Written out, because linear algebra libraries round sums differently on different processors.

    Examples
    --------
    >>> hamilton(np.array([0.0, 1, 0, 0]), np.array([0.0, 0, 1, 0]))
    array([0., 0., 0., 1.])
    """
    a, b, c, d = np.moveaxis(left, -1, 0)
    w, x, y, z = np.moveaxis(right, -1, 0)
    return np.stack(
        (
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ),
        axis=-1,
    )


def step(rotvec: NDArray[Any]) -> NDArray[Any]:
    """Return the attitude steps of rotation vectors, rad: source article, equation 35.

    Parameters
    ----------
    rotvec
        Shape ``(N, 3)``.
    """
    half = np.sqrt(np.sum(rotvec * rotvec, axis=-1, keepdims=True)) / 2
    with np.errstate(invalid="ignore"):
        factor = np.where(half > 0, np.sin(half) / (2 * half), 0.5)
    return np.concatenate((np.cos(half), factor * rotvec), axis=-1)


def running_product(steps: NDArray[Any]) -> NDArray[Any]:
    """Return ``steps[0] steps[1] ... steps[k]`` for every k, by doubling.

    Parameters
    ----------
    steps
        Unit quaternions, shape ``(N, 4)``.
    """
    product, reach = steps, 1
    while reach < len(steps):
        product = np.concatenate((product[:reach], hamilton(product[:-reach], product[reach:])))
        reach *= 2
    length = np.sqrt(np.sum(product * product, axis=-1, keepdims=True))
    result: NDArray[Any] = product / length
    return result
