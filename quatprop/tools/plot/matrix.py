"""A matrix of differences above the panels of a picture."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.tools.plot.panels import ALARM, GRID, INK, shortened

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from quatprop.tools.plot.picture import Matrix

ROW, HEADER, BELOW = 0.24, 0.25, 0.15
"""Inches: a row, the numbers above them, and the distance to the panels below."""

COLUMN, NARROW = 0.75, 0.36
"""Inches: the widest column, and the narrowest one in which there is a number."""

LEFT, RIGHT, MOST = 0.99, 0.1875, 3.2
"""Inches: least room for names, right of all, and most room for names."""

SMALL: Final = 7.0
"""Size of the letters, points."""

FAINT, FULL = 0.01, 1.0
"""Differences that are drawn white, and in full colour."""


def height_of(matrix: Matrix) -> float:
    """Return the height of a matrix with letters of the usual size, inches."""
    return HEADER + ROW * len(matrix.names) + BELOW


def draw_matrix(result: Figure, matrix: Matrix, begin: float, scale: float) -> None:
    """Draw a matrix of differences.

    `begin`: distance from the top, inches
    `scale`: size of the letters, as a multiple of the usual one
    """
    from matplotlib.colors import LinearSegmentedColormap, LogNorm

    width, height = result.get_size_inches()
    count, size = len(matrix.names), SMALL * scale
    rows = ROW * count * scale / height
    bottom = 1 - (begin + HEADER * scale) / height - rows
    axes = result.add_axes((0.5, bottom, 0.5, rows))
    colours = LinearSegmentedColormap.from_list("", ["white", ALARM]).with_extremes(bad=GRID)
    axes.pcolormesh(
        np.ma.masked_invalid(matrix.shares),
        cmap=colours,
        norm=LogNorm(FAINT, FULL),
        edgecolors=GRID,
        linewidth=0.8,
    )
    axes.invert_yaxis()
    axes.xaxis.tick_top()
    axes.tick_params(length=0, labelsize=size)
    axes.spines[:].set_visible(False)
    places = np.arange(count) + 0.5
    axes.set_xticks(places, [f"{number}" for number in range(1, count + 1)])
    axes.set_yticks(places, _numbered(matrix, 80))
    for label, is_alarming in zip(axes.get_yticklabels(), matrix.alarming, strict=True):
        label.set_color(ALARM if is_alarming else INK)
    left = LEFT * scale
    for longest in range(80, 10, -4):
        axes.set_yticklabels(_numbered(matrix, longest))
        begins = [label.get_window_extent().x0 for label in axes.get_yticklabels()]
        left = (axes.bbox.x0 - min(begins)) / result.dpi + 0.1 * scale
        if left <= MOST * scale:
            break
    left = max(left, LEFT * scale)
    column = min(COLUMN * scale, (width - left - RIGHT * scale) / count)
    axes.set_position((left / width, bottom, column * count / width, rows))
    if column >= NARROW * scale:
        for (row, place), share in np.ndenumerate(matrix.shares):
            if math.isfinite(share):
                text = _percent(100 * share)
                axes.text(place + 0.5, row + 0.5, text, size=size, ha="center", va="center")


def _numbered(matrix: Matrix, longest: int) -> list[str]:
    return [f"{shortened(name, longest)}  {k}" for k, name in enumerate(matrix.names, 1)]


def _percent(percent: float) -> str:
    """Return a number of two digits or more: ``"0.45"``, ``"2.1"``, ``"5,730"``."""
    if percent >= 10:  # noqa: PLR2004  # no decimals
        return f"{percent:,.0f}"
    return f"{percent:.2g}" if percent >= 0.01 else "0"  # noqa: PLR2004  # percent
