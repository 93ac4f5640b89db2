"""Descriptions of the columns of a series, for the metadata of the fields of Arrow and Parquet.

The metadata of a file get lost where a program keeps only columns; those of a field go with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.kinematics.conventions import AttitudeConvention
from quatprop.settings.quantities import CONVENTIONS, DIRECTIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

FRAMES = {"body-to-ref": ("body", "reference"), "ref-to-body": ("reference", "body")}
"""The frames from and to which an attitude turns vectors, by its direction."""

COMPONENTS = {"qw", "qx", "qy", "qz"}
POSITIONS = {"px", "py", "pz"}

READ = ("layout", "convention", "direction", "frame")
"""Keys that are read from the metadata of fields."""


def column_facts(
    names: Sequence[str],
    meaning: AttitudeConvention | None = None,
    sigma_axes: str | None = None,
) -> dict[str, Mapping[str, str]]:
    """Return what each column is: its unit, and its frame or layout, convention and direction.

    `names`: names of the columns that follow ``t_ns``
    `meaning`: convention of the attitudes; None: Hamilton, body to reference
    `sigma_axes`: ``"body"`` or ``"reference"``: the axes of standard deviations; None for body
    """
    meaning = meaning or AttitudeConvention()
    source, target = FRAMES[meaning.direction]
    turns = {"direction": meaning.direction, "from_frame": source, "to_frame": target}
    quaternion: Mapping[str, str] = {}
    if {*names} >= COMPONENTS:
        last = names.index("qw") > names.index("qx")
        layout = "scalar-last" if last else "scalar-first"
        quaternion = {"layout": layout, "convention": meaning.convention, **turns, "unit": "1"}
    facts: dict[str, Mapping[str, str]] = {"t_ns": {"unit": "ns"}}
    for name in names:
        if name in COMPONENTS:
            facts[name] = quaternion
        elif name.startswith(("wx", "wy", "wz")):
            facts[name] = {"frame": "reference" if "_ref" in name else "body", "unit": "rad/s"}
        elif name in POSITIONS:
            facts[name] = {"frame": "reference", "unit": "m"}
        elif name.startswith("sigma_"):
            facts[name] = {"frame": sigma_axes or "body", "unit": "rad"}
        else:  # another representation, whose names have the unit
            unit = name.rpartition("_")[2]
            facts[name] = {**turns, "unit": unit if unit in {"rad", "deg"} else "1"}
    return facts


def stated_by(fields: Iterable[tuple[str, Mapping[bytes, bytes]]]) -> dict[str, set[str]]:
    """Return the facts about attitudes in the metadata of fields: key -> the values there.

    Fields whose convention and direction are not names of this package are ignored.

    `fields`: their names and metadata. `sigma_axes` is the frame of standard deviations
    """
    stated: dict[str, set[str]] = {}
    for name, metadata in fields:
        facts = {key: metadata.get(key.encode(), b"").decode(errors="replace") for key in READ}
        if name.startswith("sigma_") and facts["frame"] in FRAMES["body-to-ref"]:
            stated.setdefault("sigma_axes", set()).add(facts["frame"])
        if facts["convention"] in CONVENTIONS and facts["direction"] in DIRECTIONS:
            for key in ("convention", "direction", "layout"):
                stated.setdefault(key, set()).add(facts[key])
    return stated
