"""Base class of logs: tables and losses."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, NamedTuple, Self

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence
    from pathlib import Path

    from quatprop.stores.stored import StoredLog
    from quatprop.tables.model import Table
    from quatprop.text import Remark


class Loss(NamedTuple):
    """A part of a damaged log that could not be read.

    `place`: where it is, such as "chunk at byte 4096" or "line 17"
    `reason`: why it could not be read
    `messages`: number of lost messages or rows; None: unknown
    """

    place: str
    reason: str
    messages: int | None = None


class Losses(list[Loss]):
    """Losses, each noted once even if the log is read several times."""

    def __init__(self) -> None:
        super().__init__()
        self._entries: dict[tuple[str, str], tuple[int, dict[Hashable, int]]] = {}

    def note(
        self, place: str, reason: str, messages: int | None = None, part: Hashable = None
    ) -> None:
        """Add a loss; with the same place and reason, messages of different parts add up."""
        number, counts = self._entries.setdefault((place, reason), (len(self), {}))
        if messages is not None:
            counts[part] = max(messages, counts.get(part, 0))
        loss = Loss(place, reason, sum(counts.values()) if counts else None)
        self[number : number + 1] = [loss]

    def restart(self, count: int) -> None:
        """Remove all but the first losses, before the log is read again."""
        earlier = self[:count]
        self.clear()
        self._entries.clear()
        for loss in earlier:
            self.note(loss.place, loss.reason, loss.messages)


class Log(ABC):
    """A log of any kind, open for reading; closed when its ``with`` block ends.

    `kind`: the key in :data:`quatprop.stores.kinds.READERS`
    `losses`: parts that could not be read so far
    `remarks`: possible problems found so far
    `definition_files`: files beside the log with message definitions
    `unchecked_chunks`: number of chunks read in part, so without verifying their checksum
    `stored`: identity in an object store; None for a local file
    """

    kind: str
    stored: StoredLog | None = None
    remarks: Sequence[Remark] = ()
    definition_files: Sequence[Path] = ()
    unchecked_chunks: int = 0

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses = Losses()

    @abstractmethod
    def tables(self, topic: str | None = None) -> Sequence[Table]:
        """Return the topics with messages, or a file as the only table, without a name.

        `topic`: name of the topics to return; None: all
        """

    def confirm(self) -> None:
        """Raise an error if the log was replaced in its store since it was opened."""
        if self.stored is not None:
            self.stored.confirm()

    def close(self) -> None:  # noqa: B027  # nothing to do where files are open only while read
        """Release files and temporary copies."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
