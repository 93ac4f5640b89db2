"""Counters and clocks beside the times that are used: watched from the first row to the last."""

import numpy as np
import pandas as pd
import pytest
from make.table_rates import told
from make.tables import write_frame

from quatprop import propagate
from quatprop.readers.tables.other_clocks import EVERY, divergence

AXES = [f"w{axis}_rad_s" for axis in "xyz"]
ROWS = 4000
LOST = 150


def written(path, **columns):
    """Write columns beside rates, and return the file."""
    frame = pd.DataFrame(columns)
    frame[AXES] = np.random.default_rng(1).normal(size=(len(frame), 3))
    return write_frame(path, frame, 700)


def without(first, count=LOST):
    """Return the numbers of rows of which some are missing."""
    return np.delete(np.arange(ROWS), range(first, first + count))


def evenly(rows=ROWS - LOST):
    """Return times that are 10 ms apart."""
    return np.arange(rows) / 100


def test_numbers_that_go_up_by_tens_name_the_rate_that_gives_the_times(tmp_path):
    """With the rate of the rows, 40 s became 400 s."""
    path = written(tmp_path / "log.csv", time_s=evenly(), frame=10 * without(2000))
    (remark,) = told(path)[1]
    assert remark.endswith("give time_col='frame' and sample_rate='1000'")
    t_ns, _ = told(path, time_col="frame", sample_rate=1000)
    assert t_ns[-1] - t_ns[0] == (ROWS - 1) * 10**7


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet", "npy"])
@pytest.mark.parametrize(
    "name", ["frame", "seq", "packet_id", "PacketCounter", "idx", "Unnamed: 0"]
)
@pytest.mark.parametrize("first", [500, 2000, 3500])
def test_missing_numbers_are_said_beside_times_that_go_on_evenly(tmp_path, suffix, name, first):
    """The times were written by row: 1.5 s became one interval."""
    columns = {"time_s": evenly(), name: without(first)}
    path = written(tmp_path / f"log.{suffix}", **columns)
    option = "1" if name == "Unnamed: 0" else name
    (remark,) = told(path)[1]
    assert remark == (
        f"'{name}' passes over 150 numbers before row {first + 1}, though the times in 'time_s' "
        f"go on evenly; to count by it, give time_col='{option}' and sample_rate='100'"
    )
    assert told(path, time_col=option, sample_rate=100)[0][-1] == (ROWS - 1) * 10**7
    assert told(path, time_col="time_s")[1] == []


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("name", ["packet", "block", "my_part"])
@pytest.mark.parametrize("rows", [4, 10, 50])
def test_missing_packets_are_said_beside_times(tmp_path, name, rows):
    """Each has several rows with its number, in a column of any name."""
    lost = 200 // rows
    packets = np.repeat(np.delete(np.arange(3 * LOST), range(LOST, LOST + lost)), rows)
    path = written(tmp_path / "log.csv", time_s=evenly(len(packets)), **{name: packets})
    (remark,) = told(path)[1]
    assert remark == (
        f"'{name}', which is the same in {rows} rows, passes over {lost} numbers before row "
        f"{LOST * rows + 1}, though the times in 'time_s' go on evenly; to count by it, give "
        f"time_col='{name}' and sample_rate='{100 / rows:g}' and regular_time"
    )


@pytest.mark.thorough
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("lost", [20, 100, 150, 200])
@pytest.mark.parametrize("options", [{}, {"sample_rate": 100}])
def test_numbers_that_fill_their_bits_begin_anew(tmp_path, bits, lost, options):
    """More than half of their range may be lost at once."""
    numbers = (without(2000, lost) + 65_000) % (1 << bits)
    times = {} if options else {"time_s": evenly(len(numbers))}
    path = written(tmp_path / "log.csv", **times, row=numbers)
    (remark,) = told(path, **options)[1]
    assert remark.startswith(f"'row' passes over {lost} numbers before row 2001")


def lossy(seed, holes, length, count=6000):
    """Return the numbers of rows of which some are missing in so many places, by tens."""
    rng = np.random.default_rng(seed)
    kept = np.ones(count // 10, bool)
    for begin in rng.choice(np.arange(3, len(kept) - 9), holes, replace=False):
        kept[begin : begin + length] = False
    return np.arange(count)[np.repeat(kept, 10)]


COUNTERS = {
    "frame": lambda numbers: numbers,
    "PacketCounter": lambda numbers: (numbers + 65_000) % 65_536,
    "sample_counter": lambda numbers: numbers % 256,
    "packet": lambda numbers: numbers // 10,
    "packet_id": lambda numbers: numbers // 10 % 256,
}


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("name", COUNTERS)
@pytest.mark.parametrize(("holes", "length"), [(5, 1), (10, 4), (48, 1), (120, 2)])
@pytest.mark.parametrize("seed", range(2))
def test_numbers_that_are_passed_over_in_many_places_are_said(tmp_path, name, holes, length, seed):
    """With ten holes and more nothing was said: the worse the loss, the quieter."""
    if name == "sample_counter" and length * holes > 100:
        pytest.skip("a quarter of the range of the counter may be missing at once")
    numbers = lossy(seed, holes, length)
    path = written(
        tmp_path / "log.parquet", time_s=evenly(len(numbers)), **{name: COUNTERS[name](numbers)}
    )
    (remark,) = told(path)[1]
    rows = 10 if name in {"packet", "packet_id"} else 1
    steps = np.diff(numbers)
    lost, places = (np.diff(numbers) - 1).sum() // rows, np.count_nonzero(steps > 1)
    in_places = f" in {places} places, first" if places > 1 else ""
    first = int(steps.argmax() if places == 1 else np.flatnonzero(steps > 1)[0]) + 2
    said = (
        f"passes over {lost} number{'s' if lost > 1 else ''}{in_places} before row {first}, though"
    )
    assert f"{said} the times in 'time_s' go on evenly" in remark
    way = {"time_col": name, "sample_rate": 100 // rows, "regular_time": "regular_time" in remark}
    assert way["regular_time"] == (rows > 1 and holes < 50)
    by_number = propagate(path, **way).t_ns
    assert by_number[-1] - by_number[0] == pytest.approx(59.99e9, rel=0.003)


@pytest.mark.thorough
@pytest.mark.parametrize("name", COUNTERS)
@pytest.mark.parametrize("lost", [(0, 1, 4), (1, 48, 1), (2, 120, 2)])
@pytest.mark.parametrize("times", ["sampled", "late", "in packets", "paused", "rounded"])
def test_times_that_show_what_is_missing_are_not_contradicted(tmp_path, name, lost, times):
    """Whatever their jitter, of a few and of many losses."""
    numbers = lossy(*lost)
    rng = np.random.default_rng(50)
    time_s = {
        "sampled": numbers / 100,
        "late": np.sort(numbers / 100 + rng.exponential(0.02, len(numbers))),
        "in packets": numbers // 10 / 10 + np.arange(len(numbers)) % 10 * 1e-3 + 0.1,
        "paused": numbers / 100 + 40 * (np.arange(len(numbers)) > 2500),
        "rounded": np.round(numbers / 100, 1),
    }[times]
    columns = {"time_s": time_s, name: COUNTERS[name](numbers)}
    said = told(written(tmp_path / "log.parquet", **columns))[1]
    assert [one for one in said if "passes over" in one] == []


def jittered(times, by, seed):
    """Return times with a delay of up to `by`, as those of arrival."""
    return times + np.random.default_rng(seed).uniform(0, by, len(times))


def healthy(seed):
    """Return columns of a log that lost nothing, or whose times show what it lost."""
    rng = np.random.default_rng(seed)
    begin, lost = rng.integers(100, 3500), rng.integers(1, 300)
    numbers = without(begin, lost)
    device = numbers / 100
    host = 1.7e9 + jittered(device * (1 + rng.uniform(-1, 1) * 1e-4), 0.03, seed)
    stalls = np.sort(rng.integers(0, len(host), 3))
    for stall in stalls:
        end = host[stall] + rng.uniform(0, 2)
        host[stall:] = np.maximum(host[stall:], end)
    k = np.arange(len(numbers))
    return {
        "numbers and times": {"time_s": device, "frame": numbers},
        "rows and times": {"time_s": device, "row": k},
        "packets": {"time_s": device, "packet": numbers // 10},
        "wrapped": {"time_s": device, "seq": numbers % 256},
        "jitter": {"time_s": np.sort(jittered(device, 0.02, seed)), "frame": numbers},
        "in a second": {"time_s": device, "sample": numbers % 100},
        "of a video": {"time_s": device, "frame": (numbers * 0.3).astype(int)},
        "shared numbers": {"time_s": k / 100, "seq": np.cumsum(rng.choice([1, 2, 4], len(k)))},
        "arrival": {"host_time_s": host, "device_time_ms": np.round(device * 1000)},
        "whole seconds": {"time_s": device, "gps_time_s": np.floor(device + 1e5)},
        "first fix": {"time_s": device, "gps_time_s": np.where(k > 700, device + 1e9, 0)},
        "minutes": {"time_s": device, "utc_time_s": np.floor(device / 10) * 10 + 1e9},
        "temperature": {"time_s": device, "temp": np.cumsum(rng.random(len(k)) < 0.1)},
        "laps": {"time_s": device, "lap_time_s": device % 12},
    }


@pytest.mark.thorough
@pytest.mark.parametrize("case", healthy(0))
@pytest.mark.parametrize("seed", range(12))
def test_no_false_alarm_beside_times(tmp_path, case, seed):
    """Delays that pass, drift, wraps, and losses that the times show are no contradiction."""
    columns = healthy(seed)[case]
    said = told(written(tmp_path / "log.parquet", **columns))[1]
    assert [one for one in said if "passes over" in one or "by a jump" in one] == []


OTHERS = {
    "host_time_s": lambda t: np.sort(jittered(t + 1.7e9, 0.02, 3)),
    "gps_time_s": lambda t: t + 1e5,
    "system_time_s": lambda t: t * 1.00003 + 1.7e9,
    "device_timestamp_ms": lambda t: t * 1000,
    "host_time": lambda t: t + 1.7e9,
    "datetime": lambda t: (t * 1e9).astype("datetime64[ns]") + np.timedelta64(19_000, "D"),
}


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("first", [1100, 2000, 3400])
def test_a_clock_that_jumps_behind_the_first_rows_is_said(tmp_path, suffix, name, first):
    """The first 1,000 rows agree."""
    numbers = without(first)
    path = written(
        tmp_path / f"log.{suffix}", time_s=evenly(), **{name: OTHERS[name](numbers / 100)}
    )
    used, other = ("time_s", name) if "device" not in name else (name, "time_s")
    (remark,) = [one for one in told(path)[1] if "by a jump" in one]
    begin = (first - 1) // EVERY * EVERY
    between = f"by a jump between rows {begin + 1} and {begin + EVERY + 1}"
    verb = "fall" if "device" in name else "go"
    assert remark.startswith(f"the times in '{other}' {verb} 1.")
    assert f"those in '{used}', which are used, {between}; " in remark
    unit = " and time_unit='s' or 'ms' or 'us' or 'ns'" if name == "host_time" else ""
    assert remark.endswith(f"to use them, name them with time_col='{other}'{unit}")
    if name != "device_timestamp_ms":
        unit = {"time_unit": "s"} if unit else {}
        t_ns = propagate(path, time_col=other, **unit).t_ns
        assert (t_ns[-1] - t_ns[0]) / 1e9 == pytest.approx((ROWS - 1) / 100, abs=0.05)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_clock_that_some_rows_lack_is_compared_in_the_others(tmp_path, suffix):
    """One empty cell among those that are compared, and nothing was said."""
    other = without(2000) / 100
    other[EVERY * 3 : EVERY * 6] = np.nan
    path = written(tmp_path / f"log.{suffix}", time_s=evenly(), host_time_s=other)
    (remark,) = told(path)[1]
    assert remark.startswith("the times in 'host_time_s' go 1.5 s further than those in 'time_s'")


def test_a_clock_of_which_there_are_few_rows_is_not_compared():
    """Nor one that goes back."""
    times = np.arange(100.0)
    jump = times + 40 * (times > 50)
    assert divergence(times, jump).largest == 50
    assert divergence(times[:10], jump[:10]) is None
    assert divergence(times, jump[::-1]) is None


def stalling(seed, share, rows=1500):
    """Return times of rows that come every 10 ms, but a share of them after 90 ms."""
    late = np.random.default_rng(seed).random(rows) < share
    return np.cumsum(np.where(late, 0.09, 0.01))


CLOCKS = {
    "millis": lambda t: np.round(t * 1000).astype(int),
    "time_s": lambda t: t,
    "SampleTimeFine": lambda t: np.round(t * 1e4).astype(int) + 734_523,
    "datetime": OTHERS["datetime"],
}
GIVEN = [{"time_col": "dt_s"}, {"sample_rate": 100, "time_col": "none"}, {"sample_rate": 100}]


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("name", CLOCKS)
@pytest.mark.parametrize(("share", "seed"), [(0.01, 0), (0.03, 1), (0.2, 2)])
def test_a_clock_that_contradicts_steady_rows_is_named(tmp_path, given, name, share, seed):
    """A program wrote its wish as `dt`, and the rows came later."""
    times = stalling(seed, share)
    columns = {"dt_s": np.full(len(times), 0.01) + 1e-4 * (np.arange(len(times)) % 2)}
    path = written(tmp_path / "log.csv", **columns, **{name: CLOCKS[name](times)})
    own = 9.99 if "sample_rate" in given else 10.04
    (remark,) = [one for one in told(path, **given)[1] if "the first 1000 rows take" in one]
    taken = float(f"{times[999] - times[0]:.4g}")
    said = f"by the times in '{name}', the first 1000 rows take {taken:g} s, not {own:g} s; to use"
    assert said in remark
    way = {"time_col": name} | ({"sample_rate": 10_000} if name == "SampleTimeFine" else {})
    ways = " and ".join(f"{key}='{value}'" for key, value in way.items())
    assert remark.endswith(f"to use these, give {ways}")
    t_ns = propagate(path, **way).t_ns
    assert (t_ns[-1] - t_ns[0]) / 1e9 == pytest.approx(times[-1] - times[0], abs=1e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("given", GIVEN)
@pytest.mark.parametrize("name", CLOCKS)
@pytest.mark.parametrize("case", ["drift", "jitter", "another unit", "not in order", "few"])
def test_a_clock_that_agrees_with_steady_rows_is_not_said_to_differ(tmp_path, given, name, case):
    """Nor one that is no clock, or so few rows that jitter would do it."""
    rng = np.random.default_rng(len(name))
    times = np.arange(1500) / 100
    times = {
        "drift": times * (1 + rng.uniform(-0.005, 0.005)),
        "jitter": np.sort(times + rng.uniform(0, 0.05, len(times))),
        "another unit": times * 60,
        "not in order": rng.permutation(times),
        "few": times[:12] * 1.1,
    }[case]
    path = written(tmp_path / "log.csv", dt_s=[0.01] * len(times), **{name: CLOCKS[name](times)})
    assert [one for one in told(path, **given)[1] if "rows take" in one] == []


def test_a_clock_beside_a_counter_at_the_stated_rate_is_compared(tmp_path):
    """Xsens states an update rate above; its clock shows another."""
    rows = "".join(f"{k},{734_523 + k * 10_000 // 60},0.1,0.2,0.3\n" for k in range(200))
    head = "PacketCounter,SampleTimeFine,Gyr_X,Gyr_Y,Gyr_Z\n"
    path = tmp_path / "log.csv"
    for hz, said in ((100, True), (60, False)):
        path.write_text(f"// Update Rate: {hz}.0Hz\n{head}{rows}")
        remarks = told(path, rate_unit="rad/s")[1]
        assert any("the first 200 rows take 3.317 s, not 1.99 s" in r for r in remarks) == said
