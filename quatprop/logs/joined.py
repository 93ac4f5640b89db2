"""Several files of one recording as one log."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.logs.open_log import is_stream, open_log
from quatprop.tables.log import Log, Losses
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.tables.model import Table


class JoinedLog(Log):
    """The tables of several logs; rows of a topic are merged by time."""

    def __init__(self, logs: Sequence[Log]) -> None:
        self._logs = logs
        self.path, self.kind = logs[0].path, logs[0].kind

    @property
    def losses(self) -> Losses:  # type: ignore[override]  # what was noted so far
        """The losses of all logs, with their files."""
        every = Losses()
        for log in self._logs:
            for loss in log.losses:
                every.note(f"{plain(log.path)}, {loss.place}", loss.reason, loss.messages)
        return every

    @property
    def remarks(self) -> Sequence[str]:  # type: ignore[override]
        """The remarks on all logs."""
        return [f"{plain(log.path)}: {remark}" for log in self._logs for remark in log.remarks]

    @property
    def definition_files(self) -> Sequence[Path]:  # type: ignore[override]
        """The definition files of all logs."""
        return [*dict.fromkeys(file for log in self._logs for file in log.definition_files)]

    @property
    def unchecked_chunks(self) -> int:  # type: ignore[override]
        """The number of unchecked chunks of all logs."""
        return sum(log.unchecked_chunks for log in self._logs)

    def confirm(self) -> None:
        """Refuse logs that were replaced in their store."""
        for log in self._logs:
            log.confirm()

    def tables(self, topic: str | None = None) -> Sequence[Table]:
        """Return the tables of all logs."""
        return [table for log in self._logs for table in log.tables(topic)]


@contextmanager
def open_logs(
    paths: Sequence[str],
    kind: str | None = None,
    *,
    msg_path: str | Path | None = None,
    copied: bool = False,
) -> Iterator[Log]:
    """Open one log, or several as one; see :func:`quatprop.logs.open_log.open_log`."""
    if len(paths) > 1:
        if copied or any(map(is_stream, paths)):
            raise UsageError("several files are read as one log, not copied or from stdin")
        if len({*paths}) < len(paths):
            raise UsageError(f"a file is named twice among {', '.join(map(plain, paths))}")
    with ExitStack() as stack:
        logs = [
            stack.enter_context(open_log(path, kind, msg_path=msg_path, copied=copied))
            for path in paths
        ]
        yield logs[0] if len(logs) == 1 else JoinedLog(logs)
