"""Times of tables that are more than numbers in a unit: intervals, ticks, dates, counters."""

from datetime import UTC, datetime, timedelta

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from make.commands import refused, run
from make.mcap import Topic, write_topics
from make.ros import write_messages
from make.table_rates import refusal, table_rates, told
from pyarrow import feather, parquet
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop import propagate
from quatprop.base.errors import UndeclaredError, UsageError
from quatprop.readers.tables.exact_times import from_text, nanoseconds
from quatprop.readers.tables.time_units import TIME_OF_DAY, since_a_date

RATES = [f"gyro_{axis}_dps" for axis in "xyz"]
NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
STEPS = np.random.default_rng(1).integers(4_000, 12_000, 200) * 1000
"""Intervals, ns."""

SUMS = np.concatenate([[0], np.cumsum(STEPS[1:])])


def table(path, columns):
    """Write columns, and rates of 1, 2 and 3 deg/s; return the path."""
    frame = pd.DataFrame(columns).assign(**dict(zip(RATES, (1.0, 2.0, 3.0), strict=True)))
    if path.suffix == ".csv":
        frame.to_csv(path, index=False)
    elif path.suffix == ".jsonl":
        frame.to_json(path, orient="records", lines=True, double_precision=15)
    elif path.suffix == ".npz":
        np.savez(path, **{name: frame[name].to_numpy() for name in frame})
    else:
        getattr(frame, f"to_{path.suffix[1:]}")(path)
    return path


# --- intervals

INTERVALS = (
    *(
        "dt_s",
        "dt (ms)",
        "delta_t_us",
        "delta_time_ms",
        "deltaT (s)",
        "DeltaTimeMs",
        "time_delta_s",
    ),
    *(
        "dtime_us",
        "timediff (ms)",
        "Sample Interval (s)",
        "interval_us",
        "imu.dt_s",
        "time_step [s]",
    ),
    *("elapsed_since_last_ms", "since_last (us)", "time_since_previous_sample_us", "dts_ms"),
    *("inter_sample_interval (ms)", "message_interval_us", "timestamp_diff_us", "diff_t (s)"),
    *(
        "delta (ms)",
        "delta_us",
        "step [ms]",
        "gap_ms",
        "loop_time (us)",
        "cycle_time_ms",
        "period (s)",
    ),
)


@pytest.mark.parametrize("name", INTERVALS)
def test_intervals_are_summed_by_their_name(tmp_path, name):
    """No option used them, and what was advised gave the identity."""
    unit = next(unit for unit in ("ms", "us", "s") if name.lower().rstrip(")]").endswith(unit))
    t_ns, (remark,) = told(table(tmp_path / "log.csv", {name: STEPS / NS[unit]}))
    assert t_ns == SUMS.tolist()
    assert remark.startswith(f"the times are the sums of '{name}', each taken as the time since ")


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "npz", "parquet", "feather"])
def test_intervals_are_summed_in_every_kind_of_table(tmp_path, suffix):
    """Also across batches and ranges; the way out that is named when no unit is, works."""
    path = table(tmp_path / f"log.{suffix}", {"dt": STEPS / 1e6})
    assert "the unit of the time 'dt' is not declared" in refusal(path, UndeclaredError)
    t_ns, _ = told(path, time_unit="ms")
    assert t_ns == SUMS.tolist()
    assert told(path, time_unit="ms", time_col="dt")[0] == t_ns
    run("propagate", path, "-o", tmp_path / "o.csv", "--time-unit", "ms", "--end", "+0.5s", code=0)
    found = pd.read_csv(tmp_path / "o.csv")["t_ns"]
    assert found.tolist() == [t for t in t_ns if t <= 500_000_000]


def test_a_clock_comes_before_intervals_and_rising_numbers_are_none(tmp_path):
    """Intervals next to a clock are not needed; times named as one are not summed unasked."""
    path = table(tmp_path / "log.csv", {"dt_s": STEPS / 1e9, "t_ns": SUMS + 7})
    assert told(path) == ((SUMS + 7).tolist(), [])
    path = table(tmp_path / "log.csv", {"dt_s": SUMS / 1e9})
    assert "whether 'dt_s' is the time is not declared" in refusal(path, UndeclaredError)
    assert told(path, time_col="dt_s")[0] == SUMS.tolist()
    path = table(tmp_path / "log.csv", {"exposure_dt_s": STEPS / 1e9})
    assert "is the time is not declared" in refusal(path, UndeclaredError)


@pytest.mark.parametrize("name", ["time_since_last_fix (s)", "gap (s)", "dt_s", "delta (s)"])
@pytest.mark.parametrize("every", [5, 40])
def test_times_since_a_rarer_event_are_no_intervals(tmp_path, name, every):
    """Their values rise to the next event; the sum of such times is no time."""
    path = table(tmp_path / "log.csv", {name: np.arange(200) % every / 100})
    assert f"whether '{name}' is the time is not declared" in refusal(path, UndeclaredError)


@pytest.mark.parametrize("name", ["delta", "gap", "step", "period"])
def test_words_for_intervals_of_anything_need_a_unit_of_time(tmp_path, name):
    """A delta may be that of an elevator."""
    path = table(tmp_path / "log.csv", {name: STEPS / 1e6})
    assert f"whether '{name}' is the time is not declared" in refusal(path, UndeclaredError)
    assert told(path, time_col=name, time_unit="ms")[0] == SUMS.tolist()


def test_a_time_that_repeats_is_no_interval(tmp_path):
    """Of packets named so, the stamps were summed."""
    path = table(tmp_path / "log.csv", {"delta_time_ms": np.repeat(np.arange(50) * 40, 4)})
    assert "whether 'delta_time_ms' is the time" in refusal(path, UndeclaredError)


# --- counters that wrap around


@settings(
    deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    unit=st.sampled_from(["ns", "us", "ms"]),
    before=st.integers(1, 150),
    turns=st.integers(1, 2),
    suffix=st.sampled_from(["csv", "npz", "jsonl"]),
)
def test_a_counter_of_32_bits_is_continued(tmp_path, unit, before, turns, suffix):
    """It was refused, though it is certain where it goes on as before."""
    step = {"ns": 2_000_000, "us": 10_000, "ms": 10}[unit]
    counts = 2**32 * turns - before * step + 3 + np.arange(200) * step
    path = table(tmp_path / f"log.{suffix}", {f"t_{unit}": counts % 2**32})
    t_ns, (remark,) = told(path)
    assert np.diff(t_ns).tolist() == [step * NS[unit]] * 199
    assert t_ns[0] == (2**32 - before * step + 3) * NS[unit]
    assert remark.startswith("the time wrapped around 1 time after")


ANEW = [
    ("t_ms", "ms", 2**16, 0, "a counter of 16 bits"),
    ("t_ms", "ms", 2**16, -(2**15), "a counter of 16 bits"),
    ("t_us", "us", 2**16, 0, "a counter of 16 bits"),
    ("t_us", "us", 2**24, 0, "a counter of 24 bits"),
    ("t_us", "us", 2**32, -(2**31), "a counter of 32 bits"),
    ("gps_tow_ms", "ms", 604_800_000, 0, "the time of a week"),
    ("time_of_week_s", "s", 604_800, 0, "the time of a week"),
    ("t_s", "s", 86_400, 0, "the time of a day"),
    ("t_us", "us", 43_200_000_000, 3_600_000_000, "a clock of 12 hours"),
]
"""Name and unit of a column, its period and its first value, and what it is called."""


@pytest.mark.parametrize("clock", ANEW)
@pytest.mark.parametrize(
    ("before", "step_ms", "suffix"),
    [(1, 10, "csv"), (100, 20, "npz"), (77, 1, "csv"), (198, 7, "parquet")],
)
def test_a_clock_that_begins_anew_after_a_known_period_is_continued(
    tmp_path, clock, before, step_ms, suffix
):
    """It was refused, and what was advised gave another motion."""
    name, unit, period, first, kind = clock
    t_ns = first * NS[unit] + period * NS[unit] + (np.arange(200) - before) * step_ms * 10**6
    stored = (t_ns - first * NS[unit]) % (period * NS[unit]) + first * NS[unit]
    cells = stored // NS[unit] if unit != "s" else np.round(stored / 1e9, 3)
    found, remarks = told(table(tmp_path / f"log.{suffix}", {name: cells}))
    assert np.abs(np.diff(found) - step_ms * 10**6).max() < 1000
    assert any(one.endswith(f", as {kind}, and is continued") for one in remarks)


def test_a_clock_of_12_hours_without_am_and_pm_goes_on_after_1259(tmp_path):
    """It was refused as a step back."""
    cells = [f"12:59:{k}.0" for k in range(40, 60)] + [f"01:00:{k:02}.0" for k in range(20)]
    t_ns, (_, remark) = told(table(tmp_path / "log.csv", {"time": cells}))
    assert np.diff(t_ns).tolist() == [10**9] * 39
    assert "after 43200 s, as a clock of 12 hours" in remark


@pytest.mark.parametrize("ran_ms", [9_000, 65_000, 86_000_000, 700_000_000])
@pytest.mark.parametrize("after_ms", [0, 20, 3_000])
def test_a_restart_is_cut_and_its_parts_are_read_in_order(tmp_path, ran_ms, after_ms):
    """The advice kept a part, or mixed the two runs."""
    first, second = ran_ms + np.arange(100) * 10, after_ms + np.arange(100) * 10
    path = table(tmp_path / "log.csv", {"uptime_ms": np.concatenate([first, second])})
    said = refused("propagate", path, "-o", "-")
    assert f"at sample 100 (t = {after_ms * 10**6} ns); if the clock begins anew there" in said
    assert "cut the file there and read its parts in order with --in-sequence" in said
    header, *rows = path.read_text().splitlines(keepends=True)
    parts = [tmp_path / "1.csv", tmp_path / "2.csv"]
    for part, of_it in zip(parts, (rows[:100], rows[100:]), strict=True):
        part.write_text("".join([header, *of_it]))
    run("propagate", *parts, "--in-sequence", "-o", tmp_path / "o.csv", code=0)
    assert np.diff(pd.read_csv(tmp_path / "o.csv")["t_ns"]).tolist() == [10**7] * 199


def test_a_late_row_next_to_the_wrap_stays_late(tmp_path):
    """It belongs to the turn before."""
    counts = 2**32 - 500 + np.arange(100) * 10
    counts[[50, 51]] = counts[[51, 50]]
    t_ns, _ = told(table(tmp_path / "log.csv", {"t_ms": counts % 2**32}))
    assert t_ns == (counts * 10**6).tolist()


@pytest.mark.parametrize("unit", ["us", "ms"])
@pytest.mark.parametrize(
    ("step", "last", "late"),
    [(10_000, 6, 0), (10_000, 6, 4_000), (1_000, 65, 0), (500, 130, 30), (65, 1008, 0)],
)
def test_a_late_row_before_later_times_is_no_wrap(tmp_path, unit, step, last, late):
    """A counter never shows times beyond its end, as the rows after this one do."""
    counts = np.arange(2000) * step
    counts = np.insert(counts, last + 1, late)
    path = table(tmp_path / "log.csv", {f"t_{unit}": counts})
    assert f"at sample {last + 1} (t = {late * NS[unit]} ns)" in refused(
        "propagate", path, "-o", "-"
    )


@pytest.mark.parametrize("back_ms", [3_000_000, 4_000_000_000, 2**32 - 200_000, 2**32])
def test_a_clock_that_is_set_back_is_no_counter(tmp_path, back_ms):
    """Unless it was at the end of a counter, and goes on from 0."""
    t_ms = 2**32 + 70_000 + np.arange(100) * 10
    t_ms[50:] -= back_ms
    path = table(tmp_path / "log.csv", {"t_ms": t_ms})
    assert "time steps back by" in refused("propagate", path, "-o", "-")


def test_ranges_of_a_wrapped_counter_are_those_of_the_whole(tmp_path):
    """The index of a table has the counts as they are stored."""
    counts = 2**32 - 1_000_000 + np.arange(400) * 10_000
    frame = pd.DataFrame({"t_us": counts % 2**32, **dict.fromkeys(RATES, 1.0)})
    frame.to_parquet(tmp_path / "log.parquet", row_group_size=20)
    words = "propagate", tmp_path / "log.parquet", "-o", tmp_path / "o.csv"
    run(*words, "--start", "+3.5s", code=0)
    assert pd.read_csv(tmp_path / "o.csv")["t_ns"].tolist() == (counts[350:] * 1000).tolist()


OWN = "float64[3] w\n{} t\n"
OF_OWN = {"rate_field": "w", "time_field": "t", "rate_unit": "rad/s"}
IGNORED = pytest.mark.filterwarnings("ignore::quatprop.base.errors.RemarkWarning")
KINDS = ["uint32", "uint64", "int64", "float64", "json"]


def counting(path, counts, kind="uint32", first=0, apart_ns=10**7):
    """Write messages with a counter, recorded at steady times; return the path."""
    recorded = (10**18 + (first + np.arange(len(counts))) * apart_ns).tolist()
    if kind == "json":
        rows = [{"w": [0.1, 0.2, k / 100], "t": t} for k, t in enumerate(counts.tolist())]
        topic = Topic("own", [*zip(recorded, rows, strict=True)])
        return write_topics(path, {"/imu": topic}, chunk_size=4000)
    stores = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    for store in stores:
        store.register(get_types_from_msg(OWN.format(kind), "p/msg/Own"))
    times = counts.astype(kind).tolist()
    messages = [
        ("/imu", "p/msg/Own", at, {"w": np.array([0.1, 0.2, k / 100]), "t": t})
        for k, (at, t) in enumerate(zip(recorded, times, strict=True))
    ]
    return write_messages(path, messages, types=stores)


@settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    unit=st.sampled_from(["ns", "us", "ms"]),
    before=st.integers(1, 150),
    kind=st.sampled_from(KINDS),
    suffix=st.sampled_from(["mcap", "bag"]),
)
@IGNORED
def test_a_counter_in_messages_is_continued(tmp_path, unit, before, kind, suffix):
    """Only those in tables were; the wrap was refused as a step back."""
    step = {"ns": 10_000_000, "us": 10_000, "ms": 10}[unit]
    counts = 2**32 - before * step + 3 + np.arange(200) * step
    path = tmp_path / f"log.{'mcap' if kind == 'json' else suffix}"
    path.unlink(missing_ok=True)
    report = propagate(counting(path, counts % 2**32, kind), **OF_OWN, time_unit=unit)
    assert np.diff(report.t_ns).tolist() == [step * NS[unit]] * 199
    assert report.t_ns[0] == (2**32 - before * step + 3) * NS[unit]
    assert any("the time wrapped around 1 time after" in one for one in report.report.remarks)


@IGNORED
@pytest.mark.parametrize("before", [30, 99, 100, 101, 299])
@pytest.mark.parametrize("in_sequence", [False, True])
def test_a_counter_that_wraps_around_in_a_split_recording_is_continued(
    tmp_path, before, in_sequence
):
    """Within a file, or between two."""
    counts = 2**32 - before * 10_000 + np.arange(300) * 10_000
    parts = [
        counting(tmp_path / f"{k}.mcap", counts[100 * k :][:100] % 2**32, first=100 * k)
        for k in range(3)
    ]
    found = propagate(parts, **OF_OWN, time_unit="us", in_sequence=in_sequence)
    assert found.t_ns.tolist() == (counts * 1000).tolist()


@IGNORED
def test_ranges_of_a_wrapped_counter_in_messages_are_those_of_the_whole(tmp_path):
    """The index has log times, which do not tell how often the counter has wrapped around."""
    counts = 2**32 - 10**7 + np.arange(900) * 1_000_000
    path = counting(tmp_path / "log.mcap", counts % 2**32, apart_ns=10**9)
    for options in ({"start": "+895s"}, {"start": int(counts[895]) * 1000}):
        found = propagate(path, **OF_OWN, time_unit="us", **options)
        assert found.t_ns.tolist() == (counts[895:] * 1000).tolist()


# --- ticks at a rate


@pytest.mark.parametrize("name", ["timestamp_ticks", "SampleTimeFine", "time", "clk", "tick", "t"])
@pytest.mark.parametrize(("hz", "bits"), [(32_768, 24), (10_000, 32), (1_000_000, 16), (40, 64)])
@pytest.mark.parametrize("suffix", ["csv", "npz", "jsonl"])
def test_a_named_time_with_a_sample_rate_counts_ticks(tmp_path, name, hz, bits, suffix):
    """Both together were refused, and the rate alone counted the rows, without a word."""
    ticks = 2 ** min(bits, 32) - 70 * max(hz // 100, 3) + np.arange(200) * max(hz // 100, 3)
    path = table(tmp_path / f"log.{suffix}", {name: ticks % 2.0**bits if bits < 64 else ticks})
    t_ns, remarks = told(path, time_col=name, sample_rate=hz)
    expected = (ticks - ticks[0]) * 10**9 / hz
    assert np.abs(np.array(t_ns) - t_ns[0] - expected).max() <= 1
    assert remarks[0].startswith(f"the numbers in '{name}' are read as ticks, {hz:g} a second: ")


def test_ticks_next_to_counted_rows_are_named(tmp_path):
    """The way out that is named reads them; other numbers are not named."""
    path = table(tmp_path / "log.csv", {"timestamp_ticks": np.arange(100) * 328, "height": 1.0})
    t_ns, (remark,) = told(path, sample_rate=32_768)
    assert np.diff(t_ns).max() < 31_000
    assert remark.endswith(
        "the numbers in 'timestamp_ticks' are not used; if they are ticks at this rate, give "
        "time_col='timestamp_ticks' too"
    )
    t_ns, _ = told(path, sample_rate=32_768, time_col="timestamp_ticks")
    assert t_ns[-1] == round(99 * 328 * 10**9 / 32_768)


@pytest.mark.parametrize("cells", [np.arange(60) / 100, [f"a{k}" for k in range(60)], [7] * 60])
def test_what_counts_no_ticks_is_refused_at_a_rate(tmp_path, cells):
    """Times with decimals, texts, and numbers that stand."""
    path = table(tmp_path / "log.csv", {"time": cells})
    said = refusal(path, UsageError, time_col="time", sample_rate=100)
    assert "'time' does not count samples or ticks" in said


# --- units and epochs


def test_ticks_of_100_ns(tmp_path):
    """By name or by the option; since 1601 or the year 1, as their size shows."""
    since_1970 = 1_600_000_000 * 10**7 + np.arange(50) * 100_003
    for before, year in (
        (0, ""),
        (116_444_736_000_000_000, "1601"),
        (621_355_968_000_000_000, "1"),
    ):
        for name, options in (("timestamp_100ns", {}), ("time", {"time_unit": "100ns"})):
            for suffix in ("csv", "npz", "jsonl", "parquet"):
                path = table(tmp_path / f"log.{suffix}", {name: since_1970 + before})
                t_ns, remarks = told(path, **options)
                assert t_ns == (since_1970 * 100).tolist()
                expected = [f"the ticks in '{name}' count from the year {year}, "] if year else []
                assert [
                    one[: len(text)] for one, text in zip(remarks, expected, strict=True)
                ] == expected


@given(
    unit=st.sampled_from(["seconds", "milliseconds", "minutes", "hours", "days", "us", "s", "h"]),
    since_s=st.integers(0, 4 * 10**9),
    zone=st.sampled_from(["", "Z", " UTC", "+00:00", "+02:00", " -5:30", "-0800"]),
    number=st.integers(0, 50_000),
)
def test_units_since_a_date_keep_their_epoch(unit, since_s, zone, number):
    """Of the CF conventions; the date was refused as an unknown unit."""
    per = {"minutes": 60, "hours": 3600, "h": 3600, "days": 86_400}.get(unit, 1)
    per_ns = {"milliseconds": 10**6, "us": 1000}.get(unit, per * 10**9)
    minutes = {"+02:00": 120, " -5:30": -330, "-0800": -480}.get(zone, 0)
    moment = datetime.fromtimestamp(since_s, UTC) + timedelta(minutes=minutes)
    found = since_a_date(f"{unit} since {moment:%Y-%m-%d %H:%M:%S}{zone}")
    assert from_text(str(number), found) == number * per_ns + since_s * 10**9
    stored = pa.array([number], "int64")
    assert nanoseconds(stored, found).tolist() == [number * per_ns + since_s * 10**9]


@pytest.mark.parametrize("units", ["seconds since 2021-05-01 00:00:00", "days since 2021-05-01"])
def test_a_table_in_units_since_a_date(tmp_path, units):
    """In the attribute of a dataset, or in the header of a text."""
    per_s = 1 if units.startswith("s") else 86_400
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["time"] = np.arange(50) / 100 / per_s
        file["time"].attrs["units"] = units
        file["gyro"], file["gyro"].attrs["units"] = np.ones((50, 3)), "rad/s"
    text = table(tmp_path / "log.csv", {f"time ({units})": np.arange(50) / 100 / per_s})
    for path in (tmp_path / "log.h5", text):
        t_ns, remarks = told(path)
        expected = 1_619_827_200 * 10**9 + np.arange(50) * 10**7
        assert np.abs(np.array(t_ns) - expected).max() <= 9
        assert remarks == []


# --- times of day


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("digits", [0, 3, 6])
def test_times_of_day_go_on_after_midnight(tmp_path, half, digits):
    """They were refused as dates in an unknown format."""
    seconds = 86_390 + np.arange(300) * (1 if digits == 0 else 0.1)
    cells = []
    for each in seconds % 86_400:
        hour, rest = divmod(round(each, 3), 3600)
        minute, second = divmod(rest, 60)
        shown = f"{second:0{digits + 3}.{digits}f}" if digits else f"{second:02.0f}"
        mark = f" {'AP'[int(hour >= 12)]}M" if half else ""
        hour = (hour % 12 or 12) if half else hour
        cells.append(f"{hour:02.0f}:{minute:02.0f}:{shown}{mark}")
    t_ns, (remark,) = told(table(tmp_path / "log.csv", {"time": cells}))
    assert t_ns == [round(each * 1000) * 10**6 for each in seconds]
    assert remark == "the times in 'time' have no date, and count from midnight"


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
@pytest.mark.parametrize(
    "kind", [pa.time32("s"), pa.time32("ms"), pa.time64("us"), pa.time64("ns")]
)
@pytest.mark.parametrize("midnight", [1, 50, 1000])
def test_times_of_day_of_arrow_go_on_after_midnight(tmp_path, suffix, kind, midnight):
    """They were refused as no numbers."""
    per_s = 10**9 // NS[kind.unit]
    steps = (86_400 - midnight) * per_s + np.arange(200) * max(per_s // 100 * 5, 1)
    stored = pa.array(steps % (86_400 * per_s)).cast(
        pa.int32() if kind.bit_width == 32 else pa.int64()
    )
    columns = {"time": stored.cast(kind), **dict.fromkeys(RATES, pa.array([1.0] * 200))}
    path = tmp_path / f"log.{suffix}"
    if suffix == "feather":
        feather.write_feather(pa.table(columns), path)
    else:
        parquet.write_table(pa.table(columns), path, row_group_size=40)
    t_ns, (remark,) = told(path)
    assert t_ns == (steps * NS[kind.unit]).tolist()
    assert remark == "the times in 'time' have no date, and count from midnight"
    run("propagate", path, "-o", tmp_path / "o.csv", "--start", "+5s", code=0)
    assert pd.read_csv(tmp_path / "o.csv")["t_ns"].tolist() == [
        t for t in t_ns if t >= t_ns[0] + 5 * 10**9
    ]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        *(
            ("10:00:00", 36_000),
            ("12:00:00 AM", 0),
            ("12:59:59.5 pm", 46_799.5),
            (" 1:02:03 PM", 46_923),
        ),
        *(("11:00:00,5 p.m.", 82_800.5), ("10:00:00:250", 36_000.25), ("23:59:60", 86_400)),
        *(("24:00:00", None), ("13:00:00 PM", None), ("0:00:00 AM", None), ("10:60:00", None)),
    ],
)
def test_a_time_of_day(text, seconds):
    """Midnight is 12 AM, and noon 12 PM."""
    if seconds is None:
        with pytest.raises(ValueError, match=text.strip()):
            from_text(text, TIME_OF_DAY)
    else:
        assert from_text(text, TIME_OF_DAY) == seconds * 1e9


def test_a_row_without_a_time_of_day_is_lost():
    """And said."""
    lines = [f"10:00:{k:02},1,2,{k}" for k in range(50)]
    lines[9] = "noon,1,2,9"
    rates = table_rates("time,gx_dps,gy_dps,gz_dps\n" + "\n".join(lines) + "\n")
    assert len(rates.t_ns) == 49
    assert [loss.reason for loss in rates.losses] == ["'noon' in column 'time' is not a time"]


# --- GPS, and rates that are stated


@pytest.mark.parametrize(
    ("week", "time", "per_s"),
    [("gps_week", "tow", 1), ("GPS Week", "GPS TOW (s)", 1), ("week", "itow_ms", 1000),
     ("wn", "sow", 1), ("gps_week", "gps_week_seconds", 1), ("gpsWeek", "gpsTow", 1000)],
)  # fmt: skip
def test_gps_weeks_and_times_of_week(tmp_path, week, time, per_s):
    """The week ends in the log; the epoch is 1980."""
    seconds = 604_799 + np.arange(200) / 100
    columns = {week: 2300 + seconds // 604_800, time: seconds % 604_800 * per_s}
    columns[week] = columns[week].astype(int)
    t_ns, (remark,) = told(table(tmp_path / "log.csv", columns))
    expected = (315_964_800 + 2300 * 604_800) * 10**9 + np.rint(seconds * 1e9)
    assert np.abs(np.array(t_ns) - expected).max() < 1000
    assert "it is ahead of UTC, by 18 s since 2017" in remark


@pytest.mark.parametrize(
    "stated",
    [
        "samplingrate,256.0",
        "Sampling rate: 256 Hz",
        "# sample_rate = 256",
        "SampleRate (Hz);256",
        "fs=256",
    ],
)
def test_a_counter_named_as_a_clock_counts_at_a_stated_rate(stated):
    """Its unit was asked for, though it is no time."""
    rows = "".join(f"{k + 3},0.5,1,{k}\n" for k in range(60) if k not in {20, 21})
    rates = table_rates(f"{stated}\ntimestamp,gx_dps,gy_dps,gz_dps\n{rows}")
    assert rates.t_ns[:3] == [0, 3_906_250, 7_812_500]
    assert rates.t_ns[-1] == round(59 * 1e9 / 256)
    assert any("count samples, at the 256 Hz that the file states" in one for one in rates.remarks)


@pytest.mark.parametrize("stated", ["sampling rate: 5 ms", "sample rate,fast", "sampling rate,0"])
def test_what_is_no_rate_in_hz_is_none(stated):
    """The unit of the time is asked for, as before."""
    rows = "".join(f"{k},0.5,1,{k}\n" for k in range(60))
    said = refusal(f"{stated}\ntimestamp,gx_dps,gy_dps,gz_dps\n{rows}", UndeclaredError)
    assert "the unit of the time 'timestamp' is not declared" in said


# --- times that no unit reads, or that rows lack


@pytest.mark.parametrize("suffix", ["csv", "npz", "jsonl"])
@pytest.mark.parametrize("first", [45_413.41, 739_373.5])
def test_days_of_excel_and_matlab_are_named(tmp_path, suffix, first):
    """None of the units that were offered was right."""
    days = first + np.arange(100) / 100 / 86_400
    said = refusal(table(tmp_path / f"log.{suffix}", {"Time": days}), UndeclaredError)
    assert "the unit of the time 'Time', which looks like days, as of Excel or MATLAB," in said
    remedy = "made seconds since its first, 86400 times the difference, or sample_rate='HZ'"
    assert f"time_unit='s' after it is {remedy}" in said
    path = table(tmp_path / "1.npz", {"Time": (days - first) * 86_400})
    assert np.abs(np.diff(told(path, time_unit="s")[0]) - 10**7).max() < 20_000
    seconds = table(tmp_path / "2.csv", {"Time": first + np.arange(100) / 100})
    assert "days" not in refusal(seconds, UndeclaredError)


@pytest.mark.parametrize("suffix", ["csv", "parquet", "npz", "jsonl"])
@pytest.mark.parametrize("size", [2, 3, 10, 200])
def test_a_time_only_in_the_first_row_of_a_packet_is_refused(tmp_path, suffix, size):
    """The sample rate, which reads such rows, was not named."""
    times = [10.0 * k if k % size == 0 else None for k in range(400)]
    path = table(tmp_path / f"log.{suffix}", {"timestamp_ms": times})
    said = refusal(path)
    assert f"only {-(-400 // size)} of the first 400 rows have a time in 'timestamp_ms'; " in said
    assert "count rows at a steady rate with sample_rate='HZ'" in said
    assert np.diff(told(path, sample_rate=100)[0]).tolist() == [10**7] * 399


# --- files of LabVIEW


@pytest.mark.parametrize("x_columns", ["One", "No"])
@pytest.mark.parametrize("mark", ["", "\t", "\t\t\t", "\t\t\t\t"])
@pytest.mark.parametrize("comment", ["", "\tComment"])
@pytest.mark.parametrize("unit", ["deg/s", "rad/s"])
@pytest.mark.parametrize("point", [".", ","])
def test_a_file_of_labview(x_columns, mark, comment, unit, point):
    """The end of its header was taken for the names, and the units stood unread in it."""
    each = "\t{0}\t{0}\t{0}"
    head = [
        *("LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab"),
        *(f"X_Columns\t{x_columns}", "Date\t2024/05/01", "***End_of_Header***\t", "\t"),
        *("Channels\t3\t\t", "Samples" + each.format(60), "Y_Unit_Label" + each.format(unit)),
        *("X_Dimension" + each.format("Time"), "X0" + each.format("0.0E+0")),
        *("Delta_X" + each.format("0.020000"), f"***End_of_Header***{mark}"),
        f"X_Value\tGyro_X\tGyro_Y\tGyro_Z{comment}",
    ]
    has_x = x_columns == "One"
    rows = [(f"{k / 50:.6f}" if has_x else "") + f"\t{k}.5\t1.0\t-2.0" for k in range(60)]
    text = "\n".join([*head, *rows, ""]).replace(".", point)
    found = table_rates(text)
    assert found.t_ns == [20_000_000 * k for k in range(60)]
    per = np.pi / 180 if unit == "deg/s" else 1
    np.testing.assert_allclose(found.rate[7], np.array([7.5, 1, -2]) * per, rtol=1e-15)
