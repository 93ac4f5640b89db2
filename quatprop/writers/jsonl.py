"""Tables as JSON Lines: one object per row, with keys in the order of the columns.

Each number is the shortest decimal that reads back as the same float64; NaN and infinity, which
JSON does not have, are null.
"""

from __future__ import annotations

import json
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.base.arrow_arrays import text_scalar, to_arrow
from quatprop.writers.text_tables import TextTable

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray
    from quatprop.writers.text_tables import Formatter


class JsonLinesTable(TextTable):
    """A table in JSON Lines.

    `target`: a path, or ``"-"`` for stdout
    `names`: names of the float64 columns that follow ``t_ns``
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:
        super().__init__(target, "", _objects(("t_ns", *names)))


def _objects(names: Sequence[str]) -> Formatter:
    """Return a formatter of columns as objects with some keys."""
    keys = [
        text_scalar(f"{',' if place else '{'}{json.dumps(name)}:")
        for place, name in enumerate(names)
    ]
    end, no_separator = text_scalar("}\n"), text_scalar("")

    def formatter(columns: list[AnyArray]) -> pa.Buffer:
        parts = chain.from_iterable(zip(keys, map(_numbers, columns), strict=True))
        lines = pc.binary_join_element_wise(*parts, end, no_separator)
        # Arrow stores the strings of an array contiguously: that is the text.
        _, ends, text = lines.buffers()
        return text.slice(0, np.frombuffer(ends, np.int32, len(lines) + 1)[-1])

    return formatter


def _numbers(column: AnyArray) -> pa.Array:
    """Return numbers as text in JSON."""
    text = pc.cast(to_arrow(column), pa.string())
    if column.dtype == np.int64:
        return text
    # Without a point, minus zero would be read as an integer, which has no sign.
    minus_zero = (column == 0) & np.signbit(column)
    if minus_zero.any():
        text = pc.if_else(to_arrow(minus_zero), text_scalar("-0.0"), text)
    finite = np.isfinite(column)
    return text if finite.all() else pc.if_else(to_arrow(finite), text, text_scalar("null"))
