"""Attitudes as a TUM trajectory: ``timestamp tx ty tz qx qy qz qw`` between blanks.

Seconds are written with nine decimals out of the integer nanoseconds, so nothing is rounded; the
position, which attitude does not tell, is zero.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.arrow_arrays import to_arrow
from quatprop.writers.base import AttitudeTable
from quatprop.writers.tables.text import TextTable, delimited

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from quatprop.conventions.layout import Layout

HEAD = "# timestamp tx ty tz qx qy qz qw\n"
_FORM = delimited(" ", HEAD.split()[1:])
_DECIMALS = 9


def attitudes(target: Path | str, layout: Layout, *, comment: bool = False) -> AttitudeTable:
    """Open a TUM trajectory of attitudes."""
    return AttitudeTable(TextTable(target, HEAD, _rows, comment=comment), layout)


def _rows(columns: list[NDArray[Any]]) -> pa.Buffer:
    t_ns, *xyzw = columns
    return _FORM([seconds(t_ns), *[np.zeros(len(t_ns), np.int8)] * 3, *xyzw])


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
