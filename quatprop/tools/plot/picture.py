"""The content of a picture and its page, independent of drawing: panels over one time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.plotting.lines import TURN, Line, folded, gaps_in, line
from quatprop.rendering import instant_text
from quatprop.text import Setting, plain
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.arrays import Float64
    from quatprop.plotting.accumulators import Group, Quantity
    from quatprop.plotting.reduction import Reduced
    from quatprop.rendering import Row


class Curve(NamedTuple):
    """A line of a panel.

    `drawn`: its points, seconds and values
    `colour`: a key of :data:`quatprop.plotting.palette.AXES`, or the number of the file
    `band`: the area of one standard deviation: seconds, lower and upper edge, shape ``(P,)`` each,
        NaN where it breaks; None if it is unknown
    """

    drawn: Line
    colour: str | int
    band: tuple[Float64, ...] | None


class Mark(NamedTuple):
    """A point with a label.

    `sign`: ``"first"`` or ``"worst"``
    """

    seconds: float
    value: float
    label: str
    sign: str


class Panel(NamedTuple):
    """One pair of axes.

    `level`: a horizontal line and its label, such as a tolerance
    """

    quantity: Quantity
    curves: tuple[Curve, ...]
    level: tuple[float, str] | None = None
    marks: tuple[Mark, ...] = ()


class PlottedFile(NamedTuple):
    """The data of one file in a picture.

    `groups`: its quantities; the gaps are those of the first group
    `detail`: further text in the legend
    """

    label: str
    groups: tuple[Group, ...]
    detail: str = ""

    @property
    def name(self) -> str:
        """Its name in a legend and in a title."""
        return f"{self.label}: {self.detail}" if self.detail else self.label

    @property
    def traces(self) -> dict[Quantity, tuple[Group, int]]:
        """The group of each quantity, and its place in the group."""
        return {
            quantity: (group, place)
            for group in self.groups
            for place, quantity in enumerate(group.quantities)
        }

    @property
    def span_ns(self) -> tuple[int, int]:
        """Its first and last timestamp, ns."""
        return (
            min(int(group.reduced.first_ns.min()) for group in self.groups),
            max(int(group.reduced.last_ns.max()) for group in self.groups),
        )


class Picture(NamedTuple):
    """The content of a picture.

    `gaps`: for each file: first and last second of each gap, shape ``(G, 2)``
    `starts`: for each file: the timestamp from which its seconds count, ns
    `bin_s`: the usual width of the bins that were reduced to their extremes, s; 0 if samples were
        not reduced
    `legend`: names of the files if there are several
    `is_log`: whether its axes are logarithmic
    """

    time: str
    panels: tuple[Panel, ...]
    gaps: tuple[Float64, ...]
    starts: tuple[int, ...]
    bin_s: float
    legend: tuple[str, ...] = ()
    is_log: bool = False


class Page(NamedTuple):
    """A picture, and the text around it.

    `facts`: lines below the title of a picture: convention, method, counts
    `lead`: the lines below the title of a page: the result
    `warnings`: warnings for the reader
    `tables`: details: headings, and rows of labels and texts
    """

    title: str
    facts: tuple[str, ...]
    lead: tuple[str, ...]
    picture: Picture
    warnings: tuple[str, ...]
    tables: Sequence[tuple[str, Iterable[Row]]]


def picture(files: Sequence[PlottedFile]) -> Picture:
    """Return the picture of overlaid files."""
    first, several = files[0], len(files) > 1
    for file in files[1:]:
        if not file.traces.keys() <= first.traces.keys():
            raise UsageError(
                f"{plain(first.label)} shows {_content(first)} and {plain(file.label)} "
                f"{_content(file)}; draw them apart, or choose with "
                f"{Setting('show')}"
            )
    starts, time = _time_axis(files)
    panels = []
    for quantity in first.traces:
        curves = tuple(
            _curve(file, quantity, number if several else quantity.axis, starts[number])
            for number, file in enumerate(files)
            if quantity in file.traces
        )
        limit = quantity.shown_above
        if limit is None or any((np.abs(curve.drawn.values) > limit).any() for curve in curves):
            panels.append(Panel(quantity, curves))
    gaps = [gaps_in(file.groups[0].reduced, file.groups[0].gap_limit_ns) for file in files]
    reduced = [group.reduced for file in files for group in file.groups]
    return Picture(
        time=time,
        panels=tuple(panels),
        gaps=tuple((one - start) / NS_PER_S for one, start in zip(gaps, starts, strict=True)),
        starts=tuple(starts),
        bin_s=1e-9 * max(map(_bin_ns, reduced)),
        legend=tuple(file.name for file in files) if several else (),
    )


def _bin_ns(reduced: Reduced) -> float:
    """Return the usual width of a bin, ns; 0 if bins have only one or two samples."""
    width = float(np.median(reduced.last_ns - reduced.first_ns))
    between = np.median(reduced.first_ns[1:] - reduced.last_ns[:-1]) if len(reduced) > 1 else 0.0
    return width if width > 1.5 * between else 0.0


def _curve(file: PlottedFile, quantity: Quantity, colour: str | int, start_ns: int) -> Curve:
    group, place = file.traces[quantity]
    drawn = line(group.reduced, place, start_ns, group.gap_limit_ns)
    band = _band(group, place, start_ns)
    return Curve(folded(drawn) if quantity.wraps else drawn, colour, band)


def _band(group: Group, place: int, start_ns: int) -> tuple[Float64, ...] | None:
    """Return the area within a standard deviation of a trace, or of zero for an error."""
    quantity, reduced = group.quantities[place], group.reduced
    sigmas = reduced.high[len(group.quantities) :]
    if not np.isfinite(sigmas[place : place + 1]).any():
        return None
    sigma = sigmas[place]
    low, high = np.zeros(len(sigma)), np.zeros(len(sigma))
    if not quantity.is_error:
        low, high = reduced.low[place], reduced.high[place]
    turns = TURN * np.rint((low + high) / 2 / TURN) if quantity.wraps else np.zeros(len(sigma))
    (after,) = np.nonzero((np.diff(turns) != 0) | reduced.gaps(group.gap_limit_ns))
    seconds = ((reduced.first_ns - start_ns) * 1e-9 + (reduced.last_ns - start_ns) * 1e-9) / 2
    edges = (seconds, low - sigma - turns, high + sigma - turns)
    return tuple(np.insert(edge, after + 1, np.nan) for edge in edges)


def _content(file: PlottedFile) -> str:
    units = [quantity.unit for quantity in file.traces if quantity.unit]
    name = next(iter(file.traces)).name
    return f"{name} in {units[0]}" if units else name


def _time_axis(files: Sequence[PlottedFile]) -> tuple[list[int], str]:
    """Return the timestamp from which the seconds of each file count, and the axis label."""
    firsts, lasts = zip(*(file.span_ns for file in files), strict=True)
    if max(firsts) > min(lasts):
        return list(firsts), "time since the start of each file, s"
    start = min(firsts)
    return [start] * len(files), f"time since {instant_text(start)}, s"
