"""What every log has: tables, and what of it could not be read."""

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

    `place`: where it is, so that a user can look: "chunk at byte 4096", "line 17"
    `reason`: why it could not be read
    `messages`: how many messages or rows are lost, where that is known
    """

    place: str
    reason: str
    messages: int | None = None


class Losses(list[Loss]):
    """Losses, each of which is noted once, however often the log is read."""

    def __init__(self) -> None:
        super().__init__()
        self._entries: dict[tuple[str, str], tuple[int, dict[Hashable, int]]] = {}

    def note(
        self, place: str, reason: str, messages: int | None = None, part: Hashable = None
    ) -> None:
        """Add a loss unless it was noted before."""
        number, counts = self._entries.setdefault((place, reason), (len(self), {}))
        if messages is not None:
            counts[part] = max(messages, counts.get(part, 0))
        loss = Loss(place, reason, sum(counts.values()) if counts else None)
        self[number : number + 1] = [loss]

    def restart(self, count: int) -> None:
        """Forget all but the first `count`, since what comes after them is read again."""
        earlier = self[:count]
        self.clear()
        self._entries.clear()
        for loss in earlier:
            self.note(loss.place, loss.reason, loss.messages)


class Log(ABC):
    """A log of any kind, open for reading; closed when its ``with`` block ends.

    `kind`: the key in :data:`quatprop.stores.kinds.READERS`
    `losses`: what could not be read; grows while the log is read
    `remarks`: what may be wrong with the log, though not for certain; grows while the log is read
    `definition_files`: files beside the log that message definitions were taken from
    `unchecked_chunks`: chunks that were read in part and so not compared with their checksum; grows
        likewise
    `stored`: by what an object store recognises it; None for a file of this machine
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
        """Return the topics that have messages, or the file as the only table of no name.

        `topic`: only those of this name; None for all
        """

    def confirm(self) -> None:
        """Refuse a log that was replaced in its store since it was opened."""
        if self.stored is not None:
            self.stored.confirm()

    def close(self) -> None:  # noqa: B027  # nothing to do where files are open only while read
        """Release files and temporary copies."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
