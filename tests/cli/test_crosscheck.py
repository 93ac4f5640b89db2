"""``quatprop crosscheck`` prints findings with options that work, and exits by what it found."""

import json
import re
import shlex
import sys
from itertools import combinations

import numpy as np
import pytest
from make.commands import refused, run
from make.rigs import CHANGES, DEG, FAULTS, GYRO, MOCAP, ORIENTATION, rig
from make.ros import TF, imu_messages, write_messages
from make.tables import write_attitudes, write_rates
from matplotlib import rc_context

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.kinematics.quaternion import conjugate, exp, multiply
from quatprop.tools.plot import figure as draw
from quatprop.tools.plot import panels as palette
from quatprop.tools.plot.picture import Group, Matrix, Page, PlottedFile, Quantity, picture
from quatprop.tools.plot.reduction import Reduction

POSE = "geometry_msgs/msg/PoseStamped"


def bag(path, sources):
    """Write a rig as a log of messages; return the path."""
    gyro, orientation, mocap = (sources[name] for name in (GYRO, ORIENTATION, MOCAP))
    messages = [*imu_messages(gyro.t_ns, gyro.values, orientation.values)]
    for t_ns, (w, *xyz) in zip(mocap.t_ns.tolist(), mocap.values.tolist(), strict=True):
        pose = {"header": {"stamp": t_ns}, "pose": {"orientation": [*xyz, w]}}
        messages.append(("/mocap", POSE, t_ns, pose))
    return write_messages(path, sorted(messages, key=lambda one: one[2]))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """Return a log in which nothing is wrong."""
    return bag(tmp_path_factory.mktemp("healthy") / "rig.mcap", rig())


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """Return a log whose motion capture is late."""
    return bag(tmp_path_factory.mktemp("late") / "rig.mcap", FAULTS["late"][0](rig(3)))


def test_a_healthy_log_is_one_line(healthy):
    """Nothing but the number of sources and that they agree."""
    said = run("crosscheck", healthy, code=0)
    assert said.stdout == "3 sources of rotation, consistent\n"


def test_a_log_without_sources_has_a_report_too(tmp_path):
    """It was a bug with --json."""
    (tmp_path / "a.csv").write_text("t_ns,temp\n0,1\n1,2\n")
    report = json.loads(run("crosscheck", tmp_path / "a.csv", "--json", code=2).stdout)
    assert (report["state"], report["sources"], report["agreeing"]) == (
        "nothing to compare",
        [],
        [],
    )


def test_unrelated_sources_fail_unless_that_is_allowed(tmp_path):
    """Alone, or with another source that agrees with one of them."""
    for number, name in enumerate(("a.csv", "b.csv", "c.csv")):
        one = rig(5 if name == "c.csv" else 3)[GYRO]
        values = one.values + np.random.default_rng(number).normal(0, 1e-3, one.values.shape)
        rows = zip(one.t_ns.tolist(), *values.T.tolist(), strict=True)
        write_rates(tmp_path / name, rows, "t_ns,wx (rad/s),wy (rad/s),wz (rad/s)")
    words = [tmp_path / name for name in ("a.csv", "c.csv")]
    assert "have nothing in common" in run("crosscheck", *words, code=1).stdout
    said = run("crosscheck", *words, "--allow", "unrelated", code=0).stdout
    assert said.startswith("2 sources of rotation, whose differences are allowed\n")
    words.append(tmp_path / "b.csv")
    said = run("crosscheck", *words, "--allow", "unrelated", code=0).stdout
    assert said.startswith("3 sources of rotation, 2 consistent, nothing shown of ")
    assert "c.csv\n" in said.splitlines(keepends=True)[0]


def test_a_corrected_log_is_consistent(tmp_path):
    """The command line that is printed applies every remedy."""
    faulty = FAULTS["late"][0](FAULTS["deg/s read as rad/s"][0](rig(8)))
    log = bag(tmp_path / "rig.mcap", faulty)
    lines = run("crosscheck", log, code=1).stdout.splitlines()
    assert lines[0] == "3 sources of rotation, inconsistent"
    assert lines[1].startswith("fault    /imu rates  deg/s read as rad/s")
    assert lines[1].endswith("   --rate-unit deg/s")
    assert lines[2].startswith("differs  /mocap      is late by ")
    head, *again = shlex.split(lines[-1].removeprefix("corrected: "))
    assert head == "quatprop"
    assert run(*again, code=0).stdout == "3 sources of rotation, consistent\n"


def test_remedies_are_options_of_the_commands_that_read_the_source(tmp_path):
    """A source read with the option of a finding agrees with the other sources."""
    faulty = FAULTS["conjugate"][0](FAULTS["deg/s read as rad/s"][0](rig(9)))
    log = bag(tmp_path / "rig.mcap", faulty)
    remedies = [one.remedy for one in quatprop.crosscheck(log).findings]
    assert remedies == ["--from-direction ref-to-body", "--rate-unit deg/s"]
    with pytest.warns(quatprop.RemarkWarning, match="read in deg/s, as requested"):
        rates = quatprop.read_rates(f"{log}:/imu", rate_unit="deg/s")
    attitudes = quatprop.read_attitudes(f"{log}:/imu", from_direction="ref-to-body")
    assert quatprop.crosscheck(rates, attitudes, f"{log}:/mocap").passed


def test_a_configuration_repairs_the_gyroscope_for_propagate(tmp_path):
    """With it, propagate gives the attitudes of the motion capture; other sources are no part."""
    faulty = FAULTS["late"][0](FAULTS["mount"][0](FAULTS["deg/s read as rad/s"][0](rig(8))))
    log, made = bag(tmp_path / "rig.mcap", faulty), tmp_path / "made.toml"
    said = run("crosscheck", log, "--write-config", made, code=1)
    assert "inconsistent" in said.stdout
    assert made.read_text().splitlines() == [
        "# quatprop propagate LOG -o OUT --config THIS_FILE",
        "# by quatprop crosscheck, for '/imu rates'",
        'topic = "/imu"',
        'rate-unit = "deg/s"',
    ]
    assert run("crosscheck", log, "--write-config", "-", code=1).stdout == made.read_text()
    run("propagate", log, "-o", tmp_path / "out.csv", "--config", made, code=0)
    limits = ("--align", "mount", "--time-offset", "auto", "--tol", "4deg")
    run("compare", tmp_path / "out.csv", f"{log}:/mocap", *limits, code=0)


def test_a_configuration_is_written_for_one_gyroscope(tmp_path):
    """Not if none is wrong or several are, nor over a log."""
    sources = rig(3)
    gyro = sources[GYRO]
    table(tmp_path / "a.csv", gyro.t_ns, gyro.values)
    truth = write_attitudes(tmp_path / "truth.csv", sources[MOCAP].t_ns, sources[MOCAP].values)
    made = tmp_path / "made.toml"
    said = refused("crosscheck", truth, truth, "--write-config", made)
    assert said == "Error: there is no gyroscope to write a configuration for"
    assert not made.exists()
    table(tmp_path / "b.csv", gyro.t_ns, gyro.values)
    both = (tmp_path / "a.csv", tmp_path / "b.csv", "--write-config")
    assert refused("crosscheck", *both, made).startswith("Error: no finding is about a gyroscope")
    assert refused("crosscheck", *both, tmp_path / "b.csv").startswith(
        f"Error: {tmp_path / 'b.csv'}"
    )


@pytest.mark.filterwarnings("ignore:.*it is taken as that of the body:quatprop.RemarkWarning")
def test_a_mounting_is_repaired_by_the_option_that_is_printed(tmp_path):
    """--mount of propagate takes the exchange of axes as it is printed."""
    log = bag(tmp_path / "rig.mcap", FAULTS["axes"][0](rig(9)))
    (finding,) = quatprop.crosscheck(log).findings
    mount = finding.remedy.removeprefix("--mount=")
    turned = quatprop.propagate(f"{log}:/imu", mount=mount, method="coning", q0="log")
    assert quatprop.crosscheck(turned, f"{log}:/mocap", tol_mount="5deg").passed


def test_json_has_everything(late):
    """Sources, findings and pairs, with values and their standard deviations."""
    report = json.loads(run("crosscheck", late, "--json", code=1).stdout)
    assert report["schema"] == "quatprop-crosscheck-1"
    assert (report["state"], report["exit"]) == ("inconsistent", 1)
    assert [one["name"] for one in report["sources"]] == [GYRO, ORIENTATION, MOCAP]
    (finding,) = report["findings"]
    assert (finding["level"], finding["code"], finding["source"]) == ("differs", "offset", MOCAP)
    assert finding["settings"]["time_offset"].endswith("ms")
    assert {one["status"] for one in report["pairs"]} == {"related"}
    assert all(one["offset_sigma_s"] > 0 for one in report["pairs"])


def test_limits_and_allowed_differences(late):
    """A difference within its limit is not stated, and an allowed one is a remark."""
    assert run("crosscheck", late, "--tol-offset", "200ms", code=0).stdout.count("\n") == 1
    lines = run("crosscheck", late, "--allow", "offset,mount", code=0).stdout.splitlines()
    assert lines[1].startswith("remark   /mocap")


def test_files_are_compared_too(tmp_path):
    """Two tables on one clock."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rows = np.column_stack((gyro.t_ns, gyro.values)).tolist()
    rates = write_rates(tmp_path / "rates.csv", [[int(t), *w] for t, *w in rows],
                        "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")  # fmt: skip
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, mocap.values)
    said = run("crosscheck", rates, poses, code=0).stdout
    assert said == "2 sources of rotation, consistent\n"


def test_an_undeclared_unit_and_layout_are_decided(tmp_path):
    """A unit and an order that nobody stated are hypotheses that the other source decides."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rows = [[t, *w] for t, w in zip(gyro.t_ns.tolist(), (gyro.values / DEG).tolist(), strict=True)]
    rates = write_rates(tmp_path / "rates.csv", rows, "t_ns,wx,wy,wz")
    xyzw = np.roll(mocap.values, -1, axis=1)
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, xyzw, "t_ns,a,b,c,d")
    result = quatprop.crosscheck(rates, poses, quat_cols="a,b,c,d")
    assert [(one.code, one.source) for one in result.findings] == [
        ("reading", "poses.csv"), ("unit", "rates.csv")
    ]  # fmt: skip
    assert result.findings[0].settings == {"from_layout": "scalar-last"}
    assert result.findings[1].settings == {"rate_unit": "deg/s"}


def test_each_transform_is_a_source(tmp_path):
    """Links of a robot are different bodies: they are not compared with each other."""
    sources = rig(2)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    seconds = (mocap.t_ns - mocap.t_ns[0])[:, None] * 1e-9
    arm = exp(np.sin(seconds * [0.7, 1.1, 0.3]))
    messages = [*imu_messages(gyro.t_ns, gyro.values)]
    for t_ns, body, link in zip(mocap.t_ns.tolist(), mocap.values, arm, strict=True):
        transforms = [
            {"header": {"stamp": t_ns, "frame_id": parent}, "child_frame_id": child,
             "transform": {"rotation": [*q[1:].tolist(), float(q[0])]}}
            for parent, child, q in (("map", "base", body), ("base", "arm", link))
        ]  # fmt: skip
        messages.append(("/tf", TF, t_ns, {"transforms": transforms}))
    path = write_messages(tmp_path / "rig.mcap", sorted(messages, key=lambda one: one[2]))
    result = quatprop.crosscheck(path)
    assert {one.name for one in result.sources} >= {"/tf map:base", "/tf base:arm"}
    assert {pair.b.name for pair in result.pairs if pair.status == "related"} == {"/tf map:base"}
    assert result.passed


def test_series_in_memory_are_sources():
    """A notebook compares what it has."""
    sources = rig(5)
    rates = GyroSeries(sources[GYRO].t_ns, sources[GYRO].values)
    truth = AttitudeSeries(sources[MOCAP].t_ns, sources[MOCAP].values)
    assert quatprop.crosscheck(rates, truth).passed
    turned = AttitudeSeries(truth.t_ns, multiply(truth.wxyz, exp(np.array([0.0, 0.2, 0.0]))))
    wrong = AttitudeSeries(truth.t_ns, conjugate(truth.wxyz))
    assert [one.code for one in quatprop.crosscheck(rates, turned).findings] == ["mount"]
    assert [one.code for one in quatprop.crosscheck(rates, wrong).findings] == ["reading"]


def test_one_source_is_nothing_to_compare(tmp_path):
    """Exit code 2, with the reason."""
    gyro = rig()[GYRO]
    log = write_messages(tmp_path / "gyro.mcap", imu_messages(gyro.t_ns, gyro.values))
    assert run("crosscheck", log, code=2).stdout == "2 sources of rotation, nothing to compare\n"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--correct", "rate-unit=deg/s"], "'rate-unit=deg/s' is not a setting of a source"),
        (["--correct", "/imu:unit=deg/s"], "'unit' is not one of 'from_layout'"),
        (["--correct", "/nowhere:rate-unit=deg/s"], "no source '/nowhere'"),
        (["--correct", "/imu rates:mount=x,y,z,w"], "'x,y,z,w' is not a mounting"),
        (["--allow", "everything"], "'everything' is not one of"),
        (["--tol-mount", "2parsec"], "'2parsec' is not an angle"),
    ],
)
def test_refusals(healthy, options, sentence):
    """A mistake is named in one sentence."""
    assert sentence in refused("crosscheck", healthy, *options)


@pytest.mark.parametrize("row", [20, 1500])
def test_one_timestamp_far_ahead_does_not_hide_what_follows(tmp_path, row):
    """All samples after it were left out as earlier."""
    rates, truth = quatprop.simulate(motion="tumbling", duration="30s")
    t_ns, rate = rates.t_ns.copy(), rates.rate
    t_ns[row] += 3_600_000_000_000
    path = write_rates(
        tmp_path / "rates.csv",
        [(t, *w) for t, w in zip(t_ns.tolist(), rate.tolist(), strict=True)],
        "t_ns,wx_rad_s,wy_rad_s,wz_rad_s",
    )
    reference = write_attitudes(tmp_path / "truth.csv", truth.t_ns, truth.wxyz)
    said = json.loads(run("crosscheck", path, reference, "--json", code=3).stdout)
    (used,) = (one for one in said["sources"] if one["kind"] == "rates")
    assert used["samples"] == len(rates) - 1


def table(path, t_ns, rate):
    """Write rates as a table; return the path."""
    path.parent.mkdir(exist_ok=True)
    rows = [(t, *w) for t, w in zip(t_ns.tolist(), rate.tolist(), strict=True)]
    return write_rates(path, rows, "t_ns,wx_rad_s,wy_rad_s,wz_rad_s")


def test_files_of_one_name_are_two_devices(tmp_path):
    """Two loggers write files of the same name: they were taken for one device."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    poses = write_attitudes(tmp_path / "poses.csv", mocap.t_ns, mocap.values)
    scaled = [table(tmp_path / name / "imu.csv", gyro.t_ns, gyro.values * factor)
              for name, factor in (("a", 1.0), ("b", 1.2))]  # fmt: skip
    result = quatprop.crosscheck(*scaled, poses)
    assert [one.name for one in result.sources] == [*map(str, scaled), "poses.csv"]
    assert len({one.device for one in result.sources}) == 3
    assert [(one.level, one.code, one.source) for one in result.findings] == [
        ("differs", "scale", str(scaled[1]))
    ]


def test_omitted_samples_are_losses(tmp_path):
    """Unusable samples are reported with their file; the exit code and JSON agree on 3."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rate, t_ns, wxyz = gyro.values.copy(), gyro.t_ns.copy(), mocap.values.copy()
    rate[100:103] = np.nan
    t_ns[[500, 501]] = t_ns[[501, 500]]
    wxyz[7] = 0.0
    logs = [table(tmp_path / "imu.csv", t_ns, rate)]
    logs.append(write_attitudes(tmp_path / "poses.csv", mocap.t_ns, wxyz))
    said = run("crosscheck", *logs, code=3)
    assert said.stdout == "2 sources of rotation, consistent\n"
    count = len(gyro.t_ns)
    left_out = "samples are left out"
    assert said.stderr.splitlines()[-2:] == [
        f"lost: imu.csv rates: 4 of {count} {left_out}: 3 are not finite, 1 timestamp out of order",
        f"lost: poses.csv orientation: 1 of {len(mocap.t_ns)} {left_out}: 1 all zero",
    ]
    assert said.stderr.startswith("warning: imu.csv: 1 non-monotonic timestamp (dropped), first at")
    report = json.loads(run("crosscheck", *logs, "--json", code=3).stdout)
    assert (report["state"], report["exit"]) == ("consistent", 3)
    assert {one["code"] for one in report["remarks"]} == {"stamps-back", "nonfinite-rates"}
    assert [one["messages"] for one in report["losses"]] == [4, 1]


def test_losses_name_their_file(healthy, tmp_path):
    """With several files, a part that cannot be read is reported with its file."""
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(healthy.read_bytes()[: healthy.stat().st_size * 2 // 3])
    said = run("crosscheck", healthy, cut, code=3)
    assert "\nlost: cut.mcap, " in f"\n{said.stderr}"
    report = json.loads(run("crosscheck", healthy, cut, "--json", code=3).stdout)
    assert report["exit"] == 3
    assert report["losses"][0]["place"].startswith("cut.mcap, ")


# Pictures.


@pytest.fixture
def drawn(monkeypatch):
    """Return a function that draws a cross-check and returns the axes, and what was printed."""
    figures, original = [], draw.figure
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda *_arguments, **_how: None)
    monkeypatch.setattr(draw, "figure", lambda *how: figures.append(original(*how)) or figures[-1])

    def drawn(*logs, code):
        said = run("crosscheck", *logs, "--plot", logs[0].with_suffix(".png"), code=code)
        return figures[-1].axes, said

    return drawn


def numbers(matrix):
    """Return the percentages in a matrix by row and column, from 1."""
    cells = {tuple(np.ceil(one.get_position()).astype(int)[::-1]): one for one in matrix.texts}
    return {place: float(one.get_text().replace(",", "")) for place, one in cells.items()}


def test_a_picture_shows_what_differs_and_the_repaired_rates(tmp_path, drawn):
    """In deg/s, rates differ by 57 times the motion; once repaired, they are those of the other."""
    faulty = FAULTS["deg/s read as rad/s"][0](rig(8))
    (*panels, matrix), said = drawn(bag(tmp_path / "rig.mcap", faulty), code=1)
    assert said.stdout.startswith("3 sources of rotation, inconsistent\nfault    /imu rates")
    names = [label.get_text() for label in matrix.get_yticklabels()]
    assert names == [f"{name}  {k}" for k, name in enumerate((GYRO, ORIENTATION, MOCAP), 1)]
    colours = [label.get_color() for label in matrix.get_yticklabels()]
    assert colours == [palette.ALARM, palette.INK, palette.INK]
    shown = numbers(matrix)
    assert {*shown} == {(2, 1), (3, 1), (3, 2), (1, 2), (1, 3), (2, 3)}
    assert all(5600 < shown[row, 1] < 5900 for row in (2, 3))
    assert all(shown[place] < 5 for place in ((3, 2), (1, 2), (1, 3), (2, 3)))
    assert [axes.get_ylabel() for axes in panels] == [f"rate {axis}\ndeg/s" for axis in "xyz"]
    for axes in panels:
        other, fitted = (line.get_ydata() for line in axes.get_lines())
        apart = (other - fitted)[np.isfinite(other) & np.isfinite(fitted)]
        assert np.sqrt(np.mean(apart**2)) < 0.05 * np.nanstd(other)
        assert np.nanstd(other) > 5  # deg/s
    texts = [text.get_text() for text in matrix.figure.texts]
    assert texts[0] == "3 sources of rotation, inconsistent: rig.mcap"
    assert any(text.startswith("fault, /imu rates: deg/s read as rad/s") for text in texts)


def test_a_change_is_in_the_middle_of_the_picture(tmp_path, drawn):
    """The ten seconds before it and after it are drawn."""
    sources = CHANGES["scale"][0](rig(3))
    (*panels, _), _ = drawn(bag(tmp_path / "rig.mcap", sources), code=1)
    start = float(re.match(r"time since ([\d.]+) s", panels[-1].get_xlabel())[1])
    assert abs(start + 10.0 - (min(one.t_ns[0] for one in sources.values()) * 1e-9 + 19.0)) < 0.6
    low, high = panels[-1].get_xlim()
    assert 20.0 < high - low < 21.0


@pytest.mark.thorough
@pytest.mark.parametrize("count", [2, 4, 8, 20])
@pytest.mark.parametrize("long", [1, 4])
def test_names_of_a_matrix_do_not_overlap(count, long):
    """Long names are shortened, so that the cells keep their room."""
    names = [f"/robot_{k}{'/a_long_namespace' * long}/imu/data orientation" for k in range(count)]
    shares = np.full((count, count), 57.3) - np.diag([np.nan] * count)
    lines = PlottedFile("one", (Group((Quantity("rate x", "deg/s"),), reduced()),))
    picture_of = picture([lines, lines._replace(label=names[-1])])
    matrix = Matrix(tuple(names), shares, (True,) * count)
    page = Page("Title", ("a", "b"), (), picture_of._replace(matrix=matrix), ("a " * 99, "b"), ())
    with rc_context({**draw.SETTINGS}):
        figure = draw.figure(page)
        figure.draw_without_rendering()
        *_, cells = figure.axes
        boxes = [part.get_window_extent() for part in (*figure.texts, *figure.legends)]
        boxes += [axes.get_tightbbox() for axes in figure.axes]
        parts = [*cells.texts, *cells.get_xticklabels(), *cells.get_yticklabels()]
        inner = [part.get_window_extent() for part in parts]
        least = cells.get_window_extent().x0
    assert len(cells.texts) == (count * (count - 1) if count < 20 else 0)
    for one in (*boxes, *inner):
        assert min(one.x0, one.y0) >= 0
        assert one.x1 <= figure.bbox.x1
        assert one.y1 <= figure.bbox.y1
    for group in (boxes, inner):
        assert not any(one.overlaps(other) for one, other in combinations(group, 2))
    assert all(label.get_window_extent().x1 < least for label in cells.get_yticklabels())


def reduced():
    """Return a short series for a picture."""
    reduction = Reduction(1)
    reduction.add(np.arange(20), np.arange(20.0)[None])
    return reduction.result()


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("suffix", "begins"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_a_picture_has_the_same_bytes_every_time(tmp_path, suffix, begins):
    """Without dates and made-up names, and without pyplot, which keeps state."""
    sys.modules.pop("matplotlib.pyplot", None)
    logs = two_tables(tmp_path)
    for name in "ab":
        run("crosscheck", *logs, "--plot", tmp_path / f"{name}.{suffix}", code=0)
    first, second = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in "ab")
    assert first.startswith(begins)
    assert first == second
    assert "matplotlib.pyplot" not in sys.modules


def test_no_picture_is_written_of_one_source(tmp_path):
    """An old picture stays; a log is not overwritten."""
    rates, poses = two_tables(tmp_path)
    old = tmp_path / "old.png"
    old.write_bytes(b"old")
    said = run("crosscheck", rates, "--plot", old, code=2)
    assert "not shown: a picture, as no two sources could be compared" in said.stdout
    assert old.read_bytes() == b"old"
    assert "image; use .png, .svg or .pdf" in refused(
        "crosscheck", rates, poses, "--plot", tmp_path / "a.html"
    )
    refused("crosscheck", rates, poses, "--plot", tmp_path / "a.txt")
    assert {path.name for path in tmp_path.iterdir()} == {"rates.csv", "poses.csv", "old.png"}


def two_tables(folder):
    """Write the rates and the motion capture of a rig as tables; return their paths."""
    sources = rig(4)
    gyro, mocap = sources[GYRO], sources[MOCAP]
    rates = table(folder / "rates.csv", gyro.t_ns, gyro.values)
    return rates, write_attitudes(folder / "poses.csv", mocap.t_ns, mocap.values)
