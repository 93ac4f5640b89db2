"""Rates are compared with the turning of gravity in the accelerometer next to them."""

import numpy as np
import pytest

import quatprop
from quatprop import GyroSeries
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, exp, rotate
from quatprop.propagation.gravity_check import against_gravity

DEG, G = np.pi / 180, 9.81
SEEDS = range(4)


def waves(random, t_s, low, high, rms):
    """Return a sum of waves of some frequencies, Hz, shape ``(N, 3)``."""
    total = np.zeros((len(t_s), 3))
    for frequency in np.exp(random.uniform(np.log(low), np.log(high), 6)):
        phase = 2 * np.pi * frequency * t_s[:, None] + random.uniform(0, 6.3, 3)
        total += random.normal(size=3) * np.sin(phase)
    return rms * total / total.std(axis=0)


def sensor(seed, motion="by hand"):
    """Return times, ns, measured rates, rad/s, and specific forces, m/s^2, of a body."""
    random = np.random.default_rng(seed)
    hz, size = random.choice([50, 100, 200, 400]), random.uniform(10, 60) * DEG
    t_s = np.arange(40 * hz) / hz
    t_ns = np.rint(t_s * 1e9).astype(np.int64)
    rate = waves(random, t_s, 0.05, 1.5, size)
    moved = waves(random, t_s, 0.1, 2.0, random.uniform(0.0, 0.5))
    if motion == "vehicle":
        rate *= [0.05, 0.05, 1.0]
        # In a bend, the acceleration is across the way.
        moved = np.stack([0 * t_s, 10.0 * rate[:, 2], 0 * t_s], axis=1)
    if motion == "shaken":
        moved = waves(random, t_s, 0.1, 2.0, 5.0)
    true = attitudes(t_ns, rate, method="mean")
    down = rotate(conjugate(true), np.tile([0.0, 0.0, G], (len(t_s), 1)))
    if motion == "pendulum":
        rate *= [1.0, 0.0, 0.0]
        down = np.tile([0.0, 0.0, 1.0], (len(t_s), 1)) * (G + rate[:, :1] ** 2)
    if motion == "flight":
        # Of a rotorcraft, the specific force is that of its thrust, wherever it tilts.
        down = np.tile([0.0, 0.0, G], (len(t_s), 1))
    if motion == "rest":
        rate, down = 0 * rate, np.tile(down[0], (len(t_s), 1))
    rate = rate + random.normal(0, 0.003, rate.shape) + random.normal(0, 0.01, 3)
    return t_ns, rate, down + moved + random.normal(0, 0.05, rate.shape)


FAULTS = {
    "deg/s as rad/s": (lambda w: w / DEG, "57.3 times too large"),
    "rad/s as deg/s": (lambda w: w * DEG, "57.3 times too small"),
    "two axes": (lambda w: w[:, [1, 0, 2]], "as the rates do about y, x, z,"),
    "half a turn": (lambda w: w * [-1, -1, 1], "as the rates do about -x, -y, z,"),
    "cycled": (lambda w: w[:, [1, 2, 0]], "as the rates do about z, x, y,"),
    "mirrored": (lambda w: w * [1, -1, 1], "as the rates do about x, -y, z,"),
    "opposite": (lambda w: -w, "as the rates do about -x, -y, -z,"),
    "axes and unit": (lambda w: w[:, [2, 1, 0]] / DEG, "about z, y, x,"),
}


@pytest.mark.thorough
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("fault", FAULTS)
def test_another_unit_or_other_axes_are_named(seed, fault):
    """Whichever sign and unit the accelerations have."""
    change, expected = FAULTS[fault]
    t_ns, rate, force = sensor(seed)
    for scale in (1.0, -1 / G):
        found = against_gravity(GyroSeries(t_ns, change(rate)), t_ns, scale * force, "rad/s")
        assert found is not None
        assert expected in str(found)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["by hand", "vehicle", "shaken", "pendulum", "flight", "rest"])
def test_nothing_is_said_of_a_sound_sensor(seed, motion):
    """Also where the accelerations show something else than gravity."""
    t_ns, rate, force = sensor(seed, motion)
    assert against_gravity(GyroSeries(t_ns, rate), t_ns, force, "rad/s") is None


@pytest.mark.thorough
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("motion", ["vehicle", "shaken", "pendulum", "flight", "rest"])
@pytest.mark.parametrize("fault", FAULTS)
def test_no_wrong_cause_is_named_where_gravity_is_hidden(seed, motion, fault):
    """It may be missed, but not called another one."""
    change, expected = FAULTS[fault]
    t_ns, rate, force = sensor(seed, motion)
    found = against_gravity(GyroSeries(t_ns, change(rate)), t_ns, force, "rad/s")
    assert found is None or expected in str(found)


@pytest.mark.parametrize("angle", [20, 45, 70])
def test_an_accelerometer_that_is_turned_by_another_angle_is_no_choice_of_axes(angle):
    """No signed axes make the two agree, so none are named."""
    t_ns, rate, force = sensor(3)
    turned = rotate(exp(np.array([angle * DEG, 0.0, 0.0]))[None], force)
    assert against_gravity(GyroSeries(t_ns, rate), t_ns, turned, "rad/s") is None


@pytest.mark.parametrize("rate", [5, 20])
def test_clipping_and_gaps_are_no_contradiction(rate):
    """Forces of a clipped sensor, in packets with pauses, with values that are missing."""
    t_ns, rates, force = sensor(rate)
    force = np.clip(force, -G, G)
    force[::7] = np.nan
    kept = (np.arange(len(t_ns)) // 300) % 3 != 0
    series = GyroSeries(t_ns[kept], rates[kept])
    assert against_gravity(series, t_ns, force, "rad/s") is None


@pytest.mark.parametrize(
    "name",
    ["a{} [m/s^2]", "acc_{}_g", "a{}_m_s2", "accel_{}_mps2", "accelerometerAcceleration{}(G)"],
)
def test_a_table_is_read_in_the_unit_that_the_remark_names(tmp_path, name):
    """The header states the wrong unit, and the remark the option that overrides it."""
    t_ns, rate, force = sensor(1)
    forces = [name.format(axis.upper() if "(G)" in name else axis) for axis in "xyz"]
    head = ",".join(["t [s],gx [rad/s],gy [rad/s],gz [rad/s]", *forces])
    path, rows = tmp_path / "log.csv", np.column_stack([t_ns * 1e-9, rate / DEG, force])
    np.savetxt(path, rows, "%.9f", ",", header=head, comments="")
    with pytest.warns(
        quatprop.QuatpropWarning, match="if they are in deg/s, use rate_unit='deg/s'"
    ):
        quatprop.propagate(path)
    with pytest.warns(quatprop.QuatpropWarning, match="read in deg/s, as requested"):
        read = quatprop.propagate(path, rate_unit="deg/s")
    assert "gravity-off-scale" not in {one.code for one in read.report.remarks}
    true = attitudes(t_ns, rate)
    np.testing.assert_allclose(read.wxyz, true, atol=1e-4)
