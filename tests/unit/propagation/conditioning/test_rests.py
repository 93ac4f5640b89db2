"""The bias from stationary periods: where they differ, and where the rates are quantised."""

import math
import re

import numpy as np
import pytest
from make.commands import refused, run
from make.tables import write_rates

from quatprop import GyroSeries, propagate
from quatprop.base.errors import LogError, UsageError
from quatprop.kinematics.quaternion import conjugate, log, multiply
from quatprop.propagation.conditioning.static_period import Levels, shared_step, step_of

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
HZ = 100
DEG = math.pi / 180


def noise(seed, seconds, sigma=1e-3):
    """Return rates at rest, ``(N, 3)``, rad/s."""
    return np.random.default_rng(seed).normal(0, sigma, (seconds * HZ, 3))


def series(*parts):
    """Return parts of rates one after the other, at 100 Hz."""
    rate = np.concatenate(parts)
    return GyroSeries(np.arange(len(rate)) * (10**9 // HZ), rate)


def turning(seed, seconds=5):
    """Return rates of a body that moves."""
    t_s = np.arange(seconds * HZ)[:, None] / HZ
    return np.sin(2 * np.pi * t_s + np.random.default_rng(seed).uniform(0, 6, 3))


def found(samples, **options):
    """Return the report of a run that takes the bias from a rest, and its remarks."""
    report = propagate(samples, **{"bias": "static", "sigma": True, **options}).report
    return report, [str(remark) for remark in report.remarks]


def written(folder, samples):
    """Write samples as a table, whose unit is not told; return its path."""
    rows = ([t_ns, *rate] for t_ns, rate in zip(samples.t_ns, samples.rate.tolist(), strict=True))
    return write_rates(folder / "log.csv", rows)


# --- rests that differ


def two_rests(change):
    """Return 20 s of rest, motion, and 10 s of rest with another bias."""
    return series(noise(1, 20), turning(2), noise(3, 10) + np.array(change))


def test_the_bias_sigma_is_at_least_what_rests_differ_by():
    """It was that of the noise of one rest: 0.08 deg/h where the rests differed by 400."""
    report, remarks = found(two_rests([0, 0, 2e-3]))
    assert report.uncertainty.errors.bias_sigma == pytest.approx(2e-3, rel=0.05)
    (remark,) = (text for text in remarks if "differs" in text)
    assert remark.startswith("the mean rate at rest from 0 to 19990000000 ns differs by 0.11")
    assert remark.endswith(
        "the bias changed between the two, or the body turned steadily in one of them"
    )


@pytest.mark.parametrize(("change", "differs"), [(0.033, True), (0.037, False)])
def test_what_differs_by_more_than_biases_do_is_a_rotation(change, differs):
    """By the rates alone a steady turn of 2 deg/s and more is another rest, and no bias."""
    report, remarks = found(two_rests([0, 0, change]))
    assert any("differs" in text for text in remarks) == differs
    assert (report.correction.rest.other is not None) == differs


def test_the_bias_sigma_of_one_rest_is_that_of_the_mean_of_its_noise():
    """White noise of 1 mrad/s, averaged over all samples."""
    report, _ = found(series(noise(1, 60)))
    assert report.correction.rest.samples == 60 * HZ
    expected = 1e-3 / math.sqrt(60 * HZ)
    assert report.uncertainty.errors.bias_sigma == pytest.approx(expected, rel=0.05)


def test_the_rest_that_the_remark_names_can_be_taken():
    """Its remedy, applied, gives the mean of the other rest."""
    samples = two_rests([0, 0, 2e-3])
    _, remarks = found(samples)
    remedy = re.search(r"bias='(static@[0-9.]+)'", " ".join(remarks))[1]
    report, _ = found(samples, bias=remedy)
    inside = samples.rate[25 * HZ :]
    np.testing.assert_allclose(report.correction.bias_rad_s, inside.mean(axis=0), atol=3e-5)
    assert report.correction.rest.first_ns >= 25 * 10**9


def test_a_rest_that_is_named_is_compared_with_the_others():
    """Its sigma was that of its noise: less than a hundredth of what rests differed by."""
    for given in ("static@+1s..+19s", "static@+26s..+34s"):
        report, remarks = found(two_rests([0, 0, 2e-3]), bias=given)
        assert report.uncertainty.errors.bias_sigma == pytest.approx(2e-3, rel=0.1)
        assert any("differs by 0.11" in remark for remark in remarks)


def test_a_named_part_in_which_the_body_moves_is_said_to_be_no_rest():
    """It was called rest, and its mean the bias, without a word."""
    report, remarks = found(two_rests([0, 0, 0]), bias="static@+20s..+24s")
    assert any(remark.endswith("rad/s: the body moves there") for remark in remarks)
    assert report.correction.rest.scatter_rad_s > 1


def moving(seed, seconds=40, peak=0.8):
    """Return smooth rates of a body that begins to move, and comes to rest."""
    random, t_s = np.random.default_rng(seed), np.arange(seconds * HZ)[:, None] / HZ
    waves = [
        np.cos(2 * np.pi * hertz * t_s + random.uniform(0, 6, 3)) * random.normal(0, 1, 3)
        for hertz in random.uniform(0.02, 0.8, 24)
    ]
    return peak / 6 * np.sum(waves, axis=0) * np.sin(np.pi * t_s / seconds) ** 2


@pytest.mark.thorough
@pytest.mark.parametrize("way", ["static", "static:nearest"])
@pytest.mark.parametrize("sigma", [1e-3, 7e-3, 15e-3])
def test_a_moment_of_slow_motion_is_no_rest(sigma, way):
    """A second whose mean was smaller by chance was preferred to two rests of 12 s."""
    for seed in range(12):
        bias = np.random.default_rng(seed).normal(0, 0.02, 3)
        first, last = (noise(seed + 100 * k, 12, sigma) for k in (1, 2))
        samples = series(first, moving(seed) + noise(seed, 40, sigma), last)
        report, _ = found(samples.with_rate(samples.rate + bias), bias=way)
        for rest in report.correction.all_rests:
            assert np.abs(rest.mean_rad_s - bias).max() < 0.3 * DEG, (seed, rest)


@pytest.mark.parametrize("rate", [0.25, 1.0, -8.0])
def test_a_named_part_in_which_the_body_spins_has_no_bias(rate):
    """Its rotation was taken for a bias, at any rate; without an end the same was refused."""
    samples = series(noise(1, 4), noise(2, 4) + np.array([0, 0, rate]), noise(3, 4))
    said = "more than the bias of a gyroscope: the body rotates; name a time at rest, or give bias"
    with pytest.raises(UsageError, match=f"mean rate of {abs(rate):.3g} rad/s, {said}='X,Y,Z'"):
        found(samples, bias="static@+5s..+7s")
    found(samples, bias="static@+9s..+11s")
    found(samples, bias=[0, 0, rate], sigma=False)


def test_a_shorter_rest_is_not_asked_for_again():
    """Who looked for a shorter one was told to."""
    samples = series(turning(1))
    for way in ("static", "static:3s", "static:nearest"):
        with pytest.raises(LogError, match=r"or look for a shorter one with bias='static:DUR'$"):
            found(samples, bias=way)
    for way in ("static:100ms", "static:nearest:0.9s"):
        with pytest.raises(LogError, match=r"; give bias='X,Y,Z'$"):
            found(samples, bias=way)


def test_a_rest_of_zeros_is_a_rest():
    """A coarse sensor was reported to have none; zeros before it begins to measure are none."""
    zeros, moving = np.zeros((10 * HZ, 3)), turning(2)
    report, remarks = found(series(zeros, moving), sigma=False)
    assert report.correction.rest.samples == 10 * HZ
    assert not report.correction.bias_rad_s.any()
    assert not [text for text in remarks if "would look the same" in text]
    later = noise(1, 10) + np.array([0, 0, 0.01])
    report, _ = found(series(zeros, moving, later))
    np.testing.assert_allclose(report.correction.bias_rad_s, later.mean(axis=0), atol=1e-5)


def test_a_rest_ends_where_its_mean_has_drifted():
    """Each window is like the one before it; as far as the first half of a degree in all."""
    drift = np.arange(60 * HZ)[:, None] / HZ * [0, 0, 5e-4]
    report, _ = found(series(noise(1, 60, 1e-5) + drift))
    # Of a ramp of s, a window at t is s t / 2 off the mean before it: 3 mrad/s after 12 s.
    assert report.correction.rest.samples == pytest.approx(12 * HZ, abs=HZ)


def test_one_sample_is_no_rest():
    """It has no scatter."""
    with pytest.raises(LogError, match="no stationary period: too few samples; give bias"):
        found(GyroSeries(np.arange(20) * 10**9, np.zeros((20, 3))))
    quarters = GyroSeries(np.arange(20) * 250_000_000, noise(1, 1)[:20])
    assert found(quarters)[0].correction.rest.samples == 20
    with pytest.raises(UsageError, match="holds fewer than 2 samples; info shows"):
        found(two_rests([0, 0, 0]), bias="static@+1s..+1s")
    report, _ = found(two_rests([0, 0, 0]), bias="static@+1s..+1010ms")
    assert report.correction.rest.samples == 2


def test_rests_that_are_alike_are_not_said_to_differ():
    """Of a hundred logs whose rests differ by noise alone."""
    for seed in range(100):
        samples = series(noise(3 * seed, 4), turning(3 * seed + 1, 1), noise(3 * seed + 2, 4))
        report, remarks = found(samples)
        assert not [text for text in remarks if "differs" in text], seed
        assert report.correction.rest.other is None


def test_rests_that_differ_by_less_than_their_step_shows_are_not_said_to_differ():
    """One rest at the edge of two levels was cut in two, and the bias was reported to change."""
    for seed in range(60):
        random = np.random.default_rng(seed)
        resting = [0.3, 0.44, -0.2] + 0.1 * random.normal(size=(8 * HZ, 3))
        _, remarks = found(series(np.rint(resting) * DEG, np.rint(60 * turning(seed)) * DEG))
        assert any("the bias is known only to" in text for text in remarks)
        assert not [text for text in remarks if "differs" in text], seed


def test_one_noisy_axis_is_no_change_of_the_bias():
    """Of a gyroscope with one axis, or one bad one, rests were cut and said to differ."""
    for seed in range(20):
        resting = noise(seed, 60, 0.6 * DEG) * [0, 0, 1] + [0, 0, 5e-3]
        report, remarks = found(series(resting, turning(seed) * [0, 0, 1]))
        assert not [text for text in remarks if "differs" in text], seed
        assert report.correction.rest.samples > 40 * HZ
        # White noise of 0.6 deg/s at 100 Hz; it was averaged over three axes.
        density = report.uncertainty.errors.noise_density
        assert density == pytest.approx(0.6 * DEG / math.sqrt(HZ), rel=0.06)


# --- several rests


def three_rests():
    """Return rests of 20, 10 and 10 s whose biases differ about z, with motion between them."""
    changes = np.array([[0, 0, 0], [0, 0, 2e-3], [0, 0, -1e-3]])
    first, second, third = noise(1, 20), noise(3, 10) + changes[1], noise(5, 10) + changes[2]
    return series(first, turning(2), second, turning(4), third), changes


@pytest.mark.parametrize("way", ["nearest", "interpolate"])
def test_the_bias_of_several_rests(way):
    """At rest it is that of the rest; it changes halfway to the next, or all the way to it."""
    samples, changes = three_rests()
    report, remarks = found(samples, bias=f"static:{way}")
    conditioning = report.correction
    assert conditioning.bias_rad_s is None
    assert conditioning.interpolated == (way == "interpolate")
    means = [rest.mean_rad_s for rest in conditioning.rests]
    np.testing.assert_allclose(means, changes, atol=2e-4)
    assert not any("differs by" in each for each in remarks), "they may differ"
    # The rates that are propagated, from attitudes that are.
    wxyz = propagate(samples, bias=f"static:{way}").wxyz
    rate = log(multiply(conjugate(wxyz[:-1]), wxyz[1:])) * HZ
    bias = (samples.rate[:-1] - rate)[:, 2]
    ends = [(rest.first_ns, rest.last_ns) for rest in conditioning.rests]
    for (first, last), mean in zip(ends, means, strict=True):
        inside = (samples.t_ns[:-1] >= first) & (samples.t_ns[:-1] <= last)
        np.testing.assert_allclose(bias[inside], mean[2], atol=1e-9)
    middle = int((ends[0][1] + ends[1][0]) // 2 // 10**7)
    expected = np.mean(means[:2], axis=0) if way == "interpolate" else means[1]
    assert bias[middle + 1] == pytest.approx(expected[2], abs=1e-5)
    before = np.mean(means[:2], axis=0) if way == "interpolate" else means[0]
    assert bias[middle - 1] == pytest.approx(before[2], abs=1e-5)


def test_of_several_rests_the_error_between_them_is_stated():
    """In deg/h/sqrt(h), with where it comes from; near a rest the bias is known well again."""
    samples, _ = three_rests()
    sigma = {}
    for way in ("static", "static:nearest", "static:interpolate"):
        report, _ = found(samples, bias=way)
        sigma[way] = report.uncertainty.sigma_rad[2]
        assert report.uncertainty.origins["bias_sigma"] == "rest"
        assert ("random_walk" in report.uncertainty.origins) == (way != "static")
    assert sigma["static:nearest"] < sigma["static"] / 5
    assert report.uncertainty.origins["random_walk"] == "rests that differ"
    walk = 3e-3 / math.sqrt(5.0)  # from rest to rest, of which windows cut off a part
    assert report.uncertainty.errors.random_walk == pytest.approx(walk, rel=0.2)
    given, _ = found(samples, bias="static:nearest", bias_sigma=1e-3)
    assert given.uncertainty.origins["bias_sigma"] == "given"


def test_each_rest_has_the_error_of_its_own_length():
    """The error that is stated is that of the shortest; after a longer one it is smaller."""
    samples = series(noise(5, 4), turning(2), noise(3, 100), turning(4, 10))
    uncertainty = found(samples, bias="static:nearest")[0].uncertainty
    density = uncertainty.errors.noise_density
    short, long = density / math.sqrt(4), density / math.sqrt(100)
    assert uncertainty.errors.bias_sigma == pytest.approx(short, rel=0.05)
    # In motion for 15 s, of which 2.5 s are nearer to the first rest.
    away = density**2 * 15 + (short * 2.5) ** 2 + (long * 12.5) ** 2
    assert uncertainty.sigma_rad == pytest.approx([math.sqrt(away)] * 3, rel=0.05)


def test_one_rest_is_the_nearest_and_the_bias_between():
    """To the bit what static takes."""
    samples = series(noise(1, 10), turning(2))
    one, nearest, between = (
        propagate(samples, bias=f"static{way}").wxyz for way in ("", ":nearest", ":interpolate")
    )
    assert one.tobytes() == nearest.tobytes() == between.tobytes()


def test_the_summary_says_how_the_bias_follows_from_rests(tmp_path):
    """And the same attitudes come out of a file, in whatever batches."""
    samples, _ = three_rests()
    path, out = written(tmp_path, samples), tmp_path / "out.csv"
    options = ("--rate-unit", "rad/s", "--bias", "static:interpolate")
    result = run("propagate", path, "-o", out, *options)
    (line,) = (line for line in result.stderr.splitlines() if line.startswith("bias"))
    assert "interpolated between 3 rests of 39." in line
    assert "from the first to the last x " in line
    rests = propagate(samples, bias="static:interpolate").report.correction.rests
    first, last = (rests[n].mean_rad_s for n in (0, -1))
    assert f"  z {first[2]:+.6g} to {last[2]:+.6g} rad/s" in line
    last = [float(part) for part in out.read_text().splitlines()[-1].split(",")[1:]]
    expected = propagate(samples, bias="static:interpolate").wxyz[-1]
    np.testing.assert_allclose(last, expected, rtol=1e-15)
    said = refused("propagate", path, "-o", out, "--bias", "static:2s:nearest")
    assert "'2s' is not one of 'nearest', 'interpolate'" in said


# --- a rest that is given


@pytest.mark.parametrize("given", ["+25s..+34s", "-9.99s..-990ms", "25000000000..34000000000"])
def test_a_rest_can_be_given(tmp_path, given):
    """By times in the log's clock, or counted from its first or last sample."""
    samples = two_rests([0, 0, 0])
    given = f"static@{given}"
    report = propagate(samples, bias=given).report
    rest = report.correction.rest
    inside = (samples.t_ns >= rest.first_ns) & (samples.t_ns <= rest.last_ns)
    assert inside.sum() == rest.samples == 901
    np.testing.assert_allclose(rest.mean_rad_s, samples.rate[inside].mean(axis=0), rtol=1e-12)
    path, out = written(tmp_path, samples), tmp_path / "out.csv"
    result = run("propagate", path, "-o", out, "--rate-unit", "rad/s", "--bias", given)
    assert "from 901 samples over 9 s" in result.stderr
    assert "; as given" in result.stderr


def test_a_rest_holds_the_same_for_every_part_that_is_propagated():
    """Its times count from the log, not from the part."""
    samples = two_rests([0, 0, 0])
    whole, part = (
        propagate(samples, bias="static@+25s..+34s", **options).report.correction.rest.mean_rad_s
        for options in ({}, {"start": "+20s", "end": "+30s"})
    )
    assert np.array_equal(whole, part)


# --- quantisation


@pytest.mark.parametrize("step", [1.0, 0.0152588, 1 / 16.4, 1e-6])
def test_the_step_of_rates_is_found(step):
    """Of numbers as sensors give them, rounded to float32 or to digits of text."""
    levels = np.unique(np.random.default_rng(1).integers(-200, 200, 300)) * step
    for values in (levels, levels.astype(np.float32), np.round(levels, 9)):
        assert step_of(np.unique(values.astype(float))) == pytest.approx(step, rel=1e-3)


@pytest.mark.parametrize("tiny", [5e-324, 1e-309, 1e-300, 1e-200])
@pytest.mark.parametrize("largest", [1.0, 1e99, 1e300, math.inf])
def test_values_that_differ_by_rounding_have_no_step(largest, tiny):
    """Dividing by a difference of the smallest numbers overflowed, with a warning of NumPy's."""
    assert step_of(np.array([0.0, tiny, 0.3, largest])) == 0


def test_an_axis_of_few_values_has_the_step_of_the_others():
    """Of a log that turned steadily, or about one axis alone, no step was found, nor its error."""
    for values in ([0, 1, 24, 49, 73], [2, -1, 25, 50, 72], [-2, 22, 0, 47, 3]):
        assert shared_step(np.array(values) * DEG) == pytest.approx(DEG)
    for values in ([0.0, 0.0, 1.0], [0.5, 1.0, 1.5], [math.pi, 1.0, math.e, math.sqrt(2)]):
        assert shared_step(np.array(values)) == 0
    # Few values, or very many, or a largest one that is far off, fit some step by chance.
    for values in ([1, 8], [1, 100_000], range(100)):
        assert shared_step(np.array(values, float)) == 1
    for values in ([], [9], [1, 7], [1, 100_001], range(101)):
        assert shared_step(np.array(values, float)) == 0
    planar = np.zeros((1000, 3))
    planar[300:, 2] = np.rint(np.linspace(0, 40, 700))
    report, _ = found(series(planar * DEG), bias="static@+0s..+2s")
    assert len(report.correction.rest.levels) == 3


@pytest.mark.parametrize(("sigma", "axes"), [(1.05, 3), (1.25, 0)])
def test_noise_of_two_steps_hides_them(sigma, axes):
    """Over the three axes, with that of rounding: 1.89 and 2.22 steps."""
    samples = series(np.rint(noise(1, 20, sigma)) * DEG, np.rint(60 * turning(2)) * DEG)
    assert len(found(samples)[0].correction.rest.levels) == axes


@pytest.mark.parametrize("damaged", [np.nan, np.inf, -1e308, 1e300])
def test_damaged_numbers_hide_no_step(damaged):
    """The difference of two of them was an overflow."""
    values = np.concatenate([np.arange(50) * 0.1, [damaged, -damaged]])
    assert step_of(values) == pytest.approx(0.1)


def test_rates_that_are_not_quantised_have_no_step():
    """Whatever their number; nor have two values, nor those that differ by rounding alone."""
    assert step_of(0.1 + np.spacing(0.1) * np.array([0, 1, 2, 3, 5])) == 0
    # Differences are whole steps to 2 %, of which most are at most 50 steps.
    assert step_of(np.array([0, 1, 2.015])) == pytest.approx(1, rel=0.01)
    assert step_of(np.array([0, 1, 2.025])) == 0
    assert step_of(np.array([0, 1, 51, 101])) == 1
    assert step_of(np.array([0, 1, 52, 103])) == 0
    random = np.random.default_rng(2)
    for count in (2, 10, 1000):
        assert step_of(np.unique(random.normal(size=count))) == 0


@pytest.mark.parametrize("spread", [0.0, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.5])
def test_the_mean_of_a_quantised_rest_is_as_good_as_stated(spread):
    """Of a thousand rests; noise alone, which was stated, is hundreds of times less."""
    random = np.random.default_rng(3)
    ratios, by_noise = [], []
    for rate in random.uniform(-1, 1, 1000):
        samples = np.rint(rate + spread * random.normal(size=500))
        counts = np.sort(np.unique(samples, return_counts=True)[1])[::-1]
        error, scatter = samples.mean() - rate, samples.std() / math.sqrt(500)
        ratios.append(error / math.hypot(Levels(1.0, counts).sigma, scatter))
        by_noise.append(error / max(scatter, 1e-9))
    # The 99.9 % band of chi-square with 1000 degrees of freedom, where the model is exact.
    rms = math.sqrt(np.square(ratios).mean())
    assert rms < math.sqrt(1.143)
    # Elsewhere it is the worst case of the rate between two levels.
    assert rms > (math.sqrt(0.866) if spread in {0.0, 0.8, 1.5} else 0.4)
    if spread <= 0.2:
        assert math.sqrt(np.square(by_noise).mean()) > 5


@pytest.mark.parametrize("value", [0.0, 0.1])
def test_a_rest_of_one_value_in_unknown_steps_tells_no_sigma(value):
    """The bias was stated to be exact, with sigma 0, and noise as well."""
    samples = series(np.full((5 * HZ, 3), value), turning(2))
    report, remarks = found(samples, sigma=False)
    assert report.uncertainty is None
    assert sum("how well the bias is known" in remark for remark in remarks) == 1
    with pytest.raises(UsageError, match=r"in no known steps; give bias_sigma$"):
        found(samples)
    given = found(samples, bias_sigma=1e-3)[0].uncertainty
    assert given.origins == {"bias_sigma": "given"}
    assert given.sigma_rad == pytest.approx(5e-3, rel=0.1)
