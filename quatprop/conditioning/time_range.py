"""The part of a log that is used: which samples it has, and which of the log have to be read."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol, TypeVar

import numpy as np

from quatprop.errors import UsageError
from quatprop.text import Setting, Text
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.arrays import Int64
    from quatprop.conditioning import Conditioning, ConditioningReport
    from quatprop.series import AttitudeSeries, GyroSeries

Series = TypeVar("Series", "GyroSeries", "AttitudeSeries")


_NOT_NS = 100_000
"""A stamp this many times the start that is asked for shows that the start is not in ns."""


class PartOfLog(NamedTuple):
    """The part of a log that holds a time range, found by the index of the log.

    Parameters
    ----------
    first_ns, last_ns
        The part, by log times, ends included, ns.
    leaves_out
        Whether the range leaves out samples before it, and after it.
    """

    first_ns: int
    last_ns: int
    leaves_out: tuple[bool, bool]


class PartReader(Protocol):
    """Reads parts of a log by its index."""

    def ends(self) -> tuple[int, int] | None:
        """Return the first and the last stamp, ns; None where only the whole log tells them."""

    def read(
        self, first_ns: int | None, last_ns: int | None
    ) -> tuple[PartOfLog, Iterator[GyroSeries]] | None:
        """Return the part with the stamps of a range, and the samples of that part.

        None where the whole log has to be read.
        """


def ends_of(stamps: Iterable[Int64]) -> tuple[int, int]:
    """Return the earliest and the latest of batches of stamps, ns; 0 where there is none."""
    ends = [(int(t_ns.min()), int(t_ns.max())) for t_ns in stamps if len(t_ns)]
    return min((first for first, _ in ends), default=0), max((last for _, last in ends), default=0)


def absolute_range(
    settings: Conditioning, first_ns: int, last_ns: int
) -> tuple[int | None, int | None]:
    """Return the first and the last stamp to use, ns; None is open.

    Parameters
    ----------
    settings
        What is asked for.
    first_ns, last_ns
        The earliest and the latest stamp of the log.

    Raises
    ------
    UsageError
        The range ends before it starts.
    """
    origins = {"clock": 0, "first": first_ns, "last": last_ns}
    start_ns, end_ns = (
        None if instant is None else instant.ns + origins[instant.origin]
        for instant in (settings.start, settings.end)
    )
    if settings.start is not None and settings.start.origin == "last":
        start_ns = max(settings.start.ns + last_ns, first_ns)
    if start_ns is not None and end_ns is not None and start_ns > end_ns:
        raise UsageError(
            f"{Setting('start')} is {duration_text(start_ns - end_ns)} after {Setting('end')}; "
            "swap them, or check units"
        )
    return start_ns, end_ns


def clipping_remarks(settings: Conditioning, report: ConditioningReport) -> Iterator[Text]:
    """Yield a remark for each absolute end that leaves nothing out, and on what was not read.

    Parameters
    ----------
    settings, report
        What to do, and what was done once all samples have passed.
    """
    before, after = report.outside if report.part is None else report.part.leaves_out
    ends = (
        ("start", "before the first", settings.start, before),
        ("end", "after the last", settings.end, after),
    )
    for name, side, instant, left_out in ends:
        if instant is not None and instant.origin == "clock" and not left_out:
            yield Text(
                f"{Setting(name)} is {side} sample and leaves nothing out; a number without a unit "
                "is in ns"
            )
    if report.part is not None:
        yield Text(
            "only the part of the log around the time range was read, by its index: what is "
            "damaged or lost elsewhere is not reported, and there is no SHA-256 of the log"
        )


def clipped(
    batches: Iterable[Series], start_ns: int | None, end_ns: int | None, outside: list[int]
) -> Iterator[Series]:
    """Yield the samples with start <= t <= end; None leaves an end open.

    The samples before and after are counted in the two numbers of `outside`.

    Raises
    ------
    UsageError
        The start is so far before the first sample that it must be in seconds or milliseconds.
    """
    first, last = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    # A date may be beyond what a clock of 64 bits can say.
    low = first if start_ns is None else min(max(start_ns, first), last)
    high = last if end_ns is None else min(max(end_ns, first), last)
    for number, batch in enumerate(batches):
        if not number and low > 0 and any(batch.t_ns[:1] // low >= _NOT_NS):
            raise UsageError(
                f"{Setting('start')} is at {low} ns, and the first sample at {batch.t_ns[0]} ns; a "
                "number without a unit is in ns: write all digits, a date, or a duration from the "
                "first sample such as +5s"
            )
        inside = (batch.t_ns >= low) & (batch.t_ns <= high)
        outside[0] += int(np.count_nonzero(batch.t_ns < low))
        outside[1] += int(np.count_nonzero(batch.t_ns > high))
        if inside.all():
            yield batch
        elif inside.any():
            yield batch[inside]
