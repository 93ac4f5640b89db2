"""The model of a gyroscope and of two clocks, and its parameters.

Calibrated rates are w = R (I + U) (w_raw - b). The bias b is in the axes of the raw rates. U is
upper triangular: its diagonal corrects the scale, the elements above it the angles between the axes
of the sensor, whose z axis defines the frame. R is the mounting: sensor to the body of the
reference. Every matrix of positive determinant has exactly one such R and U.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.calibration.settings import GROUPS
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

OF_GROUP: Final = np.array([name for name, group in GROUPS.items() for _ in group.axes])
"""The group of each of the 14 parameters."""

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
        shape = self.shape + np.diag(by[OF_GROUP == "scale"])
        shape[UPPER] += by[OF_GROUP == "misalignment"]
        return self._replace(
            bias=self.bias + by[OF_GROUP == "bias"],
            shape=shape,
            mount=normalize(multiply(exp(by[OF_GROUP == "mount"]), self.mount)),
            offset=self.offset + float(by[OF_GROUP == "offset"][0]),
            drift=self.drift + float(by[OF_GROUP == "drift"][0]),
        )

    @property
    def values(self) -> Float64:
        """All parameters, ``(14,)``; the mounting as a rotation vector."""
        scale, turn = self.shape.diagonal() - 1, log(shorter(self.mount))
        clock = [self.offset, self.drift]
        return np.concatenate([self.bias, scale, self.shape[UPPER], turn, clock])

    def times_of(self, t_ns: Int64) -> Int64:
        """Return timestamps of the reference in the clock of the rates, int64 ns."""
        since = (t_ns - self.middle_ns) / NS_PER_S
        moved = np.rint((self.offset + self.drift * since) * NS_PER_S).astype(np.int64)
        return np.asarray(t_ns + self.added_ns + moved)

    def by_rate(self) -> Float64:
        """Return the derivatives of calibrated rates by the parameters; 0 for the clock.

        `Returns`: shape ``(14, 3, 4)``: times 1 and the three components of the rate
        """
        change = np.zeros((len(OF_GROUP), 3, 4))
        change[OF_GROUP == "bias", :, 0] = -self.matrix.T
        change[OF_GROUP == "mount", :, 1:] = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
        inverse = np.linalg.inv(self.matrix)
        of_shape = np.einsum("im,nj->mnij", rotation_matrix(self.mount), inverse)
        change[OF_GROUP == "scale", :, 1:] = of_shape[range(3), range(3)]
        change[OF_GROUP == "misalignment", :, 1:] = of_shape[UPPER]
        return change
