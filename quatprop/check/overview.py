"""Overview of a suite: an HTML file with a row and a small plot for each case."""

from __future__ import annotations

import math
from base64 import b64encode
from hashlib import sha256
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from quatprop.check.reports import VERDICTS, totals, worst_first
from quatprop.text import plain
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.check.case import CaseResult

STYLE = """\
:root { color-scheme: light dark; font: 14px system-ui, sans-serif }
table { border-collapse: collapse }
th, td { text-align: left; vertical-align: top; padding: .3em .8em; border-bottom: 1px solid #8886 }
button { all: unset; cursor: pointer; font-weight: bold }
button:focus-visible { outline: 2px solid }
.fail, .error { color: #d33 } .xpass, .deleted { color: #b70 }
svg { width: 160px; height: 32px; stroke: currentcolor; fill: none }
"""

SCRIPT = """\
for (const button of document.querySelectorAll('th button')) button.onclick = () => {
  const head = button.parentElement, column = head.cellIndex;
  const body = document.querySelector('tbody'), up = head.ariaSort !== 'ascending';
  for (const other of head.parentElement.cells) other.ariaSort = null;
  head.ariaSort = up ? 'ascending' : 'descending';
  const key = row => row.cells[column].dataset.key;
  body.append(...[...body.rows].sort((a, b) => (up ? 1 : -1)
    * key(a).localeCompare(key(b), 'en', {numeric: true})));
};
"""

HEADS = ("case", "verdict", "worst error", "over time", "why")


def write_overview(folder: Path, suite: Path, results: Sequence[CaseResult]) -> None:
    """Write ``index.html``: each case, worst first, with a link to its page."""
    target = folder / "index.html"
    refuse_outside(target, folder)
    folder.mkdir(parents=True, exist_ok=True)
    digest = b64encode(sha256(SCRIPT.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    title = escape(plain(suite.as_posix()))
    heads = "".join(f'<th scope="col"><button>{head}</button></th>' for head in HEADS)
    lines = [
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        f"<title>{title}</title><style>\n{STYLE}</style></head><body>",
        f"<h1>{title}</h1><p>{escape(totals(results))}</p>",
        f"<table><thead><tr>{heads}</tr></thead><tbody>",
        *(_row(result, order, folder) for order, result in enumerate(worst_first(results))),
        f'</tbody></table><script type="module">{SCRIPT}</script></body></html>',
    ]
    with open_atomic(target) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def _row(result: CaseResult, order: int, folder: Path) -> str:
    name = escape(plain(result.name))
    if result.evidence is not None:
        page = quote(Path(result.evidence, "error.html").relative_to(folder).as_posix())
        name = f'<a href="{page}">{name}</a>'
    error = result.error_rad
    size = "" if error is None else f"{math.degrees(error):.6g} deg"
    why = result.reason or "; ".join([*result.changes, *result.notes])
    cells = [
        (plain(result.name), name),
        (str(order), f'<span class="{result.verdict}">{VERDICTS[result.verdict][0]}</span>'),
        (f"{(error or 0.0) * 1e15:.0f}", size),
        (f"{(error or 0.0) * 1e15:.0f}", _plot(result)),
        (why, f"{escape(plain(result.summary))}<br>{escape(plain(why))}"),
    ]
    inside = "".join(f'<td data-key="{escape(plain(key))}">{text}</td>' for key, text in cells)
    return f"<tr>{inside}</tr>"


def _plot(result: CaseResult) -> str:
    """Return a line plot of the error over time, scaled from 0 to its maximum."""
    largest = max(result.trace, default=0.0)
    if largest <= 0.0:
        return ""
    last = max(len(result.trace) - 1, 1)
    points = " ".join(
        f"{158 * k / last + 1:.1f},{31 - 30 * error / largest:.1f}"
        for k, error in enumerate(result.trace)
    )
    label = f"error over time, at most {math.degrees(largest):.4g} deg"
    return f'<svg role="img" aria-label="{label}"><polyline points="{points}"/></svg>'
