"""ROS 2 bags with attitudes added: folders of parts, and databases by themselves."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from quatprop.containers.mcap.log import McapLog
from quatprop.containers.rosbag2.parts import folder
from quatprop.errors import OutputError, UnsupportedLogError
from quatprop.into import sqlite
from quatprop.into.mcap import McapPart
from quatprop.into.rosbag2_metadata import extended
from quatprop.into.topics import refuse_taken
from quatprop.text import plain
from quatprop.writers.atomic import Replacement, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.messages.ros_messages import Encoder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import Any

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.into import Addition
    from quatprop.series import AttitudeSeries

    Int64 = NDArray[np.int64]

METADATA = "metadata.yaml"
_LATEST = int(np.iinfo(np.int64).max)


class _Part(Protocol):
    """A copy of one file of a bag."""

    def write(self, log_ns: Int64, messages: NDArray[np.void]) -> None:
        """Append messages, and when each was logged."""

    def finish(self, metadata: str | None = None) -> None:
        """Finish the file."""

    def close(self) -> None:
        """Let go of it."""


@dataclass(slots=True)
class Added:
    """What was added to a part: how many messages, and their first and last log time, ns."""

    count: int = 0
    first: int = _LATEST
    last: int = 0


class Rosbag2Into(AttitudeWriter):
    """Copy a ROS 2 bag and add attitudes to it, each to the part of its time.

    Parameters
    ----------
    log
        What is copied: a folder, or a database.
    target
        Where the copy goes; nothing is there.
    addition
        What is added.

    Raises
    ------
    UsageError
        The topic is there already, or the message is none of ROS.
    UnsupportedLogError
        The bag is packed.
    """

    def __init__(self, log: MessageLog, target: Path | str, addition: Addition) -> None:
        self._message = addition.message
        self._times = addition.times
        self._encoder = Encoder(self._message)
        self._target = target
        self._source = log.path
        taken = [channel.topic for channel in log.channels()]
        refuse_taken(self._message.place, taken, log.path)
        self._files = _files(log.path)
        self._added: list[Added] = []
        self._part: _Part | None = None
        self._open_log = ExitStack()
        is_folder = log.path.is_dir()
        with self._reported():
            starts = [_first_ns(file) for file in self._files[1:]]
        # What comes before the start of the next part belongs to this one.
        self._ends = [*starts, _LATEST]
        self._replacement = Replacement(target, folder=is_folder)
        try:
            with self._reported():
                if is_folder:
                    self._replacement.path.mkdir()
                    self._copy_others()
                self._open_next()
        except BaseException:
            self.abort()
            raise

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch, to one part or to several."""
        messages = self._encoder.encode(series, self._target)
        log_ns = self._times.of(series.t_ns)
        with self._reported():
            while len(log_ns):
                end = self._ends[len(self._added) - 1]
                count = int(np.searchsorted(log_ns, end)) if end != _LATEST else len(log_ns)
                self._put(log_ns[:count], messages[:count])
                log_ns, messages = log_ns[count:], messages[count:]
                if len(log_ns):
                    self._finish_part()
                    self._open_next()

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Copy the rest, finish the bag with its provenance, and put it in its place."""
        custom = {f"quatprop {self._message.place}": words_of(provenance)}
        with self._reported():
            while len(self._added) < len(self._files):
                self._finish_part()
                self._open_next()
            metadata = self._metadata(custom)
            if metadata is not None:
                place = self._replacement.path / METADATA
                place.write_text(metadata, encoding="utf-8")
            self._finish_part(metadata)
        self._replacement.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        if self._part is not None:
            self._part.close()
        self._open_log.close()
        self._replacement.discard()

    def _metadata(self, custom: Mapping[str, str]) -> str | None:
        """Return the new metadata.yaml, where the bag has one."""
        place = self._source / METADATA
        if not place.is_file():
            return None
        text = place.read_text(encoding="utf-8")
        try:
            return extended(text, self._message, self._added, custom)
        except (KeyError, TypeError, AttributeError, ValueError):
            # Damaged, and told; without it, the parts are found by their names.
            return None

    def _copy_others(self) -> None:
        """Copy what else is in the folder."""
        known = {file.name for file in self._files} | {METADATA}
        known |= {name + end for name in known for end in ("-wal", "-shm")}
        for file in sorted(self._source.iterdir()):
            if file.is_file() and file.name not in known:
                shutil.copyfile(file, self._replacement.path / file.name)

    def _open_next(self) -> None:
        source = self._files[len(self._added)]
        place = self._replacement.path
        place = place / source.name if self._source.is_dir() else place
        if source.suffix == ".mcap":
            log = self._open_log.enter_context(McapLog(source))
            self._part = McapPart(log, place, self._message)
        else:
            self._part = sqlite.SqlitePart(source, place, self._message)
        self._added.append(Added())

    def _finish_part(self, metadata: str | None = None) -> None:
        if self._part is not None:
            self._part.finish(metadata)
        self._open_log.close()

    def _put(self, log_ns: Int64, messages: NDArray[np.void]) -> None:
        if self._part is not None and len(log_ns):
            self._part.write(log_ns, messages)
            added = self._added[-1]
            added.count += len(log_ns)
            added.first = min(added.first, int(log_ns[0]))
            added.last = max(added.last, int(log_ns[-1]))

    @contextmanager
    def _reported(self) -> Iterator[None]:
        """Turn errors of the system and of SQLite into an error that names the target."""
        with reported(self._target):
            try:
                yield
            except sqlite3.Error as error:
                raise OutputError(
                    self._target,
                    f"{plain(self._source)} cannot be copied: {error}; write the attitudes to a "
                    "file of their own with -o",
                ) from error


def _files(path: Path) -> list[Path]:
    """Return the files of a bag in order."""
    if not path.is_dir():
        return [path]
    found = folder(path)
    packed = [file for file in found.parts if file.suffix not in {".mcap", ".db3"}]
    if packed or found.message_compression:
        raise UnsupportedLogError(
            path,
            "its files or messages are packed one by one, and nothing can be added to them; unpack "
            "it with `ros2 bag convert`, or write the attitudes to a file of their own with -o",
        )
    return found.parts


def _first_ns(file: Path) -> int:
    if file.suffix != ".mcap":
        return sqlite.first_ns(file)
    with McapLog(file) as log:
        return min((region.first_ns for region in log.contents.regions), default=0)
