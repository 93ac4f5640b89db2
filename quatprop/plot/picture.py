"""What a picture shows, before anything is drawn: panels over one time axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.errors import UsageError
from quatprop.plot.accumulators import NORM_ERROR
from quatprop.plot.lines import folded, gaps_in, line
from quatprop.rendering import instant_text
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from quatprop.plot.accumulators import Quantity
    from quatprop.plot.lines import Line
    from quatprop.plot.reduction import Reduced

    Float64 = NDArray[np.float64]


NORM_DIGITS = 1e-6
"""Norm errors below this are those of printed digits, and have no panel."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A line of a panel.

    Parameters
    ----------
    drawn
        Its points, seconds and values.
    colour
        A key of :data:`quatprop.plot.palette.AXES`, or the number of the file.
    band
        Whether the area below it is filled.
    """

    drawn: Line
    colour: str | int
    band: bool = False


@dataclass(frozen=True, slots=True)
class Mark:
    """A point with a label.

    Parameters
    ----------
    seconds, value
        Where it is.
    label
        Its text.
    sign
        ``"first"`` or ``"worst"``.
    """

    seconds: float
    value: float
    label: str
    sign: str


@dataclass(frozen=True, slots=True)
class Panel:
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
        Marked points.
    """

    quantity: Quantity
    curves: tuple[Curve, ...]
    level: tuple[float, str] | None = None
    marks: tuple[Mark, ...] = ()


class Group(NamedTuple):
    """Quantities that share their stamps.

    Parameters
    ----------
    quantities
        What is drawn, one panel each.
    reduced
        Their reduced samples.
    gap_limit_ns
        Intervals longer than this are gaps, ns; None: there are none.
    """

    quantities: tuple[Quantity, ...]
    reduced: Reduced
    gap_limit_ns: int | None = None


@dataclass(frozen=True, slots=True)
class PlottedFile:
    """What is drawn of one file.

    Parameters
    ----------
    label
        Name of the file.
    groups
        What is drawn of it; the gaps are those of the first.
    detail
        What else stands in the legend.
    band
        Whether the areas below its lines are filled.
    """

    label: str
    groups: tuple[Group, ...]
    detail: str = ""
    band: bool = False

    @property
    def name(self) -> str:
        """Its name in a legend and in a title."""
        return f"{self.label}: {self.detail}" if self.detail else self.label

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is drawn of it."""
        return tuple(quantity for group in self.groups for quantity in group.quantities)

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
        Label of the time axis.
    panels
        From top to bottom.
    gaps
        For each file: first and last second of each gap, shape ``(G, 2)``.
    starts
        For each file: the stamp at which its seconds begin, ns.
    legend
        Names of the files where they are several.
    notes
        Warnings below it.
    """

    title: str
    facts: tuple[str, ...]
    time: str
    panels: tuple[Panel, ...]
    gaps: tuple[Float64, ...]
    starts: tuple[int, ...]
    legend: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def picture(
    files: Sequence[PlottedFile],
    title: str,
    facts: tuple[str, ...] = (),
    notes: tuple[str, ...] = (),
) -> Picture:
    """Return files drawn over one another.

    Parameters
    ----------
    files
        At least one; all with the same quantities.
    title, facts, notes
        Those of the :class:`Picture`.

    Raises
    ------
    UsageError
        The files have different quantities.
    """
    first = files[0]
    for file in files[1:]:
        if file.quantities != first.quantities:
            raise UsageError(
                f"{plain(first.label)} shows {_content(first)} and {plain(file.label)} "
                f"{_content(file)}; draw them apart, or choose with ",
                Setting("show"),
            )
    starts, time = _time_axis(files)
    several = len(files) > 1
    panels = []
    for group, index in _places(first):
        quantity = first.groups[group].quantities[index]
        curves = tuple(
            Curve(
                _line(file.groups[group], index, start),
                number if several else quantity.axis,
                file.band,
            )
            for number, (file, start) in enumerate(zip(files, starts, strict=True))
        )
        if quantity is not NORM_ERROR or _is_off(curves):
            panels.append(Panel(quantity, curves))
    return Picture(
        title=title,
        facts=facts,
        time=time,
        panels=tuple(panels),
        gaps=tuple(_gaps(file, start) for file, start in zip(files, starts, strict=True)),
        starts=tuple(starts),
        legend=tuple(file.name for file in files) if several else (),
        notes=notes,
    )


def _is_off(curves: tuple[Curve, ...]) -> bool:
    """Whether a norm is off by more than the digits of a text file explain."""
    return any(bool((np.abs(curve.drawn.values) > NORM_DIGITS).any()) for curve in curves)


def _places(file: PlottedFile) -> list[tuple[int, int]]:
    """Return the group of each quantity, and its index in the group."""
    return [
        (number, index)
        for number, group in enumerate(file.groups)
        for index in range(len(group.quantities))
    ]


def _content(file: PlottedFile) -> str:
    units = [quantity.unit for quantity in file.quantities if quantity.unit]
    name = file.quantities[0].name
    return f"{name} in {units[0]}" if units else name


def _line(group: Group, index: int, start_ns: int) -> Line:
    drawn = line(group.reduced, index, start_ns, group.gap_limit_ns)
    return folded(drawn) if group.quantities[index].wraps else drawn


def _gaps(file: PlottedFile, start_ns: int) -> Float64:
    _, reduced, gap_limit_ns = file.groups[0]
    return np.asarray((gaps_in(reduced, gap_limit_ns) - start_ns) * 1e-9)


def _time_axis(files: Sequence[PlottedFile]) -> tuple[list[int], str]:
    """Return the stamp at which the seconds of each file begin, and the label of the axis."""
    if max(file.first_ns for file in files) > min(file.last_ns for file in files):
        return [file.first_ns for file in files], "time since the start of each file, s"
    start = min(file.first_ns for file in files)
    return [start] * len(files), f"time since {instant_text(start)}, s"
