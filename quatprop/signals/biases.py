"""Biases of a gyroscope that are recorded over time: in a table, or on a topic of a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conditioning.calibration import BiasSeries
from quatprop.errors import LogError, UsageError
from quatprop.formats import open_log
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import find
from quatprop.messages.stamps import Stamp
from quatprop.selection import RateSelection, SignalSelection
from quatprop.signals.clock import choose_clock
from quatprop.signals.message_values import channels_of, field_reader, timed_values
from quatprop.signals.rates import UNITS
from quatprop.tables.base import AnyLog, TableLog
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from quatprop.arrays import Float64, Int64
    from quatprop.containers.base import Channel, MessageLog


class BiasField(NamedTuple):
    """Where a message has the bias of a gyroscope, rad/s.

    Parameters
    ----------
    name
        Three numbers.
    stamps
        Its time, the best first.
    valid
        What is false where the bias is not valid; None where nothing says it.
    """

    name: str
    stamps: tuple[Stamp, ...]
    valid: str | None = None


_PX4 = BiasField(
    "gyro_bias",
    (Stamp(("timestamp_sample",), "us"), Stamp(("timestamp",), "us")),
    "gyro_bias_valid",
)
FIELDS: Mapping[str, BiasField] = {
    "px4_msgs/msg/EstimatorSensorBias": _PX4,
    "px4_msgs/msg/SensorBias": _PX4,
    "geometry_msgs/msg/Vector3Stamped": BiasField("vector", (Stamp.of_time("header.stamp"),)),
}
"""Fields by message type. The states of PX4's estimator are not among them: older versions hold a
bias of the angle there, newer ones of the rate, and messages do not say which."""


def read_biases(source: str, log: AnyLog | None, selection: SignalSelection) -> BiasSeries:
    """Read biases over time.

    Parameters
    ----------
    source
        A file, or a topic of the log.
    log, selection
        The log whose rates the biases are of, and how those were chosen; None for rates in memory.

    Raises
    ------
    LogError
        The file cannot be read, or holds no biases.
    UsageError
        There is no such file and no such topic.
    """
    if Path(source).exists():
        with open_log(source) as opened:
            if isinstance(opened, TableLog):
                return _of_table(source, opened)
            known = [c for c in channels_of(opened) if c.type_name in FIELDS]
            if len(known) != 1:
                topics = listed(channel.topic for channel in known)
                there = f"several topics with biases: {topics}" if known else "no topic with biases"
                raise UsageError(f"{Setting('bias')} {plain(source)}: it has {there}")
            return _of_channel(source, opened, known[0], RateSelection())
    if log is None or isinstance(log, TableLog) or not (channels := channels_of(log, source)):
        raise UsageError(
            f"{Setting('bias')} {plain(source)} is neither three numbers X,Y,Z nor static[:DUR], "
            "no such file is there, and the log has no such topic"
        )
    known = [channel for channel in channels if channel.type_name in FIELDS]
    if len(known) != 1:
        raise LogError(
            log.path,
            f"messages of topic {quoted(source)} are of type {quoted(channels[0].type_name)}, of "
            f"which no bias is known; types with one are {listed(FIELDS)}",
        )
    return _of_channel(source, log, known[0], RateSelection(clock=selection.clock))


def _of_table(source: str, log: TableLog) -> BiasSeries:
    from quatprop.tables.matching.biases import match_bias

    columns = match_bias(log)
    rows = ((t_ns, bias * UNITS[columns.unit]) for t_ns, bias in log.rows(columns.timed))
    return _series(source, columns.name, rows)


def _of_channel(
    source: str, log: MessageLog, channel: Channel, selection: SignalSelection
) -> BiasSeries:
    bias, root = FIELDS[channel.type_name], message_type(channel, log.path)
    stamps = [stamp for stamp in bias.stamps if all(find(root, name) for name in stamp.fields)]
    valid = [bias.valid] if bias.valid and find(root, bias.valid) else []
    clock = choose_clock(log, channel, stamps, selection)
    reader = field_reader(log, channel, clock, [bias.name], [], valid)
    rows = (
        (t_ns, np.where(good[0].reshape(-1, 1) != 0, value, np.nan) if good else value)
        for t_ns, value, *good in timed_values(log, channel, reader)
    )
    return _series(source, bias.name, rows)


def _series(source: str, name: str, rows: Iterable[tuple[Int64, Float64]]) -> BiasSeries:
    parts = [(np.empty(0, np.int64), np.empty((0, 3))), *rows]
    t_ns, bias = (np.concatenate(column) for column in zip(*parts, strict=True))
    good = np.isfinite(bias).all(axis=1)
    if not good.any():
        raise UsageError(f"{Setting('bias')} {plain(source)}: it has no valid biases")
    return BiasSeries(source, name, t_ns[good], bias[good])
