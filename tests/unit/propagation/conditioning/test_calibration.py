"""Calibration of the gyroscope: ``--calibration``, in its own form and in kalibr's."""

import json

import numpy as np
import pytest

from quatprop import GyroSeries, propagate
from quatprop.base.errors import UsageError
from quatprop.propagation.conditioning.biases import read_calibration

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
    A: [[0, 0, 0], [0, 0, 0], [0, 0, 0]]
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
TRUE = np.sin(np.arange(50)[:, None] / 10 + np.arange(3))


def rotated(rate, **options):
    """Return the attitudes that rates lead to."""
    return propagate(GyroSeries(np.arange(50) * 10_000_000, rate), **options).wxyz


@pytest.fixture
def path(tmp_path):
    """Return where a calibration is written."""
    return tmp_path / "gyro.yaml"


@pytest.mark.parametrize("form", ["json", "yaml"])
def test_raw_rates_become_true_ones(form, path):
    """W = M (w_raw - b), as the file says."""
    text = json.dumps({"matrix": MATRIX.tolist(), "bias": BIAS.tolist()})
    if form == "yaml":
        rows = "".join(f"- {row}\n" for row in MATRIX.tolist())
        text = f"# of the laboratory\nmatrix:\n{rows}bias: {BIAS.tolist()}\n"
    path.write_text(text)
    raw, expected = TRUE @ np.linalg.inv(MATRIX).T + BIAS, rotated(TRUE)
    assert rotated(raw, calibration=path) == pytest.approx(expected, abs=1e-13)
    # A bias that is given or found is the newer one.
    newer = rotated(raw + 0.2, calibration=path, bias=BIAS + 0.2)
    assert newer == pytest.approx(expected, abs=1e-13)


def test_the_file_of_kalibr(path):
    """Its matrices turn true rates into measured ones: M C_gyro_i w + b."""
    path.write_text(KALIBR)
    m = np.array([[1.02, 0, 0], [0.03, 0.97, 0], [-0.01, 0.02, 1.01]])
    c_gyro_i = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    raw = np.array([m @ c_gyro_i @ w for w in TRUE])
    assert rotated(raw, calibration=path) == pytest.approx(rotated(TRUE), abs=1e-13)
    assert read_calibration(path).remarks == ()
    path.write_text("gyroscopes: {M: [[1000, 0, 0], [0, 1, 0], [0, 0, 1]]}")
    assert read_calibration(path)[:2] == (pytest.approx(np.diag([1e-3, 1, 1])), None)
    # The matrix A of kalibr needs the acceleration of every sample.
    path.write_text(KALIBR.replace("A: [[0, 0, 0], [0, 0,", "A: [[0, 0, 0], [0, 0.001,"))
    assert read_calibration(path).remarks == (
        f"{path}: the effect of acceleration on the rates (A of kalibr) is not corrected",
    )


def test_one_imu_of_several_is_chosen_by_its_topic(path):
    """Kalibr's file may be of several; the one with the topic of the rates is meant."""
    path.write_text(KALIBR + KALIBR.replace("imu0", "imu1").replace("1.02", "1.07"))
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
        ("matrix: [[1001, 0, 0], [0, 1, 0], [0, 0, 1]]", "matrix is singular (condition number 1"),
        ("matrix: [[1, 0, 0], [0, 1, 0]]", "matrix is not three rows of three numbers"),
        ("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, .nan]]", "matrix is not three rows"),
        ("matrix: [[1, 0, 0], [0, 1], [0, 0, 1]]", "matrix is not three rows of three numbers"),
        ("matrix: [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]", "matrix mirrors the axes"),
        ("{matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], bias: 3}", "bias is not three numbers"),
        ("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nbais: 3", "no key 'bais'; did you mean 'bias"),
        ("gyroscopes: {M: [[1, 0, 0]]}", "M is not three rows of three numbers"),
        ("gyroscopes: 3", "it holds no calibration; write matrix:"),
        ("- 3", "it holds no names with values"),
        ("matrix: [", "it is neither YAML nor JSON"),
        ("matrix: !!python/object:os.system [x]", "it is neither YAML nor JSON"),
        (None, "no such file or folder; check"),
    ],
)
def test_what_is_no_calibration_is_refused(text, reason, path):
    """One sentence, before anything is read."""
    if text is not None:
        path.write_text(text)
    with pytest.raises(UsageError) as refused:
        rotated(TRUE, calibration=path)
    assert str(refused.value).startswith(f"calibration {path}: {reason}")
