"""A series of attitudes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from quatprop.errors import SeriesError, UsageError
from quatprop.series.base import Series
from quatprop.series.columns import rows_of, seconds_in_ns, stamps_of, times_beside
from quatprop.text import listed

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64, Int64

SIGMA_COLUMNS = ("sigma_x", "sigma_y", "sigma_z")
"""Names of the columns of standard deviations (rad)."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class AttitudeSeries(Series):
    """A time series of attitudes of the body.

    Accepts the same types as :class:`GyroSeries`.

    Parameters
    ----------
    t_ns
        Timestamps, shape ``(N,)``: int64 nanoseconds, or dates.
    wxyz
        Unit quaternions body -> reference (Hamilton, scalar first), shape ``(N, 4)``, kept as
        float64.
    position
        Position of the body in the reference frame, shape ``(N, 3)``, m; None if unknown.
    covariance
        Covariance of small rotations about the body axes, shape ``(N, 3, 3)``, rad^2; None if
        unknown.
    rate
        Angular rate of the body in body axes, shape ``(N, 3)``, rad/s; None if unknown.
    log_ns
        As for :class:`GyroSeries`.
    layout
        The layout in which they were read, ``"scalar-first"`` or ``"scalar-last"``: an explanation
        of errors offers the other one. None if they were not read.

    Raises
    ------
    SeriesError
        A shape or type is wrong.
    """

    _rows: ClassVar = "attitudes"

    wxyz: Float64
    position: Float64 | None = None
    covariance: Float64 | None = None
    rate: Float64 | None = None
    log_ns: Int64 | None = None
    layout: str | None = None

    if TYPE_CHECKING:

        def __init__(  # noqa: PLR0913, PLR0917  # as many as there are columns
            self,
            t_ns: ArrayLike,
            wxyz: ArrayLike,
            position: ArrayLike | None = None,
            covariance: ArrayLike | None = None,
            rate: ArrayLike | None = None,
            log_ns: ArrayLike | None = None,
            layout: str | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        t_ns = stamps_of("t_ns", self.t_ns)
        rows = {"wxyz": rows_of("wxyz", self.wxyz, len(t_ns), 4)}
        for name, shape in (("position", [3]), ("rate", [3]), ("covariance", [3, 3])):
            if (values := getattr(self, name)) is not None:
                rows[name] = rows_of(name, values, len(t_ns), *shape)
        self._keep(t_ns=t_ns, **rows, log_ns=times_beside(t_ns, "log_ns", self.log_ns))

    @classmethod
    def from_seconds(cls, t_s: ArrayLike, wxyz: ArrayLike) -> Self:
        """Return a series whose timestamps are seconds as floats; see :class:`GyroSeries`."""
        return cls(seconds_in_ns(t_s), wxyz)

    @property
    def sigma(self) -> Float64 | None:
        """Standard deviations of small rotations about the body axes, ``(N, 3)``, rad."""
        if self.covariance is None:
            return None
        variances: Float64 = np.einsum("...ii->...i", self.covariance)
        return np.sqrt(variances)

    def as_quat(self, *, scalar_first: bool | None = None) -> Float64:
        """Return the quaternions as an array in a layout.

        Parameters
        ----------
        scalar_first
            Whether the columns are w, x, y, z; otherwise x, y, z, w, the order of
            ``scipy.spatial.transform.Rotation.from_quat``.

        Returns
        -------
        ndarray
            Shape ``(N, 4)``, float64; a copy.

        Raises
        ------
        UsageError
            The layout is not given: there is no default, since libraries differ in it.
        """
        if scalar_first is None:
            raise UsageError(
                "as_quat needs the order of the components: scalar_first=True is w, x, y, z, "
                "scalar_first=False x, y, z, w, as scipy has them by default"
            )
        return self.wxyz.copy() if scalar_first else np.roll(self.wxyz, -1, axis=1)

    def as_matrix(self) -> Float64:
        """Return the rotation matrices, v_ref = R v_body, shape ``(N, 3, 3)``."""
        from quatprop.kinematics.quaternion import rotation_matrix

        return rotation_matrix(self.wxyz)

    def as_rotvec(self) -> Float64:
        """Return the rotation vectors, axis times angle up to half a turn, ``(N, 3)``, rad."""
        from quatprop.kinematics.quaternion import log, shorter

        return log(shorter(self.wxyz))

    def as_euler(self, sequence: str, *, degrees: bool = False) -> Float64:
        """Return the angles of intrinsic rotations about three axes.

        Parameters
        ----------
        sequence
            The axes in capital letters, as scipy writes intrinsic rotations: ``"ZYX"`` is yaw,
            pitch and roll, about z, the new y and the newest x.
        degrees
            Whether to return degrees instead of radians.

        Returns
        -------
        ndarray
            Shape ``(N, 3)``, in the order of the sequence. In gimbal lock only the sum or the
            difference of the first and the third angle is determined.

        Raises
        ------
        UsageError
            The sequence is unknown.
        """
        from quatprop.conventions.representations import euler_angles
        from quatprop.settings.choices import EULER_SEQUENCES

        known = [name.upper() for name in EULER_SEQUENCES]
        if sequence not in known:
            small = sequence.upper() in known
            raise UsageError(
                f"{sequence!r} is not one of {listed(known)}"
                + ("; small letters are extrinsic rotations in scipy" if small else "")
            )
        angles = euler_angles(sequence.lower(), self.wxyz)
        return np.degrees(angles) if degrees else angles

    def inv(self) -> AttitudeSeries:
        """Return the attitude of the reference frame relative to the body.

        Covariances are converted; positions and rates are dropped.
        """
        from quatprop.kinematics.quaternion import conjugate

        rotation, covariance = self.as_matrix(), self.covariance
        if covariance is not None:
            covariance = rotation @ covariance @ rotation.swapaxes(-1, -2)
        return AttitudeSeries(self.t_ns, conjugate(self.wxyz), covariance=covariance)

    def __mul__(self, other: AttitudeSeries) -> AttitudeSeries:
        """Return self * other, row by row, for two series with the same timestamps.

        The body of self is the reference of other.

        Raises
        ------
        SeriesError
            The timestamps differ.
        """
        from quatprop.kinematics.quaternion import multiply

        if not isinstance(other, AttitudeSeries):
            return NotImplemented
        if not np.array_equal(self.t_ns, other.t_ns):
            raise SeriesError(
                "attitudes at different times cannot be multiplied; relative_to() interpolates "
                "those of another body, and wxyz has the quaternions alone"
            )
        return AttitudeSeries(self.t_ns, multiply(self.wxyz, other.wxyz))

    def relative_to(self, other: AttitudeSeries) -> AttitudeSeries:
        """Return the attitudes of this body relative to another, such as the angle of a joint.

        Parameters
        ----------
        other
            Attitudes of the other body relative to the same reference, at non-decreasing
            timestamps. Between two of them slerp is used: a fixed axis and the shorter rotation.

        Returns
        -------
        AttitudeSeries
            q_other* q_self, at the timestamps of this series within the time range of the other.
        """
        from quatprop.kinematics.quaternion import conjugate, multiply, slerp

        inside = self.between(int(other.t_ns[0]), int(other.t_ns[-1])) if len(other) else self[:0]
        after = np.searchsorted(other.t_ns, inside.t_ns, side="right").clip(1, len(other) - 1)
        before = np.maximum(after - 1, 0)
        span = np.maximum(other.t_ns[after] - other.t_ns[before], 1)
        fraction = (inside.t_ns - other.t_ns[before]) / span
        at = slerp(other.wxyz[before], other.wxyz[after], fraction)
        return AttitudeSeries(inside.t_ns, multiply(conjugate(at), inside.wxyz))

    def to_arrow(self, *, scalar_first: bool = True) -> pa.Table:
        """Return a table of the timestamps and the quaternions.

        Parameters
        ----------
        scalar_first
            Whether the columns are ``t_ns``, ``qw``, ``qx``, ``qy``, ``qz``; otherwise ``qw`` is
            the last. If the series has them, positions follow as ``px``, ``py``, ``pz`` and
            standard deviations about body axes as ``sigma_x``, ``sigma_y``, ``sigma_z``.
        """
        names = ("qw", "qx", "qy", "qz") if scalar_first else ("qx", "qy", "qz", "qw")
        columns = dict(zip(names, self.as_quat(scalar_first=scalar_first).T, strict=True))
        if self.position is not None:
            columns |= dict(zip(("px", "py", "pz"), self.position.T, strict=True))
        if (sigma := self.sigma) is not None:
            columns |= dict(zip(SIGMA_COLUMNS, sigma.T, strict=True))
        return self._table(columns)

    def to_pandas(self, *, scalar_first: bool = True) -> Any:
        """Return a pandas data frame with the columns of :meth:`to_arrow`.

        Raises
        ------
        UsageError
            pandas is not installed.
        """
        return self._data_frame(self.to_arrow(scalar_first=scalar_first))
