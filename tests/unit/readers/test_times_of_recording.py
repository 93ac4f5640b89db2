"""Timestamps that contradict the times of recording, where these are steady."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest
from make.ros import imu_messages, write_messages

from quatprop import RemarkWarning, propagate, read_rates
from quatprop.readers.clock_difference import against_recorded, unlike_speed

T0, MS = 1_700_000_000_000_000_000, 10**6
COUNT = 1200
STEADY = T0 + np.arange(COUNT) * 10 * MS
RNG = np.random.default_rng(5)
RATE = np.sin(np.arange(COUNT)[:, None] / 30 + np.arange(3))
CONTRADICTING = {
    "fast": (STEADY - T0) * 6 // 5 + T0,
    "slow": (STEADY - T0) // 2 + T0,
    "off by 2 %": (STEADY - T0) * 51 // 50 + T0,
    "since start": (STEADY - T0) * 51 // 50,
    "jittering": STEADY + RNG.integers(-4 * MS, 4 * MS, COUNT),
    "in disorder": STEADY + RNG.integers(-30 * MS, 30 * MS, COUNT),
    "packets of 2": STEADY[np.arange(COUNT) // 2 * 2],
    "packets of 50": STEADY[np.arange(COUNT) // 50 * 50],
}
SENTENCES = {
    "fast": (
        "the header timestamps of topic '/imu' go 1.2 times as fast as its log times: that is "
        "right in a simulation, if a log was played at another speed, or if the recorder was "
        "behind at first; if not, use clock='log'"
    ),
    "packets of 2": (
        "many samples share the header timestamps of topic '/imu', while its log times are "
        "steady, about 10 ms apart; if they are those of packets, use clock='log'"
    ),
}


def said(read, path, **options):
    """Return the remarks of a reader on two clocks."""
    with pytest.warns() as caught:
        read(path, **options)
    codes = {"shared-stamps", "unlike-log-times", "clocks-differ"}
    remarks = [one.message for one in caught if isinstance(one.message, RemarkWarning)]
    return [str(one).removeprefix(f"{path}: ") for one in remarks if one.code in codes]


@pytest.mark.thorough
@pytest.mark.parametrize("name", CONTRADICTING)
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
@pytest.mark.filterwarnings("always::quatprop.QuatpropWarning")
def test_header_timestamps_that_contradict_steady_log_times_are_remarked_on(tmp_path, name, suffix):
    """Rates were integrated over wrong intervals; the log times are those of the samples."""
    messages = imu_messages(CONTRADICTING[name], RATE, recorded=STEADY)
    path = write_messages(tmp_path / f"log.{suffix}", messages)
    (remark,) = said(read_rates, path)
    assert remark.endswith("use clock='log'")
    assert remark == SENTENCES.get(name, remark)
    (way_out,) = re.findall(r"clock='(\w+)'", remark)
    assert read_rates(path, clock=way_out).t_ns.tolist() == STEADY.tolist()


@pytest.mark.parametrize("name", ["fast", "in disorder", "packets of 50"])
@pytest.mark.filterwarnings("always::quatprop.QuatpropWarning")
def test_times_in_a_table_that_contradict_those_of_arrival_are_remarked_on(tmp_path, name):
    """By the same rules; a difference of more than a second was said already."""
    columns = {"sensor_time (ns)": CONTRADICTING[name][:300], "received_at (ns)": STEADY[:300]}
    rates = {f"gyro_{axis}_dps": RATE[:300, k] for k, axis in enumerate("xyz")}
    path = tmp_path / "log.csv"
    pd.DataFrame(columns | rates).to_csv(path, index=False)
    (remark,) = said(read_rates, path)
    assert remark.startswith(("the ", "many samples share the times in 'sensor_time (ns)', while "))
    (way_out,) = re.findall(r"use time_col='(.+)'$", remark)
    assert read_rates(path, time_col=way_out).t_ns.tolist() == STEADY[:300].tolist()


@pytest.mark.parametrize("size", [5, 10, 20, 50])
@pytest.mark.filterwarnings("always::quatprop.QuatpropWarning")
def test_log_times_in_bursts_are_not_steady(tmp_path, size):
    """Packets are unpacked within 30 us a sample: --clock log was named and changed nothing."""
    number = np.arange(COUNT)
    ends = STEADY[number // size * size + size - 1]
    messages = imu_messages(ends, RATE, recorded=ends + MS + number % size * 30_000)
    assert said(propagate, write_messages(tmp_path / "log.mcap", messages)) == []


def delayed(rng):
    """Return times of samples, ns, and those at which a healthy recorder got them."""
    interval, count = rng.choice([0.5, 1, 2.5, 5, 10, 20, 100]), int(rng.choice([30, 200, 1000]))
    drift = 1 + rng.uniform(-1, 1) * rng.choice([0, 1e-5, 1e-4, 1e-3])
    sampled = (np.arange(count) + rng.choice([0, 0.01, 0.1, 0.3]) * rng.random(count)) * interval
    if rng.random() < 0.3:  # a sensor that is read at uneven times
        sampled = np.cumsum(rng.uniform(0.5, 1.5, count)) * interval
    if rng.random() < 0.3:  # lost samples
        sampled = sampled[np.sort(rng.choice(count, count * 9 // 10, replace=False))]
    delay = rng.choice([0.001, 0.05, 0.5, 3, 30]) * rng.gamma(rng.choice([0.5, 2, 20]), size=1)
    delay = delay * rng.gamma(2, size=len(sampled)) * rng.choice([0.01, 0.1, 1.0])
    if rng.random() < 0.3:  # the recorder stops now and then
        delay += (rng.random(len(sampled)) < 0.01) * rng.uniform(0, 500)
    recorded = np.maximum.accumulate(sampled * drift + delay)
    if rng.random() < 0.3:  # sends packets
        every = int(rng.choice([2, 5, 10]))
        last = np.minimum(np.arange(len(sampled)) // every * every + every, len(sampled)) - 1
        recorded = recorded[last]
    step = rng.choice([1, 1000, 100_000])  # ns, of the stamps
    if step > interval * MS / 10:
        step = 1
    stamped = np.rint(sampled * MS / step).astype(np.int64) * step
    return T0 + stamped, T0 + np.rint(recorded * MS).astype(np.int64)


def test_a_recorder_that_is_late_contradicts_nothing():
    """Whatever its delays, and whatever the sensor does."""
    rng = np.random.default_rng(11)
    for trial in range(3000):
        times = delayed(rng)
        assert against_recorded(*times) is None, trial
        unlike = unlike_speed(*times)
        assert unlike is None or abs(unlike.speed - 1) < 1.1e-3, trial


@pytest.mark.parametrize("speed", [0.5, 0.985, 1.015, 2.0])
@pytest.mark.parametrize("count", [900, 1500, 8000])
@pytest.mark.filterwarnings("always::quatprop.QuatpropWarning")
def test_speed_is_told_from_a_queue_by_all_of_a_table(tmp_path, speed, count):
    """Over the first 1,000 rows, a delay that grows looks as a clock that is slow."""
    sampled = np.arange(count) * 10 * MS
    late = np.interp(np.arange(count), [0, count / 3, count / 2, count], [0, 500 * MS, 0, 0])
    rates = {f"gyro_{axis}_dps": np.sin(sampled / 3e8 + k) for k, axis in enumerate("xyz")}
    told = []
    for number, recorded in enumerate((sampled / speed, sampled + late.astype(np.int64))):
        times = {"sensor_time (ns)": T0 + sampled, "received_at (ns)": T0 + recorded.astype(int)}
        path = tmp_path / f"{number}.csv"
        pd.DataFrame(times | rates).to_csv(path, index=False)
        with warnings.catch_warnings(record=True) as caught:
            read_rates(path)
        told.append([str(one.message) for one in caught if " times as fast " in str(one.message)])
    assert len(told[0]) <= 1 == len(told[0]) + (abs(speed - 1) > 0.1), told
    assert not told[1]
