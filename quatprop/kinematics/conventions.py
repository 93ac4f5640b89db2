"""Attitude conventions: convention, direction and sign of stored numbers.

Inside quatprop an attitude is a Hamilton quaternion q that transforms body coordinates to reference
coordinates, v_ref = q v_body q*. Other conventions store the same rotation as other numbers:

==========  ===========  =======
convention  direction    numbers
==========  ===========  =======
hamilton    body-to-ref  q
hamilton    ref-to-body  q*
jpl         ref-to-body  q
jpl         body-to-ref  q*
==========  ===========  =======

because a JPL quaternion with components p rotates vectors as the Hamilton quaternion p* does. The
order of the four numbers is a separate matter: :mod:`quatprop.conventions.layout`; so are other
representations of a rotation: :mod:`quatprop.conventions.representations`.

References
----------
Breckenridge, "Quaternions - Proposed Standard Conventions", JPL interoffice memorandum
343-79-1199, 1979. Solà, "Quaternion kinematics for the error-state Kalman filter",
arXiv:1711.02508, 2017.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import UsageError
from quatprop.kinematics.quaternion import conjugate
from quatprop.settings.choices import CONVENTIONS, DIRECTIONS
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from quatprop.arrays import Float64


@dataclass(frozen=True, slots=True)
class AttitudeConvention:
    """The convention and the direction of a quaternion, independent of its layout.

    `convention`: ``"hamilton"`` or ``"jpl"``
    `direction`: ``"body-to-ref"`` or ``"ref-to-body"``: that of the coordinate transformation
    """

    convention: str = "hamilton"
    direction: str = "body-to-ref"

    def __post_init__(self) -> None:
        for what, name, known in (("convention", self.convention, CONVENTIONS),
                                  ("direction", self.direction, DIRECTIONS)):  # fmt: skip
            if name not in known:
                raise UsageError(f"no {what} {quoted(name)}; choose one of {listed(known)}")

    @property
    def is_conjugate(self) -> bool:
        """Whether the numbers are q*, with q the attitude in Hamilton, body to reference."""
        return (self.convention == "jpl") != (self.direction == "ref-to-body")

    @property
    def description(self) -> str:
        """The formula that rotates a vector by the numbers q, in one line."""
        source, target = ("body", "ref") if self.direction == "body-to-ref" else ("ref", "body")
        if self.convention == "jpl":
            return f"JPL, ij = -k: v_{target} = q v_{source} q* in its product"
        return f"Hamilton, ij = k: v_{target} = q v_{source} q*"

    def converted(self, wxyz: Float64) -> Float64:
        """Convert attitudes to this convention, or numbers in this convention to attitudes.

        Conjugation is its own inverse and exact, so both directions are the same function.

        `wxyz`: quaternions, shape ``(..., 4)``, scalar first
        `Returns`: shape ``(..., 4)``
        """
        return conjugate(wxyz) if self.is_conjugate else wxyz


HAMILTON = AttitudeConvention()
"""The convention of attitudes inside quatprop."""


class Signs:
    """Chooses between q and -q, which are the same attitude, along a series.

    `sign`: ``"keep"``: no change; ``"positive"``: the first component that is not zero is positive,
        so w >= 0; ``"continuous"``: a non-negative dot product with the previous quaternion; the
        first is not changed
    """

    def __init__(self, sign: str) -> None:
        self._sign = sign
        self._last: Float64 | None = None
        self._flip = 1.0

    def applied(self, wxyz: Float64) -> Float64:
        """Return the next batch of the series with its signs chosen, shape ``(N, 4)``."""
        if self._sign == "keep" or not len(wxyz):
            return wxyz
        if self._sign == "positive":
            return _positive(wxyz)
        before = wxyz[:1] if self._last is None else self._last
        dots = np.einsum("ij,ij->i", np.concatenate([before, wxyz[:-1]]), wxyz)
        flips = self._flip * np.cumprod(np.where(dots < 0, -1.0, 1.0))
        self._last, self._flip = wxyz[-1:].copy(), float(flips[-1])
        signed: Float64 = wxyz * flips[:, None]
        return signed


def _positive(wxyz: Float64) -> Float64:
    """Return q or -q, such that the first component that is not zero is positive."""
    signed: Float64 = np.where(wxyz[:, :1] < 0, -wxyz, wxyz)
    (half_turns,) = np.nonzero(signed[:, 0] == 0)
    if len(half_turns):
        rows = signed[half_turns]
        first = np.argmax(rows != 0, axis=1)[:, None]
        negative = np.take_along_axis(rows, first, axis=1) < 0
        # Adding zero removes the sign of -0.0.
        signed[half_turns] = np.where(negative, -rows, rows) + 0.0
    return signed
