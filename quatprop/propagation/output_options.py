"""The keywords of an output of attitudes, and the settings that they define."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, quoted
from quatprop.settings.parsers import Choice, Keyword, flag, text
from quatprop.settings.quantities import EULER_SEQUENCES, LAYOUTS
from quatprop.writers.formats import MESSAGES, WRITERS, Message

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.propagation.settings import OutputSettings

_COMMENTED = [kind for kind, form in WRITERS.items() if form.comments]
EULER = tuple(f"euler-{sequence}" for sequence in EULER_SEQUENCES)
"""Representations by Euler angles."""

OUTPUT_OPTIONS = {
    "--to": Keyword(
        Choice(*WRITERS), f"{', '.join(WRITERS)}.",
        "from the suffix, else a ROS 2 bag", "FORMAT", group="Output", common=True),
    "--layout": Keyword(
        Choice(*LAYOUTS), "Order of the components: in storage only; scalar-first if the "
        "format allows both.", "from the format", group="Output", common=True),
    "--with extra_columns": Keyword(Choice("rotvec", *EULER, "matrix"),
        "Also write angles, a rotation vector or a matrix; in further columns of a "
        "table: euler-zyx is yaw, pitch and roll, euler-xyz and so on another sequence; "
        "rotvec; matrix.", takes="euler-zyx|...", group="Output", common=True),
    "--euler-unit": Keyword(Choice("rad", "deg"), "Unit of Euler angles.", "rad", group="Output"),
    "--header-comment comment": Keyword(
        flag, f"Begin {', '.join(_COMMENTED[:-1])} or {_COMMENTED[-1]} with the report in a # "
        "comment.", group="Output"),
    "--message": Keyword(Choice(*MESSAGES),
        f"Message type in mcap and bags: {', '.join(MESSAGES)}. The last two are "
        "Foxglove's own, for mcap only.", "QuaternionStamped", "TYPE", group="Output"),
    "--out-topic": Keyword(
        text, "Topic of the messages.", "/attitude, or /tf for transforms", "NAME",
        group="Output"),
    "--frames": Keyword(
        text, "Names of the two frames in the messages.", "reference,body",
        "REFERENCE,BODY", group="Output"),
}  # fmt: skip
"""Format, layout and messages of an output: names of an option -> its keyword."""


def output_settings(chosen: Mapping[str, Any]) -> OutputSettings:
    """Return the settings of an output from the values of its keywords, its path and its report."""
    from quatprop.kinematics.conventions import layout_named
    from quatprop.propagation.settings import OutputSettings

    layout, extra, unit = chosen["layout"], chosen["extra_columns"], chosen["euler_unit"]
    if unit and not {extra, chosen.get("representation")} & {*EULER}:
        raise UsageError(
            f"{Setting('euler_unit')} requires euler-zyx or another sequence of angles"
        )
    return OutputSettings(
        path=chosen["output"],
        to=chosen["to"],
        layout=layout and layout_named(layout).name,
        message=_message(chosen["message"], chosen["out_topic"], chosen["frames"]),
        extra_columns=extra and with_unit(extra, unit),
        comment=chosen["comment"],
        report=chosen["report"],
    )


def with_unit(representation: str, euler_unit: str | None) -> str:
    """Return the key of a representation, with the unit of Euler angles."""
    in_degrees = representation in EULER and euler_unit == "deg"
    return f"{representation}-deg" if in_degrees else representation


def _message(kind: str | None, topic: str | None, frames: str | None) -> Message | None:
    """Return the message to write; None if no keyword is given."""
    if kind is None and topic is None and frames is None:
        return None
    reference, comma, body = (frames or "reference,body").partition(",")
    if not comma:
        raise UsageError(
            f"{Setting('frames')} {quoted(frames)} is not two names; write REFERENCE,BODY"
        )
    return Message(kind or Message().type, topic, reference, body)
