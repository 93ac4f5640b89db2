"""``quatprop noise`` writes what its options say, and refuses what is not at rest."""

import json
import re
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from make.commands import refused, run
from make.gyro_noise import HZ, Truth, rates
from make.places import SAMPLE_LOGS
from PIL import Image

from quatprop import GyroSeries, noise
from quatprop.base.errors import RemarkWarning, UsageError

TRUTH = Truth(N=1.7e-4, K=2e-4)


def write(path, rate, t_ns=None):
    """Write a table of rates, ``(N, 3)``; return its path."""
    t_ns = np.arange(len(rate)) * (10**9 // HZ) if t_ns is None else t_ns
    axes = dict(zip(("wx", "wy", "wz"), rate.T, strict=True))
    pq.write_table(pa.table({"t_ns": t_ns, **axes}), path)
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Write ten minutes of a gyroscope at rest, whose random walk shows."""
    rate = rates(TRUTH, 60_000, np.random.default_rng(9)) + np.array([0.01, -0.02, 0.005])
    return write(tmp_path_factory.mktemp("noise") / "rest.parquet", rate)


def test_it_states_the_terms_of_each_axis(log):
    """In a table: values with their standard deviations, bounds of what does not show."""
    result = run("noise", log, code=0)
    assert result.stderr == ""
    rows = {line[:18].strip(): line[18:] for line in result.stdout.splitlines()}
    assert rows["at rest"] == " 60,000 samples in 1 period: 599.99 s, 100 Hz on average"
    for name, true in (("angle random walk", TRUTH.N), ("rate random walk", TRUTH.K)):
        *values, unit = rows[name].replace("(", "").replace("%)", "").split()
        assert unit.startswith("rad/s")
        for value, percent in zip(values[::2], values[1::2], strict=True):
            assert abs(float(value) / true - 1) < 4 * float(percent) / 100
    assert rows["quantisation"].count("<") == rows["bias instability"].count("<") == 4
    assert "angle random walk 0.5" in rows["data-sheet units"]
    assert "rate random walk" in rows["data-sheet units"]
    deviation = noise(log).deviation
    *lowest, _ = rows["lowest deviation"].split("  rad/s")
    assert " ".join(lowest).split() == [f"{least:.3e}" for least in deviation.min(axis=0)]


def test_json_is_what_python_returns(log):
    """Every number of it; of a series, too."""
    told = json.loads(run("noise", log, "--json", code=0).stdout)
    found = noise(log)
    assert told["combined"]["rate_random_walk"]["value"] == found.combined.rate_random_walk.value
    np.testing.assert_array_equal(told["deviation"], found.deviation)
    table = pq.read_table(log)
    rate = np.stack([table[name].to_numpy() for name in ("wx", "wy", "wz")], axis=1)
    series = noise(GyroSeries(table["t_ns"].to_numpy(), rate))
    assert series.axes == found.axes
    assert (found.low < found.deviation).all()
    assert (found.deviation < found.high).all()
    freedoms = 2 * (found.deviation / (found.high - found.low) * 2) ** 2 / 4
    assert freedoms[0].min() > 10_000


def test_the_file_is_what_propagate_reads(log, tmp_path):
    """Kalibr's keys, with the values that are shown; as options they give the same uncertainty."""
    path, out = tmp_path / "imu.yaml", tmp_path / "out.csv"
    run("noise", log, "-o", path, "-q", code=0)
    terms = noise(log).combined
    options = ("-o", out, "--sigma", "--report", "-", "--start", "+10s", "--end", "+20s")
    told = json.loads(run("propagate", log, *options, "--imu", path, code=0).stdout)
    errors = told["uncertainty"]["errors"]
    assert errors["noise_density"] == pytest.approx(terms.angle_random_walk.value, rel=1e-4)
    assert errors["random_walk"] == pytest.approx(terms.rate_random_walk.value, rel=1e-4)
    with_options = ("--noise-density", f"{errors['noise_density']}rad/s/sqrt(Hz)",
                    "--random-walk", f"{errors['random_walk']}rad/s^2/sqrt(Hz)")  # fmt: skip
    first = out.read_bytes()
    run("propagate", log, *options, *with_options, code=0)
    assert out.read_bytes() == first
    assert run("noise", log, "-o", "-", code=0).stdout == path.read_text()
    for term in (terms.angle_random_walk, terms.rate_random_walk):
        (comment,) = re.findall(rf"{term.value:.4e}  # .*, 1 sigma (.*) %", path.read_text())
        assert float(comment) / 100 == pytest.approx(term.sigma / term.value, rel=0.05)


def test_undetermined_terms_have_no_value_in_the_file(tmp_path):
    """A short log says nothing of a random walk, and the file says so."""
    path = tmp_path / "imu.yaml"
    run("noise", SAMPLE_LOGS / "rest.parquet", "-o", path, code=0)
    lines = path.read_text().splitlines()
    assert any(line.startswith("# gyroscope_random_walk: at most ") for line in lines)
    assert any(line.startswith("gyroscope_noise_density: 1.0") for line in lines)
    out = tmp_path / "out.csv"
    told = run("propagate", SAMPLE_LOGS / "spin.csv", "-o", out, "--imu", path, "--report", "-")
    assert json.loads(told.stdout)["uncertainty"]["errors"]["random_walk"] == 0


def test_it_draws_the_deviation(log, tmp_path):
    """With the slopes and their values in the legend."""
    path = tmp_path / "allan.svg"
    run("noise", log, "--plot", path, "-q", code=0)
    text = path.read_text()
    assert "averaging time, s" in text
    assert "angle random walk 0.00017 rad/s/sqrt(Hz)" in text
    assert "rate random walk 0.000" in text
    assert "bias instability" not in text


def test_a_long_title_stays_on_the_picture(log, tmp_path):
    """Wide letters ran off the right edge."""
    long = shutil.copy(log, tmp_path / f"{'W' * 90}.parquet")
    run("noise", long, "--plot", tmp_path / "allan.png", "-q", code=0)
    with Image.open(tmp_path / "allan.png") as image:
        assert image.size[0] == 1500
        dark = np.asarray(image.convert("L"))[:60] < 128
    assert dark.any()
    assert not dark[:, -15:].any()


def test_rests_and_gaps_divide_the_samples(tmp_path):
    """Two rests, one with a gap, about a motion: what is stated is that of the pieces alone."""
    random = np.random.default_rng(10)
    rate = rates(Truth(N=1e-4), 9000, random)
    t_ns = np.arange(9000) * (10**9 // HZ)
    moves = (t_ns >= 40e9) & (t_ns < 50e9)
    rate[moves] += np.sin(t_ns[moves] * 3e-9)[:, None]
    gap = (t_ns >= 20e9) & (t_ns < 20.2e9)
    path = write(tmp_path / "rests.parquet", rate[~gap], t_ns[~gap])
    found = json.loads((result := run("noise", path, "--json", code=0)).stdout)
    assert len(found["rests"]) == 2
    assert found["pieces"] == 3
    assert "warning: gaps at rest, longer than 100 ms: 1; no difference is taken across one" in (
        result.stderr
    )
    density = found["combined"]["angle_random_walk"]
    assert abs(density["value"] - 1e-4) < 4 * density["sigma"]
    part = json.loads(run("noise", path, "--json", "--start", "+51s", code=0).stdout)
    assert len(part["rests"]) == part["pieces"] == 1
    assert part["samples"] <= 3900


def test_timestamps_that_step_back_are_sorted_if_wanted(log, tmp_path):
    """As in propagate; else they are refused."""
    table = pq.read_table(log).slice(0, 9000)
    path = tmp_path / "swapped.parquet"
    pq.write_table(table.take([*range(4000), 4001, 4000, *range(4002, 9000)]), path)
    assert "--on-backwards" in refused("noise", path)
    with pytest.warns(RemarkWarning, match="1 non-monotonic timestamp"):
        assert noise(path, on_backwards="sort").samples == 9000


def test_a_rest_with_a_drift_is_one_rest(tmp_path):
    """A gyroscope that warms up by 1 deg/s is found at rest in parts, which are one rest."""
    rate = rates(Truth(N=1e-4, R=6e-5), 30_000, np.random.default_rng(11))
    found = noise(write(tmp_path / "drift.parquet", rate))
    assert len(found.rests) == found.pieces == 1
    assert found.samples > 29_900
    # The ramp is no random walk, which would explain as much at 100 s.
    assert found.combined.rate_random_walk.value is None


REFUSED = {
    "moves": "no stationary period (the rates scatter by at least 1.",
    "short": "samples at rest are too few to measure noise; record the sensor at rest",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_log_that_moves_or_is_short_is_refused(tmp_path, name):
    """With what to record instead, and without a file."""
    k = np.arange(500)[:, None]
    rate = {"moves": np.sin(k * [1, 2, 3]), "short": 1e-3 * np.sin(k[:10] ** 2 * [1, 2, 3])}[name]
    t_ns = k[: len(rate), 0] * (10**7 if name == "moves" else 2 * 10**8)
    path = write(tmp_path / "log.parquet", rate, t_ns)
    said = refused("noise", path, "-o", tmp_path / "imu.yaml", "--plot", tmp_path / "a.png")
    assert said.startswith(f"Error: {path}: ")
    assert REFUSED[name] in said
    assert [each.name for each in tmp_path.iterdir()] == ["log.parquet"]


def test_other_refusals(log, tmp_path):
    """Stdin, a page, an input as output; and no walk of something that shows no noise."""
    assert "stdin and pipes can be read only once" in refused("noise", "-")
    assert "use .png, .svg or .pdf" in refused("noise", log, "--plot", tmp_path / "a.html")
    other = shutil.copy(log, tmp_path / "log.yaml")
    assert "this is an input of the run" in refused("noise", other, "-o", other)
    assert "ends in neither .yaml nor .yml" in refused("noise", log, "-o", tmp_path / "x.txt")
    flat = write(tmp_path / "flat.parquet", np.zeros((3000, 3)))
    assert "shows no angle random walk" in refused("noise", flat, "-o", tmp_path / "imu.yaml")
    assert "data-sheet" not in run("noise", flat, code=0).stdout
    with pytest.raises(UsageError, match="rate_unit is for logs"):
        noise(GyroSeries([0, 1], np.zeros((2, 3))), rate_unit="deg/s")


def test_a_damaged_log_gives_exit_code_3(tmp_path):
    """The rest is measured, and the loss is reported."""
    path = tmp_path / "rest.bag"
    run("simulate", path, "--motion", "rest", "--noise", "1e-4", "--truth", "none", "-q", code=0)
    path.write_bytes(path.read_bytes()[:-20_000])
    result = run("noise", path, "-o", tmp_path / "imu.yaml", code=3)
    assert "lost: " in result.stderr
    assert 'rostopic: "/imu"' in (tmp_path / "imu.yaml").read_text()


def test_copies_of_one_recording_are_read_once(log, tmp_path):
    """They gave half of the noise at short times, with a warning."""
    other = shutil.copy(log, tmp_path / "copy.parquet")
    done = run("noise", log, other, "--json", code=0)
    assert "the files overlap: 60000 samples in several of them are read once" in done.stderr
    found = json.loads(done.stdout)
    np.testing.assert_array_equal(found["deviation"], noise(log).deviation)


def test_parts_of_one_recording_are_one(log, tmp_path):
    """Two halves have the same noise as the whole."""
    table, parts = pq.read_table(log), [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    for start, path in zip((0, 30_000), parts, strict=True):
        pq.write_table(table.slice(start, 30_000), path)
    found = json.loads(run("noise", *parts, "--json", code=0).stdout)
    np.testing.assert_array_equal(found["deviation"], noise(log).deviation)
