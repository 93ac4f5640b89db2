"""Write attitude series as rows of a table, or as messages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.writers.base import MessageWriter, TableWriter, Transaction

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from quatprop.arrays import AnyArray, Float64, Int64, Records
    from quatprop.conventions.layout import Layout
    from quatprop.conventions.representations import Representation
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.messages import AttitudeEncoder

    Columns = tuple[Int64, list[AnyArray]]


class AttitudeWriter(Transaction):
    """Writes batches of attitudes in order; the arrays must not change before the commit.

    `file`: the file to which rows or messages are written
    `rows`: converts a batch to timestamps in ns, and columns or messages
    `holds_positions`: whether positions are written, too; zero if a batch has none
    `locked_rows`: number of rows whose angles are not unique (gimbal lock)
    """

    def __init__(
        self,
        file: TableWriter | MessageWriter,
        rows: Callable[[Any], tuple[Int64, Any]],
        *,
        holds_positions: bool = False,
    ) -> None:
        self._file = file
        self._rows = rows
        self.holds_positions = holds_positions
        self.locked_rows = 0

    def write(self, series: AttitudeSeries | GyroSeries) -> None:
        """Append a batch; see :meth:`TableWriter.write` for the errors."""
        self._file.write(*self._rows(series))

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Write the rest of the file."""
        self._file.finish(provenance)

    def publish(self) -> None:
        """Replace the target with the finished file."""
        self._file.publish()

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._file.abort()


def attitude_table(
    table: TableWriter,
    layout: Layout,
    sigma: str | None = None,
    form: Representation | None = None,
) -> AttitudeWriter:
    """Return a writer of attitudes as a table: timestamps, four components, and more columns.

    `table`: a table with the columns of `layout`, of `form` and of standard deviations
    `sigma`: the axes of the columns of standard deviations at the end; None for no such columns
    `form`: another representation of each attitude to write, such as its angles; None for none
    """

    def columns(series: AttitudeSeries) -> Columns:
        columns = [series.wxyz[:, component] for component in layout.order]
        if table.holds_positions and series.position is not None:
            columns += list(series.position.T)
        if form is not None:
            columns += map(np.ascontiguousarray, form.values(series.wxyz).T)
        if sigma is not None and series.covariance is not None:
            covariance = series.covariance
            if sigma == "reference":
                from quatprop.kinematics.uncertainty import reference_covariance

                covariance = reference_covariance(series.wxyz, covariance)
            columns += [np.sqrt(covariance[:, axis, axis]) for axis in range(3)]
        return series.t_ns, columns

    return AttitudeWriter(table, columns, holds_positions=table.holds_positions)


def column_table(
    table: TableWriter,
    values: Callable[[Any], Float64],
    locked: Callable[[Float64], int] = lambda _values: 0,
) -> AttitudeWriter:
    """Return a writer of series as a table of numbers that are computed from them.

    `values`: computes the columns of a series, shape ``(N, k)``
    `locked`: counts the rows of gimbal lock in them
    """

    def columns(series: AttitudeSeries | GyroSeries) -> Columns:
        numbers = values(series)
        writer.locked_rows += locked(numbers)
        return series.t_ns, [np.ascontiguousarray(column) for column in numbers.T]

    writer = AttitudeWriter(table, columns)
    return writer


def attitude_messages(
    container: MessageWriter,
    encoder: AttitudeEncoder,
    target: Path | str,
    log_times: Callable[[AttitudeSeries], Int64] = lambda series: series.t_ns,
) -> AttitudeWriter:
    """Return a writer of attitudes as messages.

    `log_times`: returns the log times of attitudes, ns
    """

    def messages(series: AttitudeSeries) -> tuple[Int64, Records]:
        encoded = encoder.encode(series, target)
        return log_times(series), encoded

    return AttitudeWriter(container, messages, holds_positions=encoder.holds_positions)
