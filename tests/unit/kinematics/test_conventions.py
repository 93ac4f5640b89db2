"""The convention, by the five checks and against the six pitfalls of the source article.

The motions here are worked out on paper from pictures of axes, or in closed form, so that no test
shares a formula with the code. Each pitfall test fails when its pitfall is put into the code.
"""

import numpy as np
import pytest

from quatprop.kinematics.propagate import TILE, attitudes
from quatprop.kinematics.quaternion import exp, geodesic_angle, multiply, rotate, rotation_matrix

SECOND = 1_000_000_000
QUARTER = np.pi / 2
X, Y, Z = np.eye(3)
# As many steps as the tree has a loop at its foot, a tree of its own, and several trees.
COUNTS = [5, 100, 3 * TILE + 5]


def turn(rate, count=101, seconds=1, **options):
    """Return the attitudes along a constant rate over some seconds."""
    t_ns = np.linspace(0, seconds * SECOND, count).round().astype(np.int64)
    return attitudes(t_ns, np.tile(np.asarray(rate, float), (count, 1)), **options)


def turns(*rates, count=101, **options):
    """Return the last attitude after each of several rates has acted for a second."""
    rate = np.repeat(np.array(rates, float), count - 1, axis=0)
    t_ns = np.linspace(0, len(rates) * SECOND, len(rate) + 1).round().astype(np.int64)
    return attitudes(t_ns, np.concatenate([rate, rate[-1:]]), **options)[-1]


def same(p, q, tol=1e-9):
    """Tell whether two attitudes are the same."""
    return np.max(geodesic_angle(p, q)) < tol


def tumbling(count=2000, seed=1):
    """Return stamps and body rates of a motion about all axes."""
    phase = np.linspace(0, 20, count)[:, None] * [1.0, 0.7, 1.3] + np.arange(3)
    return np.arange(count) * 10_000_000, 3 * np.sin(phase + seed)


# --- the five checks


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_check_1_zero_rate_keeps_the_attitude(rates):
    """Where the rate is zero, nothing turns."""
    q0 = exp([0.4, -0.3, 0.8])
    assert np.abs(turn([0, 0, 0], 3 * TILE, q0=q0, rates=rates) - q0).max() < 4e-16


@pytest.mark.parametrize("rate", [1e-6, 0.1, 3.0, 40.0])
def test_check_2_spin_about_z(rate):
    """From q = 1, a positive z rate gives q = cos(wt/2) + k sin(wt/2) (eq. 37), for many turns."""
    steps = np.random.default_rng(1).integers(1, 50_000_000, 20_000)
    t_ns = np.concatenate([[0], np.cumsum(steps)])
    half = rate * (t_ns / 1e9) / 2
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    q = attitudes(t_ns, np.tile(rate * Z, (len(t_ns), 1)))
    assert np.abs(q - expected).max() < 1e-14 + 1e-15 * half[-1]


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_check_3_opposite_sign_is_the_same_trajectory(rates):
    """From -q0 every quaternion is the opposite, to the bit, and every attitude the same."""
    t_ns, rate = tumbling()
    q0 = exp([0.4, -0.3, 0.8])
    q, opposite = (attitudes(t_ns, rate, q0=start, rates=rates) for start in (q0, -q0))
    assert np.array_equal(opposite, -q)
    assert same(opposite, q, 1e-15)


def test_check_4_body_and_inertial_forms_agree():
    """The same motion through w_I = R(q) w_B gives the same attitudes, first order apart."""
    t_ns, rate = tumbling()
    q0 = exp([0.4, -0.3, 0.8])
    body = attitudes(t_ns, rate, q0=q0)
    # The rate of a step is constant in both frames at once, for it lies along the step's own axis.
    inertial_rate = np.einsum("nij,nj->ni", rotation_matrix(body), rate)
    inertial = attitudes(t_ns, inertial_rate, q0=q0, rates="inertial")
    assert same(inertial, body, 1e-12)


@pytest.mark.parametrize("size", [1e-6, 0.1, 3.0])
def test_check_5_length_stays_one(size):
    """Every attitude has unit length to 2 ulp, however many and however large the steps."""
    rng = np.random.default_rng(1)
    count = 20 * TILE
    q = attitudes(np.arange(count) * SECOND, size * rng.normal(size=(count, 3)))
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() <= 2 * np.finfo(float).eps


# --- the six pitfalls


@pytest.mark.parametrize("count", COUNTS)
def test_pitfall_1_rate_equation_of_the_other_frame(count):
    """Of a body on its side, a spin about its long axis is along its z, and the reference's -y."""
    rolled = exp(QUARTER * X)
    body = turn(QUARTER * Z, count, q0=rolled)[-1]
    inertial = turn(-QUARTER * Y, count, q0=rolled, rates="inertial")[-1]
    assert same(body, inertial)
    assert np.allclose(rotate(body, X), Z, atol=1e-9)
    assert np.allclose(rotate(inertial, X), Z, atol=1e-9)
    confused = turn(QUARTER * Z, count, q0=rolled, rates="inertial")[-1]
    assert np.allclose(rotate(confused, X), Y, atol=1e-9)


@pytest.mark.parametrize("count", COUNTS)
def test_pitfall_2_wrong_side(count):
    """Roll by 90 degrees, then yaw by 90: about the body's own axes the nose goes up."""
    body = turns(QUARTER * X, QUARTER * Z, count=count)
    # The roll brings y to z and z to -y; the yaw x to where y was, and y to where -x was.
    assert np.allclose(rotation_matrix(body).T, [Z, -X, -Y], atol=1e-9)
    fixed = turns(QUARTER * X, QUARTER * Z, count=count, rates="inertial")
    assert np.allclose(rotation_matrix(fixed).T, [Y, Z, X], atol=1e-9)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("method", ["start", "end", "mean", "coning"])
def test_pitfall_3_factor_one_half(method, count):
    """At 90 degrees a second, a second turns by 90 degrees: x to y; not by 180, not by 45."""
    q = turn(QUARTER * Z, count, method=method)[-1]
    assert np.allclose(rotate(q, X), Y, atol=1e-9)
    assert np.isclose(geodesic_angle(q, [1, 0, 0, 0]), QUARTER, rtol=1e-9)
    slow = turn(1e-3 * Z, count, method=method)[-1]
    assert np.isclose(geodesic_angle(slow, [1, 0, 0, 0]), 1e-3, rtol=1e-9)
    fast = turn(3.0 * Z, 2, method=method)[-1]
    assert np.isclose(geodesic_angle(fast, [1, 0, 0, 0]), 3.0, rtol=1e-9)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_pitfall_4_wrong_frame_direction(rates, count):
    """After a yaw to the left by 90 degrees, the body's x lies along the reference's y, not -y."""
    q = turn(QUARTER * Z, count, rates=rates)[-1]
    assert np.allclose(rotate(q, X), Y, atol=1e-9)
    assert np.allclose(q, [np.sqrt(0.5), 0, 0, np.sqrt(0.5)], atol=1e-9)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_pitfall_5_layout_is_not_physics(axis, count):
    """Inside, w comes first, in q0 as in the result, and the motion is that of wxyz."""
    # A body that is rolled by 90 degrees turns a half about each axis, on paper.
    s = np.sqrt(0.5)
    rolled = np.array([s, s, 0, 0])
    expected = np.array([[-s, s, 0, 0], [0, 0, s, s], [0, 0, -s, s]])[axis]
    q = turn(np.pi * np.eye(3)[axis], count, q0=rolled)
    assert np.allclose(q[0], rolled, atol=1e-15)
    assert np.allclose(q[-1], expected, atol=1e-9)
    scalar_last = np.roll(rolled, -1)
    assert same(turn(np.pi * np.eye(3)[axis], count, q0=np.roll(scalar_last, 1)), q, 1e-15)
    assert not same(turn(np.pi * np.eye(3)[axis], count, q0=scalar_last), q, 0.1)


def test_pitfall_6_norm_drift_is_not_motion():
    """First-order steps of 1 rad would be 12 % too long each, and would turn by 0.93 rad."""
    rng = np.random.default_rng(2)
    t_ns, rate = np.arange(10 * TILE) * SECOND, rng.normal(size=(10 * TILE, 3))
    q = attitudes(t_ns, rate)
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() <= 2 * np.finfo(float).eps
    longer = attitudes(t_ns, rate, q0=[1.25, 0, 0, 0])
    assert np.array_equal(longer, q)
    step = attitudes(t_ns[:2], np.tile(X, (2, 1)))[-1]
    assert np.isclose(geodesic_angle(step, [1, 0, 0, 0]), 1.0, rtol=1e-14)
    steps = multiply(q[:-1] * [1, -1, -1, -1], q[1:])
    assert same(steps, exp(rate[:-1]), 1e-14)
