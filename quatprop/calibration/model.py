"""What is estimated: how body rates follow from raw ones, and one clock from the other.

Calibrated rates are w = R (I + U) (w_raw - b), with the bias b in the axes of the raw rates, U upper
triangular and R a rotation. The diagonal of U corrects the scale and the rest of it the angles
between the axes of the sensor, of which z is taken to be right; R is the mounting, from the sensor
to the body whose attitude the reference is. So every matrix of positive determinant is one R (I + U).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import IDENTITY, exp, multiply, normalize, rotation_matrix
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64


class Parameter(NamedTuple):
    """One number that can be estimated.

    `group`, `axis`: what it is, and of which axes
    `limit`: standard deviation above which it is not shown: rad/s, a ratio, rad or s
    """

    group: str
    axis: str
    limit: float


GROUPS: Final = {
    "bias": (("x", "y", "z"), 0.01),
    "scale": (("x", "y", "z"), 0.01),
    "misalignment": (("xy", "xz", "yz"), 0.01),
    "mount": (("x", "y", "z"), 0.02),
    "offset": (("",), 0.01),
    "drift": (("",), 1e-4),
}
"""What can be estimated: its parameters, and their limits. Where the limit is exceeded a data sheet
says more: of MEMS gyroscopes and crystals, the errors are mostly below it."""

PARAMETERS: Final = tuple(
    Parameter(group, axis, limit) for group, (axes, limit) in GROUPS.items() for axis in axes
)
LIMITS: Final = np.array([parameter.limit for parameter in PARAMETERS])
UPPER: Final = ((0, 1), (0, 2), (1, 2))
"""Rows and columns of the misalignment."""


class Model(NamedTuple):
    """Values of all parameters.

    `bias`: b, shape ``(3,)``, rad/s
    `shape`: I + U, shape ``(3, 3)``
    `mount`: R, sensor to body, wxyz, shape ``(4,)``
    `added_ns`: added to the timestamps of the reference, ns, before the offset
    `offset`: added to them in the middle, s
    `drift`: what more is added for each second after it, s
    `middle_ns`: the middle of the reference, in its own clock, ns
    """

    bias: Float64 = np.zeros(3)
    shape: Float64 = np.eye(3)
    mount: Float64 = IDENTITY
    added_ns: int = 0
    offset: float = 0.0
    drift: float = 0.0
    middle_ns: int = 0

    @property
    def matrix(self) -> Float64:
        """R (I + U), shape ``(3, 3)``."""
        return np.asarray(rotation_matrix(self.mount) @ self.shape)

    def moved(self, by: Float64) -> Model:
        """Return the model with something added to all parameters, ``(14,)``; a mounting turned."""
        shape = self.shape + np.diag(by[3:6])
        for place, value in zip(UPPER, by[6:9], strict=True):
            shape[place] += value
        return self._replace(
            bias=self.bias + by[:3],
            shape=shape,
            mount=normalize(multiply(exp(by[9:12]), self.mount)),
            offset=self.offset + float(by[12]),
            drift=self.drift + float(by[13]),
        )

    def times_of(self, t_ns: Int64) -> Int64:
        """Return timestamps of the reference in the clock of the rates, int64 ns."""
        since = (t_ns - self.middle_ns) / NS_PER_S
        moved = np.rint((self.offset + self.drift * since) * NS_PER_S).astype(np.int64)
        return np.asarray(t_ns + self.added_ns + moved)

    def by_rate(self) -> Float64:
        """Return what a change of each parameter but those of the clock does to calibrated rates.

        `Returns`: shape ``(12, 3, 4)``: times 1 and the three components of the rate
        """
        matrix, turn = self.matrix, rotation_matrix(self.mount)
        of_shape = np.linalg.inv(matrix)
        change = np.zeros((12, 3, 4))
        change[:3, :, 0] = -matrix.T
        for row, place in zip(range(3, 9), (*zip(range(3), range(3), strict=True), *UPPER),
                              strict=True):  # fmt: skip
            change[row, :, 1:] = np.outer(turn[:, place[0]], of_shape[place[1]])
        change[9:12, :, 1:] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        return change
