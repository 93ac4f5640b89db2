"""Types that are known by name, found at the top of a message or inside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from quatprop.errors import SchemaError
from quatprop.messages.decoders import DECODERS
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import ros_name, structs

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from quatprop.containers.base import Channel
    from quatprop.messages.schema import Struct

Row = TypeVar("Row")


@dataclass(frozen=True, slots=True)
class KnownTypes(Generic[Row]):
    """What is known of message types.

    Parameters
    ----------
    rows
        By the name of the type.
    """

    rows: Mapping[str, Row]

    def row_of(self, type_name: str) -> Row | None:
        """Return what is known of a type, however ROS spells it; None where nothing is."""
        return self.rows.get(type_name) or self.rows.get(ros_name(type_name))

    def root(self, channel: Channel, path: Path | str) -> Struct | None:
        """Return the definition of a channel's messages where a known type may be in it.

        Raises
        ------
        SchemaError
            The definition of a known type cannot be read.
        """
        is_known = self.row_of(channel.type_name) is not None
        # The text of the definition tells cheaply that no known type is inside.
        if channel.encoding not in DECODERS or not (is_known or self._is_named_in(channel.schema)):
            return None
        try:
            return message_type(channel, path)
        except SchemaError:
            if is_known:
                raise
            return None

    def _is_named_in(self, schema: bytes) -> bool:
        return any(name.rpartition("/")[2].encode() in schema for name in self.rows)

    def inside(
        self, root: Struct, fits: Callable[[Row, Struct, str], bool]
    ) -> Iterator[tuple[str, Row]]:
        """Yield where known types are in a message, and their rows, outermost first.

        What is inside a known type is its own affair.

        Parameters
        ----------
        root
            The definition of the message.
        fits
            Tells of a row, a struct of that type and its prefix whether this version of the type
            has the fields of its row.
        """
        passed: list[str] = []
        for prefix, kind in structs(root):
            row = self.row_of(kind.name)
            if row is None or any(prefix.startswith(outer) for outer in passed):
                continue
            if fits(row, kind, prefix):
                passed.append(prefix)
                yield prefix, row
