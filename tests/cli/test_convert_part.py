"""`quatprop convert` of a part of a series, and at a steady rate."""

import json

import numpy as np
import pytest
from make.commands import run
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation, Slerp

import quatprop
from quatprop.base.errors import TimelineError, UsageError

TRUTH = SAMPLE_LOGS / "tumbling.truth.csv"


@pytest.fixture(scope="module")
def truth():
    """Return the attitudes of the sample log, 100 a second."""
    return quatprop.read_attitudes(TRUTH)


@pytest.mark.parametrize(
    ("part", "first", "last"),
    [
        (("--start", "+1s"), 100, 999),
        (("--end", "-2s"), 0, 799),
        (("--start", "-3s", "--end", "1700000008000000000"), 699, 800),
    ],
)
def test_a_time_range_is_converted(tmp_path, truth, part, first, last):
    """Ends included, in Python too; the provenance has the range, and what it left out."""
    out, report = tmp_path / "out.csv", tmp_path / "report.json"
    said = run("convert", TRUTH, out, *part, "--report", report).stderr
    assert quatprop.read_attitudes(out) == truth[first : last + 1]
    named = {
        name.removeprefix("--"): time for name, time in zip(part[::2], part[1::2], strict=True)
    }
    assert quatprop.read_attitudes(TRUTH, **named) == truth[first : last + 1]
    recorded = json.loads(report.read_text())["conversions"][0]["time_range"]
    assert (recorded["before"], recorded["after"]) == (first, 999 - last)
    assert f"omitted: {first + 999 - last} rows outside the time range" in said


def test_a_time_range_that_leaves_nothing_out_is_remarked_on(tmp_path):
    """An absolute time may be in other units than was meant."""
    told = run("convert", TRUTH, tmp_path / "out.csv", "--end", "1800000000000000000").stderr
    assert "note: --end is after the last sample and excludes nothing" in told


def test_a_steady_rate_is_interpolated(tmp_path, truth):
    """Better than ten times slerp, and to the bit where there is an attitude."""
    half, out = tmp_path / "half.csv", tmp_path / "out.csv"
    quatprop.write(truth[::2], half)
    report = quatprop.convert(half, out, rate="100Hz", convention="hamilton")
    known, found = truth[:999], quatprop.read_attitudes(out)
    assert (report.written, report.counts.samples_used) == (999, 500)
    assert found.t_ns.tolist() == known.t_ns.tolist()
    assert np.array_equal(found.wxyz[::2], known.wxyz[::2])
    rotations = Rotation.from_quat(known.wxyz, scalar_first=True)
    slerp = Slerp(known.t_ns[::2] - known.t_ns[0], rotations[::2])(known.t_ns - known.t_ns[0])
    error = Rotation.from_quat(found.wxyz, scalar_first=True) * rotations.inv()
    assert error.magnitude().max() < (slerp * rotations.inv()).magnitude().max() / 10


def test_nothing_is_interpolated_across_gaps(tmp_path, truth):
    """They stay gaps, with a remark; a single attitude between two is kept."""
    gappy, out = tmp_path / "gappy.csv", tmp_path / "out.csv"
    rows = np.r_[0:100, 300, 500:600]
    quatprop.write(truth[rows], gappy)
    said = run("convert", gappy, out, "--rate", "200").stderr
    found = quatprop.read_attitudes(out)
    since = (found.t_ns - truth.t_ns[0]) // 5_000_000
    assert since.tolist() == [*range(199), 600, *range(1000, 1199)]
    assert "no attitudes are interpolated across 2 gaps longer than 100 ms" in said


def test_what_is_next_to_attitudes_is_interpolated_too(tmp_path):
    """Positions in a straight line."""
    source, out = tmp_path / "in.tum", tmp_path / "out.tum"
    source.write_text("1.0 0 0 0 0 0 0 1\n1.2 2 4 6 0 0 0 1\n1.4 4 8 12 0 0 0 1\n")
    run("convert", source, out, "--rate", "10")
    found = quatprop.read_attitudes(out)
    expected = np.arange(5)[:, None] * [1, 2, 3]
    assert np.allclose(found.position, expected, rtol=0, atol=1e-12)


def test_stamps_that_do_not_rise_are_not_interpolated(tmp_path):
    """There is no attitude between them."""
    source = tmp_path / "in.csv"
    source.write_text("t_ns,qw,qx,qy,qz\n5,1,0,0,0\n5,1,0,0,0\n")
    with pytest.raises(
        TimelineError, match="only between rising timestamps, not between 5 ns and 5 ns; omit rate"
    ):
        quatprop.convert(source, tmp_path / "out.csv", rate=10)


def test_more_attitudes_than_a_timestamp_can_mean_are_refused(tmp_path):
    """Of two attitudes with a wrong timestamp, memory would run out."""
    source = tmp_path / "in.csv"
    source.write_text("t_ns,qw,qx,qy,qz\n0,1,0,0,0\n200000000000000,1,0,0,0\n")
    with pytest.raises(UsageError, match="20,000,000 attitudes at 100 Hz; is a timestamp wrong"):
        quatprop.convert(source, tmp_path / "out.csv", rate=100)
