"""Series that take turns in the rows of a table: found by their labels, and one is chosen."""

import json
from functools import partial

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from quatprop import RemarkWarning, propagate, read_attitudes, read_rates
from quatprop.cli.commands import cli
from quatprop.errors import TimelineError, UndeclaredError, UsageError
from quatprop.logs.clocks.series import labels_of, take_turns

AXES = ["wx", "wy", "wz"]
ROWS = 40


def save_h5(frame, path):
    """Write a dataset of records."""
    types = dict.fromkeys(frame.select_dtypes(exclude="number"), "S5")
    with pytest.importorskip("h5py").File(path, "w") as file:
        file["log"] = frame.to_records(index=False, column_dtypes=types)


def save_npy(frame, path):
    """Write an array of records."""
    types = dict.fromkeys(frame.select_dtypes(exclude="number"), "U5")
    np.save(path, frame.to_records(index=False, column_dtypes=types))


def save_npz(frame, path):
    """Write an array for each column."""
    np.savez(path, **{name: np.array(frame[name].tolist()) for name in frame})


WRITERS = {
    "csv": partial(pd.DataFrame.to_csv, index=False),
    "jsonl": partial(pd.DataFrame.to_json, orient="records", lines=True),
    "parquet": pd.DataFrame.to_parquet,
    "feather": pd.DataFrame.to_feather,
    "npy": save_npy,
    "npz": save_npz,
    "h5": save_h5,
}
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
    WRITERS[path.suffix[1:]](frame, path)
    return path


@pytest.mark.parametrize("suffix", list(WRITERS)[:-1])
@pytest.mark.parametrize("name", LABELS)
def test_one_of_the_series_that_take_turns_is_read(tmp_path, name, suffix):
    """Rates of two gyroscopes, or accelerations, were integrated as those of one, if named."""
    kinds = LABELS[name]
    labels = [kinds[k % len(kinds)] for k in range(ROWS)]
    path = table(tmp_path / f"log.{suffix}", name, labels)
    for named in ({}, {"rate_cols": AXES}):
        with pytest.raises(
            UndeclaredError, match=r"which series to read, of .* that take turns in"
        ):
            read_rates(path, **named, time_unit="ns")
    for number, kind in enumerate(kinds):
        for wanted in (str(kind), f"{name}={kind}"):
            with pytest.warns(RemarkWarning) as caught:
                rates = read_rates(path, series=wanted)
            assert rates.t_ns.tolist() == list(range(ROWS))[number :: len(kinds)]
            assert {*rates.rate[:, 0].tolist()} == {number}
            (remark,) = [str(warning.message) for warning in caught]
            others = ROWS - len(rates.t_ns)
            assert remark == (
                f"{path}: {others} rows of other series than '{kind}' in column '{name}' were not "
                "read"
            )


def test_the_message_says_the_choices_and_each_of_them_works(tmp_path):
    """Following the former advice, 2,002 rows were read instead of 1,001."""
    path = tmp_path / "log.csv"
    path.write_text("".join(f"acc,{k},0,0,9.8\ngyro,{k},1,2,3\n" for k in range(1001)))
    named = ["--rate-cols", "2,3,4", "--time-col", "1", "--rate-unit", "rad/s", "--time-unit", "ms"]
    command = ["propagate", str(path), "-o", "-", "-q", *named]
    result = CliRunner().invoke(cli, command)
    assert result.stderr == (
        f"Error: {path}: which series to read, of 'acc', 'gyro' that take turns in column '0', is "
        "not declared; say it with --series acc|gyro, or if all rows are of one sensor, with "
        "--series all\n"
    )
    counts = {}
    for wanted in ("acc", "gyro", "all"):
        done = CliRunner().invoke(cli, [*command, "--series", wanted])
        assert done.exit_code == 0, done.stderr
        counts[wanted] = done.stdout.count("\n") - 1
    assert counts == {"acc": 1001, "gyro": 1001, "all": 2002}


def test_rows_of_other_series_are_said_and_not_lost(tmp_path):
    """The exit code is 0; summary and report say how many, and the output what was asked for."""
    path = table(tmp_path / "log.csv", "sensor", ["acc", "gyro"] * ROWS)
    out, report = tmp_path / "a.parquet", tmp_path / "r.json"
    arguments = [str(path), "-o", str(out), "--series", "gyro", "--report", str(report)]
    result = CliRunner().invoke(cli, ["propagate", *arguments])
    assert result.exit_code == 0, result.stderr
    remark = f"{ROWS} rows of other series than 'gyro' in column 'sensor' were not read"
    assert remark in " ".join(result.stderr.split())
    facts = json.loads(report.read_text())
    assert (facts["losses"], facts["settings"]["series"]) == ([], "gyro")
    assert remark in facts["remarks"]
    made = read_attitudes(out)
    assert len(made.t_ns) == ROWS
    config = CliRunner().invoke(cli, ["info", str(out), "--as-config"]).stdout
    assert 'series = "gyro"' in config


def test_info_names_the_option_and_takes_it(tmp_path):
    """It lists what is missing to read a source."""
    path = table(tmp_path / "log.csv", "sensor", ["acc", "gyro"] * ROWS)
    result = CliRunner().invoke(cli, ["info", str(path)])
    assert "--series acc|gyro, or if all rows are of one sensor, with --series all" in result.stdout
    result = CliRunner().invoke(cli, ["info", "--json", str(path), "--series", "gyro"])
    assert json.loads(result.stdout)[0]["sources"][0]["samples"] == ROWS


def attitudes(path):
    """Write attitudes of two bodies that take turns."""
    half = 0.5**0.5
    rows = "".join(f"{k},left,1,0,0,0\n{k},right,{half},{half},0,0\n" for k in range(ROWS))
    path.write_text(f"t_ns,body,qw,qx,qy,qz\n{rows}")
    return str(path)


def test_attitudes_of_a_series_are_converted_and_compared(tmp_path):
    """By the same option, for each side of a comparison."""
    path = attitudes(tmp_path / "two.csv")
    result = CliRunner().invoke(cli, ["convert", path, "-", "--series", "right"])
    assert (result.exit_code, result.stdout.count("\n")) == (0, ROWS + 1)
    sides = ["--series-a", "left", "--series-b", "right", "--json"]
    result = CliRunner().invoke(cli, ["compare", path, path, *sides])
    assert json.loads(result.stdout)["error_rad"]["max"] == pytest.approx(np.pi / 2)
    result = CliRunner().invoke(cli, ["compare", path, path, "--series-a", "left"])
    assert "say it with --series-b left|right" in result.stderr


def test_a_batch_reads_the_same_series_of_every_log(tmp_path):
    """Also of one that has no other."""
    for name, labels in (("a", ["acc", "gyro"] * ROWS), ("b", ["gyro"] * ROWS)):
        table(tmp_path / f"{name}.csv", "sensor", labels)
    result = CliRunner().invoke(
        cli, ["batch", str(tmp_path), "-o", str(tmp_path / "out"), "--series", "gyro", "-j", "1"]
    )
    assert result.exit_code == 0, result.stderr
    made = [read_attitudes(tmp_path / "out" / f"{name}.parquet") for name in "ab"]
    assert [len(series.t_ns) for series in made] == [ROWS, ROWS]


def test_rows_of_a_series_alone_have_to_fit(tmp_path, recwarn):
    """Text, blanks and other numbers of columns of others are not damage."""
    path = tmp_path / "log.csv"
    rows = [f"{k},gyro,1,2,3\n{k},gps,A,fix,,more\n,wifi,-\n" for k in range(ROWS)]
    rows[7] = "7,gyro,1,x,3\n"
    path.write_text(f"t_ns,sensor,wx,wy,wz\n{''.join(rows)}")
    rates = read_rates(path, series="gyro")
    assert rates.t_ns.tolist() == [k for k in range(ROWS) if k != 7]
    lost, others = [str(warning.message).removeprefix(f"{path}: ") for warning in recwarn]
    assert lost == "lost: line 23: 'x' in column 'wy' is not a number"
    assert others.startswith(f"{2 * (ROWS - 1)} rows of other series than 'gyro' in column")


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet"])
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_rows_of_a_series_are_counted_at_a_sample_rate(tmp_path, suffix):
    """Those of others take no time."""
    path = table(tmp_path / f"log.{suffix}", "sensor", ["acc", "gyro"] * ROWS)
    rates = read_rates(path, series="gyro", sample_rate=100)
    assert rates.t_ns.tolist() == [k * 10**7 for k in range(ROWS)]


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
    """What is left after the first still takes turns, and the message names it."""
    rows = [(k, s, d) for k in range(ROWS) for s in ("acc", "gyro") for d in ("left", "right")]
    frame = pd.DataFrame(rows, columns=["t_ns", "sensor", "side"])
    frame[AXES] = 1.0
    frame.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(UndeclaredError, match="series='gyro,left' or 'gyro,right'"):
        read_rates(tmp_path / "log.csv", series="gyro")
    with pytest.warns(match="'gyro' in column 'sensor' and 'left' in column 'side' were not read"):
        assert len(read_rates(tmp_path / "log.csv", series="gyro,left").t_ns) == ROWS


MISSING = {
    "mag": "no column has the series 'mag' in the first rows; there are 'acc', 'gyro' in column "
    "'sensor'; to read one that begins later, name its column with series='COLUMN=mag'",
    "sensor=mag": "no row is of the series 'mag' in column 'sensor'; check series",
    "kind=gyro": "series asks for column 'kind'; the columns are 't_ns', 'sensor', 'wx', 'wy', "
    "'wz'",
}


@pytest.mark.parametrize("wanted", MISSING)
def test_a_series_that_is_not_there_is_refused(tmp_path, wanted):
    """The sentence says what is."""
    path = table(tmp_path / "log.csv", "sensor", ["acc", "gyro"] * ROWS)
    with pytest.raises(UsageError) as caught:
        read_rates(path, series=wanted)
    assert str(caught.value) == f"{path}: {MISSING[wanted]}"


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet", "npy", "npz", "h5"])
def test_a_sensor_that_joins_later_is_found(tmp_path, suffix):
    """It may be connected only seconds after the first."""
    labels = [("left", "right")[k % 2 if k > 900 else 0] for k in range(1000)]
    axes = [f"gyro_{axis}" for axis in "xyz"]
    path = table(tmp_path / f"log.{suffix}", "sensor", labels, axes)
    units = {"rate_unit": "rad/s", "time_unit": "ns"}
    with pytest.raises(UndeclaredError, match=r"of 'left', 'right' that take turns in column"):
        read_rates(path, **units)
    with pytest.warns(match="50 rows of other series than 'left' in"):
        assert len(read_rates(path, series="left", **units).t_ns) == 950
    table(path, "sensor", labels[:900], axes)
    assert len(read_rates(path, **units).t_ns) == 900


@pytest.mark.parametrize("name", ["Source", "node_id", "name", "MAC Address", "unit", "hand"])
def test_what_tells_two_instruments_apart_goes_by_many_names(tmp_path, name):
    """Where it comes and goes from row to row, the rows are of several."""
    path = table(tmp_path / "log.csv", name, ["l", "r", "l"] * 3)
    with pytest.raises(UndeclaredError, match="which series to read, of 'l', 'r' that take turns"):
        read_rates(path)


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
@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet"])
def test_numbers_states_and_counters_are_no_series(tmp_path, recwarn, name, values, suffix):
    """Names of columns decide nothing: 25.0 and 25.1 of temp_imu were taken for two sensors."""
    frame = pd.DataFrame({"t_ns": range(len(values)), "wx": 1.0, "wy": 2.0, "wz": 3.0})
    frame[name] = values
    WRITERS[suffix](frame, tmp_path / f"log.{suffix}")
    assert len(read_rates(tmp_path / f"log.{suffix}").t_ns) == len(values)
    assert not recwarn.list


@pytest.mark.parametrize("suffix", ["csv", "jsonl", "parquet"])
def test_rows_without_rates_may_be_of_another_sensor(tmp_path, suffix):
    """The rates are all of one then."""
    path = tmp_path / f"log.{suffix}"
    frame = pd.DataFrame({"t_ns": np.arange(18), "topic": ["imu", "odom"] * 9, "speed": 4.0})
    frame[AXES] = np.where(np.arange(18)[:, None] % 2, np.nan, [1.0, 2.0, 3.0])
    WRITERS[suffix](frame, path)
    rates = read_rates(path)
    np.testing.assert_array_equal(rates.rate[::2], np.tile([1.0, 2.0, 3.0], (9, 1)))
    assert np.isnan(rates.rate[1::2]).all()


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


def test_messages_of_one_series_leave_nothing_to_choose(tmp_path):
    """The option is refused, and not ignored."""
    log = str(tmp_path / "log.mcap")
    assert CliRunner().invoke(cli, ["simulate", log]).exit_code == 0
    with pytest.raises(UsageError, match="are one series, so 'gyro' cannot be chosen"):
        read_rates(log, series="gyro")


def test_a_bias_of_several_series_is_refused_with_a_way_out(tmp_path):
    """No option chooses among those of a file beside the log."""
    rates = table(tmp_path / "log.csv", "sensor", ["gyro"] * ROWS)
    bias = tmp_path / "bias.csv"
    rows = "".join(f"{k},a,0,0,0\n{k},b,1,1,1\n" for k in range(ROWS))
    bias.write_text(
        f"t_ns,unit,gyro_bias_x [rad/s],gyro_bias_y [rad/s],gyro_bias_z [rad/s]\n{rows}"
    )
    result = CliRunner().invoke(cli, ["propagate", str(rates), "-o", "-", "--bias", str(bias)])
    assert result.stderr == (
        f"Error: {bias}: the rows of several series, 'a', 'b' in column 'unit', take turns; write "
        "each to a file of its own\n"
    )


def test_rates_of_one_series_that_are_all_marked_as_absent_are_refused(tmp_path):
    """They became NaN, since the other series has rates."""
    times = np.arange(ROWS)
    rates = {f"angular_velocity.{axis}": 1.0 for axis in "xyz"}
    is_b = times % 2 == 1
    stamps = {"header.stamp.secs": times, "header.stamp.nsecs": 0}
    columns = {**stamps, "header.frame_id": np.where(is_b, "b", "a"), **rates}
    columns["angular_velocity_covariance[0]"] = np.where(is_b, 0.0, -1.0)
    path = tmp_path / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    with pytest.warns(RemarkWarning, match="rows of other series"):
        assert np.isfinite(read_rates(path, series="b").rate).all()
    with pytest.raises(TimelineError, match="all rates are marked as absent"):
        read_rates(path, series="a")
