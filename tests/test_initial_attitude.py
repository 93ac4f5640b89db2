"""Where a propagation begins: given, from gravity, from the log itself, from another series."""

import math
import re

import numpy as np
import pytest
from click.testing import CliRunner

from quatprop.cli import cli
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply, rotate
from quatprop.pipeline.initial_attitude import level

G = 9.80665
COLUMNS = "t_ns,wx,wy,wz,accel_x,accel_y,accel_z\n"


@pytest.mark.parametrize("down", [False, True])
@pytest.mark.parametrize("heading", [0.0, 0.7, -3.0])
@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (0.3, -0.2), (2.9, 1.2), (-1.0, -1.0)])
def test_level_is_roll_and_pitch_from_gravity(roll, pitch, heading, down):
    """The force that a body feels at a known zyx attitude gives that attitude back."""
    turns = exp(np.array([[0, 0, heading], [0, pitch, 0], [roll, 0, 0]], dtype=np.float64))
    truth = multiply(turns[0], multiply(turns[1], turns[2]))
    up = np.array([0.0, 0.0, -G if down else G])
    felt = rotate(truth * [1, -1, -1, -1], up)
    assert geodesic_angle(level(felt, heading, down=down), truth) < 1e-15


def run(*arguments):
    """Run `quatprop propagate`."""
    return CliRunner().invoke(cli, ["propagate", *map(str, arguments)])


@pytest.fixture
def resting(tmp_path):
    """Return a table of 2 s at rest, rolled by 30 degrees, and where to write."""
    force = [0.0, G * math.sin(math.radians(30)), G * math.cos(math.radians(30))]
    rows = [
        f"{k * 10_000_000},0,0,0,{','.join(str(f + 1e-3 * (k % 2)) for f in force)}\n"
        for k in range(200)
    ]
    path = tmp_path / "log.csv"
    path.write_text(COLUMNS + "".join(rows))
    return path, tmp_path / "out.csv"


def first_row(path):
    """Return the first attitude of a CSV, wxyz."""
    return [float(q) for q in path.read_text().splitlines()[1].split(",")[1:]]


def test_level_from_a_table(resting):
    """--q0 level takes roll and pitch from the columns of acceleration, heading from --heading."""
    log, out = resting
    result = run(log, "-o", out, "--q0", "level", "--heading", "90")
    assert result.exit_code == 0, result.output
    half_roll, half_heading = math.radians(15), math.radians(45)
    about_x = [math.cos(half_roll), math.sin(half_roll), 0, 0]
    about_z = [math.cos(half_heading), 0, 0, math.sin(half_heading)]
    assert geodesic_angle(first_row(out), multiply(about_z, about_x)) < 1e-3


def test_level_turns_with_the_mounting(resting):
    """The accelerometer is mounted as the gyroscope is: x,-y,-z turns the roll by 180 degrees."""
    log, out = resting
    run(log, "-o", out, "--q0", "level", "--mount", "x,-y,-z")
    expected = math.radians(30 - 180) / 2
    assert geodesic_angle(first_row(out), [math.cos(expected), math.sin(expected), 0, 0]) < 1e-3


def test_level_needs_rest(tmp_path):
    """A log that begins in motion tells no level, and says where to begin."""
    path = tmp_path / "log.csv"
    rows = [f"{k * 10_000_000},{math.sin(k)},0,0,0,0,{G}\n" for k in range(200)]
    path.write_text(COLUMNS + "".join(rows))
    result = run(path, "-o", tmp_path / "out.csv", "--q0", "level")
    assert result.exit_code == 2
    assert re.search(
        r"does not begin at rest .* choose --start at rest, or give --q0", result.stderr
    )


def test_level_needs_accelerations(tmp_path):
    """A log without an accelerometer says so."""
    path = tmp_path / "log.csv"
    path.write_text("t_ns,wx,wy,wz\n0,0,0,0\n10,0,0,0\n")
    result = run(path, "-o", tmp_path / "out.csv", "--q0", "level")
    assert result.exit_code == 2
    assert "it has no accelerations to take roll and pitch from; give --q0" in result.stderr


def test_a_series_as_the_beginning(resting, tmp_path):
    """--q0 FILE is the attitude of that series at the first sample, also between its rows."""
    log, out = resting
    other = tmp_path / "other.csv"
    other.write_text(
        f"t_ns,qw,qx,qy,qz\n-1000000000,1,0,0,0\n1000000000,{math.cos(0.5)},0,0,{math.sin(0.5)}\n"
    )
    assert run(log, "-o", out, "--q0", other).exit_code == 0
    assert geodesic_angle(first_row(out), [math.cos(0.25), 0, 0, math.sin(0.25)]) < 1e-15


def test_a_series_that_does_not_reach_is_refused(resting, tmp_path):
    """A series that ends before the first sample cannot say how to begin."""
    log, out = resting
    other = tmp_path / "other.csv"
    other.write_text("t_ns,qw,qx,qy,qz\n-20,1,0,0,0\n-10,1,0,0,0\n")
    result = run(log, "-o", out, "--q0", other)
    assert result.exit_code == 2
    assert str(other) in result.stderr
    assert not out.exists()


def test_the_log_s_own_orientation(shared_logs, tmp_path):
    """--q0 log begins from the orientation in the same messages; --start moves it along."""
    log = shared_logs / "husky" / "test1_husky.bag"
    out, own = tmp_path / "out.csv", tmp_path / "own.csv"
    converted = CliRunner().invoke(
        cli, ["convert", str(log), str(own), "-t", "/imu/data", "--layout", "scalar-first"]
    )
    assert converted.exit_code == 0, converted.output
    rows = {line.split(",")[0]: line.split(",")[1:] for line in own.read_text().splitlines()[1:]}
    for options in ([], ["--start", "+100s"]):
        result = run(log, "-o", out, "--q0", "log", *options)
        assert result.exit_code == 0, result.output
        stamp = out.read_text().splitlines()[1].split(",")[0]
        assert geodesic_angle(first_row(out), [float(q) for q in rows[stamp]]) < 1e-9


def test_stdin_cannot_be_read_twice():
    """What needs a second look needs a file."""
    result = run("-", "-o", "-", "--q0", "level")
    assert result.exit_code == 2
    assert "stdin can be read only once" in result.stderr
