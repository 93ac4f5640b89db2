"""The clock of a table: the best that moves, what the others say, counters, stated offsets."""

import json
import re
from datetime import UTC, datetime, timedelta
from itertools import permutations

import numpy as np
import pandas as pd
import pytest
from make.commands import run
from make.table_rates import refusal, told

from quatprop import propagate
from quatprop.base.errors import TimelineError, UndeclaredError
from quatprop.readers.clock_difference import difference
from quatprop.readers.tables.table_log import counted

E0 = 1_700_000_000
TIMES = np.arange(300) / 100
HEAD = "# Sample rate: 100 Hz\n"
STEADY = [k * 10**7 for k in range(300)]
SINCE_1970 = [E0 * 10**9 + t for t in STEADY]
RATES = [f"gyro_{axis}_dps" for axis in "xyz"]


def date(seconds, zone=""):
    """Return a time since 1970 as text to the millisecond."""
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(milliseconds=round(seconds * 1000))
    return moment.isoformat(timespec="milliseconds").removesuffix("+00:00") + zone


LATE = (TIMES + np.random.default_rng(1).uniform(0, 3.4, len(TIMES))).round(3)
CLOCKS = {
    "device_timestamp_ms": ((TIMES * 1000).round().astype(int), STEADY),
    "epoch (ms)": (((E0 + TIMES) * 1000).round().astype(int), SINCE_1970),
    "zoned": ([date(E0 + t + 3600, "+01:00") for t in TIMES], SINCE_1970),
    "local": ([date(E0 + t + 7200) for t in TIMES], [t + 7200 * 10**9 for t in SINCE_1970]),
    "server_time (s)": (
        [f"{E0 + t:.3f}" for t in LATE],
        [E0 * 10**9 + round(t * 1000) * 10**6 for t in LATE],
    ),
}
"""A clock of each rank and its stamps, the best first."""
EPOCH = {"epoch (ms)": CLOCKS["epoch (ms)"][0]}


def table(path, columns, rates=RATES):
    """Write columns and rates of 1, 2 and 3 deg/s."""
    frame = pd.DataFrame(columns).assign(**dict(zip(rates, (1.0, 2.0, 3.0), strict=True)))
    if path.suffix == ".csv":
        frame.to_csv(path, index=False)
    elif path.suffix == ".jsonl":
        frame.to_json(path, orient="records", lines=True)
    else:
        getattr(frame, f"to_{path.suffix[1:]}")(path)
    return path


REPEATED = {
    "as they are": lambda name, _: name,
    "numbered by pandas": lambda name, k: f"{name}.{k}" if k else name,
    "numbered by polars": lambda name, k: f"{name}_duplicated_{k - 1}" if k else name,
}
"""How names of columns are repeated."""


@pytest.mark.thorough
@pytest.mark.parametrize("repeated", REPEATED)
@pytest.mark.parametrize("place", range(4))
@pytest.mark.parametrize(
    ("stands", "name", "apart"),
    [("before", "Time (s)", 0.022), ("after", "time_s", -5.0), ("before", "X [s]", 0.022)],
)
def test_of_clocks_of_one_name_that_next_to_the_rates_is_used(  # noqa: PLR0913, PLR0917
    tmp_path, repeated, place, stands, name, apart
):
    """The first was used, which was that of another sensor, and off by seconds."""
    blocks = ["acc", "mag", "emg"]
    blocks.insert(place, "gyro")
    header, columns = [], []
    for k, block in enumerate(blocks):
        axes = [f"gyro_{axis}_dps" if block == "gyro" else f"{block}_{axis}" for axis in "xyz"]
        clock = REPEATED[repeated](name, k)
        header += [clock, *axes] if stands == "before" else [*axes, clock]
        times, data = 1000 + TIMES + apart * k, np.ones((3, len(TIMES)))
        columns += [times, *data] if stands == "before" else [*data, times]
    rows = (",".join(f"{cell:.6f}" for cell in row) for row in zip(*columns, strict=True))
    path = tmp_path / "log.csv"
    path.write_text("\n".join([",".join(header), *rows]))
    t_ns, remarks = told(path)
    first = blocks.index("gyro")
    assert t_ns[0] == round((1000 + apart * first) * 1e9)
    assert len(remarks) == len(blocks) - 1
    for remark in remarks:
        advised = re.search(r"time_col='(.+)'$", remark)[1]
        block = (int(advised) if advised.isdecimal() else header.index(advised)) // 4
        side = "ahead of" if (block - first) * apart > 0 else "behind"
        assert re.match(rf"the times in '.*' (\(column \d+\) )?are \d.* {side} those in", remark)
    assert told(path, time_col=advised)[0][0] == round((1000 + apart * block) * 1e9)


@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
@pytest.mark.parametrize("pair", list(permutations(CLOCKS, 2)), ids=",".join)
def test_of_two_clocks_the_better_is_used_wherever_it_stands(tmp_path, pair, suffix):
    """Local text beat the epoch, and the time of arrival that of the device: by name alone."""
    path = table(tmp_path / f"log.{suffix}", {name: CLOCKS[name][0] for name in pair})
    best, other = sorted(pair, key=list(CLOCKS).index)
    t_ns, remarks = told(path)
    assert t_ns == CLOCKS[best][1]
    expected = ""
    if other == "server_time (s)":
        expected = f"the times in 'server_time (s)' differ from those in '{best}', which are used, "
    elif other == "local" and best != "device_timestamp_ms":
        expected = (
            f"the times in 'local' are those in '{best}', which are used, at a UTC offset of "
            "+02:00; to use them, name them with time_col='local'"
        )
    assert [remark[: len(expected)] for remark in remarks] == [expected] * bool(expected)
    # The advice of a remark works, in a shell too.
    advised = re.search(r"time_col='([\w.]+)'$", remarks[0])[1] if remarks else other
    assert told(path, time_col=advised) == (CLOCKS[other][1], [])


@pytest.mark.parametrize("arrival", ["%time", "received_at (ns)"])
@pytest.mark.parametrize(("jitter", "count"), [(0.5, 0), (4, 1)])
def test_the_jitter_of_arrival_is_not_remarked_on(tmp_path, arrival, jitter, count):
    """It is that of any network: of 12 ms in what `rostopic echo -p` wrote, and remarked on."""
    late = np.random.default_rng(1).uniform(0, jitter * 1e9, len(TIMES)).astype(int)
    stamp, rates = "device_time (ns)", RATES
    if arrival == "%time":
        stamp, rates = "field.header.stamp", [f"field.angular_velocity.{axis}" for axis in "xyz"]
    path = table(tmp_path / "log.csv", {arrival: SINCE_1970 + late, stamp: SINCE_1970}, rates)
    t_ns, remarks = told(path)
    assert (t_ns, len(remarks)) == (SINCE_1970, count)
    assert all(f"in '{arrival}' differ from those in '{stamp}'" in one for one in remarks)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize(("row", "count"), [(999, 1), (1000, 0)])
def test_clocks_are_compared_over_the_first_thousand_rows(tmp_path, suffix, row, count):
    """Their later rows are not examined."""
    millis = 10 * np.arange(1100)
    jump = E0 * 1000 + millis + 60_000 * (millis >= 10 * row)
    clocks = {"device_timestamp_ms": millis, "epoch (ms)": jump}
    t_ns, remarks = told(table(tmp_path / f"log.{suffix}", clocks))
    assert t_ns == (10**6 * millis).tolist()
    assert len(remarks) == count


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("value", [0, -1])
def test_a_clock_that_stands_still_is_not_the_time(tmp_path, value, suffix):
    """It was never set; the next best is used, with a remark."""
    path = table(tmp_path / f"log.{suffix}", {"device_time (s)": value, **EPOCH})
    remark = "the times in 'device_time (s)' are all the same; those in 'epoch (ms)' are used"
    assert told(path) == (SINCE_1970, [remark])


PER_SECOND = {"s": 1, "ms": 1e3, "us": 1e6}
MOVING = [(f"{stem}_{unit}", unit) for unit in PER_SECOND for stem in ("epoch", "unix", "elapsed")]
MOVING += [("micros", "us"), ("millis", "ms"), ("uptime_ms", "ms"), ("uptime_s", "s")]
MOVING += [("lap (ms)", "ms"), ("boot_ms", "ms")]


@pytest.mark.parametrize(("name", "unit"), MOVING)
def test_a_clock_that_moves_is_used_in_its_unit_before_one_that_stands_still(tmp_path, name, unit):
    """Names such as epoch_ms were unknown, so that a device's clock that was never set was used."""
    moving = {name: np.round(TIMES * PER_SECOND[unit], 3)}
    path = table(tmp_path / "log.csv", moving)
    assert told(path) == (STEADY, [])
    remark = f"the times in 'device_timestamp_ms' are all the same; those in '{name}' are used"
    assert told(table(path, {"device_timestamp_ms": 0, **moving})) == (STEADY, [remark])


def test_a_stated_rate_is_used_before_a_clock_that_stands_still(tmp_path):
    """Every sample had the same stamp, though the rate is known."""
    path = table(tmp_path / "log.csv", {"t_ms": [0] * 300})
    path.write_text(HEAD + path.read_text())
    remark = "the times in 't_ms' are all the same; the sample rate is used"
    assert told(path) == (STEADY, [remark])


@pytest.mark.parametrize(
    "columns",
    [
        {"when": CLOCKS["local"][0], "PacketCounter": range(300)},
        {"when": [f"11/14/2023 10:13:{t:02.0f} PM" for t in TIMES]},
    ],
)
def test_a_stated_rate_is_used_before_dates_that_tell_less(tmp_path, columns):
    """Those next to a counter of samples, and those that may be read in several ways."""
    path = table(tmp_path / "log.csv", columns)
    path.write_text(HEAD + path.read_text())
    assert told(path) == (STEADY, [])


def test_two_clocks_of_one_rank_that_disagree_are_refused(tmp_path):
    """Nothing tells which of them is right; either can be named."""
    path = table(tmp_path / "log.csv", {"epoch (s)": TIMES * 1.1, "time (s)": TIMES})
    assert refusal(path, UndeclaredError) == (
        "the time column (one of 'epoch (s)', 'time (s)', which differ by up to 149.5 ms "
        "beyond a constant) is not declared; specify it with time_col='C', or sample_rate='HZ' for "
        "rows at a steady rate"
    )
    assert told(path, time_col="time (s)")[0] == STEADY
    assert told(path, sample_rate=50)[0][1] == 20_000_000
    # A constant between them is where each begins to count.
    assert told(table(path, {"elapsed (s)": TIMES, **EPOCH})) == (SINCE_1970, [])
    # Seconds and milliseconds that say the same are not added.
    whole = {"time_seconds": TIMES, "time_milliseconds": (TIMES * 1000).round()}
    assert told(table(path, whole)) == (STEADY, [])


@pytest.mark.parametrize(
    ("offset", "seconds"),
    [("01:00", 3600), ("-07:00", -25_200), ("+0530", 19_800), ("UTC-3:30", -12_600)],
)
@pytest.mark.parametrize("suffix", ["csv", "jsonl"])
def test_a_stated_utc_offset_of_local_text_is_honoured(tmp_path, offset, seconds, suffix):
    """MetaMotion says it in brackets after the name, which was taken for a unit and dropped."""
    local = {f"time ({offset})": [date(E0 + t + seconds) for t in TIMES]}
    path = table(tmp_path / f"log.{suffix}", local)
    assert told(path) == (SINCE_1970, [])
    # A cell that is no date does not count where it is compared.
    local[f"time ({offset})"][0] = "?"
    assert told(table(path, {**EPOCH, **local, "elapsed (s)": TIMES})) == (SINCE_1970, [])


HOUR = 3600
SINCE_2023 = E0 * 1e9 + np.arange(9) * 1e7


@pytest.mark.parametrize(
    ("used", "seconds", "found"),
    [
        (SINCE_2023, HOUR, (HOUR, 0)),
        (SINCE_2023, -900, (-900, 0)),
        (SINCE_2023, HOUR + 1, (HOUR, 0)),
        (SINCE_2023, HOUR - 1, (HOUR, 0)),
        (SINCE_2023, HOUR + 1.5, None),
        (SINCE_2023, 420, None),
        (SINCE_2023, 0, None),
        (SINCE_2023, 14 * HOUR, (14 * HOUR, 0)),
        (SINCE_2023, 14 * HOUR + 900, None),
        # Before 2000 neither is a date.
        (SINCE_2023 - SINCE_2023[0], HOUR, None),
        # A deviation of a step is rounding.
        (SINCE_2023, np.where(np.arange(9) == 4, 0.01, 0), None),
        (SINCE_2023, np.where(np.arange(9) == 4, 0.02, 0), (0, 0.02)),
        (SINCE_2023, np.where(np.arange(9) < 7, np.nan, HOUR), (HOUR, 0)),
        (SINCE_2023, np.where(np.arange(9) < 8, np.nan, HOUR), None),
    ],
)
def test_clocks_differ_by_a_utc_offset_or_by_more_than_their_steps(used, seconds, found):
    """Offsets are whole quarters of an hour up to 14 hours, to a second."""
    differ = difference(used, used + np.multiply(seconds, 1e9))
    assert (differ and tuple(np.divide(differ, 1e9).tolist())) == found


SOURCES = {
    "SensorLog": (
        (
            "loggingTime(txt),accelerometerTimestamp_sinceReboot(s),motionTimestamp_sinceReboot(s),"
            "motionRotationRateX(rad/s),motionRotationRateY(rad/s),motionRotationRateZ(rad/s)"
        ),
        lambda t: f"{date(E0 + t)},{7 + t / 2},{100 + t:.2f},1,2,3",
        100,
    ),
    "SensorLog before": (
        (
            "Timestamp,timeIntervalSince1970,rotationRateX(rad/s),rotationRateY(rad/s),"
            "rotationRateZ(rad/s)"
        ),
        lambda t: f"{date(E0 + t - 14_400)},{E0 + t:.2f},1,2,3",
        E0,
    ),
    "AndroSensor": (
        (
            "GYROSCOPE X (rad/s);GYROSCOPE Y (rad/s);GYROSCOPE Z (rad/s);Time since start in ms ;"
            "YYYY-MO-DD HH-MI-SS_SSS"
        ),
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
    "unit alone": (
        "Date,lap [s],X [dps],Y [dps],Z [dps]",
        lambda t: f"12.07.2015 11:05:33,{t:.2f},1,2,3",
        0,
    ),
}


@pytest.mark.parametrize("name", SOURCES)
def test_the_clock_of_a_program_is_recognised(tmp_path, name):
    """A date next to it, in whatever form, is not preferred and not refused."""
    header, row, first = SOURCES[name]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([header, *map(row, TIMES), ""]))
    t_ns, remarks = told(path)
    assert len(remarks) == (name == "SensorLog before")
    assert t_ns == [first * 10**9 + t for t in STEADY]


NO_DATES = (
    "hold{} {}; write the times as 2023-11-14T22:13:20.5{}, name another column "
    "with time_col='C', or count rows at a steady rate with sample_rate='HZ'"
)


@pytest.mark.parametrize(
    ("names", "day"),
    [
        ("date,time", "2023-11-14"),
        ("Date,Time", "14.11.2023"),
        ("day,clock", "11/14/2023"),
        ("time,date", "2023-11-14"),
        ("day,clock", "14.11.2023"),
    ],
)
def test_times_of_day_next_to_dates_count_from_midnight(tmp_path, names, day):
    """Comparing them ended in a KeyError, even if a number next to them is a good clock."""
    times = [date(E0 + t)[11:] for t in TIMES]
    names = names.split(",")
    columns = {name: day if name.lower() in {"date", "day"} else times for name in names}
    path = table(tmp_path / "log.csv", columns)
    t_ns, (remark,) = told(path)
    assert t_ns == [E0 % 86_400 * 10**9 + t for t in STEADY]
    assert remark.endswith("have no date, and count from midnight")
    path = table(path, {**columns, "elapsed_ms": CLOCKS["device_timestamp_ms"][0]})
    assert told(path) == (STEADY, [])


@pytest.mark.parametrize(
    ("cell", "named"),
    [
        *((cell, False) for cell in ("2023/11/14 22:13:{:06.3f}", "11/14/2023 10:13:{:02.0f} PM")),
        ("14.11.2023 22:13:{:02.0f}", False),
        # Whatever the unit, dates with names of months cannot be read.
        *(
            (cell, True)
            for cell in ("14-Nov-2023 22:13:20.{:.0f}", "00:00.{:.3f}", "Nov 14, {} PM")
        ),
    ],
)
@pytest.mark.parametrize("name", ["when", "timestamp"])
def test_dates_that_may_be_read_in_several_ways_are_refused(tmp_path, cell, named, name):
    """Text that is named as the time was requested its unit."""
    path = table(tmp_path / "log.csv", {name: [cell.format(t) for t in TIMES]})
    options = {"time_col": name} if named or name == "when" else {}
    dates = "dates that are not of ISO 8601"
    what = "text that is neither a number nor a date of ISO 8601" if named else dates
    assert refusal(path, **options) == f"'{name}' " + NO_DATES.format("s", what, "")
    assert told(path, sample_rate=100, time_col="none")[0] == STEADY


@pytest.mark.parametrize("unit", ["s", "min", "hr", "days"])
def test_durations_that_are_text_are_no_dates(tmp_path, unit):
    """As MATLAB may write them; the error names an option that works."""
    path = table(tmp_path / "log.csv", {"Time": [f"{980 + t} {unit}" for t in TIMES]})
    assert refusal(path).startswith("'Time' holds text that is neither a number nor a date of ISO")
    assert told(path, sample_rate=100)[0] == STEADY


STAMPS = {
    10**6: "ts_sec,ts_msec seconds,milliseconds Sec,mSec ts_sec,ts_ms t_s,t_ms",
    10**3: "tv_sec,tv_usec sec,usec timestamp_sec,timestamp_usec unix_sec,unix_us TS_Sec,TS_uSec",
    1: "t_sec,t_nsec Seconds,Nanoseconds epoch_sec,epoch_nsec time_seconds,time_nanoseconds",
}


@pytest.mark.parametrize("count", [50, 300])
@pytest.mark.parametrize(
    ("pair", "unit_ns"), [(pair, unit) for unit, pairs in STAMPS.items() for pair in pairs.split()]
)
def test_seconds_and_their_fraction_are_one_stamp(tmp_path, pair, unit_ns, count):
    """The fraction alone was the clock, which stepped back every second."""
    seconds, fraction = np.divmod(STEADY[:count], 10**9)
    columns = dict(zip(pair.split(","), (E0 + seconds, fraction // unit_ns), strict=True))
    for order in (1, -1):
        ordered = {name: columns[name] for name in [*columns][::order]}
        assert told(table(tmp_path / "log.csv", ordered)) == (SINCE_1970[:count], [])


def test_seconds_next_to_their_fraction_in_two_units_are_refused(tmp_path):
    """The second fraction is another clock, which steps back."""
    seconds, fraction = np.divmod(STEADY, 10**9)
    columns = {"t_sec": E0 + seconds, "t_nsec": fraction, "t_usec": fraction // 1000}
    words = refusal(table(tmp_path / "log.csv", columns), UndeclaredError)
    assert "the time column (one of 't_sec', 't_usec', which differ by up to 1 s" in words


WHOLE = [k // 50 for k in range(150)]


@pytest.mark.parametrize(
    ("seconds", "unit", "fraction"),
    [
        # Seconds with decimals are a stamp by themselves, even behind a row that has none.
        ([k / 50 for k in range(150)], "nsec", [k * 20_000_000 % 10**9 for k in range(150)]),
        (["?", *(k / 50 for k in range(1, 150))], "nsec", [0] * 150),
        # And so are parts that go on beyond a second.
        (WHOLE, "msec", [20 * k for k in range(150)]),
        (WHOLE, "nsec", [20_000_000 * k for k in range(150)]),
        (WHOLE, "msec", [20 * (k % 51) for k in range(150)]),
        (WHOLE, "nsec", [40_000_000 * (k % 51) for k in range(150)]),
    ],
)
def test_a_whole_stamp_next_to_another_is_no_fraction_of_it(tmp_path, seconds, unit, fraction):
    """Nobody can tell which of the two is meant."""
    path = table(tmp_path / "log.csv", {"t_sec": seconds, f"t_{unit}": fraction})
    names = f"'t_sec', 't_{unit}'"
    assert f"the time column (one of {names})" in refusal(path, UndeclaredError)


def test_nanoseconds_may_go_on_a_little_beyond_a_second(tmp_path):
    """As in odd messages of ROS; it was not said."""
    parts = [20_000_000 * k for k in range(100)]
    path = table(tmp_path / "log.csv", {"t_sec": [7] * 100, "t_nsec": parts})
    t_ns, (remark,) = told(path)
    assert t_ns == [7 * 10**9 + part for part in parts]
    assert remark.startswith("'t_nsec', the fraction of a second, reaches a second or more")


@pytest.mark.parametrize("units", list(permutations(["K", "V", "ms"], 2)), ids=",".join)
def test_clocks_in_what_is_no_unit_of_time_end_in_no_bug(tmp_path, units):
    """Temperatures and voltages of such names cannot be compared as times."""
    path = table(tmp_path / "log.csv", {f"t ({units[0]})": TIMES, f"ts ({units[1]})": TIMES})
    if "ms" in units:
        assert told(path)[0][-1] == 2_990_000
    else:
        names = "'t ({})', 'ts ({})'".format(*units)
        assert f"the time column (one of {names})" in refusal(path, UndeclaredError)


@pytest.mark.parametrize("suffix", ["parquet", "feather"])
def test_a_column_of_text_is_no_clock_of_a_typed_table(tmp_path, suffix):
    """It cannot be read, whatever its name says, and a number next to it can."""
    path = table(tmp_path / f"log.{suffix}", {"timestamp": CLOCKS["local"][0], **EPOCH})
    assert told(path) == (SINCE_1970, [])


SAID = " is not declared; specify it with "
TIME_UNITS = "time_unit='s' or 'ms' or 'us' or 'ns'"
STEADILY = "sample_rate='HZ' for rows at a steady rate"
ONE_OF = f"{SAID}time_col='C', or {STEADILY}"
HZ = "sample_rate='HZ'"


@pytest.mark.parametrize(
    ("names", "options", "sentence"),
    [
        ("n,", {}, (f"whether 'n' is the time{SAID}time_col='n' and {TIME_UNITS}, time_col='n' and "
                   f"{HZ} if it counts ticks, or {STEADILY}")),
        ("a,b,", {}, f"the time column (one of 'a', 'b'){ONE_OF}"),
        ("", {}, f"the time column{ONE_OF}"),
        # An unknown name with a clock's ending may be better than an arrival.
        ("server_t,kit_t,", {}, f"the time column (one of 'server_t', 'kit_t'){ONE_OF}"),
        ("Counter,", {"time_col": "Counter"}, f"the rate of the counter 'Counter'{SAID}{HZ}"),
    ],
)  # fmt: skip
def test_a_refusal_offers_only_what_may_be_the_time(names, options, sentence):
    """Columns of the rates were offered, one column was one of several, a counter had a unit."""
    row = "5," * names.count(",") + "1,2,3\n"
    text = f"{names}wx_dps,wy_dps,wz_dps\n{3 * row}"
    assert refusal(text, UndeclaredError, **options) == sentence


@pytest.mark.parametrize("options", [{}, {"start": "+1s"}])
def test_a_table_that_steps_back_is_told_of_another_column(tmp_path, options):
    """Another clock was advised, which tables refuse; sensors one after another were sorted."""
    path = table(tmp_path / "log.csv", {"t_ms": [*range(150), *range(100, 250)]})
    with pytest.raises(TimelineError, match=r"time_col, series='C=VALUE' if .*, or cut the"):
        propagate(path, **options)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_a_table_whose_times_say_little_is_told_of_another_column(tmp_path):
    """Another clock was advised here too."""
    remarks = propagate(table(tmp_path / "log.csv", {"t_s": [1] * 5 + [2] * 5})).report.remarks
    assert any("other timestamps with time_col" in one for one in remarks)
    with pytest.raises(TimelineError, match="other timestamps with time_col, or count rows"):
        propagate(table(tmp_path / "equal.csv", {"t_s": [7] * 9}))


# Counters

DEGREES = {"rate_unit": "deg/s"}


def xsens(path, counts, head="// Update Rate: 100.0Hz\n"):
    """Write rows of an Xsens MTw, which have a counter."""
    rows = "".join(f"{n:05d}\t\t1\t2\t3\t\n" for n in counts)
    path.write_text(f"{head}PacketCounter\tSampleTimeFine\tGyr_X\tGyr_Y\tGyr_Z\t\n{rows}")
    return path


def numbered(path, name, counts):
    """Write rows of a column that may count, at a stated rate of 100 Hz."""
    table(path, {name: counts})
    path.write_text(HEAD + path.read_text())
    return path


@pytest.mark.parametrize("bits", [8, 16, 32])
@pytest.mark.parametrize("lost", [0, 1, 30])
def test_a_counter_at_a_stated_rate_tells_of_lost_samples(tmp_path, bits, lost):
    """Rows were counted, so that samples that were lost took no time: 23.7 s instead of 33.7."""
    numbers = [n for n in range(300) if not 140 <= n < 140 + lost]
    path = xsens(tmp_path / "log.txt", [(2**bits - 150 + n) % 2**bits for n in numbers])
    said = f"{lost} sample{'s' * (lost > 1)} lost by the counter 'PacketCounter'"
    assert told(path, **DEGREES) == ([n * 10**7 for n in numbers], [said] * (lost > 0))


def test_a_clock_that_wraps_around_next_to_a_counter_is_continued(tmp_path):
    """As that of a Movella DOT does; it was refused, and its counter of samples not named."""
    path = tmp_path / "dot.csv"
    rows = [f"{k},{(2**32 - 50_000 + 16_667 * k) % 2**32},0,0,0,1,2,3" for k in range(6)]
    names = "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,Gyr_X,Gyr_Y,Gyr_Z"
    path.write_text("\n".join([names, *rows, ""]))
    t_ns, (remark,) = told(path)
    assert np.diff(t_ns).tolist() == [16_667_000] * 5
    assert remark.startswith("the time wrapped around 1 time after 4294.97 s")
    assert told(path, time_col="PacketCounter", sample_rate=100)[0] == STEADY[:6]


def test_the_lost_samples_of_a_counter_are_a_gap(tmp_path):
    """They are reported, and handled like any gap."""
    counts = [n % 65536 for n in range(65000, 67000) if n not in range(65100, 66100)]
    path, report = xsens(tmp_path / "log.txt", counts), tmp_path / "r"
    run("propagate", path, "-o", "-", "--rate-unit", "deg/s", "--report", report, code=0)
    report = json.loads(report.read_text())
    assert report["counts"]["gaps"]["count"] == 1
    assert report["result"]["span_s"] == pytest.approx(19.99)
    assert report["source"]["clock"] == "PacketCounter at 100 Hz"


def test_a_counter_is_used_at_a_sample_rate_unless_rows_are_to_be_counted(tmp_path):
    """The remark says how to count rows, and that works."""
    path = xsens(tmp_path / "log.txt", [0, 1, 2, 5, 6, 7], head="")
    options = {"sample_rate": 100, **DEGREES}
    by_counter = [k * 10**7 for k in (0, 1, 2, 5, 6, 7)]
    assert told(path, **options) == (
        by_counter,
        [
            (
                "sample_rate='100' is the rate of the counter 'PacketCounter', which also "
                "counts lost "
                "samples; to count rows, give time_col='none' too"
            ),
            "2 samples lost by the counter 'PacketCounter'",
        ],
    )
    t_ns, (remark,) = told(path, time_col="none", **options)
    assert t_ns == STEADY[:6]
    assert remark == (
        "'PacketCounter' passes over 2 numbers before row 4, but rows are counted, as requested; "
        "to count by it, give time_col='PacketCounter' and sample_rate='100'"
    )
    assert told(path, time_col="PacketCounter", **options)[0] == by_counter


@pytest.mark.parametrize("counts", [[0, 0, 1, 1, 2, 2], [4, 4, 4], [3, 2, 1, 0], [0.5, 1.5, 2.5]])
def test_what_does_not_count_samples_is_no_counter(tmp_path, counts):
    """Rows are counted then, as if it were not there: no loss can be seen in it."""
    path = numbered(tmp_path / "log.csv", "counter", counts)
    assert told(path) == (STEADY[: len(counts)], [])


RANDOM = np.random.default_rng(3)
LOSSES = {
    "1 and 3 of 5": [n for n in range(500) if n % 5 in {1, 3}],
    "0, 1 and 4 of 8": [n for n in range(500) if n % 8 in {0, 1, 4}],
    **{f"{part:.0%}": np.flatnonzero(RANDOM.random(500) > part) for part in (0.1, 0.45, 0.55, 0.7)},
}


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("name", ["PacketCounter", "seq", "sample_id"])
def test_a_counter_is_used_however_many_samples_are_lost(tmp_path, name, loss):
    """Where most were lost, so that most steps were not 1, rows were counted without a word."""
    counts = LOSSES[loss]
    lost = counts[-1] - counts[0] + 1 - len(counts)
    assert told(numbered(tmp_path / "log.csv", name, counts)) == (
        [int(n - counts[0]) * 10**7 for n in counts],
        [f"{lost} samples lost by the counter '{name}'"],
    )


@pytest.mark.parametrize("step", [2, 5])
def test_a_counter_of_larger_steps_is_not_guessed_about(tmp_path, step):
    """Steady, it says nothing that rows do not; with gaps, only the user knows what it counts."""
    path = numbered(tmp_path / "log.csv", "Counter", range(0, 300 * step, step))
    what = f"the counter 'Counter', which usually steps by {step},"
    by_counter = {"time_col": "Counter", "sample_rate": 100}
    remark = f"{what} is not used; to use it, give time_col='Counter' and sample_rate='100'"
    assert told(path) == (STEADY, [remark])
    counts = [n * step for n in range(300) if n % 10]
    numbered(path, "Counter", counts)
    for options in ({}, {"sample_rate": 100}):
        assert refusal(path, UndeclaredError, **options) == (
            f"whether {what} counts samples is not declared; specify it with "
            f"time_col='Counter' and "
            "sample_rate='100' if it does, or time_col='none' and sample_rate='100' to count rows"
        )
    t_ns, (remark,) = told(path, time_col="none", sample_rate=100)
    assert t_ns == STEADY[:270]
    assert "'Counter' passes over 29 numbers in 29 places, first before row 10, but" in remark
    assert told(path, **by_counter)[0] == [(n - counts[0]) * 10**7 for n in counts]


@pytest.mark.parametrize("name", ["frame", "index", "count", "Sample", "N"])
def test_numbers_of_rows_that_have_gaps_are_remarked_on(tmp_path, name):
    """Rows were counted without a word, though samples are missing."""
    path = numbered(tmp_path / "log.csv", name, [n for n in range(300) if n % 10])
    remark = (
        f"'{name}' passes over 29 numbers in 29 places, first before row 10, but rows are counted, "
        f"as if all were there; to count by it, give time_col='{name}' and sample_rate='100'"
    )
    assert told(path) == (STEADY[:270], [remark])
    t_ns, remarks = told(path, time_col=name, sample_rate=100)
    assert (t_ns[-1], remarks) == (298 * 10**7, [f"29 samples lost by the counter '{name}'"])
    assert told(numbered(path, name, range(300))) == (STEADY, [])


@pytest.mark.parametrize("cut", [1, 7, 150, 299])
def test_a_counter_goes_on_from_batch_to_batch(cut):
    """Wherever a batch ends, also where the counter begins again."""
    values = (np.arange(300) + 65_400) % 65536
    first = counted(values[:cut])
    rest = counted(values[cut:], (int(values[cut - 1]), int(first[-1])))
    assert np.concatenate([first, rest]).tolist() == counted(values).tolist() == [*range(300)]


def test_a_counter_that_begins_anew_steps_back():
    """Far from the end of its range it was reset, and nobody knows what was lost."""
    assert counted(np.array([40_000, 40_001, 0, 1])).tolist() == [0, 1, -40_000, -39_999]


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_one_damaged_count_is_an_outlier_and_hides_no_other(tmp_path):
    """The counter is used all the same, and the policy for such stamps counts."""
    path = xsens(tmp_path / "log.txt", [*range(50), 90_000, *range(51, 99)])
    with pytest.raises(TimelineError, match=r"sample 50 .* is an outlier, 899.51 s ahead"):
        propagate(path, **DEGREES)
    for policy in ("drop", "sort"):
        kept = propagate(path, on_backwards=policy, **DEGREES).t_ns
        assert kept.tolist() == [*STEADY[:50], *STEADY[51:99]]


@pytest.mark.parametrize("count", [10**17, 9 * 10**18])
def test_counts_beyond_the_clock_are_refused_with_a_way_out_that_works(tmp_path, count):
    """Far behind the first rows, where the counter was taken for one."""
    path = xsens(tmp_path / "log.txt", [*range(1500), count])
    assert refusal(path, **DEGREES) == (
        "at 100 Hz, the counts in column 'PacketCounter' do not fit in int64 ns; count "
        "rows with sample_rate='100' and time_col='none'"
    )
    assert told(path, sample_rate="100", time_col="none", **DEGREES)[0][-1] == 15 * 10**9


def test_stamps_next_to_a_counter_that_is_used_are_named(tmp_path):
    """Samples are counted, and not the rows."""
    path = table(tmp_path / "log.csv", {"counter": range(300), "server_time (s)": TIMES})
    said = "sample_rate='100' counts the samples; the timestamps in 'server_time (s)' are not used"
    assert told(path, sample_rate=100)[1][1] == said


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet"])
@pytest.mark.parametrize(
    ("name", "per_ms"), [("ms", 1), ("msec", 1), ("us", 1000), ("usec", 1000), ("ns", 10**6)]
)
def test_a_column_named_as_a_unit_is_the_only_clock(tmp_path, name, per_ms, suffix):
    """It was no time; next to a clock, or falling, it is none."""
    path = table(tmp_path / f"log.{suffix}", {name: np.arange(50) * 10 * per_ms, "ax": 1, "ay": 2})
    assert told(path)[0] == [k * 10**7 for k in range(50)]
    path = table(tmp_path / f"1.{suffix}", {name: np.arange(50) * 7 % 1000 % 13, "t_s": range(50)})
    assert told(path)[0] == [k * 10**9 for k in range(50)]
    path = table(tmp_path / f"2.{suffix}", {name: np.arange(50) * 7 % 13, "ax": 1})
    assert "is not declared" in refusal(path, UndeclaredError)
