"""Panels of a picture: colours, lines, gaps, tolerance, marks, range and ticks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from quatprop.base.text import plain
from quatprop.tools.plot.picture import MINUS, NORM_ERROR, TURN, lone_points

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from quatprop.tools.plot.picture import Curve, Mark, Panel, Picture


# Colours that can be distinguished with any colour vision.
#
# Reference: Okabe and Ito, "Color Universal Design: how to make figures and presentations that are
# friendly to colorblind people", 2008.


BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"

AXES = {"x": VERMILION, "y": GREEN, "z": BLUE, "w": PURPLE, "": BLACK}
"""Colours of axes; black for no axis."""

FILES = (BLUE, ORANGE, GREEN, PURPLE, SKY_BLUE, VERMILION, BLACK)
"""Colours of overlaid files, in their order."""

Stroke = Literal["solid", "dashed", "dotted", "dashdot"]

STROKES: tuple[Stroke, ...] = ("solid", "dashed", "dotted", "dashdot")
"""Line styles of files, in their order: a line below a dashed one stays visible."""

INK = "#222222"
"""Text and axes."""

GRID = "#DDDDDD"

SHADE = "#BBBBBB"
"""Gaps."""

ALARM = VERMILION
"""Tolerances, and errors above them."""


def colour_of(key: str | int) -> str:
    """Return the colour of an axis, or of a file by its number."""
    return AXES[key] if isinstance(key, str) else FILES[key % len(FILES)]


def stroke_of(key: str | int) -> Stroke:
    """Return the line style of an axis, or of a file by its number."""
    if isinstance(key, str):
        return STROKES[0]
    return STROKES[key % len(STROKES)]


# Draw one panel of a picture: lines, gaps, tolerance, marks, range and ticks.


THIN, THICKER, WIDEST = 0.8, 0.9, 3
"""Line width, points; the increment for each line below another; most increments."""

FLAT = 1e-9
"""Relative range below which a series counts as constant, so that rounding is not magnified."""

SMALLEST, LARGEST = 1e-2, 1e5
"""Tick labels outside this range have an exponent."""

WIDE_ANGLE = 150.0
"""deg: angles with a larger range are drawn on an axis of a full circle."""

LEVEL_SHARE = 100.0
"""An error this many times above or below its tolerance has a logarithmic axis."""


def draw_panel(axes: Axes, panel: Panel, picture: Picture, place: int) -> list[tuple[Artist, str]]:
    """Draw one panel: gaps behind, then lines, tolerance and marks."""
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
    for number, curve in enumerate(panel.curves):
        # Of coinciding lines, the lower ones are wider, so that they can be seen.
        wider = 0.5 if picture.is_log else min(len(panel.curves) - 1 - number, WIDEST)
        _draw_curve(axes, curve, THIN + THICKER * wider, f"curve_{place}_{number}")
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    unit = f"\n{panel.quantity.unit}" if panel.quantity.unit else ""
    axes.set_ylabel(panel.quantity.name.replace("norm error ", "norm error\n") + unit)
    if picture.is_log:
        axes.set(xscale="log", yscale="log")
        axes.xaxis.set_major_formatter(_tick_label)
        axes.yaxis.set_major_formatter(_tick_label)
    else:
        _set_value_axis(axes, panel)
    explained: list[tuple[Artist, str]] = []
    if panel.level is not None:
        value, label = panel.level
        level = axes.axhline(value, color=ALARM, linestyle="dashed", linewidth=1.0)
        explained.append((level, label))
    explained += [(_draw_mark(axes, mark), mark.label) for mark in panel.marks]
    return explained


def draw_together(axes: Axes, picture: Picture) -> None:
    """Draw the main quantities on one pair of axes, with a colour by axis and a stroke by file."""
    first, *others = picture.panels
    alike = [one for one in others if (one.quantity.is_error, one.quantity.shown_above) == _MAIN]
    for panel in (first, *alike):
        name, axis = panel.quantity.name, panel.quantity.axis
        for number, curve in enumerate(panel.curves):
            file = picture.legend[number] if picture.legend else ""
            file = file.partition(": ")[0].replace("$", r"\$")
            drawn = axes.plot(
                *curve.drawn,
                color=colour_of(axis or number),
                linestyle=stroke_of(number),
                label=f"{name} {file}".rstrip(),
            )
            if curve.band:
                seconds, low, high = curve.band
                axes.fill_between(
                    seconds, low, high, color=drawn[0].get_color(), alpha=0.2, linewidth=0
                )
    axes.set_xlabel(picture.time)
    axes.set_ylabel(first.quantity.unit)
    axes.legend()


_MAIN = False, None
"""`is_error` and `shown_above` of the main quantities: not an error about one axis."""


def _draw_curve(axes: Axes, curve: Curve, width: float, name: str) -> None:
    colour, points = colour_of(curve.colour), lone_points(curve.drawn)
    stroke = stroke_of(curve.colour)
    axes.plot(*curve.drawn, color=colour, linestyle=stroke, linewidth=width, gid=name)
    if curve.band:
        seconds, low, high = curve.band
        axes.fill_between(seconds, low, high, color=colour, alpha=0.2, linewidth=0, zorder=1)
    if len(points.seconds):
        axes.plot(*points, color=colour, linestyle="none", marker=".", markersize=5)


def _draw_mark(axes: Axes, mark: Mark) -> Artist:
    first = mark.sign == "first"
    (drawn,) = axes.plot(
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
    return drawn


def _set_value_axis(axes: Axes, panel: Panel) -> None:
    """Choose the range, the scale and the ticks of a panel."""
    parts = [curve.drawn.values for curve in panel.curves]
    parts += [edge for curve in panel.curves if curve.band for edge in curve.band[1:]]
    values = np.concatenate(parts)
    values = values[np.isfinite(values)]
    axes.margins(y=0.08)
    axes.ticklabel_format(axis="y", useOffset=False, style="plain")
    if not len(values):
        axes.set_yticks([])
        axes.text(0.5, 0.5, "no values", transform=axes.transAxes, ha="center", va="center")
        return
    low, high = float(values.min()), float(values.max())
    if panel.quantity == NORM_ERROR:
        low, high = min(low, 0.0), max(high, 0.0)
        axes.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low))
    if not SMALLEST <= max(-low, high) < LARGEST:
        axes.yaxis.set_major_formatter(_tick_label)
    if panel.level is not None or panel.marks:
        _set_error_scale(axes, panel, high)
    elif panel.quantity.wraps and max(-low, high) > WIDE_ANGLE:
        axes.set_ylim(-TURN / 2 - 10, TURN / 2 + 10)
        axes.set_yticks(np.linspace(-TURN / 2, TURN / 2, 5))
    else:
        size = max(-low, high)
        if high - low <= max(FLAT * size, panel.quantity.least):
            middle, half = (low + high) / 2, 0.05 * size
            if half <= panel.quantity.least:
                half = panel.quantity.scale
            axes.set_ylim(middle - half, middle + half)


def _tick_label(value: float, _position: float = 0) -> str:
    """Return a short tick label."""
    text = f"{value:g}"
    if value and not SMALLEST <= abs(value) < LARGEST:
        digits, exponent = f"{value:.2e}".split("e")
        text = f"{float(digits):g}e{int(exponent)}"
    return text.replace("-", MINUS, 1) if value < 0 else text


def _set_error_scale(axes: Axes, panel: Panel, high: float) -> None:
    """Show an error from zero, or on a logarithmic axis if it is far from its tolerance."""
    level = panel.level[0] if panel.level else high
    top = max(high, level)
    if level > 0 and high > 0 and not 1 / LEVEL_SHARE <= high / level <= LEVEL_SHARE:
        axes.set_ylim(min(high, level) / LEVEL_SHARE, 5 * top)
        axes.set_yscale("log", nonpositive="mask")
        axes.yaxis.set_major_formatter(_tick_label)
    else:
        axes.set_ylim(0, 1.18 * top if top > 0 else 1.0)


def shortened(text: str, longest: int) -> str:
    """Return a text, without its middle if it is too long."""
    text = plain(text)
    if len(text) <= longest:
        return text
    half = (longest - 1) // 2
    begin, end = text[: longest - 1 - half], text[-half:]
    # Words are not broken, unless one of them is most of the text.
    if not text[len(begin)].isspace() and " " in begin[half // 2 :]:
        begin = begin[: begin.rindex(" ")]
    if not text[-half - 1].isspace() and " " in end[: half // 2]:
        end = end[end.index(" ") + 1 :]
    between = " " if " " in text else ""
    return f"{begin.rstrip()}{between}\N{HORIZONTAL ELLIPSIS}{between}{end.lstrip()}"
