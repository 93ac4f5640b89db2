"""Parquet and Feather tables: types, units, nested columns, damage."""

import json
import re
from datetime import UTC, datetime
from decimal import Decimal

import numpy as np
import pyarrow as pa
import pytest
from make.table_rates import rate_batches
from pyarrow import feather, parquet

from quatprop import read_rates
from quatprop.errors import (
    DamagedLogError,
    NoRatesError,
    UndeclaredError,
    UnreadableLogError,
    UnsupportedLogError,
)
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import RateSelection
from quatprop.tables.arrow import FeatherLog, ParquetLog
from quatprop.text import in_python

RATES = {"wx": [1.0, 4.0], "wy": [2.0, 5.0], "wz": [3.0, 6.0]}
EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
EPOCH_NS = 1767225600_000000000


@pytest.fixture(params=["parquet", "feather"])
def open_table(request, tmp_path):
    """Return a function that writes a table in one format and opens it as a log."""

    def written(columns):
        path = tmp_path / f"log.{request.param}"
        if request.param == "parquet":
            parquet.write_table(pa.table(columns), path)
            return ParquetLog(path)
        feather.write_feather(pa.table(columns), path)
        return FeatherLog(path)

    return written


def read(log, **options):
    """Return stamps, rates and losses of an open table."""
    with log:
        batches = list(rate_batches(log, **options))
    t_ns = np.concatenate([batch.t_ns for batch in batches])
    return t_ns.tolist(), np.concatenate([batch.rate for batch in batches]), log.losses


def test_our_own_rate_table_is_recognised(open_table):
    """The table that simulate writes needs no options."""
    t_ns, rate, losses = read(open_table({"t_ns": [10, 20], **RATES}))
    assert t_ns == [10, 20]
    assert rate.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert losses == []


TIMES = {
    "timestamps of ns": (pa.array([EPOCH_NS, EPOCH_NS + 1], pa.timestamp("ns", "UTC")), None),
    "timestamps of us": (pa.array([EPOCH, EPOCH], pa.timestamp("us")), None),
    "timestamps of s": (pa.array([EPOCH, EPOCH], pa.timestamp("s")), None),
    "durations": (pa.array([1, 2], pa.duration("ms")), None),
    "integers": (pa.array([5, 7], pa.uint32()), "us"),
    "decimals": (pa.array([Decimal("0.1234567895"), Decimal("-1.5")], pa.decimal128(12, 10)), "s"),
    "coarse decimals": (pa.array([Decimal("0.5"), Decimal("1.5")], pa.decimal128(3, 1)), "s"),
    "floats": (pa.array([1763590172.7504675, -0.25]), "s"),
}
STAMPS = {
    "timestamps of ns": [EPOCH_NS, EPOCH_NS + 1],
    "timestamps of us": [EPOCH_NS, EPOCH_NS],
    "timestamps of s": [EPOCH_NS, EPOCH_NS],
    "durations": [1_000_000, 2_000_000],
    "integers": [5_000, 7_000],
    "decimals": [123456790, -1500000000],
    "coarse decimals": [500000000, 1500000000],
    "floats": [1763590172750467539, -250000000],  # the float nearest to .7504675
}


@pytest.mark.parametrize("kind", TIMES)
def test_times_of_every_type_are_exact(open_table, kind):
    """Time columns become ns without a detour through floats; timestamps know their unit."""
    time, unit = TIMES[kind]
    t_ns, _, _ = read(open_table({"stamp": time, **RATES}), rate_unit="rad/s", time_unit=unit)
    assert t_ns == STAMPS[kind]


def test_the_only_timestamps_are_the_time(open_table):
    """A column of timestamps is the time whatever it is called."""
    recorded = pa.array([1, 2], pa.timestamp("ns"))
    t_ns, _, _ = read(open_table({"recorded": recorded, **RATES}), rate_unit="rad/s")
    assert t_ns == [1, 2]


def test_a_time_unit_against_the_type_applies(open_table):
    """A timestamp's unit is part of its type; who says another one is told."""
    log = open_table({"time": pa.array([1, 2], pa.timestamp("ns")), **RATES})
    with log:
        source = choose_rates(log, RateSelection(rate_unit="rad/s", time_unit="s"))
        (batch,) = source.batches()
    assert batch.t_ns.tolist() == [1_000_000_000, 2_000_000_000]
    (remark,) = source.remarks
    assert "time_unit says s, but by header or convention 'time' is in ns" in in_python(remark)


def test_units_in_column_names_are_declared(open_table):
    """Suffixes say the units, and degrees become radians."""
    columns = {"time_ms": [1, 2], **{f"gyro_{axis}_dps": [180, -90] for axis in "xyz"}}
    t_ns, rate, _ = read(open_table(columns))
    assert t_ns == [1_000_000, 2_000_000]
    assert rate[:, 0].tolist() == [np.pi, -np.pi / 2]


def test_integers_without_a_unit_are_not_guessed(open_table):
    """A number that is called time is refused until its unit is said."""
    log = open_table({"time": [1, 2], **RATES})
    with log, pytest.raises(UndeclaredError, match=r"the unit of the time 'time'"):
        rate_batches(log, rate_unit="rad/s")


def test_nested_columns_are_opened(open_table):
    """Messages written as structs are found by their fields, as flattened ones are."""
    stamp = {"sec": 3, "nanosec": 7}
    columns = {
        "header": [{"stamp": stamp, "frame_id": "imu"}],
        "angular_velocity": [{"x": 1.0, "y": 2.0, "z": 3.0}],
        "linear_acceleration": [{"x": 0.0, "y": 0.0, "z": 9.8}],
    }
    log = open_table(columns)
    # Versions of Arrow order the fields of a struct that they infer differently.
    assert sorted(log.names[:3]) == [
        *("header.frame_id", "header.stamp.nanosec", "header.stamp.sec"),
    ]
    t_ns, rate, _ = read(log)
    assert t_ns == [3_000_000_007]
    assert rate.tolist() == [[1, 2, 3]]


def test_flattened_names_with_dots_are_columns(open_table):
    """A column whose own name has dots is not taken for a struct."""
    columns = {"header.stamp.sec": [3], "header.stamp.nanosec": [7]}
    columns |= {f"angular_velocity.{axis}": [1.5] for axis in "xyz"}
    t_ns, rate, _ = read(open_table(columns))
    assert t_ns == [3_000_000_007]
    assert rate.tolist() == [[1.5, 1.5, 1.5]]


def test_rates_of_any_number_type_are_read(open_table):
    """Integers, short floats and nulls become float64; null becomes NaN."""
    columns = {
        "t_ns": [1, 2],
        "wx": pa.array([1, None], pa.int16()),
        "wy": pa.array([0.5, 2.5], pa.float32()),
        "wz": pa.array([Decimal("0.25"), Decimal("-0.75")], pa.decimal128(5, 2)),
    }
    _, rate, losses = read(open_table(columns))
    np.testing.assert_array_equal(rate, [[1, 0.5, 0.25], [np.nan, 2.5, -0.75]])
    assert losses == []


@pytest.mark.parametrize(
    ("time", "unit"), [([1, None], "ns"), ([1.0, float("nan")], "ns"), ([1.0, None], "ns")]
)
def test_rows_without_a_time_are_told(open_table, time, unit):
    """A row that has no stamp is left out and counted."""
    t_ns, rate, losses = read(open_table({"t": time, **RATES}), rate_unit="rad/s", time_unit=unit)
    assert t_ns == [1]
    assert len(rate) == 1
    assert [(loss.place, loss.messages) for loss in losses] == [("rows 1 to 2", 1)]


@pytest.mark.parametrize("time", [[2**62], [9.3e18], [Decimal(2**62)]])
def test_times_that_overflow_are_refused(open_table, time):
    """A stamp beyond the years 1678 to 2262 is a wrong unit."""
    columns = {"t": time, **{name: values[:1] for name, values in RATES.items()}}
    with pytest.raises(
        UnsupportedLogError, match="'t' do not fit in int64 ns when they are s; che"
    ):
        read(open_table(columns), rate_unit="rad/s", time_unit="s")


def test_text_columns_are_refused(open_table):
    """A column of text is not parsed as numbers."""
    log = open_table({"t_ns": [1, 2], **RATES, "wx": ["1", "2"]})
    with (
        log,
        pytest.raises(UnsupportedLogError, match="'wx' holds string, not numbers; convert it"),
    ):
        list(rate_batches(log))


def test_a_sample_rate_counts_rows_across_batches(open_table):
    """Rows are counted from the start of the file, not of the batch."""
    rows = 200_000
    t_ns, _, _ = read(
        open_table({f"w{axis}": np.zeros(rows) for axis in "xyz"}),
        rate_unit="rad/s",
        sample_rate=1000.0,
    )
    assert t_ns == list(range(0, rows * 1_000_000, 1_000_000))


def test_an_attitude_table_has_no_rates(open_table):
    """What propagate writes is told apart from what it reads."""
    columns = {"t_ns": [1], **{name: [0.5] for name in ("qw", "qx", "qy", "qz")}}
    with open_table(columns) as log, pytest.raises(NoRatesError, match="columns are 't_ns', 'qw'"):
        list(rate_batches(log))


def test_a_parquet_file_without_its_footer_is_refused(tmp_path):
    """A Parquet file that was not written to the end has no schema."""
    path = tmp_path / "log.parquet"
    parquet.write_table(pa.table({"t_ns": [1, 2], **RATES}), path)
    path.write_bytes(path.read_bytes()[:-20])
    size = path.stat().st_size
    message = (
        "only there does a Parquet file say what its columns are, so none of its "
        f"{size} bytes can be read; was it closed?"
    )
    with pytest.raises(DamagedLogError, match=re.escape(message)):
        ParquetLog(path)


@pytest.mark.parametrize("kind", ["parquet", "indexed.parquet", "feather", "dictionary.feather"])
def test_joined_files_are_refused(tmp_path, kind):
    """Of two files in one, pyarrow sees the last only, and takes the bytes of the first for it."""
    paths = [tmp_path / f"{name}.{kind}" for name in ("first", "second", "both")]
    for path, rows in zip(paths, (40, 30_000), strict=False):
        columns = {"t_ns": np.arange(rows), **{f"w{axis}": np.ones(rows) for axis in "xyz"}}
        table = pa.table(
            {**columns, "note": pa.array(["a", "b"] * (rows // 2)).dictionary_encode()}
        )
        if "parquet" in kind:
            parquet.write_table(table, path, write_page_index="indexed" in kind)
        elif "dictionary" in kind:
            feather.write_feather(table, path)
        else:
            feather.write_feather(table.drop_columns("note"), path, compression="uncompressed")
    first, second, both = paths
    open_log = ParquetLog if "parquet" in kind else FeatherLog
    for one, other in ((first, second), (second, first), (first, first)):
        both.write_bytes(one.read_bytes() + other.read_bytes())
        place = f"another file begins in it at byte {one.stat().st_size}; split it there into two"
        with pytest.raises(UnsupportedLogError, match=place):
            open_log(both)
        with open_log(one) as log:
            assert len(log.names) >= 4
    data = second.read_bytes()
    missing = data.replace(bytes(600), b"", 1) if open_log is FeatherLog else data[:99] + data[999:]
    both.write_bytes(first.read_bytes() + missing)
    with pytest.raises(UnsupportedLogError, match="another file begins in it at byte"):
        open_log(both)


def test_damaged_row_groups_are_lost_alone(tmp_path):
    """Damage inside a Parquet file costs its row group; those after it are read."""
    path = tmp_path / "log.parquet"
    rows = 30_000
    values = np.random.default_rng(1).normal(size=rows)
    table = pa.table({"t_ns": np.arange(rows), "wx": values, "wy": values, "wz": values})
    parquet.write_table(table, path, row_group_size=10_000, compression="zstd")
    data = bytearray(path.read_bytes())
    chunk = parquet.ParquetFile(path).metadata.row_group(1).column(2)
    begin = chunk.dictionary_page_offset or chunk.data_page_offset
    data[begin : begin + 2000] = bytes(2000)  # the head of a page and what follows
    path.write_bytes(data)
    t_ns, _, losses = read(ParquetLog(path))
    assert t_ns == [*range(10_000), *range(20_000, 30_000)]
    assert [(loss.place, loss.messages) for loss in losses] == [("row group 1", 10_000)]


PAGES = [{}, {"data_page_version": "2.0"}, {"compression": "none", "use_dictionary": False}]


@pytest.mark.parametrize("options", PAGES, ids=str)
def test_no_flipped_bit_in_checked_pages_is_believed(tmp_path, options, monkeypatch):
    """A sign bit in a page with a checksum gave a wrong rate, one in its head a group less."""
    path = tmp_path / "log.parquet"
    rates = np.random.default_rng(3).normal(size=(40, 3))
    columns = dict(zip(RATES, rates.T, strict=True))
    table = pa.table({"t_ns": np.arange(40), **columns})
    parquet.write_table(table, path, write_page_checksum=True, row_group_size=20, **options)
    good = path.read_bytes()
    groups = parquet.ParquetFile(path).metadata
    end = len(good) - 8 - groups.serialized_size
    lost = 0
    for byte in range(4, end, 29):
        data = bytearray(good)
        data[byte] ^= 1 << byte % 8
        path.write_bytes(data)
        t_ns, rate, losses = read(ParquetLog(path))
        assert np.array_equal(rate, rates[t_ns])
        assert 40 - len(t_ns) == sum(loss.messages for loss in losses)
        lost += len(losses)
    assert lost > 50
    begin = groups.row_group(1).column(1).data_page_offset
    data = bytearray(good)
    data[begin + groups.row_group(1).column(1).total_compressed_size - 2] ^= 1
    path.write_bytes(data)
    _, _, (loss,) = read(ParquetLog(path))
    reason = "could not verify page integrity, CRC checksum verification failed for page_ordinal 0"
    assert loss[1:] == (f"it is damaged: {reason}", 20)
    if "compression" in options:
        monkeypatch.setenv("QUATPROP_CHECKSUMS", "ignore")
        t_ns, rate, losses = read(ParquetLog(path))
        assert (len(t_ns), losses) == (40, [])
        assert not np.array_equal(rate, rates)


def test_a_feather_file_without_its_footer_is_read_to_its_end(tmp_path):
    """An Arrow file that was cut off is still a stream of batches."""
    path = tmp_path / "log.feather"
    table = pa.table({"t_ns": np.arange(1000), **{f"w{axis}": np.ones(1000) for axis in "xyz"}})
    feather.write_feather(table, path, compression="uncompressed", chunksize=100)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    t_ns, _, losses = read(FeatherLog(path))
    assert t_ns == list(range(len(t_ns)))
    assert 300 <= len(t_ns) <= 500
    assert [loss.place for loss in losses] == ["end of the file"]


@pytest.mark.parametrize("compression", ["uncompressed", "lz4", "zstd"])
def test_a_feather_file_cut_between_batches_is_reported_as_cut(tmp_path, compression):
    """Where a file ends behind a whole batch, all before is read, and that it is cut is said."""
    path = tmp_path / "log.feather"
    values = np.random.default_rng(2).normal(size=3_000)
    table = pa.table({"t_ns": np.arange(3_000), "wx": values, "wy": values, "wz": values})
    feather.write_feather(table, path, compression=compression, chunksize=100)
    data = path.read_bytes()
    # A message begins with this mark; the first is the schema, and each other one a batch.
    begins = [at for at in range(0, len(data), 8) if data[at : at + 4] == b"\xff\xff\xff\xff"]
    assert len(begins) == 32
    for rows, at in zip(range(0, 3_100, 300), begins[1::3], strict=True):
        path.write_bytes(data[:at])
        with FeatherLog(path) as log:
            batches = list(rate_batches(log))
            assert sum(len(batch.t_ns) for batch in batches) == rows
            (loss,) = log.losses
            assert loss.place == "end of the file"
            assert loss.reason == (
                "it is damaged: its footer is damaged or missing, so more batches may have followed"
            )


def test_feather_version_1_is_refused(tmp_path):
    """The first Feather format is another one; the sentence says what to do."""
    path = tmp_path / "log.feather"
    path.write_bytes(b"FEA1" + bytes(100))
    with pytest.raises(UnsupportedLogError, match="it is of Feather version 1; save it again"):
        FeatherLog(path)


def test_a_missing_file_is_told(tmp_path):
    """A path that leads nowhere is told in one line."""
    with pytest.raises(UnreadableLogError, match=r"no such file or folder; check the path$"):
        ParquetLog(tmp_path / "none.parquet")


AXES = np.random.default_rng(5).normal(size=(50, 3))
LISTS = {
    "fixed": pa.FixedSizeListArray.from_arrays(pa.array(AXES.ravel()), 3),
    "list": pa.array(AXES.tolist()),
    "large": pa.array(AXES.tolist(), pa.large_list(pa.float64())),
    "first null": pa.array([None, *AXES[1:].tolist()]),
    "short": pa.array([[0.0, 0.0, 0.0], [1.0], *AXES[2:].tolist()]),
    "in a struct": pa.array([{"gyro": rate} for rate in AXES.tolist()]),
}


@pytest.mark.parametrize("lists", LISTS)
@pytest.mark.parametrize("kind", ["parquet", "feather", "jsonl"])
def test_lists_of_three_are_three_columns(tmp_path, kind, lists):
    """Where a list is missing or too short there are no numbers, as in a cell that is empty."""
    name = "imu" if lists == "in a struct" else "gyro"
    path = tmp_path / f"log.{kind}"
    table = pa.table({"t_ns": np.arange(50), name: LISTS[lists]})
    if kind == "jsonl":
        path.write_text("\n".join(map(json.dumps, table.to_pylist())))
    else:
        (parquet.write_table if kind == "parquet" else feather.write_feather)(table, path)
    expected = AXES.copy()
    if lists == "first null":
        expected[0] = np.nan
    if lists == "short":
        expected[:2] = [0, 0, 0], [1, np.nan, np.nan]
    np.testing.assert_array_equal(read_rates(path, rate_unit="rad/s").rate, expected)


def test_long_lists_are_refused(tmp_path):
    """A file of one object with all columns is no table with a row a sample."""
    path = tmp_path / "log.json"
    path.write_text(json.dumps({name: list(range(40)) for name in ("t_ns", "wx", "wy", "wz")}))
    with pytest.raises(UnsupportedLogError, match="column 'wx' holds lists, not numbers"):
        read_rates(path)


def test_a_stream_of_arrow_is_read(tmp_path):
    """It is what a file of Arrow is without beginning and end."""
    path = tmp_path / "log.arrows"
    table = pa.table({"t_ns": np.arange(50), **dict(zip(("wx", "wy", "wz"), AXES.T, strict=True))})
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
        stream.write_table(table, max_chunksize=20)
    assert read_rates(path).rate.tolist() == AXES.tolist()
