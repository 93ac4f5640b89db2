"""How a file came about, kept inside it: the key under which it stands, and how it is read.

The content is JSON: convention, layout, method, q0, source, policies, counts, versions. Files of
Arrow keep it in their metadata, text in a comment if that was asked for.
"""

from __future__ import annotations

import hashlib
import json
import threading
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.errors import DamagedLogError, UnreadableLogError

if TYPE_CHECKING:
    from typing import Self

_BLOCK_BYTES = 1 << 20

METADATA_KEY = b"quatprop"
"""Key of a file's metadata that holds the provenance, as JSON."""


COMMENT = b"# quatprop "
"""How the first line of a text begins that holds the provenance."""


def as_json(value: object) -> Any:
    """Return a value as JSON has it: the one place where reports and results become JSON.

    Dataclasses become objects with their fields as keys, arrays and other sequences become lists,
    paths and sentences become strings; sentences with settings as the library spells them.

    Examples
    --------
    >>> from quatprop.text import Setting, Text
    >>> as_json({"path": Path("a.bag"), "remarks": (Text("see ", Setting("clock", "log")),)})
    {'path': 'a.bag', 'remarks': ["see clock='log'"]}
    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if is_dataclass(value):
        return {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [as_json(item) for item in value]
    # NumPy's arrays and scalars, without importing NumPy.
    convert = getattr(value, "tolist", None)
    return str(value) if convert is None else convert()


def provenance_in(metadata: Mapping[bytes, bytes], path: Path | str) -> dict[str, Any]:
    """Return the provenance in the metadata of a file; empty where there is none.

    Parameters
    ----------
    metadata
        All of the file's own keys and values.
    path
        The file, for errors.

    Raises
    ------
    DamagedLogError
        The provenance is not what this package writes.

    Examples
    --------
    >>> provenance_in({b"quatprop": b'{"quatprop": "1.0"}'}, "attitude.parquet")
    {'quatprop': '1.0'}
    """
    words = metadata.get(METADATA_KEY)
    if words is None:
        return {}
    try:
        provenance = json.loads(words)
    except ValueError:
        provenance = None
    if not isinstance(provenance, dict):
        raise DamagedLogError(
            path, "its metadata 'quatprop' is not the JSON it should be; write the file again"
        )
    return provenance


def provenance_of(said: Mapping[str, str], topic: str, path: Path | str) -> dict[str, Any]:
    """Return the provenance of one topic; empty where there is none.

    Parameters
    ----------
    said
        What a log of messages says of each topic, as JSON; under ``""`` of all others.
    topic
        The topic.
    path
        The log, for errors.

    Raises
    ------
    DamagedLogError
        It is not what this package writes.

    Examples
    --------
    >>> provenance_of({"": "{}", "/attitude": '{"quatprop": "1.0"}'}, "/attitude", "a.mcap")
    {'quatprop': '1.0'}
    """
    words = said.get(topic, said.get(""))
    return {} if words is None else provenance_in({METADATA_KEY: words.encode()}, path)


def of_all_topics(custom: Mapping[str, str]) -> dict[str, str]:
    """Return what the metadata of a whole log say, for :func:`provenance_of`.

    Parameters
    ----------
    custom
        All of them, by their names.
    """
    # What was added to a bag stands under its topic.
    parted = {name.partition(" ")[::2]: words for name, words in custom.items()}
    return {topic: words for (key, topic), words in parted.items() if key == METADATA_KEY.decode()}


def fingerprint(path: Path | str) -> dict[str, Any]:
    """Return by what a source can be told again: its bytes and their SHA-256.

    Parameters
    ----------
    path
        A file, or a folder; pipes and ``"-"`` cannot be read again.

    Returns
    -------
    dict
        ``bytes`` and ``sha256``, None where there is nothing to read. Of a folder also ``files``,
        the same of each file in it by name; its ``sha256`` is that of what ``sha256sum *`` prints
        for them.
    """
    with Fingerprint(path) as found:
        return found.result()


class Fingerprint:
    """Takes the fingerprint of a source, of a large one in a thread, while others read it.

    Parameters
    ----------
    path
        As for :func:`fingerprint`.
    wanted
        Whether it is wanted at all: reading everything once more is not for free. Otherwise
        ``sha256`` is None.
    """

    def __init__(self, path: Path | str, *, wanted: bool = True) -> None:
        self._place = Path(path)
        self._wanted = wanted
        self._stopped = threading.Event()
        self._found: dict[str, Any] = {"bytes": None, "sha256": None}
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None
        if self._place.is_file() and self._place.stat().st_size <= _BLOCK_BYTES:
            self._run()
        else:
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()

    def result(self) -> dict[str, Any]:
        """Wait for the fingerprint and return it; see :func:`fingerprint`.

        Raises
        ------
        UnreadableLogError
            The source cannot be read to its end.
        """
        if self._thread is not None:
            self._thread.join()
        if self._error is not None:
            raise UnreadableLogError(
                self._place, f"it cannot be read: {self._error.strerror}"
            ) from self._error
        return self._found

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            if self._place.is_dir():
                files = sorted(file for file in self._place.iterdir() if file.is_file())
                if files:
                    self._found = _of_folder({file.name: self._of_file(file) for file in files})
            elif self._place.is_file():
                self._found = self._of_file(self._place)
        except OSError as error:
            self._error = error

    def _of_file(self, file: Path) -> dict[str, Any]:
        digest = hashlib.sha256()
        size = 0
        block = memoryview(bytearray(min(file.stat().st_size + 1, _BLOCK_BYTES)))
        with file.open("rb", buffering=0) as stream:
            if not self._wanted:
                return {"bytes": stream.seek(0, 2), "sha256": None}
            while not self._stopped.is_set() and (count := stream.readinto(block)):
                digest.update(block[:count])
                size += count
        return {"bytes": size, "sha256": digest.hexdigest()}


def _of_folder(files: dict[str, dict[str, Any]]) -> dict[str, Any]:
    size = sum(facts["bytes"] for facts in files.values())
    if any(facts["sha256"] is None for facts in files.values()):
        return {"bytes": size, "sha256": None}
    lines = "".join(f"{facts['sha256']}  {name}\n" for name, facts in files.items())
    digest = hashlib.sha256(lines.encode(errors="surrogateescape"))
    return {"bytes": size, "sha256": digest.hexdigest(), "files": files}
