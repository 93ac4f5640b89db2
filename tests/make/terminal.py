"""Draw a terminal: commands and what they print, as a picture in SVG."""

import re
from xml.sax.saxutils import escape

COLUMNS = 124
SIZE, LINE, MARGIN = 12, 17, 14
"""Of the letters, from line to line, and around the text, px."""

WIDTH = round(COLUMNS * SIZE * 0.61) + 2 * MARGIN
"""Letters of fonts of fixed width are 0.6 of their size wide."""

STYLE = (
    f"text{{font:{SIZE}px ui-monospace,SFMono-Regular,Menlo,Consolas,'DejaVu Sans Mono',monospace;"
    "white-space:pre;fill:#d4d4d8}.prompt{fill:#4ade80;font-weight:bold}.passed{fill:#4ade80}"
    ".command{fill:#fff;font-weight:bold}.label{fill:#7dd3fc}"
)


def terminal(runs):
    """Return the picture of commands and their outputs, given in pairs."""
    lines = []
    for number, (command, output) in enumerate(runs):
        lines += [""] * (number > 0)
        lines.append(f'<tspan class="prompt">$ </tspan>{_span("command", command)}')
        for line in output.splitlines():
            parts = [line[at : at + COLUMNS] for at in range(0, len(line), COLUMNS)]
            lines += [_coloured(parts[0]), *map(escape, parts[1:])] if parts else [""]
    height = len(lines) * LINE + 2 * MARGIN
    rows = "".join(
        f'<text x="{MARGIN}" y="{MARGIN + SIZE + LINE * number}">{line}</text>\n'
        for number, line in enumerate(lines)
        if line
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" '
        f'width="{WIDTH}" height="{height}" xml:space="preserve">\n<style>{STYLE}</style>\n'
        f'<rect width="100%" height="100%" rx="8" fill="#18181b"/>\n{rows}</svg>\n'
    )


def _coloured(line):
    """Return a line of a summary whose label has a colour of its own."""
    if label := re.match(r"\w+(?= {2,})|\w{11}(?= )", line):
        kind = "passed" if label[0] == "passed" else "label"
        return _span(kind, label[0]) + escape(line[label.end() :])
    return escape(line)


def _span(kind, text):
    return f'<tspan class="{kind}">{escape(text)}</tspan>'
