"""Copy ROS 2 bags, folders or single databases, and add attitudes."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import apsw
import numpy as np

from quatprop.containers.mcap.log import McapLog
from quatprop.containers.rosbag2.parts import METADATA, folder
from quatprop.errors import OutputError, UnsupportedLogError
from quatprop.log_copy import sqlite
from quatprop.log_copy.mcap import McapPart
from quatprop.log_copy.rosbag2_metadata import Added, extended, extended_record
from quatprop.text import Setting, plain
from quatprop.writers.atomic import OutputPath
from quatprop.writers.base import MessageWriter, provenance_json
from quatprop.writers.messages import attitude_encoder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from quatprop.arrays import Int64, Records
    from quatprop.containers.base import MessageLog
    from quatprop.writers.messages.kinds import Message


_LATEST = int(np.iinfo(np.int64).max)


class Rosbag2CopyWriter(MessageWriter):
    """Copy a ROS 2 bag and add each attitude to the part of its time."""

    _output: OutputPath

    def __init__(self, log: MessageLog, target: Path | str, message: Message) -> None:
        self._message = message
        self.encoder = attitude_encoder(message, ("cdr",))
        self._source = log.path
        self._files = _files(log.path)
        self._parts: list[McapPart | sqlite.SqlitePart] = []
        self._part_log = ExitStack()
        is_folder = log.path.is_dir()
        super().__init__(OutputPath(target, folder=is_folder))
        with self._opening():
            # Messages before the start of the next part that has any belong to this one.
            ends = [_LATEST]
            for file in reversed(self._files[1:]):
                ends.append(_first_ns(file) or ends[-1])
            self._ends = ends[::-1]
            if is_folder:
                self._output.path.mkdir()
                self._copy_other_files()
            self._open_next()

    def _write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages to one or several parts."""
        while len(log_ns):
            end = self._ends[len(self._parts) - 1]
            count = int(np.searchsorted(log_ns, end)) if end != _LATEST else len(log_ns)
            if count:
                self._parts[-1].write(log_ns[:count], messages[:count])
            log_ns, messages = log_ns[count:], messages[count:]
            if len(log_ns):
                self._finish_part({})
                self._open_next()

    def _finish(self, provenance: Mapping[str, object]) -> None:
        """Copy the rest of the log and finish the bag with its provenance."""
        custom = {f"quatprop {self.encoder.topic.name}": provenance_json(provenance)}
        while len(self._parts) < len(self._files):
            self._finish_part({})
            self._open_next()
        self._write_metadata(custom)
        self._finish_part(custom)

    def abort(self) -> None:
        """Discard uncommitted output."""
        for part in self._parts[-1:]:
            part.close()
        self._part_log.close()
        super().abort()

    def _write_metadata(self, custom: Mapping[str, str]) -> None:
        """Write metadata.yaml if the bag has one.

        If it is damaged, which the reader reports, it is omitted: parts are found by file name.
        """
        place = self._source / METADATA
        if place.is_file():
            text = place.read_text(encoding="utf-8")
            if copied := extended(text, self.encoder.topic, self._added(), custom):
                (self._output.path / METADATA).write_text(copied, encoding="utf-8")

    def _added(self) -> list[Added]:
        return [part.added for part in self._parts]

    def _copy_other_files(self) -> None:
        """Copy the files of the folder that are not part of the bag."""
        names = {file.name for file in self._files} | {METADATA}
        names |= {name + end for name in names for end in ("-wal", "-shm")}
        for file in sorted(self._source.iterdir()):
            if file.is_file() and file.name not in names:
                shutil.copyfile(file, self._output.path / file.name)

    def _open_next(self) -> None:
        source = self._files[len(self._parts)]
        place = self._output.path
        place = place / source.name if self._source.is_dir() else place
        if source.suffix == ".mcap":
            with ExitStack() as opened:
                log = opened.enter_context(McapLog(source))
                self._parts.append(McapPart(log, place, self._message))
                self._part_log = opened.pop_all()
        else:
            self._parts.append(sqlite.SqlitePart(source, place, self.encoder.topic))

    def _finish_part(self, custom: Mapping[str, str]) -> None:
        topic, added = self.encoder.topic, self._added()
        self._parts[-1].finish(lambda text: extended_record(text, topic, added, custom))
        self._part_log.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        """Turn errors of the operating system and of SQLite into an OutputError."""
        with super()._errors():
            try:
                yield
            except (sqlite3.Error, apsw.Error) as error:
                raise OutputError(
                    self._output.target,
                    f"{plain(self._source)} cannot be copied: {error}; write the attitudes to a "
                    f"file of their own with {Setting('output')}",
                ) from error


def _files(path: Path) -> list[Path]:
    """Return the files of a bag in their order."""
    if not path.is_dir():
        return [path]
    bag = folder(path)
    compressed = [file for file in bag.parts if file.suffix not in {".mcap", ".db3"}]
    if compressed or bag.message_compression:
        raise UnsupportedLogError(
            path,
            "its files or messages are compressed one by one, and nothing can be added to them; "
            "decompress it with `ros2 bag convert`, or write the attitudes to a file of their own "
            f"with {Setting('output')}",
        )
    return bag.parts


def _first_ns(file: Path) -> int:
    if file.suffix != ".mcap":
        return sqlite.first_ns(file)
    with McapLog(file) as log:
        return min((chunk.first_ns for chunk in log.index.chunks), default=0)
