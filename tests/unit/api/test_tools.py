"""`info`, `plot` and `simulate` of the library do what the commands of these names do."""

import json
import re
import warnings
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from make.batches import spin
from make.commands import run
from make.places import SAMPLE_LOGS
from make.tables import write_rates
from matplotlib.figure import Figure

import quatprop
from quatprop.base.errors import UsageError

BAG, TRUTH = SAMPLE_LOGS / "tumbling.bag", SAMPLE_LOGS / "tumbling.truth.csv"
RATES = quatprop.read_rates(BAG)


def test_info_has_what_the_command_prints(tmp_path):
    """The same survey, with settings as keywords; short when shown."""
    found = quatprop.info(BAG)
    told = json.loads(run("info", "--json", BAG).stdout)[0]
    assert [one.samples for one in found.sources] == [one["samples"] for one in told["sources"]]
    assert repr(found) == f"<LogSurvey: {BAG} (bag): '/imu (1000)'>"
    odd = tmp_path / "odd.csv"
    odd.write_text("t_ns,gyr_x,gyr_y,gyr_z\n" + "".join(f"{k},1,2,{k}\n" for k in range(9)))
    (source,) = quatprop.info(odd).sources
    assert "rate_unit='rad/s' or 'deg/s'" in source.missing


def test_simulate_gives_what_the_command_writes(tmp_path):
    """To the bit, noise and all."""
    out = tmp_path / "a.parquet"
    options = "--motion tumbling --rate 50 --duration 2s --noise 1e-3 --bias 0.1,0,0 --seed 3"
    run("simulate", out, *options.split())
    rates, truth = quatprop.simulate(
        motion="tumbling", rate=50, duration="2s", noise=1e-3, bias=np.array([0.1, 0, 0]), seed=3
    )
    assert rates == quatprop.read_rates(out)
    assert truth == quatprop.read_attitudes(tmp_path / "a.truth.parquet")


def test_plot_draws_what_the_command_draws(tmp_path):
    """The same lines."""
    for words, options in (
        (["--start", "+1s"], {"start": "+1s"}),
        (["--show", "rates"], {"show": "rates"}),
    ):
        ours, theirs = tmp_path / "ours.svg", tmp_path / "theirs.svg"
        quatprop.plot(BAG, output=ours, **options)
        run("plot", BAG, "-o", theirs, *words)
        drawn = [re.findall(r' d="[^"]*"', path.read_text()) for path in (ours, theirs)]
        assert drawn[0] == drawn[1] != []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        quatprop.plot(TRUTH, TRUTH, output=tmp_path / "errors.png", reference=TRUTH)
    assert (tmp_path / "errors.png").read_bytes().startswith(b"\x89PNG")


def test_a_plot_takes_and_returns_axes(tmp_path):
    """Series in memory needed a file of each, and the picture could not be one of several."""
    ax = Figure().subplots()
    rates = RATES
    one, two = quatprop.propagate(rates), quatprop.propagate(rates, method="coning")
    assert quatprop.plot(one, two, TRUTH, ax=ax) is ax
    drawn = {line.get_label(): line for line in ax.get_lines()}
    angles = ("yaw", "pitch", "roll")
    names = ("series 1", "series 2", "tumbling.truth.csv")
    assert list(drawn) == [f"{angle} {name}" for angle in angles for name in names]
    pitch = drawn["pitch series 2"].get_ydata()
    np.testing.assert_allclose(pitch, two.as_euler("ZYX", degrees=True)[:, 1], atol=1e-9)
    error = quatprop.plot(two, reference=TRUTH, ax=Figure().subplots()).get_lines()[0].get_ydata()
    largest = np.degrees(quatprop.compare(two, TRUTH).error_rad.max)
    np.testing.assert_allclose(max(error), largest, atol=1e-9)
    within = quatprop.plot(two, reference=TRUTH, start="+1s", end="+2s", ax=Figure().subplots())
    assert len(within.get_lines()[0].get_ydata()) == 101
    part = quatprop.plot(rates, start="+1s", end="+2s", ax=Figure().subplots()).get_lines()
    np.testing.assert_allclose([line.get_ydata() for line in part], rates.rate[100:201].T)
    rows, head = ["0,270,0,0", "10000000,0,45,-9"], "t_ns,gyr_x,gyr_y,gyr_z"
    log = write_rates(tmp_path / "deg.csv", rows, head)
    lines = quatprop.plot(log, rate_unit="deg/s", ax=Figure().subplots()).get_lines()
    drawn = [line.get_ydata() for line in lines]
    np.testing.assert_allclose(drawn, [[270, 0], [0, 45], [0, -9]], atol=1e-12)
    assert ax.get_xlabel() == "time since 2023-11-14 22:13:20 UTC, s"


def test_a_batch_is_that_of_the_command(tmp_path):
    """Only a process could run one; here its manifest comes back, and sentences name keywords."""
    logs, out = [BAG, SAMPLE_LOGS / "coning.mcap", TRUTH], tmp_path / "out"
    entries = quatprop.batch(logs, out, method="coning", to="csv", processes=1)
    assert [entry.state for entry in entries] == ["done", "done", "failed"]
    assert "name the columns with rate_cols and time_col" in entries[2].error
    assert all(entry.time and entry.run for entry in entries)
    one = quatprop.propagate(BAG, method="coning")
    np.testing.assert_array_equal(quatprop.read_attitudes(out / entries[0].output).wxyz, one.wxyz)
    words = ("--method", "coning", "--to", "csv", "-o", out, "--skip-existing")
    assert "nothing to do" in run("batch", *logs[:2], *words).stderr
    assert quatprop.batch(logs[:2], out, method="coning", to="csv", skip_existing=True) == []


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize("place", ["folder", "store"])
def test_logs_are_found_under_the_names_that_a_batch_records(tmp_path, bucket, place):
    """Other systems that propagate them had to guess the names."""
    top = bucket if place == "store" else str(tmp_path)
    for name in ("a.csv", "in/a.csv", "in/deep/b.csv"):
        spin(f"{top}/{name}" if place == "store" else tmp_path / name)
    found = quatprop.find_logs(f"{top}/in")
    entries = quatprop.batch(f"{top}/in", tmp_path / "out", processes=1)
    assert (
        [log.name for log in found] == [entry.log for entry in entries] == ["a.csv", "deep/b.csv"]
    )
    assert [f"{log.name}.parquet" for log in found] == [entry.output for entry in entries]
    for log, entry in zip(found, entries, strict=True):
        assert log.path == f"{entry.root}/{entry.log}"
        assert quatprop.propagate(log.path).wxyz[-1].tolist() == list(entry.final_wxyz)
    named = quatprop.find_logs([f"{top}/in/a.csv"], root=top)
    assert [log.name for log in named] == ["in/a.csv"]
    with pytest.raises(UsageError, match="would have one output"):
        quatprop.find_logs([f"{top}/in/a.csv", f"{top}/a.csv"])


def test_a_named_topic_is_in_path_and_name():
    """The path is that of one series, and so is the name."""
    (log,) = quatprop.find_logs(f"{BAG}:/imu")
    assert (log.path, log.name) == (f"{BAG}:/imu", f"{BAG.name}/imu")


def test_a_notebook_shows_tables():
    """Results were shown as the text of a tuple of arrays, or in one line."""
    rest = quatprop.simulate(motion="rest", noise=1e-3, duration="100s", seed=1).rates
    rates, truth = quatprop.simulate(motion="tumbling", duration="20s")
    compared = quatprop.compare(quatprop.propagate(rates), truth, tol="1e-9deg")
    calibrated = quatprop.calibrate(rates, truth, time_offset="0")
    results = {
        "angle random walk": quatprop.noise(rest),
        "windows": calibrated,
        "RMS": compared,
        "samples": quatprop.info(SAMPLE_LOGS / "tumbling.bag"),
        "attitudes": quatprop.info(SAMPLE_LOGS / "tumbling.truth.csv"),
    }
    for label, result in results.items():
        page = result._repr_html_()
        table = ET.fromstring(f"<div>{page}</div>").find("table")  # noqa: S314  # ours
        cells = [(cell.text or "").strip() for row in table for cell in row]
        assert label in cells
        assert len({len(row) for row in table}) == 1
    assert "failed" in str(compared)
    assert "angle random walk" in str(results["angle random walk"])
    assert "&lt;" in results["angle random walk"]._repr_html_()
