"""A series of body rates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from quatprop.series.base import Series
from quatprop.series.columns import rows_of, seconds_in_ns, stamps_of, times_beside

if TYPE_CHECKING:
    import pyarrow as pa
    from numpy.typing import ArrayLike

    from quatprop.arrays import Float64, Int64


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
    log_ns
        Log time of the message of each sample, shape ``(N,)``, int64, ns; None if it is unknown
        or not needed.

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
    log_ns: Int64 | None = None

    if TYPE_CHECKING:  # the accepted types; the fields have the stored ones

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
