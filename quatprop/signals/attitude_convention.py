"""What the stored numbers of an attitude mean: layout, convention and direction.

The user, the metadata of a file and the definition of a message may each say it; where two of them
contradict each other, nothing is read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.conventions import Meaning
from quatprop.conventions.layout import LAYOUTS, layout_named
from quatprop.errors import UndeclaredError, UsageError
from quatprop.provenance import entry_of
from quatprop.text import Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.containers.base import Channel
    from quatprop.messages.message_types import OrientationField
    from quatprop.selection import AttitudeSelection

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
    """Return what numbers mean: as the user or the metadata say, else Hamilton, body to reference.

    Raises
    ------
    UsageError
        The user contradicts the metadata.
    """
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


def message_layout(
    path: Path | str,
    channel: Channel,
    field: OrientationField,
    given: str | None,
    recorded: str | None,
) -> str:
    """Return how a message stores a quaternion: by its definition, else as the user says.

    Parameters
    ----------
    path
        The log, for errors.
    channel, field
        Where the quaternion is.
    given, recorded
        The layout that the user gives, and that in the metadata of the topic.

    Raises
    ------
    UsageError
        User, metadata and definition contradict each other.
    UndeclaredError
        None of them says it.
    """
    given = given and layout_named(given).name
    of_type = f"{quoted(field.name)} of {quoted(channel.type_name)}"
    if field.layout is not None:
        by_definition = field.layout.name
        if given is None and recorded not in (None, by_definition):
            raise UsageError(
                f"{plain(path)}: the metadata of topic {quoted(channel.topic)} say {recorded}, "
                f"but {of_type} is {by_definition} by definition; settle it with "
                f"{Setting('from_layout', by_definition)}"
            )
        if given not in (None, by_definition):
            raise UsageError(
                f"{plain(path)}: {Setting('from_layout')} says {given}, but {of_type} is "
                f"{by_definition} by definition; leave it out"
            )
        return by_definition
    if not (given or recorded) and len(field.fields) == 1:
        raise UndeclaredError(
            path,
            f"which of the four numbers in {quoted(field.name)} is the scalar",
            Setting("from_layout", "scalar-first|scalar-last"),
        )
    return given or recorded or BY_NAME
