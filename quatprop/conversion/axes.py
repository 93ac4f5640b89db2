"""Change of the reference axes and of the body axes of attitudes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conditioning.mounting import mounting
from quatprop.kinematics.quaternion import conjugate, from_matrix, multiply, rotate

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Float64
    from quatprop.series import AttitudeSeries


class AxisChange(NamedTuple):
    """The rotations from old to new axes, v_new = M v_old.

    `reference`, `body`: rotation matrices M, shape ``(3, 3)``
    """

    reference: Float64
    body: Float64

    @classmethod
    def of(cls, left: str | None, right: str | None) -> AxisChange:
        """Return the change of axes of two settings; None for no change."""
        unchanged = "1,0,0,0"
        return cls(*(mounting(axes or unchanged, "rotation") for axes in (left, right)))

    def mixes(self, axes: str) -> bool:
        """Return whether a new axis of the ``"body"`` or ``"reference"`` is along no old one."""
        change: Float64 = self.body if axes == "body" else self.reference
        return bool((np.abs(change).max(axis=0) < 1 - 1e-12).any())

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield attitudes q' = L q R*, and positions and covariances in the new axes."""
        left, right = from_matrix(self.reference), conjugate(from_matrix(self.body))
        for series in batches:
            position, covariance = series.position, series.covariance
            yield replace(
                series,
                wxyz=multiply(multiply(left, series.wxyz), right),
                position=None if position is None else rotate(left, position),
                covariance=None if covariance is None else self.body @ covariance @ self.body.T,
            )
