"""Samples that the sensor has integrated: taken as they are, never integrated again."""

import numpy as np
import pytest
from make.streams import propagated

from quatprop.kinematics.quaternion import conjugate, exp, geodesic_angle, log, multiply
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.conditioning.corrections import corrected
from quatprop.timeline.counts import Policy
from quatprop.timeline.policies import Timeline


def tumbling(count):
    """Return attitudes that turn about a moving axis, from the identity on."""
    t = np.linspace(0, 3, count)
    angle = np.stack([1.3 * np.sin(2 * t), 0.8 * t, 0.4 * (1 - np.cos(3 * t))], axis=1)
    attitude = multiply(exp(angle), exp(angle[:, ::-1].copy()))
    return multiply(conjugate(attitude[:1]), attitude)


def increments_of(wxyz, integration_time_ns, t_ns):
    """Return the samples of a sensor that integrates exactly."""
    steps = multiply(conjugate(wxyz[:-1]), wxyz[1:])
    turned = np.concatenate([np.full((1, 3), 0.7), log(steps)])
    return GyroSeries(t_ns, turned / (integration_time_ns / 1e9)[:, None], integration_time_ns)


def attitudes_of(batches, **options):
    """Return all attitudes of a stream."""
    return np.concatenate([series.wxyz for series in propagated(batches, **options)])


@pytest.mark.parametrize("method", ["start", "end", "mean"])
def test_increments_lead_to_the_true_attitude_whatever_the_stamps_say(method):
    """Stamps jitter by half an interval, the motion is no constant rate: every step is exact."""
    random = np.random.default_rng(5)
    truth = tumbling(40_000)
    integration_time_ns = random.integers(4_000_000, 6_000_000, len(truth))
    t_ns = np.cumsum(integration_time_ns) + random.integers(-1_900_000, 1_900_000, len(truth))
    series = increments_of(truth, integration_time_ns, t_ns)
    assert geodesic_angle(attitudes_of([series], method=method), truth).max() < 1e-12


def test_a_message_that_repeats_turns_nothing():
    """An increment whose stamp was there before is the same increment."""
    integration_time_ns = np.full(3, 1_000_000_000)
    rate = np.array([[0, 0, 1.0]] * 3)
    series = GyroSeries(np.array([0, 5, 5]), rate, integration_time_ns)
    angle = 2 * np.arctan2(*attitudes_of([series])[-1, [3, 0]])
    assert angle == pytest.approx(1.0, abs=1e-15)


def test_a_bias_is_a_rate_times_the_time_of_integration():
    """Bias and mounting do to increments what they do to rates."""
    integration_time_ns = np.array([1_000_000_000, 250_000_000])
    turned = np.array([[0.5, 0, 0], [0.5, 0, 0]])
    series = GyroSeries(
        np.array([0, 10]), turned / (integration_time_ns / 1e9)[:, None], integration_time_ns
    )
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    (found,) = corrected([series], bias=np.array([0.4, 0, 0]), matrix=turn)
    increment = found.rate * (found.integration_time_ns / 1e9)[:, None]
    np.testing.assert_allclose(increment, [[0, -0.1, 0], [0, -0.4, 0]], atol=1e-16)


@pytest.mark.parametrize("backwards", ["drop", "sort"])
def test_the_timeline_keeps_increments_whole(backwards):
    """Dropping, sorting and holding carry the time of integration along."""
    t_ns = np.array([0, 10, 5, 20, 30])
    rate = np.ones((5, 3))
    rate[3] = np.nan
    series = GyroSeries(t_ns, rate, np.array([1, 2, 3, 4, 5]))
    timeline = Timeline(Policy(on_backwards=backwards, on_nonfinite="hold"), "log")
    (found,) = timeline.apply([series])
    kept = {"drop": [1, 2, 4, 5], "sort": [1, 3, 2, 4, 5]}[backwards]
    assert found.integration_time_ns.tolist() == kept
    assert timeline.counts.integrated_ns == sum(kept[1:])
    assert timeline.counts.path_angle_rad == pytest.approx(3**0.5 * sum(kept[1:]) * 1e-9)
