"""``quatprop calibrate`` writes what it says, never over its inputs, and says what was dropped."""

import shutil

import numpy as np
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS

from quatprop import read_attitudes

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
    """``-o -`` writes a file that can be read, and nothing else."""
    lines = run("calibrate", LOG, TRUTH, "-o", "-", code=0).stdout.splitlines()
    assert [line.split(":")[0] for line in lines if line[0] not in "# "] == ["matrix", "bias"]


def test_dropped_quaternions_are_counted(tmp_path):
    """Exit code 3 came without a word."""
    series = read_attitudes(TRUTH)
    wxyz = series.wxyz.copy()
    wxyz[10:15] = np.nan
    path = tmp_path / "reference.csv"
    rows = [
        ",".join(map(repr, [int(t), *q.tolist()])) for t, q in zip(series.t_ns, wxyz, strict=True)
    ]
    path.write_text("\n".join(["t_ns,qw,qx,qy,qz", *rows]))
    result = run("calibrate", LOG, path, "--on-invalid", "drop", code=3)
    assert "lost: REFERENCE: 5 invalid quaternions" in result.stderr


def test_the_time_offset_may_be_auto():
    """As for compare; it is what happens by default, and needs an offset that is estimated."""
    chosen = ("--estimate", "scale,offset", "--json")
    found = run("calibrate", LOG, TRUTH, *chosen, "--time-offset", "auto", code=0).stdout
    assert found == run("calibrate", LOG, TRUTH, *chosen, code=0).stdout
    said = refused("calibrate", LOG, TRUTH, "--estimate", "bias", "--time-offset", "auto")
    assert "add offset to --estimate, or give a duration" in said


def test_the_file_is_yaml(tmp_path):
    """A file x.txt was written, which nothing reads as a calibration."""
    said = refused("calibrate", LOG, TRUTH, "-o", tmp_path / "x.txt")
    assert "ends in neither .yaml nor .yml; rename it, or choose - for stdout" in said
