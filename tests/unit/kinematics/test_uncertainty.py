"""The growth of a gyroscope's errors: closed forms, batches, contributions."""

import numpy as np
import pytest
from make.motion import SECOND, rotor, stamps
from scipy.spatial.transform import Rotation

from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.series import GyroSeries
from quatprop.kinematics.uncertainty import TILE, ErrorGrowth, SensorErrors

N, B, K, S, M = 2e-3, 3e-4, 1e-4, 2e-4, 5e-3
EACH = {
    "noise_density": SensorErrors(noise_density=N),
    "bias_sigma": SensorErrors(bias_sigma=B),
    "random_walk": SensorErrors(random_walk=K),
    "scale_sigma": SensorErrors(scale_sigma=S),
    "misalignment_sigma": SensorErrors(misalignment_sigma=M),
    "together": SensorErrors(N, B, K, S, M),
}


def covariances(t_ns, rate, errors, rates="body", size=None):
    """Return the covariances of a series, in batches of some size."""
    wxyz = attitudes(t_ns, rate, method="coning", rates=rates)
    growth = ErrorGrowth(errors, rates, "coning")
    size = size or len(t_ns)
    parts = [
        growth.advance(GyroSeries(t_ns[k : k + size], rate[k : k + size]), wxyz[k : k + size])
        for k in range(0, len(t_ns), size)
    ]
    return np.concatenate(parts), growth


# --- closed forms


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


# --- batches, prefixes, contributions


@pytest.mark.thorough
@pytest.mark.parametrize("rates", ["body", "inertial"])
@pytest.mark.parametrize("size", [TILE, 2 * TILE])
def test_the_same_bits_for_any_batch_and_any_end(rates, size):
    """Batches are cut at tiles, and the first samples give what the whole log gives."""
    t_ns = np.arange(3 * TILE + 17) * 10_000_000
    _, rate = rotor(t_ns / 1e9)
    # At first some angles are large, while no component is; later all are.
    rate = rate[:, [0, 1, 1]] + np.linspace(5, 30, len(t_ns))[:, None]
    whole, _ = covariances(t_ns, rate, EACH["together"], rates)
    cut, _ = covariances(t_ns, rate, EACH["together"], rates, size=size)
    assert cut.tobytes() == whole.tobytes()
    for count in (1, 2, 129, TILE, TILE + 1, 2 * TILE + 1000):
        part, _ = covariances(t_ns[:count], rate[:count], EACH["together"], rates)
        assert part.tobytes() == whole[:count].tobytes()


@pytest.mark.parametrize("rates", ["body", "inertial"])
def test_contributions_add_up(rates):
    """Each error alone, and the sum of all, which is the trace of the covariance."""
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


def test_across_a_gap_without_rotation_only_the_bias_walks_on():
    """At rest, a second before and after a gap of three: what is not integrated adds nothing."""
    t_ns = np.concatenate([np.arange(0, 101), np.arange(400, 501)]) * SECOND // 100
    series = GyroSeries(t_ns, np.zeros((len(t_ns), 3)))
    wxyz = np.tile([1.0, 0, 0, 0], (len(t_ns), 1))
    for name, variance in (
        ("noise_density", N**2 * 2),
        ("bias_sigma", B**2 * 2**2),
        ("random_walk", K**2 * (1 / 3 + 4 + 1 / 3 + 2 * 1 / 2)),
    ):
        growth = ErrorGrowth(EACH[name])
        growth.advance(series[:101], wxyz[:101])
        growth.begin(restart=False)
        found = growth.advance(series[101:], wxyz[101:])
        assert found[-1] == pytest.approx(np.eye(3) * variance, rel=1e-9)
        before = ErrorGrowth(EACH[name]).advance(series[:101], wxyz[:101])[-1]
        assert found[0] == pytest.approx(before, rel=1e-12)
