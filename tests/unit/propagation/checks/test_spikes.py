"""Single samples that jump away and back on one axis are found; what a body can do is not."""

import numpy as np
import pytest

from quatprop.base.text import in_python
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.checks.rate_checks import RateChecks
from quatprop.timeline.counts import Counts


def said_of(rate, hz=200):
    """Return the codes of remarks on rates in rad/s, and the sentences on spikes."""
    t_ns = np.arange(len(rate)) * (1_000_000_000 // hz)
    checks = RateChecks("rad/s")
    GyroSeries.joined(list(checks.observe([GyroSeries(t_ns, rate)])))
    counts = Counts(
        samples_used=len(t_ns), first_ns=0, last_ns=int(t_ns[-1]), median_dt_ns=1_000_000_000 // hz
    )
    remarks = checks.remarks(counts)
    codes = {one.code for one in remarks}
    return codes, [in_python(one) for one in remarks if one.code == "spikes"]


def moving(seed, count=40_000, noise=0.01):
    """Return rates of a body that swings, rad/s."""
    rng = np.random.default_rng(seed)
    phase = np.arange(count)[:, None] * rng.uniform(0.005, 0.03, 3) + rng.uniform(0, 6, 3)
    return 2 * np.sin(phase) + rng.normal(0, noise, (count, 3))


@pytest.mark.thorough
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("place", [6, 16_370, 16_383, 16_384, 16_385, 32_767, 39_980])
@pytest.mark.parametrize("value", [-34.9, 20.0])
def test_a_single_damaged_sample_is_found_wherever_blocks_end(value, place, axis):
    """One axis jumped for one sample, which turned the attitude by up to 10 deg unsaid."""
    rate = moving(place)
    before = rate[place - 1, axis]
    rate[place, axis] = value
    _, (said,) = said_of(rate)
    turned = np.degrees(abs(value - before) * 0.005)
    assert said == (
        f"axis {'xyz'[axis]} jumps to {value:.4g} rad/s for one sample, and back to where it was, "
        f"at t = {place * 5_000_000} ns, which is {turned:.3g} deg of rotation: is it damaged?"
    )


def test_several_are_counted_on_each_axis():
    """They are of the same size, or somewhat smaller."""
    rate = moving(3)
    rate[1000:30_000:1000, 2] += np.linspace(30, 15, 29)
    rate[500, 0] = -30
    _, said = said_of(rate)
    assert [one[:20] for one in said] == [
        "axis x jumps to -30 ",
        f"axis z jumps to {rate[1000, 2]:.4g}"[:20],
    ]
    assert "29 times, first at t = 5000000000 ns" in said[1]


@pytest.mark.parametrize("value", [100.0, 3e4, 1e200, -1e308])
def test_a_damaged_sample_says_nothing_of_the_unit_or_the_motion(value):
    """Such a rate is beyond any gyroscope, but others are not."""
    rate = moving(4)
    rate[20_000, 1] = value
    assert said_of(rate)[0] == {"spikes"}


TIMES = np.arange(40_000)
HEALTHY = {
    "noise": np.random.default_rng(5).normal(0, 10.0, (40_000, 3)),
    "a hit": moving(6) + 15 * (np.exp(-(TIMES % 400) / 4) * np.cos(TIMES % 400))[:, None],
    "steps of a gait": moving(7) + 9 * np.exp(-((((TIMES % 200) - 100) / 1.2) ** 2))[:, None],
    "switched": 8.0 * np.sign(np.sin(TIMES / 50))[:, None] * [1, 0, 0],
    "held": np.repeat(moving(8, 10_000), 4, axis=0),
    "clipped": np.clip(10 * moving(9), -17.45, 17.45),
}
"""Rates that a body may have, rad/s."""


@pytest.mark.parametrize("healthy", HEALTHY)
def test_no_spike_is_found_in(healthy):
    """A body that is hit goes on to swing."""
    assert said_of(HEALTHY[healthy])[1] == []


def test_a_slow_sensor_may_miss_how_a_body_moves():
    """Between two samples it can turn away and stop."""
    rate = moving(10, 2000)
    rate[700, 1] = 20
    assert said_of(rate, hz=50)[1] == []


def test_a_dropout_elsewhere_does_not_hide_a_spike():
    """The advice was to take the rates for deg/s, and the spike was not told."""
    rate = moving(11)
    rate[20_000, 0] = -1000.0
    rate[30_000:30_100] = 0
    codes, (said,) = said_of(rate)
    assert codes == {"spikes", "dropout"}
    assert said.startswith("axis x jumps to -1000 rad/s for one sample")
    rate = moving(12)
    rate[20_000] = -1000.0
    assert said_of(rate)[0] == {"dropout"}
