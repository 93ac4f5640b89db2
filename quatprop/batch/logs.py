"""Find the logs of a batch.

Paths are strings here: a batch may have a hundred thousand.
"""

from __future__ import annotations

import glob
import os.path
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import UnreadableLogError, UsageError, os_reason
from quatprop.stores.kinds import COMPRESSION_SUFFIXES, READERS
from quatprop.stores.objects import (
    below,
    exists,
    find,
    has_address,
    is_address,
    list_objects,
    split_address,
    without_secret,
)
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

MAGIC = tuple(magic for reader in READERS.values() for magic in reader.magic if len(magic) > 1)
"""First bytes of logs that are recognised by their content alone."""

SUFFIXES = {suffix: kind for kind, reader in READERS.items() for suffix in reader.suffixes}

METADATA = "metadata.yaml"
"""The file that makes a folder a ROS 2 bag."""

TABLES = {kind for kind, reader in READERS.items() if reader.load.startswith("quatprop.tables.")}
"""Kinds of files that hold many other things, too."""

REFUSED = "its key has an empty part, '.', '..' or parameters; no address can have these: rename it"


class FoundLog(NamedTuple):
    """A log of a batch.

    `name`: name of its output without the suffix: its path below the root, without its own suffixes
    `maybe`: whether it is a table that was found in a folder: one without body rates is no log
    `refused`: why it cannot be read, nor its output be written; empty where it can
    """

    path: str
    name: str
    maybe: bool = False
    refused: str = ""


@dataclass(slots=True)
class LogSearch:
    """Finds logs by the names of files and folders, by addresses, and by patterns.

    `root`: the names of outputs are paths below this folder. None: below the folder that is
        searched, the fixed part of a pattern, or the folder of a file
    `output`: the folder of the outputs, which is not searched
    `of_messages`: a setting, such as ``"topic"``, that only logs of messages can follow: tables in
        folders are no logs then. None: there is no such setting
    `logs`: the logs, each once, in the order of the names, and of their paths within a folder
    `other_files`: number of files in the searched folders that are no logs
    """

    root: str | None = None
    output: str = ""
    of_messages: str | None = None
    logs: list[FoundLog] = field(default_factory=list)
    other_files: int = 0
    _places: set[str] = field(default_factory=set)

    def add(self, name: str) -> None:
        """Add a log, the logs in a folder, or those that match a pattern."""
        if name == "-":
            raise UsageError("stdin is one log; give it to quatprop propagate")
        if glob.has_magic(name) and _is_pattern(name):
            self._add_matches(name)
        elif _is_plain_folder(name):
            self._add_folder(name, name)
        else:
            self._add_log(name, os.path.dirname(_absolute(name)), folder=_is_folder(name))

    def _add_matches(self, pattern: str) -> None:
        base, mark, parameters = _split(pattern)
        parts = base.replace(os.sep, "/").split("/")
        count = next(k for k, part in enumerate(parts) if glob.has_magic(part))
        root = f"{'/'.join(parts[:count]) or ('/' if count else '.')}{mark}{parameters}"
        if parts[-1] == "**":
            self._add_folder(root, root)
            return
        noted = len(self.logs)
        if is_address(pattern):
            names = _matching(root, parts[count:])
            matches = [below(root, name) for name in names if self._is_usable(root, name)]
        else:
            matches = sorted(glob.iglob(pattern, recursive=True))
        if not matches and len(self.logs) == noted:
            raise UsageError(f"nothing matches {quoted(pattern)}; check the pattern")
        for match in matches:
            if _is_plain_folder(match):
                self._add_folder(match, root)
            else:
                self._add_log(match, root, folder=_is_folder(match))

    def _add_folder(self, folder: str, root: str) -> None:
        output = self.output and _real(self.output)
        if _real(folder) == output:
            raise UsageError(
                f"outputs in {quoted(folder)} would lie among the logs; choose "
                f"{Setting('output', 'another folder')}"
            )
        search = self._search_store if is_address(folder) else self._search
        for path, kind in search(folder, output):
            if kind in TABLES and self.of_messages:
                self.other_files += 1
            else:
                self._add_log(path, root, folder=kind == "rosbag2", maybe=kind in TABLES)

    def _search_store(self, address: str, output: str) -> Iterator[tuple[str, str]]:
        """Yield address and kind of each log below an address."""
        names = [name for name in list_objects(address) if self._is_usable(address, name)]
        bags = {os.path.dirname(name) for name in names if os.path.basename(name) == METADATA}
        for name in names:
            bag = next((above for above in _folders_of(name) if above in bags), None)
            log = below(address, name if bag is None else bag)
            if _absolute(log).startswith(f"{output}/"):
                continue
            hidden = any(part.startswith(".") for part in name.split("/"))
            if kind := "rosbag2" if bag else "" if hidden else _kind_by_suffix(name):
                yield log, kind
            else:
                self.other_files += 1

    def _is_usable(self, address: str, name: str) -> bool:
        """Return whether a key can be part of an address; note a log if it cannot."""
        usable = has_address(address, name)
        if not usable and _kind_by_suffix(name):
            self.logs.append(FoundLog(below(address, name), name, refused=REFUSED))
        return usable

    def _search(self, top: str, output: str) -> Iterator[tuple[str, str]]:
        """Yield path and kind of each log in a folder."""

        def refuse(error: OSError) -> None:
            raise UnreadableLogError(error.filename, os_reason(error))

        for place, folders, files in os.walk(top, onerror=refuse):
            if METADATA in files:
                folders.clear()
                yield place, "rosbag2"
                continue
            folders[:] = sorted(
                folder
                for folder in folders
                if not folder.startswith(".") and _real(os.path.join(place, folder)) != output
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
        if self.of_messages and _kind_by_suffix(place) in TABLES:
            raise UsageError(
                f"{quoted(place)} is a table, and {Setting(self.of_messages)} is for logs of "
                "messages; propagate tables by themselves",
            )
        root = _absolute(self.root or root)
        if not place.startswith(os.path.join(root, "")):
            raise UsageError(
                f"{quoted(place)} does not lie in {quoted(root)}; choose another "
                f"{Setting('root')} (names are relative to the current folder)"
            )
        name = place[len(os.path.join(root, "")) :]
        self.logs.append(FoundLog(path, name if folder else _stem(name), maybe))


def _is_pattern(name: str) -> bool:
    """Return whether a name with ``*`` or ``[`` is a pattern: nothing has it for its own name."""
    if not is_address(name):
        return not os.path.exists(name)
    return glob.has_magic(_split(name)[0]) and not exists(name)


def _is_folder(path: str) -> bool:
    """Return whether a path is a folder, or an address a prefix."""
    if not is_address(path):
        return os.path.isdir(path)
    # Of what has the name of a log, the store is not asked: there may be many.
    return not _kind_by_suffix(_absolute(path)) and not find(path)[1].is_file


def _is_plain_folder(path: str) -> bool:
    """Return whether a path is a folder, but no ROS 2 bag."""
    if is_address(path):
        return _is_folder(path) and not exists(below(path, METADATA))
    return os.path.isdir(path) and not os.path.isfile(os.path.join(path, METADATA))


def _matching(address: str, patterns: Sequence[str]) -> list[str]:
    """Return what below an address matches a pattern: objects, and prefixes above them."""
    names = list_objects(address)
    places = {place for name in names for place in (*_folders_of(name), name)}
    return sorted(place for place in places if _fits(place.split("/"), patterns))


def _fits(parts: Sequence[str], patterns: Sequence[str]) -> bool:
    """Return whether the parts of a path match those of a pattern, as in :mod:`glob`."""
    if not patterns:
        return not parts
    if patterns[0] == "**" and _fits(parts, patterns[1:]):
        return True
    if not parts or (parts[0].startswith(".") and not patterns[0].startswith(".")):
        return False
    if patterns[0] == "**":
        return _fits(parts[1:], patterns)
    return fnmatchcase(parts[0], patterns[0]) and _fits(parts[1:], patterns[1:])


def _kind(path: str) -> str:
    """Return the kind of a log by its suffix, or ``"other"`` by its content; empty for no log."""
    if kind := _kind_by_suffix(path):
        return kind
    # Nobody may ever write to a pipe.
    at_once = getattr(os, "O_NONBLOCK", 0)
    try:
        with open(path, "rb", 0, opener=lambda name, how: os.open(name, how | at_once)) as stream:
            head = stream.read(max(map(len, MAGIC)))
            return "other" if head and head.startswith(MAGIC) else ""
    except OSError:
        return ""


def _kind_by_suffix(name: str) -> str:
    """Return the kind of a log by its suffix; empty where that is not one of a log."""
    stem, suffix = os.path.splitext(name.lower())
    if suffix in COMPRESSION_SUFFIXES:
        suffix = os.path.splitext(stem)[1]
    return SUFFIXES.get(suffix, "")


def _folders_of(name: str) -> Iterator[str]:
    """Yield the folders above a file, the uppermost first."""
    parts = name.split("/")
    yield from ("/".join(parts[:count]) for count in range(1, len(parts)))


def _stem(name: str) -> str:
    """Return the name of a file without its suffixes: also those of compression."""
    stem, suffix = os.path.splitext(name)
    packed = suffix.lower() in (*COMPRESSION_SUFFIXES, ".active")
    return os.path.splitext(stem)[0] if packed else stem


def _split(name: str) -> tuple[str, str, str]:
    """Return a path, or an address without its parameters; then their mark, and they."""
    base, query = split_address(name) if is_address(name) else (name, "")
    return base, "?" if query else "", query


def _absolute(path: str) -> str:
    """Return an absolute path, whose links are not followed, or an address without its secrets."""
    return (
        _split(without_secret(path))[0].rstrip("/") if is_address(path) else os.path.abspath(path)
    )


def _real(path: str) -> str:
    """Return an absolute path, whose links are followed, or an address as above."""
    return _absolute(path) if is_address(path) else os.path.realpath(path)
