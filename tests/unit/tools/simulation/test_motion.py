"""Simulated motions obey the laws they are named after; gyroscopes sample them as told."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quatprop.base.errors import UsageError
from quatprop.tools import simulation
from quatprop.tools.simulation import (
    MOTIONS,
    Gyroscope,
    Shape,
    motion_named,
    precession,
    record,
    spin,
)

CLOSED_FORMS = ["rest", "spin", "coning", "tumbling"]
SHAPE = Shape(
    frequency=Fraction("1.7"),
    axis=(1.0, -2.0, 0.5),
    angle=Fraction(25),
    spin_frequency=Fraction("-0.6"),
    seed=3,
)


def rotation(wxyz):
    """Return attitudes as rotations of an independent library."""
    return Rotation.from_quat(np.roll(wxyz, -1, axis=-1))


# Phases


@pytest.mark.parametrize("frequency", ["1", "123.457", "-0.7"])
def test_phases_are_exact_after_a_day(frequency):
    """Sine and cosine are within 3e-16 of 40-digit arithmetic, in the first second and after."""
    mpmath.mp.dps = 40
    eighths = np.arange(9) * 125_000_000
    t_ns = np.append(np.random.default_rng(1).integers(0, 86_400 * 10**9, 300), eighths)
    of_time = simulation.of_time(t_ns, Fraction(frequency))
    for t, cosine, sine in zip(t_ns, *of_time, strict=True):
        angle = 2 * mpmath.pi * mpmath.mpf(frequency) * int(t) / mpmath.mpf(10) ** 9
        assert abs(mpmath.cos(angle) - float(cosine)) < 3e-16
        assert abs(mpmath.sin(angle) - float(sine)) < 3e-16


# Motions


@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_rates_are_the_derivative_of_the_attitude(name):
    """q(t+h) = q(t) exp(w(t+h/2) h/2) up to h cubed, the body rate on the right."""
    motion = motion_named(name, SHAPE)
    t_ns = np.arange(0, 2 * 10**9, 37_000_000)
    errors = []
    for h_ns in (4_000_000, 2_000_000):
        begin, end = (rotation(motion(t_ns + shift)[1]) for shift in (0, h_ns))
        rate, _ = motion(t_ns + h_ns // 2)
        stepped = begin * Rotation.from_rotvec(rate * h_ns * 1e-9)
        errors.append((stepped.inv() * end).magnitude().max())
    assert errors[0] < 1e-4
    if name in {"rest", "spin"}:
        assert max(errors) < 1e-15
    else:
        assert errors[0] / errors[1] == pytest.approx(8, rel=0.01)


def test_a_free_symmetric_body_keeps_its_angular_momentum():
    """With A / C = 1 + s' / (f' cos n), R(q) (A wx, A wy, C wz) never changes."""
    angle, frequency, spinning = Fraction(35), Fraction("0.4"), Fraction("0.3")
    ratio = 1 + 0.3 / (0.4 * np.cos(np.radians(35)))
    rate, wxyz = precession(angle, frequency, spinning)(np.arange(0, 10**11, 10**9 // 7))
    momentum = rotation(wxyz).apply(rate * [ratio, ratio, 1])
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(rate), 1)), atol=2e-14)


def test_coning_keeps_the_body_axis_on_its_cone():
    """The z axis goes round a cone of the half-angle and comes back each period."""
    _, wxyz = motion_named("coning", Shape(angle=Fraction(8), frequency=Fraction(5)))(
        np.arange(0, 10**9, 10**7)
    )
    axis = rotation(wxyz).apply([0, 0, 1])
    middle = axis.mean(axis=0)
    np.testing.assert_allclose(
        axis @ (middle / np.linalg.norm(middle)), np.cos(np.radians(8)), rtol=1e-14
    )
    np.testing.assert_allclose(wxyz[20:], wxyz[:-20], rtol=0, atol=1e-15)


def test_a_random_walk_is_the_product_of_its_own_rates():
    """Each sample's rate rules until the next, on the right."""
    motion = motion_named("random-walk", Shape(walk=2.0, seed=11))
    t_ns = np.arange(300) * 7_000_000
    rate, wxyz = (
        np.concatenate(part) for part in zip(motion(t_ns[:1]), motion(t_ns[1:]), strict=True)
    )
    expected = Rotation.identity()
    for k in range(1, len(t_ns)):
        expected = expected * Rotation.from_rotvec(rate[k - 1] * 7e-3)
    assert (expected.inv() * rotation(wxyz[-1])).magnitude() < 1e-13
    assert np.linalg.norm(rate[-1]) > 0.1


# The gyroscope


def test_noise_and_bias_are_as_requested():
    """White noise has deviation N sqrt(rate), the mean is the bias."""
    told = Gyroscope(Fraction(400), 100_000, noise=2e-3, bias=(0.1, 0.0, -0.2), seed=5)
    batches = [series.rate for series in record(motion_named("rest", SHAPE), told)]
    rate = np.concatenate(batches)
    assert len(batches) > 1
    np.testing.assert_allclose(rate.std(axis=0), 0.04, rtol=0.01)
    np.testing.assert_allclose(rate.mean(axis=0), [0.1, 0, -0.2], atol=5 * 0.04 / 100_000**0.5)
    steps = np.diff(rate, axis=0)
    np.testing.assert_allclose(steps.std(axis=0), 0.04 * 2**0.5, rtol=0.01)


def test_the_noise_is_independent_of_a_random_walk():
    """Noise and walk were drawn from the same numbers, so noise looked like a shift in time."""
    true, noisy = (
        np.concatenate([series.rate for series in record(motion_named("random-walk", SHAPE), told)])
        for told in (Gyroscope(Fraction(100), 10_000, noise=noise, seed=3) for noise in (0, 1e-3))
    )
    noise, increments = (noisy - true)[1:].ravel(), np.diff(true, axis=0).ravel()
    assert abs(np.corrcoef(noise, increments)[0, 1]) < 5 / noise.size**0.5


@pytest.mark.parametrize("name", MOTIONS)
def test_batches_cannot_be_seen(name, monkeypatch):
    """However many samples are made at a time, they are the same, from the identity on."""
    told = Gyroscope(Fraction(100), 50, noise=1e-3, seed=9)
    (whole,) = record(motion_named(name, SHAPE), told)
    monkeypatch.setattr(simulation, "BATCH", 7)
    parts = list(record(motion_named(name, SHAPE), told))
    rate = np.concatenate([part.rate for part in parts])
    wxyz = np.concatenate([part.wxyz for part in parts])
    np.testing.assert_array_equal(rate, whole.rate)
    np.testing.assert_allclose(wxyz, whole.wxyz, rtol=0, atol=3e-16)
    np.testing.assert_allclose(wxyz[0], [1, 0, 0, 0], rtol=0, atol=3e-16)


def test_the_first_attitude_turns_the_whole_truth():
    """q0 stands on the left of every attitude, made unit length; rates do not feel it."""
    told = Gyroscope(Fraction(10), 20)
    q0 = (2.0, 0.0, -2.0, 1.0)
    (plain,) = record(motion_named("tumbling", SHAPE), told)
    (turned,) = record(motion_named("tumbling", SHAPE), told, q0)
    np.testing.assert_array_equal(turned.rate, plain.rate)
    np.testing.assert_allclose(turned.wxyz[0], np.array(q0) / 3, rtol=1e-15)
    gap = rotation(turned.wxyz).inv() * rotation(np.array(q0)) * rotation(plain.wxyz)
    assert gap.magnitude().max() < 1e-15


@pytest.mark.parametrize(
    ("use", "sentence"),
    [
        (lambda: Gyroscope(Fraction(1, 10**6), 10), "too many digits to keep its timestamps exact"),
        (
            lambda: next(record(motion_named("rest", SHAPE), Gyroscope(1, 10), (0, 0, 0, 0))),
            "^q0 must be four finite numbers W,X,Y,Z, not all zero$",
        ),
        (
            lambda: simulation.of_time(np.arange(3), Fraction("0.12345678901")),
            "too many digits to keep its phase exact; give it to",
        ),
        (lambda: motion_named("dance", SHAPE), "^no motion 'dance'; choose one of 'rest', 'spin'"),
        *(
            (lambda x=x: spin((x, 0, 0), Fraction(1)), "^the axis of a spin needs a direction;")
            for x in (0, np.nan, np.inf)
        ),
    ],
)
def test_impossible_simulations_are_refused(use, sentence):
    """With a remedy, before anything is written."""
    with pytest.raises(UsageError, match=sentence):
        use()
