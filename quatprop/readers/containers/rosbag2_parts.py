"""The parts of a ROS 2 bag folder, from its metadata.yaml or by file name."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from rosbags.typesys.msg import normalize_msgtype

from quatprop.base.errors import Losses, UnsupportedLogError
from quatprop.base.guarded_text import ContentError, read_bytes, read_yaml
from quatprop.base.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.provenance import JsonObject
    from quatprop.readers.containers.message_log import MessageLog
    from quatprop.readers.messages.blocks import Channel
    from quatprop.stores.compression import DecompressedCopy

METADATA = "metadata.yaml"

_PART = re.compile(
    r"(?P<bag>.+?)(_(?P<number>\d+))?(?P<storage>\.mcap|\.db3)(\.zstd|\.lz4|\.gz|\.bz2)?"
)
"""File names of parts: the bag's name, a number if it was split, storage, compression."""

_SCALAR = re.compile(r"^ {2,4}(compression_(?:mode|format)): *(\S*) *$", re.MULTILINE)
_PATH_LIST = re.compile(
    r"^ {2,4}relative_file_paths: *\n(?P<items>(?: *- [^\n{}&*]+\n)+)(?= {0,4}\w|\Z)", re.MULTILINE
)

_LARGE_METADATA = 1 << 18
"""Characters of metadata.yaml from which only the needed fields are read."""

MAX_METADATA = 1 << 22
"""Maximum bytes of metadata.yaml; that of thousands of parts is smaller."""


MAX_COUNT = (1 << 63) - 1
"""Maximum message count in metadata: rosbag2 uses 64 bits."""


@dataclass(slots=True)
class Folder:
    """The content of a bag folder.

    `parts`: the files to read, in order of the metadata or of their numbers
    `counts`: number of messages by topic and type, from the metadata
    `losses`: parts that are missing or not read
    `custom`: custom data in the metadata, by name
    """

    parts: list[Path] = field(default_factory=list)
    message_compression: str | None = None
    counts: dict[tuple[str, str], int] = field(default_factory=dict)
    losses: Losses = field(default_factory=Losses)
    custom: dict[str, str] = field(default_factory=dict)


def folder(path: Path) -> Folder:
    """Find the parts of a bag folder."""
    # A pipe or device with the name of a part could be read forever.
    files = {
        file.name: file for file in path.iterdir() if _PART.fullmatch(file.name) and file.is_file()
    }
    losses = Losses()
    metadata = _metadata(path / METADATA, losses)
    found = Folder(losses=losses)
    if metadata is None:
        found.parts = _numbered(path, files, losses)
    else:
        _compare(metadata, files, found)
        if files and not found.parts:
            found = replace(found, losses=Losses())
            reason = "the parts that it names are not in the folder; they are found by their names"
            found.losses.note(METADATA, reason)
            found.parts = _numbered(path, files, found.losses)
    return found


def _metadata(path: Path, losses: Losses) -> JsonObject | None:
    """Return the content of metadata.yaml; None if it is missing or unusable."""
    if not path.exists():
        return None
    try:
        if path.is_file():
            text = read_bytes(path, MAX_METADATA).decode()
            large = _skimmed(text) if len(text) > _LARGE_METADATA else {}
            metadata = large or _loaded(text)["rosbag2_bagfile_information"]
            if isinstance(metadata, dict) and _paths(metadata):
                return metadata
    except (OSError, KeyError, ValueError):
        pass
    losses.note(METADATA, "it is damaged; the parts are found by their names")
    return None


def _skimmed(text: str) -> JsonObject:
    """Return the needed fields of large metadata; empty if they are not in the usual format.

    A YAML parser in Python takes seconds per megabyte.
    """
    metadata: JsonObject = {}
    for key, value in _SCALAR.findall(text):
        metadata[key] = value.strip("'\"")
    paths = _PATH_LIST.search(text)
    if paths is None:
        return {}
    metadata["relative_file_paths"] = [
        line.strip()[1:].strip().strip("'\"") for line in paths["items"].splitlines()
    ]
    return metadata


def _loaded(text: str) -> JsonObject:
    """Return the content of a YAML text; empty if it is damaged."""
    try:
        loaded = read_yaml(text)
    except ContentError:
        return {}
    return loaded if isinstance(loaded, dict) else {}


def custom_data(text: str) -> dict[str, str]:
    """Return the custom data in the metadata of a bag, by name."""
    return _custom(_loaded(text)) if len(text) <= MAX_METADATA else {}


def _custom(metadata: JsonObject) -> dict[str, str]:
    custom = metadata.get("custom_data")
    if not isinstance(custom, dict):
        return {}
    return {_text(name): _text(value) for name, value in custom.items()}


def _numbered(path: Path, files: dict[str, Path], losses: Losses) -> list[Path]:
    """Return the parts in the folder in order of their numbers, and record missing ones."""
    parts: dict[tuple[str, int], Path] = {}
    for match in filter(None, map(_PART.fullmatch, sorted(files))):
        # Of a compressed file and its decompressed copy, the copy is sorted first and read.
        bag = match["bag"] + match["storage"]
        parts.setdefault((bag, int(match["number"] or 0)), files[match.string])
    bags = sorted({bag for bag, _ in parts})
    if not parts:
        raise UnsupportedLogError(
            path,
            "the folder holds no part of a ROS 2 bag (.mcap, .db3); name a log file or a "
            "bag folder",
        )
    if len(bags) > 1:
        raise UnsupportedLogError(
            path,
            f"the folder has no usable metadata.yaml and holds several bags: {listed(bags)}; "
            "name one file",
        )
    for before, after in pairwise(sorted(number for _, number in parts)):
        if after > before + 1:
            losses.note(f"parts between {before} and {after}", "they are not in the folder")
    return [parts[key] for key in sorted(parts)]


def _compare(metadata: JsonObject, files: dict[str, Path], found: Folder) -> None:
    """Find the parts that the metadata lists, and copy its counts and settings to `found`."""
    sizes = {
        PurePosixPath(_text(entry.get("path"))).name: entry.get("message_count")
        for entry in _dicts(metadata.get("files"))
    }
    listed_names: set[str] = set()
    for relative in _paths(metadata):
        name = PurePosixPath(relative).name
        # Old metadata include the folder's name. Nothing outside the folder is read.
        file = next((files[name] for name in _spellings(name) if name in files), None)
        listed_names.update(_spellings(name))
        if file is None:
            count = sizes.get(name)
            found.losses.note(f"part {quoted(relative)}", "it is not in the folder", _count(count))
        elif file not in found.parts:
            found.parts.append(file)
    for name in sorted(files.keys() - listed_names):
        reason = "metadata.yaml does not name it and it is not read; name it by itself to read it"
        found.losses.note(f"part {quoted(name)}", reason)
    if _text(metadata.get("compression_mode")).lower() == "message":
        found.message_compression = _text(metadata.get("compression_format")) or "zstd"
    found.custom = _custom(metadata)
    for entry in _dicts(metadata.get("topics_with_message_count")):
        topic, count = entry.get("topic_metadata"), _count(entry.get("message_count"))
        if isinstance(topic, dict) and count is not None:
            type_name = normalize_msgtype(_text(topic.get("type")))
            found.counts[_text(topic.get("name")), type_name] = count


def _paths(metadata: JsonObject) -> list[str]:
    paths = metadata["relative_file_paths"]
    return [_text(path) for path in paths] if isinstance(paths, list) else []


def _text(value: object) -> str:
    """Return a string; ``""`` for a value of another type."""
    return value if isinstance(value, str) else ""


def _spellings(name: str) -> Iterator[str]:
    """Yield possible file names of a part: after a crash the last one may not be compressed."""
    yield name
    yield name.removesuffix(".zstd")
    yield name + ".zstd"


def _dicts(value: object) -> list[JsonObject]:
    return [entry for entry in value if isinstance(entry, dict)] if isinstance(value, list) else []


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and 0 <= value <= MAX_COUNT else None


@dataclass(slots=True)
class Part:
    """A file of the bag.

    `copy`: its decompressed copy, if it is compressed
    `log`: the part, as long as it is kept open
    """

    path: Path
    copy: DecompressedCopy | None = None
    channels: dict[Channel, Channel] = field(default_factory=dict)
    log: MessageLog | None = None


def total_count(counts: list[int | None], stated: int | None) -> int | None:
    """Return the number of messages by the parts if all are known, else by the metadata."""
    known = [count for count in counts if count is not None]
    # After a crash of the recorder the metadata have no count, or 0.
    return sum(known) if len(known) == len(counts) else stated or None
