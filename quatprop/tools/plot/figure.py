"""The figure of a picture: position and size of panels, legend and text."""

from __future__ import annotations

import re
import warnings
from contextlib import contextmanager
from io import BytesIO
from json import dumps
from math import ceil, isfinite
from textwrap import wrap
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError, os_reason
from quatprop.base.text import Setting, plain
from quatprop.tools.plot.panels import ALARM, GRID, INK, colour_of, draw_panel, shortened, stroke_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from quatprop.tools.plot.picture import Matrix, Page, Picture


WIDTH = 7.5
"""Inches: a page between its margins."""

HEAD, PANEL, SINGLE, FOOT = 0.75, 1.25, 3.2, 0.5
"""Inches: title and facts; one of several panels; a single panel; the time axis."""

BARE_HEAD, GAP = 0.2, 0.1
"""Inches: above panels without a title; between the legend and the panels."""

LINE, FACT_LINE, FILE_LINE = 0.15, 0.165, 0.18
"""Inches: a line of notes, of facts, and of the legend."""

MARGIN = 0.012
"""Share of the width left of text."""

DOTS = 200
"""Dots per inch of a PNG."""

FONT, FONT_TITLE, FONT_SMALL = 8.5, 10.0, 7.5
"""Points."""

LEFT, RIGHT, LABEL = 0.99, 0.1875, 0.61
"""Inches: left and right of the panels, and from their labels to them."""

LONGEST_TITLE = 88
"""Characters that fit the width in the title's size; facts, which are smaller, may have more."""

LONGEST_FACT = 125

LONGEST_LABEL = 85

TWO_COLUMNS_FROM = 0.7
"""Share of the usual width below which a legend has one column."""

MIN_HEIGHT_SHARE = 0.8
"""Smallest height of a panel relative to the usual one, for letters of the usual size."""

MIN_PANEL_HEIGHT, MIN_PANEL_WIDTH = 0.4, 1.15
"""Inches: least height of one of several panels, and least width, for letters of the usual size."""

MAX_NOTES, LINES = 3, 4
"""Notes below a picture, and lines of each where its height is free."""

MORE = " \N{HORIZONTAL ELLIPSIS}"


class Style(NamedTuple):
    """Size of a picture and of its letters.

    `width`, `height`: inches; without a height, that of the panels
    `dpi`: dots per inch of a PNG
    `font`: size of the letters, points
    `title`: whether to draw title, facts and notes around the panels
    `sheet`: settings of matplotlib that replace those of quatprop
    """

    width: float = WIDTH
    height: float | None = None
    dpi: int = DOTS
    font: float = FONT
    title: bool = True
    sheet: Mapping[str, Any] = MappingProxyType({})


STYLE = Style()

ON_PAGE = Style(width=4.8, font=8.0, title=False)
"""The picture of a page, whose letters are legible on a telephone and not huge on a desk; title,
facts and notes are on the page already."""


def figure(page: Page, style: Style = STYLE) -> Figure:
    """Return the figure of a page, in the style of matplotlib's current settings."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    picture, panels, scale = page.picture, page.picture.panels, style.font / FONT
    heights = [panel.quantity.height for panel in panels]
    least_width = (LEFT + MIN_PANEL_WIDTH + RIGHT) * scale
    room = max(style.width, least_width) / WIDTH / scale
    time = wrap(picture.time, round(LONGEST_LABEL * room))
    lines = LINES if style.height is None else 1
    notes = [
        line
        for note in (notes_of(page.warnings) if style.title else ())
        for line in wrap(plain(note), round(LONGEST_FACT * room), max_lines=lines, placeholder=MORE)
    ]
    body = SINGLE if len(panels) == 1 else PANEL * sum(heights)
    entries = len(picture.legend) + sum(len(panel.marks) + bool(panel.level) for panel in panels)
    columns = 2 if room >= TWO_COLUMNS_FROM else 1
    begin = (HEAD if style.title else BARE_HEAD) * scale
    above = 0.0 if picture.matrix is None else _height_of(picture.matrix) * scale
    head = begin + above + FILE_LINE * -(-entries // columns) * scale
    foot = (FOOT + LINE * (len(notes) + len(time) - 1)) * scale
    height = style.height or head + body * max(style.width / WIDTH, MIN_HEIGHT_SHARE * scale) + foot
    _require_room(style, least_width, head + MIN_PANEL_HEIGHT * sum(heights) * scale + foot)
    result = Figure(figsize=(style.width, height))
    left, right = LEFT * scale / style.width, 1 - RIGHT * scale / style.width
    edges = {"left": left, "right": right, "top": 1 - head / height, "bottom": foot / height}
    rows = result.subplots(
        len(panels), sharex=True, squeeze=False, height_ratios=heights,
        gridspec_kw={**edges, "hspace": 0.14},
    )  # fmt: skip
    label = -LABEL * scale / (style.width * (right - left))
    explained: list[tuple[Artist, str]] = [
        (Line2D([], [], color=colour_of(file), linestyle=stroke_of(file), linewidth=1.8), name)
        for file, name in enumerate(picture.legend)
    ]
    for number, (axes, panel) in enumerate(zip(rows[:, 0], panels, strict=True), 1):
        explained += draw_panel(axes, panel, picture, number)
        axes.yaxis.set_label_coords(label, 0.5)
    result.axes[-1].set_xlabel("\n".join(time))
    if not picture.is_log:
        _set_time(result.axes[0], picture)
    if style.title:
        _write_text(result, page, notes, scale, room)
    if explained:
        _write_legend(result, explained, 1 - (head - GAP * scale) / height, columns)
    if picture.matrix is not None:
        _draw_matrix(result, picture.matrix, begin, scale)
    return result


def _require_room(style: Style, width: float, height: float) -> None:
    """Raise an error if the picture is smaller than this, in inches."""
    if style.width >= width and (style.height is None or style.height >= height):
        return
    sides = (max(style.width, width), *([] if style.height is None else [height]))
    least = "x".join(f"{ceil(round(25.4 * side, 6))}" for side in sides)
    raise UsageError(
        "the panels and their letters do not fit into this picture; give at least "
        f"{Setting('size', f'{least}mm')}, or a smaller {Setting('font_size')}"
    )


def _set_time(axes: Axes, picture: Picture) -> None:
    seconds = [curve.drawn.seconds for panel in picture.panels for curve in panel.curves]
    finite = np.concatenate(seconds)
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    margin = 0.01 * (high - low) if high > low else 0.5
    axes.set_xlim(low - margin, high + margin)
    axes.ticklabel_format(axis="x", useOffset=False, style="plain")


def _write_text(
    result: Figure, page: Page, notes: Sequence[str], scale: float, room: float
) -> None:
    """Write title and facts at the top, notes at the bottom."""
    height = result.get_size_inches()[1] / scale
    title = shortened(page.title, round(LONGEST_TITLE * room))
    large, small = FONT_TITLE * scale, FONT_SMALL * scale
    head = result.text(MARGIN, 1 - 0.1 / height, title, fontsize=large, weight="bold", va="top")
    while head.get_window_extent().x1 > result.bbox.x1 and len(title) > 1:
        # Wide letters.
        title = shortened(title, len(title) * 9 // 10)
        head.set_text(title)
    longest = round(LONGEST_FACT * room)
    for number, fact in enumerate(page.facts):
        place = 1 - (0.32 + FACT_LINE * number) / height
        result.text(MARGIN, place, shortened(fact, longest), fontsize=small, va="top")
    for number, note in enumerate(reversed(notes)):
        place = (0.07 + LINE * number) / height
        result.text(MARGIN, place, note, fontsize=small)


def _write_legend(
    result: Figure, explained: Sequence[tuple[Artist, str]], top: float, columns: int
) -> None:
    legend = result.legend(
        [artist for artist, _ in explained],
        [f"{number}" for number in range(len(explained))],
        loc="lower left",
        bbox_to_anchor=(0.006, top),
        ncols=columns,
        frameon=False,
        borderaxespad=0.2,
        borderpad=0.1,
        labelspacing=0.2,
    )
    longest, right = max(len(name) for _, name in explained), 0.0
    while not 0 < right <= result.bbox.x1 and longest > 1:
        # Set afterwards, since names that begin with "_" would be left out.
        for text, (_, name) in zip(legend.get_texts(), explained, strict=True):
            text.set_text(shortened(name, longest))
        longest, right = longest * 9 // 10, legend.get_window_extent().x1


def notes_of(warnings: Sequence[str]) -> tuple[str, ...]:
    """Return the warnings below a picture; a page has all of them."""
    if len(warnings) <= MAX_NOTES:
        return tuple(warnings)
    shown = warnings[: MAX_NOTES - 1]
    return (*shown, f"and {len(warnings) - len(shown)} more warnings")


# A matrix of differences above the panels.


ROW, HEADER, BELOW = 0.24, 0.25, 0.15
"""Inches: a row, the numbers above them, and the distance to the panels below."""

COLUMN, NARROW = 0.75, 0.36
"""Inches: the widest column, and the narrowest one in which there is a number."""

MOST = 3.2
"""Inches: most room for names; the least is that of labels."""

SMALL: Final = 7.0
"""Size of the letters, points."""

FAINT, FULL = 0.01, 1.0
"""Differences that are drawn white, and in full colour."""


def _height_of(matrix: Matrix) -> float:
    """Return the height of a matrix with letters of the usual size, inches."""
    return HEADER + ROW * len(matrix.names) + BELOW


def _draw_matrix(result: Figure, matrix: Matrix, begin: float, scale: float) -> None:
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
            if isfinite(share):
                text = _percent(100 * share)
                axes.text(place + 0.5, row + 0.5, text, size=size, ha="center", va="center")


def _numbered(matrix: Matrix, longest: int) -> list[str]:
    return [f"{shortened(name, longest)}  {k}" for k, name in enumerate(matrix.names, 1)]


def _percent(percent: float) -> str:
    """Return a number of two digits or more: ``"0.45"``, ``"2.1"``, ``"5,730"``."""
    if percent >= 10:  # noqa: PLR2004  # no decimals
        return f"{percent:,.0f}"
    return f"{percent:.2g}" if percent >= 0.01 else "0"  # noqa: PLR2004  # percent


# Draw a picture with matplotlib: PNG, SVG, PDF.
#
# Without pyplot no state is kept between pictures. Equal pictures give equal bytes, without dates
# or random names.


MIN_ZOOM_BINS = 150
"""Fewest bins of a long series that a page can zoom to."""

SETTINGS: dict[Any, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": FONT,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    # Names may look like mathematical notation.
    "text.parse_math": False,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "svg.hashsalt": "quatprop",
    "pdf.fonttype": 42,
}

METADATA: dict[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "pdf": {"CreationDate": None, "ModDate": None, "Creator": "quatprop", "Producer": None},
}
"""Metadata of a file, without anything that changes from run to run."""


def require_matplotlib() -> None:
    """Raise an error if matplotlib is missing."""
    try:
        import matplotlib as mpl  # noqa: F401  # checked before anything is read
    except ImportError as error:
        raise UsageError(
            "plots need matplotlib, which is not installed; pip install matplotlib"
        ) from error


def style_sheet(path: str) -> dict[Any, Any]:
    """Return the settings in a style sheet of matplotlib."""
    require_matplotlib()
    from matplotlib import rc_params_from_file

    try:
        return dict(rc_params_from_file(path, use_default_template=False))
    except (OSError, UnicodeError) as error:
        reason = os_reason(error) if isinstance(error, OSError) else "it is not text"
        raise UsageError(
            f"{plain(path)}: {reason}; {Setting('style')} takes a style sheet of matplotlib"
        ) from error


def render(page: Page, kind: str, style: Style = STYLE) -> bytes:
    """Return a picture as a file.

    `kind`: ``"png"``, ``"svg"`` or ``"pdf"``
    """
    stream = BytesIO()
    with _figure_of(page, {**style.sheet, "font.size": style.font}, style) as drawn:
        drawn.savefig(stream, format=kind, dpi=style.dpi, metadata=METADATA[kind])
    return stream.getvalue()


def inline_svg(page: Page) -> tuple[str, str]:
    """Return the picture of a page as an SVG element, and the limits of its axes as JSON.

    Text is not converted to paths, the background is transparent, and lines are not simplified.
    """
    stream = BytesIO()
    settings = {"svg.fonttype": "none", "path.simplify": False, "font.size": ON_PAGE.font}
    with _figure_of(page, settings, ON_PAGE) as drawn:
        drawn.savefig(stream, format="svg", metadata=METADATA["svg"], transparent=True)
        limits = {
            "time": drawn.axes[0].get_xlim(),
            "least": MIN_ZOOM_BINS * page.picture.bin_s,
            "panels": [[*axes.transScale.transform([[1.0, y] for y in axes.get_ylim()])[:, 1],
                        axes.get_yscale() == "log", panel.quantity.unit]
                       for axes, panel in zip(drawn.axes, page.picture.panels, strict=True)],
        }  # fmt: skip
    text = stream.getvalue().decode()
    text = text[text.index("<svg") :]
    # HTML does not need namespaces, which look like addresses.
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text, count=2)
    # A rule for all elements would apply to the whole page.
    text = text.replace('<style type="text/css">*{', '<style type="text/css">figure svg *{', 1)
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Four decimals of a point are enough to zoom in by hundreds.
    path = re.compile(r'<path[^>]* d="[^"]*"')
    return path.sub(lambda found: re.sub(r"(\.\d{4})\d+", r"\1", found[0]), text), dumps(limits)


@contextmanager
def _figure_of(page: Page, settings: dict[Any, Any], style: Style) -> Iterator[Figure]:
    """Yield the figure of a page, with matplotlib set up to save it."""
    import matplotlib as mpl

    with mpl.rc_context({**SETTINGS, **settings}), warnings.catch_warnings():
        # Characters missing in the font are drawn as boxes.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield figure(page, style)
