"""Samples that share timestamps in packets: recognised, what they cost, and spread by a clock."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.commands import refused, run
from make.motion import rotor

from quatprop import GyroSeries
from quatprop.base.errors import TimelineError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.timeline.counts import OBSERVE, Policy, remarks
from quatprop.timeline.packets import UNSTEADY
from quatprop.timeline.policies import Timeline

MS = 1_000_000
FIRST = 1_700_000_000_000_000_000
OTHERS = np.random.default_rng(7)


def tumbling(count, hz):
    """Return times and rates of a tumbling body."""
    t_ns = np.rint(np.arange(count) * 1e9 / hz).astype(np.int64)
    return FIRST + t_ns, rotor(t_ns * 1e-9)[1]


def at(t_ns, sizes, *, is_first=False):
    """Return stamps of packets of given sizes, those of their last samples or their first."""
    ends = np.cumsum(sizes)
    ends = np.append(ends[ends < len(t_ns)], len(t_ns))
    begins = np.append(0, ends[:-1])
    return np.repeat(t_ns[begins if is_first else ends - 1], ends - begins)


def spread(stamps, rate):
    """Return the times by the clock, and what is counted."""
    timeline = Timeline(Policy(regular_time=True), "log.csv")
    used = list(timeline.apply([GyroSeries(stamps, rate)]))
    return np.concatenate([batch.t_ns for batch in used]), timeline.counts


def said_of(stamps, rate):
    """Return the remarks on stamps that are not changed, and what is counted."""
    timeline = Timeline(OBSERVE, "log.csv", "time_col")
    list(timeline.apply([GyroSeries(stamps, rate)]))
    return {one.code: str(one) for one in remarks(timeline.counts, OBSERVE, "time_col")}, (
        timeline.counts
    )


@given(
    size=st.integers(2, 200),
    begun=st.integers(0, 199),
    hz=st.sampled_from([50.0, 104.0, 200.0, 833.0]),
    is_first=st.booleans(),
)
def test_packets_of_one_size_are_spread_exactly(size, begun, hz, is_first):
    """From 2 samples to 200, also if the log begins within one; a constant is not known."""
    t_ns, rate = tumbling(size * 12 + 5, hz)
    sizes = [size - begun % size, *[size] * 13]
    times, counts = spread(at(t_ns, sizes, is_first=is_first), rate)
    assert np.ptp(times - t_ns) <= 3
    assert counts.steady_clock.packet == size
    assert counts.steady_clock.rate_hz == pytest.approx(hz, rel=1e-6)


@given(
    seed=st.integers(0, 999),
    low=st.integers(1, 3),
    more=st.integers(1, 20),
    delay=st.sampled_from([0.0, 0.1, 0.5]),
)
def test_packets_of_many_sizes_are_spread(seed, low, more, delay):
    """They come late by up to half of the usual interval between them."""
    random = np.random.default_rng(seed)
    t_ns, rate = tumbling(3000, 100.0)
    sizes = random.integers(low, low + more + 1, 3000)
    late = np.repeat(random.random(3000) * delay * (low + more / 2) * 10 * MS, sizes)[:3000]
    stamps = np.maximum.accumulate(at(t_ns, sizes) + late.astype(np.int64))
    times, counts = spread(stamps, rate)
    assert np.ptp(times - t_ns) < 10 * MS + 0.2 * late.max()
    assert counts.steady_clock.rate_hz == pytest.approx(100, rel=2e-3)


@pytest.mark.parametrize("tick_ms", [48, 100, 1000])
@pytest.mark.parametrize("hz", [104.0, 128.0, 400.0])
def test_rounded_stamps_of_several_samples_are_spread(hz, tick_ms):
    """None is missing, though some ticks have a sample less."""
    t_ns, rate = tumbling(12_000 if tick_ms == 1000 else 3000, hz)
    times, counts = spread(t_ns // (tick_ms * MS) * (tick_ms * MS), rate)
    assert counts.steady_clock.missing_ticks == 0
    assert np.ptp(times - t_ns) < 1.2e9 / hz


@pytest.mark.parametrize("tick_ms", [50, 100, 500, 1000, 2000])
@pytest.mark.parametrize("hz", [100.0, 104.0, 200.0, 400.0])
@pytest.mark.parametrize("begun_ms", [0, 333])
def test_times_of_stamps_rounded_down_are_not_early(hz, tick_ms, begun_ms):
    """All times were early by a tick: 88 deg, of stamps in whole seconds."""
    t_ns, rate = tumbling(int(hz * 40), hz)
    t_ns = t_ns + begun_ms * MS
    times, counts = spread(t_ns // (tick_ms * MS) * (tick_ms * MS), rate)
    assert np.abs(times - t_ns).max() <= 1.5e9 / hz
    assert counts.steady_clock.packet >= hz * tick_ms / 1000


@given(
    size=st.integers(12, 60),
    apart_us=st.sampled_from([1, 30, 200]),
    seed=st.integers(0, 99),
    hz=st.sampled_from([100.0, 200.0, 833.0]),
)
def test_samples_stamped_while_they_are_unpacked_are_spread(size, apart_us, seed, hz):
    """They were gaps, in "799 intervals longer than 400 us", and --regular-time was refused."""
    t_ns, rate = tumbling(size * 40, hz)
    number = np.arange(len(t_ns)) % size
    apart_ns = min(apart_us * 1000, int(1e8 / hz))
    late = np.random.default_rng(seed).random(40).repeat(size) * 1e8 / hz
    stamps = at(t_ns, [size] * 40) + number * apart_ns + late.astype(np.int64)
    times, counts = spread(stamps, rate)
    assert np.abs(times - t_ns).max() < 2e8 / hz
    assert counts.steady_clock.packet == size
    said, _ = said_of(stamps, rate)
    true, found = (attitudes(each, rate) for each in (t_ns, stamps))
    if np.degrees(geodesic_angle(found, true)[size - 1 :: size].max()) > 0.1:
        assert said["packets"].startswith(f"up to {size} samples are stamped at about one time, of")
        assert "--regular-time" in said["packets"] or "regular_time" in said["packets"]


def test_times_of_arrival_of_no_known_clock_have_a_way_out():
    """They were gaps of 10 ns: 39.7 deg."""
    random = np.random.default_rng(94)
    t_ns, rate = tumbling(4000, 100.0)
    delay = random.exponential(20 * MS, 4000) + (random.random(4000) < 0.02) * 150 * MS
    stamps = np.maximum.accumulate(t_ns + delay.astype(np.int64)) + np.arange(4000)
    # Slow rotation in much noise does not show which times are those of the samples.
    said, counts = said_of(stamps, 1e-3 * rate + random.normal(size=rate.shape))
    assert counts.steady_clock is None
    assert "; the samples come in bursts: if they were taken one after another" in said["gaps"]
    assert ", or count rows at a steady rate with " in said["gaps"]


@pytest.mark.parametrize("still", [False, True])
def test_a_sensor_that_samples_in_bursts_is_not_spread(still):
    """Its rates follow its timestamps; bursts of longer than a moment are no packets."""
    for apart_ns, size, between_ns in ((500_000, 10, 100 * MS), (10 * MS, 100, 60_000 * MS)):
        number = np.arange(4000)
        stamps = FIRST + number // size * between_ns + number % size * apart_ns
        rate = rotor((stamps - FIRST) * 1e-9)[1]
        if still:
            rate = 1e-3 * OTHERS.normal(size=rate.shape)
            said, _ = said_of(stamps, rate)
            assert "packets" not in said
            continue
        with pytest.raises(TimelineError):
            spread(stamps, rate)


def test_packets_that_end_at_round_times_of_their_own_clock_do_so():
    """A clock that begins with the first sample has a whole packet before its first stamp."""
    t_ns, rate = tumbling(4000, 100.0)
    t_ns = t_ns - FIRST + 10 * MS
    times, _ = spread(at(t_ns, [10] * 400), rate)
    assert np.abs(times - t_ns).max() <= 2


@pytest.mark.parametrize("size", [3, 10, 40])
def test_a_packet_that_is_lost_stays_a_gap(size):
    """Its samples are missing, and those after it are not moved."""
    t_ns, rate = tumbling(size * 40, 100.0)
    stamps = at(t_ns, [size] * 40)
    kept = np.delete(
        np.arange(size * 40), [*range(size * 7, size * 8), *range(size * 30, size * 32)]
    )
    times, counts = spread(stamps[kept], rate[kept])
    assert counts.steady_clock.missing_ticks == 3 * size
    assert np.ptp(times - t_ns[kept]) <= 2


@pytest.mark.parametrize("size", [2, 10, 60])
def test_what_packets_cost_is_what_the_attitudes_are_off(size):
    """It was not said: 12 deg after a minute of packets of ten."""
    t_ns, rate = tumbling(6000, 100.0)
    stamps = at(t_ns, [size] * 3000)
    said, counts = said_of(stamps, rate)
    true, found = (attitudes(each, rate) for each in (t_ns, stamps))
    last = np.arange(size - 1, 6000, size)
    off = np.sqrt(np.mean(geodesic_angle(found, true)[last] ** 2))
    assert counts.steady_clock.error_rad == pytest.approx(off, rel=0.02)
    assert f"up to {size} samples share a timestamp" in said["packets"]
    assert f"the attitude error is {np.degrees(off):.2g} deg RMS" in said["packets"]


def test_packets_at_no_steady_rate_have_their_cost_and_a_way_out():
    """The samples of each are spread over the time since the one before, for the estimate alone."""
    random = np.random.default_rng(5)
    t_ns = FIRST + np.cumsum(random.exponential(10 * MS, 3000)).astype(np.int64)
    rate = rotor((t_ns - FIRST) * 1e-9)[1]
    stamps = at(t_ns, random.integers(1, 20, 3000))
    said, counts = said_of(stamps, rate)
    assert counts.steady_clock is None
    true, found = (attitudes(each, rate) for each in (t_ns, stamps))
    off = np.sqrt(np.mean(geodesic_angle(found, true) ** 2))
    assert counts.packet_error_rad == pytest.approx(off, rel=0.3)
    assert "the attitude error is about " in said["repeated-stamps"]
    assert ", or count rows at a steady rate with " in said["repeated-stamps"]
    with pytest.raises(TimelineError, match=UNSTEADY):
        spread(stamps, rate)


def test_copies_of_samples_cost_nothing():
    """A sample that is recorded twice is no packet of two."""
    t_ns, rate = tumbling(1000, 100.0)
    said, _ = said_of(np.repeat(t_ns, 2), np.repeat(rate, 2, axis=0))
    assert "packets" not in said
    assert "deg" not in said["repeated-stamps"]


def test_a_clock_that_begins_at_zero_is_that_of_first_samples():
    """No time before it is made up."""
    t_ns, rate = tumbling(400, 100.0)
    times, _ = spread(at(t_ns - FIRST, [5] * 80, is_first=True), rate)
    assert times[0] == 0


@pytest.mark.parametrize("kind", ["csv", "float32", "float64", "int32", "parquet"])
def test_a_clock_that_stands_still_is_refused(tmp_path, kind):
    """It gave the identity, with exit code 0; the way out that is named gives the attitudes."""
    count = 100
    rate = OTHERS.normal(size=(count, 3))
    if kind in {"csv", "parquet"}:
        import pandas as pd

        path = tmp_path / f"log.{kind}"
        table = pd.DataFrame(
            {"time": 1.73234e9, **dict(zip(("gx", "gy", "gz"), rate.T, strict=True))}
        )
        (table.to_parquet if kind == "parquet" else table.to_csv)(path, index=False)
    else:
        path = tmp_path / "log.npz"
        np.savez(path, gyro=rate, time=np.full(count, 1.7e9).astype(kind))
    words = "propagate", path, "-o", tmp_path / "out.csv", "--rate-unit", "rad/s"
    said = refused(*words, "--time-unit", "s")
    assert f"all {count} timestamps are " in said
    assert said.endswith("or count rows at a steady rate with --sample-rate HZ")
    assert not (tmp_path / "out.csv").exists()
    run(*words, "--sample-rate", "100", code=0)
