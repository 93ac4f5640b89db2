"""The entries of a manifest: what a batch records of a log, as a line of JSON."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

from quatprop.provenance import as_json
from quatprop.settings.guarded_text import ContentError, read_json
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

COMPLETE = {"done", "data lost"}
"""States of logs whose output is complete."""


class ManifestEntry(NamedTuple):
    """What a batch records of a log.

    `state`: ``"done"``; ``"data lost"``: done, but some data of the log were lost or left out;
        ``"no rates"``: a table found in a folder, without body rates; ``"failed"``
    `log`, `output`: absolute path or address; name of the output below the folder
    `samples`, `rows`: samples propagated, attitudes written
    `seconds`: how long it took, s
    `remarks`, `losses`: what should be known of; what could not be read
    `error`: why there is no output
    `log_bytes`, `log_sha256`, `log_etag`, `output_bytes`, `output_sha256`: sizes and digests; None
        where there are none. A log in an object store has the ETag that the store gives it
    `options`: digest of all settings but the paths
    `origin`: digest of the version, the settings, and names, sizes and times of all files that are
        read, and of their ETags in an object store; None where they cannot be found out
    """

    state: str
    log: str
    output: str
    samples: int | None = None
    rows: int | None = None
    span_s: float | None = None
    sample_rate_hz: float | None = None
    method: str | None = None
    final_wxyz: tuple[float, ...] | None = None
    remarks: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    error: str | None = None
    seconds: float = 0.0
    log_bytes: int | None = None
    log_sha256: str | None = None
    log_etag: str | None = None
    output_bytes: int | None = None
    output_sha256: str | None = None
    quatprop: str = __version__
    options: str = ""
    origin: str | None = None


TYPES: Mapping[str, str] = {
    **dict.fromkeys(ManifestEntry._fields, "string"),
    **dict.fromkeys(("samples", "rows", "log_bytes", "output_bytes"), "int64"),
    **dict.fromkeys(("span_s", "sample_rate_hz", "seconds", "final_wxyz"), "double"),
}
"""Field of an entry -> type of its values, by Arrow's name."""

LISTS = {"remarks", "losses", "final_wxyz"}
"""Fields with several values."""

_REQUIRED = {"state", "log", "output"}


def entries_in(lines: Iterable[bytes], unused: list[int]) -> Iterator[Mapping[str, Any]]:
    """Yield the entries of the lines of a manifest."""
    for number, line in enumerate(lines, 1):
        try:
            entry = read_json(line)
        except ContentError:
            entry = None
        if _is_entry(entry):
            yield entry
        elif line.strip() and not (line.startswith(_BEGINNING) and line.rstrip()[-1:] != b"}"):
            unused.append(number)


_BEGINNING = b'{"state": '

_MAX_COUNT = (1 << 63) - 1

_IS_VALID: Mapping[str, Callable[[Any], bool]] = {
    "string": lambda value: isinstance(value, str),
    "int64": lambda value: type(value) is int and 0 <= value <= _MAX_COUNT,
    "double": lambda value: type(value) in {int, float},
}


def _is_valid(name: str, value: object) -> bool:
    values = value if name in LISTS else [value]
    return isinstance(values, list) and all(map(_IS_VALID[TYPES[name]], values))


def _is_entry(entry: object) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a line is what a batch writes; other versions may have other fields."""
    return isinstance(entry, dict) and all(
        name not in _REQUIRED if entry.get(name) is None else _is_valid(name, entry[name])
        for name in TYPES
    )


def json_line(entry: ManifestEntry | Mapping[str, Any]) -> bytes:
    """Return an entry as a line of JSON."""
    text = json.dumps(as_json(entry), ensure_ascii=False) + "\n"
    return text.encode(errors="surrogateescape")
