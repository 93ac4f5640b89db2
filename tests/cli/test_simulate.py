"""``quatprop simulate`` writes what its options say."""

import math

import pytest
from make.commands import run

from quatprop import simulate
from quatprop.tools.simulation import MOTIONS
from quatprop.tools.simulation_options import SHAPED_BY, SIMULATE


def test_the_command_knows_every_motion():
    """The names that it lists without importing the motions are theirs."""
    assert tuple(MOTIONS) == SIMULATE["motion"].choices


def test_the_command_writes_log_and_truth(tmp_path):
    """Half a turn between samples, to the byte."""
    log, truth = tmp_path / "spin.csv", tmp_path / "spin.truth.csv"
    options = "--frequency 1 --rate 2 --duration 1.5s --start 5"
    result = run("simulate", log, *options.split(), code=0)
    assert result.stderr == f"{log}: 3 samples of spin; the truth is in {truth}\n"
    assert log.read_text() == (
        "t_ns,wx,wy,wz\n"
        "5,0,0,6.283185307179586\n"
        "500000005,0,0,6.283185307179586\n"
        "1000000005,0,0,6.283185307179586\n"
    )
    assert truth.read_text() == (
        "t_ns,qw,qx,qy,qz\n5,1,0,0,0\n500000005,0,0,0,1\n1000000005,-1,0,0,0\n"
    )


def test_the_command_writes_to_stdout():
    """A dash is CSV on stdout, without a truth."""
    result = run("simulate", "-", "--motion", "rest", "--samples", "1", "-q", code=0)
    assert result.stdout == "t_ns,wx,wy,wz\n1700000000000000000,0,0,0\n"
    assert result.stderr == ""


def test_noise_has_the_units_of_data_sheets(tmp_path):
    """Noise in deg/sqrt(h), as `--noise-density` takes it, was no number."""
    logs = [tmp_path / "degrees.csv", tmp_path / "radians.csv"]
    for log, noise in zip(logs, ("60deg/sqrt(h)", f"{math.radians(1)!r}"), strict=True):
        run("simulate", log, "--samples", "10", "--noise", noise, "-q", code=0)
    assert logs[0].read_bytes() == logs[1].read_bytes()


@pytest.mark.parametrize("motion", MOTIONS)
def test_defaults_are_those_that_help_states(motion):
    """Given as it states them, they change nothing."""
    words = []
    for name, keyword in SIMULATE.items():
        if name not in {"motion", "samples"} and motion in SHAPED_BY.get(name, [motion]):
            words += [f"--{name.replace('_', '-')}", keyword.default]
    log = run("simulate", "-", "--motion", motion, code=0).stdout
    assert log == run("simulate", "-", "--motion", motion, *words, code=0).stdout
    assert log.count("\n") == 1 + 2000
    rates, _ = simulate(motion=motion)
    assert [f"{t}" for t in rates.t_ns] == [row.split(",")[0] for row in log.splitlines()[1:]]
