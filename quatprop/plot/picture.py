"""What a picture shows, before anything is drawn: rows over one time axis."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.plot.lines import folded, gaps_in, line
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from quatprop.plot.accumulators import Quantity
    from quatprop.plot.lines import Line
    from quatprop.plot.reduction import Reduced

    Float64 = NDArray[np.float64]

CALENDAR_NS = 315_964_800_000_000_000
"""1980-01-06, where the time of GPS begins: earlier stamps are of a clock that counts from boot."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a row.

    Parameters
    ----------
    drawn
        Its points, seconds and values.
    colour
        A key of :data:`quatprop.plot.palette.AXES`, or the number of the file.
    """

    drawn: Line
    colour: str | int


@dataclass(frozen=True, slots=True)
class Mark:
    """A point that is pointed at.

    Parameters
    ----------
    seconds, value
        Where it is.
    words
        What is said there.
    sign
        ``"first"`` or ``"worst"``.
    """

    seconds: float
    value: float
    words: str
    sign: str


@dataclass(frozen=True, slots=True)
class Row:
    """One pair of axes.

    Parameters
    ----------
    quantity
        What it shows.
    curves
        Its lines.
    level
        A horizontal line and what it is, such as a tolerance.
    marks
        Points to look at.
    """

    quantity: Quantity
    curves: tuple[Curve, ...]
    level: tuple[float, str] | None = None
    marks: tuple[Mark, ...] = ()


class Group(NamedTuple):
    """Rows that share their stamps.

    Parameters
    ----------
    rows
        What there is to draw.
    reduced
        What is left of the samples.
    gap_limit_ns
        The longest interval that is no gap, ns; None: there are none.
    """

    rows: tuple[Quantity, ...]
    reduced: Reduced
    gap_limit_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Part:
    """What one file puts into a picture.

    Parameters
    ----------
    label
        What the file is called.
    groups
        What there is to draw of it; the gaps are those of the first.
    detail
        What else is said of it in the legend.
    """

    label: str
    groups: tuple[Group, ...]
    detail: str = ""

    @property
    def name(self) -> str:
        """What it is called in a legend and in a title."""
        return f"{self.label}: {self.detail}" if self.detail else self.label

    @property
    def rows(self) -> tuple[Quantity, ...]:
        """What there is to draw of it."""
        return tuple(row for group in self.groups for row in group.rows)

    @property
    def first_ns(self) -> int:
        """Its first stamp, ns."""
        return min(int(group.reduced.first_ns.min()) for group in self.groups)

    @property
    def last_ns(self) -> int:
        """Its last stamp, ns."""
        return max(int(group.reduced.last_ns.max()) for group in self.groups)


@dataclass(frozen=True, slots=True)
class Picture:
    """All that is drawn.

    Parameters
    ----------
    title
        What it is of, in one line.
    facts
        Lines below the title: convention, method, counts.
    time
        What the time axis says.
    rows
        From top to bottom.
    gaps
        For each file: first and last second of each gap, shape ``(G, 2)``.
    starts
        For each file: the stamp at which its seconds begin, ns.
    legend
        Names of the files where they are several.
    notes
        What has to be known to read it.
    """

    title: str
    facts: tuple[str, ...]
    time: str
    rows: tuple[Row, ...]
    gaps: tuple[Float64, ...]
    starts: tuple[int, ...]
    legend: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def picture(parts: Sequence[Part], **said: Any) -> Picture:
    """Return files laid over one another.

    Parameters
    ----------
    parts
        At least one; all with the same rows.
    **said
        Title, facts and notes of the :class:`Picture`.

    Raises
    ------
    UsageError
        The files have different things to show.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.rows != first.rows:
            raise UsageError(
                f"{plain(first.label)} shows {_told(first)} and {plain(part.label)} {_told(part)}; "
                "draw them apart, or choose with --show"
            )
    starts, time = _time_axis(parts)
    several = len(parts) > 1
    rows = []
    for number, quantity in enumerate(first.rows):
        curves = tuple(
            Curve(_drawn(part, number, start), place if several else quantity.axis)
            for place, (part, start) in enumerate(zip(parts, starts, strict=True))
        )
        rows.append(Row(quantity, curves))
    return Picture(
        time=time,
        rows=tuple(rows),
        gaps=tuple(_gaps(part, start) for part, start in zip(parts, starts, strict=True)),
        starts=tuple(starts),
        legend=tuple(part.name for part in parts) if several else (),
        **said,
    )


def _told(part: Part) -> str:
    units = [row.unit for row in part.rows if row.unit]
    return f"{part.rows[0].name} in {units[0]}" if units else part.rows[0].name


def _drawn(part: Part, number: int, start_ns: int) -> Line:
    """Return the line of the row with this number."""
    for rows, reduced, gap_limit_ns in part.groups:
        if number < len(rows):
            drawn = line(reduced, number, start_ns, gap_limit_ns)
            return folded(drawn) if rows[number].turns else drawn
        number -= len(rows)
    raise IndexError(number)


def _gaps(part: Part, start_ns: int) -> Float64:
    _, reduced, gap_limit_ns = part.groups[0]
    return np.asarray((gaps_in(reduced, gap_limit_ns) - start_ns) * 1e-9)


def _time_axis(parts: Sequence[Part]) -> tuple[list[int], str]:
    """Return where the seconds of each file begin, and what the axis says of it."""
    begins = max(part.first_ns for part in parts)
    ends = min(part.last_ns for part in parts)
    if begins > ends:
        return [part.first_ns for part in parts], "time since the start of each file, s"
    start = min(part.first_ns for part in parts)
    return [start] * len(parts), f"time since {instant_text(start)}, s"


def instant_text(t_ns: int) -> str:
    """Return a stamp as a time of day in UTC, or as it is where its clock knows no calendar.

    Examples
    --------
    >>> instant_text(1_700_000_000_250_000_000)
    '2023-11-14 22:13:20.25 UTC'
    >>> instant_text(112_500_000_000)
    '112.5 s of its clock'
    """
    seconds, rest = divmod(abs(t_ns), 1_000_000_000)
    fraction = f".{rest:09d}".rstrip("0").rstrip(".")
    if t_ns < CALENDAR_NS:
        return f"{'-' if t_ns < 0 else ''}{seconds}{fraction} s of its clock"
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    return f"{moment:%Y-%m-%d %H:%M:%S}{fraction} UTC"
