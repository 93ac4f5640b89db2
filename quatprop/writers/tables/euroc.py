"""Attitudes as the EuRoC ground truth lays them out: position, then quaternion, scalar first.

Only the columns that trajectory tools read: of position, which attitude does not tell, zeros;
velocities and biases are left out rather than invented.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.writers.base import AttitudeTable
from quatprop.writers.tables.text import TextTable, delimited

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    import pyarrow as pa
    from numpy.typing import NDArray

    from quatprop.conventions.layout import Layout

HEAD = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
)
_FORM = delimited(",", ("timestamp", "x", "y", "z", "qw", "qx", "qy", "qz"))


def attitudes(target: Path | str, layout: Layout, *, comment: bool = False) -> AttitudeTable:
    """Open a file of attitudes as EuRoC lays out its ground truth; stamps are in ns."""
    return AttitudeTable(TextTable(target, HEAD, _rows, comment=comment), layout)


def _rows(columns: list[NDArray[Any]]) -> pa.Buffer:
    t_ns, *wxyz = columns
    return _FORM([t_ns, *[np.zeros(len(t_ns), np.int8)] * 3, *wxyz])
