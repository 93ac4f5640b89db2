"""The content of a picture and its page, independent of drawing: panels over one time axis."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.rendering import instant_text, source_text
from quatprop.base.text import Setting, plain
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.conventions import Signs, euler_angles
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.settings.quantities import RATES
from quatprop.stores.kinds import READERS
from quatprop.tools.plot.reduction import Reduced, Reduction

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.base.rendering import Row
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries


# Lines from reduced series: seconds, values, and breaks.
#
# A NaN breaks a line at gaps in time and where an angle wraps: the line leaves the picture at one
# edge and enters at the other, without a line across.


TURN = 360.0
"""deg."""


class Line(NamedTuple):
    """A line to draw.

    `seconds`, `values`: its points, shape ``(P,)``; NaN in both where it breaks
    """

    seconds: Float64
    values: Float64


class Unwrap:
    """Unwraps angles, which then do not jump from one end of their range to the other.

    Whole turns are added so that every angle is within half a turn of the one before it. The turns
    are counted as integers, so no rounding errors accumulate.
    """

    def __init__(self, traces: int) -> None:
        self._turns = np.zeros((traces, 1), dtype=np.int64)
        self._last: Float64 | None = None

    def applied(self, degrees: Float64) -> Float64:
        """Return the next angles, shape ``(traces, N)``, deg."""
        if not degrees.shape[1]:
            return degrees
        before = degrees[:, :1] if self._last is None else self._last
        steps = np.diff(degrees, axis=1, prepend=before)
        turns = self._turns - np.cumsum(np.rint(steps / TURN).astype(np.int64), axis=1)
        self._turns, self._last = turns[:, -1:].copy(), degrees[:, -1:].copy()
        continued: Float64 = degrees + TURN * turns
        return continued


def gaps_in(reduced: Reduced, limit_ns: int | None) -> Int64:
    """Return the gaps between bins as first and last stamps, shape ``(G, 2)``, int64 ns.

    `limit_ns`: intervals longer than this are gaps, ns; None: there are no gaps
    """
    gaps = reduced.gaps(limit_ns)
    return np.stack([reduced.last_ns[:-1][gaps], reduced.first_ns[1:][gaps]], axis=1)


def line(reduced: Reduced, trace: int, start_ns: int, limit_ns: int | None = None) -> Line:
    """Return one trace as a line.

    `start_ns`: the stamp at which the seconds begin, ns
    `limit_ns`: intervals longer than this are gaps, ns
    """
    # Subtract as integers: timestamps are too large for exact floats.
    begin, end = (reduced.first_ns - start_ns) * 1e-9, (reduced.last_ns - start_ns) * 1e-9
    middle, breaks = (begin + end) / 2, np.full(len(reduced), np.nan)
    first, last = reduced.first[trace], reduced.last[trace]
    low, high = reduced.low[trace], reduced.high[trace]
    # Drawing an extreme that is the first or last value again would make a slope a step.
    drawn = [
        np.ones(len(reduced), dtype=np.bool_),
        ~(low >= np.fmin(first, last)) & ~np.isnan(low),
        ~(high <= np.fmax(first, last)) & ~np.isnan(high),
        ~((begin == end) & (first == last)),
        np.append(reduced.gaps(limit_ns), False),
    ]
    chosen = np.stack(drawn, axis=1)
    return Line(
        np.stack([begin, middle, middle, end, breaks], axis=1)[chosen],
        np.stack([first, low, high, last, breaks], axis=1)[chosen],
    )


def folded(continuous: Line) -> Line:
    """Return a line of angles, deg, wrapped to half a turn about zero and broken there."""
    seconds, values = continuous
    turns = np.floor((values + TURN / 2) / TURN)
    inside = values - TURN * turns
    crossed = np.nan_to_num(np.diff(turns))
    (before,) = np.nonzero(crossed)
    if not len(before):
        return Line(seconds, inside)
    up = np.sign(crossed[before])
    after = before + 1
    leaving = TURN * turns[before] + up * TURN / 2
    entering = TURN * turns[after] - up * TURN / 2
    slope = (seconds[after] - seconds[before]) / (values[after] - values[before])
    left = seconds[before] + (leaving - values[before]) * slope
    entered = seconds[before] + (entering - values[before]) * slope
    edge, breaks = up * TURN / 2, np.full(len(before), np.nan)
    # A step of more than one turn crosses the whole range.
    whole = np.abs(crossed[before]) > 1
    both = np.ones(len(before), dtype=np.bool_)
    inserted = np.stack([both, both, whole, whole, whole, both], axis=1)
    cut_seconds = np.stack([left, breaks, left, entered, breaks, entered], axis=1)[inserted]
    cut_values = np.stack([edge, breaks, -edge, edge, breaks, -edge], axis=1)[inserted]
    places = np.repeat(after, inserted.sum(axis=1))
    return Line(np.insert(seconds, places, cut_seconds), np.insert(inside, places, cut_values))


def lone_points(drawn: Line) -> Line:
    """Return the points of a line without neighbours, which the line does not show."""
    finite = np.isfinite(drawn.values)
    padded = np.concatenate([[False], finite, [False]])
    lone = finite & ~padded[:-2] & ~padded[2:]
    return Line(drawn.seconds[lone], drawn.values[lone])


class Curve(NamedTuple):
    """A line of a panel.

    `drawn`: its points, seconds and values
    `colour`: a key of :data:`quatprop.tools.plot.panels.AXES`, or the number of the file
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


def topic_text(kind: str, name: str, type_name: str) -> str:
    """Return a topic and its type, for titles; empty for a table, which has columns instead."""
    reader = READERS.get(kind)
    return source_text(name, type_name) if reader and ".containers." in reader.load else ""


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


class Matrix(NamedTuple):
    """How much things differ from one another, as a matrix above the panels.

    `names`: of its rows, and by their numbers of its columns
    `shares`: differences, shape ``(N, N)``; NaN: not compared
    `alarming`: which names are those of something wrong
    """

    names: tuple[str, ...]
    shares: Float64
    alarming: tuple[bool, ...]


class Picture(NamedTuple):
    """The content of a picture.

    `gaps`: for each file: first and last second of each gap, shape ``(G, 2)``
    `starts`: for each file: the timestamp from which its seconds count, ns
    `bin_s`: the usual width of the bins that were reduced to their extremes, s; 0 if samples were
        not reduced
    `legend`: names of the files if there are several
    `is_log`: whether its axes are logarithmic
    `matrix`: the matrix above the panels, if any
    """

    time: str
    panels: tuple[Panel, ...]
    gaps: tuple[Float64, ...]
    starts: tuple[int, ...]
    bin_s: float
    legend: tuple[str, ...] = ()
    is_log: bool = False
    matrix: Matrix | None = None


class Page(NamedTuple):
    """A picture, and the text around it.

    `facts`: lines below the title of a picture: convention, method, counts
    `lead`: the lines below the title of a page: the result
    `warnings`: warnings for the reader
    `tables`: details: headings, and rows of labels and texts
    `back`: address of the page that lists this one; empty for none
    """

    title: str
    facts: tuple[str, ...]
    lead: tuple[str, ...]
    picture: Picture
    warnings: tuple[str, ...]
    tables: Sequence[tuple[str, Iterable[Row]]]
    back: str = ""


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


# Accumulate the rates, attitudes and errors of a picture while they are read.


ZERO = 1e-6
"""Norms below this are zero: no rotation can be computed from them."""

SMALL = 1e-6
"""Rotation for numerical derivatives, rad; its effect is linear."""


class Quantity(NamedTuple):
    """A quantity that a panel of a picture shows over time.

    `name`, `unit`: label of its axis; no unit is ``""``
    `axis`: its colour in a picture of one file: ``"x"``, ``"y"``, ``"z"``, ``"w"``, or ``""``
    `wraps`: whether it is an angle, in deg, that wraps at half a turn
    `least`: a series that varies by less is drawn as a constant
    `scale`: range of its axis in either direction if the series is zero
    `is_error`: whether it should be zero: its standard deviation is drawn about zero
    `shown_above`: it has a panel only if it exceeds this value; None for always
    """

    name: str
    unit: str
    axis: str = ""
    wraps: bool = False
    least: float = 0.0
    scale: float = 1.0
    is_error: bool = False
    height: float = 1.0
    shown_above: float | None = None


ROUNDING_DEG = 1e-6

MINUS = "\N{MINUS SIGN}"

NORM_DIGITS = 1e-6
"""Norm errors up to this are due to rounding in text files."""

NORM_ERROR = Quantity(f"norm error |q| {MINUS} 1", "", shown_above=NORM_DIGITS)

SIGMA_BAND = "1 sigma shaded"

EXPECTED = Quantity("1 sigma error", "deg", shown_above=0.0)
"""The angle of an error of one standard deviation about all three axes."""

ANGLES = (
    Quantity("yaw", "deg", "z", wraps=True, least=ROUNDING_DEG),
    Quantity("pitch", "deg", "y", least=ROUNDING_DEG),
    Quantity("roll", "deg", "x", wraps=True, least=ROUNDING_DEG),
    EXPECTED,
    NORM_ERROR,
)
"""An attitude as q = q_z(yaw) q_y(pitch) q_x(roll)."""

COMPONENTS = (*(Quantity(f"q{axis}", "", axis) for axis in "wxyz"), EXPECTED, NORM_ERROR)
"""An attitude as its quaternion."""

ERROR = (
    Quantity("geodesic error", "deg", height=2.0),
    *(Quantity(f"error {axis}", "deg", axis, least=1e-12, is_error=True) for axis in "xyz"),
)
"""The angle of an error, and its rotation vector about the body axes."""


class Group(NamedTuple):
    """Quantities with the same timestamps.

    `reduced`: their reduced samples, then their standard deviations, if known
    `gap_limit_ns`: intervals longer than this are gaps, ns; None for no gaps
    """

    quantities: tuple[Quantity, ...]
    reduced: Reduced
    gap_limit_ns: int | None = None


class Accumulator:
    """Quantities of a picture, reduced while samples are read.

    `has_sigmas`: whether there are standard deviations
    """

    def __init__(self, quantities: tuple[Quantity, ...], *, has_sigmas: bool = False) -> None:
        self.quantities = quantities
        self.has_sigmas = has_sigmas
        self._reduction = Reduction(len(quantities) * (2 if has_sigmas else 1))

    def add(self, t_ns: Int64, values: Float64, sigmas: Float64 | None = None) -> None:
        """Add samples: stamps ``(N,)``, ns; values, and sigmas if any, ``(quantities, N)``."""
        self._reduction.add(t_ns, values if sigmas is None else np.concatenate([values, sigmas]))

    def group(self, gap_limit_ns: int | None) -> Group:
        """Return the reduced quantities; longer intervals than this are gaps, ns."""
        return Group(self.quantities, self._reduction.result(), gap_limit_ns)


class RateAccumulator(Accumulator):
    """Angular rates."""

    def __init__(self, unit: str) -> None:
        super().__init__(tuple(Quantity(f"rate {axis}", unit, axis) for axis in "xyz"))
        self._scale = 1.0 / RATES[unit]

    def passing(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Accumulate batches, and yield them unchanged."""
        for batch in batches:
            with np.errstate(over="ignore", invalid="ignore"):  # numbers of a damaged log
                drawn = batch.rate.T * self._scale
            self.add(batch.t_ns, drawn)
            yield batch


class AttitudeAccumulator(Accumulator):
    """Attitudes, as angles or as components, and their norm error.

    `components`: draw the components of the quaternion, with a continuous sign, instead of yaw,
        pitch and roll
    `unwrap`: draw yaw and roll beyond half a turn, without wrapping
    `invalid`: number of invalid quaternions: zero, or not finite
    `knows_sigmas`: whether any standard deviation was above zero
    `norm_error`: largest deviation from unit length
    """

    def __init__(
        self, *, components: bool = False, unwrap: bool = False, has_sigmas: bool = False
    ) -> None:
        angles = tuple(angle._replace(wraps=angle.wraps and not unwrap) for angle in ANGLES)
        super().__init__(COMPONENTS if components else angles, has_sigmas=has_sigmas)
        self._signs = Signs("continuous") if components else None
        self._unwrap = Unwrap(2)
        self.invalid, self.knows_sigmas = 0, False
        self.norm_error = 0.0

    def _add_attitudes(self, t_ns: Int64, wxyz: Float64, covariance: Float64 | None) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.sqrt(np.einsum("ij,ij->i", wxyz, wxyz))
        good = np.isfinite(length) & (length > ZERO)
        self.invalid += len(good) - int(np.count_nonzero(good))
        self.norm_error = max(
            self.norm_error, float(np.max(np.abs(length - 1), initial=0.0, where=good))
        )
        values = np.full((len(self.quantities), len(t_ns)), np.nan)
        values[-1] = np.where(good, length - 1, np.nan)
        sigmas = np.full(values.shape, np.nan) if self.has_sigmas else None
        if sigmas is not None and covariance is not None:
            sigmas[:-2, good] = self._sigmas(wxyz[good], covariance[good])
            values[-2] = np.degrees(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))
            self.knows_sigmas |= bool((values[-2] > 0).any())
        if self._signs is not None:
            drawn = self._signs.applied(wxyz[good]).T
        else:
            drawn = self._drawn(wxyz[good])
            drawn[[0, 2]] = self._unwrap.applied(drawn[[0, 2]])
        values[:-2, good] = drawn
        self.add(t_ns, values, sigmas)

    def _drawn(self, wxyz: Float64) -> Float64:
        """Return components, or angles in deg, without continuity, shape ``(values, N)``."""
        if self._signs is not None:
            return wxyz.T
        return np.degrees(euler_angles("zyx", wxyz)).T

    def _sigmas(self, wxyz: Float64, covariance: Float64) -> Float64:
        """Return standard deviations of these values, to first order, shape ``(values, N)``."""
        drawn, change = self._drawn(wxyz), []
        for axis in np.eye(3):
            steps = self._drawn(multiply(wxyz, exp(SMALL * axis))) - drawn
            change.append((steps - TURN * np.rint(steps / TURN)) / SMALL)
        with np.errstate(invalid="ignore"):
            variance = np.einsum("ivn,nij,jvn->vn", change, covariance, change)
            return np.asarray(np.sqrt(np.minimum(variance, (TURN / 2) ** 2)))

    def passing(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Accumulate attitudes of any norm, and yield them unchanged."""
        for batch in batches:
            self._add_attitudes(batch.t_ns, batch.wxyz, batch.covariance)
            yield batch
