"""Trajectories without a header, whose columns are known: of TUM RGB-D and of KITTI."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, BinaryIO

from quatprop.errors import UnsupportedLogError
from quatprop.tables.csv.log import CsvLog

if TYPE_CHECKING:
    from pathlib import Path


class TumLog(CsvLog):
    """A trajectory of eight columns: time in seconds, position, quaternion.

    Parameters
    ----------
    source
        As for :class:`quatprop.tables.csv.log.CsvLog`.

    Raises
    ------
    UnreadableLogError
        The file cannot be read, or is empty.
    UnsupportedLogError
        It has other columns.
    """

    kind = "tum"
    expected: tuple[str, ...] = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")

    def __init__(self, source: Path | BinaryIO) -> None:
        super().__init__(source)
        if self._layout.header:
            return
        if len(self._layout.names) != len(self.expected):
            raise UnsupportedLogError(
                self.path,
                f"it has {len(self._layout.names)} columns, and a {self.kind.upper()} trajectory "
                f"has {len(self.expected)}: {' '.join(self.expected)}",
            )
        self._layout = replace(self._layout, names=list(self.expected))


class KittiLog(TumLog):
    """A trajectory of twelve columns, which are a matrix (R | t) row by row; it has no times."""

    kind = "kitti"
    expected = (
        *("r11", "r12", "r13", "tx"),
        *("r21", "r22", "r23", "ty"),
        *("r31", "r32", "r33", "tz"),
    )
