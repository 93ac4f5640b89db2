"""Attitudes in the layout of the EuRoC ground truth: position, then quaternion, scalar first.

Only the columns that trajectory tools read: the position is zero where the attitudes have none;
velocities and biases are left out rather than invented. Stamps are in ns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.writers.tables.text import TextTable, delimited

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from typing import Any

    import pyarrow as pa
    from numpy.typing import NDArray

HEADER = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
)
_FORMATTER = delimited(",", ("timestamp", "x", "y", "z", "qw", "qx", "qy", "qz"))


class EurocTable(TextTable):
    """Write quaternions as EuRoC ground truth; parameters as for a CSV table."""

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
    t_ns, wxyz, position = columns[0], columns[1:5], columns[5:]
    position = position or [np.zeros(len(t_ns), np.int8)] * 3
    return _FORMATTER([t_ns, *position, *wxyz])
