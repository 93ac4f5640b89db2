"""Ids that an MCAP file defines anew inside a chunk, which the format forbids.

Messages are read by the definitions of the summary, or of the beginnings of chunks; those inside
chunks are compared with them, so that no message goes to a topic that it is not of.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.containers.compression import UnreadableDataError
from quatprop.containers.mcap.definitions import IDS
from quatprop.containers.mcap.regions import MESSAGE, Region
from quatprop.containers.mcap.summary import McapIndex
from quatprop.containers.mcap.walk import walk_records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.containers.compression import Buffer


class DefinitionCheck:
    """Compares definitions inside chunks with those by which the messages are read.

    Parameters
    ----------
    index
        The definitions by which its messages are read.
    """

    def __init__(self, index: McapIndex) -> None:
        self.index = index
        self._found: dict[tuple[int, int, bytes], tuple[list[int], str, str]] = {}

    def check_leading(self, data: Buffer, region: Region, ids: Sequence[int]) -> int:
        """Compare the definitions before the first message of a region; return where they end.

        Raises
        ------
        UnreadableDataError
            A channel that is read, or its schema, is redefined there.
        """
        if not len(data) or data[0] == MESSAGE:
            return 0
        walked = walk_records(data, stop_at={MESSAGE})
        self.check(data, walked.definitions, region, ids)
        return walked.end

    def check(
        self,
        data: Buffer,
        definitions: Sequence[tuple[int, int, int]],
        region: Region,
        ids: Sequence[int],
    ) -> None:
        """Compare the definitions of a region: opcode, and begin and end of each in `data`."""
        for opcode, begin, end in definitions:
            record = region.first_id, opcode, bytes(data[begin:end])
            if record not in self._found:
                self._found[record] = self._redefined(*record)
            channels, what, change = self._found[record]
            if not set(ids).isdisjoint(region.own(channels)):
                raise UnreadableDataError(
                    f"it redefines {what} ({change}), so it is not certain whose messages these are"
                )

    def _redefined(self, first_id: int, opcode: int, content: bytes) -> tuple[list[int], str, str]:
        """Return which channels a record redefines, its id, and how it differs."""
        index, here = self.index, McapIndex()
        here.define(opcode, content, "", first_id)
        for kind, earlier, later in (
            ("channel", index.channels, here.channels),
            ("schema", index.schemas, here.schemas),
        ):
            for id_ in earlier.keys() & later.keys():
                before, now = earlier[id_].identity, later[id_].identity
                if before != now:
                    by_schema = [c.id for c in index.channels.values() if c.schema_id == id_]
                    channels = [id_] if kind == "channel" else by_schema
                    change = f"is now {now[0]}" if before[0] != now[0] else "has changed"
                    return channels, f"{kind} {id_ % IDS}", f"{before[0]} {change}"
        return [], "", ""
