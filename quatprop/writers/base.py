"""Interfaces of the writers: attitude series, tables of columns, encoded messages."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from quatprop.provenance import as_json
from quatprop.writers.atomic import output_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path
    from typing import Any, Self

    from numpy.typing import NDArray

    from quatprop.arrays import Float64, Int64
    from quatprop.conventions.layout import Layout
    from quatprop.conventions.representations import Representation
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.atomic import OutputFile, OutputPath
    from quatprop.writers.messages.encoders import AttitudeEncoder


def provenance_json(provenance: Mapping[str, object]) -> str:
    """Return a provenance as it is kept in files: JSON on one line, plain ASCII.

    Examples
    --------
    >>> provenance_json({"source": "a.bag", "samples": 1})
    '{"samples": 1, "source": "a.bag"}'
    """
    return json.dumps(provenance, sort_keys=True, default=as_json)


def block_slices(rows: int, filled: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Yield how a batch of rows is distributed to blocks that all have one size.

    Blocks end at fixed rows, wherever a batch ends: the bytes do not depend on batches.

    Parameters
    ----------
    rows
        Rows of the batch.
    filled
        Rows that the first block has already.
    size
        Rows of a block. The caller starts the next one when a place ends at `size`.

    Yields
    ------
    source, place
        Rows of the batch, and where they go in the block.

    Examples
    --------
    >>> list(block_slices(3, 3, 4))
    [(slice(0, 1, None), slice(3, 4, None)), (slice(1, 3, None), slice(0, 2, None))]
    """
    done = 0
    while done < rows:
        count = min(rows - done, size - filled)
        yield slice(done, done + count), slice(filled, filled + count)
        done, filled = done + count, (filled + count) % size


class Transaction(ABC):
    """A context manager that removes what was not committed.

    A commit has two steps, so that a run with several outputs writes all of them before it puts
    the first in its place: :meth:`finish`, which may fail, and :meth:`publish`.
    """

    def commit(self, provenance: Mapping[str, object]) -> None:
        """Finish the file and put it in its place; see :meth:`finish`."""
        self.finish(provenance)
        self.publish()

    @abstractmethod
    def finish(self, provenance: Mapping[str, object]) -> None:
        """Write the file to its end.

        Parameters
        ----------
        provenance
            How the content came about: convention, layout, method, q0, source, counts,
            versions; JSON-ready. Kept in the file where the format has a place for it. May be
            empty.

        Raises
        ------
        OutputError
            The file cannot be finished.
        """

    @abstractmethod
    def publish(self) -> None:
        """Put the finished file in its place."""

    @abstractmethod
    def abort(self) -> None:
        """Remove what was not committed; does nothing after a commit."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.abort()


class FileWriter(Transaction):
    """Writes a file or folder; errors of the system become errors that name it.

    Parameters
    ----------
    output
        What is written.
    """

    _output: OutputFile | OutputPath

    def __init__(self, output: OutputFile | OutputPath) -> None:
        self._output = output

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Write the file to its end."""
        with self._errors():
            self._finish(provenance)
            self._output.finish()

    @abstractmethod
    def _finish(self, provenance: Mapping[str, object]) -> None:
        """Write what is left to write."""

    def publish(self) -> None:
        """Put the finished file in its place."""
        self._output.publish()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._output.discard()

    def _errors(self) -> AbstractContextManager[None]:
        return output_errors(self._output.target)


class TableWriter(FileWriter):
    """A file of named columns: int64 stamps ``t_ns`` first, then float64.

    Attributes
    ----------
    holds_positions
        Whether three columns of positions may follow those of the quaternion.
    """

    holds_positions = False

    _output: OutputFile

    def write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows: stamps and the named columns, all of one length.

        Raises
        ------
        OutputError
            The disk is full, or the target is otherwise gone.
        BrokenPipeError
            The reader of the output has gone.
        """
        with self._errors():
            self._write(t_ns, columns)

    @abstractmethod
    def _write(self, t_ns: NDArray[Any], columns: Sequence[NDArray[Any]]) -> None:
        """Append a batch of rows."""


class MessageWriter(FileWriter):
    """A container to which one topic is written whose messages all have one size."""

    def write(self, log_ns: Int64, messages: NDArray[np.void]) -> None:
        """Append a batch of messages.

        Parameters
        ----------
        log_ns
            When each was logged, shape ``(N,)``, ns.
        messages
            The encoded messages, shape ``(N,)``, always of the same item size.

        Raises
        ------
        OutputError
            The disk is full, or the target is otherwise gone.
        """
        with self._errors():
            self._write(log_ns, messages)

    @abstractmethod
    def _write(self, log_ns: Int64, messages: NDArray[np.void]) -> None:
        """Append a batch of messages."""


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
