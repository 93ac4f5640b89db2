"""Conversion of columns between NumPy and Arrow, without copies where possible.

Arrow's own conversions import pandas if it is installed, to test whether the input is a Series:
this would add a fifth of a second to every command.
"""

from __future__ import annotations

from collections import Counter, deque
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

_CODES = ("f8", "f4", "f2", "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1")
_TYPES = {np.dtype(code): pa.from_numpy_dtype(np.dtype(code)) for code in _CODES}
_held: deque[pa.Buffer] = deque(maxlen=2)
_DTYPES = {kind: dtype for dtype, kind in _TYPES.items()}


def readable(data: bytes | memoryview) -> pa.BufferReader:
    """Return bytes as a file for Arrow.

    A thread of Arrow may release the last reference to them. If the interpreter is shutting down
    then, as after an interruption, the process would abort: so the latest two are kept here.
    """
    buffer = pa.py_buffer(data)
    _held.append(buffer)
    return pa.BufferReader(buffer)


def to_arrow(values: NDArray[Any]) -> pa.Array:
    """Return a column as an Arrow array, without a copy if it is contiguous.

    `values`: numbers or booleans, shape ``(N,)``
    """
    if values.dtype == np.bool_:
        bits = np.packbits(values, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), len(values), [None, pa.py_buffer(bits)])
    native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    return pa.Array.from_buffers(
        _TYPES[native.dtype], len(native), [None, pa.py_buffer(native)], null_count=0
    )


def series_schema(
    names: Iterable[str], facts: Mapping[str, Mapping[str, str]] = MappingProxyType({})
) -> pa.Schema:
    """Return the schema of a series: ``t_ns`` int64, and float64 columns.

    A name that is repeated is one column of lists of that length. No column is nullable, so Parquet
    files need not store which values are present.

    `facts`: metadata of the fields, by name
    """
    number = pa.field("element", pa.float64(), nullable=False)
    types = {
        "t_ns": pa.int64(),
        **{
            name: pa.float64() if size == 1 else pa.list_(number, size)
            for name, size in Counter(list(names)).items()
        },
    }
    return pa.schema(
        [
            pa.field(name, kind, nullable=False, metadata=facts.get(name))
            for name, kind in types.items()
        ]
    )


def series_arrays(schema: pa.Schema, columns: Iterable[NDArray[Any]]) -> list[pa.Array]:
    """Return the columns of a series as arrays of its schema, those of lists put together."""
    rest = iter(columns)

    def array(kind: pa.DataType) -> pa.Array:
        if not pa.types.is_fixed_size_list(kind):
            return to_arrow(next(rest))
        rows = np.stack([next(rest) for _ in range(kind.list_size)], axis=1)
        return pa.FixedSizeListArray.from_arrays(to_arrow(rows.ravel()), type=kind)

    return [array(kind) for kind in schema.types]


def nested_schema(fields: Mapping[tuple[str, ...], pa.DataType]) -> pa.Schema:
    """Return the schema of some fields, nested by their paths."""
    tree: dict[str, Any] = {}
    for path, kind in fields.items():
        place = tree
        for name in path[:-1]:
            place = place.setdefault(name, {})
        place[path[-1]] = kind
    return pa.schema(_struct_fields(tree))


def _struct_fields(tree: dict[str, Any]) -> list[pa.Field]:
    return [
        pa.field(name, pa.struct(_struct_fields(kind)) if isinstance(kind, dict) else kind)
        for name, kind in tree.items()
    ]


def text_scalar(text: str) -> pa.StringScalar:
    """Return a text as an Arrow value."""
    data = text.encode()
    ends = np.array([0, len(data)], np.int32)
    return pa.Array.from_buffers(pa.string(), 1, [None, pa.py_buffer(ends), pa.py_buffer(data)])[0]


def to_numpy(column: pa.Array | pa.ChunkedArray) -> NDArray[Any]:
    """Return a column of numbers or booleans as an array, read-only if it is a view.

    `column`: shape ``(N,)``; nulls of floats become NaN; columns of other types must have none
    """
    if isinstance(column, pa.ChunkedArray):
        parts = [to_numpy(chunk) for chunk in column.chunks]
        if len(parts) == 1:
            return parts[0]
        empty = np.empty(0, _DTYPES.get(column.type, np.dtype(np.bool_)))
        return np.concatenate([*parts, empty])
    validity, data = column.buffers()
    if pa.types.is_boolean(column.type):
        return _bits(data, column)
    dtype = _DTYPES[column.type]
    if data is None:
        return np.zeros(len(column), dtype)
    numbers: NDArray[Any] = np.frombuffer(data, dtype, len(column), column.offset * dtype.itemsize)
    if column.null_count:
        numbers = np.where(_bits(validity, column), numbers, dtype.type(np.nan))
    return numbers


def _bits(data: pa.Buffer | None, column: pa.Array) -> NDArray[np.bool_]:
    """Return a column's part of a bitmap."""
    if data is None:
        return np.zeros(len(column), np.bool_)
    every = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
    return every[column.offset : column.offset + len(column)].view(np.bool_)
