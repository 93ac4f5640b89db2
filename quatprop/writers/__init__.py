"""Writers of attitude series: a format is one module and one row of :data:`.formats.WRITERS`.

A writer is opened on a target, takes batches in order, and is committed with the provenance of
its content. Without a commit nothing is left::

    with open_writer("attitude.parquet", layout="scalar-first") as writer:
        for series in attitudes:
            writer.write(series)
        writer.commit(provenance)
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.places import is_stdout
from quatprop.base.text import Setting, did_you_mean, listed, quoted
from quatprop.writers.formats import MESSAGES, WRITERS, Message, kind_of, layout_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from quatprop.writers.base import FileWriter, MessageWriter, TableWriter
    from quatprop.writers.message_encoders import FoxgloveEncoder, RosEncoder, Topic

    AttitudeEncoder = RosEncoder | FoxgloveEncoder
    """Encodes attitudes as messages of one type: has a topic, whether positions are written, and
    `encode`, which returns the messages of a batch."""


# Attitudes as encoded ROS and Foxglove messages.


def attitude_encoder(message: Message, encodings: Collection[str]) -> AttitudeEncoder:
    """Return the encoder of a message for a container.

    `encodings`: encodings of the container: ``"cdr"`` or ``"ros1"``, and ``"protobuf"``
    """
    if message.definition.is_ros:
        from quatprop.writers.message_encoders import RosEncoder

        return RosEncoder(message, ros1="ros1" in encodings)
    if "protobuf" not in encodings:
        raise UsageError(
            f"{quoted(message.type)} is Foxglove's own, in protobuf, and ROS bags hold ROS "
            "messages; write mcap, or choose "
            f"{listed(name for name, definition in MESSAGES.items() if definition.is_ros)}"
        )
    from quatprop.writers.message_encoders import FoxgloveEncoder

    return FoxgloveEncoder(message)


def open_writer(  # noqa: PLR0913  # content, target and format
    target: Path | str,
    kind: str | None = None,
    *,
    layout: str | None = None,
    comment: bool = False,
    message: Message | None = None,
    sigma: str | None = None,
    extra_columns: str | None = None,
) -> FileWriter:
    """Open a writer of attitude series.

    `target`: where to write; ``"-"`` is stdout
    `kind`: a key of :data:`WRITERS`; None takes it from the suffix of `target`. Stdout, pipes and
        devices get CSV; any other name without a suffix is a ROS 2 bag folder
    `layout`: a name in :data:`quatprop.settings.LAYOUTS`; None is the layout that the format
        prescribes, or else scalar-first
    `sigma`: ``"body"`` or ``"reference"``: add columns of standard deviations about these axes.
        Messages with a covariance always have that of the attitudes, about reference axes, as ROS
        defines it
    """
    from quatprop.kinematics.conventions import REPRESENTATIONS
    from quatprop.kinematics.series import SIGMA_COLUMNS
    from quatprop.writers.base import attitude_messages, attitude_table

    kind = kind_of(target, kind)
    chosen = WRITERS[kind]
    refuse_message(kind, message)
    order = layout_of(kind, layout)
    refuse_columns(kind, message, sigma, extra_columns)
    if not chosen.encodings:
        form = REPRESENTATIONS[extra_columns] if extra_columns else None
        columns = (order.columns, form.columns if form else (), SIGMA_COLUMNS if sigma else ())
        table = _open_columns(target, kind, sum(columns, ()), comment=comment, sigma=sigma)
        return attitude_table(table, order, sigma, form)

    refuse_comment(kind, comment=comment)
    _refuse_stdout(target, kind)
    encoder = attitude_encoder(message or Message(), chosen.encodings)
    return attitude_messages(open_messages(target, kind, encoder.topic), encoder, target)


def refuse_message(kind: str, message: Message | None) -> None:
    """Refuse message settings for a format without messages."""
    if message is not None and not WRITERS[kind].encodings:
        settings = f"{Setting('message')}, {Setting('out_topic')} and {Setting('frames')}"
        raise UsageError(f"{kind} holds no messages; omit {settings}")


def holds_covariances(kind: str, message: Message | None) -> bool:
    """Return whether a format, or a message in it, can store covariances."""
    chosen = WRITERS[kind]
    has_covariance = (message or Message()).definition.has_covariance
    return bool(chosen.columns or (chosen.encodings and has_covariance))


def refuse_columns(
    kind: str, message: Message | None, sigma: str | None, extra_columns: str | None
) -> None:
    """Refuse standard deviations and angles that a format or a message cannot store."""
    if extra_columns is None and sigma is None:
        return
    from quatprop.kinematics.conventions import REPRESENTATIONS

    chosen = WRITERS[kind]
    tables = listed(name for name, form in WRITERS.items() if form.columns)
    if extra_columns is not None and extra_columns not in REPRESENTATIONS:
        hint = did_you_mean(
            extra_columns, REPRESENTATIONS, f"choose one of {listed(REPRESENTATIONS)}"
        )
        raise UsageError(f"{Setting('extra_columns')}: there is no {quoted(extra_columns)}{hint}")
    if extra_columns is not None and not chosen.columns:
        raise UsageError(f"{Setting('extra_columns')}: {kind} has its own columns; choose {tables}")
    if sigma is None or holds_covariances(kind, message):
        return
    if chosen.encodings:
        message = message or Message()
        able = listed(name for name, one in MESSAGES.items() if one.has_covariance)
        reason = f"{message.type} has no covariance; choose {able} with "
        raise UsageError(f"{Setting('sigma')}: {reason}{Setting('message')}")
    raise UsageError(f"{Setting('sigma')}: {kind} holds poses only; choose {tables}")


def open_table(
    target: Path | str,
    names: Sequence[str],
    kind: str | None = None,
    *,
    comment: bool = False,
    facts: Mapping[str, Mapping[str, str]] | None = None,
) -> TableWriter:
    """Open a table of any columns.

    `names`: names of the float64 columns that follow ``t_ns``
    `facts`: unit, frame and convention of columns, by name; None: from their names
    """
    kind = kind_of(target, kind)
    if not WRITERS[kind].columns:
        tables = [name for name, form in WRITERS.items() if form.columns]
        raise OutputError(
            target, f"kind {quoted(kind)} holds quaternions only; choose {listed(tables)}"
        )
    return _open_columns(target, kind, names, comment=comment, facts=facts)


def open_messages(
    target: Path | str, kind: str, topic: Topic, compression: str | None = None
) -> MessageWriter:
    """Open a container of messages of one topic.

    `compression`: one of the format's compressions; None for its default
    """
    _refuse_stdout(target, kind)
    chosen = WRITERS[kind]
    writer: MessageWriter = chosen.load()(target, topic, compression or chosen.compressions[0])
    return writer


def _open_columns(  # noqa: PLR0913  # target and content
    target: Path | str,
    kind: str,
    names: Sequence[str],
    *,
    comment: bool,
    sigma: str | None = None,
    facts: Mapping[str, Mapping[str, str]] | None = None,
) -> TableWriter:
    _refuse_stdout(target, kind)
    refuse_comment(kind, comment=comment)
    options: dict[str, object] = {"comment": True} if comment else {}
    if WRITERS[kind].has_fields:
        from quatprop.kinematics.column_facts import column_facts

        options["facts"] = facts or column_facts(names, sigma_axes=sigma)
    table: TableWriter = WRITERS[kind].load()(target, names, **options)
    return table


def _refuse_stdout(target: Path | str, kind: str) -> None:
    if not is_stdout(target) or WRITERS[kind].is_text:
        return
    if "cdr" in WRITERS[kind].encodings and kind != "mcap":
        raise OutputError(target, "a ROS 2 bag is a folder; name one")
    if sys.stdout is not None and sys.stdout.isatty():
        raise OutputError(target, f"a terminal cannot show {kind}; send it to a file or a program")


def refuse_comment(kind: str, *, comment: bool) -> None:
    """Refuse a comment for a format without comments."""
    if comment and not WRITERS[kind].comments:
        raise UsageError(f"{kind} has no comments; omit {Setting('header_comment')}")
