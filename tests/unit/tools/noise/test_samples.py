"""Noise of samples that are missing, rounded, rare, in bursts, or of a sensor that warms up."""

import re
import warnings

import numpy as np
import pytest
from make.gyro_noise import HZ, Truth, rates

from quatprop import GyroSeries, noise
from quatprop.base.errors import UsageError
from quatprop.propagation.conditioning.static_period import StepFinder
from quatprop.tools.noise_table import imu_yaml, rest_text
from quatprop.tools.rest_samples import RunningMeans, spacing_of

EPOCH = 1_700_000_000_000_000_000
SAMPLES = 12_000
SIGMA = 1e-3
"""Of a sample, rad/s."""


def measured(t_ns, rate, **options):
    """Return the noise of rates, and the codes of the remarks on them."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = noise(GyroSeries(EPOCH + np.asarray(t_ns).astype(np.int64), rate), **options)
    return found, {one.message.code for one in said}


def apart(term, true):
    """Return by how many standard deviations a term is off."""
    return abs(term.value - true) / term.sigma


@pytest.mark.parametrize(
    ("share", "jitter", "hertz"),
    [(0.002, 0.05, 50), (0.03, 0, 100), (0.15, 0.05, 400), (0.35, 0, 200), (0.35, 0.05, 50)],
)
def test_samples_that_are_missing_change_nothing(share, jitter, hertz):
    """The mean interval was taken for that of the sensor, and N was larger by its root."""
    random = np.random.default_rng(round(1000 * share) + hertz)
    rate = SIGMA * random.standard_normal((SAMPLES, 3))
    there = random.random(SAMPLES) > share
    t_ns = (np.arange(SAMPLES) + jitter * random.standard_normal(SAMPLES)) * 1e9 / hertz
    found, said = measured(np.sort(t_ns[there]), rate[there])
    assert said <= {"noise-gaps"}
    assert apart(found.combined.angle_random_walk, SIGMA / np.sqrt(hertz)) < 4
    inside = np.flatnonzero(there)
    assert found.missing == pytest.approx(inside[-1] - inside[0] + 1 - len(inside), abs=20)
    assert f", {found.missing} missing in 1 period" in rest_text(found)
    assert f"update_rate: {hertz}" in imu_yaml(found) or jitter


@pytest.mark.parametrize("noise_in_steps", [0.05, 0.125, 0.35, 0.5, 0.62, 1.0])
@pytest.mark.parametrize("levels", [(0.5, 0.25, 0.1), (0.4, 0.0, 0.9)])
def test_steps_of_the_rates_are_no_noise_of_the_sensor(noise_in_steps, levels):
    """It was off by a factor of 0.07 to 15, with a standard deviation of 0.3 %."""
    random = np.random.default_rng(round(100 * noise_in_steps))
    step = SIGMA / noise_in_steps
    rate = np.array(levels) * step + SIGMA * random.standard_normal((SAMPLES, 3))
    found, said = measured(np.arange(SAMPLES) * 1e9 / HZ, np.rint(rate / step) * step)
    terms = [axis.angle_random_walk for axis in found.axes]
    if noise_in_steps < 0.6:
        assert [term.value for term in terms] == [None] * 3
        assert said & {"noise-steps", "noise-unexplained"}
        with pytest.raises(UsageError, match="no angle random walk to write; record"):
            imu_yaml(found)
    else:
        assert not said
        assert max(apart(term, SIGMA / np.sqrt(HZ)) for term in terms) < 4


def test_a_value_that_comes_late_and_seldom_is_found():
    """All of an axis that shows one value so far is examined, not the beginning of a block."""
    rate = np.full((SAMPLES, 3), 0.01)
    rate[9000::700, 1] = 0.011
    found, said = measured(np.arange(SAMPLES) * 1e9 / HZ, rate + [0, 0, 1e-3] * np.sin(rate))
    assert "noise-steps" in said
    assert found.axes[1].angle_random_walk.value is None
    assert len(StepFinder().observe(rate)) == SAMPLES


@pytest.mark.parametrize("interval_s", [0.3, 1, 60])
def test_slow_logs_are_measured(interval_s):
    """Below 4 Hz no window of half a second had samples enough to be at rest."""
    rate = 1e-6 * np.random.default_rng(3).standard_normal((4000, 3))
    found, _ = measured(np.arange(4000) * interval_s * 1e9, rate)
    assert apart(found.combined.angle_random_walk, 1e-6 * np.sqrt(interval_s)) < 4
    assert found.interval_s == pytest.approx(interval_s)
    assert found.samples == 4000


@pytest.mark.parametrize(
    ("size", "share"), [(2, 0.05), (3, 0.002), (10, 0.02), (50, 0.05), (200, 0.002)]
)
def test_bursts_are_refused_with_a_remedy_for_either_meaning(size, share):
    """Their rate was measured within a burst: 5000 Hz instead of 100, and 0.14 times the noise."""
    number = np.arange(SAMPLES)
    t_ns = (number // size * size + number % size * share) * 1e9 / HZ
    rate = SIGMA * np.random.default_rng(size).standard_normal((SAMPLES, 3))
    with pytest.raises(UsageError) as refused:
        measured(t_ns, rate)
    said = str(refused.value)
    assert f"the samples come in bursts of {size} within " in said
    evenly, in_bursts = re.findall(r"max_gap='([^']+)' if they", said)
    found, codes = measured(t_ns, rate, max_gap=evenly)
    assert apart(found.combined.angle_random_walk, SIGMA / np.sqrt(HZ)) < 4
    assert found.interval_s * HZ == pytest.approx(1, rel=0.02)
    assert codes == {"noise-irregular"}
    if size > 10:
        found, _ = measured(t_ns, rate, max_gap=in_bursts)
        assert apart(found.combined.angle_random_walk, SIGMA * np.sqrt(share / HZ)) < 4


def test_lost_samples_and_pauses_are_no_bursts():
    """Bursts have a pace of their own; what is lost here and there has none."""
    random = np.random.default_rng(4)
    t_ns = np.arange(20_000) * 10_000_000
    assert spacing_of(t_ns).bursts is None
    for share in (0.01, 0.1, 0.4):
        assert spacing_of(t_ns[random.random(20_000) > share]).bursts is None
    pauses = np.cumsum(random.exponential(0.5e9, 20_000) * (random.random(20_000) < 0.01))
    assert spacing_of(t_ns + pauses.astype(np.int64)).bursts is None
    late = np.sort(t_ns + random.exponential(4e6, 20_000).astype(np.int64))
    assert spacing_of(late).bursts is None


@pytest.mark.parametrize(("constant_s", "rise"), [(4, 0.05), (12, 1e-3), (12, 0.02), (60, 0.05)])
def test_warming_up_is_not_a_random_walk(constant_s, rise):
    """Only a ramp was recognised; a strong one was also taken for white noise."""
    t_s = np.arange(SAMPLES) / HZ
    rate = SIGMA * np.random.default_rng(5).standard_normal((SAMPLES, 3))
    warm = rise * np.exp(-t_s / constant_s)[:, None] * [1, -0.5, 1]
    found, said = measured(t_s * 1e9, rate + warm)
    assert apart(found.combined.angle_random_walk, SIGMA / np.sqrt(HZ)) < 4
    assert found.combined.rate_random_walk.value is None
    assert found.combined.bias_instability.value is None
    if rise > 1e-3:
        assert "noise-warm-up" in said
    if constant_s == 4:
        later, said = measured(t_s * 1e9, rate + warm, start="+60s")
        assert not said
        assert later.combined.rate_random_walk.at_most is not None


@pytest.mark.parametrize("truth", [Truth(N=1e-4, K=1e-3), Truth(N=1e-4, K=1e-4, R=1e-5)])
def test_a_random_walk_is_no_warming_up(truth):
    """Its steps have nothing to do with each other; nor is a ramp remarked, which is a term."""
    random = np.random.default_rng(6)
    for _ in range(2):
        rate = rates(truth, SAMPLES, random)
        found, said = measured(np.arange(SAMPLES) * 1e9 / HZ, rate)
        assert "noise-warm-up" not in said
        assert found.combined.rate_random_walk.value is not None or truth.R


def test_means_of_a_long_log_take_little_memory():
    """Neighbouring ones are joined, and none is lost."""
    means, block = RunningMeans(), np.ones((1 << 17, 3))
    for number in range(20):
        means.add((np.arange(len(block)) + number * len(block)) * 10**7, block * number)
    count, time, rate = means.result()
    assert len(count) <= 1 << 14
    assert count.sum() == 20 * len(block)
    assert (np.diff(time / count) > 0).all()
    np.testing.assert_allclose(rate.sum(axis=0), len(block) * sum(range(20)))
