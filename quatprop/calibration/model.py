"""The model of a gyroscope and of two clocks, and its parameters.

Calibrated rates are w = R (I + U) (w_raw - b). The bias b is in the axes of the raw rates. U is
upper triangular: its diagonal corrects the scale, the elements above it the angles between the axes
of the sensor, whose z axis defines the frame. R is the mounting: sensor to the body of the
reference. Every matrix of positive determinant has exactly one such R and U.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import (
    IDENTITY,
    exp,
    log,
    multiply,
    normalize,
    rotation_matrix,
    shorter,
)
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64


class Parameter(NamedTuple):
    """One number that can be estimated.

    `group`, `axis`: what it is, and of which axes
    `limit`: standard deviation above which it counts as unobservable: rad/s, a ratio, rad or s
    """

    group: str
    axis: str
    limit: float


GROUPS: Final = {
    "bias": (("x", "y", "z"), 0.01),
    "offset": (("",), 0.01),
    "mount": (("x", "y", "z"), 0.02),
    "drift": (("",), 1e-4),
    "scale": (("x", "y", "z"), 0.01),
    "misalignment": (("xy", "xz", "yz"), 0.01),
}
"""Groups of parameters, with axes and limits: errors of usual MEMS gyroscopes and crystals are
smaller. Of parameters that cannot be separated, the later ones are held."""

PARAMETERS: Final = tuple(
    Parameter(group, axis, limit) for group, (axes, limit) in GROUPS.items() for axis in axes
)
LIMITS: Final = np.array([parameter.limit for parameter in PARAMETERS])
OF_GROUP: Final = np.array([parameter.group for parameter in PARAMETERS])
PLACES: Final = np.cumsum([len(axes) for axes, _ in GROUPS.values()])[:-1]
UPPER: Final = np.triu_indices(3, 1)
"""Rows and columns of the misalignment in U."""


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
        """Return the model with increments of all parameters, ``(14,)``, in their order."""
        bias, offset, mount, drift, scale, misalignment = np.split(by, PLACES)
        shape = self.shape + np.diag(scale)
        shape[UPPER] += misalignment
        return self._replace(
            bias=self.bias + bias,
            shape=shape,
            mount=normalize(multiply(exp(mount), self.mount)),
            offset=self.offset + float(offset[0]),
            drift=self.drift + float(drift[0]),
        )

    @property
    def values(self) -> Float64:
        """All parameters, ``(14,)``; the mounting as a rotation vector."""
        offset, drift = [self.offset], [self.drift]
        scale = self.shape.diagonal() - 1
        turn = log(shorter(self.mount))
        return np.concatenate([self.bias, offset, turn, drift, scale, self.shape[UPPER]])

    def times_of(self, t_ns: Int64) -> Int64:
        """Return timestamps of the reference in the clock of the rates, int64 ns."""
        since = (t_ns - self.middle_ns) / NS_PER_S
        moved = np.rint((self.offset + self.drift * since) * NS_PER_S).astype(np.int64)
        return np.asarray(t_ns + self.added_ns + moved)

    def by_rate(self) -> Float64:
        """Return the derivatives of calibrated rates by the parameters; 0 for the clock.

        `Returns`: shape ``(14, 3, 4)``: times 1 and the three components of the rate
        """
        matrix, turn = self.matrix, rotation_matrix(self.mount)
        inverse = np.linalg.inv(matrix)
        change = np.zeros((len(PARAMETERS), 3, 4))
        change[OF_GROUP == "bias", :, 0] = -matrix.T
        change[OF_GROUP == "mount", :, 1:] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        of_shape = np.einsum("im,nj->mnij", turn, inverse)
        change[OF_GROUP == "scale", :, 1:] = of_shape[range(3), range(3)]
        change[OF_GROUP == "misalignment", :, 1:] = of_shape[UPPER]
        return change
