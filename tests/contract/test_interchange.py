"""What other tools write is read, and what they read is written, with as few options as needed."""

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pytest
from click.testing import CliRunner
from evo.core.trajectory import PosePath3D, PoseTrajectory3D
from evo.tools import file_interface
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, read_attitudes
from quatprop.cli.commands import cli

T_S = np.array([0.0, 0.1, 0.2])
WXYZ = Rotation.random(3, random_state=3).as_quat(canonical=True, scalar_first=True)
XYZ = np.arange(9.0).reshape(3, 3)


def run(*arguments):
    """Return the result of a command that is expected to end well."""
    result = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


def piped(*arguments, data=b""):
    """Return what quatprop writes to a pipe, given what it reads from one."""
    command = [sys.executable, "-m", "quatprop", *map(str, arguments)]
    return subprocess.run(command, input=data, capture_output=True, check=True).stdout


def test_a_trajectory_of_kitti_is_read_with_its_positions(tmp_path):
    """As evo writes it: twelve numbers a row and no time."""
    path = tmp_path / "poses.kitti"
    file_interface.write_kitti_poses_file(
        path, PosePath3D(positions_xyz=XYZ, orientations_quat_wxyz=WXYZ)
    )
    with pytest.warns(RemarkWarning, match="which of q and -q is meant is not stored"):
        series = read_attitudes(path, sample_rate=10)
    np.testing.assert_allclose(series.wxyz, WXYZ, atol=1e-9)
    np.testing.assert_array_equal(series.t_ns, [0, 100_000_000, 200_000_000])
    run("convert", path, tmp_path / "poses.tum", "--sample-rate", "10")
    again = file_interface.read_tum_trajectory_file(tmp_path / "poses.tum")
    np.testing.assert_allclose(again.positions_xyz, XYZ, atol=1e-9)
    path.rename(tmp_path / "poses.txt")
    with pytest.warns(RemarkWarning, match="which of q and -q is meant is not stored"):
        other = read_attitudes(tmp_path / "poses.txt", kind="kitti", sample_rate=10)
    np.testing.assert_array_equal(other.wxyz, series.wxyz)


def test_a_trajectory_of_kitti_needs_a_rate_and_twelve_columns(tmp_path):
    """What is missing is named."""
    path = tmp_path / "poses.kitti"
    path.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    result = CliRunner().invoke(cli, ["convert", str(path), "-"])
    assert result.exit_code == 2
    assert "or --sample-rate HZ for rows at a steady rate" in result.stderr
    path.write_text("1 0 0 0\n")
    result = CliRunner().invoke(cli, ["convert", str(path), "-"])
    assert "it has 4 columns, and a KITTI trajectory has 12: r11 r12 r13 tx" in result.stderr


def test_a_trajectory_is_written_as_kitti_has_them(tmp_path):
    """Evo reads it without an option, with the positions; so does quatprop, given a rate."""
    source, path = tmp_path / "poses.tum", tmp_path / "poses.kitti"
    file_interface.write_tum_trajectory_file(source, PoseTrajectory3D(XYZ, WXYZ, T_S))
    lost = "the timestamps are not kept: kitti has no place for them"
    assert lost in run("propagate", SAMPLE_LOGS / "spin.csv", "-o", path).stderr
    assert lost in run("convert", source, path).stderr
    found = file_interface.read_kitti_poses_file(path)
    np.testing.assert_allclose(found.positions_xyz, XYZ, atol=1e-15)
    expected = Rotation.from_quat(WXYZ, scalar_first=True).as_matrix()
    np.testing.assert_allclose(np.array(found.poses_se3)[:, :3, :3], expected, atol=1e-9)
    evo = subprocess.run([Path(sys.executable).parent / "evo_traj", "kitti", path, "--full_check"],
                         capture_output=True, text=True, check=False)  # fmt: skip
    assert evo.returncode == 0, evo.stderr
    assert "SE(3) conform\tyes" in evo.stdout
    again = tmp_path / "again.kitti"
    run("convert", path, again, "--sample-rate", "10")
    np.testing.assert_allclose(np.loadtxt(again), np.loadtxt(path), atol=1e-15)


def test_attitudes_become_rows_of_kitti_at_the_origin(tmp_path):
    """A quarter turn about z takes x to y; the rows of the matrix follow one another."""
    run("simulate", tmp_path / "spin.csv", "--frequency", "0.25", "--duration", "2s", "--rate", "1")
    run("propagate", tmp_path / "spin.csv", "-o", tmp_path / "spin.kitti")
    rows = np.loadtxt(tmp_path / "spin.kitti").round(12) + 0.0
    assert rows.tolist() == [
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
        [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0],
    ]
    arguments = ["convert", str(tmp_path / "spin.truth.csv"), "-", "--to", "kitti"]
    result = CliRunner().invoke(cli, [*arguments, "--header-comment"])
    assert "kitti has no comments; leave --header-comment out" in result.stderr


def test_a_trajectory_of_evo_is_read_as_it_is(tmp_path):
    """Which has no header."""
    path = tmp_path / "poses.tum"
    file_interface.write_tum_trajectory_file(path, PoseTrajectory3D(XYZ, WXYZ, T_S))
    np.testing.assert_allclose(read_attitudes(path).wxyz, WXYZ, atol=1e-9)


def test_columns_that_are_only_components_mean_a_quaternion_where_one_is_asked_for(tmp_path):
    """As NGIMU's quaternion.csv has them; by themselves they are not taken for one."""
    path = tmp_path / "quaternion.csv"
    frame = pd.DataFrame(WXYZ, columns=list("WXYZ"))
    frame.insert(0, "Time (s)", T_S)
    frame.to_csv(path, index=False)
    series = read_attitudes(path, quat_cols="W,X,Y,Z")
    np.testing.assert_array_equal(series.wxyz, WXYZ)
    series = read_attitudes(path, quat_cols="X,Y,Z,W")
    np.testing.assert_array_equal(series.wxyz, WXYZ)
    assert CliRunner().invoke(cli, ["convert", str(path), "-"]).exit_code == 2


@pytest.mark.parametrize("name", ["coning.mcap", "tumbling.bag", "rest.parquet"])
def test_a_binary_log_is_read_from_a_pipe(tmp_path, name):
    """Its kind is recognised; the attitudes are those of the file."""
    run("propagate", SAMPLE_LOGS / name, "-o", tmp_path / "a.csv", "-q")
    assert (
        piped("propagate", "-", "-o", "-", "-q", data=(SAMPLE_LOGS / name).read_bytes())
        == (tmp_path / "a.csv").read_bytes()
    )


@pytest.mark.parametrize("kind", ["parquet", "feather", "mcap"])
def test_a_binary_format_is_written_to_a_pipe(tmp_path, kind):
    """The bytes are those of the file, up to its name."""
    log, out = SAMPLE_LOGS / "coning.mcap", tmp_path / f"a.{kind}"
    run("propagate", log, "-o", out, "-q")
    assert piped("propagate", log, "-o", "-", "--to", kind, "-q") == out.read_bytes()


def test_tables_open_in_pandas_and_polars_without_an_option():
    """From a pipe, too."""
    log = SAMPLE_LOGS / "coning.mcap"
    data = piped("propagate", log, "-o", "-", "--to", "parquet", "-q")
    names = ["t_ns", "qw", "qx", "qy", "qz"]
    assert pd.read_parquet(io.BytesIO(data)).columns.tolist() == names
    assert pl.read_parquet(io.BytesIO(data)).columns == names
    text = piped("propagate", log, "-o", "-", "-q")
    assert pd.read_csv(io.BytesIO(text))["t_ns"].dtype == np.int64
    assert pl.read_csv(io.BytesIO(text)).schema["t_ns"] == pl.Int64
