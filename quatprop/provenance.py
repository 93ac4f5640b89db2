"""How a file came about, kept inside it: the key under which it stands, and how it is read.

The content is JSON: convention, layout, method, q0, source, policies, counts, versions. Files of
Arrow keep it in their metadata, text in a comment if that was asked for.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.errors import DamagedLogError

if TYPE_CHECKING:
    from collections.abc import Mapping

METADATA_KEY = b"quatprop"
"""Key of a file's metadata that holds the provenance, as JSON."""


COMMENT = b"# quatprop "
"""How the first line of a text begins that holds the provenance."""


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
    words = custom.get(METADATA_KEY.decode())
    return {} if words is None else {"": words}


def fingerprint(path: Path | str) -> dict[str, Any]:
    """Return by what a source can be told again: its bytes and their SHA-256.

    Parameters
    ----------
    path
        A file; of a folder, its files in order of their names; ``"-"`` cannot be read again.

    Returns
    -------
    dict
        ``bytes`` and ``sha256``, None where there is nothing to read.
    """
    place = Path(path)
    files = sorted(place.iterdir()) if place.is_dir() else [place]
    files = [file for file in files if file.is_file()]
    if not files:
        return {"bytes": None, "sha256": None}
    digest = hashlib.sha256()
    size = 0
    for file in files:
        with file.open("rb") as stream:
            while data := stream.read(1 << 20):
                digest.update(data)
                size += len(data)
    return {"bytes": size, "sha256": digest.hexdigest()}
