"""Of a program that writes minus the specific force, a level start is not upside down."""

import numpy as np
import pytest

import quatprop
from quatprop.kinematics.quaternion import conjugate, exp, rotate

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("name", "scale"), [("accelerometerAcceleration{}(G)", -1.0), ("acc_{} [m/s^2]", 9.81)]
)
def test_the_reference_points_up_by_the_accelerometer_of_a_phone(tmp_path, name, scale, seed):
    """As SensorLog of iOS and loggers of Android write it."""
    random = np.random.default_rng(seed)
    true = exp(random.uniform(-1, 1, 3))
    up = rotate(conjugate(true)[None], UP)
    rows = np.column_stack([
        np.arange(300) * 0.01,
        random.normal(0, 1e-3, (300, 3)),
        scale * up + random.normal(0, 1e-3, (300, 3)),
    ])  # fmt: skip
    head = ",".join(["t (s),wx (rad/s),wy (rad/s),wz (rad/s)", *map(name.format, "XYZ")])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, "%.9f", ",", header=head, comments="")
    read = quatprop.propagate(path, q0="level")
    np.testing.assert_allclose(rotate(conjugate(read.wxyz[:1]), UP), up, atol=5e-3)
    said = {one.code for one in read.report.remarks}
    assert ("reversed-forces" in said) == (scale < 0)
