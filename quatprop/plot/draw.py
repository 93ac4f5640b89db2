"""Draw a picture with matplotlib: PNG, SVG, PDF.

Only figures are used, no pyplot: no state is kept between pictures. The same picture gives the same
bytes: no dates, no random names.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import UsageError
from quatprop.plot.axes import draw_panel
from quatprop.plot.palette import GRID, INK, colour_of, stroke_of
from quatprop.text import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from quatprop.plot.picture import Picture

WIDTH = 7.5
"""Inches: a page between its margins."""

HEAD, PANEL, SINGLE, FOOT = 0.75, 1.25, 3.2, 0.5
"""Inches: title and facts; one of several panels; a single panel; the time axis."""

BARE_HEAD = 0.1
"""Inches: above panels without a title."""

LINE, FACT_LINE, FILE_LINE = 0.15, 0.165, 0.18
"""Inches: a line of notes, of facts, and of the legend."""

MARGIN = 0.012
"""Share of the width left of text."""

DOTS = 200
"""Dots an inch of a PNG."""

FONT, FONT_TITLE, FONT_SMALL = 8.5, 10.0, 7.5
"""Points."""

LEFT, RIGHT, LABEL = 0.915, 0.1875, 0.531
"""Inches: left and right of the panels, and from their labels to them."""

LONGEST_TITLE = 88
"""Characters that fit the width in the title's size; facts, which are smaller, may have more."""

LONGEST_FACT = 125

SETTINGS: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": FONT,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.unicode_minus": True,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    # Names may look like mathematics.
    "text.parse_math": False,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "path.simplify": True,
    "path.simplify_threshold": 0.1,
    "figure.constrained_layout.h_pad": 0.03,
    "svg.hashsalt": "quatprop",
    "pdf.fonttype": 42,
}

METADATA: dict[str, dict[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "ModDate": None, "Creator": "quatprop", "Producer": None},
}
"""Metadata of a file: nothing that changes from run to run."""


def require_matplotlib() -> None:
    """Make sure that pictures can be drawn.

    Raises
    ------
    UsageError
        matplotlib is not installed.
    """
    try:
        import matplotlib as mpl  # noqa: F401  # checked before anything is read
    except ImportError as error:
        raise UsageError(
            "pictures need matplotlib, which is not installed; pip install 'quatprop[plot]'"
        ) from error


@dataclass(frozen=True, slots=True)
class Style:
    """How large a picture and its letters are.

    Parameters
    ----------
    width, height
        Inches; no height is that which the panels need.
    dpi
        Dots an inch of a PNG.
    font
        Size of the letters, points.
    title
        Whether title, facts and notes stand around the panels.
    """

    width: float = WIDTH
    height: float | None = None
    dpi: int = DOTS
    font: float = FONT
    title: bool = True

    @property
    def scale(self) -> float:
        """How much larger than usual the letters are."""
        return self.font / FONT


STYLE = Style()


def render(picture: Picture, kind: str, style: Style = STYLE) -> bytes:
    """Return a picture as a file.

    Parameters
    ----------
    picture
        What to draw.
    kind
        ``"png"``, ``"svg"`` or ``"pdf"``.
    style
        How large it is.
    """
    if not style.title:
        picture = replace(picture, title="", facts=(), notes=())
    return _saved(picture, kind, {**SETTINGS, "font.size": style.font}, style)


def inline_svg(picture: Picture) -> str:
    """Return a picture as an SVG element for a page: text as text, on a clear background."""
    content = _saved(picture, "svg", {**SETTINGS, "svg.fonttype": "none"}, transparent=True)
    text = content.decode()
    text = text[text.index("<svg") :]
    # A page needs no namespaces, and they look like addresses.
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text, count=2)
    # A rule for all elements would be one for all of the page.
    text = text.replace('<style type="text/css">*{', '<style type="text/css">figure svg *{', 1)
    return re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)


def _saved(
    picture: Picture, kind: str, settings: dict[Any, Any], style: Style = STYLE, **options: Any
) -> bytes:
    import matplotlib as mpl

    stream = BytesIO()
    with mpl.rc_context(settings), warnings.catch_warnings():
        # Letters that the font does not have are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        drawn = figure(picture, style)
        drawn.savefig(stream, format=kind, dpi=style.dpi, metadata=METADATA[kind], **options)
    return stream.getvalue()


def figure(picture: Picture, style: Style = STYLE) -> Figure:
    """Return the figure of a picture, in the style of matplotlib's current settings."""
    from matplotlib.figure import Figure

    panels = picture.panels
    body = SINGLE if len(panels) == 1 else PANEL * len(panels)
    head = (HEAD if picture.title else BARE_HEAD) + FILE_LINE * -(-len(picture.legend) // 2)
    head *= style.scale
    foot = (FOOT + LINE * len(picture.notes)) * style.scale
    height = style.height or head + body * style.width / WIDTH + foot
    result = Figure(figsize=(style.width, height))
    left, right = LEFT * style.scale / style.width, 1 - RIGHT * style.scale / style.width
    grid = result.add_gridspec(
        len(panels), 1, left=left, right=right, top=1 - head / height, bottom=foot / height,
        hspace=0.12,
    )  # fmt: skip
    label = -LABEL * style.scale / (style.width * (right - left))
    shared: Axes | None = None
    for number, panel in enumerate(panels):
        axes = result.add_subplot(grid[number], sharex=shared)
        shared = shared or axes
        draw_panel(axes, panel, picture)
        axes.tick_params(labelbottom=number == len(panels) - 1)
        axes.yaxis.set_label_coords(label, 0.5)
    result.axes[-1].set_xlabel(picture.time)
    _set_time(result.axes[0], picture)
    _write_text(result, picture, style)
    if picture.legend:
        _write_legend(result, picture, 1 - head / height)
    return result


def _set_time(axes: Axes, picture: Picture) -> None:
    seconds = [curve.drawn.seconds for panel in picture.panels for curve in panel.curves]
    finite = np.concatenate(seconds)
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.01 * (high - low) if high > low else 0.5
    axes.set_xlim(low - margin, high + margin)
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")


def _write_text(result: Figure, picture: Picture, style: Style) -> None:
    """Write title and facts at the top, notes at the bottom."""
    height = result.get_size_inches()[1] / style.scale
    room = style.width / WIDTH / style.scale
    title = shortened(picture.title, round(LONGEST_TITLE * room))
    large, small = FONT_TITLE * style.scale, FONT_SMALL * style.scale
    result.text(MARGIN, 1 - 0.1 / height, title, fontsize=large, weight="bold", va="top")
    longest = round(LONGEST_FACT * room)
    for number, fact in enumerate(picture.facts):
        place = 1 - (0.32 + FACT_LINE * number) / height
        result.text(MARGIN, place, shortened(fact, longest), fontsize=small, va="top")
    for number, note in enumerate(reversed(picture.notes)):
        place = (0.07 + LINE * number) / height
        result.text(MARGIN, place, shortened(note, longest), fontsize=small)


def _write_legend(result: Figure, picture: Picture, top: float) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color=colour_of(file), linestyle=stroke_of(file), linewidth=1.8)
        for file in range(len(picture.legend))
    ]
    legend = result.legend(
        handles,
        [f"{number}" for number in range(len(handles))],
        loc="lower left",
        bbox_to_anchor=(0.006, top),
        ncols=2,
        frameon=False,
        borderaxespad=0.2,
        borderpad=0.1,
        labelspacing=0.2,
    )
    # Set afterwards, since names that begin with "_" would be left out.
    for text, name in zip(legend.get_texts(), picture.legend, strict=True):
        text.set_text(shortened(name, LONGEST_FACT // 2))


def shortened(text: str, longest: int) -> str:
    """Return a text with its middle left out where it is too long.

    Examples
    --------
    >>> shortened("a very long name", 9)
    'a ve…name'
    """
    text = plain(text)
    if len(text) <= longest:
        return text
    half = (longest - 1) // 2
    return f"{text[: longest - 1 - half]}\N{HORIZONTAL ELLIPSIS}{text[-half:]}"
