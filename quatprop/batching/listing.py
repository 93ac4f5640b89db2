"""What lies below a folder or below a prefix of a store, and what of it matches a pattern."""

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
"""The file that makes a folder a ROS 2 bag, if it says so."""

BAG = b"rosbag2_bagfile_information"
"""What the metadata of a bag hold."""

MAGIC = tuple(magic for reader in READERS.values() for magic in reader.magic if len(magic) > 1)
"""First bytes of logs that are recognised by their content alone."""


class Entry(NamedTuple):
    """What is in a folder.

    `type`: ``"file"``, ``"folder"``, ``"link"`` to a folder, or ``"other"``: a pipe, a device
    `origin`: by what a store's listing tells that it is another one; empty in a folder
    """

    name: str
    type: str
    origin: str = ""


class Tree(Protocol):
    """A folder or a prefix; paths in it are relative to it, with ``/``.

    `refused`: keys that no address can have
    """

    refused: list[str]

    def entries(self, folder: str) -> list[Entry]:
        """Return what is in a folder, in order of the names; raises OSError."""

    def has_bag(self, folder: str) -> bool:
        """Return whether the ``metadata.yaml`` of a folder is that of a ROS 2 bag."""

    def is_log(self, file: str) -> bool:
        """Return whether a file, whose suffix does not tell, is a log by its content."""


class FolderTree:
    """A folder of this machine."""

    def __init__(self, top: str) -> None:
        self._top = top
        self.refused: list[str] = []

    def entries(self, folder: str) -> list[Entry]:
        """Return what is in a folder; of a link that leads nowhere, reading says so."""
        with os.scandir(os.path.join(self._top, folder) or os.curdir) as found:
            return sorted(Entry(entry.name, _type(entry)) for entry in found)

    def has_bag(self, folder: str) -> bool:
        """Read the metadata, if they are a file."""
        path = os.path.join(self._top, folder, METADATA)
        if not os.path.isfile(path):
            return False
        with open(path, "rb") as stream:
            return BAG in stream.read()

    def is_log(self, file: str) -> bool:
        """Read the first bytes."""
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
    except OSError:  # a link to what may not be looked at
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
        """Return what is below a prefix."""
        return sorted(self._folders[folder])

    def has_bag(self, folder: str) -> bool:
        """Fetch the metadata."""
        return BAG in get(below(self._address, f"{folder}/{METADATA}".removeprefix("/")))

    def is_log(self, file: str) -> bool:  # noqa: ARG002  # for the look, each would be fetched
        """Return False: in a store the suffix tells."""
        return False


def tree_of(place: str) -> Tree:
    """Return what lies below a folder or an address."""
    return StoreTree(place) if is_address(place) else FolderTree(place)


class Pattern:
    """A pattern of paths, as :mod:`pathlib` has them.

    ``*``, ``?`` and ``[...]`` stand for a part of a name or a whole one, and ``**`` for any number
    of folders; neither stands for what is hidden, and ``**`` does not follow links. A state is the
    parts that may come next.

    `parts`: those of the pattern; none matches the beginning itself
    """

    def __init__(self, parts: list[str]) -> None:
        self._parts = parts
        self._fits = [re.compile(fnmatch.translate(part)).match for part in parts]
        self.start = self._closed({0})

    def after(self, state: frozenset[int], name: str, *, link: bool = False) -> frozenset[int]:
        """Return the state after one more name of a path."""
        following = set()
        for place in state - {len(self._parts)}:
            part, is_hidden = self._parts[place], name.startswith(".")
            if part == "**":
                following |= {place} if not is_hidden and not link else set()
            elif self._fits[place](name) and (not is_hidden or part.startswith(".")):
                following.add(place + 1)
        return self._closed(following)

    def matches(self, state: frozenset[int], *, file: bool = False) -> bool:
        """Return whether the path is a match; that of a file is none of ``**`` at the end."""
        return len(self._parts) in state and not (file and self._parts[-1:] == ["**"])

    def reaches(self, path: str) -> bool:
        """Return whether a path is a match, or lies below one."""
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
