"""``convert --left --right``: attitudes of other axes, against SciPy."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from make.commands import run
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries
from quatprop.base.errors import QuatpropError
from quatprop.kinematics.quaternion import geodesic_angle

NED_ENU = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FLU = Rotation.from_matrix([[1, 0, 0], [0, -1, 0], [0, 0, -1]])
QUARTER = Rotation.from_rotvec([0, 0, np.pi / 2])
SPELLED = [
    ("ned-to-enu", NED_ENU), ("enu-to-ned", NED_ENU.inv()), ("frd-to-flu", FRD_FLU),
    ("FLU-to-FRD", FRD_FLU.inv()), ("y,-x,z", QUARTER.inv()), ("0.6,0,0.8,0", None),
    ("rpy:10,-20,130", Rotation.from_euler("xyz", [10, -20, 130], degrees=True)),
    ("y:30deg", Rotation.from_euler("y", 30, degrees=True)),
    ("Z:-1.5", Rotation.from_euler("z", -1.5, degrees=True)),
]  # fmt: skip


@pytest.fixture
def source(tmp_path):
    """Return a file of random attitudes, with positions."""
    rng = np.random.default_rng(5)
    q = Rotation.random(50, rng)
    series = AttitudeSeries(
        np.arange(50) * 10, q.as_quat(scalar_first=True), rng.normal(size=(50, 3))
    )
    quatprop.write(series, tmp_path / "in.tum")
    return tmp_path / "in.tum", q, series.position


@pytest.mark.parametrize(("text", "turn"), SPELLED)
def test_either_side_takes_old_axes_to_new(source, tmp_path, text, turn):
    """On the left those of the reference, with positions; on the right those of the body."""
    path, q, position = source
    turn = turn or Rotation.from_quat([0.6, 0, 0.8, 0], scalar_first=True)
    for side, expected in (("left", turn * q), ("right", q * turn.inv())):
        run("convert", path, tmp_path / "out.tum", f"--{side}", text, code=0)
        found = quatprop.read_attitudes(tmp_path / "out.tum")
        assert geodesic_angle(found.wxyz, expected.as_quat(scalar_first=True)).max() < 1e-15 * 8
        moved = turn.apply(position.copy()) if side == "left" else position
        np.testing.assert_allclose(found.position, moved, atol=1e-15)


def test_right_is_what_mount_is(tmp_path):
    """The attitudes of a body are those of its sensor with the mounting on the right."""
    options = {"method": "coning", "q0": (0.6, 0.8, 0, 0)}
    log, mount = "sample_logs/tumbling.bag", "rpy:0,30,0"
    sensor, body = (tmp_path / name for name in ("sensor.csv", "body.csv"))
    quatprop.write(quatprop.propagate(log, **options), sensor)
    run("convert", sensor, body, "--right", mount, code=0)
    m = Rotation.from_euler("y", 30, degrees=True)
    q0 = Rotation.from_quat([0.6, 0.8, 0, 0], scalar_first=True) * m.inv()
    options["q0"] = q0.as_quat(scalar_first=True)
    propagated = quatprop.propagate(log, mount=mount, **options)
    assert geodesic_angle(quatprop.read_attitudes(body).wxyz, propagated.wxyz).max() < 1e-13


def test_python_takes_matrices_and_rotations(source, tmp_path):
    """In both places where a rotation is wanted."""
    path, q, _ = source
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 0.9])
    expected = (turn * q * FRD_FLU.inv()).as_quat(scalar_first=True)
    for left in (
        turn,
        turn.as_matrix(),
        turn.as_matrix().tolist(),
        turn.as_quat(scalar_first=True),
    ):
        quatprop.convert(path, tmp_path / "out.csv", left=left, right="frd-to-flu")
        found = quatprop.read_attitudes(tmp_path / "out.csv").wxyz
        assert geodesic_angle(found, expected).max() < 1e-15 * 8
    with pytest.raises(QuatpropError, match="is not a rotation matrix"):
        quatprop.convert(path, tmp_path / "out.csv", left=np.eye(3) * 2)


def test_covariances_turn_with_the_body(tmp_path):
    """Their rotations are about its axes; deviations alone say nothing of axes between those."""
    variances = np.array([1.0, 4.0, 9.0]) * 1e-4
    series = AttitudeSeries(
        np.arange(3), [[1, 0, 0, 0]] * 3, covariance=np.tile(np.diag(variances), (3, 1, 1))
    )
    quatprop.write(series, tmp_path / "in.parquet")
    run("convert", tmp_path / "in.parquet", tmp_path / "out.parquet", "--right", "y,-x,z", code=0)
    table = pq.read_table(tmp_path / "out.parquet")
    found = [table[f"sigma_{axis}"][0].as_py() for axis in "xyz"]
    np.testing.assert_allclose(found, [0.02, 0.01, 0.03], atol=1e-15)
    said = run("convert", tmp_path / "in.parquet", tmp_path / "out.parquet",
               "--right", "rpy:30,0,0", code=0).stderr  # fmt: skip
    assert "axes that are at most permuted" in said
    assert pq.read_schema(tmp_path / "out.parquet").names == ["t_ns", "qw", "qx", "qy", "qz"]


def test_the_metadata_state_the_change_of_axes(source, tmp_path):
    """As typed."""
    done = run("convert", source[0], tmp_path / "a.parquet", "--left", "ned-to-enu", code=0)
    assert "axes of the reference by ned-to-enu\n" in done.stderr
    told = json.loads(pq.read_metadata(tmp_path / "a.parquet").metadata[b"quatprop"])
    assert told["conversions"][0]["to"]["left"] == "ned-to-enu"
    assert "right" not in told["conversions"][0]["to"]
