"""Colours that can be distinguished with any colour vision.

References
----------
Okabe and Ito, "Color Universal Design: how to make figures and presentations that are friendly to
colorblind people", 2008.
"""

from __future__ import annotations

from typing import Literal

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
