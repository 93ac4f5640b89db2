"""The entries of a manifest: what a batch records of a log, as a line of JSON."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeGuard

from quatprop import __version__
from quatprop.guarded_text import ContentError, read_json
from quatprop.provenance import as_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

COMPLETE = {"done", "data lost"}
"""States of logs whose output is complete."""


class ManifestEntry(NamedTuple):
    """What a batch records of a log.

    Parameters
    ----------
    state
        ``"done"``; ``"data lost"``: done, but some data of the log were lost or left out;
        ``"no rates"``: a table found in a folder, without body rates; ``"failed"``.
    log
        Absolute path or address.
    output
        Path of the output in the folder of the manifest.
    samples, rows, span_s, sample_rate_hz, method, final_wxyz
        As in the report; None where there is no output.
    remarks, losses
        As in the report.
    error
        Why there is no output.
    seconds
        Duration, s.
    log_bytes, log_sha256, log_etag, output_bytes, output_sha256
        Sizes and digests; None where there are none. A log in an object store has the ETag that
        the store gives it.
    quatprop
        The version.
    options
        Digest of all settings but the paths.
    origin
        Digest of the version, the settings, and names, sizes and times of all files that are read,
        and of their ETags in an object store; None where they cannot be found out.
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


def entries_in(lines: Iterable[bytes], unused: list[int]) -> Iterator[Mapping[str, Any]]:
    """Yield the entries of the lines of a manifest.

    Parameters
    ----------
    lines
        The lines.
    unused
        Where the numbers of lines go that are no entries, but for those that a kill has cut.
    """
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


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_count(value: object) -> bool:
    return type(value) is int and 0 <= value <= _MAX_COUNT


def _is_number(value: object) -> bool:
    return type(value) in {int, float}


def _is_list(value: object, is_valid: Callable[[object], bool]) -> bool:
    return isinstance(value, list) and all(map(is_valid, value))


_IS_VALID: Mapping[str, Callable[[object], bool]] = {
    **dict.fromkeys(ManifestEntry._fields, _is_text),
    **dict.fromkeys(("samples", "rows", "log_bytes", "output_bytes"), _is_count),
    **dict.fromkeys(("span_s", "sample_rate_hz", "seconds"), _is_number),
    **dict.fromkeys(("remarks", "losses"), partial(_is_list, is_valid=_is_text)),
    "final_wxyz": partial(_is_list, is_valid=_is_number),
}
"""Field of an entry -> whether a value in the manifest is valid."""


def _is_entry(entry: object) -> TypeGuard[Mapping[str, Any]]:
    """Return whether a line is what a batch writes; other versions may have other fields."""
    return (
        isinstance(entry, dict)
        and all(isinstance(entry.get(name), str) for name in ("state", "log", "output"))
        and all(
            entry.get(name) is None or is_valid(entry[name]) for name, is_valid in _IS_VALID.items()
        )
    )


def json_line(entry: ManifestEntry | Mapping[str, Any]) -> bytes:
    """Return an entry as a line of JSON."""
    text = json.dumps(as_json(entry), ensure_ascii=False) + "\n"
    return text.encode(errors="surrogateescape")
