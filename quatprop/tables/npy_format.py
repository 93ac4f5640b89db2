"""NumPy's array format: headers, and the columns of an array.

Headers are not read by ``numpy.lib.format``, which has no public function for version 3, trusts any
size, and has no clear errors for other content. Nothing is unpickled.

References
----------
NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays", and its versions 2 and 3.
"""

from __future__ import annotations

import ast
import math
import struct
from itertools import islice
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

MAGIC = b"\x93NUMPY"
_PREAMBLES = {(1, 0): ("<H", "latin-1"), (2, 0): ("<I", "latin-1"), (3, 0): ("<I", "utf-8")}
"""Version -> format of the header length, and encoding of the header."""

_LONGEST_HEADER = 1 << 15
_WIDEST_ROW = 1 << 20
_MOST_COLUMNS = 4096
_MOST_SIGNALS, _FEWEST_SAMPLES = 20, 100


class HeaderError(ValueError):
    """The header cannot be used, for the reason in the message."""


class ArrayHeader(NamedTuple):
    """The header of an array.

    `is_fortran`: whether it is stored column by column
    """

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    is_fortran: bool


class ArrayColumn(NamedTuple):
    """A column of numbers within an array.

    `name`: ``""`` for a plain array of one dimension
    `start`: position of its first row after the header, bytes
    `step`: distance of rows, bytes
    `offset`: position of the value in a row, bytes
    """

    name: str
    dtype: np.dtype[Any]
    start: int
    step: int
    offset: int
    rows: int


def has_signals_in_rows(shape: tuple[int, ...]) -> bool:
    """Return whether rows of a matrix are signals instead of samples, as is common in MATLAB.

    It then has few rows and many columns.
    """
    return len(shape) == 2 and shape[0] <= _MOST_SIGNALS and shape[1] > _FEWEST_SAMPLES  # noqa: PLR2004


def read_header(stream: BinaryIO) -> ArrayHeader:
    """Read the header of an array, up to its first number."""
    magic = stream.read(len(MAGIC) + 2)
    version = tuple(magic[len(MAGIC) :])
    if not magic.startswith(MAGIC) or len(version) != 2:  # noqa: PLR2004  # major and minor
        raise HeaderError("it does not begin as a NumPy array; check that it was copied whole")
    if version not in _PREAMBLES:
        shown = ".".join(map(str, version))
        raise HeaderError(f"it is of version {shown} and 1.0 to 3.0 are read; save it again")
    length_format, encoding = _PREAMBLES[version]
    size = stream.read(struct.calcsize(length_format))
    length = int.from_bytes(size, "little")
    if length > _LONGEST_HEADER:
        raise HeaderError(f"its header claims {length} bytes, which no table needs")
    text = stream.read(length)
    if len(text) < length or not length:
        raise HeaderError("it ends within its header; check that it was copied whole")
    try:
        return _header(ast.literal_eval(text.decode(encoding).strip()))
    except HeaderError:
        raise
    except Exception as error:
        # The parsers of Python and NumPy raise all kinds of exceptions.
        raise HeaderError("its header is damaged; save it again") from error


def _header(facts: dict[str, Any]) -> ArrayHeader:
    descr, shape = facts["descr"], facts["shape"]
    if not isinstance(shape, tuple) or any(type(size) is not int or size < 0 for size in shape):
        raise HeaderError("its header gives no shape; save it again")
    dtype = np.lib.format.descr_to_dtype(descr)
    if dtype.hasobject:
        raise HeaderError(
            "it holds pickled Python objects, which could run code and are not read; "
            "save plain numbers"
        )
    if not 0 < dtype.itemsize <= _WIDEST_ROW:
        raise HeaderError(f"its elements have {dtype.itemsize} bytes, which no table needs")
    return ArrayHeader(dtype, shape, bool(facts["fortran_order"]))


def columns_of(header: ArrayHeader) -> list[ArrayColumn]:
    """Return the columns of an array, at least one.

    An array of records has one for each field, with nested fields as ``field.part`` and elements of
    fields that are arrays as ``field[0]``. A plain array of two dimensions has ``[0]``, ``[1]``...
    if there are several. A matrix with signals in rows is transposed.
    """
    dtype, shape, is_fortran = header
    if has_signals_in_rows(shape):
        shape, is_fortran = shape[::-1], not is_fortran
    if len(shape) == 1:
        rows, fields, step = shape[0], _fields(dtype), dtype.itemsize
    elif len(shape) == 2 and not dtype.names:  # noqa: PLR2004  # rows and columns
        rows, width = shape
        # In column-major order, each column is contiguous.
        step = dtype.itemsize * (1 if is_fortran else width)
        names = (f"[{k}]" if width > 1 else "" for k in range(width))
        fields = ((name, dtype, k * dtype.itemsize) for k, name in enumerate(names))
    else:
        raise HeaderError(
            f"its array of shape {shape} is not a table; save one row per sample, in two "
            "dimensions or as records"
        )
    placed = list(islice(fields, _MOST_COLUMNS + 1))
    if not 0 < len(placed) <= _MOST_COLUMNS or step > _WIDEST_ROW:
        raise HeaderError(f"its rows have {step} bytes, which no table needs")
    by_column = len(shape) == 2 and is_fortran  # noqa: PLR2004  # rows and columns
    return [
        ArrayColumn(name, kind, *((place * rows, step, 0) if by_column else (0, step, place)), rows)
        for name, kind, place in placed
    ]


def _fields(
    dtype: np.dtype[Any], name: str = "", place: int = 0
) -> Iterator[tuple[str, np.dtype[Any], int]]:
    """Yield name, type and offset of every number in a record."""
    if dtype.names is not None and dtype.fields is not None:
        for field in dtype.names:
            inner, offset = dtype.fields[field][:2]
            yield from _fields(inner, f"{name}.{field}" if name else field, place + offset)
    elif dtype.subdtype is not None:
        base, shape = dtype.subdtype
        for k in range(math.prod(shape)):
            yield from _fields(base, f"{name}[{k}]", place + k * base.itemsize)
    else:
        yield name, dtype, place
