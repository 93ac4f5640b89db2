"""``quatprop calibrate`` writes what it says, never over its inputs, and says what was dropped."""

import shutil

import numpy as np
import pytest
from make.commands import refused, run
from make.places import SAMPLE_LOGS

from quatprop import read_attitudes

LOG, TRUTH = SAMPLE_LOGS / "tumbling.bag", SAMPLE_LOGS / "tumbling.truth.csv"


@pytest.mark.parametrize("which", ["log.bag", "truth.csv"])
def test_an_input_is_not_overwritten(tmp_path, which):
    """The calibration replaced the log, exit code 0."""
    log, truth = shutil.copy(LOG, tmp_path / "log.bag"), shutil.copy(TRUTH, tmp_path / "truth.csv")
    before = (tmp_path / which).read_bytes()
    said = refused("calibrate", log, truth, "-o", tmp_path / which)
    assert "this is an input of the run; choose another output" in said
    assert (tmp_path / which).read_bytes() == before


def test_stdout_has_the_file_alone():
    """What ``-o -`` writes is what is read, and nothing else."""
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
    assert "lost: 5 invalid quaternions of REFERENCE" in result.stderr
