"""The report as one HTML file: loads nothing, lets nothing of a file be markup, opens anywhere."""

import json
import re
import shutil
import subprocess
from base64 import b64encode
from hashlib import sha256
from html import escape
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from make.commands import run
from make.json_messages import imu
from make.mcap import Topic, write_topics
from make.places import SAMPLE_LOGS
from make.tables import write_attitudes, write_rates

from quatprop.kinematics.quaternion import exp
from quatprop.tools.check.case import CaseResult
from quatprop.tools.check.runner import write_overview

HOSTILE = '/imu"><script>alert(1)</script><img src=http://example.com/x onerror=alert(2)>&amp;'

LOADS = {
    "link", "img", "image", "iframe", "object", "embed", "audio", "video", "source",
    "base", "form", "input", "button", "foreignobject", "feimage", "animate", "set",
}  # fmt: skip
"""Elements that fetch or send something."""

NO_WORDS = {"html", "head", "body", "main", "figure", "table", "tr", "svg", "g", "defs"}
"""Elements whose content is elements."""

EMPTY = {"meta", "path", "use", "rect", "line", "circle", "br"}


class Page(HTMLParser):
    """The parts of a page: elements with attributes, style sheets, scripts, words."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.elements, self.words, self.open = [], [], []
        self.styles, self.scripts = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        """Keep an element."""
        self.elements.append((tag, dict(attrs)))
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        """Keep an element without content."""
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        """Check that elements are nested as they should be."""
        if tag not in EMPTY:
            assert self.open.pop() == tag

    def handle_data(self, data):
        """Keep words, style sheets and scripts apart; words are in elements that are for words."""
        assert not (self.open and self.open[-1] in NO_WORDS and data.strip()), data
        apart = {"style": self.styles, "script": self.scripts}
        apart.get(self.open[-1] if self.open else "", self.words).append(data)


def page_of(*arguments):
    """Run a command and return its page as text and parsed."""
    assert run(*arguments).exit_code in {0, 1}
    text = arguments[-1].read_text()
    return text, Page(text)


def assert_loads_nothing(text, page):
    """Check that no element and no address reaches out of a page, and that one script may run."""
    assert not page.open
    tags = {tag for tag, _ in page.elements}
    assert not tags & LOADS
    (script,) = page.scripts
    assert script == files("quatprop.tools.plot").joinpath("page.js").read_text("utf-8")
    assert [attributes for tag, attributes in page.elements if tag == "script"] == [
        {"type": "module"}
    ]
    digest = b64encode(sha256(script.encode()).digest()).decode()
    (policy,) = (attributes for _, attributes in page.elements if "http-equiv" in attributes)
    assert policy["content"] == (
        f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
    )
    for tag, attributes in page.elements:
        assert not [name for name in attributes if name.startswith("on")], tag
        for name, value in attributes.items():
            if name in {"href", "xlink:href", "src", "srcset", "data", "action", "poster"}:
                assert value.startswith("#"), (tag, name, value)
            if name == "style":
                assert not re.search(r"url\((?!#)", value), value
    for style in page.styles:
        assert "@import" not in style
        assert not re.search(r"url\((?!#)", style)
    # Whatever there is of addresses is what a file says.
    assert "://" not in text.replace("http://example.com/x", "")


@pytest.fixture
def series(tmp_path):
    """Write a series of attitudes, and one that is 3 degrees off."""
    angle = np.linspace(0, 20, 400)
    t_ns = 1_700_000_000_000_000_000 + np.arange(400) * 50_000_000
    return [
        write_attitudes(
            tmp_path / name, t_ns, exp(np.stack([0 * angle, 0 * angle, turned], axis=1))
        )
        for name, turned in (("new.csv", angle + np.radians(3)), ("truth.csv", angle))
    ]


def test_a_page_explains_its_picture(series, tmp_path):
    """Figures, conventions and warnings are words; every page is one picture and loads nothing."""
    new, truth = series
    target = tmp_path / "page.html"
    tolerance = ("--tol", "1deg")
    pages = [
        page_of("plot", new, "-o", target),
        page_of("compare", new, truth, *tolerance, "--plot", target),
        page_of("plot", new, "--reference", truth, *tolerance, "-o", target),
    ]
    for text, page in pages:
        assert_loads_nothing(text, page)
        assert [tag for tag, _ in page.elements].count("svg") == 1
    words = " ".join(pages[0][1].words)
    assert "Hamilton, ij = k: v_ref = q v_body q*" in words
    assert "400 samples over 19.95 s, 20 Hz" in words
    words = " ".join(pages[2][1].words)
    assert "new.csv: max 3 deg, RMS 3 deg; above the tolerance of 1 deg" in words
    assert "hamilton body-to-ref, scalar-first" in words
    assert "likely cause" in words
    above = r"new\.csv: above the tolerance 0\.0174533 rad \(1 deg\), first at sample \d+ of "
    assert re.search(above + r"(new\.csv|the reference), ", words)
    (figure,) = (attributes for tag, attributes in pages[2][1].elements if tag == "figure")
    assert figure["aria-label"] == (
        "error of new.csv against truth.csv: geodesic error, error x, error y, error z against time"
    )


def test_names_from_a_file_are_text(tmp_path):
    """A topic that is markup shows as it is written, and does nothing."""
    messages = [imu(0.1, 0.2, 0.01 * k, {"sec": 1 + k, "nanosec": 0}) for k in range(20)]
    log = tmp_path / "<b>log&.mcap"
    write_topics(log, {HOSTILE: Topic("sensor_msgs/Imu", messages)})
    target = tmp_path / "page.html"
    for arguments in (
        ("plot", log, "-o", target),
        ("propagate", log, "-q", "-o", tmp_path / "a.csv", "--plot", target),
    ):
        text, page = page_of(*arguments)
        assert_loads_nothing(text, page)
        assert text.count("<script") == 1
        assert "<img" not in text
        assert HOSTILE in "".join(page.words)
    picture, _ = page_of("plot", log, "-o", tmp_path / "a.svg")
    assert "<script" not in picture
    assert "<img" not in picture


def test_the_page_of_propagate_has_its_summary(tmp_path):
    """Every line of what goes to stderr is on the page, too: sensitivity, errors, bias."""
    log, out, target = SAMPLE_LOGS / "tumbling.bag", tmp_path / "a.csv", tmp_path / "page.html"
    errors = ("--sigma", "--noise-density", "0.2deg/sqrt(h)")
    options = ("--bias", "0,0,0.1", *errors, "--start", "+1s")
    summary = run("propagate", log, "-o", out, *options, "--plot", target).stderr
    words = " ".join(" ".join(Page(target.read_text()).words).split())
    for line in summary.splitlines():
        assert " ".join(line.split()) in words
    assert "first 2023-11-14 22:13:21 UTC" in words
    assert "max gap 10 median intervals start 1700000001000000000 ns Made from" in words
    _, page = page_of("plot", out, "-o", target)
    assert "as zyx angles (1 sigma shaded), t_ns clock" in " ".join(page.words)


@pytest.mark.parametrize(
    ("command", "inputs"),
    [
        ("plot new.csv -o", ["new.csv"]),
        ("compare new.csv truth.csv --plot", ["new.csv", "truth.csv"]),
        ("propagate log.csv -o out.csv --plot", ["log.csv"]),
    ],
)
@pytest.mark.usefixtures("series")
def test_a_page_names_its_inputs(tmp_path, monkeypatch, command, inputs):
    """The command, and for each file the digest that proves it unchanged."""
    monkeypatch.chdir(tmp_path)
    write_rates(tmp_path / "log.csv", [[0, 0, 0, 1], [10_000_000, 0, 0, 1]])
    arguments = [*command.split(), "a page.html"]
    monkeypatch.setattr("sys.argv", ["/usr/bin/quatprop", *arguments])
    run(*arguments)
    words = " ".join(Page((tmp_path / "a page.html").read_text()).words)
    assert f"quatprop {command} 'a page.html'" in words
    for name in inputs:
        content = (tmp_path / name).read_bytes()
        assert f"{len(content):,} bytes, SHA-256 {sha256(content).hexdigest()}" in words


def test_a_page_is_light_and_dark_and_fit_for_paper(series, tmp_path):
    """A dark page inverts the picture, whose styles are not those of the page."""
    text, page = page_of("plot", series[0], "-o", tmp_path / "page.html")
    style, of_picture = page.styles
    assert of_picture.startswith("figure svg *{")
    assert "prefers-color-scheme: dark) { figure svg {" in style
    assert "@media print" in style
    assert "#ffffff" not in text.partition("<svg")[2], "the picture has no ground of its own"
    used = set(re.findall(r"var\((--[a-z0-9-]+)", text))
    assert used == set(re.findall(r"(--[a-z-]+):", style))


@pytest.mark.parametrize(("samples", "bin_s"), [(2000, 0.0), (4000, 0.0), (8 * 2048, 0.007)])
def test_a_long_series_zooms_no_further_than_it_was_drawn(tmp_path, samples, bin_s):
    """A drawing of bins has no detail below a bin; a short series is drawn with all its samples."""
    log, target = tmp_path / "rates.npy", tmp_path / "page.html"
    rows = np.zeros(samples, [("t_ns", "<i8"), ("wx", "<f8"), ("wy", "<f8"), ("wz", "<f8")])
    rows["t_ns"] = np.arange(samples) * 1_000_000
    np.save(log, rows)
    text, page = page_of("plot", log, "--rate-unit", "rad/s", "-o", target)
    path = re.search('id="curve_1_0">\\s*<path d="([^"]*)"', text)[1]
    assert path.count("L") > samples / 2 or bin_s, "as it would be simplified for paper"
    (figure,) = (attributes for tag, attributes in page.elements if tag == "figure")
    # A bin is 2^23 ns long, and holds 8 or 9 samples.
    assert json.loads(figure["data-limits"])["least"] == pytest.approx(150 * bin_s, rel=0.2)
    assert ("Only the extremes" in "".join(page.words)) == (bin_s > 0)


CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
     if (found := shutil.which(name))), None
)  # fmt: skip


def shown(page, folder, script, width=1200):
    """Return what a script, put into a page for the test only, writes into its title.

    The page is in a frame, since windows of Chromium are 500 px wide at least.
    """
    probe = folder / "probe.html"
    text = re.sub(r"<meta http-equiv[^>]*>", "", page.read_text())
    script += "\nparent.document.title = document.title;"
    text = text.replace("</body>", f'<script type="module">{script}</script></body>')
    frame = f'<iframe srcdoc="{escape(text)}" style="width:{width}px;height:900px;border:0">'
    probe.write_text(f'<!DOCTYPE html><meta charset="utf-8"><title></title>{frame}</iframe>')
    arguments = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
        "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", f"--user-data-dir={folder / 'profile'}",
        f"--window-size={width + 100},1000", "--dump-dom", probe.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120, check=True)
    return re.search(r"<title>(.*?)</title>", done.stdout)[1]


needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here to open the page in")


@needs_browser
@pytest.mark.parametrize("width", [360, 400, 1400])
def test_a_browser_shows_the_page(series, tmp_path, width):
    """Chromium lays the page out at the width of a telephone and of a desk, wider than neither."""
    new, truth = series
    target = tmp_path / "page.html"
    page_of("plot", new, "--reference", truth, "--tol", "1deg", "-o", target)
    assert shown(target, tmp_path, MEASURE, width) == "true true true true true"


@needs_browser
@pytest.mark.parametrize("width", [360, 400, 1400])
def test_a_browser_shows_the_overview_of_a_suite(tmp_path, width):
    """No cell is beyond the window, and no word is broken where there is room for it."""
    reason = "above the tolerance, first at +60 ms (1700000000060000000 ns); " * 4
    cases = [
        CaseResult(f"case-with-a-name-{number}", "error", reason, error_rad=0.1 * number,
                   trace=(0.0, 1.0, 0.5))
        for number in range(3)
    ]  # fmt: skip
    write_overview(tmp_path, Path("suite.toml"), cases)
    script = """
    const cells = [...document.querySelectorAll('td')], verdict = document.querySelector('td span');
    document.title = [document.documentElement.scrollWidth <= innerWidth,
      cells.every(cell => cell.getBoundingClientRect().right <= innerWidth),
      verdict.getClientRects().length].join(' ');
    """
    assert shown(tmp_path / "index.html", tmp_path, script, width) == "true true 1"


MEASURE = """
const svg = document.querySelector('svg'), box = svg.getBoundingClientRect();
const letters = [...svg.querySelectorAll('text')].map(text => text.getBoundingClientRect());
document.title = [document.documentElement.scrollWidth <= innerWidth, box.height > 150,
  letters.length > 8, box.right <= innerWidth && letters.every(({right}) => right <= innerWidth),
  parseFloat(getComputedStyle(svg.querySelector('g text')).fontSize) * box.width
  / svg.viewBox.baseVal.width > 7].join(' ');
"""
"""Nothing is wider than the window; the picture has a height, letters, and all of it and of them is
within the window, where a thumb can reach it; the letters are of more than 7 px."""


MOUSE = """
const svg = document.querySelector('svg');
const box = svg.querySelector('#axes_1 path').getBoundingClientRect();
const mouse = (kind, share, shiftKey = false) => svg.dispatchEvent(new PointerEvent(kind, {
  clientX: box.x + share * box.width, clientY: box.y + 5, pointerId: 1, bubbles: true, shiftKey}));
svg.setPointerCapture = () => {};
const drag = (from, to, shift) => {
  mouse('pointerdown', from, shift);
  mouse('pointermove', to, shift);
  mouse('pointerup', to, shift);
};
const texts = () => [...document.querySelectorAll('figure svg > text')].map(text =>
  [...text.childNodes].map(part => part.textContent.trim()).join('|'));
const times = () => [...document.querySelectorAll('#axes_3 [id^=xtick_]')].filter(
  tick => tick.style.display != 'none').map(tick => tick.textContent.trim());
const said = [];
"""


@needs_browser
def test_a_page_zooms_and_reads_values(series, tmp_path):
    """Zoomed, panned and whole again, the values under the cursor are those of the files."""
    target = tmp_path / "page.html"
    page_of("plot", *series, "-o", target)
    script = """
    mouse('pointermove', (7 + 0.1995) / 20.349); said.push(texts(), times());
    drag(0.25, 0.35); mouse('pointermove', 0.5); said.push(texts(), times());
    drag(0.5, 0.4, true); mouse('pointermove', 0.5); said.push(texts());
    svg.dispatchEvent(new MouseEvent('dblclick')); said.push(times());
    mouse('pointermove', 2); said.push(texts());
    document.title = JSON.stringify(said);
    """
    whole, ticks, zoomed, fine, panned, again, left = json.loads(
        shown(target, tmp_path, MOUSE + script)
    )

    def yaw(seconds, off):
        return (np.degrees(20 * seconds / 19.95) + off + 180) % 360 - 180

    # The axis is wider than the series, of 19.95 s, by 1 % on either side.
    places = [7.0, *(share * 20.349 - 0.1995 for share in (0.3, 0.31))]
    for texts, seconds in zip((whole, zoomed, panned), places, strict=True):
        assert float(texts[-1].removesuffix(" s")) == pytest.approx(seconds, abs=0.01)
        *values, unit = texts[0].replace("\N{MINUS SIGN}", "-").split("|")
        assert unit == "deg"
        values = [float(text) for text in values]
        assert values == pytest.approx([yaw(seconds, 3), yaw(seconds, 0)], abs=0.05)
        assert values[0] - values[1] == pytest.approx(3, abs=0.01)
    assert [float(tick) for tick in ticks] == [0, 2.5, 5, 7.5, 10, 12.5, 15, 17.5, 20]
    assert [float(tick) for tick in fine] == [5, 5.5, 6, 6.5]
    assert again == ticks
    assert left == ["", "", "", ""]
