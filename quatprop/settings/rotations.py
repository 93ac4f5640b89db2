"""Parsers of settings about attitudes and rates: numbers, a file, a topic, or a value in memory."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Protocol, TypeGuard

from quatprop.errors import UsageError
from quatprop.settings.parsers import number_list, parts_of, path
from quatprop.stores.log_names import split_topic
from quatprop.text import shown

FROM_THE_LOG = ("level", "log")
"""Initial attitudes from the log itself."""

FILE_SETTINGS = frozenset({"at", "bias", "calibration", "imu", "msg_path", "q0"})
"""Settings whose value is, or may be, the name of a file."""

STATIC = "static"
"""Value for a bias that is the mean rate at rest."""


class Rotated(Protocol):
    """A rotation, such as that of scipy."""

    def as_matrix(self) -> Any:
        """Return the rotation matrix, shape ``(3, 3)``."""


class Timed(Protocol):
    """A series of rates or of attitudes."""

    @property
    def t_ns(self) -> Any:
        """The timestamps, shape ``(N,)``, ns."""


class InMemory:
    """A value without text: times or a series in a program that uses the library."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __str__(self) -> str:
        """Return the text for reports."""
        return "in memory"


def place(value: object) -> tuple[float, ...]:
    """Return a latitude, and the azimuth of the reference's x axis if given, deg."""
    names = "LAT,AZIMUTH" if len(parts_of(value)) > 1 else "LAT"
    numbers = number_list(names)(value)
    if abs(numbers[0]) > 90:  # noqa: PLR2004  # the poles
        raise UsageError(f"{shown(value)} is not a latitude: give -90 to 90 deg, north positive")
    return numbers


def file_beside(name: str, text: str, folder: Path) -> Path | None:
    """Return the file that a setting names, relative to a folder; None if it names none."""
    path = folder / text
    words = {"bias": (STATIC,), "q0": FROM_THE_LOG}.get(name, ())
    if name not in FILE_SETTINGS or "://" in text or re.split("[:@]", text)[0].strip() in words:
        return None
    # It may also be a topic or numbers.
    is_there = Path(split_topic(str(path))[0]).exists()
    return path if is_there or not (words or name == "at" or "," in text) else None


def files_beside(values: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Return settings with the paths of their files relative to a folder."""
    texts = {name: str(one) for name, one in values.items() if isinstance(one, str | PathLike)}
    files = {name: file_beside(name, text, folder) for name, text in texts.items()}
    return {**values, **{name: str(file) for name, file in files.items() if file is not None}}


def times(value: object) -> str | InMemory:
    """Return the path of a series, or times in memory."""
    is_times = isinstance(value, Iterable) and not isinstance(value, str)
    return InMemory(value) if is_times else path(value)


def initial_attitude(value: object) -> tuple[float, ...] | str | InMemory:
    """Return four numbers, ``"level"``, ``"log"``, or an attitude series: a path or a topic.

    `value`: text, four numbers, a series in memory, or a rotation of scipy
    """
    if hasattr(value, "t_ns"):
        return InMemory(value)
    if (as_quat := getattr(value, "as_quat", None)) is not None:
        x, y, z, w = parts_of(as_quat())
        value = (w, x, y, z)
    if isinstance(value, str) and value in FROM_THE_LOG:
        return value
    if not is_name(value):
        return number_list("W,X,Y,Z")(value)
    may_be_a_topic = isinstance(value, str) and "." not in Path(value).name
    if not may_be_a_topic and not Path(value).exists():
        raise UsageError(
            f"{shown(value)} is neither four numbers W,X,Y,Z nor level or log, and no such file "
            "is there"
        )
    return path(value)


def mounting(value: object) -> str:
    """Return axes, a name or a quaternion as text, which the conditioning parses.

    `value`: text, four numbers, a matrix of shape ``(3, 3)``, or a rotation of scipy
    """
    if isinstance(value, str):
        return value
    as_matrix = getattr(value, "as_matrix", None)
    parts = parts_of(value if as_matrix is None else as_matrix())
    # The rows of a matrix in sequence.
    rows = [parts_of(part) if not isinstance(part, str) else [part] for part in parts]
    return ",".join(str(part) for row in rows for part in row)


def is_name(value: object) -> TypeGuard[str | PathLike[str]]:
    """Return whether a value may be a file or a topic: text that is not numbers."""
    if not isinstance(value, str) or not value:
        return isinstance(value, PathLike)
    try:
        list(map(float, value.split(",")))
    except ValueError:
        return True
    return False
