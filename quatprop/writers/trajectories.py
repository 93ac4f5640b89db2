"""Trajectories in the formats of TUM RGB-D, EuRoC and KITTI, and orientations of OpenSim.

The position is zero if the attitudes have none. The velocities and biases of EuRoC's ground truth
are omitted, as they are unknown; rows of KITTI are a matrix (R | t) without a time.
"""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from quatprop.base.arrow_arrays import to_arrow
from quatprop.base.places import is_stdout
from quatprop.kinematics.quaternion import normalize, rotation_matrix
from quatprop.writers.text_tables import TextTable, delimited

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Int64

    Column = AnyArray
    Columns = Sequence[Column]

_DECIMALS = 9


class TumTable(TextTable):
    """``timestamp tx ty tz qx qy qz qw``: seconds with nine decimals, which are exact.

    Parameters are those of a CSV table; the format prescribes the names of columns.
    """

    holds_positions = True
    header = "# timestamp tx ty tz qx qy qz qw\n"
    separator = " "

    def __init__(
        self,
        target: Path | str,
        names: Sequence[str],  # noqa: ARG002  # prescribed by the format
        *,
        comment: bool = False,
    ) -> None:
        super().__init__(target, self.header, self._rows, comment=comment)

    def _rows(self, columns: list[Column]) -> pa.Buffer:
        position = columns[5:] or [np.zeros(len(columns[0]), np.int8)] * 3
        values = self.values(columns[0], columns[1:5], position)
        return delimited(self.separator)(values)

    @staticmethod
    def values(t_ns: Column, quaternion: Columns, position: Columns) -> list[Any]:
        """Return the columns of the file from timestamps, components in its layout, and x, y, z."""
        return [seconds(t_ns), *position, *quaternion]


class EurocTable(TumTable):
    """Timestamps in ns, position, quaternion: the first columns of EuRoC's ground truth."""

    header = (
        "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
        "q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    )
    separator = ","

    @staticmethod
    def values(t_ns: Column, quaternion: Columns, position: Columns) -> list[Any]:
        """Return the columns of the file."""
        return [t_ns, *position, *quaternion]


class KittiTable(TumTable):
    """Twelve numbers: the matrix (R | t) row by row."""

    header = ""

    @staticmethod
    def values(t_ns: Column, quaternion: Columns, position: Columns) -> list[Any]:  # noqa: ARG004
        """Return the columns of the file."""
        matrix = rotation_matrix(normalize(np.stack(quaternion, axis=-1)))
        return [part for row in range(3) for part in (*matrix[:, row].T, position[row])]


class StoTable(TextTable):
    """Seconds and one sensor, ``w,x,y,z`` in one cell, named after the file: as OpenSense reads it.

    Parameters are those of a CSV table; the format prescribes the names of columns.
    """

    def __init__(self, target: Path | str, names: Sequence[str]) -> None:  # noqa: ARG002
        sensor = "imu" if is_stdout(target) else PurePath(target).stem
        header = f"DataType=Quaternion\nversion=3\nOpenSimVersion=4.5\nendheader\ntime\t{sensor}\n"
        super().__init__(target, header, self._rows)

    @staticmethod
    def _rows(columns: list[Column]) -> pa.Buffer:
        t_ns, *quaternion = columns
        cells = [pc.cast(to_arrow(part), pa.string()) for part in quaternion[:4]]
        return delimited("\t")([seconds(t_ns), pc.binary_join_element_wise(*cells, ",")])


def seconds(t_ns: Int64) -> pa.Array:
    """Return timestamps as text: seconds with nine decimals, exact."""
    digits = pc.utf8_lpad(pc.cast(to_arrow(np.abs(t_ns).view(np.uint64)), pa.string()), 10, "0")
    text = pc.binary_replace_slice(digits, -_DECIMALS, -_DECIMALS, ".")
    negative = t_ns < 0
    if negative.any():
        text = pc.if_else(to_arrow(negative), pc.binary_join_element_wise("-", text, ""), text)
    return text
