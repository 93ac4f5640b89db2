"""Interfaces of the writers of files: tables of columns, encoded messages."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from quatprop.provenance import as_json
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager

    from quatprop.arrays import AnyArray, Int64, Records
    from quatprop.writers.atomic import OutputFile, OutputPath


def provenance_json(provenance: Mapping[str, object]) -> str:
    """Return a provenance as it is kept in files: JSON on one line, plain ASCII."""
    return json.dumps(provenance, sort_keys=True, default=as_json)


def block_slices(rows: int, filled: int, size: int) -> Iterator[tuple[slice, slice]]:
    """Yield how a batch of rows is distributed to blocks that all have one size.

    Blocks end at fixed rows, wherever a batch ends: the bytes do not depend on batches.
    """
    done = 0
    while done < rows:
        count = min(rows - done, size - filled)
        yield slice(done, done + count), slice(filled, filled + count)
        done, filled = done + count, (filled + count) % size


class RecordBlock:
    """Records of messages that all have one size, filled a column at a time.

    `empty`: returns the records of a block of messages of a size, whose field ``data`` is the last
    `submit`: takes a full block, and at the end what is left
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
        """Hand on the records that do not fill a block."""
        if self._filled and self._rows is not None:
            self._submit(self._rows[: self._filled].copy())
            self._filled = 0


def empty_records(head: dict[str, str], size: int, block_bytes: int) -> Records:
    """Return a block of about so many bytes of records: fields, and data of `size` bytes."""
    dtype = np.dtype([*head.items(), ("data", f"V{size}")])
    return np.zeros(max(1, block_bytes // dtype.itemsize), dtype)


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

        `provenance`: how the content came about: convention, layout, method, q0, source, counts,
            versions; JSON-ready. Kept in the file where the format has a place for it. May be empty
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
    """Writes a file or folder; errors of the system become errors that name it."""

    _output: OutputFile | OutputPath
    _other_errors: tuple[type[Exception], ...] = ()
    """What a library raises besides errors of the system."""

    def __init__(self, output: OutputFile | OutputPath) -> None:
        self._output = output

    def write(self, t_ns: Int64, rows: Any) -> None:
        """Append a batch of rows; a closed pipe raises BrokenPipeError.

        `t_ns`: the stamp of each, shape ``(N,)``, ns; of messages, when each was logged
        `rows`: the named columns of a table, all of that length; or encoded messages, shape
            ``(N,)``, always of the same item size
        """
        with self._errors():
            self._write(t_ns, rows)

    @abstractmethod
    def _write(self, t_ns: Int64, rows: Any) -> None:
        """Append a batch of rows."""

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
        return output_errors(self._output.target, *self._other_errors)

    @contextmanager
    def _opening(self) -> Iterator[None]:
        """Remove the file where it cannot even be begun."""
        try:
            with self._errors():
                yield
        except BaseException:
            self._output.discard()
            raise


class TableWriter(FileWriter):
    """A file of named columns: int64 stamps ``t_ns`` first, then float64.

    `holds_positions`: whether three columns of positions may follow those of the quaternion
    """

    holds_positions = False

    _output: OutputFile


class MessageWriter(FileWriter):
    """A container to which one topic is written whose messages all have one size."""
