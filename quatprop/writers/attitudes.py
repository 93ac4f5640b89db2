"""Attitude series as rows of a table, or as messages."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.writers.base import MessageWriter, TableWriter, Transaction

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from quatprop.arrays import Float64, Int64
    from quatprop.conventions.layout import Layout
    from quatprop.conventions.representations import Representation
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.messages.kinds import AttitudeEncoder


class AttitudeWriter(Transaction):
    """Takes batches of attitudes in order; the arrays must not change before the commit.

    Parameters
    ----------
    file
        The file whose rows or messages they become, and with which they are committed.

    Attributes
    ----------
    holds_positions
        Whether positions are written too; where a batch has none, they are zero.
    """

    holds_positions = False

    def __init__(self, file: Transaction) -> None:
        self._file = file

    @abstractmethod
    def write(self, series: AttitudeSeries) -> None:
        """Append a batch; see :meth:`TableWriter.write` for the errors."""

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Write the file to its end."""
        self._file.finish(provenance)

    def publish(self) -> None:
        """Put the finished file in its place."""
        self._file.publish()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._file.abort()


class AttitudeTable(AttitudeWriter):
    """Attitudes as a table: stamps, four components in the order of a layout, and more columns.

    Parameters
    ----------
    table
        A table with the columns of `layout`, of `form` and of standard deviations.
    layout
        Order of the components.
    sigma
        The axes of the columns of standard deviations at the end; None where there are none.
    form
        What else to write of each attitude, such as its angles; None for nothing.
    """

    def __init__(
        self,
        table: TableWriter,
        layout: Layout,
        sigma: str | None = None,
        form: Representation | None = None,
    ) -> None:
        super().__init__(table)
        self._table = table
        self._order, self._sigma, self._form = layout.order, sigma, form
        self.holds_positions = table.holds_positions

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        columns = [series.wxyz[:, component] for component in self._order]
        if self.holds_positions and series.position is not None:
            columns += list(series.position.T)
        if self._form is not None:
            columns += map(np.ascontiguousarray, self._form.values(series.wxyz).T)
        if self._sigma is not None and series.covariance is not None:
            covariance = series.covariance
            if self._sigma == "reference":
                from quatprop.kinematics.uncertainty import reference_covariance

                covariance = reference_covariance(series.wxyz, covariance)
            columns += [np.sqrt(covariance[:, axis, axis]) for axis in range(3)]
        self._table.write(series.t_ns, columns)


class ColumnTable(AttitudeWriter):
    """Series as a table of numbers that are made of them.

    Parameters
    ----------
    table
        The table.
    values
        Returns the columns of a series, shape ``(N, k)``.
    locked
        Returns in how many rows of columns the angles are not unique.

    Attributes
    ----------
    locked_rows
        How many there were.
    """

    def __init__(
        self,
        table: TableWriter,
        values: Callable[[Any], Float64],
        locked: Callable[[Float64], int] = lambda _values: 0,
    ) -> None:
        super().__init__(table)
        self._table, self._values, self._locked = table, values, locked
        self.locked_rows = 0

    def write(self, series: AttitudeSeries | GyroSeries) -> None:
        """Append a batch."""
        values = self._values(series)
        self._table.write(series.t_ns, [np.ascontiguousarray(column) for column in values.T])
        self.locked_rows += self._locked(values)


class AttitudeMessages(AttitudeWriter):
    """Attitudes as messages.

    Parameters
    ----------
    container
        Takes the messages.
    encoder
        Encodes the attitudes.
    target
        The file, for errors.
    log_times
        Returns when attitudes are logged, given their stamps, ns; None is at their stamps.
    """

    def __init__(
        self,
        container: MessageWriter,
        encoder: AttitudeEncoder,
        target: Path | str,
        log_times: Callable[[Int64], Int64] | None = None,
    ) -> None:
        super().__init__(container)
        self._container = container
        self._encoder = encoder
        self._target = target
        self._log_times = log_times
        self.holds_positions = encoder.holds_positions

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        messages = self._encoder.encode(series, self._target)
        t_ns = series.t_ns
        self._container.write(t_ns if self._log_times is None else self._log_times(t_ns), messages)
