"""Render angles, quaternions, counts, times and names as text, for summaries and plots."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.base.text import plain, spelled
from quatprop.base.times import NS_PER_UNIT, duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from quatprop.base.errors import Loss


Row = tuple[str, str]
"""A label and the text of its value; an empty label continues the previous row."""

MAX_LOSSES = 20
"""Maximum number of losses that are listed."""

_UNUSUAL = 1.25
"""The usual rate is shown if it is this many times the average."""

GPS_EPOCH_NS = 315_964_800_000_000_000
"""1980-01-06; earlier timestamps are from a clock that starts at boot."""


def lines_of(rows: Iterable[Row], width: int = 9) -> list[str]:
    """Return rows as lines with aligned values."""
    return [f"{label:<{width}} {value}".rstrip() for label, value in rows]


def aligned(rows: Sequence[Sequence[str]], numbers_from: int) -> list[str]:
    """Return cells as lines, with the columns from a number on, which are numbers, to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if number >= numbers_from else cell.ljust(width)
            for number, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return lines


def rows_html(title: str, rows: Iterable[Row]) -> str:
    """Return rows as a table in HTML, as notebooks show it."""
    return table_html(title, (), rows)


def table_html(title: str, head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a title, names of columns and rows of texts as a table in HTML."""

    def line(tag: str, cells: Iterable[str]) -> str:
        # Numbers are aligned by spaces, and long sentences wrap.
        style = ' style="text-align:left;white-space:pre-wrap"'
        return "".join(f"<{tag}{style}>{escape(cell)}</{tag}>" for cell in cells)

    lines = [line("th", head), *(line("td", row) for row in rows)]
    body = "".join(f"<tr>{cells}</tr>" for cells in lines if cells)
    return f"<p>{escape(title)}</p><table>{body}</table>"


def degrees_text(angle: float, digits: int = 6) -> str:
    """Return an angle, rad, as text in degrees."""
    return f"{math.degrees(angle):.{digits}g} deg"


def decimals_of(sigma: float, most: int = 9) -> int:
    """Return the decimals with which two digits of a standard deviation show."""
    return min(max(1 - math.floor(math.log10(sigma)), 0), most)


def angle_text(angle: float) -> str:
    """Return an angle, rad, as text in rad and degrees."""
    return f"{angle:.6g} rad ({degrees_text(angle)})"


def quaternion_text(wxyz: Iterable[float]) -> str:
    """Return a quaternion with named components."""
    return "w {:+.9f}  x {:+.9f}  y {:+.9f}  z {:+.9f}".format(*wxyz)


def count_text(count: int, noun: str) -> str:
    """Return a count with its noun."""
    return f"{count:,} {noun}{'' if count == 1 else 's'}"


def instant_text(t_ns: int) -> str:
    """Return a timestamp as UTC, or in seconds if its clock does not start in 1970."""
    seconds, rest = divmod(abs(t_ns), NS_PER_UNIT["s"])
    fraction = f".{rest:09d}".rstrip("0").rstrip(".")
    if t_ns < GPS_EPOCH_NS:
        return f"{'-' if t_ns < 0 else ''}{seconds}{fraction} s of its clock"
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    return f"{moment:%Y-%m-%d %H:%M:%S}{fraction} UTC"


def rate_text(samples: int, span_ns: int, median_dt_ns: int | None = None) -> str:
    """Return the average sample rate, and the usual one if pauses make it differ."""
    rate_hz = (samples - 1) / (span_ns * 1e-9)
    usual_hz = 1e9 / median_dt_ns if median_dt_ns else rate_hz
    text = f"{rate_hz:.6g} Hz"
    has_pauses = usual_hz > _UNUSUAL * rate_hz
    return f"{text} on average, mostly {usual_hz:.6g} Hz" if has_pauses else text


def samples_text(samples: int, span_ns: int, median_dt_ns: int | None = None) -> str:
    """Return the number of samples, their time span and rate."""
    text = count_text(samples, "sample")
    if span_ns <= 0:
        return text
    return f"{text} over {duration_text(span_ns)}, {rate_text(samples, span_ns, median_dt_ns)}"


def source_text(name: str, type_name: str) -> str:
    """Return a topic and its type, or columns and the program that wrote them."""
    return " ".join(plain(text) for text in (name, type_name) if text)


def file_names(files: Iterable[tuple[str, str]]) -> list[str]:
    """Return short unique names for files and topics.

    Files of equal names are shown by path, and several topics of one file by topic.
    """
    files = list(files)
    paths = [path for path, _ in files]
    names = ["stdin" if path == "-" else Path(path).name for path in paths]
    return [
        plain(
            f"{name} {topic}" if paths.count(path) > 1 else path if names.count(name) > 1 else name
        )
        for (path, topic), name in zip(files, names, strict=True)
    ]


def loss_text(loss: Loss) -> str:
    """Return what was lost, where and why."""
    reason, count = spelled(loss.reason), loss.messages or 0
    # One is that of the place; some reasons have the number.
    is_said = count <= 1 or re.search(rf"\b({count}|{count:,})\b", reason)
    return f"lost: {plain(loss.place)}: {reason}{'' if is_said else f' ({count:,} lost)'}"


def loss_lines(losses: Sequence[Loss]) -> list[str]:
    """Return a line for each loss, at most :data:`MAX_LOSSES`."""
    lines = [loss_text(loss) for loss in losses[:MAX_LOSSES]]
    if len(losses) > MAX_LOSSES:
        more = len(losses) - MAX_LOSSES
        lines.append(f"lost: {more} more, which the JSON report lists")
    return lines
