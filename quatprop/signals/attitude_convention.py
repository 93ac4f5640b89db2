"""What the stored numbers of an attitude mean: layout, convention and direction.

The user, the metadata of a file and the definition of a message may each say it; where two of them
contradict each other, nothing is read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.conventions import Meaning
from quatprop.conventions.layout import LAYOUTS, SCALAR_FIRST, SCALAR_LAST, layout_named
from quatprop.errors import UndeclaredError, UsageError
from quatprop.provenance import entry_of
from quatprop.text import Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.logs.matching import Found
    from quatprop.settings.selection import AttitudeSelection
    from quatprop.tables.model import Group

BY_NAME = "by name"
"""The layout of components that have names and stand in neither order."""


def recorded_convention(provenance: Mapping[str, Any]) -> dict[str, str]:
    """Return what a file says about its numbers, as far as it is understood."""
    convention = entry_of(provenance, "convention", dict)
    layout = entry_of(convention, "layout", str)
    recorded = {
        name: convention[name]
        for name in ("convention", "direction", "representation")
        if isinstance(convention.get(name), str)
    }
    if layout in LAYOUTS:
        recorded["layout"] = layout_named(layout).name
    return recorded


def meaning_of(
    path: Path | str, selection: AttitudeSelection, recorded: Mapping[str, str]
) -> Meaning:
    """Return what numbers mean: as user or metadata say, else Hamilton, body to reference."""
    return Meaning(
        _agreed(path, "convention", selection.from_convention, recorded) or "hamilton",
        _agreed(path, "direction", selection.from_direction, recorded) or "body-to-ref",
    )


def _agreed(
    path: Path | str, what: str, given: str | None, recorded: Mapping[str, str]
) -> str | None:
    stored = recorded.get(what)
    if given is not None and stored is not None and given != stored:
        raise UsageError(
            f"{plain(path)}: {Setting(f'from_{what}')} says {given}, but the metadata of the file "
            f"says {plain(stored)}; leave it out"
        )
    return given or stored


def message_layout(found: Found, given: str | None, recorded: str | None) -> str:
    """Return how a message stores a quaternion: by its definition, else as the user says.

    `given`, `recorded`: the layout that the user gives, and that in the metadata of the topic
    """
    given = given and layout_named(given).name
    table, by_definition = found.table, _defined_layout(found)
    of_type = f"{quoted(found.field)} of {quoted(table.type)}"
    if by_definition:
        if given is None and recorded not in (None, by_definition):
            raise UsageError(
                f"{plain(table.path)}: the metadata of topic {quoted(table.name)} say {recorded}, "
                f"but {of_type} is {by_definition} by definition; settle it with "
                f"{Setting('from_layout', by_definition)}"
            )
        if given not in (None, by_definition):
            raise UsageError(
                f"{plain(table.path)}: {Setting('from_layout')} says {given}, but {of_type} is "
                f"{by_definition} by definition; leave it out"
            )
        return by_definition
    if not (given or recorded) and not _has_names(found):
        raise UndeclaredError(
            table.path,
            f"which of the four numbers in {quoted(found.field)} is the scalar",
            Setting("from_layout", "scalar-first|scalar-last"),
        )
    return given or recorded or BY_NAME


def in_order(found: Found, layout: str) -> Group:
    """Return the columns of w, x, y, z; where they are only numbered, by the layout."""
    (stored,) = found.sets
    if _has_names(found):
        return stored
    order = layout_named(layout).order
    return tuple(stored[order.index(component)] for component in range(4))


def _defined_layout(found: Found) -> str:
    """Return the layout by names or by the type; ``""`` where neither says it."""
    if _has_names(found):
        # The columns of a message are in the order of its definition.
        stored = "".join("wxyz"[found.sets[0].index(k)] for k in sorted(found.sets[0]))
        return {"wxyz": SCALAR_FIRST.name, "xyzw": SCALAR_LAST.name}.get(stored, "")
    return found.row.layout or (SCALAR_LAST.name if found.row.types else "")


def _has_names(found: Found) -> bool:
    return found.table.columns[found.sets[0][0]].text.endswith("w")
