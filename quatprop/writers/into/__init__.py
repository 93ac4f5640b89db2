"""Copy a log and add its attitudes; everything else is unchanged.

The log's content is copied as bytes, the attitudes are inserted in order of time, and the indexes
are rewritten.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.stores.kinds import COMPRESSION_SUFFIXES
from quatprop.writers import refuse_columns, refuse_comment
from quatprop.writers.base import AttitudeWriter, attitude_messages
from quatprop.writers.formats import WRITERS, Message, kind_of, layout_of
from quatprop.writers.targets import is_stdout

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.base.arrays import Int64
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.readers.containers.message_log import MessageLog
    from quatprop.readers.tables.model import Log

COPIERS: Mapping[str, tuple[str, str]] = {
    "mcap": ("mcap", "mcap_copy:McapCopyWriter"),
    "bag": ("bag", "rosbag1_copy:BagCopyWriter"),
    "db3": ("rosbag2", "rosbag2_copy:Rosbag2CopyWriter"),
    "rosbag2": ("rosbag2", "rosbag2_copy:Rosbag2CopyWriter"),
}
"""By kind of log: the copy's key in :data:`quatprop.writers.formats.WRITERS`, and ``module:class``
of the writer, which is called with the log, the target and the message to add."""


def copy_kind(log: Log, target: str, to: str | None = None) -> str:
    """Return the key of a log's copy in :data:`quatprop.writers.formats.WRITERS`."""
    if log.kind not in COPIERS:
        raise UsageError(
            f"{plain(log.path)}: attitudes can be added to logs of kind {listed(COPIERS)}, and "
            f"this one is {quoted(log.kind)}; write them to a file of their own with "
            f"{Setting('output')}",
        )
    kind, _ = COPIERS[log.kind]
    if is_stdout(target):
        raise OutputError(target, "standard output takes text only; name a file for the copy")
    if to is not None:
        raise UsageError(
            f"{Setting('into')} copies the log in its own format; omit {Setting('to')}"
        )
    suffixes = tuple(suffix for form in WRITERS.values() for suffix in form.suffixes if suffix)
    name = target.lower()
    compressed = name.endswith(COMPRESSION_SUFFIXES)
    if compressed or (name.endswith(suffixes) and kind_of(target) != kind):
        raise UsageError(
            f"{plain(target)}: a copy of {plain(log.path)} is {kind}, whatever its name; "
            f"name it {WRITERS[kind].suffixes[0] or 'without a suffix'}"
        )
    return kind


def open_into(  # noqa: PLR0913  # as open_writer, and the log
    log: Log,
    target: str,
    *,
    layout: str | None = None,
    comment: bool = False,
    message: Message | None = None,
    sigma: str | None = None,
    extra_columns: str | None = None,
) -> AttitudeWriter:
    """Open a writer of a copy of a log to which attitudes are added at their log times.

    Timestamps and log times may be of different clocks: some devices count from power-on. Players
    and plots sort by log time, so attitudes logged at their timestamps could be decades away.
    """
    kind = copy_kind(log, target)
    layout_of(kind, layout)
    refuse_comment(kind, comment=comment)
    refuse_columns(kind, message, sigma, extra_columns)
    message = message or Message()
    channels = cast("MessageLog", log).channels()
    if message.topic_name in {channel.topic for channel in channels}:
        raise UsageError(
            f"{plain(log.path)}: topic {quoted(message.topic_name)} exists already; choose "
            f"another with {Setting('out_topic', 'NAME')}",
        )
    module, _, name = COPIERS[log.kind][1].partition(":")
    container = getattr(import_module(f"quatprop.writers.into.{module}"), name)(
        log, target, message
    )

    def log_times(series: AttitudeSeries) -> Int64:
        return series.t_ns if series.log_ns is None else series.log_ns

    return attitude_messages(container, container.encoder, target, log_times)
