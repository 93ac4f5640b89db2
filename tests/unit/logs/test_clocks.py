"""The clock of a table: the best that moves, what the others say, counters, stated offsets."""

import json
import re
from datetime import UTC, datetime, timedelta
from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from quatprop import propagate, read_rates
from quatprop.cli.commands import cli
from quatprop.errors import TimelineError, UndeclaredError, UnsupportedLogError
from quatprop.tables.counters import counted

E0 = 1_700_000_000
TIMES = np.arange(300) / 100
RATES = [f"gyro_{axis}_dps" for axis in "xyz"]


def date(seconds, zone=""):
    """Return a time since 1970 as text to the millisecond."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=round(seconds * 1000))
    return moment.isoformat(timespec="milliseconds").removesuffix("+00:00") + zone


JITTER = np.random.default_rng(1).uniform(0, 3.4, len(TIMES))
CLOCKS = {
    "device_timestamp_ms": (TIMES * 1000).round().astype(int),
    "epoch (ms)": ((E0 + TIMES) * 1000).round().astype(int),
    "zoned": [date(E0 + t + 3600, "+01:00") for t in TIMES],
    "local": [date(E0 + t + 7200) for t in TIMES],
    "server_time (s)": [f"{E0 + t:.3f}" for t in TIMES + JITTER],
}
"""A clock of each rank, the best first."""


def table(path, columns):
    """Write columns and rates of 1, 2 and 3 deg/s."""
    frame = pd.DataFrame(columns).assign(**dict(zip(RATES, (1.0, 2.0, 3.0), strict=True)))
    if path.suffix == ".csv":
        frame.to_csv(path, index=False)
    elif path.suffix == ".jsonl":
        frame.to_json(path, orient="records", lines=True)
    else:
        frame.to_parquet(path)
    return path


def read(path, recwarn, **options):
    """Return the stamps of a table, and the remarks on it without its path."""
    recwarn.clear()
    t_ns = read_rates(path, **options).t_ns
    return t_ns, [str(warning.message).removeprefix(f"{path}: ") for warning in recwarn]


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
@pytest.mark.parametrize("pair", list(permutations(CLOCKS, 2)), ids=",".join)
def test_of_two_clocks_the_better_is_used_wherever_it_stands(tmp_path, recwarn, pair, suffix):
    """Local text beat the epoch, and the time of arrival that of the device: by name alone."""
    path = table(tmp_path / f"log.{suffix}", {name: CLOCKS[name] for name in pair})
    best, other = sorted(pair, key=list(CLOCKS).index)
    t_ns, remarks = read(path, recwarn)
    alone, _ = read(table(tmp_path / f"alone.{suffix}", {best: CLOCKS[best]}), recwarn)
    assert t_ns.tolist() == alone.tolist()
    if other == "server_time (s)":
        (remark,) = remarks
        assert remark.startswith(
            f"the times in 'server_time (s)' differ from those in '{best}', which are used, by up "
        )
    elif other == "local" and best != "device_timestamp_ms":
        assert remarks == [
            (
                f"the times in 'local' are those in '{best}', which are used, at a UTC offset of "
                "+02:00; to use them, name them with time_col='local'"
            )
        ]
    else:
        assert remarks == []
    # What a remark advises works, in a shell too.
    advised = re.search(r"time_col='([\w.]+)'$", remarks[0])[1] if remarks else other
    named, remarks = read(path, recwarn, time_col=advised)
    alone, _ = read(table(tmp_path / f"alone.{suffix}", {other: CLOCKS[other]}), recwarn)
    assert (named.tolist(), remarks) == (alone.tolist(), [])


@pytest.mark.parametrize("stamp", ["field.header.stamp", "device_time (ns)"])
@pytest.mark.parametrize(("jitter", "count"), [(0.5, 0), (4, 1)])
def test_the_jitter_of_arrival_is_not_remarked_on(tmp_path, recwarn, stamp, jitter, count):
    """It is that of any network: of 12 ms in what `rostopic echo -p` wrote, and remarked on."""
    arrival = "%time" if stamp.startswith("field") else "received_at (ns)"
    late = np.random.default_rng(1).uniform(0, jitter, len(TIMES))
    columns = {name: ((E0 + t) * 1e9).astype(int) for name, t in ((arrival, TIMES + late),
                                                               (stamp, TIMES))}  # fmt: skip
    names = [f"field.angular_velocity.{axis}" for axis in "xyz"]
    path = table(tmp_path / "log.csv", columns)
    if stamp.startswith("field"):
        pd.read_csv(path).rename(columns=dict(zip(RATES, names, strict=True))).to_csv(
            path, index=False
        )
    t_ns, remarks = read(path, recwarn)
    assert t_ns.tolist() == columns[stamp].tolist()
    assert len(remarks) == count
    assert all(f"in '{arrival}' differ from those in '{stamp}'" in one for one in remarks)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("value", [0, -1])
def test_a_clock_that_stands_still_is_not_the_time(tmp_path, recwarn, value, suffix):
    """It was never set; the next best is used, with a remark."""
    columns = {"device_time (s)": value, "epoch (ms)": CLOCKS["epoch (ms)"]}
    t_ns, remarks = read(table(tmp_path / f"log.{suffix}", columns), recwarn)
    assert t_ns[0] == E0 * 10**9
    assert remarks == [
        "the times in 'device_time (s)' are all the same; those in 'epoch (ms)' are used"
    ]


UNITS = {"s": 1, "ms": 1e3, "us": 1e6}


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *((f"{stem}_{unit}", unit) for unit in UNITS for stem in ("epoch", "unix", "elapsed")),
        *(("micros", "us"), ("millis", "ms"), ("uptime_ms", "ms"), ("uptime_s", "s")),
        *(("lap (ms)", "ms"), ("boot_ms", "ms")),
    ],
)
def test_a_clock_that_moves_is_used_in_its_unit_before_one_that_stands_still(
    tmp_path, recwarn, name, unit
):
    """Names such as epoch_ms were unknown, so that a device's clock that was never set was used."""
    moving = {name: np.round(TIMES * UNITS[unit], 3)}
    path = table(tmp_path / "log.csv", moving)
    t_ns, remarks = read(path, recwarn)
    assert (t_ns.tolist(), remarks) == ([k * 10**7 for k in range(300)], [])
    t_ns, remarks = read(table(path, {"device_timestamp_ms": 0, **moving}), recwarn)
    assert t_ns.tolist() == [k * 10**7 for k in range(300)]
    assert remarks == [
        f"the times in 'device_timestamp_ms' are all the same; those in '{name}' are used"
    ]


def test_a_stated_rate_is_used_before_a_clock_that_stands_still(tmp_path, recwarn):
    """Every sample had the same stamp, though the rate is known."""
    path = table(tmp_path / "log.csv", {"t_ms": [0] * 300})
    path.write_text("# Sample rate: 100 Hz\n" + path.read_text())
    t_ns, remarks = read(path, recwarn)
    assert t_ns[-1] == 2_990_000_000
    assert remarks == ["the times in 't_ms' are all the same; the sample rate is used"]


def test_two_clocks_of_one_rank_that_disagree_are_refused(tmp_path, recwarn):
    """Nothing tells which of them is right; either can be named."""
    path = table(tmp_path / "log.csv", {"epoch (s)": TIMES * 1.1, "time (s)": TIMES})
    with pytest.raises(UndeclaredError) as caught:
        read_rates(path)
    assert str(caught.value) == (
        f"{path}: the time column (one of 'epoch (s)', 'time (s)', which differ by up to 149.5 ms "
        "beyond a constant) is not declared; say it with time_col='C', or sample_rate='HZ' for "
        "rows at a steady rate"
    )
    assert read(path, recwarn, time_col="time (s)")[0][-1] == 2_990_000_000
    assert read(path, recwarn, sample_rate=50)[0][1] == 20_000_000


def test_two_clocks_of_one_rank_that_agree_are_one(tmp_path, recwarn):
    """A constant between them is where each begins to count."""
    columns = {"elapsed (s)": TIMES, "epoch (ms)": CLOCKS["epoch (ms)"]}
    t_ns, remarks = read(table(tmp_path / "log.csv", columns), recwarn)
    assert (t_ns[0], remarks) == (E0 * 10**9, [])


@pytest.mark.parametrize(
    ("offset", "seconds"),
    [("01:00", 3600), ("-07:00", -25_200), ("+0530", 19_800), ("UTC-3:30", -12_600)],
)
@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_a_stated_utc_offset_of_local_text_is_honoured(tmp_path, recwarn, offset, seconds, suffix):
    """MetaMotion says it in brackets after the name, which was taken for a unit and dropped."""
    local = {f"time ({offset})": [date(E0 + t + seconds) for t in TIMES]}
    t_ns, remarks = read(table(tmp_path / f"log.{suffix}", local), recwarn)
    assert (t_ns[0], t_ns[-1], remarks) == (E0 * 10**9, E0 * 10**9 + 2_990_000_000, [])
    both = {"epoch (ms)": CLOCKS["epoch (ms)"], **local, "elapsed (s)": TIMES}
    t_ns, remarks = read(table(tmp_path / f"both.{suffix}", both), recwarn)
    assert (t_ns[0], remarks) == (E0 * 10**9, [])


SOURCES = {
    "SensorLog": (
        ("loggingTime(txt),accelerometerTimestamp_sinceReboot(s),motionTimestamp_sinceReboot(s),"
        "motionRotationRateX(rad/s),motionRotationRateY(rad/s),motionRotationRateZ(rad/s)"),
        lambda t: f"{date(E0 + t)},{7 + t / 2},{100 + t:.2f},1,2,3",
        100,
    ),
    "SensorLog before": (
        ("Timestamp,timeIntervalSince1970,rotationRateX(rad/s),rotationRateY(rad/s),"
        "rotationRateZ(rad/s)"),
        lambda t: f"{date(E0 + t - 14_400)},{E0 + t:.2f},1,2,3",
        E0,
    ),
    "AndroSensor": (
        ("GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);GYROSCOPE Z (rad/s);Time since start in ms ;"
        "YYYY-MO-DD HH-MI-SS_SSS"),
        lambda t: f"1;2;3;{t * 1000:.0f};2015-07-12 11:05:{33 + int(t)}:{t % 1 * 1000:.0f}",
        0,
    ),
    "ST BlueST": (
        "Date,HostTimestamp (ms),NodeName,X (dps),Y (dps),Z (dps)",
        lambda t: f"12/07/2015 11:05:{33 + int(t)},{t * 1000:.0f},WESU,1,2,3",
        0,
    ),
    "Polar": (
        "Phone timestamp;sensor timestamp [ns];X [dps];Y [dps];Z [dps]",
        lambda t: f"{date(E0 + t - t % 0.2)};{round(t * 100) * 10**7};1;2;3",
        0,
    ),
    "unit alone": ("Date,lap [s],X [dps],Y [dps],Z [dps]",
                   lambda t: f"12.07.2015 11:05:33,{t:.2f},1,2,3", 0),
}  # fmt: skip


@pytest.mark.parametrize("name", SOURCES)
def test_the_clock_of_a_program_is_recognised(tmp_path, recwarn, name):
    """A date beside it, in whatever form, is not preferred and not refused."""
    header, row, first = SOURCES[name]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *map(row, TIMES), ""]))
    t_ns, remarks = read(path, recwarn)
    assert len(remarks) == (name == "SensorLog before")
    assert t_ns.tolist() == [first * 10**9 + k * 10**7 for k in range(300)]


DAYS = ["2023-11-14", "14.11.2023", "11/14/2023"]
PAIRS = [("date", "time"), ("Date", "Time"), ("day", "clock"), ("time", "date")]


@pytest.mark.parametrize("names", PAIRS, ids=",".join)
@pytest.mark.parametrize("day", DAYS)
def test_dates_and_times_of_day_in_two_columns_are_refused_or_passed_over(
    tmp_path, recwarn, names, day
):
    """To compare them ended in a KeyError, even where a number beside them is a good clock."""
    cells = {"d": day, "t": [date(E0 + t)[11:] for t in TIMES]}
    columns = {name: cells["d" if name.lower() in {"date", "day"} else "t"] for name in names}
    path = table(tmp_path / "log.csv", columns)
    with pytest.raises(UnsupportedLogError) as caught:
        read_rates(path)
    assert str(caught.value) == (
        f"{path}: '{names[0]}', '{names[1]}' hold dates that are not of ISO 8601; write them as "
        "2023-11-14T22:13:20.5 in one column, name another column with time_col='C', or count "
        "rows at a steady rate with sample_rate='HZ'"
    )
    elapsed = (TIMES * 1000).round().astype(int)
    t_ns, remarks = read(table(path, {**columns, "elapsed_ms": elapsed}), recwarn)
    assert (t_ns[-1], remarks) == (2_990_000_000, [])


STAMPS = {
    "ms": "ts_sec,ts_msec seconds,milliseconds Sec,mSec ts_sec,ts_ms t_s,t_ms",
    "us": "tv_sec,tv_usec sec,usec timestamp_sec,timestamp_usec unix_sec,unix_us TS_Sec,TS_uSec",
    "ns": "t_sec,t_nsec Seconds,Nanoseconds epoch_sec,epoch_nsec time_seconds,time_nanoseconds",
}


@pytest.mark.parametrize("count", [50, 300])
@pytest.mark.parametrize(
    ("pair", "unit"), [(pair, unit) for unit in STAMPS for pair in STAMPS[unit].split()]
)
def test_seconds_and_their_fraction_are_one_stamp(tmp_path, recwarn, pair, unit, count):
    """The fraction alone was the clock, which stepped back every second."""
    seconds, fraction = np.divmod(np.arange(count) * 10_000_000, 10**9)
    fraction = fraction // {"ms": 10**6, "us": 10**3, "ns": 1}[unit]
    columns = dict(zip(pair.split(","), (E0 + seconds, fraction), strict=True))
    for order in (1, -1):
        ordered = {name: columns[name] for name in [*columns][::order]}
        t_ns, remarks = read(table(tmp_path / "log.csv", ordered), recwarn)
        assert t_ns.tolist() == [E0 * 10**9 + k * 10**7 for k in range(count)]
        assert remarks == []


def test_whole_clocks_in_seconds_and_milliseconds_are_no_stamp_together(tmp_path, recwarn):
    """Each says the same; their sum would run at twice the rate."""
    columns = {"time_seconds": TIMES, "time_milliseconds": (TIMES * 1000).round()}
    t_ns, remarks = read(table(tmp_path / "log.csv", columns), recwarn)
    assert (t_ns[-1], remarks) == (2_990_000_000, [])


@pytest.mark.parametrize("units", list(permutations(["K", "V", "ms"], 2)), ids=",".join)
def test_clocks_in_what_is_no_unit_of_time_end_in_no_bug(tmp_path, units):
    """Temperatures and voltages of such names cannot be compared as times."""
    path = table(tmp_path / "log.csv", {f"t ({units[0]})": TIMES, f"ts ({units[1]})": TIMES})
    if "ms" in units:
        assert read_rates(path).t_ns[-1] == 2_990_000
    else:
        with pytest.raises(UndeclaredError, match=r"time column \(one of 't \(.\)', 'ts \(.\)'\)"):
            read_rates(path)


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_a_column_of_text_is_no_clock_of_a_typed_table(tmp_path, recwarn, suffix):
    """It cannot be read, whatever its name says, and a number beside it can."""
    columns = {"timestamp": CLOCKS["local"], "epoch (ms)": CLOCKS["epoch (ms)"]}
    frame = pd.DataFrame(columns).assign(**dict.fromkeys(RATES, 1.0))
    path = tmp_path / f"log.{suffix}"
    getattr(frame, f"to_{suffix}")(path)
    t_ns, remarks = read(path, recwarn)
    assert (t_ns[0], remarks) == (E0 * 10**9, [])


SENTENCES = {
    "n,wx_dps,wy_dps,wz_dps": (
        {},
        (
            "whether 'n' is the time is not declared; say it with time_col='n' and time_unit='s' "
            "or 'ms' or 'us' or 'ns', or sample_rate='HZ' for rows at a steady rate"
        ),
    ),
    "a,b,wx_dps,wy_dps,wz_dps": (
        {},
        (
            "the time column (one of 'a', 'b') is not declared; say it with time_col='C', or "
            "sample_rate='HZ' for rows at a steady rate"
        ),
    ),
    "wx_dps,wy_dps,wz_dps": (
        {},
        (
            "the time column is not declared; say it with time_col='C', or sample_rate='HZ' for "
            "rows at a steady rate"
        ),
    ),
    "PacketCounter,wx_dps,wy_dps,wz_dps": (
        {"time_col": "PacketCounter"},
        "the rate of the counter 'PacketCounter' is not declared; say it with sample_rate='HZ'",
    ),
}


@pytest.mark.parametrize("header", SENTENCES)
def test_a_refusal_offers_only_what_may_be_the_time(tmp_path, header):
    """Columns of the rates were offered, one column was one of several, a counter had a unit."""
    path = tmp_path / "log.csv"
    cells = ["5", "6", "1", "2", "3"][-(header.count(",") + 1) :]
    path.write_text(f"{header}\n" + f"{','.join(cells)}\n" * 3)
    options, sentence = SENTENCES[header]
    with pytest.raises(UndeclaredError) as caught:
        read_rates(path, **options)
    assert str(caught.value) == f"{path}: {sentence}"


@pytest.mark.parametrize("text", ["14-Nov-2023 22:13:20.{:03}", "00:00.{:03}", "Nov 14, 10.{} PM"])
@pytest.mark.parametrize("name", ["when", "timestamp"])
def test_text_that_is_named_as_the_time_is_not_asked_for_a_unit(tmp_path, name, text):
    """Whatever the unit, dates with names of months cannot be read."""
    path = table(tmp_path / "log.csv", {name: [text.format(k) for k in range(300)]})
    with pytest.raises(UnsupportedLogError) as caught:
        read_rates(path, time_col=name)
    assert str(caught.value) == (
        f"{path}: '{name}' holds dates that are not of ISO 8601; write them as "
        "2023-11-14T22:13:20.5, name another column with time_col='C', or count rows at a steady "
        "rate with sample_rate='HZ'"
    )


@pytest.mark.parametrize("options", [{}, {"start": "+1s"}])
def test_a_table_that_steps_back_is_told_of_another_column(tmp_path, options):
    """Another clock was advised, which tables refuse."""
    path = table(tmp_path / "log.csv", {"t_ms": [*range(150), *range(100, 250)]})
    with pytest.raises(TimelineError, match=r"or another time_col$"):
        propagate(path, **options)


def test_an_arrival_is_not_taken_where_another_column_may_be_the_sensors(tmp_path):
    """An unknown name with a clock's ending may be better; either can be named."""
    path = table(tmp_path / "log.csv", {"server_t": TIMES, "kit_t": TIMES})
    with pytest.raises(UndeclaredError, match=r"the time column \(one of 'server_t', 'kit_t'\)"):
        read_rates(path)
    assert len(read_rates(path, time_col="kit_t", time_unit="s").t_ns) == 300


# Counters

RATE = "// Update Rate: 100.0Hz\n"


def xsens(path, counts, head=RATE):
    """Write rows of an Xsens MTw, which have a counter."""
    rows = "".join(f"{n:05d}\t\t1\t2\t3\t\n" for n in counts)
    path.write_text(f"{head}PacketCounter\tSampleTimeFine\tGyr_X\tGyr_Y\tGyr_Z\t\n{rows}")
    return path


@pytest.mark.parametrize("bits", [8, 16, 32])
@pytest.mark.parametrize("lost", [0, 1, 30])
def test_a_counter_at_a_stated_rate_tells_of_lost_samples(tmp_path, recwarn, bits, lost):
    """Rows were counted, so that samples that were lost took no time: 23.7 s instead of 33.7."""
    first = 2**bits - 150
    numbers = [n for n in range(300) if not 140 <= n < 140 + lost]
    path = xsens(tmp_path / "log.txt", [(first + n) % 2**bits for n in numbers])
    t_ns, remarks = read(path, recwarn, rate_unit="deg/s")
    assert t_ns.tolist() == [n * 10**7 for n in numbers]
    said = f"{lost} sample{'s' * (lost > 1)} lost by the counter 'PacketCounter'"
    assert remarks == [said] * (lost > 0)


def test_the_lost_samples_of_a_counter_are_a_gap(tmp_path):
    """They are said, and the rotation over them is propagated or not as over any gap."""
    path = xsens(
        tmp_path / "log.txt",
        [n % 65536 for n in range(65000, 67000) if n not in range(65100, 66100)],
    )
    result = CliRunner().invoke(
        cli,
        [
            "propagate",
            str(path),
            "-o",
            "-",
            "--rate-unit",
            "deg/s",
            "--report",
            str(tmp_path / "r"),
        ],
    )
    assert result.exit_code == 0, result.output
    report = json.loads((tmp_path / "r").read_text())
    assert report["counts"]["gaps"]["count"] == 1
    assert report["result"]["span_s"] == pytest.approx(19.99)
    assert report["source"]["clock"] == "PacketCounter at 100 Hz"


def test_a_counter_is_used_at_a_sample_rate_unless_rows_are_to_be_counted(tmp_path, recwarn):
    """The remark says how to count rows, and that works."""
    path = xsens(tmp_path / "log.txt", [0, 1, 2, 5, 6, 7], head="")
    t_ns, remarks = read(path, recwarn, rate_unit="deg/s", sample_rate=100)
    assert t_ns.tolist() == [k * 10**7 for k in (0, 1, 2, 5, 6, 7)]
    assert remarks == [
        (
            "sample_rate='100' is that of the counter 'PacketCounter', which also counts lost "
            "samples; to count rows, give time_col='none' too"
        ),
        "2 samples lost by the counter 'PacketCounter'",
    ]
    t_ns, remarks = read(path, recwarn, rate_unit="deg/s", sample_rate=100, time_col="none")
    assert (t_ns.tolist(), remarks) == ([k * 10**7 for k in range(6)], [])
    t_ns, _ = read(path, recwarn, rate_unit="deg/s", sample_rate=100, time_col="PacketCounter")
    assert t_ns[-1] == 70_000_000


@pytest.mark.parametrize("counts", [[0, 0, 1, 1, 2, 2], [4, 4, 4], [3, 2, 1, 0], [0.5, 1.5, 2.5]])
def test_what_does_not_count_samples_is_no_counter(tmp_path, recwarn, counts):
    """Rows are counted then, as if it were not there: no loss can be seen in it."""
    path = tmp_path / "log.csv"
    rows = "".join(f"{n},1,2,3\n" for n in counts)
    path.write_text(f"# Sample rate: 100 Hz\ncounter,wx_dps,wy_dps,wz_dps\n{rows}")
    t_ns, remarks = read(path, recwarn)
    assert (t_ns.tolist(), remarks) == ([k * 10**7 for k in range(len(counts))], [])


HEAD = "# Sample rate: 100 Hz\n{},wx_dps,wy_dps,wz_dps\n"


def numbered(path, name, counts):
    """Write rows of a column that may count, at a stated rate of 100 Hz."""
    path.write_text(HEAD.format(name) + "".join(f"{n},1,2,3\n" for n in counts))
    return path


RANDOM = np.random.default_rng(3)
LOSSES = {
    "1 and 3 of 5": [n for n in range(500) if n % 5 in {1, 3}],
    "0, 1 and 4 of 8": [n for n in range(500) if n % 8 in {0, 1, 4}],
    **{f"{part:.0%}": np.flatnonzero(RANDOM.random(500) > part) for part in (0.1, 0.45, 0.55, 0.7)},
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("name", ["PacketCounter", "seq", "sample_id"])
def test_a_counter_is_used_however_many_samples_are_lost(tmp_path, recwarn, name, loss):
    """Where most were lost, so that most steps were not 1, rows were counted without a word."""
    counts = LOSSES[loss]
    t_ns, remarks = read(numbered(tmp_path / "log.csv", name, counts), recwarn)
    assert t_ns.tolist() == [int(n - counts[0]) * 10**7 for n in counts]
    lost = counts[-1] - counts[0] + 1 - len(counts)
    assert remarks == [f"{lost} samples lost by the counter '{name}'"]


@pytest.mark.parametrize("step", [2, 5])
def test_a_counter_of_larger_steps_is_not_guessed_about(tmp_path, recwarn, step):
    """Steady, it says nothing that rows do not; with gaps, only the user knows what it counts."""
    steady = numbered(tmp_path / "steady.csv", "Counter", range(0, 300 * step, step))
    t_ns, remarks = read(steady, recwarn)
    assert t_ns[-1] == 299 * 10**7
    assert remarks == [
        (
            f"the counter 'Counter', which usually steps by {step}, is not used; to use it, give "
            "time_col='Counter' and sample_rate='100'"
        )
    ]
    counts = [n * step for n in range(300) if n % 10]
    path = numbered(tmp_path / "log.csv", "Counter", counts)
    for options in ({}, {"sample_rate": 100}):
        with pytest.raises(UndeclaredError) as caught:
            read_rates(path, **options)
        assert str(caught.value) == (
            f"{path}: whether the counter 'Counter', which usually steps by {step}, counts samples "
            "is not declared; say it with time_col='Counter' and sample_rate='100' if it does, or "
            "time_col='none' and sample_rate='100' to count rows"
        )
    rows, remarks = read(path, recwarn, time_col="none", sample_rate=100)
    assert (rows[-1], remarks) == (269 * 10**7, [])
    samples, _ = read(path, recwarn, time_col="Counter", sample_rate=100)
    assert samples[-1] == (counts[-1] - counts[0]) * 10**7


@pytest.mark.parametrize("name", ["frame", "index", "count", "Sample", "N"])
def test_numbers_of_rows_that_have_gaps_are_remarked_on(tmp_path, recwarn, name):
    """Rows were counted without a word, though samples are missing."""
    path = numbered(tmp_path / "log.csv", name, [n for n in range(300) if n % 10])
    t_ns, remarks = read(path, recwarn)
    assert t_ns[-1] == 269 * 10**7
    assert remarks == [
        (
            f"'{name}' passes over numbers, as if samples were lost, but rows are counted; to "
            f"count by it, give time_col='{name}' and sample_rate='100'"
        )
    ]
    t_ns, remarks = read(path, recwarn, time_col=name, sample_rate=100)
    assert (t_ns[-1], remarks) == (298 * 10**7, [f"29 samples lost by the counter '{name}'"])
    _, remarks = read(numbered(path, name, range(300)), recwarn)
    assert remarks == []


@pytest.mark.parametrize("cut", [1, 7, 150, 299])
def test_a_counter_goes_on_from_batch_to_batch(cut):
    """Wherever a batch ends, also where the counter begins again."""
    values = (np.arange(300) + 65_400) % 65536
    whole = counted(values)
    first = counted(values[:cut])
    rest = counted(values[cut:], (int(values[cut - 1]), int(first[-1])))
    assert np.concatenate([first, rest]).tolist() == whole.tolist() == list(range(300))


def test_a_counter_that_begins_anew_steps_back():
    """Far from the end of its range it was reset, and nobody knows what was lost."""
    assert counted(np.array([40_000, 40_001, 0, 1])).tolist() == [0, 1, -40_000, -39_999]


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_a_counter_gives_attitudes_as_stamps_do(tmp_path):
    """Through the whole run."""
    path = xsens(tmp_path / "log.txt", [0, 1, 2, 12, 13])
    attitudes = propagate(path, rate_unit="deg/s")
    assert attitudes.t_ns.tolist() == [0, 10**7, 2 * 10**7, 12 * 10**7, 13 * 10**7]


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_one_damaged_count_is_an_outlier_and_hides_no_other(tmp_path):
    """The counter is used all the same, and the policy for such stamps counts."""
    path = xsens(tmp_path / "log.txt", [*range(50), 90_000, *range(51, 99)])
    with pytest.raises(TimelineError, match=r"sample 50 .* is an outlier, 899.51 s ahead"):
        propagate(path, rate_unit="deg/s")
    for policy in ("drop", "sort"):
        kept = propagate(path, rate_unit="deg/s", on_backwards=policy).t_ns
        assert (len(kept), kept[97]) == (98, 98 * 10**7)


@pytest.mark.parametrize("count", [10**17, 9 * 10**18])
def test_counts_beyond_the_clock_are_refused_with_a_way_out_that_works(tmp_path, recwarn, count):
    """Far behind the first rows, where the counter was taken for one."""
    path = xsens(tmp_path / "log.txt", [*range(1500), count])
    with pytest.raises(UnsupportedLogError) as caught:
        read_rates(path, rate_unit="deg/s")
    assert str(caught.value) == (
        f"{path}: at 100 Hz, the counts in column 'PacketCounter' do not fit in int64 ns; count "
        "rows with sample_rate='100' and time_col='none'"
    )
    t_ns, _ = read(path, recwarn, rate_unit="deg/s", sample_rate="100", time_col="none")
    assert t_ns[-1] == 15 * 10**9


def test_stamps_beside_a_counter_that_is_used_are_named(tmp_path, recwarn):
    """Samples are counted, and not the rows."""
    columns = {"counter": range(300), "server_time (s)": TIMES}
    _, remarks = read(table(tmp_path / "log.csv", columns), recwarn, sample_rate=100)
    assert remarks[1] == (
        "sample_rate='100' counts the samples; the stamps in 'server_time (s)' are not used"
    )
