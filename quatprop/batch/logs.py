"""Find the logs of a batch, and name the output of each.

Paths are strings here: a batch may have a hundred thousand.
"""

from __future__ import annotations

import glob
import os.path
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.containers.stores import below, find, is_address, list_objects, locate, without_secret
from quatprop.errors import UnreadableLogError, UsageError
from quatprop.log_kinds import READERS
from quatprop.text import Setting, Text, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

COMPRESSION_SUFFIXES = {".gz", ".zst", ".zstd", ".lz4", ".bz2"}

MAGIC = tuple(magic for reader in READERS.values() for magic in reader.magic if len(magic) > 1)
"""First bytes of logs that are recognised by their content alone."""

MAGIC_BYTES = max(map(len, MAGIC))

SUFFIXES = {suffix: kind for kind, reader in READERS.items() for suffix in reader.suffixes}

TABLES = {"parquet", "feather", "npy", "npz", "hdf5", "jsonl", "tum", "kitti", "csv"}
"""Kinds of files that hold many other things, too."""

OTHER_OUTPUT = Text(
    "keep their folders in the names with ", Setting("root", "DIR"), ", a folder above both, or "
    "write to another folder"
)  # fmt: skip
"""The way out where two logs have the same output."""


@dataclass(frozen=True, slots=True)
class FoundLog:
    """A log of a batch.

    Parameters
    ----------
    path
        Path or address, as it was given or found.
    name
        Name of its output without the suffix: its path below the root, without its own suffixes.
    maybe
        Whether it is a table that was found in a folder: one without body rates is no log.
    """

    path: str
    name: str
    maybe: bool = False


@dataclass(slots=True)
class LogSearch:
    """Finds logs by the names of files and folders, by addresses, and by patterns.

    Parameters
    ----------
    root
        The names of outputs are paths below this folder. None: below the folder that is searched,
        the fixed part of a pattern, or the folder of a file.
    output
        The folder of the outputs, which is not searched.

    Attributes
    ----------
    logs
        The logs, each once, in the order of the names, and of their paths within a folder.
    other_files
        Number of files in the searched folders that are no logs.
    """

    root: str | None = None
    output: str = ""
    logs: list[FoundLog] = field(default_factory=list)
    other_files: int = 0
    _places: set[str] = field(default_factory=set)

    def add(self, name: str) -> None:
        """Add a log, the logs in a folder, or those that match a pattern.

        Raises
        ------
        UsageError
            Nothing matches a pattern, a log is not below the root, or the outputs would lie among
            the logs.
        UnreadableLogError, StoreError
            A folder cannot be listed.
        """
        if name == "-":
            raise UsageError("stdin is one log; give it to quatprop propagate")
        if is_address(name):
            self._add_address(name)
        elif glob.has_magic(name) and not os.path.exists(name):
            self._add_matches(name)
        elif _is_plain_folder(name):
            self._add_folder(name, name)
        else:
            self._add_log(name, os.path.dirname(os.path.abspath(name)), folder=os.path.isdir(name))

    def _add_address(self, address: str) -> None:
        place = _absolute(address)
        # Of what has the name of a log, the store is not asked: there may be many.
        if _kind_by_suffix(place) or find(address)[1].is_file:
            self._add_log(address, place.rpartition("/")[0])
            return
        if place.rstrip("/") == _absolute(self.output).rstrip("/"):
            raise UsageError(f"outputs in {quoted(place)} would lie among the logs; choose ",
                             Setting("output", "another folder"))  # fmt: skip
        top = len(locate(address)[1]) + 1
        names = [str(info.path)[top:] for info in list_objects(address)]
        bags = {os.path.dirname(name) for name in names if _is_metadata(name)}
        if "" in bags:
            self._add_log(address, place.rstrip("/").rpartition("/")[0], folder=True)
            return
        for name in names:
            bag = next((above for above in _folders_of(name) if above in bags), None)
            log = below(address, name if bag is None else bag)
            if _absolute(log).startswith(os.path.join(_absolute(self.output), "")):
                continue
            kind = "" if _is_hidden(name) else _kind_by_suffix(name)
            if bag is not None or kind:
                is_table = bag is None and kind in TABLES
                self._add_log(log, place, folder=bag is not None, maybe=is_table)
            else:
                self.other_files += 1

    def _add_matches(self, pattern: str) -> None:
        parts = Path(pattern).parts
        fixed = next(k for k, part in enumerate(parts) if glob.has_magic(part))
        root = str(Path(*parts[:fixed]))
        if parts[-1] == "**":
            self._add_folder(root, root)
            return
        matches = sorted(glob.iglob(pattern, recursive=True))
        if not matches:
            raise UsageError(f"nothing matches {quoted(pattern)}; check the pattern")
        for match in matches:
            if _is_plain_folder(match):
                self._add_folder(match, root)
            else:
                self._add_log(match, root, folder=os.path.isdir(match))

    def _add_folder(self, folder: str, root: str) -> None:
        output = self.output and os.path.realpath(self.output)
        if os.path.realpath(folder) == output:
            raise UsageError(f"outputs in {quoted(folder)} would lie among the logs; choose ",
                             Setting("output", "another folder"))  # fmt: skip
        for path, kind in self._search(folder, output):
            self._add_log(path, root, folder=kind == "rosbag2", maybe=kind in TABLES)

    def _search(self, top: str, output: str) -> Iterator[tuple[str, str]]:
        """Yield path and kind of each log in a folder."""

        def refuse(error: OSError) -> None:
            raise UnreadableLogError(error.filename, f"it cannot be listed: {error.strerror}")

        for place, folders, files in os.walk(top, onerror=refuse):
            if "metadata.yaml" in files:
                folders.clear()
                yield place, "rosbag2"
                continue
            folders[:] = sorted(
                folder
                for folder in folders
                if not folder.startswith(".")
                and os.path.realpath(os.path.join(place, folder)) != output
            )
            for file in sorted(files):
                path = os.path.join(place, file)
                if kind := "" if file.startswith(".") else _kind(path):
                    yield path, kind
                else:
                    self.other_files += 1

    def _add_log(self, path: str, root: str, *, folder: bool = False, maybe: bool = False) -> None:
        place = _absolute(path)
        if place in self._places:
            return
        self._places.add(place)
        root = _absolute(self.root or root)
        if not place.startswith(os.path.join(root, "")):
            reason = f"{quoted(place)} does not lie in {quoted(root)}; choose another "
            raise UsageError(reason, Setting("root"))
        name = place[len(os.path.join(root, "")) :]
        self.logs.append(FoundLog(path, name if folder else _stem(name), maybe))


def output_paths(logs: Iterable[FoundLog], folder: str, suffix: str) -> list[str]:
    """Return the path of the output of each log.

    Parameters
    ----------
    logs
        The logs.
    folder
        The folder of all outputs.
    suffix
        Suffix of every output, with its dot; empty for folders.

    Raises
    ------
    UsageError
        Two logs would have the same output, also on file systems that ignore case.
    """
    paths: list[str] = []
    owners: dict[str, FoundLog] = {}
    for log in logs:
        name = log.name + suffix
        paths.append(below(folder, name) if is_address(folder) else os.path.join(folder, name))
        owner = owners.setdefault(log.name.lower(), log)
        if owner is not log:
            one, other, both = (
                quoted(without_secret(path)) for path in (owner.path, log.path, paths[-1])
            )
            raise UsageError(f"{one} and {other} would both be written to {both}; ", OTHER_OUTPUT)
    return paths


def shard(logs: Iterable[FoundLog], text: str) -> list[FoundLog]:
    """Return one part of N of the logs: that of one machine of many, as in an array job.

    Parameters
    ----------
    logs
        All logs, the same on every machine.
    text
        ``"I/N"``, the I-th part, from 1 to N.

    Raises
    ------
    UsageError
        It is not I/N.
    """
    match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
    part, parts = map(int, match.groups()) if match else (0, 0)
    if not 1 <= part <= parts:
        raise UsageError(f"{quoted(text)} is not I/N, from 1/N to N/N, for ", Setting("shard"))
    return sorted(logs, key=lambda log: log.name)[part - 1 :: parts]


def _is_plain_folder(path: str) -> bool:
    """Return whether a path is a folder, but no ROS 2 bag."""
    return os.path.isdir(path) and not os.path.isfile(os.path.join(path, "metadata.yaml"))


def _kind(path: str) -> str:
    """Return the kind of a log by its suffix, or ``"other"`` by its content; empty for no log."""
    if kind := _kind_by_suffix(path):
        return kind
    try:
        with open(path, "rb") as stream:
            return "other" if stream.read(MAGIC_BYTES).startswith(MAGIC) else ""
    except OSError:
        return ""


def _kind_by_suffix(name: str) -> str:
    """Return the kind of a log by its suffix; empty where that is not one of a log."""
    stem, suffix = os.path.splitext(name.lower())
    if suffix in COMPRESSION_SUFFIXES:
        suffix = os.path.splitext(stem)[1]
    return SUFFIXES.get(suffix, "")


def _is_metadata(name: str) -> bool:
    return os.path.basename(name) == "metadata.yaml"


def _is_hidden(name: str) -> bool:
    return any(part.startswith(".") for part in name.split("/"))


def _folders_of(name: str) -> Iterator[str]:
    """Yield the folders above a file, the uppermost first."""
    parts = name.split("/")
    yield from ("/".join(parts[:count]) for count in range(1, len(parts)))


def _stem(name: str) -> str:
    """Return the name of a file without its suffixes: also those of compression."""
    stem, suffix = os.path.splitext(name)
    packed = suffix.lower() in {*COMPRESSION_SUFFIXES, ".active"}
    return os.path.splitext(stem)[0] if packed else stem


def _absolute(path: str) -> str:
    """Return an absolute path, whose links are not followed, or an address without its secrets."""
    return without_secret(path).partition("?")[0] if is_address(path) else os.path.abspath(path)
