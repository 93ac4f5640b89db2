"""Quaternion arithmetic: group axioms, the exponential, rotation of vectors, angles."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from quatprop.kinematics.quaternion import (
    IDENTITY,
    conjugate,
    exp,
    from_matrix,
    geodesic_angle,
    half_angle,
    log,
    multiply,
    normalize,
    rotate,
    rotation_matrix,
    slerp,
)

QI, QJ, QK = np.eye(4)[1:]
SHAPES = st.sampled_from([(), (1,), (5,), (2, 3), (0,), (4, 1, 2)])
# From steps that round to the identity to several turns.
SIZES = st.sampled_from([0.0, 1e-300, 1e-160, 1e-17, 1e-9, 1e-4, 0.1, 1.0, 3.0, 30.0])
SEEDS = st.integers(0, 2**32 - 1)


@st.composite
def rotation_vectors(draw):
    """Draw rotation vectors of any shape and size."""
    rng = np.random.default_rng(draw(SEEDS))
    return draw(SIZES) * rng.normal(size=(*draw(SHAPES), 3))


def some_quaternions(seed, count=50):
    """Return unit quaternions spread over all attitudes."""
    return normalize(np.random.default_rng(seed).normal(size=(count, 4)))


def rotations(wxyz):
    """Return SciPy's rotations."""
    return Rotation.from_quat(wxyz, scalar_first=True)


def close(p, q, tol=1e-15):
    """Tell whether components agree, sign included."""
    return np.allclose(p, q, rtol=0, atol=tol)


# --- the group


@pytest.mark.parametrize(
    ("p", "q", "product"),
    [
        (QI, QJ, QK),
        (QJ, QK, QI),
        (QK, QI, QJ),
        (QJ, QI, -QK),
        (QK, QJ, -QI),
        (QI, QK, -QJ),
        (QI, QI, -IDENTITY),
    ],
)
def test_product_is_hamiltons(p, q, product):
    """The units multiply as i j = k, i i = -1, and not as in the opposite convention."""
    assert np.array_equal(multiply(p, q), product)


@given(SEEDS)
def test_axioms_of_the_product(seed):
    """(p q) r = p (q r), (p q)* = q* p*, and SciPy's product is the same; shapes broadcast."""
    p, q, r = (some_quaternions(seed + k) for k in range(3))
    assert close(multiply(multiply(p, q), r), multiply(p, multiply(q, r)))
    assert close(conjugate(multiply(p, q)), multiply(conjugate(q), conjugate(p)))
    theirs = rotations(p) * rotations(q)
    assert (rotations(multiply(p, q)) * theirs.inv()).magnitude().max() < 1e-15
    grid = multiply(p[:5, None], q[:3])
    assert np.array_equal(grid[4, 2], multiply(p[4], q[2]))


@given(rotation_vectors())
def test_axioms_of_the_exponential(rotvec):
    """Of any shape, near the identity and far: unit length, 1 q = q 1 = q to the bit, q q* = 1."""
    q = exp(rotvec)
    assert q.shape == (*rotvec.shape[:-1], 4)
    assert close(np.linalg.norm(q, axis=-1), 1, 4e-16)
    assert np.array_equal(multiply(IDENTITY, q), q)
    assert np.array_equal(multiply(q, IDENTITY), q)
    assert close(multiply(q, conjugate(q)), np.broadcast_to(IDENTITY, q.shape))


def test_the_identity_cannot_be_changed():
    """It is shared by all that begin with it."""
    with pytest.raises(ValueError, match="read-only"):
        IDENTITY[0] = 2


@given(st.sampled_from([1e-300, 1e-8, 1.0, 1e8, 1e300]), SEEDS)
def test_normalize_gives_unit_length(size, seed):
    """Any length that float64 can hold is brought to 1, within 2 ulp."""
    q = normalize(size * np.random.default_rng(seed).normal(size=(20, 4)))
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() <= 2 * np.finfo(float).eps


# --- exponential and logarithm


@pytest.mark.parametrize("largest", [0, 1e-8, 1e-3, 0.02, 0.1, 0.3, 0.6, 0.79, 0.8, 3.0, 7.0])
def test_half_angle_is_exact(largest):
    """Cosine and ratio are within 1.5 ulp of the truth whichever series or function gives them."""
    angles = np.append(np.random.default_rng(6).uniform(0, largest, 200), [0, largest])
    cosine, ratio = half_angle(angles**2)
    assert (cosine[-2], ratio[-2]) == (1.0, 0.5)
    with mpmath.workdps(40):
        for a, c, r in zip((angles**2).tolist(), cosine.tolist(), ratio.tolist(), strict=True):
            angle = mpmath.sqrt(a)
            assert abs(c - mpmath.cos(angle / 2)) < 1.5 * 2**-53
            assert abs(r - (mpmath.sin(angle / 2) / angle if a else 0.5)) < 1.5 * 2**-54


def test_half_angle_of_many_turns():
    """Of steps over many turns, and of absurd ones, whole turns are removed."""
    angles = np.random.default_rng(6).uniform(0, 1.6e6, 200)
    cosine, ratio = half_angle(angles**2)
    with mpmath.workdps(40):
        for angle, c, r in zip(np.sqrt(angles**2), cosine.tolist(), ratio.tolist(), strict=True):
            assert abs(c - mpmath.cos(mpmath.mpf(angle) / 2)) < 2 * 2**-53
            assert abs(r * angle - mpmath.sin(mpmath.mpf(angle) / 2)) < 3 * 2**-53
    angles = np.array([1e8, 1e15, 1e100, 1e150])
    cosine, ratio = half_angle(angles**2)
    assert close(np.hypot(cosine, ratio * angles), 1, 4e-16)


def test_one_bad_vector_spoils_no_other():
    """A rotation vector that is not a number gives a quaternion that is none, alone."""
    q = exp([[np.nan, 0, 0], [3.0, 0, 0]])
    assert np.isnan(q[0]).all()
    assert close(q[1], [np.cos(1.5), np.sin(1.5), 0, 0])


def test_smallest_steps_do_not_vanish():
    """Earth rate at 8 kHz turns 9e-9 rad a step; so do steps whose squares underflow."""
    assert exp([7.292e-5 / 8000, 0, 0])[1] == 7.292e-5 / 8000 / 2
    assert exp([1e-200, 0, 0])[1] == 5e-201


@given(SEEDS, st.sampled_from([1e-200, 1e-12, 1e-3, 1.0, 6.2]))
def test_logarithm_inverts_exponential(seed, angle):
    """Log(exp(v)) = v for every v shorter than a full turn; neither 1 nor -1 has an axis."""
    axis = normalize(np.append(np.random.default_rng(seed).normal(size=3), 0))[:3]
    assert np.allclose(log(exp(angle * axis)), angle * axis, rtol=1e-13, atol=0)
    assert np.array_equal(log([IDENTITY, -IDENTITY]), np.zeros((2, 3)))


# --- rotation of vectors, matrices


def test_rotate_is_the_sandwich_product():
    """Rotate(q, v) is the vector part of q v q* (eq. 3), and agrees with the matrix (eq. 5)."""
    q, v = some_quaternions(7), np.random.default_rng(8).normal(size=(50, 3))
    pure = np.concatenate([np.zeros((50, 1)), v], axis=1)
    sandwich = multiply(multiply(q, pure), conjugate(q))[:, 1:]
    assert close(rotate(q, v), sandwich, 4e-15)
    assert close(np.einsum("nij,nj->ni", rotation_matrix(q), v), sandwich, 4e-15)


@given(SEEDS)
def test_matrices_become_the_quaternions_that_scipy_gives(seed):
    """From scipy's own matrices, of any leading shape, with w never below zero."""
    rotation = rotations(some_quaternions(seed, 6))
    expected = rotation.as_quat(scalar_first=True).reshape(2, 3, 4)
    found = from_matrix(rotation.as_matrix().reshape(2, 3, 3, 3))
    assert geodesic_angle(found, expected).max() < 4e-15
    assert (found[..., 0] >= 0).all()


@pytest.mark.parametrize("axis", [0, 1, 2, 3])
def test_matrices_of_half_turns_are_exact(axis):
    """Where three of the four components vanish, the fourth is taken."""
    unit = np.eye(4)[axis]
    assert close(from_matrix(rotation_matrix(unit)), unit)
    assert np.isnan(from_matrix(np.full((3, 3), np.nan))).all()


# --- angles, and attitudes in between


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-15, 1e-9, 1e-3, 1.0, 3.0, np.pi])
def test_geodesic_angle_is_exact_at_any_size(angle):
    """The angle between 1 and a turn is that turn, down to the smallest."""
    between = geodesic_angle(IDENTITY, exp([0, angle, 0]))
    assert between == pytest.approx(angle, rel=1e-15, abs=0)


@given(SEEDS)
def test_axioms_of_the_geodesic_angle(seed):
    """It depends neither on signs, order and frames; equal attitudes are exactly none apart."""
    p, q, r = (some_quaternions(seed + k) for k in range(3))
    angle = geodesic_angle(p, q)
    assert close(geodesic_angle(-p, q), angle)
    assert close(geodesic_angle(q, -p), angle)
    assert close(geodesic_angle(multiply(r, p), multiply(r, q)), angle, 4e-15)
    assert close(geodesic_angle(multiply(p, r), multiply(q, r)), angle, 4e-15)
    # Whatever their length: a file against itself passes any tolerance.
    long = np.random.default_rng(seed).normal(size=(1000, 4))
    assert geodesic_angle(long, long).max() == geodesic_angle(long, -long).max() == 0.0


@given(SEEDS, st.floats(0, 1))
def test_slerp_agrees_with_scipy(seed, fraction):
    """Between any two attitudes, of either sign, it goes the shorter way at a constant rate."""
    p, q = some_quaternions(seed, 2)
    expected = Slerp([0, 1], rotations(np.array([p, q])))(fraction).as_quat(scalar_first=True)
    assert geodesic_angle(slerp(p, q, fraction), expected) < 1e-14
    assert geodesic_angle(slerp(p, -q, fraction), expected) < 1e-14


def test_slerp_broadcasts_and_keeps_its_ends():
    """Fractions of 0 and 1 are the attitudes themselves; rows need no loop."""
    p, q = some_quaternions(1), some_quaternions(2)
    both = slerp(p, q, np.array([[0.0], [1.0]]))
    assert both.shape == (2, 50, 4)
    assert geodesic_angle(both, [p, q]).max() < 1e-15
    assert np.allclose(np.linalg.norm(both, axis=-1), 1, rtol=0, atol=4e-16)
