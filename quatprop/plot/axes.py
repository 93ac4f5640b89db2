"""One row of a picture onto a pair of axes: lines, gaps, tolerance, marks; its range and ticks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.plot.accumulators import MINUS, NORM_ERROR
from quatprop.plot.lines import TURN, lone_points
from quatprop.plot.palette import ALARM, PAPER, SHADE, colour_of, stroke_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from quatprop.plot.picture import Curve, Mark, Picture, Row

THIN, THICKER, WIDEST = 0.8, 0.6, 3
"""Points: a line, and what each line below another has more, so many times at most."""

LATE, LATE_FIRST = 0.5, 0.65
"""Share of the time after which words stand to the left of a mark."""

FLAT = 1e-9
"""Share of its size below which a series counts as constant: its rounding is not drawn large."""

SMALLEST, LARGEST = 1e-2, 1e5
"""Values between are written out on an axis, others with an exponent each."""

WIDE_ANGLE = 150.0
"""deg: angles that reach further have the full circle as their axis."""

LEVEL_SHARE = 100.0
"""An error this many times above or below its tolerance has a logarithmic axis."""

_GROUND: dict[str, Any] = {"facecolor": PAPER, "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
"""Under words that lie over lines."""


def draw_row(axes: Axes, row: Row, picture: Picture) -> None:
    """Draw one row: gaps behind, then lines, tolerance and marks."""
    several = len(picture.gaps) > 1
    for file, spans in enumerate(picture.gaps):
        if len(spans):
            axes.broken_barh(
                [(start, stop - start) for start, stop in spans.tolist()],
                (0, 1),
                transform=axes.get_xaxis_transform(),
                color=colour_of(file) if several else SHADE,
                alpha=0.25 if several else 0.6,
                linewidth=0.4,
                zorder=0.5,
            )
    for number, curve in enumerate(row.curves):
        # Of lines that coincide, those below show on both sides.
        wider = min(len(row.curves) - 1 - number, WIDEST)
        _draw_curve(axes, curve, THIN + THICKER * wider)
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    unit = f"\n{row.quantity.unit}" if row.quantity.unit else ""
    axes.set_ylabel(row.quantity.name.replace(" error ", " error\n") + unit)
    _set_values(axes, row)
    if row.level is not None:
        _draw_level(axes, *row.level)
    for mark in row.marks:
        _draw_mark(axes, mark)


def _draw_curve(axes: Axes, curve: Curve, width: float) -> None:
    colour, points = colour_of(curve.colour), lone_points(curve.drawn)
    stroke = stroke_of(curve.colour)
    axes.plot(*curve.drawn, color=colour, linestyle=stroke, linewidth=width)
    if len(points.seconds):
        axes.plot(*points, color=colour, linestyle="none", marker=".", markersize=5)


def _draw_level(axes: Axes, value: float, words: str) -> None:
    axes.axhline(value, color=ALARM, linestyle="dashed", linewidth=1.0)
    axes.annotate(
        words,
        (0.995, value),
        xycoords=axes.get_yaxis_transform(),
        xytext=(0, 2),
        textcoords="offset points",
        horizontalalignment="right",
        color=ALARM,
        bbox=_GROUND,
    )


def _draw_mark(axes: Axes, mark: Mark) -> None:
    """Point at a place; the words go where the line hardly is.

    Nothing is above the worst; after the first above the tolerance, the line is above it.
    """
    first = mark.sign == "first"
    axes.plot(
        [mark.seconds],
        [mark.value],
        linestyle="none",
        marker="o" if first else "v",
        markersize=6,
        markerfacecolor="none" if first else ALARM,
        markeredgecolor=ALARM,
        markeredgewidth=1.2,
        zorder=4,
        clip_on=False,
    )
    start, end = axes.dataLim.intervalx
    left = mark.seconds > start + (LATE_FIRST if first else LATE) * (end - start)
    axes.annotate(
        mark.words,
        (mark.seconds, mark.value),
        xytext=(-7 if left else 7, -13 if first and not left else 5),
        textcoords="offset points",
        horizontalalignment="right" if left else "left",
        bbox=_GROUND,
        zorder=5,
    )


def _set_values(axes: Axes, row: Row) -> None:
    """Choose the range, the scale and the ticks of a row."""
    values = np.concatenate([curve.drawn.values for curve in row.curves])
    values = values[np.isfinite(values)]
    axes.margins(y=0.08)
    axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    if not len(values):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no values", transform=axes.transAxes, ha="center", va="center")
        return
    low, high = float(values.min()), float(values.max())
    if row.quantity is NORM_ERROR:
        low, high = min(low, 0.0), max(high, 0.0)
        if high > low:
            axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    if not SMALLEST <= max(-low, high) < LARGEST:
        axes.yaxis.set_major_formatter(_short)
    if row.level is not None or row.marks:
        _set_error_scale(axes, row, high)
    elif row.quantity.turns and max(-low, high) > WIDE_ANGLE:
        axes.set_ylim(-TURN / 2 - 10, TURN / 2 + 10)
        axes.set_yticks(np.linspace(-TURN / 2, TURN / 2, 5))
    else:
        size = max(-low, high)
        if high - low <= max(FLAT * size, row.quantity.least):
            middle, half = (low + high) / 2, 0.05 * size
            if half <= row.quantity.least:
                half = row.quantity.scale
            axes.set_ylim(middle - half, middle + half)


def _short(value: float, _position: float = 0) -> str:
    """Return a tick in as few letters as it takes.

    Examples
    --------
    >>> _short(0.000125), _short(20.0), _short(0.0)
    ('1.25e-4', '20', '0')
    """
    text = f"{value:g}"
    if value and not SMALLEST <= abs(value) < LARGEST:
        digits, exponent = f"{value:.2e}".split("e")
        text = f"{float(digits):g}e{int(exponent)}"
    return text.replace("-", MINUS, 1) if value < 0 else text


def _set_error_scale(axes: Axes, row: Row, high: float) -> None:
    """Show an error from zero; where it is far from its tolerance, on a logarithmic axis."""
    level = row.level[0] if row.level else high
    top = max(high, level)
    if level > 0 and high > 0 and not 1 / LEVEL_SHARE <= high / level <= LEVEL_SHARE:
        axes.set_yscale("log", nonpositive="mask")
        axes.yaxis.set_major_formatter(_short)
        axes.set_ylim(min(high, level) / LEVEL_SHARE, 5 * top)
    else:
        axes.set_ylim(0, 1.18 * top if top > 0 else 1.0)
