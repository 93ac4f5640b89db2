"""Pictures as users ask for them: their content, and messages."""

import re
import struct
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.tables import write_attitudes, write_rates
from matplotlib import rc_context
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import quatprop
from quatprop.base.rendering import instant_text
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.tools.plot import figure as draw
from quatprop.tools.plot import panels as palette
from quatprop.tools.plot.picture import Page, picture
from quatprop.tools.plot.plotting import View, view_file

T0 = 1_700_000_000_000_000_000
STEP = 10_000_000
RATES = "timestamp [ns],wx [rad/s],wy [rad/s],wz [rad/s]"
SIGMAS = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z"


def spin(samples, rate=1.0):
    """Return stamps and attitudes of a spin about z, rate in rad/s."""
    t_ns = T0 + np.arange(samples) * STEP
    return t_ns, exp(np.outer(rate * np.arange(samples) * STEP * 1e-9, [0, 0, 1]))


def with_sigmas(path, t_ns, wxyz, sigmas):
    """Write attitudes with standard deviations about the body axes, rad."""
    rows = np.column_stack([wxyz, np.broadcast_to(sigmas, (len(t_ns), 3))])
    return write_attitudes(path, t_ns, rows, SIGMAS)


@pytest.fixture
def turning(tmp_path):
    """Write the spin of one turn in two seconds and more, and return its file."""
    return write_attitudes(tmp_path / "spin.csv", *spin(1000, np.pi))


@pytest.fixture
def rates(tmp_path):
    """Write rates with a spike of 2.5 rad/s at 1.23 s, and return their file."""
    rows = [(T0 + k * STEP, 0, 2.5 * (k == 123), 0) for k in range(500)]
    return write_rates(tmp_path / "rates.csv", rows, RATES)


@pytest.fixture
def off(tmp_path):
    """Write a series that is off by a ramp up to 2 degrees, and by 5 in one sample, and truth."""
    t_ns, wxyz = spin(1001)
    error = np.outer(np.radians(np.linspace(0, 2, 1001)), [1, 0, 0])
    error[300, 0] = np.radians(5)
    new = write_attitudes(tmp_path / "new.csv", t_ns, multiply(wxyz, exp(error)))
    return new, write_attitudes(tmp_path / "truth.csv", t_ns, wxyz)


@pytest.fixture
def drawn(monkeypatch):
    """Return a function that runs a command and returns the axes it draws and what it said.

    The picture is not made a file of.
    """
    figures, original = [], draw.figure
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_arguments, **_how: None)
    monkeypatch.setattr(draw, "figure", lambda *how: figures.append(original(*how)) or figures[-1])

    def drawn(*arguments, code=0):
        said = run(*arguments, code=code).stderr
        return figures[-1].axes, said

    return drawn


def axes_of(*paths, **view):
    """Return the axes of the figure of files."""
    views = [view_file(str(path), View(**view)) for path in paths]
    plotted = [
        one.plotted._replace(label=path.name) for one, path in zip(views, paths, strict=True)
    ]
    return draw.figure(Page("t", (), (), picture(plotted), (), ())).axes


def lines(axes, number=0):
    """Return what a line of each of some axes has in y."""
    return [one.get_lines()[number].get_ydata() for one in axes]


def labels(axes):
    """Return the quantities next to some axes."""
    return [one.get_ylabel().split("\n")[0] for one in axes]


def legend(axes):
    """Return the texts of the legend of the figure that has these axes."""
    return [text.get_text() for text in axes[0].figure.legends[0].get_texts()]


def edges(axes):
    """Return the seconds and the lower and upper edge of the area that is shaded in axes."""
    (area,) = axes.collections
    corners = np.concatenate([path.vertices for path in area.get_paths()])
    seconds = np.unique(corners[:, 0])
    at = [corners[corners[:, 0] == second, 1] for second in seconds]
    return seconds, np.array([one.min() for one in at]), np.array([one.max() for one in at])


# Files.


@pytest.mark.parametrize(
    ("suffix", "begins"),
    [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF"), ("html", b"<!DOCTYPE html>")],
)
def test_the_suffix_tells_the_kind_and_the_bytes_are_the_same_every_time(
    turning, tmp_path, suffix, begins
):
    """No dates, no names made up anew, and no state of matplotlib: pyplot is not imported."""
    sys.modules.pop("matplotlib.pyplot", None)
    first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix.upper()}"
    said = "spin.csv: 1,000 samples over 9.99 s, 100 Hz\n"
    for target in (first, second):
        assert run("plot", turning, "-o", target, code=0).output == said
    assert "matplotlib.pyplot" not in sys.modules
    assert first.read_bytes().startswith(begins)
    assert first.read_bytes() == second.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"spin.csv", first.name, second.name}


def test_a_style_sheet_of_matplotlib_is_taken(turning, tmp_path):
    """Its fonts and axes, and the size of its letters unless an option gives one."""
    sheet = tmp_path / "paper.mplstyle"
    sheet.write_text("font.size: 12\nfont.family: DejaVu Serif\naxes.edgecolor: 00ff00\n")
    command = "plot", turning, "--style", sheet, "-o"
    run(*command, tmp_path / "a.svg", code=0)
    run(*command, tmp_path / "b.pdf", "--font-size", "6", code=0)
    assert "stroke: #00ff00" in (tmp_path / "a.svg").read_text("utf-8")
    assert b"DejaVuSerif" in (tmp_path / "b.pdf").read_bytes()
    said = run("plot", turning, "--style", "none.mplstyle", "-o", tmp_path / "c.png", code=2).stderr
    assert "none.mplstyle: no such file" in said
    assert "--style takes a style sheet of matplotlib" in said


@pytest.mark.parametrize(
    "command",
    [
        "plot spin.csv -o a.png",
        "plot spin.csv -o a.png --style a.mplstyle",
        "propagate rates.csv -o o.csv --plot a.png --rate-unit rad/s",
        "compare spin.csv spin.csv --plot a.png",
    ],
)
@pytest.mark.usefixtures("turning", "rates")
def test_without_matplotlib_the_error_says_how_to_install_it(tmp_path, command, monkeypatch):
    """The extra that is missing is named with the command that brings it; nothing is written."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.chdir(tmp_path)
    assert refused(*command.split()) == (
        "Error: plots need matplotlib, which is not installed; pip install matplotlib"
    )
    assert {path.name for path in tmp_path.iterdir()} == {"rates.csv", "spin.csv"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("suffix", ["svg", "png", "pdf", "html"])
def test_damaged_numbers_and_names_like_mathematics_are_drawn_without_warnings(tmp_path, suffix):
    """Numbers whose difference is not finite, NaNs that signal; a dollar sign is a dollar sign."""
    path = tmp_path / r"$\frac{1$ _x^.npy"
    rows = np.zeros(50, [("t_ns", "<i8"), ("wx", "<f8"), ("wy", "<f8"), ("wz", "<f8")])
    rows["t_ns"] = STEP * np.arange(50)
    rows["wx"][10:12] = 1.7e308, -1.7e308
    rows["wy"].view(np.uint64)[20] = 0x7FF0000000000001  # a signalling NaN
    rows["wz"][30] = 1e308
    np.save(path, rows)
    run("plot", path, "-o", tmp_path / f"rates.{suffix}", code=0)


def test_a_picture_has_the_size_that_is_asked_for(turning, tmp_path):
    """In mm, cm or inches, at the dots an inch; without a title there is no text but the axes'."""
    out, vector = tmp_path / "a.png", tmp_path / "a.svg"
    for size, dpi, expected in (("127x63.5mm", 100, (500, 250)), ("4x3in", 50, (200, 150))):
        run("plot", turning, "-o", out, "--size", size, "--dpi", dpi, "--font-size", 6, code=0)
        assert struct.unpack(">II", out.read_bytes()[16:24]) == expected
    heights = []
    for options, titled in ((["--no-title"], False), ([], True), (["--font-size", "17"], True)):
        run("plot", turning, "-o", vector, *options, code=0)
        text = vector.read_text()
        assert ("<!-- Hamilton q, body to reference" in text) == titled
        heights.append(float(re.search(r'height="([\d.]+)pt"', text)[1]))
    assert heights == sorted(set(heights))


@pytest.mark.parametrize(
    "options",
    [
        ["--size=40x30mm"],
        ["--size=2x1in", "--no-title"],
        ["--size=1in"],
        ["--size=90x30mm"],
        ["--font-size=72"],
    ],
)
def test_a_picture_without_room_for_its_panels_names_the_size_that_does(turning, tmp_path, options):
    """One millimetre less would not do; a picture of that size is drawn."""
    words = ("plot", turning, "-o", tmp_path / "a.png", "--dpi=10", *options)
    said = refused(*words)
    width, *height = map(int, re.search(r"--size (\d+(?:x\d+)?)mm, or a sma", said)[1].split("x"))
    run(*words, f"--size={'x'.join(map(str, [width, *height]))}mm", code=0)
    less = f"{width}x{height[0] - 1}" if height else f"{width - 1}"
    refused(*words, f"--size={less}mm")


@pytest.mark.parametrize(
    "how", [{}, {"title": False}, {"width": 4.0}, {"font": 12.0}, {"width": 12.0}]
)
def test_nothing_overlaps_or_is_cut(turning, how):
    """Long names in the legend ran off the right edge; the panels have most of the room."""
    style = draw.STYLE._replace(**how)
    plotted = view_file(str(turning), View()).plotted
    files = [plotted._replace(label=name * 9) for name in ("flight_2024.", "nave", "WWWWWWWWW")]
    page = Page("Title", ("a fact", "another"), (), picture(files), ("a " * 99, "b", "c"), ())
    with rc_context({**draw.SETTINGS, "font.size": style.font}):
        figure = draw.figure(page, style)
        figure.draw_without_rendering()
        boxes = [part.get_window_extent() for part in (*figure.texts, *figure.legends)]
        boxes += [panel.get_tightbbox() for panel in figure.axes]
    for one in boxes:
        assert min(one.x0, one.y0) >= 0
        assert one.x1 <= figure.bbox.x1
        assert one.y1 <= figure.bbox.y1
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    places = [panel.get_position() for panel in figure.axes]
    least = 0.33 if style.title else 0.5
    assert sum(place.width * place.height for place in places) > least
    assert figure.bbox.y1 < 1.4 * figure.bbox.x1


# Attitudes.


def test_attitudes_are_angles(turning, tmp_path):
    """Yaw goes around without bars, pitch and roll stay at zero; --unwrap goes on to five turns."""
    axes = axes_of(turning)
    assert [one.get_ylabel() for one in axes] == ["yaw\ndeg", "pitch\ndeg", "roll\ndeg"]
    yaw, pitch, _ = lines(axes)
    assert np.isnan(yaw).sum() == 5
    assert np.nanmax(np.abs(np.diff(yaw))) < 2.0
    assert np.abs(pitch).max() == 0
    yaw = lines(axes_of(turning, unwrap=True))[0]
    np.testing.assert_allclose(yaw, np.degrees(np.pi * np.arange(1000) * 0.01), atol=1e-9)
    # Missing attitudes in between change nothing.
    t_ns, wxyz = spin(1000, np.pi)
    wxyz[95:99] = 0
    again = lines(axes_of(write_attitudes(tmp_path / "a.csv", t_ns, wxyz), unwrap=True))[0]
    np.testing.assert_allclose(again[-800:], yaw[-800:], atol=1e-9)


def test_components_are_the_quaternion_with_a_continuous_sign(tmp_path):
    """Of q and -q the one nearer to the row before is drawn: no leaps where a file has them."""
    t_ns, wxyz = spin(1000)
    flipped = wxyz * np.where(np.arange(1000) % 7 < 3, -1.0, 1.0)[:, None]
    axes = axes_of(write_attitudes(tmp_path / "a.csv", t_ns, flipped), components=True)
    assert labels(axes[:4]) == ["qw", "qx", "qy", "qz"]
    np.testing.assert_allclose(np.array(lines(axes[:4])).T, -wxyz, atol=1e-15)


def test_gaps_are_shaded_where_they_are_and_break_the_line(tmp_path):
    """The shade reaches from the last sample before a gap to the first after it."""
    t_ns, wxyz = spin(1000)
    kept = np.r_[0:300, 500:1000]
    path = write_attitudes(tmp_path / "a.csv", t_ns[kept], wxyz[kept])
    axes = axes_of(path)
    (shade,) = axes[1].collections
    np.testing.assert_allclose(shade.get_paths()[0].get_extents().intervalx, [2.99, 5.0])
    assert np.isnan(lines(axes)[1]).sum() == 1
    shades = [shade, *axes_of(path, path)[1].collections]
    assert len({tuple(one.get_facecolor()[0][:3]) for one in shades}) == 3, "files have their own"
    assert run("plot", path, "-o", tmp_path / "a.png", code=0).stderr.splitlines()[1] == (
        "warning: 1 gap longer than 100 ms, the longest 2.01 s: shaded, "
        f"first at {T0 + 5 * 10**9} ns"
    )


def test_standard_deviations_are_shaded_about_the_angles(tmp_path):
    """As SciPy's angles spread when the attitude is turned about its body axes by random errors."""
    truth = Rotation.from_euler(
        "ZYX", [[170, 50, -30], [190, 50, -30], [20, -40, 60]], degrees=True
    )
    sigmas = np.array([0.001, 0.002, 0.003])
    t_ns, wxyz = T0 + np.arange(3) * STEP, truth.as_quat(scalar_first=True)
    path = with_sigmas(tmp_path / "a.csv", t_ns, wxyz, sigmas)
    axes = axes_of(path)
    assert labels(axes) == ["yaw", "pitch", "roll", "1 sigma error"]
    np.testing.assert_allclose(lines(axes)[3], np.degrees(np.linalg.norm(sigmas)), rtol=1e-12)
    errors = Rotation.from_rotvec(np.random.default_rng(1).normal(size=(100_000, 3)) * sigmas)
    for row, attitude in enumerate(truth):
        middle = attitude.as_euler("ZYX", degrees=True)
        spread = (attitude * errors).as_euler("ZYX", degrees=True) - middle
        wanted = np.std((spread + 180) % 360 - 180, axis=0)
        for column, one in enumerate(axes[:3]):
            seconds, low, high = edges(one)
            (at,) = np.nonzero(np.isclose(seconds, row * 0.01))
            assert (high - low)[at] / 2 == pytest.approx(wanted[column], rel=0.01)
            assert (high + low)[at] / 2 == pytest.approx(middle[column], abs=1e-9)
    upright = Rotation.from_euler("ZYX", [0, 90, 0], degrees=True).as_quat(scalar_first=True)
    yaw, *_ = axes_of(with_sigmas(tmp_path / "b.csv", t_ns[:1], upright[None], sigmas))
    assert edges(yaw)[2] - edges(yaw)[1] == pytest.approx(360), "it may be anything"
    wanted = np.std((truth[0] * errors).as_quat(scalar_first=True), axis=0)
    together = quatprop.plot(path, ax=Figure().subplots())
    assert len(together.collections) == 3, "each angle has its own"
    for want, one in zip(wanted, axes_of(path, components=True)[:4], strict=True):
        _, low, high = edges(one)
        assert (high - low)[0] / 2 == pytest.approx(want, rel=0.01)


def test_files_with_and_without_standard_deviations_are_drawn_together(tmp_path):
    """The standard deviations of a file are drawn, unless they are unknown or zero."""
    series, target = spin(100), tmp_path / "a.svg"
    plain = write_attitudes(tmp_path / "a.csv", *series)
    sure = with_sigmas(tmp_path / "b.csv", *series, [0.1, 0.1, 0.1])
    exact = with_sigmas(tmp_path / "c.csv", *series, [0.0, 0.0, 0.0])
    for other, panels in ((sure, 4), (exact, 3)):
        axes = axes_of(plain, other)
        assert len(axes) == panels
        assert {len(one.get_lines()) for one in axes} == {2}
        run("plot", other, "-o", target, code=0)
        assert ("zyx angles (1 sigma shaded)" in target.read_text()) == (other == sure)


def test_a_norm_that_is_off_is_drawn_as_it_is(tmp_path):
    """The norm error shows what the file says, of rows that no rotation would pass for too."""
    t_ns, wxyz = spin(1000)
    wxyz[400] *= 1.25
    wxyz[600:610] = 0
    path = write_attitudes(tmp_path / "a.csv", t_ns, wxyz)
    norm = lines(axes_of(path))[3]
    assert np.nanmax(norm) == pytest.approx(0.25)
    assert np.isnan(norm).any()
    assert view_file(str(path), View()).facts[-1] == ("norm error", "at most 0.25")
    assert run("plot", path, "-o", tmp_path / "a.png", code=0).stderr.splitlines()[1] == (
        "warning: 10 invalid quaternions (zero, absent or not finite): not drawn"
    )


def test_one_sample_is_a_point_and_a_constant_is_no_noise(tmp_path):
    """A line of one point would be invisible; the rounding of a constant is not blown up."""
    t_ns, wxyz = spin(200)
    one = axes_of(write_attitudes(tmp_path / "one.csv", t_ns[:1], wxyz[:1]))[0]
    assert one.get_lines()[1].get_marker() == "."
    assert one.get_xlim() == (-0.5, 0.5)
    still = np.tile(wxyz[77], (200, 1))
    still[::2] += [0, 1e-16, 1e-16, 1e-16]
    for axes in axes_of(write_attitudes(tmp_path / "still.csv", t_ns, still))[:3]:
        low, high = axes.get_ylim()
        assert high - low > 1


def test_a_small_change_is_drawn_over_its_range(tmp_path):
    """With 8 % beyond, 1 % in time; ticks are values, without an offset next to them."""
    t_ns, wxyz = spin(200, 1e-5)
    turned = multiply(exp(np.array([[0, 0, 1.5]])), wxyz)
    yaw = axes_of(write_attitudes(tmp_path / "a.csv", t_ns, turned))[0]
    low, high = yaw.get_ylim()
    assert high - low == pytest.approx(1.16 * np.degrees(1.99e-5), rel=1e-6)
    assert yaw.get_xlim() == pytest.approx((-0.0199, 1.99 + 0.0199))
    yaw.figure.draw_without_rendering()
    assert yaw.yaxis.get_offset_text().get_text() == ""
    *_, last = axes_of(write_attitudes(tmp_path / "long.csv", t_ns * 1_000_000, turned))
    last.figure.draw_without_rendering()
    assert last.xaxis.get_offset_text().get_text() == ""


@pytest.mark.parametrize(("end", "whole"), [(149.5, False), (150.5, True), (-150.5, True)])
def test_a_wide_angle_is_drawn_over_a_whole_turn(tmp_path, end, whole):
    """With ticks at every quarter."""
    yaw = axes_of(write_attitudes(tmp_path / "a.csv", *spin(101, np.radians(end))))[0]
    assert (yaw.get_yticks().tolist() == [-180, -90, 0, 90, 180]) == whole


@pytest.mark.parametrize("components", [False, True])
@pytest.mark.parametrize(("length", "limits"), [(1.25, (-0.02, 0.27)), (0.75, (-0.27, 0.02))])
def test_norm_errors_are_drawn_from_zero(tmp_path, length, limits, components):
    """With 8 % beyond; next to angles, one that was the same everywhere filled the picture."""
    t_ns, wxyz = spin(100)
    path = write_attitudes(tmp_path / "a.csv", t_ns, length * wxyz)
    assert axes_of(path, components=components)[-1].get_ylim() == pytest.approx(limits)


def test_files_are_laid_over_one_another_in_colours_that_all_can_tell(turning, tmp_path):
    """Each file has its colour of the palette of Okabe and Ito, and a place in the legend."""
    other = write_attitudes(tmp_path / "_other$x$.csv", *spin(1000, 1.0))
    axes = axes_of(turning, other)
    assert [line.get_color() for line in axes[0].get_lines()] == ["#0072B2", "#E69F00"]
    below, above = (line.get_linewidth() for line in axes[0].get_lines())
    assert below > above, "where they coincide, both are seen"
    names = ["spin.csv", "_other$x$.csv"]
    assert legend(axes) == [*names]
    figure = axes[0].figure
    figure.draw_without_rendering()
    left, right = (text.get_window_extent() for text in figure.legends[0].get_texts())
    assert left.x1 < right.x0
    run("plot", turning, other, "-o", tmp_path / "a.png", code=0)
    okabe_ito = {
        "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
    }  # fmt: skip
    assert {*palette.FILES, *palette.AXES.values()} <= okabe_ito
    pairs = {(palette.colour_of(file), palette.stroke_of(file)) for file in range(28)}
    assert len(pairs) == 28


def test_files_of_other_times_begin_together(turning, tmp_path):
    """Recordings that do not overlap are laid over one another from their own starts."""
    t_ns, wxyz = spin(1000)
    axes = axes_of(turning, write_attitudes(tmp_path / "later.csv", t_ns + 10**15, wxyz))
    assert axes[-1].get_xlabel() == "time since the start of each file, s"
    assert all(line.get_xdata()[0] == 0 for line in axes[0].get_lines())


def test_an_option_about_attitudes_selects_attitudes(shared_logs, tmp_path):
    """--components and the like draw the orientation of a log that also has rates."""
    log, target = shared_logs / "husky" / "test1_husky.bag", tmp_path / "a.svg"
    run("plot", log, "-o", target, code=0)
    assert "rate x" in target.read_text()
    run("plot", log, "-t", "/imu/data", "--components", "-o", target, code=0)
    assert "<!-- qw -->" in target.read_text()


# Rates.


def test_rates_are_rows_with_units_and_a_spike_stands_out(rates, tmp_path, drawn):
    """Each axis of the gyroscope is a row in the unit of the log; one sample of 2.5 is drawn."""
    axes, _ = drawn("plot", rates, "--show", "rates", "-o", tmp_path / "a.svg")
    assert [one.get_ylabel() for one in axes] == [f"rate {axis}\nrad/s" for axis in "xyz"]
    assert axes[-1].get_xlabel() == "time since 2023-11-14 22:13:20 UTC, s"
    (line,) = axes[1].get_lines()
    seconds, values = line.get_data()
    assert np.nanmax(values) == 2.5
    assert seconds[np.nanargmax(values)] == pytest.approx(1.23)


def test_stdin_is_read_once_and_quiet_prints_nothing(tmp_path):
    """Though it has an orientation, which is compared with the rates where they are in a file."""
    rows = "".join(f"{T0 + k * STEP},0,0,0,1,0,0,0\n" for k in range(9))
    words = ("plot", "-", "-q", "--show", "rates", "-o", tmp_path / "a.svg")
    assert run(*words, input=f"{RATES},qw,qx,qy,qz\n{rows}", code=0).output == ""


@pytest.mark.parametrize(("size", "label"), [(99_999, "100000"), (100_000, "1e5")])
def test_large_numbers_have_exponents(tmp_path, size, label):
    """And where there is no number at all, the panel says so."""
    rows = [(T0 + k * STEP, size * k, "nan", 0) for k in (0, 1)]
    axes = axes_of(write_rates(tmp_path / "a.csv", rows, RATES))
    axes[0].figure.draw_without_rendering()
    assert label in [text.get_text() for text in axes[0].get_yticklabels()]
    assert [text.get_text() for one in axes for text in one.texts] == ["no values"]


def test_a_part_of_a_series_can_be_drawn(turning, rates, tmp_path):
    """--start and --end cut rates and attitudes alike, relative to either end."""
    for path, said in ((turning, "800 samples over 7.99"), (rates, "300 samples over 2.99")):
        words = ("plot", path, "-o", tmp_path / "a.svg", "--start", "+1s", "--end", "-1s")
        assert f": {said} s, 100 Hz" in run(*words, code=0).stderr


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("spin.csv --show rates", "no body rates found; its columns are 't_ns', 'qw', 'qx', "),
        ("spin.csv --start +1h", "no samples in 'qw,qx,qy,qz' between --start and --end: 1000 "),
        ("rates.csv --start +1h", "no samples in 'wx [rad/s],wy [rad/s],wz [rad/s]' between"),
        ("q.csv --quat-cols 1,2,3,4 --time-col 0", "which of the columns '1', '2', '3', '4' is "),
        (
            f"{SAMPLE_LOGS / 'coning.mcap'} --reference spin.csv",
            "none of 1000 rows holds an attitude (they are absent, not finite or no rotations); if",
        ),
        (f"{SAMPLE_LOGS / 'coning.mcap'} -t /no", "no topic '/no' that carries body rates; "),
    ],
)
@pytest.mark.usefixtures("turning", "rates")
def test_the_error_says_why_there_is_nothing_to_draw(tmp_path, monkeypatch, command, words):
    """It is about rates or attitudes, whichever the options are about."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "q.csv").write_text("1,1,0,0,0\n2,1,0,0,0\n")
    assert f": {words}" in refused("plot", *command.split(), "-o", "a.svg")


def test_a_part_is_relative_to_the_latest_stamp_of_rates_and_of_attitudes(tmp_path):
    """Not to the last one read, where stamps are not in order."""
    t_ns = [T0 + second * 10**9 for second in (0, 1, 2, 3, 4, 1)]
    for path in (
        write_attitudes(tmp_path / "q.csv", t_ns, [[1, 0, 0, 0]] * 6),
        write_rates(tmp_path / "w.csv", [(t, 1, 1, 1) for t in t_ns], RATES),
    ):
        said = run("plot", path, "-o", tmp_path / "a.svg", "--start", "-1s", code=0).stderr
        assert ": 2 samples over 1 s, 1 Hz" in said


def test_propagate_draws_rates_and_the_attitudes_it_wrote(rates, tmp_path, drawn):
    """One picture of both, and the same attitudes in the file as without it."""
    plain, out, target = tmp_path / "plain.csv", tmp_path / "out.csv", tmp_path / "a.svg"
    run("propagate", rates, "-o", plain, code=0)
    axes, _ = drawn("propagate", rates, "-o", out, "--plot", target)
    assert out.read_bytes() == plain.read_bytes()
    assert labels(axes) == ["rate x", "rate y", "rate z", "yaw", "pitch", "roll"]
    assert lines(axes)[4][-1] == pytest.approx(np.degrees(2.5 * 0.01))
    # With --rate 1, intervals of 100 samples are no gaps: they are joined by a line all the same.
    axes, _ = drawn("propagate", rates, "-o", out, "--rate", "1", "--plot", target)
    assert not np.isnan(lines(axes)[3]).any()
    expected = ("--sigma", "--noise-density", "1deg/sqrt(s)")
    axes, _ = drawn("propagate", rates, "-o", out, *expected, "--plot", target)
    assert lines(axes)[-1][-1] == pytest.approx(np.sqrt(3 * 4.99), rel=1e-6)
    assert any("(1 sigma shaded)" in text.get_text() for text in axes[0].figure.texts)


@pytest.mark.parametrize("suffix", ["svg", "html"])
def test_lost_data_of_a_damaged_log_is_reported(tmp_path, suffix):
    """A log that was cut off is drawn as far as it goes: exit code 3, and the page says so."""
    whole, cut = tmp_path / "a.mcap", tmp_path / "b.mcap"
    run("simulate", whole, "--truth", "none", "--samples", "2000", "--compression", "none", code=0)
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    target = tmp_path / f"a.{suffix}"
    said = run("plot", cut, "-o", target, code=3).stderr
    (lost,) = [line for line in said.splitlines() if "lost: " in line]
    if suffix == "html":
        assert lost.removeprefix("warning: ")[:30] in target.read_text()


def test_lost_data_of_a_compared_series_is_exit_code_3(off, tmp_path):
    """A row that is not a quaternion, on either side, is omitted."""
    new, truth = off
    cut = tmp_path / "cut.csv"
    cut.write_text(new.read_text() + "1,0,0,0,0\n")
    for sides in ((cut, truth), (new, cut)):
        run("plot", sides[0], "--reference", sides[1], "-o", tmp_path / "a.svg", code=3)


def test_remarks_on_rates_are_printed_with_a_picture(tmp_path):
    """They are those of the other commands."""
    still = write_rates(tmp_path / "a.csv", [(T0 + k * STEP, 0, 0, 0) for k in range(300)], RATES)
    said = run("plot", still, "-o", tmp_path / "a.svg", code=0).stderr
    assert "warning: every rate is zero: is this the right topic?" in said.splitlines()


@pytest.mark.parametrize(("height", "whole"), [(None, True), (4.0, False)])
def test_a_long_warning_is_wrapped_and_cut_only_behind_a_word(turning, height, whole):
    """Its middle was missing, and with it the number that was to be subtracted."""
    note = (
        "run: likely cause (rate bias): " + "subtract 0.00221576878 from the rates; " * 8 + "done"
    )
    plotted = view_file(str(turning), View()).plotted
    page = Page("t", (), (), picture([plotted]), (), ())._replace(warnings=(note,))
    texts = draw.figure(page, draw.STYLE._replace(height=height)).texts[1:]
    shown = " ".join(
        text.get_text() for text in sorted(texts, key=lambda text: -text.get_position()[1])
    )
    assert (shown == note) is whole
    assert note.startswith(shown.removesuffix(" \N{HORIZONTAL ELLIPSIS}"))
    assert set(shown.split()) <= {*note.split(), "\N{HORIZONTAL ELLIPSIS}"}


@pytest.mark.parametrize(
    ("warnings", "shown"), [("abc", "abc"), ("abcd", ("a", "b", "and 2 more warnings"))]
)
def test_three_warnings_are_below_a_picture(turning, warnings, shown):
    """Of more, the last line counts the others."""
    page = Page("t", (), (), picture([view_file(str(turning), View()).plotted]), (*warnings,), ())
    assert [text.get_text() for text in draw.figure(page).texts[:0:-1]] == [*shown]


# Errors.


@pytest.fixture(params=["plot", "compare"])
def error_drawn(request, off, tmp_path, drawn):
    """Return a function that draws the error of a series against its truth, by either command."""
    (new, truth), target = off, tmp_path / "a.svg"
    words = {
        "plot": ("plot", new, "--reference", truth, "-o", target),
        "compare": ("compare", new, truth, "--plot", target),
    }[request.param]

    def error_drawn(*options, code=0):
        return drawn(*words, *options, code=code if request.param == "compare" else 0)

    return error_drawn


def test_an_error_has_its_tolerance_first_and_worst_marked(error_drawn):
    """The line is the geodesic angle in degrees; what is marked is where it belongs."""
    axes, _ = error_drawn("--tol", "1deg", code=1)
    error, level, worst = axes[0].get_lines()
    want = np.linspace(0, 2, 1001)
    want[300] = 5
    np.testing.assert_allclose(error.get_ydata(), want, atol=1e-9)
    assert (level.get_ydata()[0], axes[0].get_ylim()[0]) == (pytest.approx(1.0), 0)
    heights = [panel.get_position().height for panel in axes]
    assert heights[1:] == pytest.approx([heights[0] / 2] * 3)
    assert worst.get_xydata()[0] == pytest.approx([3.0, 5.0])
    assert not axes[0].texts, "nothing is written over the line"
    worst = "first above the tolerance, and worst: 5 deg at 3 s"
    assert legend(axes) == ["tolerance 1 deg", worst]
    assert [panel.get_ylabel() for panel in axes[1:]] == [f"error {axis}\ndeg" for axis in "xyz"]
    np.testing.assert_allclose(lines(axes[1:]), [want, 0 * want, 0 * want], atol=1e-9)


def test_errors_over_windows_are_drawn_next_to_the_error(error_drawn, off):
    """As scipy has the rotations over each second, drawn where the second begins."""
    axes, _ = error_drawn("--window", "1s")
    error, window = axes[0].get_lines()[:2]
    assert len(error.get_ydata()) == 1001
    over = []
    for path in off:
        wxyz = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(1, 2, 3, 4))
        attitude = Rotation.from_quat(wxyz, scalar_first=True)
        over.append(attitude[:-100].inv() * attitude[100:])
    want = np.degrees((over[0].inv() * over[1]).magnitude())
    np.testing.assert_allclose(window.get_ydata(), want, atol=1e-9)
    np.testing.assert_allclose(window.get_xdata(), np.arange(901) * 0.01, atol=1e-9)
    assert legend(axes)[1] == f"over 1 s: max {want.max():.4g} deg, from where each begins"


def test_the_first_sample_above_the_tolerance_is_marked_next_to_the_worst(off, tmp_path, drawn):
    """Where they are two samples, each has its own words; far from it, the axis is logarithmic."""
    words = ("plot", off[0], "--reference", off[1], "-o", tmp_path / "a.svg", "--tol")
    axes, said = drawn(*words, "0.5deg")
    first = "first above the tolerance at 2.51 s"
    assert legend(axes) == ["tolerance 0.5 deg", first, "worst: 5 deg at 3 s"]
    faces = {line.get_marker(): line.get_markerfacecolor() for line in axes[0].get_lines()}
    assert (faces["o"], faces["v"]) == ("none", palette.ALARM)
    summary = "new.csv: max 5 deg, RMS 1.166 deg; above the tolerance of 0.5 deg"
    assert said.splitlines()[0] == summary
    for tolerance, scale in (("0.0501deg", "linear"), ("0.0499deg", "log"), ("1e-6deg", "log")):
        axes, _ = drawn(*words, tolerance)
        assert axes[0].get_yscale() == scale
    low, high = axes[0].get_ylim()
    assert (low < 1e-6, high > 5) == (True, True)
    shown = {label.get_text() for label in axes[0].get_yticklabels()}
    assert {"1e-6", "0.01", "1"} <= shown


def test_an_error_is_judged_as_by_compare(off, tmp_path, drawn):
    """Every limit was refused but that on the largest error."""
    words = ("plot", off[0], "--reference", off[1], "-o", tmp_path / "a.svg", "--align", "yaw")
    axes, said = drawn(*words, "--tol-heading", "1deg", "--tol-inclination", "1deg")
    assert "warning: new.csv: error in inclination 0.0872665 rad (5 deg), at most" in said
    assert "heading" not in said
    assert len(axes[0].get_lines()[0].get_xdata()) == 1001
    axes, said = drawn(*words, "--tol-inclination", "1deg", "--judge", "+0s..+2.99s,+3.01s..+5s")
    assert len(axes[0].get_lines()[0].get_xdata()) == 500
    assert "warning" not in said


def test_errors_about_the_axes_have_their_standard_deviation_shaded(tmp_path, drawn):
    """About zero, in degrees, as the file says."""
    new = with_sigmas(tmp_path / "new.csv", *spin(100), np.radians([1.0, 2.0, 3.0]))
    truth = write_attitudes(tmp_path / "truth.csv", *spin(100))
    axes, _ = drawn("compare", new, truth, "--plot", tmp_path / "a.svg")
    for panel, sigma in zip(axes[1:], [1.0, 2.0, 3.0], strict=True):
        _, low, high = edges(panel)
        np.testing.assert_allclose([low, high], [[-sigma] * 100, [sigma] * 100], rtol=1e-9)
    words = ("compare", truth, truth, "--plot", tmp_path / "a.svg")
    assert drawn(*words)[0][0].get_ylim() == (0, 1)
    axes, _ = drawn(*words, "--time-offset=10ms")
    assert any("reference 10 ms later" in text.get_text() for text in axes[0].figure.texts)


# Words.


def test_only_what_draws_knows_of_matplotlib():
    """Reduction of the data is separate from how they are drawn."""
    paths = Path(draw.__file__).parent.glob("*.py")
    know = {path.name for path in paths if "matplotlib." in path.read_text()}
    assert know == {"figure.py", "panels.py"}


@pytest.mark.parametrize(
    ("t_ns", "text"),
    [
        (0, "0 s of its clock"),
        (-1_500_000_000, "-1.5 s of its clock"),
        (1_700_000_000_000_000_001, "2023-11-14 22:13:20.000000001 UTC"),
        (2**63 - 1, "2262-04-11 23:47:16.854775807 UTC"),
    ],
)
def test_the_start_is_shown_to_the_nanosecond(t_ns, text):
    """A clock that counts from boot is not taken for the year 1970."""
    assert instant_text(t_ns) == text
