"""Header timestamps against steady times of recording, over a whole log."""

import re

import numpy as np
import pytest
from make.ros import imu_messages, write_messages

import quatprop
from quatprop.propagation.clock_watch import ClockWatch

T0 = 1_700_000_000 * 10**9


def said_of(t_s, log_s, size=3333):
    """Return what is said of timestamps and times of recording, s."""
    t_ns, log_ns = (T0 + np.rint(np.asarray(each) * 1e9).astype(np.int64) for each in (t_s, log_s))
    watch = ClockWatch("/imu")
    for begin in range(0, len(t_ns), size):
        watch.add(t_ns[begin : begin + size], log_ns[begin : begin + size])
    return {one.code: str(one) for one in watch.remarks()}


def delayed(true_s, hz, seed, share=0.15):
    """Return times of recording, late by a delay that varies, in order."""
    rng = np.random.default_rng(seed)
    late = 0.001 + rng.exponential(share / hz / 3, len(true_s)).clip(max=share / hz)
    return np.maximum.accumulate(true_s + late)


CASES = [(100, 85, 1), (50, 120, 2), (200, 40, 3), (1000, 30, 4), (100, 900, 5)]


@pytest.mark.parametrize("off", [0.002, 0.003, -0.005, 0.008, -0.009, 1.0, 9.0, -0.5, -0.9])
@pytest.mark.parametrize(("hz", "seconds", "seed"), CASES)
def test_a_clock_of_another_speed_is_found(hz, seconds, seed, off):
    """Stamps that count samples at a nominal rate, of a gyroscope whose own is another."""
    number = np.arange(hz * seconds)
    true_s = number / hz * (1 + off)
    said = said_of(number / hz, delayed(true_s, hz, seed))
    assert [*said] == ["unlike-log-times"]
    speed = float(re.search(r"go ([\d.]+) times as fast", said["unlike-log-times"])[1])
    assert abs(speed - 1 / (1 + off)) < 1e-4


@pytest.mark.parametrize("step_s", [0.03, 0.045, 0.08, 0.5, 7.0])
@pytest.mark.parametrize(("hz", "seconds", "seed"), CASES)
@pytest.mark.parametrize("size", [50, 3333])
def test_a_step_of_the_clock_is_found_with_its_place(hz, seconds, seed, step_s, size):
    """A receiver was locked: the stamps leap, and the messages go on as before."""
    true_s = np.arange(hz * seconds) / hz
    at = len(true_s) * 2 // 5
    stamped = true_s + step_s * (np.arange(len(true_s)) >= at)
    if step_s < 2.6 / hz:
        return
    text = said_of(stamped, delayed(true_s, hz, seed), size)["clock-step"]
    assert f"before {T0 + round(stamped[at] * 1e9)} ns," in text
    assert "step ahead by " in text


def healthy(kind, hz, seconds, seed):
    """Return timestamps and times of recording, s, of a log that is well."""
    rng = np.random.default_rng(seed)
    true_s = np.arange(hz * seconds) / hz
    stamped, recorded = true_s.copy(), delayed(true_s, hz, seed)
    middle = len(true_s) // 2
    if kind == "quartz":
        stamped = true_s * (1 + 2e-4)
    elif kind == "jitter":
        stamped = true_s + rng.normal(0, 0.1 / hz, len(true_s))
    elif kind == "bursts":
        recorded = np.ceil((true_s + 1e-4) / 0.016) * 0.016
    elif "queue" in kind:
        grown, ends = (0.45, 0.6) if kind == "queue" else (0.9, 0.99)
        late = np.interp(true_s / seconds, [0, grown, ends], [0, 0.015 * seconds * grown, 0])
        recorded = np.maximum.accumulate(recorded + late)
    elif kind == "backlog":
        recorded = np.maximum.accumulate(recorded + np.clip(true_s - 5, 0, 2) * 0.05)
    elif kind == "stall":
        recorded[middle : middle + hz] = recorded[middle + hz]
    elif kind == "lost":
        keep = (np.arange(len(true_s)) < middle) | (np.arange(len(true_s)) >= middle + 8)
        stamped, recorded = stamped[keep], recorded[keep]
    elif kind == "late one":
        stamped[middle] += 0.08
    elif kind == "both set":
        stamped[middle:] += 0.08
        recorded[middle:] += 0.08
    elif kind == "longer delay":
        recorded[middle:] += 0.03
    elif kind == "other epoch":
        stamped = stamped - 1e9
    elif kind == "unset":
        stamped[: hz // 2] = -1.7e9
    return stamped, recorded


KINDS = ["quartz", "jitter", "bursts", "backlog", "stall", "lost", "late one", "both set"]
KINDS += ["longer delay", "other epoch", "unset", "queue", "long queue", "well"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("hz", "seconds", "seed"), CASES)
def test_a_clock_that_is_well_has_no_remark(kind, hz, seconds, seed):
    """Delays vary, samples are lost, quartz is off by some hundred millionths."""
    assert not said_of(*healthy(kind, hz, seconds, seed))


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0])
def test_a_log_that_was_played_at_another_speed_is_told(tmp_path, speed):
    """Of one file and of several; log times may be uneven, and the header stamps stay right."""
    true_s = np.arange(4000) / 100
    late = np.random.default_rng(6).exponential(0.01, len(true_s))
    t_ns, log_ns = (
        T0 + np.rint(each * 1e9).astype(np.int64)
        for each in (true_s, np.maximum.accumulate(true_s / speed + late))
    )
    rate = np.sin(true_s[:, None] + np.arange(3))
    names = []
    for number, part in enumerate((slice(2000), slice(2000, None))):
        messages = imu_messages(t_ns[part], rate[part], recorded=log_ns[part])
        names.append(write_messages(tmp_path / f"{number}.bag", messages))
    for log in (names[0], names):
        result = quatprop.propagate(log)
        (said,) = [str(one) for one in result.report.remarks if one.code == "unlike-log-times"]
        assert f"go {speed:g} times as fast as its log times" in said
        assert (np.diff(result.t_ns) == 10_000_000).all()


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_a_step_is_said_only_where_it_is_used(tmp_path):
    """Also if only a part of the log is read."""
    true_s = np.arange(30_000) / 50
    t_ns = T0 + np.rint((true_s + 0.5 * (true_s >= 450)) * 1e9).astype(np.int64)
    messages = imu_messages(t_ns, recorded=T0 + np.rint(true_s * 1e9).astype(np.int64))
    path = write_messages(tmp_path / "log.mcap", messages)
    for start, end, is_said in (("+440s", "+460s", 1), ("+300s", "+320s", 0), (None, "+400s", 0)):
        remarks = quatprop.propagate(path, start=start, end=end).report.remarks
        codes = [one.code for one in remarks]
        assert codes.count("clock-step") == is_said
        assert ("part-read" in codes) == (start is not None)


@pytest.mark.parametrize("size", [1, 7, 5000])
def test_batches_of_any_size_give_the_same(size):
    """The findings do not depend on where batches end."""
    true_s = np.arange(9000) / 100
    stamped = true_s * 1.004
    whole = said_of(stamped, delayed(true_s, 100, 8), 10**6)
    assert said_of(stamped, delayed(true_s, 100, 8), size) == whole != {}


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("count", [50, 2000])
def test_absolute_times_of_a_clock_ahead_of_the_recording_are_remarked_on(tmp_path, count):
    """A range in UTC of stamps in GPS time began 18 s too early, in silence."""
    t_ns = T0 + np.arange(count) * 10_000_000
    for lead_s, code in ((18, True), (37, True), (0, False), (-18, False)):
        messages = imu_messages(t_ns + lead_s * 10**9, np.ones((count, 3)), recorded=t_ns)
        path = write_messages(tmp_path / f"{lead_s}.mcap", messages)
        for start, is_absolute in ((T0 - 60 * 10**9, True), ("+0.1s", False), (None, False)):
            remarks = quatprop.propagate(path, start=start).report.remarks
            said = [str(one) for one in remarks if one.code == "range-of-other-clock"]
            assert bool(said) == (code and is_absolute)
            assert not said or f"are {lead_s} s later" in said[0]
