"""What the stored numbers of an attitude mean: layout, convention and direction.

The user, the metadata of a file and the definition of a message may each say it; where two of them
contradict each other, nothing is read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.conventions import Meaning
from quatprop.conventions.layout import LAYOUTS, layout_named
from quatprop.errors import UsageError
from quatprop.provenance import entry_of
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.settings.selection import AttitudeSelection

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
