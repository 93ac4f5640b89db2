"""The growth of a gyroscope's errors: closed forms, and simulated errors propagated by scipy."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from test_cubic import SECOND, rotor, stamps

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.uncertainty import TILE, ErrorGrowth, SensorErrors
from quatprop.series import GyroSeries

RUNS = 1000
N, B, K, S = 2e-3, 3e-4, 1e-4, 2e-4
EACH = {
    "noise_density": SensorErrors(noise_density=N),
    "bias_sigma": SensorErrors(bias_sigma=B),
    "random_walk": SensorErrors(random_walk=K),
    "scale_sigma": SensorErrors(scale_sigma=S),
    "together": SensorErrors(N, B, K, S),
}


def covariances(t_ns, rate, errors, rates="body", size=None):
    """Return the covariances of a series, in batches of some size."""
    wxyz = attitudes(t_ns, rate, method="coning", rates=rates)
    growth = ErrorGrowth(errors, rates)
    size = size or len(t_ns)
    parts = [
        growth.advance(GyroSeries(t_ns[k : k + size], rate[k : k + size]), wxyz[k : k + size])
        for k in range(0, len(t_ns), size)
    ]
    return np.concatenate(parts), growth


# --- closed forms


@pytest.mark.parametrize(
    ("errors", "closed"),
    [
        (SensorErrors(noise_density=N), lambda t: N * np.sqrt(t)),
        (SensorErrors(bias_sigma=B), lambda t: B * t),
        (SensorErrors(random_walk=K), lambda t: K * np.sqrt(t**3 / 3)),
        (SensorErrors(scale_sigma=S), lambda t: 0 * t),
        (SensorErrors(N, B, K, S), lambda t: np.sqrt(N**2 * t + B**2 * t**2 + K**2 * t**3 / 3)),
    ],
)
@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_at_rest(errors, closed, rates):
    """N sqrt(t), b t, K sqrt(t^3/3), nothing, and the root of the sum of their squares."""
    t_ns = 7 * SECOND + stamps(100, 200, jitter=0.3)
    found, _ = covariances(t_ns, np.zeros((len(t_ns), 3)), errors, rates)
    sigma = closed((t_ns - t_ns[0]) / 1e9)
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(found, axis1=1, axis2=2)), np.tile(sigma[:, None], 3), rtol=1e-9
    )
    across = found[:, [0, 0, 1], [1, 2, 2]]
    assert np.abs(across).max() <= 1e-15 * np.abs(found).max()


def test_a_scale_error_is_a_share_of_the_angle_about_a_fixed_axis():
    """Whatever the rate does: 400 ppm of the angle turned, about that axis alone."""
    t_ns = stamps(100, 20)
    angle = np.sin(0.7 * t_ns / 1e9) * 4
    increments = np.diff(angle, prepend=0.0)
    spans = np.full(len(t_ns), 10_000_000)
    rate = np.outer(increments / 0.01, [0.0, 1.0, 0.0])
    growth = ErrorGrowth(SensorErrors(scale_sigma=4e-4))
    rotation = Rotation.from_rotvec(np.outer(angle, [0.0, 1.0, 0.0]))
    wxyz = np.roll(rotation.as_quat(), 1, axis=1)
    found = growth.advance(GyroSeries(t_ns, rate, spans), wxyz)
    np.testing.assert_allclose(np.sqrt(found[:, 1, 1]), 4e-4 * np.abs(angle), atol=1e-15)
    assert np.abs(found[:, [0, 2], [0, 2]]).max() < 1e-30


def test_a_constant_spin_holds_the_bias_across_it():
    """In the plane of the spin a bias turns with the body: b |2 sin(w t / 2) / w|, not b t."""
    spin = 2.0
    t_ns = stamps(400, 10)
    found, _ = covariances(t_ns, np.tile([0, 0, spin], (len(t_ns), 1)), SensorErrors(bias_sigma=B))
    t = t_ns / 1e9
    across = np.abs(2 * np.sin(spin * t / 2) / spin)
    np.testing.assert_allclose(np.sqrt(found[:, 0, 0]), B * across, atol=1e-5 * B)
    np.testing.assert_allclose(np.sqrt(found[:, 2, 2]), B * t, rtol=1e-12)


# --- simulated errors


@cache
def simulated(name, motion):
    """Return stamps and true rates of 60 s, and the errors of 1,000 runs at five samples.

    scipy propagates the true rates and the wrong ones.
    """
    # At rest few samples show the same, and quickly.
    errors, hz, seconds = EACH[name], 5 if motion == "rest" else 10, 60
    t_ns, h = stamps(hz, seconds), 1 / hz
    turning = 0.0 if motion == "rest" else 0.25
    rate, between = (turning * rotor(turning * t)[1] for t in (t_ns / 1e9, t_ns / 1e9 + h / 2))
    if motion == "rest":
        rate = between = np.tile([0, 0, 7.292e-5], (len(t_ns), 1))
    random = np.random.default_rng(20)
    bias = errors.bias_sigma * random.normal(size=(RUNS, 3))
    scale = errors.scale_sigma * random.normal(size=(RUNS, 3))
    # The walk in the middle of each interval.
    walk = errors.random_walk * np.sqrt(h / 2) * random.normal(size=(RUNS, 3))
    truth, wrong = Rotation.identity(), Rotation.identity(RUNS)
    found = {}
    for k, true in enumerate(between[:-1], 1):
        noise = errors.noise_density / np.sqrt(h) * random.normal(size=(RUNS, 3))
        measured = true * (1 + scale) + bias + walk + noise
        walk = walk + errors.random_walk * np.sqrt(h) * random.normal(size=(RUNS, 3))
        truth = truth * Rotation.from_rotvec(true * h)
        wrong = wrong * Rotation.from_rotvec(measured * h)
        if k % (hz * seconds // 5) == 0:
            found[k] = (truth.inv() * wrong).as_rotvec()
    return t_ns, rate, found


def all_as_predicted(name, motion, errors):
    """Tell whether the means of e' P^-1 e are inside the 95 % band of all five together."""
    t_ns, rate, found = simulated(name, motion)
    predicted, _ = covariances(t_ns, rate, errors)
    # At rest a scale error shows about the axis of the Earth alone.
    axes = slice(2 if (name, motion) == ("scale_sigma", "rest") else 0, 3)
    squares = [
        np.einsum("ni,ij,nj->n", error[:, axes], np.linalg.inv(predicted[k][axes, axes]),
                  error[:, axes])
        for k, error in found.items()
    ]  # fmt: skip
    low, high = chi2.ppf([0.025 / 5, 1 - 0.025 / 5], RUNS * (axes.stop - axes.start)) / RUNS
    return all(low < each.mean() < high for each in squares)


@pytest.mark.parametrize("motion", ["rest", "rotor"])
@pytest.mark.parametrize("name", EACH)
def test_simulated_errors_are_as_large_as_predicted(name, motion):
    """The error is in the one of them that a name says, or in all."""
    assert all_as_predicted(name, motion, EACH[name])


@pytest.mark.parametrize("motion", ["rest", "rotor"])
@pytest.mark.parametrize("name", [name for name in EACH if name != "together"])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_prediction_that_is_off_by_a_tenth_is_caught(name, motion, factor):
    """The band of 1,000 runs is narrow enough."""
    wrong = EACH[name]._replace(**{name: factor * getattr(EACH[name], name)})
    assert not all_as_predicted(name, motion, wrong)


# --- batches, prefixes, contributions


@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("size", [TILE, 2 * TILE])
def test_the_same_bits_for_any_batch_and_any_end(rates, size):
    """Batches are cut at tiles, and the first samples give what the whole log gives."""
    t_ns = np.arange(3 * TILE + 17) * 10_000_000
    _, rate = rotor(t_ns / 1e9)
    whole, _ = covariances(t_ns, rate, EACH["together"], rates)
    cut, _ = covariances(t_ns, rate, EACH["together"], rates, size=size)
    assert cut.tobytes() == whole.tobytes()
    for count in (1, 2, 129, TILE, TILE + 1, 2 * TILE + 1000):
        part, _ = covariances(t_ns[:count], rate[:count], EACH["together"], rates)
        assert part.tobytes() == whole[:count].tobytes()


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_contributions_add_up(rates):
    """Each error alone, and the sum of the four, which is the trace of the covariance."""
    t_ns = stamps(100, 30)
    _, rate = rotor(t_ns / 1e9)
    together, growth = covariances(t_ns, rate, EACH["together"], rates)
    total = 0.0
    for name, errors in EACH.items():
        if name != "together":
            alone, _ = covariances(t_ns, rate, errors, rates)
            trace = np.trace(alone[-1])
            assert growth.variances[name] == pytest.approx(trace, rel=1e-9)
            total += trace
    assert np.trace(together[-1]) == pytest.approx(total, rel=1e-12)
    assert (np.linalg.eigvalsh(together[1:]) > 0).all()


def test_a_restart_begins_with_a_known_attitude():
    """After it everything is as of a new log."""
    t_ns = stamps(100, 2)
    _, rate = rotor(t_ns / 1e9)
    wxyz = attitudes(t_ns, rate)
    growth = ErrorGrowth(EACH["together"])
    series = GyroSeries(t_ns, rate)
    first = growth.advance(series, wxyz)
    assert not first[0].any()
    growth.restart()
    assert growth.advance(series, wxyz).tobytes() == first.tobytes()
