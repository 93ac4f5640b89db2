"""One series of attitudes in a log, and what is said about its numbers.

The user, the metadata of a file and the definition of a message may each say what four numbers
mean; where two of them contradict each other, nothing is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from quatprop.conventions import Meaning
from quatprop.conventions.layout import LAYOUTS, layout_named
from quatprop.errors import UsageError
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.selection import AttitudeSelection

    Rows = Iterator[tuple[NDArray[np.int64], NDArray[np.float64]]]

BY_NAME = "by name"
"""The layout of components that stand in neither order, but have names."""


@dataclass(frozen=True, slots=True)
class AttitudeSource:
    """One series of attitudes in a log.

    Parameters
    ----------
    name
        The topic, or the names of the columns.
    type_name
        The message type, or the dialect of a table; ``""`` where there is none.
    quaternion
        The field, the columns, or the frames that are the attitude.
    layout
        How it is stored, ``"scalar-first"`` or ``"scalar-last"``; ``"by name"`` where it is
        neither; ``""`` where it is no quaternion.
    meaning
        What the stored numbers mean.
    clock
        Whose stamps: ``"header"``, ``"log"``, ``"publish"``, or the name of a column.
    remarks
        What was inferred.
    provenance
        How a table came about, as written beside it.
    rows
        Reads stamps in ns and numbers, scalar first and in the terms of :data:`HAMILTON
        <quatprop.conventions.HAMILTON>`, batch after batch in the order of the log. They are not
        checked: see :class:`quatprop.signals.rotation_check.RotationCheck`.
    stamps
        Reads the stamps of messages and when they were logged, ns, as `rows` reads the attitudes;
        None for a table.
    representation
        ``"quaternion"``, or what else is stored: a key of
        :data:`quatprop.conventions.representations.REPRESENTATIONS`.
    """

    name: str
    type_name: str
    quaternion: str
    layout: str
    meaning: Meaning
    clock: str
    remarks: tuple[str, ...]
    provenance: dict[str, Any]
    rows: Callable[[], Rows]
    stamps: Callable[[], Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]] | None = None
    representation: str = "quaternion"


def recorded_in(provenance: dict[str, Any]) -> dict[str, str]:
    """Return what a file says about its numbers; only words that are known."""
    said = provenance.get("convention")
    if not isinstance(said, dict):
        return {}
    layout = said.get("layout")
    known = {
        name: said[name]
        for name in ("convention", "direction", "representation")
        if isinstance(said.get(name), str)
    }
    is_known = isinstance(layout, str) and layout in LAYOUTS
    return {**known, "layout": layout_named(str(layout)).name} if is_known else known


def meaning_of(path: Path, selection: AttitudeSelection, recorded: dict[str, str]) -> Meaning:
    """Return what numbers mean: as the user or the metadata say, else what attitudes mean here.

    Raises
    ------
    UsageError
        The user contradicts the metadata.
    """
    return Meaning(
        _agreed(path, "convention", selection.from_convention, recorded) or "hamilton",
        _agreed(path, "direction", selection.from_direction, recorded) or "body-to-ref",
    )


def _agreed(path: Path, what: str, said: str | None, recorded: dict[str, str]) -> str | None:
    there = recorded.get(what)
    if said is not None and there is not None and said != there:
        raise UsageError(
            f"{plain(path)}: --from-{what} says {said}, but the metadata of the file says "
            f"{plain(there)}; leave the option out"
        )
    return said or there
