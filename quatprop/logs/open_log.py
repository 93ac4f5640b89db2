"""Open a log of any kind: a file, a folder, an address in an object store, or stdin."""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, BinaryIO

from quatprop.containers.base import MessageLog
from quatprop.containers.msg_files import MsgFiles
from quatprop.errors import (
    DamagedLogError,
    LogError,
    QuatpropError,
    UnreadableLogError,
    UnsupportedLogError,
    UsageError,
    os_reason,
)
from quatprop.errors.third_party import as_errors_of
from quatprop.stores.compressed_files import DecompressedCopy, file_compression
from quatprop.stores.compression import UnreadableDataError
from quatprop.stores.file_source import FileSource
from quatprop.stores.kinds import READERS, TEXT_KINDS, head_of, kind_of
from quatprop.stores.objects import below, find, is_address, without_secret
from quatprop.stores.temp_files import temp_folder
from quatprop.text import Remark, Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.tables.log import Log

_MAGIC_BYTES = 16

_SHELL_PIPES = ("/dev/fd/", "/dev/stdin", "/proc/self/fd/")

_INDEXED_KINDS = {"mcap", "bag", "parquet", "feather"}
"""Kinds of which only a part is read from an object store: they say where everything is."""


@contextmanager
def open_log(
    path: str | Path,
    kind: str | None = None,
    *,
    msg_path: str | Path | None = None,
    copied: bool = False,
) -> Iterator[Log]:
    """Open a log of any kind for the length of a ``with`` block.

    A log inside a compressed file is decompressed into a temporary copy.

    `path`: a file, a ROS 2 bag folder, the address of one of them in an object store, or ``"-"``
        for stdin
    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None to recognise it by the content,
        then by the suffix
    `msg_path`: a ``.msg`` file, a package or a folder of packages with the definitions that a bag
        lacks; None for files that lie beside it
    """
    with as_errors_of(without_secret(path)), ExitStack() as stack:
        if msg_path is not None and not Path(msg_path).exists():
            sentence = f"{plain(msg_path)}: no such file or folder; check {Setting('msg_path')}"
            raise UsageError(sentence)
        if is_stream(path):
            yield _open_stream(str(path), kind, msg_path, stack)
        elif is_address(path):
            yield _open_remote(str(path), kind, msg_path, stack, copied=copied)
        else:
            place = Path(path)
            is_folder = place.is_dir()
            log = (_open_folder if is_folder else _open_file)(place, kind, stack)
            _complete(log, [place, place.parent] if is_folder else [place.parent], msg_path)
            yield log


def _open_folder(folder: Path, kind: str | None, stack: ExitStack, **options: Any) -> Log:
    """Open a ROS 2 bag; `stack` closes it."""
    if kind not in (None, "rosbag2"):
        raise _other_kind(folder, "folder", kind)
    if kind is None:
        _refuse_several_logs(folder)
    return _enter("rosbag2", folder, stack, **options)


def _open_remote(
    address: str,
    kind: str | None,
    msg_path: str | Path | None,
    stack: ExitStack,
    *,
    copied: bool,
) -> Log:
    """Open a log in an object store; `stack` closes it, and removes what was copied."""
    from quatprop.stores.remote import RemoteSource
    from quatprop.stores.transfers import bag_files, local_copy

    name = without_secret(address)
    _, found = find(address)
    if copied or (kind == "rosbag2" and found.is_file):
        copy = stack.enter_context(local_copy(address))
        stack.enter_context(_renamed_errors(copy, name))
        return stack.enter_context(open_log(copy, kind, msg_path=msg_path))
    if not found.is_file:
        files = bag_files(address)
        indexed = {name for name in files if Path(name).suffix in READERS["mcap"].suffixes}
        copy = stack.enter_context(local_copy(address, set(files) - indexed))
        stack.enter_context(_renamed_errors(copy, name))

        def source_of_part(part: Path) -> FileSource:
            if part.name in indexed:
                return RemoteSource(below(address, part.name), part)
            return FileSource(part)

        log = _open_folder(copy, kind, stack, source_of_part=source_of_part)
    else:
        file = Path(PurePosixPath(found.path).name)
        stack.enter_context(_renamed_errors(file, name))
        source = stack.enter_context(RemoteSource(address, file))
        head = head_of(source)
        told = kind or ("" if file_compression(head) else kind_of(file, head))
        if told not in _INDEXED_KINDS:
            source.close()
            return _open_remote(address, kind, msg_path, stack, copied=True)
        log = _open_source(source, told, stack)
    _complete(log, [], msg_path)
    return log


def _complete(log: Log, folders: list[Path], msg_path: str | Path | None) -> None:
    """Look for definitions that channels lack; remark on their origin and on types of a topic."""
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
    """Refuse a folder with other logs than the parts of a bag: none of them is left out."""
    # A text beside the parts of a bag is a note, as a rule, and a file .truth. is no log.
    suffixes = {suffix for reader in READERS.values() for suffix in reader.suffixes} - {".txt"}
    logs: list[Path] = []
    if not (folder / "metadata.yaml").exists():
        with suppress(OSError):  # the reader of bags has the sentence for it
            logs = sorted(
                file
                for file in folder.iterdir()
                if (file.suffix.lower() in suffixes and ".truth." not in file.name)
                or (file / "metadata.yaml").exists()
            )
    parts = {suffix for kind in ("mcap", "db3") for suffix in READERS[kind].suffixes}
    if len(logs) > 1 and any(file.suffix.lower() not in parts for file in logs):
        names = listed(file.name for file in logs)
        raise UnsupportedLogError(
            folder, f"the folder holds several logs: {names}; name one, or use quatprop batch"
        )


def _other_kind(path: str | Path, what: str, kind: str) -> UnreadableLogError:
    return UnreadableLogError(
        path,
        f"a {what} is no log of kind {kind}; leave {Setting('kind')} out, or name the log itself",
    )


def is_stream(path: str | Path) -> bool:
    """Whether a log is read once, as it comes: stdin, or a pipe of the shell as ``<(...)``."""
    name = str(path)
    # Only these have a writer for certain: to open a pipe with a name could take forever.
    return name == "-" or (name.startswith(_SHELL_PIPES) and Path(path).is_fifo())


def _open_stream(name: str, kind: str | None, msg_path: str | Path | None, stack: ExitStack) -> Log:
    """Open text as it comes; a binary log, which is read at places, from a temporary copy."""
    stream: Any = sys.stdin.buffer
    if name != "-":
        stream = stack.enter_context(Path(name).open("rb"))  # noqa: SIM115  # the stack closes it
    if kind == "rosbag2":
        raise UnsupportedLogError(name, "a ROS 2 bag is a folder; name it")
    head = stream.peek(_MAGIC_BYTES) if hasattr(stream, "peek") else b""
    named = (name for name, reader in READERS.items() if head.startswith(reader.magic))
    kind = kind or next(named, "csv")
    if kind in TEXT_KINDS:
        stack.enter_context(_renamed_errors("-", name))
        return _enter(kind, stream, stack)
    folder = temp_folder()
    stack.callback(folder.remove)
    copy = folder.path / "stdin"
    stack.enter_context(_renamed_errors(copy, name))
    with copy.open("wb") as file:
        import shutil

        shutil.copyfileobj(stream, file)
    return stack.enter_context(open_log(copy, kind, msg_path=msg_path))


def _open_file(path: Path, kind: str | None, stack: ExitStack) -> Log:
    """Open a file, or the log inside a compressed file; `stack` closes what was opened."""
    if kind == "rosbag2":
        raise _other_kind(path, "file", kind)
    source = stack.enter_context(FileSource(path))
    head = head_of(source)
    inside = path.with_suffix("") if path.suffix else path
    is_compressed = file_compression(head) != ""
    if is_compressed and kind is None:
        text_kinds = (k for k in TEXT_KINDS if inside.suffix.lower() in READERS[k].suffixes)
        kind = next(text_kinds, None)
    # A text table decompresses itself as it is read, and its name may tell what it holds.
    if kind in TEXT_KINDS or not is_compressed:
        return _open_source(source, kind or kind_of(path, head), stack)
    source.close()
    try:
        copy = stack.enter_context(closing(DecompressedCopy(path)))
    except UnreadableDataError as error:
        raise DamagedLogError(path, f"{error.reason}; decompress it by hand to see more") from error
    stack.enter_context(_renamed_errors(copy.path, path))
    source = stack.enter_context(FileSource(copy.path))
    log = _open_source(source, kind or kind_of(inside, head_of(source)), stack)
    if copy.damage:
        log.losses.note("end of the file", copy.damage)
    return log


def _open_source(source: FileSource, kind: str, stack: ExitStack) -> Log:
    if READERS[kind].reads_source:
        return _enter(kind, source, stack)
    source.close()
    return _enter(kind, source.path, stack)


def _enter(
    kind: str, source: Path | FileSource | BinaryIO, stack: ExitStack, **options: Any
) -> Log:
    """Import the reader of a kind of log and open a log with it; `stack` closes it."""
    module, _, name = READERS[kind].load.partition(":")
    try:
        log: Log = getattr(import_module(module), name)(source, **options)
    except OSError as error:
        path = source if isinstance(source, Path) else getattr(source, "path", "-")
        raise UnreadableLogError(path, os_reason(error)) from error
    stack.enter_context(log)
    return log


@contextmanager
def _renamed_errors(copy: Path | str, path: Path | str) -> Iterator[None]:
    """Let errors about a temporary copy name the file that the user knows.

    Errors about other files, such as the one of the first attitude, keep their names.
    """
    try:
        yield
    except QuatpropError as error:
        if isinstance(error, LogError) and Path(error.path).is_relative_to(copy):
            error.path = path
        name = rf"(?<![^\s'(]){re.escape(plain(copy))}(?![\w.-])"
        error.reason = re.sub(name, lambda _: plain(path), error.reason)
        raise
