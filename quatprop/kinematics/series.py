"""Series of body rates and series of attitudes, validated on construction."""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

import numpy as np

from quatprop.base.errors import SeriesError, UsageError
from quatprop.base.text import listed
from quatprop.kinematics.array_conversion import rows_of, seconds_in_ns, stamps_of, times_like
from quatprop.kinematics.time_series import Series

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import ArrayLike

    from quatprop.base.arrays import Float64, Int64
    from quatprop.settings.quantities import Layout


# A series of body rates.


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class GyroSeries(Series):
    """A time series of angular rates of the body relative to the reference.

    Arrays, lists, and columns or tables of pandas, polars and Arrow are accepted, and stored as
    read-only NumPy arrays.

    Parameters
    ----------
    t_ns
        Timestamps, shape ``(N,)``: int64 nanoseconds, or dates. For seconds as floats see
        :meth:`from_seconds`.
    rate
        Angular rate, shape ``(N, 3)``, rad/s, kept as float64. Resolved in the body frame, unless
        it is propagated with ``rates="inertial"``.
    integration_time_ns
        For samples that are increments, integrated by the sensor: the integration time of each,
        shape ``(N,)``, int64, ns, ending at its timestamp. The increment is the rate times this
        time, whatever the interval between the timestamps. None for rates.
    is_interval_average
        Whether each rate is the average over the interval that ends at its timestamp, instead of
        the rate at that moment. Then method ``"end"`` is the default, and exact about a fixed axis.

    Raises
    ------
    SeriesError
        A shape or type is wrong.

    Examples
    --------
    >>> GyroSeries([0, 10_000_000], [[0, 0, 1], [0, 0, 1]]).rate.dtype
    dtype('float64')
    """

    _rows: ClassVar = "samples"

    rate: Float64
    integration_time_ns: Int64 | None = None
    is_interval_average: bool = False

    if TYPE_CHECKING:  # the accepted types; the fields have the stored ones

        def __init__(
            self,
            t_ns: ArrayLike,
            rate: ArrayLike,
            integration_time_ns: ArrayLike | None = None,
            is_interval_average: bool = False,
        ) -> None: ...

    def __post_init__(self) -> None:
        t_ns = stamps_of("t_ns", self.t_ns)
        self._keep(
            t_ns=t_ns,
            rate=rows_of("rate", self.rate, len(t_ns), 3),
            integration_time_ns=times_like(t_ns, "integration_time_ns", self.integration_time_ns),
        )

    def is_integrated(self, method: str) -> bool:
        """Return whether a method uses each sample as the integral over the interval before it.

        True for increments with every method, for averages with all but ``start`` and ``mean``.

        Parameters
        ----------
        method
            One of :data:`quatprop.settings.METHODS`.
        """
        return self.integration_time_ns is not None or (
            self.is_interval_average and method not in {"start", "mean"}
        )

    @classmethod
    def from_seconds(cls, t_s: ArrayLike, rate: ArrayLike) -> Self:
        """Return a series whose timestamps are seconds as floats.

        Parameters
        ----------
        t_s
            Timestamps, shape ``(N,)``, s; rounded to the nearest ns. Floats near 1.7e9 s, today's
            Unix time, are 238 ns apart.
        rate
            As for the class.
        """
        return cls(seconds_in_ns(t_s), rate)

    def to_arrow(self) -> pa.Table:
        """Return a table with the columns ``t_ns``, ``wx``, ``wy``, ``wz`` (ns, rad/s)."""
        return self._table(dict(zip(("wx", "wy", "wz"), self.rate.T, strict=True)))

    def to_pandas(self) -> Any:
        """Return a pandas data frame with the columns of :meth:`to_arrow`.

        Raises
        ------
        UsageError
            pandas is not installed.
        """
        return self._data_frame(self.to_arrow())

    def with_rate(self, rate: Float64) -> Self:
        """Return a copy of the series with other rates, shape ``(N, 3)``, rad/s."""
        return replace(self, rate=rate)


# A series of attitudes.


SIGMA_COLUMNS = ("sigma_x", "sigma_y", "sigma_z")
"""Names of the columns of standard deviations (rad)."""


class MethodSensitivity(NamedTuple):
    """The largest angle between attitudes by an integration rule and by a better one.

    `rule`: what the samples are and the rule, such as ``("rates", "start")``
    `better`: the better rule
    `angle_rad`: the angle, rad
    """

    rule: tuple[str, str]
    better: str
    angle_rad: float


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class AttitudeSeries(Series):
    """A time series of attitudes of the body.

    Accepts the same types as :class:`GyroSeries`.

    Parameters
    ----------
    t_ns
        Timestamps, shape ``(N,)``: int64 nanoseconds, or dates.
    wxyz
        Unit quaternions body -> reference (Hamilton), shape ``(N, 4)``, kept as float64, scalar
        first.
    position
        Position of the body in the reference frame, shape ``(N, 3)``, m; None if unknown.
    covariance
        Covariance of small rotations about the body axes, shape ``(N, 3, 3)``, rad^2; None if
        unknown.
    rate
        Angular rate of the body in body axes, shape ``(N, 3)``, rad/s; None if unknown.
    read_layout
        The layout in which they were stored where they were read, ``"scalar-first"`` or
        ``"scalar-last"``: an explanation of errors offers the other one. None if it is unknown.
    others
        Other columns of the file, carried along, shape ``(N, k)``; None for none.
    lag_ns
        Time by which they lag behind the body because of the integration rule, ns, such as half a
        sampling interval with method ``start``; None if it is unknown.
    sensitivity
        By how much a better integration rule changes them; None if it is unknown.
    layout
        The order of the numbers that are given as `wxyz`: ``"scalar-last"`` or ``"xyzw"`` if they
        are x, y, z, w. As an attribute, that of the kept ones.

    Raises
    ------
    SeriesError
        A shape or type is wrong.
    UsageError
        There is no such layout.

    Examples
    --------
    >>> AttitudeSeries([0], [[0, 0, 0, 1]], layout="scalar-last").wxyz.tolist()
    [[1.0, 0.0, 0.0, 0.0]]
    """

    _rows: ClassVar = "attitudes"
    sigma_axes: ClassVar[str] = "body"

    wxyz: Float64
    position: Float64 | None = None
    covariance: Float64 | None = None
    rate: Float64 | None = None
    read_layout: str | None = field(default=None, compare=False)
    others: Float64 | None = None
    lag_ns: int | None = field(default=None, compare=False)
    sensitivity: MethodSensitivity | None = field(default=None, compare=False)
    layout: InitVar[Layout] = field(default="scalar-first", kw_only=True)

    if TYPE_CHECKING:

        def __init__(  # noqa: PLR0913, PLR0917  # as many as there are columns
            self,
            t_ns: ArrayLike,
            wxyz: ArrayLike,
            position: ArrayLike | None = None,
            covariance: ArrayLike | None = None,
            rate: ArrayLike | None = None,
            read_layout: str | None = None,
            others: ArrayLike | None = None,
            lag_ns: int | None = None,
            sensitivity: MethodSensitivity | None = None,
            *,
            layout: Layout = "scalar-first",
        ) -> None: ...

    def __post_init__(self, layout: Layout) -> None:
        t_ns = stamps_of("t_ns", self.t_ns)
        rows = {"wxyz": rows_of("wxyz", self.wxyz, len(t_ns), 4)}
        if layout != "scalar-first":
            from quatprop.kinematics.conventions import layout_named

            given = layout_named(layout)
            rows["wxyz"] = rows["wxyz"].take(np.argsort(given.order), axis=1)
            object.__setattr__(self, "read_layout", given.name)
        for name, shape in (("position", [3]), ("rate", [3]), ("covariance", [3, 3])):
            if (values := getattr(self, name)) is not None:
                rows[name] = rows_of(name, values, len(t_ns), *shape)
        if self.others is not None:
            rows["others"] = rows_of("others", self.others, len(t_ns), *np.shape(self.others)[1:])
        self._keep(t_ns=t_ns, **rows)

    @classmethod
    def from_seconds(
        cls, t_s: ArrayLike, wxyz: ArrayLike, *, layout: Layout = "scalar-first"
    ) -> Self:
        """Return a series whose timestamps are seconds as floats; see :class:`GyroSeries`."""
        return cls(seconds_in_ns(t_s), wxyz, layout=layout)

    @property
    def sigma(self) -> Float64 | None:
        """Standard deviations of small rotations about the body axes, ``(N, 3)``, rad."""
        return None if self.covariance is None else standard_deviations(self.covariance)

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
                "scalar_first=False x, y, z, w (scipy's default)"
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
        from quatprop.kinematics.conventions import euler_angles
        from quatprop.settings.quantities import EULER_SEQUENCES

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
        wxyz = multiply(conjugate(at), inside.wxyz)
        return AttitudeSeries(inside.t_ns, wxyz, others=inside.others)

    def to_arrow(self, *, scalar_first: bool = True) -> pa.Table:
        """Return a table of the timestamps and the quaternions.

        Parameters
        ----------
        scalar_first
            Whether the columns are ``t_ns``, ``qw``, ``qx``, ``qy``, ``qz``; otherwise ``qw`` is
            the last. If the series has them, positions follow as ``px``, ``py``, ``pz`` and
            standard deviations as ``sigma_x``, ``sigma_y``, ``sigma_z``, about body axes or, as
            :func:`quatprop.write` writes them, those of `sigma_axes` of the propagation.
        """
        names = ("qw", "qx", "qy", "qz") if scalar_first else ("qx", "qy", "qz", "qw")
        columns = dict(zip(names, self.as_quat(scalar_first=scalar_first).T, strict=True))
        if self.position is not None:
            columns |= dict(zip(("px", "py", "pz"), self.position.T, strict=True))
        if self.covariance is not None:
            to_ref = self.wxyz if self.sigma_axes == "reference" else None
            sigma = standard_deviations(self.covariance, to_ref)
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


def standard_deviations(covariance: Float64, wxyz: Float64 | None = None) -> Float64:
    """Return the standard deviations of small rotations, ``(N, 3)``, rad.

    `covariance`: about body axes, ``(N, 3, 3)``, rad^2
    `wxyz`: attitudes, for standard deviations about reference axes; None for those about body axes
    """
    if wxyz is not None:
        from quatprop.kinematics.quaternion import reference_covariance

        covariance = reference_covariance(wxyz, covariance)
    variances: Float64 = np.einsum("...ii->...i", covariance)
    return np.sqrt(variances)
