"""Frames: mean rotations, mountings, and when the motion does not show them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from quatprop.base.errors import ComparisonError
from quatprop.comparison.alignment import align, find_mounting, mean_rotation
from quatprop.kinematics.quaternion import geodesic_angle

SEEDS = st.integers(0, 2**32)


def wxyz(rotation):
    """Return quaternions of rotations, scalar first."""
    return rotation.as_quat(scalar_first=True)


def random(count, seed):
    """Return random rotations."""
    return Rotation.random(count, rng=np.random.default_rng(seed))


def wander(count, seed, scale=0.05):
    """Return rotations about axes that wander."""
    steps = np.random.default_rng(seed).normal(size=(count, 3)) * scale
    return Rotation.from_rotvec(np.cumsum(steps, axis=0))


@given(SEEDS)
def test_the_mean_is_that_of_scipy(seed):
    """The chordal mean of scattered rotations agrees with an independent one, whatever signs."""
    rng = np.random.default_rng(seed)
    scattered = random(1, seed) * Rotation.from_rotvec(rng.normal(size=(50, 3)) * 0.3)
    signs = rng.choice([-1.0, 1.0], size=(50, 1))
    found = mean_rotation(wxyz(scattered) * signs)
    assert geodesic_angle(found, wxyz(scattered.mean())) < 1e-12


@given(SEEDS)
def test_any_mounting_is_recovered(seed):
    """From a motion about all axes, mounting and reference are exact whatever they are."""
    reference, mount = random(2, seed)
    true = wander(200, seed + 1)
    found = align("mount", wxyz(reference * true * mount), wxyz(true))
    assert geodesic_angle(found.mount_wxyz, wxyz(mount)) < 1e-12
    assert geodesic_angle(found.reference_wxyz, wxyz(reference)) < 1e-12
    assert geodesic_angle(found.apply(wxyz(true)), wxyz(reference * true * mount)).max() < 1e-12


def test_the_uncertainty_covers_the_error():
    """With noise on both sides, mountings scatter as their standard deviation says."""
    mount = Rotation.from_rotvec([0.02, -0.01, 0.015])
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        true = wander(2000, 1000 + seed)
        noise = [Rotation.from_rotvec(rng.normal(size=(2000, 3)) * 0.01) for _ in range(2)]
        found, mounting = find_mounting(wxyz(true * mount * noise[0]), wxyz(true * noise[1]))
        ratios.append(geodesic_angle(found, wxyz(mount)) / mounting.std_rad)
    # Three axes, each no less certain than the one that is told.
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < np.sqrt(3)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [1e-3, 2e-2])
@pytest.mark.parametrize("white", [True, False])
def test_the_uncertainty_is_that_of_noise_of_any_colour(noise, white):
    """Noise of attitudes, which rotations over long times do not add up, gave 6 to 19 times it."""
    seconds = np.arange(3000)[:, None] / 100
    true = Rotation.from_rotvec(0.4 * np.sin(seconds * [1.3, 2.1, 0.7] + [0, 1, 2]))
    mount, errors, stated = Rotation.from_rotvec([0.6, 1.4, -0.9]), [], []
    for seed in range(12):
        rotvec = np.random.default_rng(seed).normal(size=(3000, 3)) * noise
        if not white:
            rotvec = 0.1 * np.cumsum(rotvec, axis=0)
        noisy = (
            true * Rotation.from_rotvec(rotvec) if white else Rotation.from_rotvec(rotvec) * true
        )
        found, mounting = find_mounting(wxyz(true * mount), wxyz(noisy))
        errors.append(geodesic_angle(found, wxyz(mount)) / np.sqrt(3))
        stated.append(mounting.std_rad)
    assert 0.6 < np.median(stated) / np.sqrt(np.mean(np.square(errors))) < 3.5


def test_half_turns_do_not_spoil_a_mounting():
    """The attitudes are unrelated: noise decides the signs of axes."""
    rng = np.random.default_rng(6)
    true, mount = random(2000, 7), Rotation.from_rotvec([0.4, -0.2, 0.9])
    noise = [Rotation.from_rotvec(rng.normal(size=(2000, 3)) * 0.01) for _ in range(2)]
    found, mounting = find_mounting(wxyz(true * mount * noise[0]), wxyz(true * noise[1]))
    assert geodesic_angle(found, wxyz(mount)) < 4 * mounting.std_rad < 4e-3


def test_drift_does_not_spoil_a_mounting():
    """A gyroscope that drifts by 60 deg shows the same mounting from its short rotations."""
    mount = Rotation.from_rotvec([0.02, -0.01, 0.015])
    true = wander(5000, 3)
    drift = Rotation.from_rotvec(np.radians(60) * np.linspace(0, 1, 5000)[:, None] * [[0, 0, 1]])
    found, _ = find_mounting(wxyz(true * mount), wxyz(drift * true))
    assert geodesic_angle(found, wxyz(mount)) < 2e-3


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_one_axis_is_refused(noise):
    """A body that turns about one axis only does not show how it is mounted about it."""
    rng = np.random.default_rng(5)
    yaw = np.cumsum(rng.normal(size=3000) * 0.03)
    turns = Rotation.from_rotvec(yaw[:, None] * [[0, 0, 1]])
    a, b = (turns * Rotation.from_rotvec(rng.normal(size=(3000, 3)) * noise) for _ in range(2))
    with pytest.raises(ComparisonError, match=r"axis only.*; choose align='mean', or a longer"):
        align("mount", wxyz(a), wxyz(b))


@pytest.mark.parametrize(
    ("rotations", "sentence"),
    [
        (Rotation.identity(100), "^the body turns by 0 deg only, which shows no mounting; choose"),
        (wander(11, 0), "^a mounting needs 10 relative rotations, and there are only 11 att"),
    ],
)
def test_too_little_motion_is_refused(rotations, sentence):
    """A body at rest shows no mounting, and ten relative rotations are the least."""
    with pytest.raises(ComparisonError, match=sentence):
        align("mount", wxyz(rotations), wxyz(rotations))
