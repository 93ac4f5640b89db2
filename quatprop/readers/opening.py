"""Shared steps of opening local and remote logs."""

from __future__ import annotations

import re
from collections import defaultdict
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from quatprop.base.errors import (
    LogError,
    QuatpropError,
    UnreadableLogError,
    UnsupportedLogError,
    os_reason,
)
from quatprop.base.text import Remark, Setting, listed, plain, quoted
from quatprop.readers.containers.message_log import MessageLog, MsgFiles
from quatprop.stores.kinds import READERS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.readers.tables.model import Log
    from quatprop.stores.file_source import FileSource


def open_folder(folder: Path, kind: str | None, stack: ExitStack, **options: Any) -> Log:
    """Open a ROS 2 bag; `stack` closes it."""
    if kind not in (None, "rosbag2"):
        raise other_kind(folder, "folder", kind)
    if kind is None:
        _refuse_several_logs(folder)
    return enter("rosbag2", folder, stack, **options)


def complete(log: Log, folders: list[Path], msg_path: str | Path | None) -> None:
    """Find missing message definitions; remark on their origin, and on topics of several types."""
    if not isinstance(log, MessageLog):
        return
    given = msg_path is not None
    files = MsgFiles([Path(msg_path)] if msg_path is not None else folders, is_given=given)
    log.complete(files.completed)
    log.definition_files = list(files.used.values())
    types: defaultdict[str, set[str]] = defaultdict(set)
    for channel in log.channels():
        types[channel.topic].add(channel.type_name)
    several = (
        Remark(
            "several-types",
            f"topic {quoted(topic)} was recorded with several types, which are read separately: "
            f"{listed(sorted(names))}",
        )
        for topic, names in types.items()
        if len(names) > 1
    )
    remarks = (
        Remark("definition-file", f"{quoted(name)} is defined by {plain(file)}")
        for name, file in files.used.items()
    )
    log.remarks = [*log.remarks, *remarks, *several]


def _refuse_several_logs(folder: Path) -> None:
    """Refuse a folder with several logs that are not parts of one bag."""
    # A text file next to a bag is usually a note, and a .truth. file is a reference, not a log.
    suffixes = {suffix for reader in READERS.values() for suffix in reader.suffixes} - {".txt"}
    logs: list[Path] = []
    if not (folder / "metadata.yaml").exists():
        with suppress(OSError):  # reported by the bag reader
            logs = sorted(
                file
                for file in folder.iterdir()
                if (file.suffix.lower() in suffixes and ".truth." not in file.name)
                or (file / "metadata.yaml").exists()
            )
    parts = {suffix for kind in ("mcap", "db3") for suffix in READERS[kind].suffixes}
    if len(logs) > 1 and any(file.suffix.lower() not in parts for file in logs):
        names, kinds = listed(file.name for file in logs), {file.suffix for file in logs}
        # Files of one suffix may be parts of one recording.
        parts_of_one = f"all of one recording as {plain(folder)}/*{plain(kinds.pop())}, "
        raise UnsupportedLogError(
            folder,
            f"the folder holds several logs: {names}; name one, "
            f"{'' if kinds else parts_of_one}or use quatprop batch",
        )


def other_kind(path: str | Path, what: str, kind: str) -> UnreadableLogError:
    """Return the error for a log that is not of the given kind."""
    return UnreadableLogError(
        path,
        f"a {what} is not a log of kind {kind}; omit {Setting('kind')}, or name the log itself",
    )


def open_source(source: FileSource, kind: str, stack: ExitStack) -> Log:
    """Open a log from an open file; `stack` closes it."""
    if READERS[kind].reads_source:
        return enter(kind, source, stack)
    source.close()
    return enter(kind, source.path, stack)


def enter(kind: str, source: Path | FileSource | BinaryIO, stack: ExitStack, **options: Any) -> Log:
    """Import the reader of a kind, and open a log with it; `stack` closes it."""
    module, _, name = READERS[kind].load.partition(":")
    try:
        log: Log = getattr(import_module(module), name)(source, **options)
    except OSError as error:
        path = source if isinstance(source, Path) else getattr(source, "path", "-")
        raise UnreadableLogError(path, os_reason(error)) from error
    stack.enter_context(log)
    return log


@contextmanager
def renamed_errors(copy: Path | str, path: Path | str) -> Iterator[None]:
    """Replace the name of a temporary copy in errors by the file that the user named.

    Errors about other files keep their names.
    """
    try:
        yield
    except QuatpropError as error:
        if isinstance(error, LogError) and Path(error.path).is_relative_to(copy):
            error.path = path
        name = rf"(?<![^\s'(]){re.escape(plain(copy))}(?![\w.-])"
        error.reason = re.sub(name, lambda _: plain(path), error.reason)
        raise
