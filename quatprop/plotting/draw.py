"""Draw a picture with matplotlib: PNG, SVG, PDF.

Without pyplot no state is kept between pictures. Equal pictures give equal bytes, without dates or
random names.
"""

from __future__ import annotations

import re
import warnings
from contextlib import contextmanager
from io import BytesIO
from json import dumps
from typing import TYPE_CHECKING, Any

from quatprop.errors import UsageError, os_reason
from quatprop.plotting.figure import FONT, STYLE, Style, figure
from quatprop.plotting.palette import GRID, INK
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from quatprop.plotting.picture import Page

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
    settings = {"svg.fonttype": "none", "path.simplify": False}
    # Title, facts and notes are on the page already.
    with _figure_of(page, settings, STYLE._replace(title=False)) as drawn:
        drawn.savefig(stream, format="svg", metadata=METADATA["svg"], transparent=True)
        limits = {
            "time": drawn.axes[0].get_xlim(),
            "least": MIN_ZOOM_BINS * page.picture.bin_s,
            "panels": [[*axes.transScale.transform([[1.0, y] for y in axes.get_ylim()])[:, 1],
                        axes.get_yscale() == "log"] for axes in drawn.axes],
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
