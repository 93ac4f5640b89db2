"""The numbers in a lock: what they say is compared by arithmetic of their own."""

import json
import sys
import warnings
from itertools import permutations, product

import numpy as np
import pytest
from make.suites import check, lock_of, pinned, stored
from make.tables import write_attitudes, write_rates
from scipy.spatial.transform import Rotation

import quatprop
from quatprop.readers import signal
from quatprop.tools.check.lock import pin_of
from quatprop.tools.check.pinned_numbers import final_apart_deg, moved_deg

ALIGNED = """\
[case.tumbling]
log = "tumbling.csv"
reference-log = "truth.csv"
align = "mount"
tol = "1deg"
pin-log = false
"""
AXES = [
    (order, signs)
    for order in permutations(range(3))
    for signs in product((1, -1), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)] * signs) > 0
][1:]
"""The 23 ways to name other axes of a right-handed frame."""


def write_tumbling(folder, order=(0, 1, 2), signs=(1, 1, 1)):
    """Write rates, with other axes, and their true attitudes."""
    rates, truth = quatprop.simulate(motion="tumbling", duration="3s", rate=50, noise=1e-4, seed=1)
    rows = [(int(t), *w) for t, w in zip(rates.t_ns, rates.rate[:, order] * signs, strict=True)]
    write_rates(folder / "tumbling.csv", rows)
    write_attitudes(folder / "truth.csv", truth.t_ns, truth.wxyz)


@pytest.mark.parametrize(("order", "signs"), AXES[::4])
def test_exchanged_axes_fail_although_the_alignment_removes_them(tmp_path, order, signs):
    """The alignment fitted them anew in every run, and the case passed."""
    write_tumbling(tmp_path)
    suite = pinned(tmp_path, ALIGNED)
    assert check(suite).exit_code == 0
    turned = Rotation.from_matrix(np.eye(3)[list(order)] * np.array(signs)[:, None])
    write_tumbling(tmp_path, order, signs)
    result = check(suite)
    assert result.exit_code == 1
    said = "the body frame of the reference is aligned by a rotation that is "
    moved = float(result.stdout.split(said)[1].split(" deg")[0])
    np.testing.assert_allclose(moved, np.degrees(turned.magnitude()), atol=0.1)


def test_a_log_that_begins_later_moves_no_body_frame(tmp_path):
    """Its reference frame is that of another first sample."""
    write_tumbling(tmp_path)
    suite = pinned(tmp_path, ALIGNED)
    lines = (tmp_path / "tumbling.csv").read_text().splitlines()
    (tmp_path / "tumbling.csv").write_text("\n".join([lines[0], *lines[2:], ""]))
    assert check(suite).exit_code == 0


def test_a_mistake_that_the_comparison_shares_is_found(folder, monkeypatch):
    """With rates of the other sign and angles of zero, every case passed."""
    suite = pinned(folder, stored())

    def negated(t_ns, rate, *others):
        return quatprop.GyroSeries(t_ns, -rate, *others)

    def zero(p, q):
        return np.zeros(np.broadcast_shapes(np.shape(p), np.shape(q))[:-1])

    monkeypatch.setattr(signal, "GyroSeries", negated)
    for module in [module for name, module in sys.modules.items() if name.startswith("quatprop.")]:
        if hasattr(module, "geodesic_angle"):
            monkeypatch.setattr(module, "geodesic_angle", zero)
    result = check(suite)
    assert result.exit_code == 1
    # 899.1 deg about an axis, and as many the other way.
    assert "the attitude at the last sample is 1.8 deg from the one in the lock" in result.stdout


def test_angles_between_pinned_numbers_are_those_of_scipy(folder):
    """Any final attitude, also near a pitch of 90 deg."""
    pins = lock_of(pinned(folder, stored()))
    rotations = Rotation.random(500, random_state=1)
    upright = Rotation.from_euler("ZYX", [[20, 90, 70], [-170, -90, 3]], degrees=True)
    for one, other in zip(
        [*rotations[:250], *upright], [*rotations[250:], *upright[::-1]], strict=True
    ):
        with warnings.catch_warnings(action="ignore"):  # gimbal lock
            yaw, pitch, roll = one.as_euler("ZYX", degrees=True)
        angles = {"roll": float(roll), "pitch": float(pitch), "yaw": float(yaw)}
        pin = pin_of({**pins["spin"], "final_deg": angles})
        a, b = (r.as_quat(scalar_first=True) for r in (one, other))
        apart = np.degrees((one.inv() * other).magnitude())
        np.testing.assert_allclose([final_apart_deg(pin, b), moved_deg(a, b)], apart, atol=2e-6)


def test_a_log_that_lost_samples_has_no_error(folder):
    """The error of the rows that were left, 0, was stated as that of the log."""
    suite = pinned(folder, stored())
    log = folder / "logs" / "spin.csv"
    log.write_bytes(log.read_bytes()[:-500])
    (case,) = json.loads(check(suite, "--json").stdout)["cases"]
    assert (case["verdict"], case["error_rad"], case["comparison"]) == ("error", None, None)
