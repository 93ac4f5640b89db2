"""How messages become body rates: plain rates, increments with their time, bursts of samples."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.merge import Columns
from quatprop.errors import MessageError
from quatprop.signals.message_values import FieldReader, GroupDecoder, as_rows
from quatprop.text import quoted
from quatprop.times import NS_PER_UNIT

if TYPE_CHECKING:
    from quatprop.arrays import Float64, Int64
    from quatprop.containers.base import Channel, MessageBlock, MessageLog
    from quatprop.messages.message_types import Burst, RateField
    from quatprop.messages.stamps import Stamp
    from quatprop.signals.clock import Clock
    from quatprop.signals.message_values import MessageReader

MAX_SPACING_NS = NS_PER_UNIT["s"]
"""Samples of a burst are not further apart than this, unless the message is damaged."""


def rate_reader(log: MessageLog, channel: Channel, field: RateField, clock: Clock) -> MessageReader:
    """Return what turns the messages of a channel into rates.

    Parameters
    ----------
    log, channel
        Where the messages are.
    field
        What they carry.
    clock
        Time base.

    Returns
    -------
    MessageReader
        Its values are the arguments of :class:`quatprop.series.GyroSeries`, but in the unit of
        the field.
    """
    if field.burst is not None:
        return _BurstReader(log, channel, field, field.burst, clock)
    if field.span is not None:
        return _IncrementReader(log, channel, field, field.span, clock)
    return FieldReader(log, channel, clock, field.fields, [field.absent])


class _IncrementReader(GroupDecoder):
    """One increment a message, with the time over which it was integrated."""

    def __init__(
        self, log: MessageLog, channel: Channel, field: RateField, span: Stamp, clock: Clock
    ) -> None:
        super().__init__(log, channel, clock, field.fields, span.fields)
        self._span = span

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, rate, span_ns)``; the order is the block's."""
        t_ns, (increment, span) = self.decode(block)
        span_ns = self._span.ns(span, self.path)
        # An increment over no time has no rate; it is not finite, and policies deal with that.
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = as_rows(increment) / (span_ns / NS_PER_UNIT["s"])[:, None]
        return Columns(block.log_ns, (t_ns, rate, span_ns), block.not_before_ns)


class _BurstReader(GroupDecoder):
    """Many samples a message, evenly spaced up to the stamp."""

    def __init__(
        self, log: MessageLog, channel: Channel, field: RateField, burst: Burst, clock: Clock
    ) -> None:
        super().__init__(log, channel, clock, field.fields, burst.fields)
        self._burst = burst

    def columns(self, block: MessageBlock) -> Columns:
        """Return log times with ``(t_ns, rate)``, one row a sample."""
        stamp_ns, (axes, (samples, scale, spacing)) = self.decode(block)
        stored = np.stack(axes, axis=2)
        counts = samples.astype(np.int64)
        spacing_ns = spacing.astype(np.float64) * NS_PER_UNIT[self._burst.spacing.unit]
        self._check(counts, stored.shape[1], spacing_ns)
        message = np.repeat(np.arange(len(counts)), counts)
        position = np.arange(len(message)) - np.repeat(np.cumsum(counts) - counts, counts)
        rate = stored[message, position] * scale.astype(np.float64)[message, None]
        # Rounded last: the spacing need not be a whole number of nanoseconds.
        before = np.rint((counts[message] - 1 - position) * spacing_ns[message]).astype(np.int64)
        t_ns = stamp_ns[message] - before
        return Columns(block.log_ns[message], (t_ns, rate), block.not_before_ns)

    def _check(self, counts: Int64, room: int, spacing_ns: Float64) -> None:
        # Written so that NaN is refused too.
        good = (counts <= room) & (spacing_ns >= 0) & (spacing_ns <= MAX_SPACING_NS)
        if not good.all():
            bad = np.flatnonzero(~good)
            raise MessageError(
                self.path,
                f"a message of topic {quoted(self.topic)} counts {counts[bad[0]]} samples, "
                f"{spacing_ns[bad[0]]:g} ns apart, and has room for {room}; the log is damaged",
                bad.tolist(),
            )
