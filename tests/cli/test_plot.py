"""Pictures as users ask for them: what they show, what is said, what is refused."""

import re
import struct
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from quatprop.cli.commands import cli
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.plot import draw, palette
from quatprop.plot.files import View, view_file
from quatprop.plot.picture import Page, picture
from quatprop.rendering import instant_text

T0 = 1_700_000_000_000_000_000
STEP = 10_000_000


def run(*arguments):
    """Run the command line; return exit code, stdout and stderr."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def write_attitudes(path, t_ns, wxyz):
    """Write a CSV of attitudes."""
    rows = (",".join([str(t), *map(repr, q)]) for t, q in zip(t_ns, wxyz.tolist(), strict=True))
    path.write_text("t_ns,qw,qx,qy,qz\n" + "\n".join(rows) + "\n")
    return path


def write_rates(path, t_ns, rates):
    """Write a CSV of rates in rad/s."""
    rows = (",".join([str(t), *map(repr, w)]) for t, w in zip(t_ns, rates.tolist(), strict=True))
    path.write_text("timestamp [ns],wx [rad/s],wy [rad/s],wz [rad/s]\n" + "\n".join(rows) + "\n")
    return path


def spin(samples, rate=1.0):
    """Return stamps and attitudes of a spin about z, rate in rad/s."""
    t_ns = T0 + np.arange(samples) * STEP
    angle = rate * np.arange(samples) * STEP * 1e-9
    return t_ns, exp(np.stack([0 * angle, 0 * angle, angle], axis=1))


RATE_OPTIONS = ("--rate-cols", "1,2,3", "--time-col", "0", "--time-unit", "ns",
                "--rate-unit", "rad/s")  # fmt: skip


@pytest.fixture
def turning(tmp_path):
    """Write the spin of one turn in two seconds and more, and return its file."""
    return write_attitudes(tmp_path / "spin.csv", *spin(1000, np.pi))


@pytest.fixture
def rates(tmp_path):
    """Write rates with a spike, and return their file."""
    values = np.zeros((500, 3))
    values[123, 1] = 2.5
    return write_rates(tmp_path / "rates.csv", T0 + np.arange(500) * STEP, values)


def figure_of(*paths, **view):
    """Return the figure of files, its axes and the picture."""
    views = [view_file(str(path), View(**view)) for path in paths]
    drawn = picture(
        [one.plotted._replace(label=path.name) for one, path in zip(views, paths, strict=True)]
    )
    figure = draw.figure(Page("t", (), (), drawn, (), ()))
    return figure, figure.axes, drawn


@pytest.mark.parametrize(
    ("suffix", "begins"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF"),
                           ("html", b"<!DOCTYPE html>")]
)  # fmt: skip
def test_the_suffix_tells_the_kind_and_the_bytes_are_the_same_every_time(
    turning, tmp_path, suffix, begins
):
    """The same command writes the same bytes again: no dates, no names made up anew."""
    first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix.upper()}"
    for target in (first, second):
        assert run("plot", turning, "-o", target) == (
            0,
            "",
            "spin.csv: qw,qx,qy,qz quatprop: 1,000 samples over 9.99 s, 100 Hz\n",
        )
    assert first.read_bytes().startswith(begins)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["spin.csv", first.name, second.name]
    )


def test_other_suffixes_are_refused_with_what_is_possible(turning, tmp_path):
    """A picture of no known kind is one sentence, and nothing is read."""
    code, _, said = run("plot", turning, "-o", tmp_path / "a.jpg")
    assert code == 2
    assert said == (
        f"Error: {tmp_path / 'a.jpg'}: the suffix is not one of a picture; use .png, .svg "
        "or .pdf, or .html for a report\n"
    )
    code, _, said = run("plot", turning, "-o", "-")
    assert said == "Error: -: a picture goes to a file; name one that ends in .png\n"


def test_no_input_is_replaced(turning, tmp_path):
    """A picture never takes the place of what it is drawn from."""
    picture_like = tmp_path / "spin.svg"
    picture_like.write_bytes(turning.read_bytes())
    before = picture_like.read_bytes()
    code, _, said = run("plot", picture_like, "--from", "csv", "-o", picture_like)
    assert (code, picture_like.read_bytes()) == (2, before)
    assert said == (f"Error: {picture_like}: this is an input of the run; choose another output\n")
    code, _, said = run("plot", turning, "--reference", picture_like, "-o", picture_like)
    assert (code, picture_like.read_bytes()) == (2, before)


def test_a_failed_run_leaves_the_old_picture(turning, tmp_path):
    """What was there stays when the input cannot be read."""
    target = tmp_path / "a.png"
    target.write_bytes(b"old")
    assert run("plot", turning, tmp_path / "none.csv", "-o", target)[0] == 2
    assert target.read_bytes() == b"old"
    assert not list(tmp_path.glob(".quatprop*"))


@pytest.mark.parametrize(
    "command",
    [
        ("plot", "{log}", "-o", "{pic}"),
        ("propagate", "{rates}", "-o", "{out}", "--plot", "{pic}", *RATE_OPTIONS),
        ("compare", "{log}", "{log}", "--plot", "{pic}"),
    ],
)
def test_without_matplotlib_the_way_to_it_is_told(turning, rates, tmp_path, command, monkeypatch):
    """The extra that is missing is named with the command that brings it; nothing is written."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    places = {
        "log": turning, "rates": rates, "out": tmp_path / "o.csv", "pic": tmp_path / "a.png"
    }  # fmt: skip
    code, _, said = run(*(part.format(**places) for part in command))
    assert (code, said) == (
        2,
        "Error: pictures need matplotlib, which is not installed; pip install matplotlib\n",
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rates.csv", "spin.csv"]


def test_pictures_are_drawn_without_pyplot(turning, tmp_path):
    """No state of matplotlib is left behind: pyplot is never imported."""
    sys.modules.pop("matplotlib.pyplot", None)
    assert run("plot", turning, "-o", tmp_path / "a.png")[0] == 0
    assert "matplotlib.pyplot" not in sys.modules


def test_rates_are_rows_with_units_and_a_spike_stands_out(rates):
    """Each axis of the gyroscope is a row in the unit of the log; one sample of 2.5 is drawn."""
    view = {"rates": rate_selection(), "show": "rates"}
    _, axes, _ = figure_of(rates, **view)
    assert [one.get_ylabel() for one in axes] == [f"rate {axis}\nrad/s" for axis in "xyz"]
    assert axes[-1].get_xlabel() == "time since 2023-11-14 22:13:20 UTC, s"
    (line,) = axes[1].get_lines()
    seconds, values = line.get_data()
    assert np.nanmax(values) == 2.5
    assert seconds[np.nanargmax(values)] == pytest.approx(1.23)


def rate_selection():
    """Return what the columns of the rates here are."""
    from quatprop.settings.selection import RateSelection

    return RateSelection(rate_cols=("1", "2", "3"), time_col="0", time_unit="ns", rate_unit="rad/s")


def test_attitudes_are_angles(turning):
    """Yaw goes around without bars, pitch and roll stay at zero; norms are right and left out."""
    _, axes, _ = figure_of(turning)
    assert [one.get_ylabel() for one in axes] == [
        "yaw\ndeg", "pitch\ndeg", "roll\ndeg",
    ]  # fmt: skip
    yaw = axes[0].get_lines()[0].get_ydata()
    assert np.isnan(yaw).sum() == 5
    assert np.nanmax(np.abs(np.diff(yaw))) < 2.0
    assert axes[0].get_yticks().tolist() == [-180, -90, 0, 90, 180]
    assert np.abs(axes[1].get_lines()[0].get_ydata()).max() == 0


def test_angles_are_drawn_beyond_half_a_turn_where_that_is_asked_for(turning, tmp_path):
    """Yaw goes on to five turns in one line; missing attitudes in between change nothing."""
    _, axes, _ = figure_of(turning, unwrap=True)
    yaw = axes[0].get_lines()[0].get_ydata()
    np.testing.assert_allclose(yaw, np.degrees(np.pi * np.arange(1000) * 0.01), atol=1e-9)
    t_ns, wxyz = spin(1000, np.pi)
    wxyz[95:99] = 0
    _, axes, _ = figure_of(write_attitudes(tmp_path / "a.csv", t_ns, wxyz), unwrap=True)
    again = axes[0].get_lines()[0].get_ydata()
    np.testing.assert_allclose(again[-800:], yaw[-800:], atol=1e-9)
    code, _, said = run("plot", turning, "--components", "--unwrap", "-o", tmp_path / "a.png")
    assert (code, said.splitlines()[-1]) == (
        2, "Error: --unwrap does not go with --components, which have no turns"
    )  # fmt: skip


def test_a_picture_has_the_size_that_is_asked_for(turning, tmp_path):
    """In mm, cm or inches, at the dots an inch; without a title there is no text but the axes'."""
    out = tmp_path / "a.png"
    run("plot", turning, "-o", out, "--size", "127x63.5mm", "--dpi", "100")
    assert struct.unpack(">II", out.read_bytes()[16:24]) == (500, 250)
    run("plot", turning, "-o", out, "--size", "4in", "--dpi", "50", "--font-size", "6")
    assert struct.unpack(">II", out.read_bytes()[16:24])[0] == 200
    styles = {"with": [], "without": ["--no-title"], "large": ["--font-size", "17"]}
    texts = {}
    for name, options in styles.items():
        run("plot", turning, "-o", tmp_path / "a.svg", *options)
        texts[name] = (tmp_path / "a.svg").read_text()
    assert "<!-- Hamilton q, body to reference" in texts["with"]
    assert "Hamilton" not in texts["without"]
    assert "<!-- Hamilton q, body to reference" in texts["large"]
    heights = {
        name: float(re.search(r'height="([\d.]+)pt"', text)[1]) for name, text in texts.items()
    }
    assert heights["without"] < heights["with"] < heights["large"]


@pytest.mark.parametrize("size", ["5", "0.5in", "3in x 4in", "1e9mm", "10x", "-3in", "3x0in"])
def test_a_size_that_cannot_be_is_one_sentence(turning, tmp_path, size):
    """Nothing is drawn."""
    code, _, said = run("plot", turning, "-o", tmp_path / "a.png", f"--size={size}")
    assert code == 2
    assert said.splitlines()[-1].endswith(
        f"'{size}' is not a size from 1in to 100in; write 90mm or 16x9cm"
    )
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    "options",
    [
        ["--size=40x30mm"], ["--size=2x1in"], ["--size=2x1in", "--no-title"], ["--size=1in"],
        ["--size=50x40mm"], ["--size=90x30mm"], ["--font-size=72"],
    ],
)  # fmt: skip
def test_a_picture_without_room_for_its_panels_names_the_size_that_does(turning, tmp_path, options):
    """One millimetre less would not do; a picture of that size is drawn."""
    picture = tmp_path / "a.png"
    code, _, said = run("plot", turning, "-o", picture, *options)
    assert (code, picture.exists()) == (2, False)
    sentence = re.fullmatch(
        r"Error: the panels and their letters do not fit into this picture; give at least "
        r"--size (\d+(?:x\d+)?)mm, or a smaller --font-size",
        said.splitlines()[-1],
    )
    width, *height = map(int, sentence[1].split("x"))
    more = ["--dpi=10", *options]
    least = "x".join(map(str, [width, *height]))
    assert run("plot", turning, "-o", picture, *more, f"--size={least}mm")[0] == 0
    less = f"{width}x{height[0] - 1}" if height else f"{width - 1}"
    assert run("plot", turning, "-o", picture, *more, f"--size={less}mm")[0] == 2


def test_components_are_the_quaternion_with_a_continuous_sign(tmp_path):
    """Of q and -q the one nearer to the row before is drawn: no leaps where a file has them."""
    t_ns, wxyz = spin(1000)
    flipped = wxyz * np.where(np.arange(1000) % 7 < 3, -1.0, 1.0)[:, None]
    path = write_attitudes(tmp_path / "a.csv", t_ns, flipped)
    _, axes, _ = figure_of(path, components=True)
    assert [one.get_ylabel() for one in axes[:4]] == ["qw", "qx", "qy", "qz"]
    drawn = np.array([one.get_lines()[0].get_ydata() for one in axes[:4]])
    np.testing.assert_allclose(drawn.T, -wxyz, atol=1e-15)


def test_gaps_are_shaded_where_they_are_and_break_the_line(tmp_path):
    """The shade reaches from the last sample before a gap to the first after it."""
    t_ns, wxyz = spin(1000)
    kept = np.r_[0:300, 500:1000]
    path = write_attitudes(tmp_path / "a.csv", t_ns[kept], wxyz[kept])
    _, axes, drawn = figure_of(path)
    np.testing.assert_allclose(drawn.gaps[0], [[2.99, 5.0]])
    (shade,) = axes[1].collections
    np.testing.assert_allclose(shade.get_paths()[0].get_extents().intervalx, [2.99, 5.0])
    assert np.isnan(axes[1].get_lines()[0].get_ydata()).sum() == 1
    assert run("plot", path, "-o", tmp_path / "a.png")[2].splitlines()[1] == (
        "warning: 1 gap longer than 100 ms, the longest 2.01 s: shaded, "
        f"first at {T0 + 5 * 10**9} ns"
    )


def edges(axes):
    """Return the seconds and the lower and upper edge of the area that is shaded in axes."""
    (area,) = axes.collections
    corners = np.concatenate([path.vertices for path in area.get_paths()])
    seconds = np.unique(corners[:, 0])
    at = [corners[corners[:, 0] == second, 1] for second in seconds]
    return seconds, np.array([one.min() for one in at]), np.array([one.max() for one in at])


def with_sigmas(path, t_ns, wxyz, sigmas):
    """Write a CSV of attitudes with standard deviations about the body axes, rad."""
    table = np.column_stack([wxyz, np.broadcast_to(sigmas, (len(t_ns), 3))]).tolist()
    rows = (",".join([str(t), *map(repr, row)]) for t, row in zip(t_ns, table, strict=True))
    header = "t_ns,qw,qx,qy,qz,sigma_x,sigma_y,sigma_z"
    path.write_text(f"{header}\n" + "\n".join(rows) + "\n")
    return path


def test_standard_deviations_are_shaded_about_the_angles(tmp_path):
    """As SciPy's angles spread when the attitude is turned about its body axes by random errors."""
    angles = [[170, 50, -30], [190, 50, -30], [20, -40, 60]]
    truth = Rotation.from_euler("ZYX", angles, degrees=True)
    sigmas = np.array([0.001, 0.002, 0.003])
    t_ns = T0 + np.arange(3) * STEP
    path = with_sigmas(tmp_path / "a.csv", t_ns, truth.as_quat(scalar_first=True), sigmas)
    _, axes, _ = figure_of(path)
    assert [one.get_ylabel() for one in axes] == [
        "yaw\ndeg", "pitch\ndeg", "roll\ndeg", "1 sigma error\ndeg",
    ]  # fmt: skip
    np.testing.assert_allclose(
        axes[3].get_lines()[0].get_ydata(), np.degrees(np.linalg.norm(sigmas)), rtol=1e-12
    )
    errors = np.random.default_rng(1).normal(size=(200_000, 3)) * sigmas
    for row, attitude in enumerate(truth):
        spread = (attitude * Rotation.from_rotvec(errors)).as_euler("ZYX", degrees=True)
        middle = attitude.as_euler("ZYX", degrees=True)
        for column, one in enumerate(axes[:3]):
            seconds, low, high = edges(one)
            (at,) = np.nonzero(np.isclose(seconds, row * 0.01))
            want = np.std((spread[:, column] - middle[column] + 180) % 360 - 180)
            assert (high - low)[at] / 2 == pytest.approx(want, rel=0.01)
            assert (high + low)[at] / 2 == pytest.approx(middle[column], abs=1e-9)
    _, axes, _ = figure_of(path, components=True)
    raw = (truth[0] * Rotation.from_rotvec(errors)).as_quat(scalar_first=True)
    for column, one in enumerate(axes[:4]):
        _, low, high = edges(one)
        assert (high - low)[0] / 2 == pytest.approx(np.std(raw[:, column]), rel=0.01)


def test_a_file_without_standard_deviations_lies_over_one_with_them(tmp_path):
    """What one of them expects is shown of that one; unknown and zero ones are not shown."""
    t_ns, wxyz = spin(100)
    plain = write_attitudes(tmp_path / "a.csv", t_ns, wxyz)
    sure = with_sigmas(tmp_path / "b.csv", t_ns, wxyz, [0.1, 0.1, 0.1])
    exact = with_sigmas(tmp_path / "c.csv", t_ns, wxyz, [0.0, 0.0, 0.0])
    _, axes, _ = figure_of(plain, sure)
    assert len(axes) == 4
    assert len(axes[3].get_lines()) == 2
    _, axes, _ = figure_of(plain, exact)
    assert len(axes) == 3


def test_errors_about_the_axes_have_their_standard_deviation_shaded(tmp_path, monkeypatch):
    """About zero, in degrees, as the file says."""
    t_ns, wxyz = spin(100)
    sigmas = np.radians([1.0, 2.0, 3.0])
    new = with_sigmas(tmp_path / "new.csv", t_ns, wxyz, sigmas)
    truth = write_attitudes(tmp_path / "truth.csv", *spin(100))
    axes, _ = drawn_error(monkeypatch, "compare", new, truth, "--plot", tmp_path / "a.png")
    for panel, sigma in zip(axes.figure.axes[1:], [1.0, 2.0, 3.0], strict=True):
        _, low, high = edges(panel)
        np.testing.assert_allclose([low, high], [[-sigma] * 100, [sigma] * 100], rtol=1e-9)


def test_propagate_shades_what_it_expects(rates, tmp_path, monkeypatch):
    """With --sigma, and only with it."""
    options = (*RATE_OPTIONS, "--noise-density", "1deg/sqrt(s)", "--plot", tmp_path / "a.png")
    axes, _ = drawn_error(
        monkeypatch, "propagate", rates, "-o", tmp_path / "o.csv", "--sigma", *options
    )
    want = np.sqrt(3 * 4.99)
    assert axes.figure.axes[-1].get_lines()[0].get_ydata()[-1] == pytest.approx(want, rel=1e-6)


def test_a_norm_that_is_off_is_drawn_as_it_is(tmp_path):
    """The norm error shows what the file says, of rows that no rotation would pass for too."""
    t_ns, wxyz = spin(1000)
    wxyz[400] *= 1.25
    wxyz[600:610] = 0
    path = write_attitudes(tmp_path / "a.csv", t_ns, wxyz)
    _, axes, _ = figure_of(path)
    norm = axes[3].get_lines()[0].get_ydata()
    assert np.nanmax(norm) == pytest.approx(0.25)
    assert np.isnan(norm).any()
    code, _, said = run("plot", path, "-o", tmp_path / "a.png")
    assert code == 0
    assert said.splitlines()[1] == (
        "warning: 10 invalid quaternions (zero, absent or not finite): not drawn"
    )


def test_one_sample_is_a_point_and_a_constant_is_no_noise(tmp_path):
    """A line of one point would be invisible; the rounding of a constant is not blown up."""
    t_ns, wxyz = spin(200)
    _, axes, _ = figure_of(write_attitudes(tmp_path / "one.csv", t_ns[:1], wxyz[:1]))
    assert axes[0].get_lines()[1].get_marker() == "."
    assert axes[0].get_xlim() == (-0.5, 0.5)
    still = np.tile(wxyz[77], (200, 1))
    still[::2, 3] += 1e-16
    _, axes, _ = figure_of(write_attitudes(tmp_path / "still.csv", t_ns, still))
    low, high = axes[0].get_ylim()
    assert high - low > 1


def test_files_are_laid_over_one_another_in_colours_that_all_can_tell(turning, tmp_path):
    """Each file has its colour of the palette of Okabe and Ito, and a place in the legend."""
    other = write_attitudes(tmp_path / "_other$x$.csv", *spin(1000, 1.0))
    figure, axes, _ = figure_of(turning, other)
    assert [line.get_color() for line in axes[0].get_lines()] == ["#0072B2", "#E69F00"]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "spin.csv: qw,qx,qy,qz quatprop",
        "_other$x$.csv: qw,qx,qy,qz quatprop",
    ]
    assert run("plot", turning, other, "-o", tmp_path / "a.png")[0] == 0
    okabe_ito = {
        "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
    }  # fmt: skip
    assert {*palette.FILES, *palette.AXES.values()} <= okabe_ito
    pairs = {(palette.colour_of(file), palette.stroke_of(file)) for file in range(28)}
    assert len(pairs) == 28


def test_files_of_other_times_begin_together(turning, tmp_path):
    """Recordings that do not overlap are laid over one another from their own starts."""
    t_ns, wxyz = spin(1000)
    other = write_attitudes(tmp_path / "later.csv", t_ns + 10**15, wxyz)
    _, axes, drawn = figure_of(turning, other)
    assert axes[-1].get_xlabel() == "time since the start of each file, s"
    assert drawn.starts == (T0, T0 + 10**15)
    assert all(line.get_xdata()[0] == 0 for line in axes[0].get_lines())


def test_files_with_different_things_to_show_are_refused(turning, rates, tmp_path):
    """Rates and attitudes have no common rows."""
    code, _, said = run("plot", rates, turning, "-o", tmp_path / "a.png", "--rate-unit", "rad/s")
    assert code == 2
    assert said == (
        "Error: rates.csv shows rate x in rad/s and spin.csv yaw in deg; draw them apart, or "
        "choose with --show\n"
    )


def test_a_file_with_neither_rates_nor_attitudes_is_told_so(tmp_path):
    """What the file has instead is listed, with both ways out."""
    path = tmp_path / "a.parquet"
    pyarrow.parquet.write_table(pa.table({"t_ns": [0, 1], "height": [1.0, 2.0]}), path)
    code, _, said = run("plot", path, "-o", tmp_path / "a.png")
    assert code == 2
    assert said == (
        f"Error: {path}: no body rates or attitudes found; its columns are 't_ns', "
        "'height'; name the columns with --rate-cols or --quat-cols and --time-col\n"
    )


def test_a_part_of_a_series_can_be_drawn(turning, rates, tmp_path):
    """--start and --end cut rates and attitudes alike, relative to either end."""
    for path in (turning, rates):
        code, _, said = run(
            "plot", path, "-o", tmp_path / "a.svg", "--start", "+1s", "--end", "-1s",
            "--rate-unit", "rad/s",
        )  # fmt: skip
        assert code == 0
        samples, span = (800, "7.99") if path == turning else (300, "2.99")
        assert f": {samples} samples over {span} s, 100 Hz" in said
    code, _, said = run("plot", turning, "-o", tmp_path / "a.svg", "--start", "+1h")
    assert code == 2
    assert said == (
        f"Error: {turning}: no samples in 'qw,qx,qy,qz' between --start and --end: 1000 are "
        "before, 0 after; the log is 9.99 s long\n"
    )


def test_a_part_is_relative_to_the_latest_stamp_of_rates_and_of_attitudes(tmp_path):
    """Not to the last one read, where stamps are not in order."""
    t_ns = T0 + np.array([0, 1, 2, 3, 4, 1]) * 1_000_000_000
    attitudes = write_attitudes(tmp_path / "q.csv", t_ns, np.tile([1.0, 0, 0, 0], (6, 1)))
    rates = write_rates(tmp_path / "w.csv", t_ns, np.ones((6, 3)))
    for path in (attitudes, rates):
        code, _, said = run(
            "plot", path, "-o", tmp_path / "a.svg", "--start", "-1s", "--rate-unit", "rad/s"
        )
        assert code == 0
        assert ": 2 samples over 1 s, 1 Hz" in said


def reference_pair(tmp_path):
    """Write a series and one that is off by a ramp up to 2 degrees, and by 5 in one sample."""
    t_ns, wxyz = spin(1001)
    off = np.zeros((1001, 3))
    off[:, 0] = np.radians(np.linspace(0, 2, 1001))
    off[300, 0] = np.radians(5)
    return (
        write_attitudes(tmp_path / "new.csv", t_ns, multiply(wxyz, exp(off))),
        write_attitudes(tmp_path / "truth.csv", t_ns, wxyz),
    )


def legend_of(axes):
    """Return the texts of the legend of the figure that has these axes."""
    return [text.get_text() for text in axes.figure.legends[0].get_texts()]


def drawn_error(monkeypatch, *arguments):
    """Return the axes of the error that a command draws, and what it gave."""
    figures = []
    original = draw.figure
    monkeypatch.setattr(draw, "figure", lambda *how: figures.append(original(*how)) or figures[-1])
    given = run(*arguments)
    return figures[0].axes[0], given


@pytest.mark.parametrize("command", ["plot", "compare"])
def test_an_error_has_its_tolerance_first_and_worst_marked(tmp_path, monkeypatch, command):
    """The line is the geodesic angle in degrees; the tolerance, the first sample above it and
    the worst sample are where they belong.
    """
    new, truth = reference_pair(tmp_path)
    arguments = {
        "plot": ("plot", new, "--reference", truth, "-o", tmp_path / "a.png"),
        "compare": ("compare", new, truth, "--plot", tmp_path / "a.png"),
    }[command]
    axes, (code, _, _) = drawn_error(monkeypatch, *arguments, "--tol", "1deg")
    assert code == (1 if command == "compare" else 0)
    error, level, worst = axes.get_lines()
    want = np.linspace(0, 2, 1001)
    want[300] = 5
    np.testing.assert_allclose(error.get_ydata(), want, atol=1e-9)
    assert level.get_ydata()[0] == pytest.approx(1.0)
    assert worst.get_xydata()[0] == pytest.approx([3.0, 5.0])
    # Nothing is written over the line.
    assert not axes.texts
    assert legend_of(axes) == [
        "tolerance 1 deg", "first above the tolerance, and worst: 5 deg at 3 s"
    ]  # fmt: skip
    for about, panel in zip("xyz", axes.figure.axes[1:], strict=True):
        assert panel.get_ylabel() == f"error {about}\ndeg"
        (drawn,) = panel.get_lines()
        np.testing.assert_allclose(drawn.get_ydata(), want if about == "x" else 0, atol=1e-9)


def test_the_first_sample_above_the_tolerance_is_marked_beside_the_worst(tmp_path, monkeypatch):
    """Where they are two samples, each has its own sign and words."""
    new, truth = reference_pair(tmp_path)
    axes, (code, _, said) = drawn_error(
        monkeypatch, "plot", new, "--reference", truth, "-o", tmp_path / "a.png", "--tol", "0.5deg"
    )
    assert code == 0
    assert legend_of(axes) == [
        "tolerance 0.5 deg", "first above the tolerance at 2.51 s", "worst: 5 deg at 3 s",
    ]  # fmt: skip
    assert said.splitlines()[0] == (
        "new.csv: max 5 deg, RMS 1.166 deg; above the tolerance of 0.5 deg"
    )


@pytest.mark.parametrize("command", ["plot", "compare"])
def test_errors_over_windows_are_drawn_beside_the_error(tmp_path, monkeypatch, command):
    """As scipy has the rotations over each second, drawn where the second begins."""
    new, truth = reference_pair(tmp_path)
    arguments = {
        "plot": ("plot", new, "--reference", truth, "-o", tmp_path / "a.png"),
        "compare": ("compare", new, truth, "--plot", tmp_path / "a.png"),
    }[command]
    axes, (code, _, _) = drawn_error(monkeypatch, *arguments, "--window", "1s")
    assert code == 0
    error, window = axes.get_lines()[:2]
    assert len(error.get_ydata()) == 1001
    over = []
    for path in (new, truth):
        wxyz = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(1, 2, 3, 4))
        attitude = Rotation.from_quat(wxyz, scalar_first=True)
        over.append(attitude[:-100].inv() * attitude[100:])
    want = np.degrees((over[0].inv() * over[1]).magnitude())
    np.testing.assert_allclose(window.get_ydata(), want, atol=1e-9)
    np.testing.assert_allclose(window.get_xdata(), np.arange(901) * 0.01, atol=1e-9)
    assert legend_of(axes)[1] == f"over 1 s: max {want.max():.4g} deg, from where each begins"


def test_an_error_far_from_its_tolerance_has_a_logarithmic_axis(tmp_path, monkeypatch):
    """A tolerance of a millionth of the error is still seen."""
    new, truth = reference_pair(tmp_path)
    axes, _ = drawn_error(
        monkeypatch, "plot", new, "--reference", truth, "-o", tmp_path / "a.png", "--tol", "1e-6deg"
    )
    assert axes.get_yscale() == "log"
    low, high = axes.get_ylim()
    assert low < 1e-6
    assert high > 5


def test_options_of_the_reference_need_one(turning, tmp_path):
    """What would have no effect is refused; what an error has no room for, too."""
    code, _, said = run("plot", turning, "-o", tmp_path / "a.png", "--tol", "1deg")
    assert (code, said.splitlines()[-1]) == (2, "Error: --tol goes with --reference")
    code, _, said = run("plot", turning, "-o", tmp_path / "a.png", "--topic-ref", "/a")
    assert (code, said.splitlines()[-1]) == (2, "Error: --topic-ref goes with --reference")
    code, _, said = run(
        "plot", turning, "-o", tmp_path / "a.png", "--reference", turning, "--components"
    )
    assert (code, said.splitlines()[-1]) == (
        2, "Error: --components does not go with --reference, which draws an error"
    )  # fmt: skip


def test_propagate_draws_rates_and_the_attitudes_it_wrote(rates, tmp_path, monkeypatch):
    """One picture of both, and the same attitudes in the file as without it."""
    plain, out = tmp_path / "plain.csv", tmp_path / "out.csv"
    run("propagate", rates, "-o", plain, *RATE_OPTIONS)
    figures = []
    original = draw.figure
    monkeypatch.setattr(draw, "figure", lambda *how: figures.append(original(*how)) or figures[-1])
    code, _, _ = run("propagate", rates, "-o", out, *RATE_OPTIONS, "--plot", tmp_path / "a.pdf")
    assert code == 0
    assert out.read_bytes() == plain.read_bytes()
    labels = [one.get_ylabel().split("\n")[0] for one in figures[0].axes]
    assert labels == ["rate x", "rate y", "rate z", "yaw", "pitch", "roll"]
    pitch = figures[0].axes[4].get_lines()[0].get_ydata()
    assert pitch[-1] == pytest.approx(np.degrees(2.5 * 0.01))


def test_attitudes_at_a_slower_rate_are_no_gaps(rates, tmp_path, monkeypatch):
    """--rate 1 leaves intervals of 100 samples: they are joined by a line all the same."""
    figures = []
    original = draw.figure
    monkeypatch.setattr(draw, "figure", lambda *how: figures.append(original(*how)) or figures[-1])
    code, _, _ = run(
        "propagate", rates, "-o", tmp_path / "o.csv", *RATE_OPTIONS, "--rate", "1",
        "--plot", tmp_path / "a.png",
    )  # fmt: skip
    assert code == 0
    assert not np.isnan(figures[0].axes[3].get_lines()[0].get_ydata()).any()


def test_the_picture_of_propagate_goes_nowhere_else(rates, tmp_path):
    """It takes the place neither of the log nor of the attitudes."""
    target = tmp_path / "same.svg"
    code, _, said = run(
        "propagate", rates, "-o", target, "--to", "csv", *RATE_OPTIONS, "--plot", target
    )
    assert (code, said) == (
        2, f"Error: {target}: two outputs of the run would go here; choose another\n"
    )  # fmt: skip
    assert not target.exists()


def test_whoever_says_which_attitudes_wants_attitudes(shared_logs, tmp_path):
    """--components and the like draw the orientation of a log that has rates as well."""
    log, target = shared_logs / "husky" / "test1_husky.bag", tmp_path / "a.svg"
    plain, shown = run("plot", log, "-o", target), target.read_text()
    assert plain[0] == 0
    assert "rate x" in shown
    assert run("plot", log, "-t", "/imu/data", "--components", "-o", target)[0] == 0
    assert "<!-- qw -->" in target.read_text()
    code, _, said = run("plot", log, "--components", "--show", "rates", "-o", target)
    assert (code, said.splitlines()[-1]) == (2, "Error: --components goes with --show attitude")


@pytest.mark.parametrize("suffix", ["png", "html"])
def test_what_is_lost_of_a_damaged_log_is_said(tmp_path, suffix):
    """A log that was cut off is drawn as far as it goes: exit code 3, and the page says so."""
    whole, cut = tmp_path / "a.mcap", tmp_path / "b.mcap"
    run("simulate", whole, "--truth", "none", "--samples", "2000", "--compression", "none")
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    target = tmp_path / f"a.{suffix}"
    code, _, said = run("plot", cut, "-o", target)
    assert code == 3
    (lost,) = [line for line in said.splitlines() if "lost: " in line]
    if suffix == "html":
        assert lost.removeprefix("warning: ")[:30] in target.read_text()


def test_what_looks_wrong_with_rates_is_said_below_them(tmp_path):
    """The remarks of the other commands are those of a picture too."""
    still = write_rates(tmp_path / "a.csv", T0 + np.arange(300) * STEP, np.zeros((300, 3)))
    code, _, said = run("plot", still, "-o", tmp_path / "a.png", "--rate-unit", "rad/s")
    assert code == 0
    assert "warning: every rate is zero: is this the right topic?" in said.splitlines()


def test_only_what_draws_knows_of_matplotlib():
    """What is reduced and shown is told apart from how it is drawn."""
    room = Path(draw.__file__).parent
    know = {path.name for path in room.glob("*.py") if "matplotlib." in path.read_text()}
    assert know == {"draw.py", "figure.py", "axes.py"}


@pytest.mark.parametrize(
    ("t_ns", "text"),
    [
        (0, "0 s of its clock"),
        (-1_500_000_000, "-1.5 s of its clock"),
        (1_700_000_000_000_000_001, "2023-11-14 22:13:20.000000001 UTC"),
        (2**63 - 1, "2262-04-11 23:47:16.854775807 UTC"),
    ],
)
def test_the_start_is_told_to_the_nanosecond(t_ns, text):
    """A clock that counts from boot is not taken for the year 1970."""
    assert instant_text(t_ns) == text


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("suffix", ["svg", "png", "pdf", "html"])
def test_numbers_of_a_damaged_log_are_drawn_without_warnings(tmp_path, suffix):
    """Numbers whose difference is not finite, and NaNs that signal, are in damaged logs."""
    path = tmp_path / "rates.npy"
    rows = np.zeros(50, [("t_ns", "<i8"), ("wx", "<f8"), ("wy", "<f8"), ("wz", "<f8")])
    rows["t_ns"] = STEP * np.arange(50)
    rows["wx"][10:12] = 1.7e308, -1.7e308
    rows["wy"].view(np.uint64)[20] = 0x7FF0000000000001  # a signalling NaN
    rows["wz"][30] = 1e308
    np.save(path, rows)
    code, _, _ = run("plot", path, "-o", tmp_path / f"rates.{suffix}")
    assert code == 0


def test_titles_that_look_like_mathematics_are_text(tmp_path):
    """A dollar sign in a name is a dollar sign, in every kind of picture."""
    path = write_attitudes(tmp_path / r"$\frac{1$ _x^.csv", *spin(50))
    for suffix in ("png", "svg", "pdf", "html"):
        assert run("plot", path, "-o", tmp_path / f"a.{suffix}")[0] == 0


def test_recordings_are_drawn(shared_logs, tmp_path):
    """Real logs of each kind come out as a picture with what is said about them."""
    for name, said in (
        ("auk/auk.bag", "auk.bag: /auk/fcu/imu sensor_msgs/msg/Imu: 5,580 samples over 111.579 s"),
        ("csv/xio3/Quaternion.csv", "x-io: 500 samples over 9.99704 s"),
    ):
        code, _, told = run("plot", shared_logs / name, "-o", tmp_path / "a.png")
        assert code == 0
        assert said in told
