"""Suspicious rates have one remark; healthy ones have none."""

import math
import re
from itertools import product

import numpy as np
import pytest

from quatprop.base.text import in_python
from quatprop.base.times import duration_text
from quatprop.kinematics.series import GyroSeries
from quatprop.propagation.checks.rate_checks import RateChecks
from quatprop.timeline.counts import Counts

START_NS = 1_700_000_000_000_000_000
SLOW = ": the sample rate is too low for this motion"


def remarks(rate, step_ns=10_000_000, size=10_000):
    """Return the remarks on rates at regular times, which come in batches of a size."""
    rate = np.asarray(rate, dtype=np.float64)
    t_ns, checks = np.arange(len(rate)) * step_ns, RateChecks()
    batches = [
        GyroSeries(t_ns[k : k + size], rate[k : k + size]) for k in range(0, len(rate), size)
    ]
    passed = GyroSeries.joined(list(checks.observe(batches)))
    assert (passed.t_ns == t_ns).all()
    assert np.array_equal(passed.rate, rate, equal_nan=True)
    counts = Counts(samples_used=len(rate), first_ns=0, last_ns=int(t_ns[-1]), median_dt_ns=step_ns)
    return list(map(in_python, checks.remarks(counts)))


def noise(scale, samples=20_000):
    """Return white noise."""
    return np.random.default_rng(3).normal(0, scale, (samples, 3))


def swinging(samples=20_000, peak=5.0):
    """Return rates of a body that swings; all peaks of a sine are equal, and it dwells there."""
    angle = np.arange(samples)[:, None] * 0.02 * [1.0, 1.5, 0.7] + [0, 1, 2]
    return peak * np.sin(angle) + noise(5e-3, samples)


def steps(size=1, samples=5000):
    """Return rates of a coarse sensor at rest."""
    return np.random.default_rng(5).integers(-1, 2, (samples, 3)) * 0.01 * size


def with_run(rate, first, count, value, axis=0):
    """Return rates with a run of equal ones."""
    rate[first : first + count, axis] = value
    return rate


CAR = 0.2 * np.sin(np.cumsum(noise(0.1), axis=0) * [0, 0, 1])
HELD = (
    "75 % of the rows repeat the row before while the body turns: the log repeats samples, with a "
    "new rate only every 4 rows"
)
EQUAL = "every rate is the same, "
CHANGES = "between two samples, the rate changes by"
EVERY_FOURTH = np.arange(20_000) // 4 * 4


def wave(phase, step_deg=3.0):
    """Return rates at 10 Hz of a phase in each step, whose steps differ by some deg RMS."""
    peak = math.radians(step_deg) / 0.1 / (math.sqrt(2) * math.sin(phase / 2))
    return peak * np.sin(np.arange(2000) * phase)[:, None] * [1, 0, 0], 100_000_000


def at_the_end(first, count):
    """Return rates that are close to their extreme of 3 rad/s for some samples."""
    return with_run(with_run(noise(0.1, 40_000), first, count, 2.95), first, 1, 3.0)


def stepping(ways):
    """Return rates that change 101 times, in so many ways, and are held for two rows."""
    jumps = [(k // 2 + 1) * (-1) ** k for k in range(ways)]
    places = np.cumsum([0, *np.resize(jumps, 101)])
    return (1 + 0.01 * np.repeat(places, 2))[:, None] * [1, 0, 0]


def ramp(limit, samples=20_000, slope=0.01):
    """Return rates that rise steadily to a limit, and fall again at the end."""
    rise = slope * np.arange(samples)
    return np.minimum(np.minimum(rise, rise[::-1]), limit)[:, None] * np.ones(3)


GOOD = {
    "swinging": swinging(),
    "missing rates": np.where(np.arange(20_000)[:, None] % 7 == 0, np.nan, swinging()),
    "a coarse sensor at rest": steps(),
    "one that repeats its steps": np.where(noise(1, 5000)[:, :1] < -0.5, 0, steps(0.1)),
    "a steady turn about an axis": swinging() * [1, 1, 0] + [0, 0, 6] + noise(1e-3),
    "a simulated turn about two axes": (swinging() - noise(5e-3)) * [1, 1, 0] + [0, 0, 6],
    "a rounded one": np.round((swinging() - noise(5e-3)) * [1, 1, 0] + [0, 0, 6], 4),
    "a yaw rate alone": (swinging() * [0, 0, 1], 10_000_000),
    "a simulated turn that goes on": ramp(6.0) * [0, 0, 1],
    "a sensor that clips for 19 samples": with_run(noise(0.1), 100, 19, 3.0),
    "a switched turn": np.where(np.arange(20_000)[:, None] // 500 % 2, 4.0, -4.0) + noise(0.05),
    "vibration near half the sample rate": (
        noise(0.02) + 0.5 * np.sin(np.arange(20_000) * 2.9)[:, None]
    ),
    "a turntable that is switched on and off": (
        (np.arange(20_000) // 2000 % 2)[:, None] * [0, 0, 3.0] + noise(2e-3)
    ),
    "a larger extreme after a run": with_run(
        with_run(noise(0.1), 100, 10, 3.0), 17_000, 2, 3.1
    ),
    "a car, often": (CAR, 20_000_000),
    "a stay in two of the parts that are checked together": at_the_end(16_374, 20),
    "no finite rate": np.full((200, 3), np.nan),
    "an infinite rate": with_run(swinging(1000), 500, 1, np.inf),
    "the widest range": (with_run(swinging(1000), 500, 2, math.radians(4000)), 1_000_000),
    "99 equal rates": np.full((99, 3), 0.3),
    "30 deg in a step": (np.eye(3)[[2, 0, 0]] * math.radians(30), 1_000_000_000),
    "11.6 samples a turn": wave(0.54),
    "steps below 1 deg": wave(1.0, 0.99),
    "20 samples of noise": (noise(1.0, 20), 100_000_000),
    "every fortieth row is a repetition": swinging()[np.arange(20_000) * 39 // 40],
    "rates that are constant for 20 rows": swinging(peak=2.0)[np.arange(20_000) // 20],
    "99 repetitions": swinging(peak=2.0)[np.arange(198) // 2],
    "47 different steps": stepping(47),
}  # fmt: skip
BAD = [
    (np.zeros((5, 3)), ["every rate is zero: is this the right topic?"]),
    (
        np.tile([131.0, 132.0, 133.0], (200, 1)),
        [
            (
                "rates up to 133 rad/s are beyond any gyroscope; if they are in deg/s, use "
                "rate_unit='deg/s'"
            ),
            "every rate is the same, [131.0, 132.0, 133.0] rad/s: frozen, or simulated?",
        ],
    ),
    (
        (np.eye(3)[[2, 0, 0]] * math.radians(30.1), 1_000_000_000),
        [f"the body rotates by up to 30.1 deg between two samples{SLOW}"],
    ),
    # Two stays, the first of which ends with the samples that are checked together.
    (
        with_run(at_the_end(16_374, 10), 32_768, 10, 2.95),
        ["axis +x is within 5 % of its extreme of 3 rad/s in 0.05 % of the samples"],
    ),
    # Just beyond the bounds that GOOD stays within.
    (
        (with_run(swinging(1000), 500, 2, math.radians(4000.5)), 1_000_000),
        ["rates up to 69.82 rad/s are beyond any gyroscope"],
    ),
    (np.full((100, 3), 0.2), [f"{EQUAL}[0.2, 0.2, 0.2] rad/s: frozen, or simulated?"]),
    (
        np.full((100, 3), -0.19),
        [f"{EQUAL}[-0.19, -0.19, -0.19] rad/s: frozen, or simulated, or at rest with"],
    ),
    (wave(0.57), [CHANGES]),
    (wave(1.0, 1.01), [CHANGES]),
    ((noise(1.0, 21), 100_000_000), [CHANGES]),
    (with_run(noise(0.02), 0, 20_000, 0.1)[EVERY_FOURTH], ["axis x never changes, it is 0.1 rad"]),
    (with_run(noise(0.02), 0, 20_000, 0.101)[EVERY_FOURTH], [HELD, "axis x never changes"]),
    (
        swinging()[np.arange(20_000) * 3 // 4],
        [HELD.replace("75 %", "25 %").replace("4 r", "1.3 r")],
    ),
    *(
        (
            swinging()[np.arange(20_000) * part // (part + 1)],
            [
                HELD.replace("75 %", f"{100 / (part + 1):.2g} %").replace(
                    "4 r", f"{1 + 1 / part:.2g} r"
                )
            ],
        )
        for part in (5, 9, 15)
    ),
    (swinging()[np.arange(20_000) // 19], [HELD.replace("75 %", "95 %").replace("4 r", "19 r")]),
    *(
        (rate, [HELD.replace("75 %", "50 %").replace("4 r", "2 r")])
        for rate in (swinging(peak=2.0)[np.arange(200) // 2], stepping(48))
    ),
    # Three rows of one held sample at an extreme are one sample, but a sensor that is read too
    # often may be saturated as well.
    (swinging()[EVERY_FOURTH], [HELD]),
    (
        np.clip(swinging()[EVERY_FOURTH], -4, np.inf),
        [HELD, *(f"axis -{axis} stays at its extreme of -4" for axis in "xyz")],
    ),
    (with_run(GOOD["missing rates"].copy(), 400, 3, 6.0), ["axis +x stays at its extreme of 6"]),
]


@pytest.mark.parametrize("case", GOOD)
def test_nothing_is_said_of_good_rates(case):
    """Whatever the body does."""
    rate, *step_ns = GOOD[case] if isinstance(GOOD[case], tuple) else (GOOD[case],)
    assert remarks(rate, *step_ns) == []


@pytest.mark.parametrize(("rate", "expected"), BAD)
def test_each_finding_is_a_sentence(rate, expected):
    """And there is no other one."""
    rate, *step_ns = rate if isinstance(rate, tuple) else (rate,)
    said = remarks(rate, *step_ns)
    assert len(said) == len(expected), said
    assert all(one.startswith(start) for one, start in zip(said, expected, strict=True)), said


GIVEN = ", in {} as given: is that right?"


@pytest.mark.parametrize(
    ("unit", "is_given", "peak", "advice"),
    [
        ("rad/s", False, 80, "; if they are in deg/s, use rate_unit='deg/s'"),
        ("rad/s", True, 80, GIVEN.format("rad/s")),
        ("deg/s", False, 4584, ": is deg/s right?"),
        ("deg/s", True, 4584, GIVEN.format("deg/s")),
    ],
)
def test_a_unit_that_was_given_is_not_advised(unit, is_given, peak, advice):
    """--rate-unit deg/s was advised for rates that were read in deg/s already."""
    checks = RateChecks(unit, is_given=is_given)
    rate = np.clip(swinging(peak=80.0), -80, 80)
    list(checks.observe([GyroSeries(np.arange(len(rate)), rate)]))
    (said,) = map(
        in_python, checks.remarks(Counts(samples_used=len(rate), first_ns=0, last_ns=10**10))
    )
    assert said == f"rates up to {peak} {unit} are beyond any gyroscope{advice}"


def test_the_extreme_is_said_in_the_unit_of_the_log():
    """A sensor in deg/s that saturates at 250 was reported to saturate at 4.36332 rad/s."""
    limit = math.radians(250)
    checks, rate = RateChecks("deg/s"), np.clip(swinging(1000), [-9, -9, -9], [9, limit, 9])
    list(checks.observe([GyroSeries(np.arange(1000) * 10_000_000, rate)]))
    counts = Counts(samples_used=1000, first_ns=0, last_ns=9_990_000_000, median_dt_ns=10_000_000)
    (said,) = checks.remarks(counts)
    assert said.startswith("axis +y stays at its extreme of 250 deg/s for 3 samples or more")
    assert said.code == "saturated"


def test_a_car_sampled_once_a_second_is_too_slow():
    """Steps of few degrees, each of another rate: what lies between them is unknown."""
    (said,) = remarks(CAR[::50], 1_000_000_000)
    assert said.endswith(f" deg in the time between them{SLOW}")
    change = np.sqrt((np.diff(CAR[::50], axis=0) ** 2).sum(axis=1).mean())
    assert float(said.split(" ")[7]) == pytest.approx(np.degrees(change), rel=0.01)


LOW = (0.0, 1)
STAYS = {
    # Values of x relative to the largest, and how often; samples, interval in ms -> the remark.
    (((1, 1), (0.97, 9), LOW, (0.97, 10)), 400, 1): "piled up",
    (((1, 1), (0.97, 9), LOW, (0.97, 9)), 400, 1): "",
    (((1, 1), (0.97, 39)), 400, 1): "",
    (((1, 1), (0.97, 13), LOW, (0.97, 13), (0.8, 15)), 400, 1): "piled up",
    (((1, 1), (0.97, 13), LOW, (0.97, 13), (0.8, 16)), 400, 1): "",
    (((1, 1), (0.97, 2), LOW, *((0.97, 3), LOW) * 7), 400, 1): "piled up",
    (((1, 1), (0.97, 2), LOW, *((0.97, 3), LOW) * 6, (0.97, 2)), 400, 1): "",
    (((1, 1), (0.97, 24), LOW, (0.97, 25)), 100, 1): "piled up",
    (((1, 1), (0.97, 24), LOW, (0.97, 26)), 100, 1): "",
    (((1, 1), (0.97, 199), LOW, (0.97, 200)), 1000, 10): "piled up",
    (((1, 1), (0.97, 200), LOW, (0.97, 201)), 1000, 10): "",
    # Where the end begins, and where a stay at it ends.
    (((1, 1), (0.951, 9), LOW, (0.951, 10)), 400, 1): "piled up",
    (((1, 1), (0.949, 9), LOW, (0.949, 10)), 400, 1): "",
    (((1, 1), (0.97, 9), LOW, (0.97, 10), (0.751, 12)), 400, 1): "",
    (((1, 1), (0.97, 9), LOW, (0.97, 10), (0.749, 12)), 400, 1): "piled up",
    (((1, 1), (0.97, 9), (0.751, 1), (0.97, 10)), 400, 1): "",
    (((1, 1), (0.97, 9), (0.749, 1), (0.97, 10)), 400, 1): "piled up",
    # One stay is a steady turn if it is long; a rounded peak has many values close to the largest.
    (((1, 10),), 400, 10): "run",
    (((1, 11),), 400, 10): "",
    (((1, 8), (290 / 300, 2), (289 / 300, 1)), 400, 1): "run",
    (((1, 7), (290 / 300, 2), (289 / 300, 1)), 400, 1): "",
    (((1, 7), (289 / 300, 2), (288 / 300, 1)), 400, 1): "run",
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("case", STAYS)
def test_samples_at_the_end_of_the_range(case, sign):
    """Many, in several short stays, and hardly any below; each number has a case next to it."""
    parts, samples, interval_ms = case
    # A long stay is not of one rate alone, as that of an axis that is frozen.
    x = np.concatenate([
        4 * value * (1 - 1e-4 * (count > 99) * (np.arange(count) % 2)) for value, count in parts
    ])  # fmt: skip
    rate = noise(1e-3, samples)
    rate[20 : 20 + len(x), 0] = sign * x
    side, at_end = ("+" if sign > 0 else "-"), sum(n for value, n in parts if value > 0.95)
    expected = {
        "piled up": f"axis {side}x is within 5 % of its extreme of {4 * sign} rad/s in "
        f"{100 * at_end / samples:.2g} % of the samples, and hardly ever shortly below: saturated",
        "run": f"axis {side}x stays at its extreme of {4 * sign} rad/s for 3 samples or more",
    }
    said = remarks(rate, interval_ms * 1_000_000)
    # Larger rates were said to be missing from a robot's joint that turns at the same speed.
    assert all(one.endswith(", unless the body turns steadily there") for one in said)
    assert [one[: len(expected.get(STAYS[case], one))] for one in said] == [
        expected[kind] for kind in filter(None, [STAYS[case]])
    ]


def test_extremes_below_any_range_are_not_saturation():
    """The narrowest range is 125 deg/s."""
    for limit, count in ((124.9, 0), (125.1, 1)):
        rate = with_run(noise(0.1, 400), 50, 3, math.radians(limit))
        assert len(remarks(rate, 1_000_000)) == count


@pytest.mark.thorough
@pytest.mark.parametrize("at", [0, 16_380, 16_383, 16_384, 39_997])
@pytest.mark.parametrize("size", [1000, 16_384, 40_000])
def test_a_run_of_equal_extremes_is_seen_wherever_it_is(at, size):
    """Three in a row are saturation and two are not, also where columns are cut."""
    for count in (2, 3):
        rate = with_run(noise(0.1, 40_000), at, count, -5.0, axis=2)
        said = [one.split(" rad/s")[0] for one in remarks(rate, step_ns=1_000_000, size=size)]
        assert said == ["axis -z stays at its extreme of -5"] * (count - 2)


def test_an_axis_that_freezes_for_long_times_and_short_ones_has_one_remark():
    """It is the one on the longest; an axis that freezes for a short time has its own."""
    rate = noise(0.05)
    for axis, first, count in ((0, 500, 60), (0, 2000, 3000), (1, 9000, 70)):
        rate = with_run(rate, first, count, 0.0123, axis)
    said = remarks(rate)
    assert [one.split(" samples")[0] for one in said] == [
        "axis x stays at 0.0123 rad/s for 3000",
        "axis y stays at 0.0123 rad/s for 70",
    ]


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1000, 20_000])
@pytest.mark.parametrize("first", [0, 1, 60, 9_990, 16_283, 16_333, 16_384, 17_000])
def test_an_axis_that_freezes_is_seen_wherever_it_is(first, size):
    """All three had to, and at once: one axis that stops was integrated as it was, unsaid."""
    for axis, count, value in product(range(3), (99, 100, 3000), (0.0, 0.0123)):
        rate = with_run(noise(0.05), first, count, value, axis)
        said = (
            f"axis {'xyz'[axis]} stays at {value:g} rad/s for {count} samples, "
            f"{duration_text((count - 1) * 10_000_000)} from t = {first * 10_000_000} ns on, while "
            "the others change: frozen?"
        )
        # A shorter one is known by the samples on either side.
        assert remarks(rate, size=size) == [said] * (count > 99 or first >= 60)
    rate = with_run(noise(0.05), first, 20_000, 0.0123, 1)
    count = 20_000 - first
    expected = f"for {count} samples" if first else "never changes, it is 0.0123 rad/s"
    (said,) = remarks(rate, size=size)
    assert expected in said


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1000, 20_000])
@pytest.mark.parametrize("first", [50, 9_999, 16_370, 16_381, 16_384, 16_388, 19_000])
def test_a_rate_that_wraps_around_is_seen_wherever_it_does(first, size):
    """From +2000 to -2000 deg/s in a sample: it was integrated as it was, unsaid."""
    limit = math.radians(2000)
    for axis, sign, slope in product(range(3), (1, -1), (5.0, 60.0)):
        rate, rise = noise(0.03), np.zeros(20_000)
        turn = math.radians(slope) * (np.arange(20_000) - first + 0.5)
        around = np.abs(turn) < 0.9 * limit
        rise[around] = limit + turn[around]
        # Down again as it came, and within the range of the sensor.
        rate[:, axis] += sign * rise
        rate[:, axis] = (rate[:, axis] + limit) % (2 * limit) - limit
        said = [one for one in remarks(rate, size=size) if "goes on" in one]
        assert len(said) == 1, (axis, sign, slope)
        assert said[0].startswith(f"axis {'xyz'[axis]} jumps from {'-' * (sign < 0)}3")
        off_deg = float(re.search(r", ([\d.]+) deg a sample$", said[0])[1])
        assert off_deg == pytest.approx(40, rel=0.03)


@pytest.mark.thorough
@pytest.mark.parametrize("spread", [0.0, 0.002])
@pytest.mark.parametrize("limit_deg_s", [125, 250, 500, 1000, 2000, 4000])
def test_a_rate_that_wraps_around_is_seen_at_any_range(limit_deg_s, spread):
    """16-bit integers end a step below the range; 125 deg/s was taken for no range at all."""
    limit = math.radians(limit_deg_s)
    for axis, is_integer in product(range(3), (False, True)):
        rate = swinging(peak=1.0) * 0.5 * limit + noise(spread * limit)
        rate[:, axis] += 1.1 * limit * np.sin(0.02 * np.arange(len(rate)))
        if is_integer:
            rate = np.rint(rate / limit * 32768) * limit / 32768
        rate[:, axis] = (rate[:, axis] + limit) % (2 * limit) - limit
        said = [one for one in remarks(rate) if "goes on" in one]
        assert len(said) == 1, (axis, is_integer)
        assert said[0].startswith(f"axis {'xyz'[axis]} jumps from ")


@pytest.mark.thorough
@pytest.mark.parametrize("size", [1000, 20_000])
@pytest.mark.parametrize("begin", [0, 500, 9_990, 16_384])
@pytest.mark.parametrize("sensors", [2, 3, 4])
def test_sensors_that_take_turns_without_labels_are_seen(sensors, begin, size):
    """Rates of two that were mounted against each other cancelled out, unsaid."""
    kinds = np.array([[1, 1, 1], [-1, -1, 1], [1, -1, -1], [-1, 1, -1]])[:sensors]
    rate = swinging(peak=2.0)
    turns = np.arange(20_000) % sensors * (np.arange(20_000) >= begin)
    (said,) = [one for one in remarks(rate * kinds[turns], size=size) if "alternate" in one]
    found = int(said.split(" ns")[0].rpartition(" ")[2]) // 10_000_000
    assert abs(found - begin) <= 40
    assert f"those of {sensors} sensors that take turns" in said
    assert not [one for one in remarks(rate, size=size) if "alternate" in one]


def vibrating(frequency, phase, spread, samples=400):
    """Return rates of one axis that vibrates, with as many cycles a sample."""
    rate = np.zeros((samples, 3))
    rate[:, 1] = np.sin(2 * np.pi * frequency * np.arange(samples) + phase)
    return rate + noise(spread, samples)


MIXED = {
    "other biases, at rest": lambda t: (noise(1e-3, len(t)), noise(1e-3, len(t))[::-1] + 0.05),
    "mounted against each other": lambda t: (swinging(len(t)) + 3, -swinging(len(t)) - 3),
    "of two bodies": lambda t: (swinging(len(t)), 0.3 * swinging(len(t))[::-1] + [2, -9, 4]),
}


@pytest.mark.thorough
@pytest.mark.parametrize("what", MIXED)
@pytest.mark.parametrize("share", [0.35, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("begin", [0, 16_384])
def test_sensors_that_are_mixed_without_labels_are_seen(what, share, begin):
    """Only those in strict turn were, and others came out as one body that shakes."""
    one, other = MIXED[what](np.arange(20_000))
    rng = np.random.default_rng(7)
    is_other = np.cumsum(rng.random(20_000) < share) % 2 * (np.arange(20_000) >= begin)
    (said,) = [one for one in remarks(np.where(is_other[:, None], other, one)) if "mixed" in one]
    found = int(re.search(r"near t = (\d+) ns are on two courses", said)[1]) // 10_000_000
    assert 0 <= found - begin <= (20_000 - begin)
    assert float(re.search(r" with (\d+) % of", said.replace("%", " %"))[1]) == pytest.approx(
        100 * share, abs=13
    )
    for single in (one, other):
        assert not [each for each in remarks(single) if "mixed" in each or "alternate" in each]


def test_no_vibration_is_taken_for_two_sensors_that_are_mixed():
    """Of any frequency, and of several at once; nor noise, spikes, zeros or coarse steps."""
    rng = np.random.default_rng(8)
    said = []
    for frequency in np.linspace(0.02, 0.47, 61):
        for spread in (0, 0.02, 0.1):
            said += remarks(vibrating(frequency, rng.uniform(0, 6), spread))
        tones = (vibrating(f, rng.uniform(0, 6), 0.01) for f in rng.uniform(0.02, 0.47, 3))
        said += remarks(sum(tones))
    is_zero = rng.random((2000, 1)) < 0.4
    rest = noise(1.0, 2000)
    for rate in (rest, rest**3, np.rint(rest), np.where(is_zero, 0, swinging(2000) + 3),
                 np.where(is_zero, rest, 0.01 * rest), np.cumsum(rest, axis=0)):  # fmt: skip
        said += remarks(rate)
    assert not [one for one in said if "two courses" in one]


@pytest.mark.parametrize("unit", [250, 500, 2000])
@pytest.mark.parametrize("hz", [50, 100, 400])
@pytest.mark.parametrize("seconds", [0.5, 0.9, 3.0])
def test_a_range_that_is_reached_once_is_said_with_what_it_may_cost(unit, hz, seconds):
    """A stay of 0.9 s at 2000 deg/s was a steady turn, though it has no noise and all else has."""
    limit, count = math.radians(unit), round(seconds * hz)
    motion = np.zeros((20 * hz, 3))
    motion[5 * hz : 5 * hz + count, 2] = 1.3 * limit
    kernel = np.hanning(hz // 2) / np.hanning(hz // 2).sum()
    motion[:, 2] = np.convolve(motion[:, 2], kernel, mode="same")
    rate = np.clip(motion + noise(0.03, len(motion)), -limit, limit)
    said = [one for one in remarks(rate, 1_000_000_000 // hz) if "too low" not in one]
    at = (rate[:, 2] == limit).argmax() * (1_000_000_000 // hz)
    lasted = np.count_nonzero(rate[:, 2] == limit) / hz
    if lasted * hz < 20:
        return
    (one,) = said
    assert one.startswith(
        f"axis +z stays at its extreme of {limit:.6g} rad/s for 3 samples or more"
    )
    assert f", first at t = {at} ns, " in one
    found = re.search(r", ([\d.]+) s in all, where 1 % more would add ([\d.]+) deg: ", one)
    assert [float(found[k]) for k in (1, 2)] == pytest.approx([lasted, lasted * unit / 100], 0.01)
