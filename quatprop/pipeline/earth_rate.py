"""Remove the rotation of the Earth from attitudes relative to a frame on the ground."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.kinematics.quaternion import exp, multiply

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Float64, Int64
    from quatprop.series import AttitudeSeries

RAD_S = 7.292115e-5
"""The rate of the Earth's rotation, rad/s (WGS 84)."""


class EarthRate(NamedTuple):
    """The rotation of a reference frame on the ground relative to an inertial frame.

    A gyroscope measures relative to the inertial frame. The frames agree at the first sample, so
    the attitudes relative to the ground are q_ground(t) = exp(-w (t - t_0) / 2) q(t). The factor
    is exact, since w is constant in both frames.

    `latitude`: deg, positive in the north
    `azimuth`: of the reference's x axis, deg clockwise from north; None: x points east if z is up,
        north if z is down
    `down`: whether the reference's z axis points down
    """

    latitude: float
    azimuth: float | None = None
    down: bool = False

    @property
    def rate(self) -> Float64:
        """The angular rate of the reference frame in its own axes, shape ``(3,)``, rad/s."""
        azimuth = self.azimuth
        if azimuth is None:
            azimuth = 0.0 if self.down else 90.0
        x, latitude = np.radians([azimuth, self.latitude])
        to_y = -np.sin(x) if self.down else np.sin(x)
        north, up = np.cos(latitude), np.sin(latitude)
        turn = np.array([north * np.cos(x), north * to_y, -up if self.down else up])
        # The computed cosine of 90 deg is not exactly zero.
        return RAD_S * np.where(np.abs(turn) < 1e-15, 0.0, turn)  # noqa: PLR2004

    def against_ground(self, wxyz: Float64, t_ns: Int64, first_ns: int) -> Float64:
        """Return attitudes relative to the ground, ``(N, 4)``; the frames agree at `first_ns`."""
        seconds = (t_ns - first_ns) * 1e-9
        return multiply(exp(-seconds[:, None] * self.rate), wxyz)

    def taken_off(
        self, batches: Iterable[AttitudeSeries], first_ns: int
    ) -> Iterator[AttitudeSeries]:
        """Yield attitudes relative to the ground."""
        for series in batches:
            yield replace(series, wxyz=self.against_ground(series.wxyz, series.t_ns, first_ns))
