"""A NumPy array in a file by itself: records, or columns without names."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from quatprop.errors import DamagedLogError
from quatprop.tables.npy_format import HeaderError, columns_of, read_header
from quatprop.tables.numpy_table import NumpyTable

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO


class NpyLog(NumpyTable):
    """An array in a file by itself.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    OSError
        The file cannot be read.
    DamagedLogError
        Its header cannot be used.
    """

    kind = "npy"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        with path.open("rb") as stream:
            try:
                header = read_header(stream)
                columns = columns_of(header)
            except HeaderError as error:
                raise DamagedLogError(path, str(error)) from error
            begin, size = stream.tell(), stream.seek(0, 2)
        for column in columns:
            # Columns without names have numbers, as those of text have.
            name = column.name if header.dtype.names else (column.name or "[0]")[1:-1]
            self._add_column(name, "", column)
        beyond = size - begin - math.prod(header.shape) * header.dtype.itemsize
        if beyond > 0:
            self.losses.note("end of the file", f"{beyond} bytes follow its array")

    def _open_array(self, member: str) -> BinaryIO:  # noqa: ARG002  # there is one array
        return self.path.open("rb")
