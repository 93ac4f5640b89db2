"""Open a log of any kind: a file, a folder, an address in an object store, or stdin."""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import (
    DamagedLogError,
    Loss,
    Losses,
    UnreadableLogError,
    UnsupportedLogError,
    UsageError,
    as_errors_of,
)
from quatprop.base.places import is_address, without_secret
from quatprop.base.text import Remark, Setting, listed, plain, quoted
from quatprop.readers.opening import (
    complete,
    enter,
    open_folder,
    open_source,
    other_kind,
    renamed_errors,
)
from quatprop.readers.tables.model import Log
from quatprop.readers.tables.turns import ALL
from quatprop.stores.compression import DecompressedCopy, UnreadableDataError, file_compression
from quatprop.stores.file_source import FileSource
from quatprop.stores.kinds import READERS, TEXT_KINDS, kind_of, read_magic
from quatprop.stores.temp_files import temp_folder

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.readers.tables.model import Table


_MAGIC_BYTES = 16

_SHELL_PIPES = ("/dev/fd/", "/dev/stdin", "/proc/self/fd/")


@contextmanager
def open_log(
    path: str | Path,
    kind: str | None = None,
    *,
    msg_path: str | Path | None = None,
) -> Iterator[Log]:
    """Open a log of any kind, as a context manager.

    A log inside a compressed file is decompressed into a temporary copy.

    `path`: a file, a ROS 2 bag folder, an address in an object store, or ``"-"`` for stdin
    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content, then
        suffix
    `msg_path`: a ``.msg`` file, a package or a folder of packages with definitions that a bag
        lacks; None: searched for next to the bag
    """
    with as_errors_of(without_secret(path)), ExitStack() as stack:
        if msg_path is not None and not Path(msg_path).exists():
            sentence = f"{plain(msg_path)}: no such file or folder; check {Setting('msg_path')}"
            raise UsageError(sentence)
        if is_stream(path):
            yield _open_stream(str(path), kind, msg_path, stack)
        elif is_address(path):
            from quatprop.readers.remote_log import open_remote, unchanged
            from quatprop.stores.objects import StoredLog

            stored = StoredLog(str(path))
            stack.enter_context(unchanged(stored))
            opened = open_remote(stored, kind, stack)
            if isinstance(opened, Path):
                log = stack.enter_context(open_log(opened, kind, msg_path=msg_path))
            else:
                log = opened
                complete(log, [], msg_path)
            log.stored = stored
            yield log
        else:
            place = Path(path)
            is_folder = place.is_dir()
            log = (open_folder if is_folder else _open_file)(place, kind, stack)
            complete(log, [place, place.parent] if is_folder else [place.parent], msg_path)
            yield log


def is_stream(path: str | Path) -> bool:
    """Return whether a log can be read only once: stdin, or a shell pipe such as ``<(...)``."""
    name = str(path)
    # These certainly have a writer; opening a named pipe could block forever.
    return name == "-" or (name.startswith(_SHELL_PIPES) and Path(path).is_fifo())


def _open_stream(name: str, kind: str | None, msg_path: str | Path | None, stack: ExitStack) -> Log:
    """Open text as a stream; a binary log, which needs seeking, from a temporary copy."""
    stream: Any = getattr(sys.stdin, "buffer", None)
    if name == "-" and stream is None:
        raise UnreadableLogError(name, "standard input is closed; name a file")
    if name != "-":
        stream = stack.enter_context(Path(name).open("rb"))  # noqa: SIM115  # the stack closes it
    if kind == "rosbag2":
        raise UnsupportedLogError(name, "a ROS 2 bag is a folder; name it")
    head = stream.peek(_MAGIC_BYTES) if hasattr(stream, "peek") else b""
    named = (name for name, reader in READERS.items() if head.startswith(reader.magic))
    kind = kind or next(named, "csv")
    if kind in TEXT_KINDS:
        stack.enter_context(renamed_errors("-", name))
        return enter(kind, stream, stack)
    folder = temp_folder()
    stack.callback(folder.remove)
    copy = folder.path / "stdin"
    stack.enter_context(renamed_errors(copy, name))
    with copy.open("wb") as file:
        import shutil

        shutil.copyfileobj(stream, file)
    return stack.enter_context(open_log(copy, kind, msg_path=msg_path))


def _open_file(path: Path, kind: str | None, stack: ExitStack) -> Log:
    """Open a file, or the log inside a compressed file; `stack` closes it."""
    if kind == "rosbag2":
        raise other_kind(path, "file", kind)
    source = stack.enter_context(FileSource(path))
    head = read_magic(source)
    inside = path.with_suffix("") if path.suffix else path
    is_compressed = file_compression(head) != ""
    if is_compressed and kind is None:
        text_kinds = (k for k in TEXT_KINDS if inside.suffix.lower() in READERS[k].suffixes)
        kind = next(text_kinds, None)
    # Readers of text decompress by themselves, and may need the name of the file.
    if kind in TEXT_KINDS or not is_compressed:
        return open_source(source, kind or kind_of(path, head), stack)
    source.close()
    try:
        copy = stack.enter_context(closing(DecompressedCopy(path)))
    except UnreadableDataError as error:
        raise DamagedLogError(path, f"{error.reason}; decompress it by hand to see more") from error
    stack.enter_context(renamed_errors(copy.path, path))
    source = stack.enter_context(FileSource(copy.path))
    log = open_source(source, kind or kind_of(inside, read_magic(source)), stack)
    if copy.damage:
        log.losses.note("end of the file", copy.damage)
    return log


# Several files of one recording as one log.


class JoinedLog(Log):
    """The tables of several logs; rows of a topic are merged by time."""

    def __init__(self, logs: Sequence[Log]) -> None:
        self._logs = self.joined = logs
        self.path, self.kind = logs[0].path, logs[0].kind
        for log in logs:
            log.joined = logs

    @property
    def losses(self) -> Losses:  # type: ignore[override]  # what was noted so far
        """The losses of all logs, with their files."""
        every = Losses()
        for log in self._logs:
            for loss in log.losses:
                every.note(*_in_file(log.path, loss))
        return every

    @property
    def remarks(self) -> Sequence[Remark]:  # type: ignore[override]
        """The remarks on all logs."""
        own = [remark for log in self._logs for remark in _on_file(log.path, log)]
        topics = dict.fromkeys(topic for log in self._logs for topic, _ in log.series_read)
        return [*own, *filter(None, map(self._on_frames, topics))]

    def _on_frames(self, topic: str) -> Remark | None:
        """Return the remark on a topic whose frame changes from one file to another."""
        of_files = {
            log.path: read.frames
            for log in self._logs
            for (name, wanted), read in log.series_read.items()
            if name == topic and read.frames and ALL not in wanted
        }
        every = [*dict.fromkeys(name for names in of_files.values() for name in names)]
        # A change within a file is said of that file.
        if any(len(names) == len(every) for names in of_files.values()) or not every:
            return None
        by_file = (
            f"{listed(names)} in {plain(without_secret(path))}" for path, names in of_files.items()
        )
        text = (
            f"the frame of topic {quoted(topic)} is {', '.join(by_file)}: if their axes differ, "
            f"the rates are mixed; read the messages of one with {Setting('series', every[0])}"
        )
        return Remark("several-frames", text)

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


def _in_file(path: Path | str, loss: Loss) -> Loss:
    """Return a loss with the name of its file."""
    return loss._replace(place=f"{plain(without_secret(path))}, {loss.place}")


def _on_file(path: Path | str, log: Log) -> list[Remark]:
    """Return the remarks on a log with the name of its file."""
    name = plain(without_secret(path))
    return [Remark(one.code, f"{name}: {one}") for one in log.remarks]


@contextmanager
def open_logs(
    paths: Sequence[str],
    kind: str | None = None,
    *,
    msg_path: str | Path | None = None,
) -> Iterator[Log]:
    """Open one log, or several as one; see :func:`quatprop.readers.open_log.open_log`."""
    if len(paths) > 1:
        if any(map(is_stream, paths)):
            raise UsageError("several files are read as one log, not from stdin")
        if len({*paths}) < len(paths):
            raise UsageError(f"a file is named twice among {', '.join(map(plain, paths))}")
    with ExitStack() as stack:
        logs = [stack.enter_context(open_log(path, kind, msg_path=msg_path)) for path in paths]
        yield logs[0] if len(logs) == 1 else JoinedLog(logs)
