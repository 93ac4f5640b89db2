"""Calibration of the gyroscope: ``--calibration``, in its own form and in kalibr's."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from quatprop import GyroSeries, propagate
from quatprop.check.cases import load_cases
from quatprop.cli.commands import cli
from quatprop.conditioning.calibration import read_calibration
from quatprop.errors import UsageError

MATRIX = np.array([[1.02, 0.01, -0.02], [0.0, 0.97, 0.03], [0.015, -0.01, 1.01]])
BIAS = np.array([0.01, -0.02, 0.03])
KALIBR = """\
imu0:
  T_i_b:
  - [1.0, 0.0, 0.0, 0.0]
  accelerometers:
    M:
    - [1.01, 0.0, 0.0]
    - [0.0, 1.0, 0.0]
    - [0.0, 0.0, 1.0]
  gyroscope_noise_density: 0.0004
  gyroscopes:
    A: {force}
    C_gyro_i:
    - [0.0, -1.0, 0.0]
    - [1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0]
    M:
    - [1.02, 0.0, 0.0]
    - [0.03, 0.97, 0.0]
    - [-0.01, 0.02, 1.01]
  model: scale-misalignment
  rostopic: /imu0
  update_rate: 200.0
"""
"""As kalibr writes it."""
NO_FORCE = "[[0, 0, 0], [0, 0, 0], [0, 0, 0]]"


def series():
    """Return true rates."""
    return np.sin(np.arange(50)[:, None] / 10 + np.arange(3))


def rotated(rate, **options):
    """Return the attitudes that rates lead to."""
    return propagate(GyroSeries(np.arange(50) * 10_000_000, rate), **options).wxyz


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_raw_rates_become_true_ones(form, tmp_path):
    """W = M (w_raw - b), as the file says."""
    path, true = tmp_path / f"gyro.{form}", series()
    text = json.dumps({"matrix": MATRIX.tolist(), "bias": BIAS.tolist()})
    if form == "yaml":
        rows = "".join(f"- {row}\n" for row in MATRIX.tolist())
        text = f"# of the laboratory\nmatrix:\n{rows}bias: {BIAS.tolist()}\n"
    path.write_text(text)
    raw = true @ np.linalg.inv(MATRIX).T + BIAS
    assert rotated(raw, calibration=path) == pytest.approx(rotated(true), abs=1e-13)
    # A bias that is given or found is the newer one.
    other = raw + 0.5
    assert rotated(other, calibration=path, bias=BIAS + 0.5) == pytest.approx(
        rotated(true), abs=1e-13
    )


def test_the_file_of_kalibr(tmp_path):
    """Its matrices turn true rates into measured ones: M C_gyro_i w + b."""
    path, true = tmp_path / "imu.yaml", series()
    path.write_text(KALIBR.format(force=NO_FORCE))
    m = np.array([[1.02, 0, 0], [0.03, 0.97, 0], [-0.01, 0.02, 1.01]])
    c_gyro_i = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    raw = np.array([m @ c_gyro_i @ w for w in true])
    assert rotated(raw, calibration=path) == pytest.approx(rotated(true), abs=1e-13)


def test_the_effect_of_acceleration_is_not_corrected_and_that_is_said(tmp_path):
    """What kalibr calls A needs the acceleration of every sample."""
    path = tmp_path / "imu.yaml"
    path.write_text(KALIBR.format(force="[[0, 0, 0], [0, 0.001, 0], [0, 0, 0]]"))
    assert read_calibration(path).remarks == (
        f"{path}: the effect of acceleration on the rates (A of kalibr) is not corrected",
    )


def test_one_imu_of_several_is_chosen_by_its_topic(tmp_path):
    """Kalibr's file may be of several; the one with the topic of the rates is meant."""
    path = tmp_path / "imus.yaml"
    one = KALIBR.format(force=NO_FORCE)
    other = one.replace("imu0", "imu1").replace("1.02", "1.07")
    path.write_text(one + other)
    assert np.linalg.inv(read_calibration(path, "/imu1").matrix)[0, 1] == pytest.approx(-1.07)
    assert np.linalg.inv(read_calibration(path, "/imu0").matrix)[0, 1] == pytest.approx(-1.02)
    with pytest.raises(UsageError) as refused:
        read_calibration(path, "/imu")
    assert str(refused.value) == (
        f"calibration {path}: it has several IMUs ('imu0', 'imu1'), and none with rostopic '/imu'"
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("matrix: [[1, 2, 3], [2, 4, 6], [0, 0, 1]]", "matrix is singular (condition number"),
        ("matrix: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "matrix is singular (condition number inf)"),
        ("matrix: [[1, 0, 0], [0, 1, 0]]", "matrix is not three rows of three numbers"),
        ("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, .nan]]", "matrix is not three rows"),
        ("matrix: [[1, 0, 0], [0, 1], [0, 0, 1]]", "matrix is not three rows of three numbers"),
        ("matrix: [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]", "matrix mirrors the axes"),
        ("{matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], bias: 3}", "bias is not three numbers"),
        ("gyroscopes: {M: [[1, 0, 0]]}", "M is not three rows of three numbers"),
        ("gyroscopes: 3", "it holds no calibration; write matrix:"),
        ("- 3", "it holds no names with values"),
        ("matrix: [", "it is neither YAML nor JSON"),
        ("matrix: !!python/object:os.system [x]", "it is neither YAML nor JSON"),
    ],
)
def test_what_is_no_calibration_is_refused(text, reason, tmp_path):
    """One sentence, before anything is read."""
    path, log, out = tmp_path / "gyro.yaml", tmp_path / "log.csv", tmp_path / "out.csv"
    path.write_text(text)
    log.write_text("t_ns,wx,wy,wz\n0,0,0,1\n10,0,0,1\n")
    result = CliRunner().invoke(
        cli, ["propagate", str(log), "-o", str(out), "--calibration", str(path)]
    )
    assert result.exit_code == 2
    assert f"--calibration {path}: {reason}" in result.stderr
    assert not out.exists()


def test_a_missing_file_is_refused(tmp_path):
    """The sentence names the file."""
    with pytest.raises(UsageError, match=r"nowhere.yaml: no such file or folder; check"):
        propagate(GyroSeries([0, 10], np.zeros((2, 3))), calibration=tmp_path / "nowhere.yaml")


def test_a_calibration_is_an_input_of_a_case(tmp_path):
    """A suite names it beside itself, and pins it."""
    (tmp_path / "log.csv").write_text("t_ns,wx,wy,wz\n0,0,0,1\n10,0,0,1\n")
    (tmp_path / "gyro.json").write_text(json.dumps({"matrix": MATRIX.tolist()}))
    suite = tmp_path / "suite.toml"
    suite.write_text(
        '[case.a]\nlog = "log.csv"\nreference = "a.parquet"\ncalibration = "gyro.json"\n'
    )
    _, (case,) = load_cases(suite)
    assert case.inputs["calibration"] == str(tmp_path / "gyro.json")


def test_a_key_that_is_not_known_is_refused(tmp_path):
    """A misspelt bias is not left out silently."""
    path = tmp_path / "gyro.json"
    path.write_text(json.dumps({"matrix": MATRIX.tolist(), "bais": BIAS.tolist()}))
    with pytest.raises(UsageError) as caught:
        read_calibration(path)
    assert str(caught.value) == f"calibration {path}: no key 'bais'; did you mean 'bias'?"
