"""A copy of a log with its attitude added: everything else is kept as it is.

This is where readers and writers of containers meet: what is there is copied as bytes, attitudes
are put between it in order of time, and what tells where things are is written anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

from quatprop.errors import OutputError, UsageError
from quatprop.into.log_times import LogTimes
from quatprop.text import listed, plain, quoted
from quatprop.writers import WRITERS, kind_of, layout_of
from quatprop.writers.atomic import is_stdout
from quatprop.writers.messages.kinds import Message

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import Log, MessageLog
    from quatprop.tables.base import TableLog
    from quatprop.writers.base import AttitudeWriter

    Int64 = NDArray[np.int64]
    Stamps = Callable[[MessageLog | TableLog], Iterator[tuple[Int64, Int64]]]

_COPIERS: Mapping[str, tuple[str, str]] = {
    "mcap": ("mcap", "quatprop.into.mcap:McapInto"),
    "bag": ("bag", "quatprop.into.rosbag1:Rosbag1Into"),
    "db3": ("rosbag2", "quatprop.into.rosbag2:Rosbag2Into"),
    "rosbag2": ("rosbag2", "quatprop.into.rosbag2:Rosbag2Into"),
}
"""By the kind of a log: the key of :data:`WRITERS` that it is, and what copies it."""


@dataclass(frozen=True, slots=True)
class Addition:
    """What is added to a copy of a log.

    Parameters
    ----------
    message
        What the attitudes are written as, and where they are published.
    times
        When each of them is logged.
    """

    message: Message
    times: LogTimes


def written_kind(log: Log, target: str, to: str | None = None) -> str:
    """Return the key of :data:`quatprop.writers.WRITERS` that a copy of a log is.

    Parameters
    ----------
    log
        What is copied.
    target
        Where the copy goes.
    to
        The kind asked for.

    Raises
    ------
    UsageError
        The log is no container of messages, or something else is asked for.
    OutputError
        The target is stdout.
    """
    if log.kind not in _COPIERS:
        raise UsageError(
            f"{plain(log.path)}: attitudes can be added to logs of kind {listed(_COPIERS)}, and "
            f"this one is {quoted(log.kind)}; write them to a file of their own with -o"
        )
    kind, _ = _COPIERS[log.kind]
    if is_stdout(target):
        raise OutputError(target, "standard output takes text only; name a file for the copy")
    if to is not None:
        raise UsageError("--into copies the log in its own format; leave --to out")
    suffixes = [suffix for known in WRITERS.values() for suffix in known.suffixes if suffix]
    packed = target.lower().endswith((".gz", ".zst", ".zstd", ".lz4", ".bz2"))
    if packed or (target.lower().endswith(tuple(suffixes)) and kind_of(target) != kind):
        raise UsageError(
            f"{plain(target)}: a copy of {plain(log.path)} is {kind}, whatever it is called; "
            f"name it {WRITERS[kind].suffixes[0] or 'without a suffix'}"
        )
    return kind


def open_into(  # noqa: PLR0913  # as open_writer, and what is copied
    log: MessageLog | TableLog,
    target: str,
    stamps: Stamps,
    *,
    layout: str | None = None,
    comment: bool = False,
    message: Message | None = None,
) -> AttitudeWriter:
    """Open a writer of a copy of a log to which attitudes are added.

    Parameters
    ----------
    log
        What is copied; it stays open until the copy is committed.
    target
        Where the copy goes.
    stamps
        Reads the stamps of the messages that the attitudes come from, and when they were logged:
        an attitude is logged when its message was.
    layout, comment, message
        As for :func:`quatprop.writers.open_writer`.

    Returns
    -------
    AttitudeWriter
        A context manager that removes what was not committed.

    Raises
    ------
    UsageError
        The log cannot be added to, its topic is there already, or an option does not go with
        copies.
    OutputError
        As for :func:`quatprop.writers.open_writer`.
    """
    kind = written_kind(log, target)
    layout_of(kind, layout)
    if comment:
        raise UsageError(f"{kind} has no comments; leave --header-comment out")
    module, _, name = _COPIERS[log.kind][1].partition(":")
    addition = Addition(message or Message(), LogTimes(stamps(log)))
    writer: AttitudeWriter = getattr(import_module(module), name)(log, target, addition)
    return writer
