"""How a file came about, kept inside it: the key under which it stands, and how it is read.

The content is JSON: convention, layout, method, q0, source, policies, counts, versions.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from quatprop.errors import DamagedLogError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

METADATA_KEY = b"quatprop"
"""Key of a file's metadata that holds the provenance, as JSON."""


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
