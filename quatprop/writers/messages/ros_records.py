"""ROS messages encoded by the block: columns in, an array of encoded messages out.

The strings are the same in every message, so every message has its fields in the same places: a
block is an array of records. rosbags would encode one message at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.arrays import Int64, Records


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
        parts = list(_parts(fields, ros1=ros1))
        # CDR begins with four bytes that state the encoding. After them it aligns each number to
        # its size, as C does; ROS 1 packs its fields.
        begin = b"" if ros1 else _CDR_LITTLE_ENDIAN
        body = np.dtype([(name, form) for name, form, _ in parts], align=not ros1)
        names = [name for name, *_ in parts]
        places = [body.fields[name] for name in names] if body.fields else []
        self._dtype: np.dtype[np.void] = np.dtype(
            {
                "names": names,
                "formats": [kind for kind, *_ in places],
                "offsets": [len(begin) + offset for _, offset, *_ in places],
            }
        )
        template = np.zeros(1, self._dtype)
        template.view("u1")[: len(begin)] = list(begin)
        strings = {name: value for name, _, value in parts if value is not None}
        for name, value in {**strings, **constants}.items():
            template[name] = value
        # As bare bytes: NumPy need not copy the padding between fields.
        self._template = template.view(f"V{self._dtype.itemsize}")

    def stamped(self, t_ns: Int64, target: Path | str) -> Records:
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


def _parts(
    fields: Mapping[str, str | bytes], *, ros1: bool
) -> Iterator[tuple[str, str, object | None]]:
    """Yield name, format and constant value of numbers, parts of stamps, and parts of strings."""
    for name, form in fields.items():
        if form == HEADER_TIME:
            for part in ("seq", "sec", "nanosec") if ros1 else ("sec", "nanosec"):
                yield part, "<u4", None
        elif isinstance(form, str):
            yield name, form, None
        else:
            # In CDR strings end with a zero that counts.
            content = form if ros1 else form + b"\0"
            yield f"{name}_length", "<u4", len(content)
            if content:
                yield name, f"V{len(content)}", np.void(content)
