"""Attitudes as ROS messages by the block: columns in, an array of encoded messages out.

The names of the frames are the same in every message, so every message has its fields in the
same places: a block is an array of records.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError, UsageError
from quatprop.text import listed, quoted
from quatprop.writers.messages.kinds import MESSAGES

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message

NS_PER_S = 1_000_000_000
_STAMP = (("sec", "<i4"), ("nanosec", "<u4"))
_ROS1_STAMP = (("seq", "<u4"), ("sec", "<u4"), ("nanosec", "<u4"))
_CDR_LITTLE_ENDIAN = b"\0\1\0\0"


class Encoder:
    """Encodes attitudes as one kind of message.

    Parameters
    ----------
    message
        What to encode.
    ros1
        Whether as ROS 1 does rather than in CDR, little-endian, as ROS 2 does.

    Raises
    ------
    UsageError
        It is no ROS message.
    """

    def __init__(self, message: Message, *, ros1: bool = False) -> None:
        if not message.definition.is_ros:
            ros = listed(name for name, known in MESSAGES.items() if known.is_ros)
            raise UsageError(
                f"{quoted(message.type)} is Foxglove's own, in protobuf, and ROS bags hold ROS "
                f"messages; write mcap, or choose {ros}"
            )
        self._ros1 = ros1
        self._written = 0
        fields, constants = _fields(message, ros1=ros1)
        self._dtype = np.dtype(
            {
                "names": list(fields),
                "formats": [form for form, _ in fields.values()],
                "offsets": [offset for _, offset in fields.values()],
            }
        )
        self._blank = np.zeros(1, self._dtype)
        for name, value in constants.items():
            self._blank[name] = value
        # As bare bytes: numpy need not copy what lies between fields.
        self._blank = self._blank.view(f"V{self._dtype.itemsize}")

    def encode(self, series: AttitudeSeries, target: Path | str) -> NDArray[np.void]:
        """Return the messages of a batch, shape ``(N,)``.

        Raises
        ------
        OutputError
            A stamp is beyond what ROS can hold; the error names the target.
        """
        seconds, nanoseconds = np.divmod(series.t_ns, NS_PER_S)
        outside = (seconds < 0) | (seconds > np.iinfo(np.int32).max)
        if outside.any():
            raise OutputError(
                target,
                f"ROS has no time for the stamp {series.t_ns[outside.argmax()]} ns; "
                "write a table, or a trajectory",
            )
        rows = np.repeat(self._blank, len(series)).view(self._dtype)
        rows["sec"], rows["nanosec"] = seconds, nanoseconds
        if self._ros1:
            rows["seq"] = np.arange(self._written, self._written + len(series), dtype=np.uint64)
        rows["xyzw"][:, :3], rows["xyzw"][:, 3] = series.wxyz[:, 1:], series.wxyz[:, 0]
        self._written += len(series)
        return rows


def _fields(message: Message, *, ros1: bool) -> tuple[dict[str, tuple[str, int]], dict[str, Any]]:
    """Return format and offset of each field of a message, and the values that never change.

    ROS 1 packs its fields. CDR begins with four bytes that tell the encoding, aligns each number
    to its size counted from after them, and ends strings with a zero that counts.
    """
    head, end = (0, b"") if ros1 else (4, b"\0")
    fields: dict[str, tuple[str, int]] = {} if ros1 else {"encapsulation": ("V4", 0)}
    constants: dict[str, Any] = {} if ros1 else {"encapsulation": np.void(_CDR_LITTLE_ENDIAN)}
    numbers = {"stamp": _ROS1_STAMP if ros1 else _STAMP, "count": (("count", "<u4"),)}
    numbers |= {"position": (("position", "3<f8"),), "xyzw": (("xyzw", "4<f8"),)}
    place = head

    def add(name: str, form: str) -> None:
        nonlocal place
        dtype = np.dtype(form)
        if not ros1:
            place += -(place - head) % dtype.base.alignment
        fields[name] = form, place
        place += dtype.itemsize

    for part in message.definition.parts:
        if part in numbers:
            for name, form in numbers[part]:
                add(name, form)
            continue
        text = getattr(message, part).encode() + end
        add(f"{part}_length", "<u4")
        constants[f"{part}_length"] = len(text)
        if text:
            add(part, f"V{len(text)}")
            constants[part] = np.void(text)
    if "count" in fields:
        constants["count"] = 1
    return fields, constants
