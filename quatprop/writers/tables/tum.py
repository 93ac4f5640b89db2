"""Attitudes as a TUM trajectory: ``timestamp tx ty tz qx qy qz qw`` between blanks.

Seconds are written with nine decimals from the integer nanoseconds, so nothing is rounded; the
position is zero where the attitudes have none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.arrow_arrays import to_arrow
from quatprop.writers.tables.text import TextTable, delimited

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

HEADER = "# timestamp tx ty tz qx qy qz qw\n"
_FORMATTER = delimited(" ", HEADER.split()[1:])
_DECIMALS = 9


class TumTable(TextTable):
    """Write quaternions as a TUM trajectory; parameters as for a CSV table."""

    holds_positions = True

    def __init__(
        self,
        target: Path | str,
        names: Sequence[str],  # noqa: ARG002  # prescribed by the format
        *,
        comment: bool = False,
    ) -> None:
        super().__init__(target, HEADER, _rows, comment=comment)


def _rows(columns: list[NDArray[Any]]) -> pa.Buffer:
    t_ns, xyzw, position = columns[0], columns[1:5], columns[5:]
    position = position or [np.zeros(len(t_ns), np.int8)] * 3
    return _FORMATTER([seconds(t_ns), *position, *xyzw])


def seconds(t_ns: NDArray[np.int64]) -> pa.Array:
    """Return stamps as text: seconds with nine decimals, exact.

    Examples
    --------
    >>> seconds(np.array([1_700_000_000_000_000_001, -5])).to_pylist()
    ['1700000000.000000001', '-0.000000005']
    """
    digits = pc.utf8_lpad(pc.cast(to_arrow(np.abs(t_ns).view(np.uint64)), pa.string()), 10, "0")
    text = pc.binary_replace_slice(digits, -_DECIMALS, -_DECIMALS, ".")
    negative = t_ns < 0
    if negative.any():
        text = pc.if_else(to_arrow(negative), pc.binary_join_element_wise("-", text, ""), text)
    return text
