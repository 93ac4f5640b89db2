"""Find the logs of a batch.

Paths are strings, since a batch may have a million.
"""

from __future__ import annotations

import fnmatch
import glob
import hashlib
import os
import re
from collections import defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Protocol

from quatprop.base.errors import UsageError, os_reason
from quatprop.base.places import is_address, without_secret
from quatprop.base.text import Setting, listed, quoted
from quatprop.stores.kinds import COMPRESSION_SUFFIXES, READERS
from quatprop.stores.objects import (
    below,
    exists,
    find,
    has_address,
    list_objects,
    split_address,
    split_topic,
)
from quatprop.stores.remote import get
from quatprop.tools.batch.tasks import (
    BatchTask,
    absolute,
    origin_of_object,
    origin_of_parts,
    place_below,
    real,
)
from quatprop.writers.formats import WRITERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


# List files below a folder or a store prefix, and match them with patterns.


METADATA = "metadata.yaml"
"""Metadata file of a ROS 2 bag."""

BAG = b"rosbag2_bagfile_information"
"""Key in the metadata of a bag."""

MAGIC = tuple(magic for reader in READERS.values() for magic in reader.magic if len(magic) > 1)
"""First bytes that identify logs without their suffix."""


class Entry(NamedTuple):
    """An entry of a folder.

    `type`: ``"file"``, ``"folder"``, ``"link"`` to a folder, or ``"other"``: a pipe, a device
    `origin`: size and time in the listing of a store; empty in a local folder
    """

    name: str
    type: str
    origin: str = ""


class Tree(Protocol):
    """A folder or a store prefix; paths are relative to it, with ``/``.

    `refused`: keys that have no valid address
    """

    refused: list[str]

    def entries(self, folder: str) -> list[Entry]:
        """Return the entries of a folder, sorted by name; may raise OSError."""

    def has_bag(self, folder: str) -> bool:
        """Return whether a folder is a ROS 2 bag, by its ``metadata.yaml``."""

    def is_log(self, file: str) -> bool:
        """Return whether a file with another suffix is a log, by its content."""


class FolderTree:
    """A local folder."""

    def __init__(self, top: str) -> None:
        self._top = top
        self.refused: list[str] = []

    def entries(self, folder: str) -> list[Entry]:
        """Return the entries of a folder; broken links are files, which fail when read."""
        with os.scandir(os.path.join(self._top, folder) or os.curdir) as found:
            return sorted(Entry(entry.name, _type(entry)) for entry in found)

    def has_bag(self, folder: str) -> bool:
        """Return whether a folder is a ROS 2 bag."""
        path = os.path.join(self._top, folder, METADATA)
        if not os.path.isfile(path):
            return False
        with open(path, "rb") as stream:
            return BAG in stream.read()

    def is_log(self, file: str) -> bool:
        """Return whether a file is a log, by its first bytes."""
        try:
            with open(os.path.join(self._top, file), "rb", 0) as stream:
                head = stream.read(max(map(len, MAGIC)))
        except OSError:
            return False
        return bool(head) and head.startswith(MAGIC)


def _type(entry: os.DirEntry[str]) -> str:
    try:
        if entry.is_dir():
            return "link" if entry.is_symlink() else "folder"
        return "other" if not entry.is_file() and os.path.exists(entry.path) else "file"
    except OSError:  # a link without permission
        return "file"


class StoreTree:
    """A prefix of a store, listed once."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._folders: defaultdict[str, list[Entry]] = defaultdict(list)
        self.refused: list[str] = []
        folders, is_near = {""}, address.startswith("file://")
        for name, info in list_objects(address).items():
            if not has_address(address, name):
                self.refused.append(name)
                continue
            folder, _, file = name.rpartition("/")
            self._folders[folder].append(
                Entry(file, "file", "" if is_near else origin_of_object(info))
            )
            while folder not in folders:
                folders.add(folder)
                above, _, own = folder.rpartition("/")
                self._folders[above].append(Entry(own, "folder"))
                folder = above

    def entries(self, folder: str) -> list[Entry]:
        """Return the entries of a prefix."""
        return sorted(self._folders[folder])

    def has_bag(self, folder: str) -> bool:
        """Return whether a prefix is a ROS 2 bag."""
        return BAG in get(below(self._address, f"{folder}/{METADATA}".removeprefix("/")))

    def is_log(self, file: str) -> bool:  # noqa: ARG002  # each file would be fetched
        """Return False: in a store, only suffixes identify logs."""
        return False


def tree_of(place: str) -> Tree:
    """Return the tree below a folder or an address."""
    return StoreTree(place) if is_address(place) else FolderTree(place)


class Pattern:
    """A path pattern, as in :mod:`pathlib`, matched name by name.

    ``*``, ``?`` and ``[...]`` match within a name, and ``**`` any number of folders, without links;
    hidden names do not match. A state is the set of parts that may come next.

    `parts`: parts of the pattern; without parts, it matches the top folder itself
    """

    def __init__(self, parts: list[str]) -> None:
        self._parts = parts
        self._fits = [re.compile(fnmatch.translate(part)).match for part in parts]
        self.start = self._closed({0})

    def after(self, state: frozenset[int], name: str, *, link: bool = False) -> frozenset[int]:
        """Return the state after the next name of a path."""
        following = set()
        for place in state - {len(self._parts)}:
            part, is_hidden = self._parts[place], name.startswith(".")
            if part == "**":
                following |= {place} if not is_hidden and not link else set()
            elif self._fits[place](name) and (not is_hidden or part.startswith(".")):
                following.add(place + 1)
        return self._closed(following)

    def matches(self, state: frozenset[int], *, file: bool = False) -> bool:
        """Return whether the path matches; ``**`` at the end does not match files."""
        return len(self._parts) in state and not (file and self._parts[-1:] == ["**"])

    def reaches(self, path: str) -> bool:
        """Return whether a path matches, or is below a match."""
        state = self.start
        for name in path.split("/"):
            if self.matches(state):
                break
            state = self.after(state, name)
        return self.matches(state)

    def _closed(self, state: set[int]) -> frozenset[int]:
        while more := {p + 1 for p in state if self._parts[p : p + 1] == ["**"]} - state:
            state |= more
        return frozenset(state)


SUFFIXES = {suffix: kind for kind, reader in READERS.items() for suffix in reader.suffixes}

TABLES = {
    kind for kind, reader in READERS.items() if reader.load.startswith("quatprop.readers.tables.")
}
"""Kinds of files that often are not logs."""

OF_MESSAGES = ("topic", "rate_field", "time_field")
"""Settings that do not apply to tables."""

REFUSED = "its key has an empty part, '.', '..' or parameters; no address can have these: rename it"


@dataclass(slots=True)
class LogSearch:
    """Finds logs by the names of files and folders, by addresses, and by patterns.

    `root`: folder to which names of outputs are relative; None: the searched folder, the fixed part
        of a pattern, or the folder of a file
    `output`: folder of the outputs, which is not searched
    `of_messages`: a setting, such as ``"topic"``, for logs of messages only, with which tables in
        folders are ignored; None: no such setting
    `suffix`: suffix of the outputs
    `logs`: distinct logs, in the order of the names, and sorted by path within a folder
    `searched`: folders that were searched completely
    `other_files`, `links`: number of other files in the searched folders, and of links to folders,
        which are not followed
    """

    root: str | None = None
    output: str = ""
    of_messages: str | None = None
    suffix: str = ""
    logs: list[BatchTask] = field(default_factory=list)
    searched: set[str] = field(default_factory=set)
    other_files: int = 0
    links: int = 0
    _places: set[int] | None = None

    def add(self, name: str) -> None:
        """Add a log or ``LOG:TOPIC``, the logs in a folder, or those that match a pattern."""
        if name == "-":
            raise UsageError("stdin is one log; give it to quatprop propagate")
        if self.logs and self._places is None:
            self._places = {_mark(log) for log in self.logs}
        if glob.has_magic(name) and _is_pattern(name):
            self._add_matches(name)
        elif _is_folder(name) and not _is_bag(name):
            self._add_below(name, Pattern([]))
        else:
            name, topic = split_topic(name)
            base, query = split_address(name) if is_address(name) else (name, "")
            folder, file = os.path.split(base.rstrip("/") or base)
            if file in {"", os.curdir, os.pardir}:
                folder, file = os.path.split(absolute(name))
            root = f"{folder}{'?' if query else ''}{query}"
            odd = is_address(name) and "//" in base.partition("://")[2].rstrip("/")
            refused = REFUSED if odd else ""
            self._add_log(BatchTask(root, file, refused=refused, topic=topic or ""), is_named=True)

    def take(self) -> list[BatchTask]:
        """Return the logs, and keep nothing of them: there may be a million."""
        logs, self.logs, self._places = self.logs, [], None
        return logs

    def _add_matches(self, pattern: str) -> None:
        base, query = split_address(pattern) if is_address(pattern) else (pattern, "")
        parts = base.replace(os.sep, "/").split("/")
        count = next(k for k, part in enumerate(parts) if glob.has_magic(part))
        root = "/".join(parts[:count])
        if root == os.path.splitdrive(root)[0]:
            root = f"{root}/" if count else os.curdir
        found = len(self.logs)
        self._add_below(f"{root}{'?' if query else ''}{query}", Pattern(parts[count:]))
        if len(self.logs) == found and not self.other_files:
            raise UsageError(f"nothing matches {quoted(pattern)}; check the pattern")

    def _add_below(self, root: str, pattern: Pattern) -> None:
        """Add logs that match a pattern below a folder, and the logs in matching folders."""
        if self.output and real(root) == real(self.output) and pattern.matches(pattern.start):
            raise UsageError(
                f"outputs in {quoted(root)} would lie among the logs; choose "
                f"{Setting('output', 'another folder')}"
            )
        if pattern.matches(pattern.start):
            self.searched.add(self.root or root)
        tree = tree_of(root)
        waiting = [("", pattern.start)]
        while waiting:
            folder, state = waiting.pop()
            try:
                inside = self._folders_of(tree, root, folder, pattern, state)
                waiting += reversed([(name, after) for name, after in inside if after])
            except OSError as error:
                self._add_log(BatchTask(root, folder, refused=os_reason(error)))
        for name in tree.refused:
            if kind_by_suffix(name) and pattern.reaches(name):
                self._add_log(BatchTask(root, name, refused=REFUSED))

    def _folders_of(
        self, tree: Tree, root: str, folder: str, pattern: Pattern, state: frozenset[int]
    ) -> Iterator[tuple[str, frozenset[int]]]:
        """Add the logs in a folder, and yield its subfolders with the states of the pattern."""
        entries = tree.entries(folder)
        whole, prefix = pattern.matches(state), f"{folder}/" if folder else ""
        is_bag = whole and any(one.name == METADATA for one in entries) and tree.has_bag(folder)
        if is_bag:
            files = [(one.name, one.origin) for one in entries if one.type == "file"]
            origin = origin_of_parts(files) if all(origin for _, origin in files) else ""
            self._add_log(BatchTask(root, folder, origin=origin))
        for name, kind, origin in entries:
            path = prefix + name
            # Below a match, everything except hidden names is searched.
            after = pattern.after(state, name, link=kind == "link")
            if whole and not pattern.matches(after) and kind != "link" and name[:1] != ".":
                after = state
            if kind in {"folder", "link"}:
                if whole and not after and kind == "link":
                    self.links += 1
                elif after and not self._is_output(root, path):
                    yield path, after
            elif not whole and pattern.matches(after, file=True):
                self._add_log(BatchTask(root, path, origin=origin), is_named=True)
            elif whole and not is_bag:
                self._add_file(tree, root, path, kind, origin)

    def _add_file(self, tree: Tree, root: str, path: str, kind: str, origin: str) -> None:
        """Add a file of a searched folder, if it is a log."""
        is_no_log = kind == "other" or os.path.basename(path).startswith(".")
        log = kind_by_suffix(path)
        if is_no_log or not (log or tree.is_log(path)) or (log in TABLES and self.of_messages):
            self.other_files += 1
        else:
            standing = "table" if log in TABLES else "log"
            self._add_log(BatchTask(root, path, standing=standing, origin=origin))

    def _is_output(self, root: str, folder: str) -> bool:
        return bool(self.output) and real(place_below(root, folder)) == real(self.output)

    def _add_log(self, task: BatchTask, *, is_named: bool = False) -> None:
        """Add a log, unless it was found before; `is_named`: by its name or a pattern."""
        if is_named and self.of_messages and kind_by_suffix(task.log) in TABLES:
            raise UsageError(
                f"{quoted(task.path)} is a table, and {Setting(self.of_messages)} is for logs of "
                "messages; propagate tables by themselves",
            )
        root, log = task.root, task.log
        if not log or self.root is not None:
            root, log = self._below_root(absolute(task.path), root)
        task = task._replace(root=root, log=log, suffix=self.suffix)
        if self._places is not None:
            place = _mark(task)
            if place in self._places:
                return
            self._places.add(place)
        self.logs.append(task)

    def _below_root(self, place: str, given: str) -> tuple[str, str]:
        """Return the root, and the path of a log below it."""
        root = os.path.dirname(place) if self.root is None else self.root
        above = os.path.join(absolute(root), "")
        if not place.startswith(above):
            raise UsageError(
                f"{quoted(place)} does not lie in {quoted(absolute(root))}; choose another "
                f"{Setting('root')} (names are relative to the current folder)"
            )
        if is_address(given):  # it has the credentials and the parameters
            scheme, _, rest = absolute(root).partition("://")
            host = given.partition("://")[2].partition("/")[0].partition("?")[0]
            query = split_address(given)[1]
            path = rest.partition("/")[2]
            root = f"{scheme}://{host}/{path}{'?' if query else ''}{query}"
        return root, place[len(above) :].replace(os.sep, "/")


def search_logs(  # noqa: PLR0913  # options of the command
    names: Sequence[str],
    root: str | None,
    output: str,
    to: str,
    options: Mapping[str, object],
    *,
    otherwise: str = "",
) -> LogSearch:
    """Return the search for the logs that names stand for; there is at least one.

    `to`: format of the outputs
    `options`: settings, some of which do not apply to tables
    `otherwise`: another way to name logs
    """
    of_messages = None if options.get("kind") else next(filter(options.get, OF_MESSAGES), None)
    suffix = next(filter(None, WRITERS[to].suffixes), "")
    search = LogSearch(root, output, of_messages, suffix)
    for name in names:
        search.add(name)
    if not search.logs:
        where = f" in {listed(map(without_secret, names))}" if names else ""
        raise UsageError(f"there are no logs{where}; name files, folders or patterns{otherwise}")
    return search


def _mark(log: BatchTask) -> int:
    """Return a number that no other log has: a million of them take half the memory of paths."""
    name = os.fsencode(f"{absolute(log.path)}:{log.topic}")
    return int.from_bytes(hashlib.blake2b(name, digest_size=16).digest(), "little")


def _is_pattern(name: str) -> bool:
    """Return whether a name with ``*`` or ``[`` is a pattern, not an existing name."""
    if not is_address(name):
        return not os.path.exists(name)
    return glob.has_magic(split_address(name)[0].partition("://")[2]) and not exists(name)


def _is_folder(path: str) -> bool:
    """Return whether a path is a folder, or an address is a prefix."""
    if not is_address(path):
        return os.path.isdir(path)
    # For names of logs, of which there may be many, no request is sent to the store.
    return not kind_by_suffix(absolute(path)) and not find(path)[1].is_file


def _is_bag(folder: str) -> bool:
    """Return whether a folder is a ROS 2 bag."""
    if not is_address(folder):
        return tree_of(folder).has_bag("")
    return exists(below(folder, METADATA)) and tree_of(folder).has_bag("")


def kind_by_suffix(name: str) -> str:
    """Return the kind of a log by its suffix; empty for other suffixes."""
    stem, suffix = os.path.splitext(name.lower())
    if suffix in COMPRESSION_SUFFIXES:
        suffix = os.path.splitext(stem)[1]
    return SUFFIXES.get(suffix, "")
