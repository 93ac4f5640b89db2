"""Times in messages: field names, and conversion to exact int64 nanoseconds."""

from __future__ import annotations

from decimal import Decimal
from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import MessageError
from quatprop.text import Setting, listed
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray, Int64

SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")
"""Names of the two fields of a time, in ROS 1, ROS 2 and related systems."""


def to_ns(
    columns: Sequence[AnyArray], units: Sequence[str], names: Sequence[str], path: Path | str
) -> Int64:
    """Return times in ns, shape ``(N,)``, from one column, or from seconds and nanoseconds.

    `columns`: shape ``(N,)`` each: integers, float64, or objects that are integers and decimals.
        The nanoseconds may be more than a second
    `units`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"`` of each; ``"ns"`` of the second
    """
    first, scale = columns[0], NS_PER_UNIT[units[0]]
    limit = np.iinfo(np.int64).max // scale
    bad: list[int] = []
    if first.dtype == np.object_:
        bad = [row for row, value in enumerate(first) if not -limit < value < limit]
    elif first.dtype.kind == "f" or first.dtype.itemsize == np.dtype(np.int64).itemsize:
        # In this form the condition refuses NaN, too.
        bad = np.flatnonzero(~((first > -limit) & (first < limit))).tolist()
    if bad:
        raise MessageError(
            path,
            (
                f"the time {first[bad[0]]} {units[0]} in {listed(names)} does not fit in 64 bits "
                f"of nanoseconds; choose {Setting('clock', 'log')} or another "
                f"{Setting('time_field')}"
            ),
            bad,
        )
    t_ns = _scaled(first, scale)
    for nanoseconds in columns[1:]:
        np.add(t_ns, nanoseconds, out=t_ns, dtype=np.int64, casting="unsafe")
    return t_ns


def _scaled(column: AnyArray, scale: int) -> Int64:
    t_ns: Int64
    if column.dtype == np.object_:
        whole = [int((Decimal(value) * scale).to_integral_value()) for value in column]
        t_ns = np.array(whole, np.int64)
    elif column.dtype.kind == "f":
        seconds = np.floor(column).astype(np.int64)
        t_ns = seconds * scale
        t_ns += np.rint((column - seconds) * scale).astype(np.int64)
    else:
        t_ns = np.multiply(column, scale, dtype=np.int64, casting="unsafe")
    return t_ns
