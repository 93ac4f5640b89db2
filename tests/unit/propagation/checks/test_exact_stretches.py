"""Stretches that the samples before predict exactly, in logs of which the rest is not."""

import re
from itertools import product

import numpy as np
import pytest
from fuzz.remarks import well_log

from quatprop.propagation.checks.exact_stretches import ExactStretches, stretch_remarks
from quatprop.propagation.checks.samples import Samples

COUNT = 20_000
T_S = np.arange(COUNT) / 100
SMOOTH = 2 * np.sin(T_S[:, None] * [1.9, 2.3, 1.3] + [0, 1, 2])
"""Rates of a motion without noise, rad/s."""


def noise(scale, seed=1):
    """Return white noise."""
    return np.random.default_rng(seed).normal(0, scale, (COUNT, 3))


def said(rate, size=16_384):
    """Return the remarks on rates, which come in blocks of a size."""
    found, t_ns = ExactStretches(), np.arange(len(rate)) * 10_000_000
    for begin in range(0, len(rate), size):
        part = slice(begin, begin + size)
        found.add(Samples(np.ascontiguousarray(rate[part].T), t_ns[part]))
    remarks = stretch_remarks(found.findings(), len(rate), ("rad/s", 1.0))
    return [str(one) for one in remarks]


def rounded(rate, step):
    """Return rates in steps."""
    return np.rint(rate / step) * step if step else rate


NOISY = {
    "without steps": rounded(SMOOTH + noise(0.01), 0),
    "in small steps": rounded(SMOOTH + noise(0.01), 1e-3),
    "in steps of half its size": rounded(SMOOTH + noise(0.01), 5e-3),
    "at rest": rounded(noise(0.01), 1e-3),
    "in single precision": (SMOOTH + noise(0.01)).astype(np.float32).astype(np.float64),
}
BORDERS = [300, 9_000, 16_384 - 60, 16_384 - 20, 16_384, 16_384 + 30, COUNT - 150]


@pytest.mark.parametrize("data", NOISY)
@pytest.mark.parametrize("count", [25, 79, 95])
def test_an_axis_that_freezes_for_a_short_time_is_seen(data, count):
    """Only 100 samples and more were; its rate is no extreme of those beside."""
    for begin, axis in product(BORDERS, range(3)):
        rate = NOISY[data].copy()
        near = rate[begin - 64 : begin + count + 64, axis]
        rate[begin : begin + count, axis] = near[np.argsort(near)[len(near) // 2]]
        (one,) = said(rate)
        begun = re.fullmatch(
            rf"axis {'xyz'[axis]} stays at .* rad/s for (\d+) samples, .* from t = (\d+) ns on, "
            "while the others change: frozen\\?",
            one,
        )
        assert begun, (begin, axis, one)
        # A sample beside may have the same rate, in steps.
        assert count <= int(begun[1]) <= count + 3, (begin, axis)
        assert begin - 3 <= int(begun[2]) / 1e7 <= begin, (begin, axis)


@pytest.mark.parametrize("begin", BORDERS)
@pytest.mark.parametrize("count", [12, 30, 90])
@pytest.mark.parametrize("is_zero", [False, True])
def test_an_axis_of_a_motion_without_noise_that_is_held_or_zero_is_seen(begin, count, is_zero):
    """Its rate jumps where it goes on."""
    for axis in range(3):
        rate = SMOOTH.copy()
        # Where it changes quickly.
        at = begin + int(np.abs(np.diff(rate[begin : begin + 100, axis])).argmax()) - count // 2
        at = max(at, 70)
        if is_zero:
            at = begin + int(np.abs(rate[begin : begin + 100, axis]).argmax()) - count // 2
        at = min(at, COUNT - count - 70)
        rate[at : at + count, axis] = 0 if is_zero else rate[at, axis]
        if is_zero or count * np.abs(np.diff(SMOOTH[at : at + count, axis])).mean() > 0.5:
            assert len(said(rate)) == 1, (axis, at)


@pytest.mark.parametrize("begin", BORDERS)
@pytest.mark.parametrize("data", [*NOISY, "without noise"])
@pytest.mark.parametrize("count", [25, 100, 2000])
def test_rows_that_were_filled_in_on_straight_lines_are_seen(data, begin, count):
    """As pandas does it; the gap was not to be seen."""
    rate = NOISY.get(data, SMOOTH).copy()
    count = min(count, COUNT - begin - 70)
    end = begin + count
    for axis in range(3):
        rate[begin:end, axis] = np.interp(
            np.arange(begin, end), [begin - 1, end], rate[[begin - 1, end], axis]
        )
    if "steps" in data:
        step = 5e-3 if "half" in data else 1e-3
        if np.abs(rate[end] - rate[begin - 1]).max() < 12 * step:
            return
        for values in (rate, rounded(rate, step)):
            (one,) = said(values)
            assert one.startswith("all three rates are on straight lines for ")
        return
    (one,) = said(rate)
    found = re.match(
        r"all three rates are on straight lines for (\d+) samples, .* from t = (\d+) ns on, unlike "
        "before and after: were rows filled in across a gap",
        one,
    )
    assert count <= int(found[1]) <= count + 2
    assert begin - 1 <= int(found[2]) / 1e7 <= begin


@pytest.mark.parametrize("data", [one for one in NOISY if one != "at rest"])
@pytest.mark.parametrize("count", [10, 50, 500, None])
def test_rows_of_a_body_that_turns_are_not_repeated(data, count):
    """As a logger does that repeats the last row; without a jump, noise is missing."""
    for begin in BORDERS:
        rate = NOISY[data] * [1, 3, 1]
        rate[begin:][:count] = rate[begin - 1]
        end = begin + (count or COUNT)
        is_judged = count is not None or 16_000 < begin < COUNT - 100
        _, middle, largest = np.sort(np.abs(rate[begin]))
        is_turning = 0.1 < middle < 0.95 * largest
        if not (is_judged and is_turning) or COUNT - 64 < end < COUNT:
            continue
        (one,) = said(rate)
        assert one.startswith("all three rates stay the same for "), begin
        assert one.endswith("did the sensor drop out?"), begin


def test_several_stretches_are_counted():
    """The longest is shown."""
    rate = NOISY["without steps"].copy()
    for begin, count in ((1000, 30), (5000, 60), (17_000, 40)):
        rate[begin : begin + count, 1] = np.sort(rate[begin : begin + count, 1])[count // 2]
    (one,) = said(rate)
    assert "for 60 samples, 590 ms from t = 50000000000 ns on (the longest of 3 times)" in one


def trapezoids(step=0.0, spread=0.0):
    """Return rates of a turntable: at rest, in steady rotation, and on straight lines between."""
    at = np.cumsum(np.random.default_rng(4).integers(20, 400, 100))
    levels = np.random.default_rng(5).choice([0, 0, 1, -2, 0.5], 100)
    one = np.interp(np.arange(COUNT), at, levels)
    return rounded(one[:, None] * [0.2, -0.5, 1] + noise(spread), step)


def softened(rate, width=40):
    """Return rates whose changes have limited acceleration."""
    box = np.ones(width) / width
    return np.stack([np.convolve(axis, box, "same") for axis in rate.T], axis=1)


HEALTHY = {
    "a motion without noise": SMOOTH,
    "a vibration that stops": SMOOTH * [0, 0, 1] * 0.01 + rounded(
        noise(0.2) * (np.arange(COUNT)[:, None] // 1000 % 2), 0.05),
    "a steady rotation in coarse steps": rounded(
        [0, 0.02, 3] + noise(0.2) * (np.arange(COUNT)[:, None] // 1000 % 2), 0.05),
    "steps as large as the noise": rounded(SMOOTH + noise(0.01), 0.01),
    "steps that are larger": rounded(SMOOTH + noise(0.01), 0.05),
    "rest in coarse steps": rounded(noise(0.01), 0.02),
    "a motion in coarse steps": rounded(0.1 * SMOOTH, 0.02),
    "turntable": trapezoids(),
    "turntable in steps": trapezoids(1e-3),
    "turntable with noise": trapezoids(1e-3, 2e-3),
    "turntable of limited acceleration": softened(trapezoids()),
    "rest between motions": softened(trapezoids(), 200) * [1, 0, 0] + rounded(noise(0.01), 0.03),
    "small rates set to zero": np.where(np.abs(SMOOTH + noise(0.01)) < 0.03, 0, SMOOTH),
    "clipped": np.clip(SMOOTH + noise(0.01), -1.8, 1.8),
    "every fourth sample is new": np.repeat(SMOOTH[::4] + noise(0.01)[::4], 4, axis=0),
    "resampled on straight lines": np.stack(
        [np.interp(np.arange(COUNT), np.arange(0, COUNT, 4), axis[::4])
         for axis in (SMOOTH + noise(0.01)).T], axis=1
    ),
    "two axes without a signal": SMOOTH * [0, 0, 1] + noise(0.01) * [0, 0, 1],
    "a ramp about one axis": (SMOOTH + noise(0.01)) * [0, 0, 1] * (np.abs(T_S - 99) > 5)[:, None]
    + np.clip(94 - T_S, -10, 0)[:, None] * [0, 0, 0.1] * (np.abs(T_S - 99) <= 5)[:, None],
    "damaged": np.where(np.random.default_rng(2).random((COUNT, 3)) < 0.1, np.nan, SMOOTH),
    "infinite": np.where(np.random.default_rng(2).random((COUNT, 3)) < 0.1, np.inf, SMOOTH),
}  # fmt: skip


@pytest.mark.parametrize("what", HEALTHY)
def test_healthy_rates_have_no_such_stretch(what):
    """Quantised sensors at rest, and motions that are made of straight lines."""
    for size in (16_384, 1000):
        assert said(HEALTHY[what], size) == []


@pytest.mark.parametrize("band", [0.05, 0.06, 0.08])
@pytest.mark.parametrize("peak", [0.1, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("spread", [0.004, 0.006, 0.01])
def test_rates_that_a_driver_sets_to_zero_where_they_are_small_are_not_frozen(band, peak, spread):
    """They jump to zero and back whenever the axis turns the other way."""
    rate = rounded(peak * SMOOTH + noise(spread), 5e-3)
    assert said(np.where(np.abs(rate) < band, 0, rate)) == []


def test_no_healthy_log_of_many_kinds_has_one():
    """Motions, rates, steps and noise at random."""
    assert not [how for seed in range(300) for log, how in [well_log(seed)] if said(log.rate)]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 20, 70])
def test_short_logs_have_no_stretch(count):
    """Nothing is beside it."""
    assert said(SMOOTH[:count] * 0) == said(SMOOTH[:count]) == []
