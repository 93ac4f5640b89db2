"""Copies of a log to which its attitudes are added; everything else is kept as it is.

Here the readers and writers of containers meet: the log's content is copied as bytes, attitudes
are inserted in order of time, and indexes are written anew.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, cast

import numpy as np

from quatprop.errors import OutputError, UsageError
from quatprop.text import Setting, listed, plain, quoted
from quatprop.writers import refuse_columns
from quatprop.writers.attitudes import AttitudeWriter, attitude_messages
from quatprop.writers.formats import WRITERS, kind_of, layout_of
from quatprop.writers.messages.kinds import Message
from quatprop.writers.targets import is_stdout

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from quatprop.arrays import Int64
    from quatprop.containers.base import Log, MessageLog
    from quatprop.series import AttitudeSeries
    from quatprop.tables.base import AnyLog

    Stamps = Callable[[], Iterator[tuple[Int64, Int64]]]

COPIERS: Mapping[str, tuple[str, str]] = {
    "mcap": ("mcap", "mcap:McapCopyWriter"),
    "bag": ("bag", "rosbag1:BagCopyWriter"),
    "db3": ("rosbag2", "rosbag2:Rosbag2CopyWriter"),
    "rosbag2": ("rosbag2", "rosbag2:Rosbag2CopyWriter"),
}
"""By the kind of log: the key of :data:`quatprop.writers.formats.WRITERS` of the copy, and
``module:class`` of the writer, which is called with the log, the target and the message to add."""


def copy_kind(log: Log, target: str, to: str | None = None) -> str:
    """Return the key of :data:`quatprop.writers.formats.WRITERS` that a copy of a log has.

    Parameters
    ----------
    log
        The log.
    target
        Where the copy goes.
    to
        The kind asked for.

    Raises
    ------
    UsageError
        The log is no container of messages, or another kind is asked for.
    OutputError
        The target is stdout.
    """
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
            f"{Setting('into')} copies the log in its own format; leave {Setting('to')} out"
        )
    suffixes = tuple(suffix for form in WRITERS.values() for suffix in form.suffixes if suffix)
    name = target.lower()
    compressed = name.endswith((".gz", ".zst", ".zstd", ".lz4", ".bz2"))
    if compressed or (name.endswith(suffixes) and kind_of(target) != kind):
        raise UsageError(
            f"{plain(target)}: a copy of {plain(log.path)} is {kind}, whatever its name; "
            f"name it {WRITERS[kind].suffixes[0] or 'without a suffix'}"
        )
    return kind


def open_into(  # noqa: PLR0913  # as open_writer, and the log
    log: AnyLog,
    target: str,
    stamps: Stamps,
    *,
    layout: str | None = None,
    comment: bool = False,
    message: Message | None = None,
    sigma: str | None = None,
    beside: str | None = None,
) -> AttitudeWriter:
    """Open a writer of a copy of a log to which attitudes are added.

    Parameters
    ----------
    log
        The log; it stays open until the copy is committed.
    target
        Where the copy goes.
    stamps
        Yields the stamps of the messages that the attitudes come from, and when they were logged,
        for attitudes that do not say it themselves: an attitude is logged when its message was.
    layout, comment, message, sigma, beside
        As for :func:`quatprop.writers.open_writer`.

    Returns
    -------
    AttitudeWriter
        A context manager that removes what was not committed.

    Raises
    ------
    UsageError
        The log cannot be added to, its topic exists already, or a setting does not apply to
        copies.
    OutputError
        As for :func:`quatprop.writers.open_writer`.
    """
    kind = copy_kind(log, target)
    layout_of(kind, layout)
    if comment:
        raise UsageError(f"{kind} has no comments; leave {Setting('header_comment')} out")
    refuse_columns(kind, message, sigma, beside)
    message = message or Message()
    channels = cast("MessageLog", log).channels()
    if message.topic_name in {channel.topic for channel in channels}:
        raise UsageError(
            f"{plain(log.path)}: topic {quoted(message.topic_name)} exists already; choose "
            f"another with {Setting('out_topic', 'NAME')}",
        )
    module, _, name = COPIERS[log.kind][1].partition(":")
    container = getattr(import_module(f"quatprop.into.{module}"), name)(log, target, message)
    times = LogTimes(stamps())

    def log_times(series: AttitudeSeries) -> Int64:
        return times.at(series.t_ns) if series.log_ns is None else series.log_ns

    return attitude_messages(container, container.encoder, target, log_times)


class LogTimes:
    """Finds log times by stamps, both in order, and keeps no more than it needs.

    Stamps and log times need not be of one clock: some devices count from when they were switched
    on. Players and plots sort by log time, so attitudes logged at their stamps could be fifty years
    away.

    Parameters
    ----------
    pairs
        Stamps and log times, shapes ``(N,)``, int64 ns, batch after batch in order of log times.
        Stamps that step back are ignored.

    Examples
    --------
    >>> times = LogTimes(iter([(np.array([10, 20]), np.array([1005, 1017]))]))
    >>> times.at(np.array([10, 14, 20, 30]))
    array([1005, 1009, 1017, 1027])
    """

    def __init__(self, pairs: Iterator[tuple[Int64, Int64]]) -> None:
        self._pairs = pairs
        self._stamps = np.empty(0, np.int64)
        self._logged = np.empty(0, np.int64)
        self._latest = np.iinfo(np.int64).min
        self._ended = False

    def at(self, t_ns: Int64) -> Int64:
        """Return when attitudes are logged, shape ``(N,)``, int64 ns.

        An attitude between messages is logged as long after the one before it as its stamp is
        after that one's, and never before the attitude ahead of it.

        Parameters
        ----------
        t_ns
            Their stamps, shape ``(N,)``, in order, none before those of earlier calls.
        """
        if not len(t_ns):
            return t_ns
        while not self._ended and not (len(self._stamps) and self._stamps[-1] > t_ns[-1]):
            self._fetch()
        if not len(self._stamps):
            return t_ns
        before = np.maximum(np.searchsorted(self._stamps, t_ns, "right") - 1, 0)
        log_ns: Int64 = self._logged[before] + (t_ns - self._stamps[before])
        log_ns = np.maximum(np.maximum.accumulate(log_ns), self._latest)
        self._latest = log_ns[-1]
        self._stamps, self._logged = self._stamps[before[-1] :], self._logged[before[-1] :]
        return log_ns

    def _fetch(self) -> None:
        """Read another batch, without stamps that are not later than all before them."""
        batch = next(self._pairs, None)
        if batch is None:
            self._ended = True
            return
        stamps, logged = batch
        last = self._stamps[-1:] if len(self._stamps) else stamps[:1] - 1
        latest = np.maximum.accumulate(np.concatenate([last, stamps]))[:-1]
        is_later = stamps > latest
        self._stamps = np.concatenate([self._stamps, stamps[is_later]])
        self._logged = np.concatenate([self._logged, logged[is_later]])
