"""``quatprop calibrate`` writes what it says, never over its inputs, and says what was dropped."""

import shutil

import numpy as np
import pytest
from make.calibrations import recorded
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.tables import write_attitudes, write_rates

from quatprop import GyroSeries, propagate, read_attitudes
from quatprop.estimation.model import Model

LOG, TRUTH = SAMPLE_LOGS / "tumbling.bag", SAMPLE_LOGS / "tumbling.truth.csv"


@pytest.mark.parametrize("which", ["log.yaml", "truth.yaml"])
def test_an_input_is_not_overwritten(tmp_path, which):
    """The calibration replaced the log, exit code 0."""
    log, truth = tmp_path / "log.yaml", tmp_path / "truth.yaml"
    shutil.copy(LOG, log)
    shutil.copy(TRUTH, truth)
    before = (tmp_path / which).read_bytes()
    said = refused("calibrate", log, truth, "-o", tmp_path / which)
    assert "this is an input of the run; choose another output" in said
    assert (tmp_path / which).read_bytes() == before


def test_stdout_has_the_file_alone():
    """``-o -`` writes a calibration that can be read, and nothing else."""
    arguments = ("calibrate", LOG, TRUTH, "--time-offset", "0", "-o", "-")
    lines = run(*arguments, code=0).stdout.splitlines()
    assert [line.split(":")[0] for line in lines if line[0] not in "# "] == ["matrix", "bias"]


def test_dropped_quaternions_are_counted(tmp_path):
    """The exit code was 3 without an explanation."""
    series = read_attitudes(TRUTH)
    wxyz = series.wxyz.copy()
    wxyz[10:15] = np.nan
    path = tmp_path / "reference.csv"
    rows = [
        ",".join(map(repr, [int(t), *q.tolist()])) for t, q in zip(series.t_ns, wxyz, strict=True)
    ]
    path.write_text("\n".join(["t_ns,qw,qx,qy,qz", *rows]))
    arguments = ("calibrate", LOG, path, "--time-offset", "0", "--on-invalid", "drop")
    result = run(*arguments, code=3)
    assert f"lost: {path}: 5 invalid quaternions" in result.stderr


def test_a_motion_that_repeats_itself_needs_its_offset(tmp_path):
    """Several offsets fit equally well: what is refused is accepted with a given one.

    The offset, the scale and the mounting were each off by hundreds of standard deviations.
    """
    seconds = np.arange(4000) / 100
    phase = 2 * np.pi * seconds
    rate = np.stack([np.sin(phase), 0.5 * np.sin(2 * phase), 0.3 * np.cos(2 * phase)], axis=1)
    t_ns = (seconds * 1e9).round().astype(np.int64)
    wxyz = propagate(GyroSeries(t_ns, rate), method="quintic").wxyz
    noisy = rate + 0.02 * np.random.default_rng(1).normal(size=rate.shape)
    rows = zip(t_ns.tolist(), noisy.tolist(), strict=True)
    log = write_rates(tmp_path / "log.csv", [[t, *each] for t, each in rows])
    late = write_attitudes(tmp_path / "reference.csv", t_ns + 100_000_000, wxyz)
    said = refused("calibrate", log, late)
    assert "the motion repeats itself, so that offsets of -0.100 s, " in said
    assert "give the right one with --time-offset" in said
    lines = run("calibrate", log, late, "--time-offset", "-100ms", code=0).stdout.splitlines()
    offset = next(line for line in lines if line.startswith("offset")).split()
    assert abs(float(offset[1]) + 100) < 4 * float(offset[3]) < 1


def test_the_whole_offset_is_printed_as_compare_takes_it(tmp_path):
    """Only what a coarse search left over was printed."""
    rates, reference = recorded(np.random.default_rng(3), Model(bias=np.array([0.01, 0.02, 0.0])))
    rows = zip(rates.t_ns.tolist(), rates.rate.tolist(), strict=True)
    log = write_rates(tmp_path / "log.csv", [[t, *each] for t, each in rows])
    t_ns = reference.t_ns + 37_005_000_000
    late = write_attitudes(tmp_path / "reference.csv", t_ns, reference.wxyz)
    lines = run("calibrate", log, late, code=0).stdout.splitlines()
    printed = dict(line.split(maxsplit=1) for line in lines)
    assert float(printed["offset"].split()[0]) == pytest.approx(-37005, abs=1)
    offset = next(line for line in lines if line.startswith("time offset")).split()[2].strip(",")
    run("propagate", log, "-o", tmp_path / "attitude.csv", "-q", code=0)
    run("compare", tmp_path / "attitude.csv", late, "--time-offset", offset, code=0)


def test_the_time_offset_may_be_auto():
    """As for compare; it is what happens by default, and needs an offset that is estimated."""
    chosen = ("--estimate", "scale,offset", "--json")
    found = run("calibrate", LOG, TRUTH, *chosen, "--time-offset", "auto", code=0).stdout
    assert found == run("calibrate", LOG, TRUTH, *chosen, code=0).stdout
    said = refused("calibrate", LOG, TRUTH, "--estimate", "bias", "--time-offset", "auto")
    assert "add offset to --estimate, or give a duration" in said


def test_windows_shorter_than_the_reference_are_refused():
    """A window of 1 us needed gigabytes."""
    said = refused("calibrate", LOG, TRUTH, "--window", "1us")
    assert "windows of 1 us are shorter than 2 intervals of the reference; choose --window" in said


@pytest.mark.parametrize(
    ("prior", "said"),
    [
        ("scale", "'scale' is not NAME=SIZE, such as scale=1%"),
        ("scael=1%", "did you mean 'scale'"),
        ("scale=1deg", "write a number with its unit, such as 1%"),
        ("bias=0deg/s", "a prior of 0 would hold bias; leave it out of --estimate"),
    ],
)
def test_useless_priors_are_refused(prior, said):
    """Each error is one sentence with a remedy."""
    assert said in refused("calibrate", LOG, TRUTH, "--prior", prior)


def test_the_file_is_yaml(tmp_path):
    """A file x.txt was written, which nothing reads as a calibration."""
    said = refused("calibrate", LOG, TRUTH, "-o", tmp_path / "x.txt")
    assert "ends in neither .yaml nor .yml; rename it, or choose - for stdout" in said
