"""ROS messages encoded by the block: columns in, an array of encoded messages out.

The strings are the same in every message, so every message has its fields in the same places: a
block is an array of records. rosbags would encode one message at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]

NS_PER_S = 1_000_000_000
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"
HEADER_TIME = "header time"
"""Format of a header's stamp, in ROS 1 with the sequence number ahead of it."""


class RosRecords:
    """Messages of one type, of which a block is an array of records.

    Parameters
    ----------
    fields
        The fields in order, by name: the NumPy format, :data:`HEADER_TIME`, or the constant
        content of a string.
    constants
        Values of other fields that are the same in every message.
    ros1
        Whether they are encoded as in ROS 1 rather than in CDR, little-endian, as in ROS 2.
    """

    def __init__(
        self, fields: Mapping[str, str | bytes], constants: Mapping[str, object], *, ros1: bool
    ) -> None:
        self._ros1 = ros1
        self._written = 0
        layout = _FieldLayout(ros1=ros1)
        for name, form in fields.items():
            layout.add(name, form)
        self._dtype = np.dtype(
            {"names": layout.names, "formats": layout.formats, "offsets": layout.offsets}
        )
        template = np.zeros(1, self._dtype)
        for name, value in {**layout.constants, **constants}.items():
            template[name] = value
        # As bare bytes: NumPy need not copy the padding between fields.
        self._template = template.view(f"V{self._dtype.itemsize}")

    def stamped(self, t_ns: Int64, target: Path | str) -> NDArray[np.void]:
        """Return messages with their stamps, shape ``(N,)``, whose other fields are to be filled.

        Raises
        ------
        OutputError
            A stamp is out of the range of ROS; the error names the target.
        """
        seconds, nanoseconds = np.divmod(t_ns, NS_PER_S)
        outside = (seconds < 0) | (seconds > np.iinfo(np.int32).max)
        if outside.any():
            raise OutputError(
                target,
                f"ROS has no time for the stamp {t_ns[outside.argmax()]} ns; "
                "write a table, or a trajectory",
            )
        rows = np.repeat(self._template, len(t_ns)).view(self._dtype)
        rows["sec"], rows["nanosec"] = seconds, nanoseconds
        if self._ros1:
            rows["seq"] = np.arange(self._written, self._written + len(t_ns), dtype=np.uint64)
        self._written += len(t_ns)
        return rows


class _FieldLayout:
    """Where the fields of a message are.

    ROS 1 packs its fields. CDR begins with four bytes that state the encoding, aligns each number
    to its size counted from after them, and ends strings with a zero that counts.
    """

    def __init__(self, *, ros1: bool) -> None:
        self._ros1 = ros1
        self.names: list[str] = []
        self.formats: list[str] = []
        self.offsets: list[int] = []
        self.constants: dict[str, object] = {}
        self._end = 0
        if not ros1:
            self._place("encapsulation", "V4")
            self.constants["encapsulation"] = np.void(_CDR_LITTLE_ENDIAN)

    def add(self, name: str, form: str | bytes) -> None:
        """Add a field: numbers, the parts of a stamp, or a string of constant content."""
        if form == HEADER_TIME:
            if self._ros1:
                self._place("seq", "<u4")
            self._place("sec", "<u4")
            self._place("nanosec", "<u4")
            return
        if isinstance(form, str):
            self._place(name, form)
            return
        content = form if self._ros1 else form + b"\0"
        self._place(f"{name}_length", "<u4")
        self.constants[f"{name}_length"] = len(content)
        if content:
            self._place(name, f"V{len(content)}")
            self.constants[name] = np.void(content)

    def _place(self, name: str, form: str) -> None:
        dtype = np.dtype(form)
        if not self._ros1:
            self._end += -(self._end - len(_CDR_LITTLE_ENDIAN)) % dtype.base.alignment
        self.names.append(name)
        self.formats.append(form)
        self.offsets.append(self._end)
        self._end += dtype.itemsize
