"""How messages become body rates: rates, increments with their time, bursts of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.merge import Columns
from quatprop.errors import MessageError
from quatprop.signals.channel_values import FieldReading, Groups, rows
from quatprop.text import quoted
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.messages.rate_types import Burst, RateField
    from quatprop.messages.stamps import Stamp
    from quatprop.signals.channel_values import Clock, Reading

MAX_SPACING_NS = NS_PER_UNIT["s"]
"""Samples of a burst are not further apart than this, unless the message is damaged."""


def rate_reading(log: MessageLog, channel: Channel, field: RateField, clock: Clock) -> Reading:
    """Return how the messages of a channel become rates.

    Parameters
    ----------
    log, channel
        Where the messages are.
    field
        What they carry.
    clock
        Whose time.

    Returns
    -------
    Reading
        Its values are the arguments of :class:`quatprop.series.GyroSeries`, but in the unit of
        the field.
    """
    if field.burst is not None:
        return _BurstReading(log.path, channel, field, field.burst, clock)
    if field.span is not None:
        return _IncrementReading(log.path, channel, field, field.span, clock)
    return FieldReading(log, channel, field.rate, clock, field.absent)


class _IncrementReading:
    """One increment a message, with the time over which it was integrated."""

    def __init__(
        self, path: Path | str, channel: Channel, field: RateField, span: Stamp, clock: Clock
    ) -> None:
        self._path = path
        self._span = span
        self._clock = clock
        self._groups = Groups(channel, (field.rate, span.fields, clock.fields), path)

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, rate, span_ns)``; the order is the block's."""
        turned, span, stamp = self._groups.of(block)
        span_ns = self._span.ns(span, self._path)
        # An increment over no time has no rate; it is not finite, and policies speak of that.
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = rows(turned) / (span_ns / NS_PER_UNIT["s"])[:, None]
        t_ns = self._clock.ns(stamp, block, self._path)
        return Columns(block.log_ns, (t_ns, rate, span_ns), block.not_before_ns)


class _BurstReading:
    """Many samples a message, evenly spaced up to the stamp."""

    def __init__(
        self, path: Path | str, channel: Channel, field: RateField, burst: Burst, clock: Clock
    ) -> None:
        self._path = path
        self._topic = channel.topic
        self._burst = burst
        self._clock = clock
        self._groups = Groups(channel, (field.rate, burst.fields, clock.fields), path)

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, rate)``, one row a sample."""
        axes, (samples, scale, spacing), stamp = self._groups.of(block)
        stored = np.stack(axes, axis=2)
        counts = samples.astype(np.int64)
        spacing_ns = spacing.astype(np.float64) * NS_PER_UNIT[self._burst.spacing.unit]
        self._check(counts, stored.shape[1], spacing_ns)
        message = np.repeat(np.arange(len(counts)), counts)
        position = np.arange(len(message)) - np.repeat(np.cumsum(counts) - counts, counts)
        rate = stored[message, position] * scale.astype(np.float64)[message, None]
        # Rounded last: the spacing need not be a whole number of nanoseconds.
        before = np.rint((counts[message] - 1 - position) * spacing_ns[message]).astype(np.int64)
        t_ns = self._clock.ns(stamp, block, self._path)[message] - before
        return Columns(block.log_ns[message], (t_ns, rate), block.not_before_ns)

    def _check(self, counts: NDArray[np.int64], room: int, spacing_ns: NDArray[np.float64]) -> None:
        # Written so that NaN is refused too.
        good = (counts <= room) & (spacing_ns >= 0) & (spacing_ns <= MAX_SPACING_NS)
        if not good.all():
            bad = np.flatnonzero(~good)
            raise MessageError(
                self._path,
                f"a message of topic {quoted(self._topic)} counts {counts[bad[0]]} samples, "
                f"{spacing_ns[bad[0]]:g} ns apart, and has room for {room}; the log is damaged",
                bad.tolist(),
            )
