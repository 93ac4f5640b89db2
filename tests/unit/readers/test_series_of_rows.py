"""Series that take turns in the rows of a table: found by their labels, and one is chosen."""

import json

import numpy as np
import pandas as pd
import pytest
from make.commands import run
from make.table_rates import refusal, table_rates
from make.tables import write_rates

from quatprop import propagate, read_attitudes
from quatprop.base.errors import TimelineError, UndeclaredError, UsageError
from quatprop.readers.series_choice import labels_of, take_turns

AXES = ["wx", "wy", "wz"]
ROWS = 40
SUFFIXES = ["csv", "jsonl", "parquet", "feather", "npy", "npz", "h5"]


def save(frame, path):
    """Write a table by the suffix of its name."""
    suffix = path.suffix[1:]
    text = frame.select_dtypes(exclude="number")
    if suffix == "csv":
        frame.to_csv(path, index=False)
    elif suffix == "jsonl":
        frame.to_json(path, orient="records", lines=True)
    elif suffix in {"parquet", "feather"}:
        getattr(frame, f"to_{suffix}")(path)
    elif suffix == "npy":
        np.save(path, frame.to_records(index=False, column_dtypes=dict.fromkeys(text, "U5")))
    elif suffix == "npz":
        np.savez(path, **{name: np.array(frame[name].tolist()) for name in frame})
    else:
        records = frame.to_records(index=False, column_dtypes=dict.fromkeys(text, "S5"))
        with pytest.importorskip("h5py").File(path, "w") as file:
            file["log"] = records
    return path


LABELS = {
    "imu_id": (0, 1),
    "I": (0, 1),
    "IMU.instance": (0, 1, 2),
    "device_address": (104, 105),
    "Sensor": ("gyro", "acc"),
    "header.frame_id": ("left", "right"),
    "whatever": ("A", "B", "C"),
}
"""Columns whose labels tell series apart."""


def table(path, name, labels, axes=AXES):
    """Write rows whose rate about x is the number of their label, and return the file."""
    kinds = list(dict.fromkeys(labels))
    frame = pd.DataFrame({"t_ns": range(len(labels)), name: labels})
    frame[axes] = 2.0
    frame[axes[0]] = [float(kinds.index(label)) for label in labels]
    return save(frame, path)


@pytest.fixture
def log(tmp_path):
    """Return a log of the series acc and gyro."""
    return table(tmp_path / "log.csv", "sensor", ["acc", "gyro"] * ROWS)


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", SUFFIXES[:-1])
@pytest.mark.parametrize("name", LABELS)
def test_one_of_the_series_that_take_turns_is_read(tmp_path, name, suffix):
    """Rates of two gyroscopes, or accelerations, were integrated as those of one, if named."""
    kinds = LABELS[name]
    path = table(tmp_path / f"log.{suffix}", name, [kinds[k % len(kinds)] for k in range(ROWS)])
    for named in ({}, {"rate_cols": AXES}):
        sentence = refusal(path, UndeclaredError, **named, time_unit="ns")
        assert sentence.startswith("which series to read, of ")
        assert " that take turns in" in sentence
    for number, kind in enumerate(kinds):
        for wanted in (str(kind), f"{name}={kind}"):
            found = table_rates(path, series=wanted)
            assert found.t_ns == [*range(ROWS)][number :: len(kinds)]
            assert {*found.rate[:, 0].tolist()} == {number}
            others = ROWS - len(found.t_ns)
            assert found.remarks == [
                f"{others} rows of other series than '{kind}' in column '{name}' were not read"
            ]


@pytest.mark.parametrize(("labels", "wanted"), [("acc gyro", "GYRO"), ("gyro Gyro", "Gyro")])
def test_the_case_of_a_label_counts_only_where_two_differ_in_it(tmp_path, labels, wanted):
    """By itself, and behind the name of its column."""
    path = table(tmp_path / "log.csv", "sensor", labels.split() * ROWS)
    for series in (wanted, f"sensor={wanted}"):
        assert {*table_rates(path, series=series).rate[:, 0].tolist()} == {1}


def test_the_message_says_the_choices_and_each_of_them_works(tmp_path):
    """Following the former advice, 2,002 rows were read instead of 1,001."""
    path = tmp_path / "log.csv"
    path.write_text("".join(f"acc,{k},0,0,9.8\ngyro,{k},1,2,3\n" for k in range(1001)))
    named = ["--rate-cols", "2,3,4", "--time-col", "1", "--rate-unit", "rad/s", "--time-unit", "ms"]
    command = ["propagate", path, "-o", "-", "-q", *named]
    assert run(*command).stderr == (
        f"Error: {path}: which series to read, of 'acc', 'gyro' that take turns in column '0', is "
        "not declared; specify it with --series acc|gyro, or if all rows are of one sensor, with "
        "--series all\n"
    )
    for wanted, count in {"acc": 1001, "gyro": 1001, "all": 2002}.items():
        assert run(*command, "--series", wanted, code=0).stdout.count("\n") == count + 1


def test_rows_of_other_series_are_said_and_not_lost(log, tmp_path):
    """The exit code is 0; summary and report say how many, and the output what was requested."""
    out, report = tmp_path / "a.parquet", tmp_path / "r.json"
    result = run("propagate", log, "-o", out, "--series", "gyro", "--report", report, code=0)
    remark = f"{ROWS} rows of other series than 'gyro' in column 'sensor' were not read"
    assert remark in " ".join(result.stderr.split())
    facts = json.loads(report.read_text())
    assert (facts["losses"], facts["settings"]["series"]) == ([], "gyro")
    assert remark in facts["remarks"]
    assert len(read_attitudes(out).t_ns) == ROWS
    assert 'series = "gyro"' in run("info", out, "--as-config").stdout


def test_info_names_the_option_and_takes_it(log):
    """It lists what is missing to read a source."""
    missing = "--series acc|gyro, or if all rows are of one sensor, with --series all"
    assert missing in run("info", log).stdout
    facts = json.loads(run("info", "--json", log, "--series", "gyro").stdout)
    assert facts[0]["sources"][0]["samples"] == ROWS


def test_attitudes_of_a_series_are_converted_and_compared(tmp_path):
    """By the same option, for each side of a comparison."""
    half = 0.5**0.5
    rows = [(k, *row) for k in range(ROWS) for row in (("l", 1, 0, 0, 0), ("r", half, half, 0, 0))]
    path = write_rates(tmp_path / "two.csv", rows, "t_ns,body,qw,qx,qy,qz")
    assert run("convert", path, "-", "--series", "r", code=0).stdout.count("\n") == ROWS + 1
    result = run("compare", path, path, "--series-a", "l", "--series-b", "r", "--json")
    assert json.loads(result.stdout)["error_rad"]["max"] == pytest.approx(np.pi / 2)
    result = run("compare", path, path, "--series-a", "l")
    assert "specify it with --series-b l|r" in result.stderr


def test_a_batch_reads_the_same_series_of_every_log(log, tmp_path):
    """Also of one that has no other."""
    other = table(tmp_path / "b.csv", "sensor", ["gyro"] * ROWS)
    run("batch", log, other, "-o", tmp_path / "out", "--series", "gyro", "-j", "1", code=0)
    made = [read_attitudes(tmp_path / "out" / f"{name}.csv.parquet") for name in ("log", "b")]
    assert [len(series.t_ns) for series in made] == [ROWS, ROWS]


def test_rows_of_a_series_alone_have_to_fit(tmp_path):
    """Text, blanks and other numbers of columns of others are not damage."""
    rows = [f"{k},gyro,1,2,3\n{k},gps,A,fix,,more\n,wifi,-" for k in range(ROWS)]
    rows[7] = "7,gyro,1,x,3"
    path = write_rates(tmp_path / "log.csv", rows, "t_ns,sensor,wx,wy,wz")
    t_ns, _, losses, remarks = table_rates(path, series="gyro")
    assert t_ns == [k for k in range(ROWS) if k != 7]
    assert losses == [("line 23", "'x' in column 'wy' is not a number", 1)]
    assert remarks[0].startswith(f"{2 * (ROWS - 1)} rows of other series than 'gyro' in column")


@pytest.mark.parametrize("suffix", SUFFIXES[:3])
def test_rows_of_a_series_are_counted_at_a_sample_rate(tmp_path, suffix):
    """Those of others take no time."""
    path = table(tmp_path / f"log.{suffix}", "sensor", ["acc", "gyro"] * ROWS)
    assert table_rates(path, series="gyro", sample_rate=100).t_ns == [
        k * 10**7 for k in range(ROWS)
    ]


def test_anchors_of_relative_times_are_those_of_the_series(tmp_path):
    """Not those of the statistics of a file, which know all rows."""
    frame = pd.DataFrame({"t_ns": np.arange(80) * 10**9, "sensor": ["acc", "gyro"] * 40})
    frame.loc[[0, 78], "t_ns"] = [-(10**12), 10**12]
    frame[AXES] = 0.001
    frame.to_parquet(tmp_path / "log.parquet", row_group_size=8)
    with pytest.warns(match="rows of other series"):
        part = propagate(tmp_path / "log.parquet", series="gyro", start="+2s", end="-4s")
    assert (part.t_ns[0], part.t_ns[-1]) == (3 * 10**9, 75 * 10**9)


def test_a_series_of_two_columns_is_chosen_with_a_comma(tmp_path):
    """The rows after the first series still take turns, and the message names them."""
    rows = [(k, s, d, 1, 1, 1) for k in range(ROWS) for s in ("acc", "gyro") for d in "lr"]
    path = write_rates(tmp_path / "log.csv", rows, "t_ns,sensor,side,wx,wy,wz")
    assert "series='gyro,l' or 'gyro,r'" in refusal(path, UndeclaredError, series="gyro")
    found = table_rates(path, series="gyro,l")
    assert len(found.t_ns) == ROWS
    others = "'gyro' in column 'sensor' and 'l' in column 'side' were not read"
    assert found.remarks[0].endswith(others)


def test_a_label_in_two_columns_is_that_of_the_one_that_takes_turns(tmp_path):
    """Of both, the column has to be named."""
    rows = [(k, "lr"[k % 2], "l", "lr"[k // 2 % 2], k % 2, 1, 1) for k in range(ROWS)]
    path = write_rates(tmp_path / "log.csv", rows, "t_ns,sensor,car,rack,wx,wy,wz")
    assert "is in several columns, 'sensor', 'car', 'rack'; name one with series='COLUMN=l'" in (
        refusal(path, UsageError, series="l")
    )
    path = write_rates(path, [(*row[:3], "x", *row[4:]) for row in rows], path.read_text()[:33])
    assert {*table_rates(path, series="l").rate[:, 0].tolist()} == {0}


def test_a_series_may_be_told_apart_by_decimals_where_the_user_says_so(tmp_path):
    """They are no labels otherwise."""
    frame = pd.DataFrame({"t_ns": range(ROWS), "height": [0.5, 1.5] * (ROWS // 2)})
    frame[AXES] = np.tile([[1.0] * 3, [2.0] * 3], (ROWS // 2, 1))
    found = table_rates(save(frame, tmp_path / "log.parquet"), series="height=1.5")
    assert found.rate.tolist() == [[2, 2, 2]] * (ROWS // 2)


MISSING = {
    "mag": "no column has the series 'mag' in the first rows; there are 'acc', 'gyro' in column "
    "'sensor'; to read one that begins later, name its column with series='COLUMN=mag'",
    "sensor=mag": "no row is of the series 'mag' in column 'sensor'; check series",
    "kind=gyro": "series asks for column 'kind'; the columns are 't_ns', 'sensor', 'wx', 'wy', "
    "'wz'",
}


@pytest.mark.parametrize("wanted", MISSING)
def test_a_series_that_is_not_there_is_refused(log, wanted):
    """The sentence says what is."""
    assert refusal(log, UsageError, series=wanted) == MISSING[wanted]


@pytest.mark.parametrize("suffix", [suffix for suffix in SUFFIXES if suffix != "feather"])
def test_a_sensor_that_joins_later_is_found(tmp_path, suffix):
    """It may be connected only seconds after the first."""
    labels = [("left", "right")[k % 2 if k > 900 else 0] for k in range(1000)]
    axes = [f"gyro_{axis}" for axis in "xyz"]
    path = table(tmp_path / f"log.{suffix}", "sensor", labels, axes)
    units = {"rate_unit": "rad/s", "time_unit": "ns"}
    sentence = refusal(path, UndeclaredError, **units)
    assert "of 'left', 'right' that take turns in column" in sentence
    found = table_rates(path, series="left", **units)
    assert len(found.t_ns) == 950
    assert found.remarks[0].startswith("50 rows of other series than 'left' in")
    table(path, "sensor", labels[:900], axes)
    assert len(table_rates(path, **units).t_ns) == 900


@pytest.mark.parametrize("name", ["Source", "node_id", "name", "MAC Address", "unit", "hand"])
def test_what_tells_two_instruments_apart_goes_by_many_names(tmp_path, name):
    """Where it comes and goes from row to row, the rows are of several."""
    path = table(tmp_path / "log.csv", name, ["l", "r", "l"] * 3)
    sentence = refusal(path, UndeclaredError)
    assert sentence.startswith("which series to read, of 'l', 'r' that take turns")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("id", list(range(18))),
        ("frame", [0, 0, 0, 1, 1, 1, 2, 2, 2]),
        ("imu", list("aaaabaaaa")),
        ("temp_imu", [25.0, 25.1] * 20),
        ("temp_imu", [25, 26] * 20),
        ("px_device", [0.5, 0.25] * 20),
        ("battery", [99, 98] * 20),
        ("activity", (["walk"] * 50 + ["stand"] * 50) * 3),
        ("event", (["left", *[""] * 40, "right", *[""] * 40]) * 3),
    ],
)
@pytest.mark.parametrize("suffix", SUFFIXES[:3])
def test_numbers_states_and_counters_are_no_series(tmp_path, name, values, suffix):
    """Names of columns decide nothing: 25.0 and 25.1 of temp_imu were taken for two sensors."""
    frame = pd.DataFrame({"t_ns": range(len(values)), "wx": 1.0, "wy": 2.0, "wz": 3.0})
    frame[name] = values
    found = table_rates(save(frame, tmp_path / f"log.{suffix}"))
    assert (len(found.t_ns), found.remarks) == (len(values), [])


@pytest.mark.parametrize("suffix", SUFFIXES[:3])
def test_rows_without_rates_may_be_of_another_sensor(tmp_path, suffix):
    """The rates are all of one then."""
    frame = pd.DataFrame({"t_ns": np.arange(18), "topic": ["imu", "odom"] * 9, "speed": 4.0})
    frame[AXES] = np.where(np.arange(18)[:, None] % 2, np.nan, [1.0, 2.0, 3.0])
    found = table_rates(save(frame, tmp_path / f"log.{suffix}"))
    np.testing.assert_array_equal(found.rate, frame[AXES])


@pytest.mark.parametrize("seed", range(20))
def test_labels_that_alternate_are_a_series_and_decimals_never(seed):
    """Whatever the column is called, and however long each turn is within reason."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    name = str(rng.choice(["0", "imu", "a", "temp", "wx_device", "mode", "note"]))
    order = np.concatenate(
        [np.repeat(rng.permutation(count), rng.integers(1, 5)) for _ in range(20)]
    )
    texts = [f"s{k}" for k in range(count)]
    assert take_turns(name, [texts[k] for k in order]) == tuple(texts)
    assert labels_of([f"{k + 25}.{k}" for k in order]).kinds == ()


@pytest.mark.parametrize(
    ("name", "length", "labels", "are_series"),
    [
        ("mode", 32, "ab", True),
        ("mode", 33, "ab", False),
        ("0", 4, "01", True),
        ("0", 5, "01", False),
        ("imu", 9, ("0", "15"), True),
        ("imu", 9, ("0", "16"), False),
        ("imu", 9, ("-1", "0"), False),
        ("imu", 9, ("0", "nan"), False),
    ],
)
def test_a_turn_that_lasts_is_a_state_and_a_large_number_is_one(name, length, labels, are_series):
    """Sensors take turns of a few rows, and are numbered from 0."""
    turns = [label for label in labels for _ in range(length)] * 3
    assert take_turns(name, turns) == (tuple(labels) if are_series else ())


@pytest.mark.parametrize(("count", "length", "are_labels"), [(16, 60, 1), (17, 60, 0), (2, 61, 0)])
def test_labels_are_few_and_short(count, length, are_labels):
    """As many different texts as rows are no names of sensors."""
    texts = [f"{k:s>{length}}" for k in range(count)]
    assert len(labels_of(texts * 3).kinds) == count * are_labels


def test_messages_of_one_series_leave_nothing_to_choose(tmp_path):
    """The option is refused, and not ignored."""
    path = tmp_path / "log.mcap"
    run("simulate", path, code=0)
    sentence = refusal(path, UsageError, series="gyro")
    assert sentence == ("no message of topic '/imu' is of the series 'gyro'; there are 'imu'")


def test_a_bias_of_several_series_is_refused_with_a_way_out(tmp_path):
    """No option chooses among those of a file next to the log."""
    rates = table(tmp_path / "log.csv", "sensor", ["gyro"] * ROWS)
    names = ",".join(f"gyro_bias_{axis} [rad/s]" for axis in "xyz")
    rows = [(k, unit, bias, bias, bias) for k in range(ROWS) for bias, unit in enumerate("ab")]
    bias = write_rates(tmp_path / "bias.csv", rows, f"t_ns,unit,{names}")
    assert run("propagate", rates, "-o", "-", "--bias", bias).stderr == (
        f"Error: {bias}: the rows of several series, 'a', 'b' in column 'unit', take turns; write "
        "each to its own file\n"
    )


def test_rates_of_one_series_that_are_all_marked_as_absent_are_refused(tmp_path):
    """They became NaN, since the other series has rates."""
    names = ",".join(f"angular_velocity.{axis}" for axis in "xyz")
    head = f"header.stamp.secs,header.stamp.nsecs,header.frame_id,{names}"
    rows = [(k, 0, "ab"[k % 2], 1.0, 1.0, 1.0, k % 2 - 1.0) for k in range(ROWS)]
    path = write_rates(tmp_path / "log.csv", rows, f"{head},angular_velocity_covariance[0]")
    assert np.isfinite(table_rates(path, series="b").rate).all()
    sentence = refusal(path, TimelineError, series="a")
    assert "all rates are marked as absent" in sentence


LATE = {
    "csv": ("sensor", "A", "B"),
    "jsonl": ("frame_id", "imu_left", "imu_right"),
    "parquet": ("imu_id", 0, 1),
    "feather": ("whatever", "l", "r"),
    "npz": ("Sensor ID", "", "late"),
}
"""The name of a column and its two labels, by kind of table."""


@pytest.mark.thorough
@pytest.mark.parametrize("begin", [1, 4096, 8191, 12_000])
@pytest.mark.parametrize("suffix", LATE)
def test_a_sensor_that_joins_behind_the_first_rows_is_found(tmp_path, suffix, begin):
    """Only the first 256 KiB or 5,000 rows were looked at, and its samples were mixed in."""
    name, first, late = LATE[suffix]
    begin *= 4 if suffix == "csv" else 1  # as its rows are short
    path = table(tmp_path / f"log.{suffix}", name, [first] * begin + [late, first] * 200)
    if first == "":
        # Rows without a label are of no series.
        assert len(table_rates(path).t_ns) == begin + 400
        return
    sentence = refusal(path, UndeclaredError)
    assert f"of '{first}', '{late}' that take turns in column '{name}'" in sentence
    place = f"from row {begin + 1} on"
    assert place in sentence or begin < (24_000 if suffix == "csv" else 6000)
    # Its advice, applied as it is spelled.
    for label, rows in {first: begin + 200, late: 200}.items():
        wanted = f"{name if name.isidentifier() else 1}={label}"
        assert f"'{wanted}'" in sentence or place not in sentence
        assert len(table_rates(path, series=wanted).t_ns) == rows
    remark = f"'{late}' in column '{name}' take turns"
    (said,) = table_rates(path, series="all").remarks
    assert remark in said
    assert (place in said) == (place in sentence)
    # Consecutive parts do not take turns.
    table(path, name, [first] * begin + [late] * 400)
    assert len(table_rates(path).t_ns) == begin + 400


def test_a_late_sensor_is_found_among_rows_that_do_not_fit(tmp_path):
    """Rows next to damaged ones are read one by one."""
    path = tmp_path / "log.csv"
    rows = [f"{k},{'B' if k > 30_000 and k % 2 else 'A'},1,2,3" for k in range(30_100)]
    rows[30_050] = "30050,A,1,x,3"
    path.write_text("\n".join(["t_ns,sensor,wx,wy,wz", *rows]))
    assert "from row 30002 on" in refusal(path, UndeclaredError, rate_unit="rad/s")


def test_an_inspection_lists_the_choices_of_a_sensor_that_joins_late(tmp_path):
    """It reads all rows, and does not end in an error."""
    path = table(tmp_path / "log.csv", "sensor", ["A"] * 20_000 + ["B", "A"] * 9)
    missing = "from row 20001 on, is not declared; specify it with --series sensor=A|sensor=B, or"
    assert missing in run("info", path, code=0).stdout


def test_a_column_of_text_and_numbers_does_not_cost_its_rows(tmp_path):
    """It is not read otherwise, and what is in it is of no matter."""
    rows = [{"t_ns": k, "wx": 1.0, "wy": 2.0, "wz": 3.0, "note": "a"} for k in range(3000)]
    for k in range(2000, 2100):
        rows[k]["note"] = k
    path = tmp_path / "log.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    found = table_rates(path)
    assert (len(found.t_ns), [*found.losses]) == (3000, [])


@pytest.mark.parametrize("kinds", [2, 4, 8])
def test_a_phase_of_the_motion_on_a_steady_clock_is_no_sensor(tmp_path, kinds):
    """Its numbers alternate as the rates do: all rows are read, with a remark."""
    k = np.arange(400)
    frame = pd.DataFrame({"phase": k // 2 % kinds, "t_ms": 10 * k})
    frame[AXES] = np.sin(np.pi * k[:, None] / kinds + np.arange(3))
    found = table_rates(save(frame, tmp_path / "log.csv"), rate_unit="rad/s")
    assert len(found.t_ns) == 400
    assert all("alternate; if they are sensors, choose one" in one for one in found.remarks)


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["csv", "jsonl", "npz"])
@pytest.mark.parametrize("name", ["mote", "ch", "k"])
@pytest.mark.parametrize("labels", [(12, 17), (0, 1), (1, 2, 3), (40_000, 7)])
@pytest.mark.parametrize("apart_ms", [0, 2])
def test_sensors_told_apart_by_numbers_of_any_name_are_asked_for(
    tmp_path, suffix, name, labels, apart_ms
):
    """Their rates were mixed, and the packets that were remarked on are none."""
    rows = [
        (label, 10 * k + apart_ms * place, np.sin(k / 9) + 0.1 * place, place, 0.5 - 0.4 * place)
        for k in range(60)
        for place, label in enumerate(labels)
    ]
    log = save(pd.DataFrame(rows, columns=[name, "t_ms", *AXES]), tmp_path / f"log.{suffix}")
    said = refusal(log, UndeclaredError, rate_unit="rad/s")
    assert f"take turns in column '{name}'" in said
    for place, label in enumerate(labels):
        if f"'{name}={label}'" in said:
            rates = table_rates(log, rate_unit="rad/s", series=f"{name}={label}")
            assert rates.rate[:, 1].tolist() == [place] * 60
    assert said.count(f"='{name}=") + said.count(f"or '{name}=") == len(labels)
    assert len(table_rates(log, rate_unit="rad/s", series="all").t_ns) == 60 * len(labels)


@pytest.mark.parametrize("name", ["flag", "part", "k"])
@pytest.mark.parametrize("size", [2, 3])
def test_numbers_that_alternate_next_to_one_motion_are_no_sensors(tmp_path, name, size):
    """A flag is nothing, and the place in a packet is named only."""
    rows = [(k % size, 10 * k, 10 * (k // size), np.sin(k / 9), 1, 2) for k in range(120)]
    frame = pd.DataFrame(rows, columns=[name, "t_ms", "packet_ms", *AXES])
    steady = save(frame.drop(columns="packet_ms"), tmp_path / "1.csv")
    assert table_rates(steady, rate_unit="rad/s").remarks == []
    packets = save(frame.drop(columns="t_ms"), tmp_path / "2.csv")
    said = " ".join(
        table_rates(packets, rate_unit="rad/s", time_col="packet_ms", time_unit="ms").remarks
    )
    assert f"choose one, such as series='{name}=0'" in said


WIDE = pd.DataFrame({"t_ns": range(ROWS), "imu_id": [0, 1] * (ROWS // 2)})
for _side, _sign in (("left", 1), ("right", -1)):
    for _axis in "xyz":
        WIDE[f"{_side}_gyro_{_axis}_rad_s"] = _sign * (2.0 + WIDE["imu_id"])


@pytest.mark.parametrize("suffix", SUFFIXES[:-1])
def test_a_set_of_columns_and_a_label_of_rows_are_chosen_together(tmp_path, suffix):
    """Each was refused for the lack of the other."""
    path = save(WIDE, tmp_path / f"log.{suffix}")
    assert "specify it with series='left' or 'right'" in refusal(path, UndeclaredError)
    assert refusal(path, UndeclaredError, series="left") == (
        "which series to read, of '0', '1' that take turns in column 'imu_id', is not declared; "
        "specify it with series='left,0' or 'left,1', or if all rows are of one sensor, with "
        "series='left,all'"
    )
    for side, sign in (("left", 1), ("right", -1)):
        for row in (0, 1):
            for wanted in (f"{side},{row}", f"{row},{side}", f"imu_id={row}, {side}"):
                found = table_rates(path, series=wanted)
                assert {*found.rate[:, 0].tolist()} == {sign * (2.0 + row)}
                assert len(found.t_ns) == ROWS // 2
        assert len(table_rates(path, series=f"{side},all").t_ns) == ROWS
    assert "specify it with series='left' or 'right'" in refusal(path, UndeclaredError, series="0")
    unknown = refusal(path, UsageError, series="left,7")
    assert unknown.startswith("no column has the series '7' in the first rows; ")
    assert unknown.endswith("name its column with series='left,COLUMN=7'")


def test_columns_and_rows_may_have_the_same_labels(tmp_path):
    """The first is that of the columns."""
    names = {name: name.replace("left", "0").replace("right", "1") for name in WIDE}
    path = save(WIDE.rename(columns=names), tmp_path / "log.csv")
    assert refusal(path, UndeclaredError, series="1").endswith("with series='1,all'")
    for columns, row in ((0, 0), (0, 1), (1, 0), (1, 1)):
        found = table_rates(path, series=f"{columns},{row}")
        assert {*found.rate[:, 0].tolist()} == {(1 - 2 * columns) * (2.0 + row)}
