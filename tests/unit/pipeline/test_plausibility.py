"""What looks wrong is said; what is right is not."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from quatprop.containers import topic_table
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import exp, rotate
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.pipeline.plausibility import against_orientation, log_remarks, orientation_remarks
from quatprop.pipeline.rate_checks import RateChecks
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings.selection import RateSelection
from quatprop.simulate.gyroscope import Gyroscope
from quatprop.simulate.motion import Shape
from quatprop.simulate.simulate import simulate
from quatprop.text import in_python
from quatprop.timeline.counts import Counts

MS = 1_000_000


def watched(rate, dt_ms=10, size=10_000):
    """Return the remarks on rates that came in batches of a size."""
    rate = np.asarray(rate, dtype=np.float64)
    t_ns = np.arange(len(rate)) * dt_ms * MS
    watch = RateChecks()
    batches = [
        GyroSeries(t_ns[k : k + size], rate[k : k + size]) for k in range(0, len(rate), size)
    ]
    passed = GyroSeries.joined(list(watch.observe(batches)))
    assert (passed.t_ns == t_ns).all()
    assert np.array_equal(passed.rate, rate, equal_nan=True)
    last_ns = int(t_ns[-1])
    counts = Counts(used=len(t_ns), first_ns=0, last_ns=last_ns, median_dt_ns=dt_ms * MS)
    return list(map(str, watch.remarks(counts)))


def moving(samples=1000, scale=1.0):
    """Return rates that nothing is wrong with."""
    t = np.arange(samples)[:, None] * 0.01
    return scale * np.sin(t * [1.0, 1.3, 1.7]) + 1e-3 * np.random.default_rng(1).normal(
        size=(samples, 3)
    )


def test_nothing_is_said_of_good_rates():
    """Rates of a moving body pass without remark."""
    assert watched(moving()) == []


def test_rates_beyond_any_gyroscope():
    """131 to 133 rad/s, always the same, is no rotation rate that is measured."""
    said, frozen = watched(np.tile([131.0, 132.0, 133.0], (200, 1)))
    assert frozen == "every rate is the same, [131.0, 132.0, 133.0] rad/s: frozen, or simulated?"
    assert in_python(said) == (
        "rates up to 133 rad/s are beyond any gyroscope; if they are in deg/s, "
        "use rate_unit='deg/s'"
    )


def test_rates_that_are_all_zero():
    """A topic that never turns is remarked on."""
    assert watched(np.zeros((5, 3))) == ["every rate is zero: is this the right topic?"]


@pytest.mark.parametrize("at", [0, 16_380, 16_383, 16_384, 39_997])
@pytest.mark.parametrize("size", [1000, 16_384, 40_000])
@pytest.mark.parametrize("run", [2, 3])
def test_a_run_of_equal_extremes_is_seen_wherever_it_is(at, size, run):
    """Three in a row are saturation and two are not, also where columns are cut."""
    rate = np.random.default_rng(3).normal(0, 0.1, (40_000, 3))
    rate[at : at + run, 2] = -5.0
    remarks = watched(rate, dt_ms=1, size=size)
    assert len(remarks) == (run == 3)
    assert all(remark.startswith("axis -z stays at its extreme of -5 ") for remark in remarks)


def test_a_larger_extreme_ends_saturation():
    """What three samples stayed at was not the sensor's range if another one lies beyond."""
    rate = np.random.default_rng(3).normal(0, 0.1, (40_000, 3))
    rate[100:110, 0] = 3.0
    assert len(watched(rate, dt_ms=1)) == 1
    rate[30_000, 0] = 3.1
    assert watched(rate, dt_ms=1) == []


def test_rates_that_are_not_finite_are_not_judged():
    """Missing rates do not hide what is wrong with the others."""
    rate = moving()
    rate[::7] = np.nan
    assert watched(rate) == []
    rate[400:403, 1] = 5.0
    assert len(watched(rate)) == 1


@pytest.mark.parametrize("size", [1, 2, 7, 10_000])
def test_saturation(size):
    """Three equal extremes in a row are saturation, wherever batches end; the side is named."""
    rate = np.clip(moving(scale=8.0), -np.inf, [np.inf, math.radians(250), np.inf])
    (said,) = watched(rate, size=size)
    assert said == (
        "axis +y stays at its extreme of 4.36332 rad/s for 3 samples or more: saturated, so "
        "larger rates are missing"
    )


def test_a_quantised_sensor_at_rest_is_not_saturated():
    """One step of a coarse sensor repeats, but it is far inside any range."""
    rate = np.random.default_rng(1).integers(-1, 2, (1000, 3)) * 0.01
    assert watched(rate) == []


def test_an_axis_that_turns_steadily_is_not_saturated():
    """A free body may turn about one axis at a constant rate for ever."""
    rate = moving(scale=3.0)
    rate[:, 2] = 4.0
    assert watched(rate) == []


def test_sampling_too_slow():
    """45 degrees between two samples is too far."""
    (said,) = watched([[0, 0, math.pi / 4], [0, 0, 0], [0, 0, 0.1]], dt_ms=1000)
    assert said == (
        "the body rotates by up to 45 deg between two samples: the sample rate is too low for this "
        "motion"
    )


TOO_SMALL = (
    "the log's own orientation rotates 57.3 times as far as its rates: "
    "were they scaled by pi/180 once too often?"
)
TOO_LARGE = "own orientation: if they are in deg/s, use rate_unit='deg/s'"


@pytest.mark.parametrize(
    ("scale", "sentence"),
    [(1.0, None), (1.2, None), (math.pi / 180, TOO_SMALL), (180 / math.pi, TOO_LARGE)],
)
def test_rates_against_the_log_s_own_orientation(scale, sentence):
    """A factor of pi/180 shows against the orientation; a scale error of a fifth does not."""
    t_ns = np.arange(1000) * 10 * MS
    rate = np.tile([0.01, 0.02, 0.03], (1000, 1))
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate))
    said = against_orientation([GyroSeries(t_ns, rate * scale)], [own])
    assert said is None if sentence is None else sentence in in_python(said)


def test_an_orientation_that_does_not_move_tells_nothing():
    """At rest there is nothing to compare, and a log without common stamps neither."""
    t_ns = np.arange(1000) * 10 * MS
    still = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (1000, 1)))
    noise = GyroSeries(t_ns, np.full((1000, 3), 1e-6))
    assert against_orientation([noise], [still]) is None
    assert against_orientation([GyroSeries(t_ns + 1, noise.rate)], [still]) is None
    assert against_orientation([], []) is None


def test_rates_are_compared_in_the_axes_in_which_they_are_resolved():
    """Turns by x, y and -x, and back, in every second: of body rates they undo one another.

    The orientation to which they lead in reference axes was said to rotate endlessly faster.
    """
    x, y = 2 * np.eye(3)[:2]
    rate = np.tile(4 * np.array([x, y, -x, rotate(exp(x), -y)]), (40, 1))
    t_ns = np.arange(len(rate)) * 250 * MS
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate, rates="inertial"))
    gyro = GyroSeries(t_ns, rate)
    assert "times as far as its rates" in str(against_orientation([gyro], [own], "body"))
    assert against_orientation([gyro], [own], "inertial") is None


def test_an_orientation_that_was_never_filled_tells_nothing_of_a_body_that_turns():
    """Drivers without an estimate leave the identity; the rates are not wrong for it."""
    t_ns = np.arange(1000) * 10 * MS
    still = AttitudeSeries(t_ns, np.tile([1.0, 0, 0, 0], (1000, 1)))
    assert against_orientation([GyroSeries(t_ns, np.full((1000, 3), 0.5))], [still]) is None


def test_motion_that_agrees_is_enough():
    """Where the first samples agree with the orientation, no more of the log is read."""
    t_ns = np.arange(20_000) * 10 * MS
    rate = np.tile([0.01, 0.02, 0.03], (20_000, 1))
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate))
    read = []

    def batches(series):
        for start in range(0, 20_000, 1000):
            read.append(start)
            yield series[start : start + 1000]

    assert against_orientation(batches(GyroSeries(t_ns, rate)), batches(own)) is None
    assert len(read) == 4


def test_a_unit_shows_after_a_rest():
    """A log that begins at rest is read on until it has moved."""
    t_ns = np.arange(6000) * 10 * MS
    rate = np.tile([0.01, 0.02, 0.03], (6000, 1))
    rate[:4000] = 0
    own = AttitudeSeries(t_ns, attitudes(t_ns, rate))
    said = against_orientation([GyroSeries(t_ns, rate * 180 / math.pi)], [own[:3000], own[3000:]])
    assert TOO_LARGE in in_python(said)


def test_the_beginning_of_a_log_is_read_once(tmp_path, monkeypatch):
    """Stamps and orientation are checked in what was read for the choice of the clock."""
    path = tmp_path / "imu.mcap"
    simulate(path, "tumbling", Shape(), Gyroscope(200, 3000), truth=None)
    with open_log(path) as log:
        called = []
        monkeypatch.setattr(log, "blocks", lambda c, f=log.blocks: called.append(c) or f(c))
        decoders, made = [], topic_table.decoder_of
        monkeypatch.setattr(
            topic_table, "decoder_of", lambda *args: decoders.append(args[1]) or made(*args)
        )
        source = choose_rates(log, RateSelection())
        assert log_remarks(log, source) == []
        assert len(decoders) == 1
        assert sum(map(len, source.batches())) == 3000
        assert [channel.topic for channel in called] == ["/imu"]


def test_only_the_beginning_is_searched_for_an_orientation(monkeypatch):
    """Where no message has an orientation, the log is not read to its end to find that out."""
    read = []

    def rows():
        for start in range(0, 10**6, 1000):
            read.append(start)
            yield np.arange(start, start + 1000), np.full((1000, 4), np.nan)

    absent = SimpleNamespace(first=rows)
    monkeypatch.setattr("quatprop.pipeline.plausibility.choose_attitudes", lambda *_: absent)
    rates = GyroSeries(np.arange(10), np.ones((10, 3)))
    source = SimpleNamespace(name="/imu", matches=(), batches=lambda **_: iter([rates]))
    assert orientation_remarks(SimpleNamespace(path="log.bag"), source) == []
    assert len(read) == 2
