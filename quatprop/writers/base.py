"""Base classes of file writers: tables of columns, and encoded messages."""

from __future__ import annotations

import json
import weakref
from abc import ABC, abstractmethod
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from quatprop.base.provenance import as_json
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Float64, Int64, Records
    from quatprop.kinematics.conventions import Layout, Representation
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.writers import AttitudeEncoder
    from quatprop.writers.atomic import OutputFile, OutputPath

    Columns = tuple[Int64, list[AnyArray]]


def provenance_json(provenance: Mapping[str, object]) -> str:
    """Return a provenance as stored in files: JSON on one line, plain ASCII."""
    return json.dumps(provenance, sort_keys=True, default=as_json)


def block_slices(rows: int, filled: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Yield slices of a batch of rows, and the slices of fixed-size blocks to which they go.

    Blocks end at fixed rows, so the output does not depend on the sizes of batches.

    `filled`: rows of the first block that are filled already
    """
    done = 0
    while done < rows:
        count = min(rows - done, size - filled)
        yield slice(done, done + count), slice(filled, filled + count)
        done, filled = done + count, (filled + count) % size


class RecordBlock:
    """Records of messages of one size, filled a column at a time.

    `empty`: returns a block of records for messages of a size, in bytes; the last field is ``data``
    `submit`: called with each full block, and with the rest at the end
    """

    def __init__(self, empty: Callable[[int], Records], submit: Callable[[Records], None]) -> None:
        self._empty = empty
        self._submit = submit
        self._rows: Records | None = None
        self._filled = 0

    def write(self, messages: Records, **columns: AnyArray) -> None:
        """Append messages and the other fields of their records, all of shape ``(N,)``."""
        if self._rows is None:
            self._rows = self._empty(messages.itemsize)
        columns["data"] = messages.view(self._rows.dtype["data"])
        for source, place in block_slices(len(messages), self._filled, len(self._rows)):
            for name, values in columns.items():
                self._rows[name][place] = values[source]
            self._filled = place.stop
            if self._filled == len(self._rows):
                self.flush()

    def flush(self) -> None:
        """Submit the records of a partly filled block."""
        if self._filled and self._rows is not None:
            self._submit(self._rows[: self._filled].copy())
            self._filled = 0


def empty_records(head: dict[str, str], size: int, block_bytes: int) -> Records:
    """Return a block of about `block_bytes` of records: fields, and data of `size` bytes."""
    dtype = np.dtype([*head.items(), ("data", f"V{size}")])
    return np.zeros(max(1, block_bytes // dtype.itemsize), dtype)


class FileWriter(ABC):
    """Writes batches of series to a file or folder, in order; without a commit, nothing is left.

    A commit has two steps, so that a run with several outputs writes all of them before it
    publishes the first: :meth:`finish`, which may fail, and :meth:`publish`. Errors of the
    operating system become OutputErrors. Arrays must not change before the commit.

    `rows`: converts a batch to timestamps in ns, and columns or messages
    `holds_positions`: whether positions are written, too; zero if a batch has none
    `locked_rows`: number of rows whose angles are not unique (gimbal lock)
    """

    rows: Callable[[Any], tuple[Int64, Any]]
    holds_positions = False
    locked_rows = 0

    _output: OutputFile | OutputPath
    _other_errors: tuple[type[Exception], ...] = ()
    """Errors of a library that become OutputErrors, too."""

    def __init__(self, output: OutputFile | OutputPath) -> None:
        self._output = output

    def write(self, series: AttitudeSeries | GyroSeries) -> None:
        """Append a batch; a closed pipe raises BrokenPipeError."""
        self.write_rows(*self.rows(series))

    def write_rows(self, t_ns: Int64, rows: Any) -> None:
        """Append a batch of rows.

        `t_ns`: the timestamps, or the log times of messages, shape ``(N,)``, ns
        `rows`: the named columns of a table, all of that length; or encoded messages, shape
            ``(N,)``, always of the same item size
        """
        with self._errors():
            self._write(t_ns, rows)

    @abstractmethod
    def _write(self, t_ns: Int64, rows: Any) -> None:
        """Append a batch of rows."""

    def commit(self, provenance: Mapping[str, object]) -> None:
        """Finish and publish the file; see :meth:`finish`."""
        self.finish(provenance)
        self.publish()

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Write the rest of the file.

        `provenance`: convention, layout, method, q0, source, counts and versions behind the
            content; JSON-ready. Stored in the file if the format can store it. May be empty
        """
        with self._errors():
            self._finish(provenance)
            self._output.finish()

    @abstractmethod
    def _finish(self, provenance: Mapping[str, object]) -> None:
        """Write the rest of the content."""

    def publish(self) -> None:
        """Replace the target with the finished file."""
        self._output.publish()

    def abort(self) -> None:
        """Discard uncommitted output; does nothing after a commit."""
        self._output.discard()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.abort()

    def _errors(self) -> AbstractContextManager[None]:
        return output_errors(self._output.target, *self._other_errors)

    @contextmanager
    def _opening(self) -> Iterator[None]:
        """Discard the output if opening the file fails."""
        try:
            with self._errors():
                yield
        except BaseException:
            self._output.discard()
            raise


class TableWriter(FileWriter):
    """A file of named columns: int64 timestamps ``t_ns`` first, then float64.

    With `holds_positions`, three columns of positions may follow those of the quaternion.
    """

    _output: OutputFile


class MessageWriter(FileWriter):
    """A container for one topic, whose messages all have one size."""


# Write attitude series as rows of a table, or as messages.


def attitude_table(
    table: TableWriter,
    layout: Layout,
    sigma: str | None = None,
    form: Representation | None = None,
) -> TableWriter:
    """Return a table that writes attitudes: timestamps, four components, and more columns.

    `table`: a table with the columns of `layout`, of `form` and of standard deviations
    `sigma`: the axes of the columns of standard deviations at the end; None for no such columns
    `form`: another representation of each attitude to write, such as its angles; None for none
    """
    from quatprop.kinematics.series import standard_deviations

    holds_positions = table.holds_positions

    def columns(series: AttitudeSeries) -> Columns:
        columns = [series.wxyz[:, component] for component in layout.order]
        if holds_positions and series.position is not None:
            columns += list(series.position.T)
        if form is not None:
            columns += map(np.ascontiguousarray, form.values(series.wxyz).T)
        if sigma is not None and series.covariance is not None:
            to_ref = series.wxyz if sigma == "reference" else None
            columns += list(standard_deviations(series.covariance, to_ref).T)
        return series.t_ns, columns

    table.rows = columns
    return table


def column_table(
    table: TableWriter,
    values: Callable[[Any], Float64],
    locked: Callable[[Float64], int] = lambda _values: 0,
) -> TableWriter:
    """Return a table that writes numbers that are computed from series.

    `values`: computes the columns of a series, shape ``(N, k)``
    `locked`: counts the rows of gimbal lock in them
    """
    # A cycle would keep the temporary file of a run that is interrupted.
    writer = weakref.proxy(table)

    def columns(series: AttitudeSeries | GyroSeries) -> Columns:
        numbers = values(series)
        writer.locked_rows += locked(numbers)
        return series.t_ns, [np.ascontiguousarray(column) for column in numbers.T]

    table.rows = columns
    return table


def attitude_messages(
    container: MessageWriter,
    encoder: AttitudeEncoder,
    target: Path | str,
    log_times: Callable[[AttitudeSeries], Int64] = lambda series: series.t_ns,
) -> MessageWriter:
    """Return a container that attitudes are written to as messages.

    `log_times`: returns the log times of attitudes, ns
    """

    def messages(series: AttitudeSeries) -> tuple[Int64, Records]:
        encoded = encoder.encode(series, target)
        return log_times(series), encoded

    container.rows, container.holds_positions = messages, encoder.holds_positions
    return container
