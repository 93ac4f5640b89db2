"""Files of other tools are read, and files that they read are written, with few options."""

import io

import numpy as np
import pandas as pd
import pytest
from evo.core.trajectory import PosePath3D, PoseTrajectory3D
from evo.tools import file_interface
from make.commands import refused, run
from make.places import SAMPLE_LOGS
from make.tables import write_rates
from scipy.spatial.transform import Rotation

from quatprop import RemarkWarning, read_attitudes

WXYZ = Rotation.random(3, random_state=3).as_quat(canonical=True, scalar_first=True)
XYZ = np.arange(9.0).reshape(3, 3)
MATRICES = Rotation.from_quat(WXYZ, scalar_first=True).as_matrix()
TRAJECTORY = PoseTrajectory3D(XYZ, WXYZ, np.array([0.0, 0.1, 0.2]))


def test_a_trajectory_of_kitti_is_read_with_its_positions(tmp_path):
    """As evo writes it: twelve numbers a row and no time."""
    path = tmp_path / "poses.kitti"
    poses = PosePath3D(positions_xyz=XYZ, orientations_quat_wxyz=WXYZ)
    file_interface.write_kitti_poses_file(path, poses)
    run("convert", path, tmp_path / "poses.tum", "--sample-rate", "10", code=0)
    again = file_interface.read_tum_trajectory_file(tmp_path / "poses.tum")
    np.testing.assert_allclose(again.positions_xyz, XYZ, atol=1e-9)
    path.rename(tmp_path / "poses.txt")
    with pytest.warns(RemarkWarning, match="which of q and -q is meant is not stored"):
        series = read_attitudes(tmp_path / "poses.txt", kind="kitti", sample_rate=10)
    for found in (series, read_attitudes(tmp_path / "poses.tum")):
        np.testing.assert_allclose(found.wxyz, WXYZ, atol=1e-9)
        np.testing.assert_array_equal(found.t_ns, [0, 100_000_000, 200_000_000])


def test_a_trajectory_is_written_as_kitti_has_them(tmp_path):
    """Evo reads it without an option, with the positions; so does quatprop, given a rate."""
    source, path = tmp_path / "poses.tum", tmp_path / "poses.kitti"
    file_interface.write_tum_trajectory_file(source, TRAJECTORY)
    lost = "the timestamps are not kept: kitti has no place for them"
    assert lost in run("convert", source, path, code=0).stderr
    found = file_interface.read_kitti_poses_file(path)
    assert found.check()[0]
    np.testing.assert_allclose(found.positions_xyz, XYZ, atol=1e-15)
    np.testing.assert_allclose(np.array(found.poses_se3)[:, :3, :3], MATRICES, atol=1e-9)
    again = tmp_path / "again.kitti"
    run("convert", path, again, "--sample-rate", "10", code=0)
    np.testing.assert_allclose(np.loadtxt(again), np.loadtxt(path), atol=1e-15)


def test_attitudes_become_rows_of_kitti_at_the_origin(tmp_path):
    """A quarter turn about z takes x to y; the rows of the matrix follow one another."""
    log = write_rates(tmp_path / "spin.csv", [(t * 10**9, 0, 0, np.pi / 2) for t in (0, 1)])
    told = run("propagate", log, "-o", tmp_path / "spin.kitti", code=0).stderr
    assert "the timestamps are not kept: kitti has no place for them" in told
    rows = np.loadtxt(tmp_path / "spin.kitti").round(12) + 0.0
    assert rows.tolist() == [
        [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
        [0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0],
    ]
    sentence = refused("propagate", log, "-o", "-", "--to", "kitti", "--header-comment")
    assert "kitti has no comments; omit --header-comment" in sentence


def test_columns_that_are_only_components_mean_a_quaternion_where_one_is_asked_for(tmp_path):
    """By themselves they are not taken for one, but in NGIMU's quaternion.csv."""
    path = tmp_path / "log.csv"
    frame = pd.DataFrame(WXYZ, columns=list("WXYZ"))
    frame.insert(0, "Time (s)", TRAJECTORY.timestamps)
    frame.to_csv(path, index=False)
    for columns in ("W,X,Y,Z", "X,Y,Z,W"):
        np.testing.assert_array_equal(read_attitudes(path, quat_cols=columns).wxyz, WXYZ)
    refused("convert", path, "-")
    path.rename(tmp_path / "quaternion.csv")
    np.testing.assert_array_equal(read_attitudes(tmp_path / "quaternion.csv").wxyz, WXYZ)


@pytest.mark.parametrize(
    ("name", "kind"),
    [("coning.mcap", "parquet"), ("tumbling.bag", "feather"), ("rest.parquet", "mcap")],
)
def test_binary_formats_go_through_pipes(tmp_path, name, kind):
    """The kind of what is read is recognised; the bytes are those of files, up to its name."""
    run("propagate", SAMPLE_LOGS / name, "-o", tmp_path / "a.csv", "-q", code=0)
    stdin = io.BufferedReader(io.BytesIO((SAMPLE_LOGS / name).read_bytes()))
    piped = run("propagate", "-", "-o", "-", "--to", kind, "-q", input=stdin, code=0)
    assert piped.stderr == ""
    (tmp_path / f"b.{kind}").write_bytes(piped.stdout_bytes)
    run("convert", tmp_path / f"b.{kind}", tmp_path / "b.csv", "-q", code=0)
    assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()
