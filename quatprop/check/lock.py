"""What the cases of a suite rest on, pinned in a JSON file beside it.

A lock is text, so that whoever reviews a change sees which log, option or reference moved with it;
a reference alone is binary, and a series from elsewhere has no place to keep such things.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from quatprop.errors import SuiteError, UnreadableLogError
from quatprop.provenance import fingerprint
from quatprop.writers.atomic import replacing

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Pin:
    """What one case rested on when it was last updated.

    Parameters
    ----------
    quatprop
        The version that did it.
    inputs
        Key of the suite -> SHA-256 of what it names.
    options
        As in :class:`quatprop.check.case.Case`.
    samples
        How many samples were propagated.
    every
        The reference holds every so-manieth attitude; None where the case says which.
    reference
        SHA-256 of the stored reference; None where there is none.
    final_wxyz
        The last attitude, which a thinned reference does not hold.
    error_rad
        The worst error against a series from elsewhere, rad; None for a stored reference.
    """

    quatprop: str
    inputs: dict[str, str]
    options: dict[str, str]
    samples: int
    every: int | None
    reference: str | None
    final_wxyz: list[float]
    error_rad: float | None


def _is_count(value: Any) -> bool:
    return type(value) is int and value > 0


def _is_texts(value: Any) -> bool:
    return isinstance(value, dict) and all(isinstance(text, str) for text in value.values())


def _is_number(value: Any) -> bool:
    return type(value) in {int, float}


SOUND: Mapping[str, Callable[[Any], bool]] = {
    "quatprop": lambda value: isinstance(value, str),
    "inputs": _is_texts,
    "options": _is_texts,
    "samples": _is_count,
    "every": lambda value: value is None or _is_count(value),
    "reference": lambda value: value is None or isinstance(value, str),
    "final_wxyz": lambda value: len(value) == len("wxyz") and all(map(_is_number, value)),
    "error_rad": lambda value: value is None or _is_number(value),
}
"""Field of :class:`Pin` -> whether a value of the lock can be that."""


def read_lock(path: Path) -> dict[str, Pin]:
    """Return what is pinned for each case; nothing where there is no lock yet.

    Raises
    ------
    SuiteError
        The lock is not what an update writes.
    """
    try:
        told = json.loads(path.read_bytes())
        return {name: _pin(entry) for name, entry in told["cases"].items()}
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise SuiteError(path, f"it cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SuiteError(
            path, "it is not the lock that --update writes; restore it, or remove it and update"
        ) from error


def _pin(entry: dict[str, Any]) -> Pin:
    if entry.keys() != SOUND.keys() or not all(SOUND[key](entry[key]) for key in SOUND):
        raise ValueError(entry)
    return Pin(**entry)


def write_lock(path: Path, pins: dict[str, Pin]) -> None:
    """Write what is pinned; a case a block, so that changes of two cases do not collide."""
    told = {"cases": {name: asdict(pin) for name, pin in sorted(pins.items())}}
    text = json.dumps(told, indent=1, ensure_ascii=False) + "\n"
    if path.exists() and path.read_bytes() == text.encode():
        return
    with replacing(path) as stream:
        stream.write(text.encode())


def sha256_of(path: str) -> str:
    """Return the SHA-256 of a file, or of all files of a folder.

    Raises
    ------
    UnreadableLogError
        It is not there, or cannot be read.
    """
    found = fingerprint(path)["sha256"]
    if found is None:
        raise UnreadableLogError(path, "no such file or folder; check the path")
    return str(found)
