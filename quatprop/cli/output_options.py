"""Options for the output of an attitude series."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.types import PATH
from quatprop.settings.choices import EULER_SEQUENCES, LAYOUTS
from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import Choice, flag
from quatprop.writers.formats import WRITERS
from quatprop.writers.messages.kinds import MESSAGES, Message

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.pipeline.settings import OutputSettings


_COMMENTED = [kind for kind, form in WRITERS.items() if form.comments]
EULER = tuple(f"euler-{sequence}" for sequence in EULER_SEQUENCES)
"""Representations by Euler angles."""

INTO = {
    "--into": Keyword(
        PATH, "Instead: write PATH, a copy of the log with a topic of attitudes added and "
        "everything else kept. For MCAP files and bags; see --message, --out-topic and "
        "--frames.", "off", "PATH", group="Output"),
}  # fmt: skip
OUTPUT_OPTIONS = {
    "--to": Keyword(
        Choice(*WRITERS), f"{', '.join(WRITERS)}.",
        "by the suffix, else a ROS 2 bag", "FORMAT", group="Output", common=True),
    "--layout": Keyword(
        Choice(*LAYOUTS), "Order of the components: in storage only; scalar-first if the "
        "format allows both.", "by the format", group="Output", common=True),
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
        click.STRING, "Topic of the messages.", "/attitude, or /tf for transforms", "NAME",
        group="Output"),
    "--frames": Keyword(
        click.STRING, "Names of the two frames in the messages.", "reference,body",
        "REFERENCE,BODY", group="Output"),
}  # fmt: skip
"""Options of the output: format, layout, messages."""


def output_settings(chosen: Mapping[str, Any], own: str = "-o OUT") -> OutputSettings:
    """Return the settings of the output, from a command's options."""
    from quatprop.conventions.layout import layout_named
    from quatprop.pipeline.settings import OutputSettings

    output, into, layout = chosen["output"], chosen["into"], chosen["layout"]
    if (output is None) == (into is None):
        both = "" if output is None else ", not both"
        raise click.UsageError(f"say where the attitudes go: {own}, or --into COPY{both}")
    written = {chosen["extra_columns"], chosen.get("representation")}
    if chosen["euler_unit"] and not written & {*EULER}:
        raise click.UsageError("--euler-unit requires euler-zyx or another sequence of angles")
    return OutputSettings(
        path=into or output,
        into=into is not None,
        to=chosen["to"],
        layout=layout and layout_named(layout).name,
        message=_message(chosen["message"], chosen["out_topic"], chosen["frames"]),
        extra_columns=chosen["extra_columns"]
        and with_unit(chosen["extra_columns"], chosen["euler_unit"]),
        comment=chosen["comment"],
        report=chosen["report"],
    )


def with_unit(representation: str, euler_unit: str | None) -> str:
    """Return the key of a representation, with the unit of Euler angles."""
    in_degrees = representation in EULER and euler_unit == "deg"
    return f"{representation}-deg" if in_degrees else representation


def _message(kind: str | None, topic: str | None, frames: str | None) -> Message | None:
    """Return the message to write; None if no option is given."""
    if kind is None and topic is None and frames is None:
        return None
    reference, comma, body = (frames or "reference,body").partition(",")
    if not comma:
        raise click.BadParameter(f"--frames {frames!r} is not two names; write REFERENCE,BODY")
    return Message(kind or Message().type, topic, reference, body)
