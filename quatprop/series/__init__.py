"""Series of body rates and series of attitudes.

Both are frozen, validated when they are made, and hold read-only arrays. A whole log and a batch of
one are the same type: readers yield many short series in order, writers take them in order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from quatprop.errors import UsageError
from quatprop.series.base import Series
from quatprop.series.columns import rows_of, seconds_in_ns, stamps_of, times_beside

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64, Int64

SIGMA_COLUMNS = ("sigma_x", "sigma_y", "sigma_z")
"""Names of the columns of standard deviations, rad."""


@dataclass(frozen=True, slots=True, repr=False)
class GyroSeries(Series):
    """Angular rates of the body relative to the reference, in time.

    Arrays, lists, and columns or tables of pandas, polars and Arrow are taken, and kept as
    read-only NumPy arrays.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``: int64 nanoseconds, or dates. For seconds as floats see
        :meth:`from_seconds`.
    rate
        Angular rate, shape ``(N, 3)``, rad/s, kept as float64. Resolved in the body frame unless
        the propagation is told ``rates="inertial"``.
    integration_time_ns
        For samples that are increments, integrated by the sensor: the time over which each was,
        shape ``(N,)``, int64, ns, ending at its stamp. The increment is the rate times this, and
        is taken as it is, whatever lies between the stamps. None for rates.
    is_interval_average
        Whether each rate is the average over the interval that ends at its stamp, instead of the
        rate at that moment. Then method ``"end"`` is the default, and exact about a fixed axis.
    log_ns
        When the message of each sample was recorded, shape ``(N,)``, int64, ns; None where it is
        not known or not needed.

    Raises
    ------
    SeriesError
        The shapes or the types do not fit.

    Examples
    --------
    >>> GyroSeries([0, 10_000_000], [[0, 0, 1], [0, 0, 1]]).rate.dtype
    dtype('float64')
    """

    _rows: ClassVar = "samples"

    rate: Float64
    integration_time_ns: Int64 | None = None
    is_interval_average: bool = False
    log_ns: Int64 | None = None

    if TYPE_CHECKING:  # what is taken, beside what is kept

        def __init__(
            self,
            t_ns: ArrayLike,
            rate: ArrayLike,
            integration_time_ns: ArrayLike | None = None,
            is_interval_average: bool = False,
            log_ns: ArrayLike | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        t_ns = stamps_of("t_ns", self.t_ns)
        self._keep(
            t_ns=t_ns,
            rate=rows_of("rate", self.rate, len(t_ns), 3),
            integration_time_ns=times_beside(t_ns, "integration_time_ns", self.integration_time_ns),
            log_ns=times_beside(t_ns, "log_ns", self.log_ns),
        )

    def is_integrated(self, method: str) -> bool:
        """Tell whether a method takes each sample as the whole rotation since the one before.

        Increments are that under every method, averages under those that know of intervals.

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
        """Return a series whose stamps are seconds as floats.

        Parameters
        ----------
        t_s
            Time stamps, shape ``(N,)``, s; rounded to the nearest ns. Floats near 1.7e9 s, today's
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
        """Return the same samples with other rates, shape ``(N, 3)``, rad/s."""
        return replace(self, rate=rate)


@dataclass(frozen=True, slots=True, repr=False)
class AttitudeSeries(Series):
    """Attitudes of the body, in time.

    Takes what :class:`GyroSeries` takes.

    Parameters
    ----------
    t_ns
        Time stamps, shape ``(N,)``: int64 nanoseconds, or dates.
    wxyz
        Unit quaternions body -> reference (Hamilton, scalar first), shape ``(N, 4)``, kept as
        float64.
    position
        Position of the body in the reference frame, shape ``(N, 3)``, m; None where it is not
        known.
    covariance
        Covariance of small rotations about the body's axes, shape ``(N, 3, 3)``, rad^2; None where
        it is not known.
    rate
        Angular rate of the body in its own axes, shape ``(N, 3)``, rad/s; None where it is not
        known.
    log_ns
        As for :class:`GyroSeries`.

    Raises
    ------
    SeriesError
        The shapes or the types do not fit.
    """

    _rows: ClassVar = "attitudes"

    wxyz: Float64
    position: Float64 | None = None
    covariance: Float64 | None = None
    rate: Float64 | None = None
    log_ns: Int64 | None = None

    if TYPE_CHECKING:

        def __init__(  # noqa: PLR0913, PLR0917  # as many as there are columns
            self,
            t_ns: ArrayLike,
            wxyz: ArrayLike,
            position: ArrayLike | None = None,
            covariance: ArrayLike | None = None,
            rate: ArrayLike | None = None,
            log_ns: ArrayLike | None = None,
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
        """Return a series whose stamps are seconds as floats; see :class:`GyroSeries`."""
        return cls(seconds_in_ns(t_s), wxyz)

    @property
    def sigma(self) -> Float64 | None:
        """Standard deviations of small rotations about the body's axes, ``(N, 3)``, rad."""
        if self.covariance is None:
            return None
        variances: Float64 = np.einsum("...ii->...i", self.covariance)
        return np.sqrt(variances)

    def as_quat(self, *, scalar_first: bool | None = None) -> Float64:
        """Return the quaternions as an array in a layout.

        Parameters
        ----------
        scalar_first
            Whether the columns are w, x, y, z; otherwise x, y, z, w, as
            ``scipy.spatial.transform.Rotation.from_quat`` takes them.

        Returns
        -------
        ndarray
            Shape ``(N, 4)``, float64; a copy.

        Raises
        ------
        UsageError
            The layout is not given: libraries differ in it, so there is no default.
        """
        if scalar_first is None:
            raise UsageError(
                "as_quat needs the order of the components: scalar_first=True is w, x, y, z, "
                "scalar_first=False x, y, z, w, as scipy has them by default"
            )
        return self.wxyz.copy() if scalar_first else np.roll(self.wxyz, -1, axis=1)

    def to_arrow(self, *, scalar_first: bool = True) -> pa.Table:
        """Return a table of the stamps and the quaternions.

        Parameters
        ----------
        scalar_first
            Whether the columns are ``t_ns``, ``qw``, ``qx``, ``qy``, ``qz``; otherwise ``qw`` is
            the last. Positions follow as ``px``, ``py``, ``pz`` and standard deviations about
            body axes as ``sigma_x``, ``sigma_y``, ``sigma_z``, where the series has them.
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
