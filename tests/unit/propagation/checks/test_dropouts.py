"""Rows without a measurement, on all axes at once, are found; rest and rounding are not."""

import numpy as np
import pytest

from quatprop import RemarkWarning, propagate
from quatprop.base.text import in_python
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.checks.dropouts import Filled
from quatprop.propagation.checks.rate_checks import RateChecks
from quatprop.propagation.checks.samples import Samples
from quatprop.timeline.counts import Counts

DEG = np.pi / 180


def said_of(rate_deg_s, hz=100):
    """Return the remarks on dropouts in rates in deg/s."""
    t_ns = np.arange(len(rate_deg_s)) * (1_000_000_000 // hz)
    checks = RateChecks("deg/s")
    GyroSeries.joined(list(checks.observe([GyroSeries(t_ns, rate_deg_s * DEG)])))
    counts = Counts(
        samples_used=len(t_ns), first_ns=0, last_ns=int(t_ns[-1]), median_dt_ns=10_000_000
    )
    return [in_python(one) for one in checks.remarks(counts) if one.code == "dropout"]


def moving(rng, count, noise=0.1):
    """Return rates of a body that swings, deg/s."""
    phase = np.arange(count)[:, None] * rng.uniform(0.005, 0.03, 3) + rng.uniform(0, 6, 3)
    return 40 * np.sin(phase) + rng.normal(0, noise, (count, 3))


LASTING = {
    "zeros": (0.0, "are exactly 0"),
    "held": ([31.25, -7.5, 3.0], "stay the same"),
}
"""Values of rows without a measurement, and the remarks on them."""
SINGLE = {
    "zeros": (0.0, "are exactly 0"),
    "full scale": (-32768 / 131, "jump to -250.137 deg/s"),
    "both ends": (np.array([32767, -32768, 32767]) / 131, "jump to 250.13 deg/s"),
    "all bits set": (-1 / 131, "jump to -0.00763359 deg/s"),
}
PLACES = [500, 16_370, 16_384, 16_250, 32_700]


@pytest.mark.thorough
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("first", "last"), [(0, 150), (0, None), (None, 0)])
@pytest.mark.parametrize("fault", LASTING)
def test_a_stretch_without_measurements_is_found_wherever_blocks_end(fault, first, last, place):
    """All axes froze or dropped out together, for a time, to the end, or from the beginning."""
    rate = np.round(moving(np.random.default_rng(place), 40_000), 3)
    value, sentence = LASTING[fault]
    begin, end = (None if k is None else place + k for k in (first, last))
    rate[begin:end] = value
    (said,) = said_of(rate)
    begin, end = begin or 0, end or len(rate)
    times = f"from t = {begin * 10_000_000} ns to t = {(end - 1) * 10_000_000} ns"
    assert said.startswith(f"all three rates {sentence} {times} ({end - begin} samples), next to")
    assert said.endswith("deg/s: did the sensor drop out?")


@pytest.mark.thorough
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("fault", SINGLE)
def test_single_rows_without_a_measurement_are_found(fault, place):
    """A bus that fails gives zeros, all bits, or an end of the range, for a row each."""
    rate = np.round(moving(np.random.default_rng(place), 40_000), 3)
    value, sentence = SINGLE[fault]
    rate[place % 50 :: 50] = value
    (said,) = said_of(rate)
    assert said.startswith(f"all three rates {sentence} ")
    assert said.endswith("deg/s: did the sensor drop out?")


def test_a_dropout_longer_than_blocks_is_one():
    """Of a long one, its ends are kept."""
    rate = moving(np.random.default_rng(1), 300_000)
    rate[1000:290_000] = 0
    (said,) = said_of(rate)
    assert "from t = 10000000000 ns to t = 2899990000000 ns (289000 samples)" in said


def test_a_steady_rotation_without_noise_has_dropouts_too():
    """The rates before and after are the same."""
    rate = np.tile([0.0, 0.0, 30.0], (2000, 1))
    rate[500:1000] = 0
    assert "(500 samples), next to rates of up to 30 deg/s" in said_of(rate)[0]


def rounded(rate, step):
    """Return rates as a sensor with a step has them."""
    return np.round(rate / step) * step


RNG = np.random.default_rng(4)
SOMETIMES = np.sin(np.arange(20_000) / 700).clip(0)[:, None]
HEALTHY = {
    "rest": RNG.normal(0.3, 0.1, (20_000, 3)),
    **{f"rest in steps of {step} deg/s": rounded(RNG.normal(0.2, 0.3, (20_000, 3)), step)
       for step in (0.061, 0.5, 1.0, 2.0)},
    **{f"motion and rest in steps of {step} deg/s": rounded(
        moving(RNG, 20_000, 0.0) * SOMETIMES + RNG.normal(0, 0.05, (20_000, 3)), step)
       for step in (0.061, 0.5, 1.0, 2.0)},
    "a dead band": np.where(np.abs(moving(RNG, 20_000) * SOMETIMES) < 1, 0,
                            moving(RNG, 20_000) * SOMETIMES),
    "a simulation that begins and ends at rest": moving(RNG, 20_000, 0.0) * SOMETIMES,
    "a dead band that most rates are near": np.where(
        np.abs(RNG.normal(3.0, 1.0, (20_000, 3))).max(axis=1, keepdims=True) < 4, 0,
        RNG.normal(3.0, 1.0, (20_000, 3)).clip(4)),
    "pulses of few samples": np.repeat(RNG.normal(0, 30, (4000, 1)) *
                                       (np.arange(4000) % 2)[:, None], 5, axis=0) * [1, 0.5, 0.3],
    "turns that are switched": np.repeat(RNG.normal(0, 30, (100, 3)) *
                                         (np.arange(100) % 2)[:, None], 200, axis=0),
    "every rate four times": np.repeat(moving(RNG, 5000), 4, axis=0),
    "a yaw rate alone": moving(RNG, 20_000) * [0, 0, 1],
    "clipped": np.clip(moving(RNG, 20_000) * 10, -250, 250),
}  # fmt: skip


@pytest.mark.parametrize("healthy", HEALTHY)
def test_no_dropout_is_found_in(healthy):
    """A coarse sensor that rests repeats its rows, and so does a simulation."""
    assert said_of(HEALTHY[healthy]) == []


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("bias", [None, "0.004,-0.006,0.003rad/s", "static"])
def test_zeros_are_found_whatever_is_subtracted_from_the_rates(bias):
    """The remark vanished with any bias: the samples were no longer zeros."""
    rng = np.random.default_rng(3)
    rate = moving(rng, 4000)
    rate[:400] = rng.normal(0, 0.05, (400, 3))
    rate[500:][rng.random(3500) < 0.15] = 0.0
    series = GyroSeries(np.arange(4000) * 10_000_000, rate * DEG)
    with pytest.warns(RemarkWarning, match="all three rates are exactly 0 ... times"):
        propagate(series, bias=bias)


def test_a_gap_that_was_filled_with_the_mean_is_found():
    """Rates jump to it and away; a body that turns quickly changes by half as much."""
    rate = moving(np.random.default_rng(3), 20_000) * [3, 2, 1]
    place = 5000 + int(np.abs(rate[5000:6000, 0]).argmax())
    rate[place : place + 150] = rate.mean(axis=0)
    assert "all three rates stay the same from t = " in said_of(rate)[0]


def test_a_turntable_without_noise_has_no_dropout():
    """It turns steadily, with quick ramps between."""
    ends = [4000, 4400, 9000, 9400, 12_000, 12_300, 17_000, 17_300]
    speed = np.interp(np.arange(20_000), ends, [0, 1, 1, 0, 0, -1, -1, 0])
    assert said_of(speed[:, None] * [30.0, 60.0, -90.0]) == []


def filled(rng, grid, count=12_000):
    """Return a motion on a grid of faster rows, with zeros elsewhere, and which rows are its."""
    if isinstance(grid, float):
        own = rng.random(count) < grid
    else:
        own = np.zeros(count, bool)
        own[np.unique(np.round(np.arange(0, count, grid[0] / grid[1])).astype(int))[:-1]] = True
    motion = moving(rng, int(own.sum()))
    motion[: len(motion) // 5] = rng.normal(0, 0.1, (len(motion) // 5, 3))
    rate = np.zeros((count, 3))
    rate[own] = np.round(motion, 3)
    return rate, own


GRIDS = [(2, 1), (3, 1), (4, 1), (5, 1), (10, 1), (14, 1), (240, 100), (1926, 148), 0.4, 0.77]
"""Rates of rows and of samples; or the share of the rows that are samples."""


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("grid", GRIDS)
def test_rates_joined_to_faster_rows_with_zeros_filled_in_are_found(grid, seed):
    """They were silent at most grids, and called several sensors at others."""
    rate, own = filled(np.random.default_rng(seed), grid)
    (said,) = said_of(rate)
    assert f"exactly 0 in {np.count_nonzero(~own)} of 12000 rows, first at t = " in said
    assert f"first at t = {np.flatnonzero(~own)[0] * 10_000_000} ns" in said


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("grid", GRIDS)
def test_what_is_said_of_filled_rows_does_not_depend_on_blocks(grid):
    """A stretch of zeros may begin in one block of samples and end in another."""
    rate, _ = filled(np.random.default_rng(1), grid, 50_000)
    whole, parts = Filled(), Filled()
    for looked, size in ((whole, 50_000), (parts, 7)):
        for begin in range(0, len(rate), size):
            columns = rate[begin : begin + size].T
            samples = Samples(columns, np.arange(begin, begin + size))
            looked.add(samples, np.abs(columns).max(axis=1))
    assert whole.are_found
    assert parts.text(("deg/s", 1.0)) == whole.text(("deg/s", 1.0))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("grid", [(10, 1), 0.4])
@pytest.mark.parametrize("way", ["removed", "left empty"])
def test_the_ways_out_of_filled_rows_are_right(grid, way):
    """Either gives the attitudes of the samples alone."""
    rate, own = filled(np.random.default_rng(2), grid)
    t_ns = np.arange(len(rate)) * 1_000_000
    true = GyroSeries(t_ns[own], rate[own] * DEG)
    if way == "removed":
        made = propagate(true)
    else:
        emptied = np.where(own[:, None], rate, np.nan) * DEG
        made = propagate(GyroSeries(t_ns, emptied), on_nonfinite="drop")
    assert not any(one.code == "dropout" for one in made.report.remarks)
    assert np.array_equal(made.t_ns, true.t_ns)
