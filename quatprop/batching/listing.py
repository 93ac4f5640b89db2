"""List files below a folder or a store prefix, and match them with patterns."""

from __future__ import annotations

import fnmatch
import os
import re
from collections import defaultdict
from typing import NamedTuple, Protocol

from quatprop.batching.origins import origin_of_object
from quatprop.stores.kinds import READERS
from quatprop.stores.objects import below, has_address, is_address, list_objects
from quatprop.stores.transfers import get

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
