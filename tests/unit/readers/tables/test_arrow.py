"""Parquet and Feather tables: types, units, nested columns, damage."""

import json
from datetime import UTC, datetime
from decimal import Decimal

import numpy as np
import pyarrow as pa
import pytest
from make.table_rates import refusal, table_rates
from pyarrow import feather, parquet

from quatprop import propagate
from quatprop.base.errors import DamagedLogError
from quatprop.readers.open_log import open_log

RATES = {"wx": [1.0, 4.0], "wy": [2.0, 5.0], "wz": [3.0, 6.0]}
RAD = {"rate_unit": "rad/s"}
EPOCH = datetime(2026, 1, 1, tzinfo=UTC)
T0 = 1767225600_000000000


@pytest.fixture(params=["parquet", "feather"])
def written(request, tmp_path):
    """Return a function that writes a table in one of the formats."""

    def write(columns):
        path = tmp_path / f"log.{request.param}"
        save = parquet.write_table if request.param == "parquet" else feather.write_feather
        save(pa.table(columns), path)
        return path

    return write


def steady(count, values=None):
    """Return a table with as many rows, a ns apart."""
    values = np.ones(count) if values is None else values
    return pa.table({"t_ns": np.arange(count), "wx": values, "wy": values, "wz": values})


def decimals(places, *numbers):
    """Return numbers as a column with so many decimal places."""
    return pa.array(map(Decimal, numbers), pa.decimal128(places + 2, places))


@pytest.mark.parametrize(
    ("time", "unit", "t_ns"),
    [
        (pa.array([T0, T0 + 1], pa.timestamp("ns", "UTC")), None, [T0, T0 + 1]),
        (pa.array([EPOCH, EPOCH], pa.timestamp("us")), None, [T0, T0]),
        (pa.array([EPOCH, EPOCH], pa.timestamp("s")), None, [T0, T0]),
        (pa.array([1, 2], pa.duration("ms")), None, [1_000_000, 2_000_000]),
        (pa.array([5, 7], pa.uint32()), "us", [5_000, 7_000]),
        (decimals(10, "0.1234567895", "-1.5"), "s", [123456790, -1500000000]),
        (decimals(1, "0.5", "1.5"), "s", [500000000, 1500000000]),
        # A unit against the type applies.
        (pa.array([1, 2], pa.timestamp("ns")), "s", [1_000_000_000, 2_000_000_000]),
        # The float nearest to .7504675.
        (pa.array([1763590172.7504675, -0.25]), "s", [1763590172750467539, -250000000]),
    ],
    ids=lambda value: str(value.type) if isinstance(value, pa.Array) else "",
)
def test_times_of_every_type_are_exact(written, time, unit, t_ns):
    """Times become ns without a detour through floats; timestamps know that they are the time."""
    name = "recorded" if pa.types.is_timestamp(time.type) else "stamp"
    found = table_rates(written({name: time, **RATES}), time_unit=unit, **RAD)
    assert found.t_ns == t_ns


def test_the_number_of_rows_is_known_before_they_are_read(tmp_path):
    """For progress and for arrays of the right size; of a Feather file to within a batch."""
    table = steady(2500)
    parquet.write_table(table, tmp_path / "log.parquet", row_group_size=1000)
    feather.write_feather(table, tmp_path / "log.feather", chunksize=1000)
    counts = {}
    for path in tmp_path.iterdir():
        with open_log(path) as log:
            counts[path.suffix] = log.row_count()
    assert counts == {".parquet": 2500, ".feather": 3000}


def test_nested_columns_are_opened(written):
    """Messages as structs are found by their fields; a name with dots is no struct."""
    stamp = {"sec": 3, "nanosec": 7}
    columns = {
        "header": [{"stamp": stamp, "frame_id": "imu"}],
        "angular_velocity": [{"x": 1.0, "y": 2.0, "z": 3.0}],
    }
    flattened = {"header.stamp.sec": [3], "header.stamp.nanosec": [7]}
    flattened |= {f"angular_velocity.{axis}": [k] for k, axis in enumerate("xyz", 1)}
    for table in (columns, flattened):
        found = table_rates(written(table))
        assert (found.t_ns, found.rate.tolist()) == ([3_000_000_007], [[1, 2, 3]])


def test_rates_of_any_number_type_are_read(written):
    """Integers, short floats and nulls become float64; null becomes NaN."""
    columns = {
        "t_ns": [1, 2],
        "wx": pa.array([1, None], pa.int16()),
        "wy": pa.array([0.5, 2.5], pa.float32()),
        "wz": pa.array([Decimal("0.25"), Decimal("-0.75")], pa.decimal128(5, 2)),
    }
    found = table_rates(written(columns))
    np.testing.assert_array_equal(found.rate, [[1, 0.5, 0.25], [np.nan, 2.5, -0.75]])
    assert found.losses == []


@pytest.mark.parametrize("time", [[1, None], [1.0, float("nan")], [1.0, None]])
def test_rows_without_a_time_are_told(written, time):
    """A row that has no stamp is left out and counted."""
    found = table_rates(written({"t": time, **RATES}), time_unit="ns", **RAD)
    assert (found.t_ns, found.rate.tolist()) == ([1], [[1, 2, 3]])
    assert [(loss.place, loss.messages) for loss in found.losses] == [("rows 1 to 2", 1)]


@pytest.mark.parametrize(
    "time", [[2**62], [9.3e18], [Decimal(2**62)], [Decimal(10**37)], pa.array([2**63], pa.uint64())]
)
def test_times_that_overflow_are_refused(written, time):
    """A stamp beyond the years 1678 to 2262 is a wrong unit."""
    path = written({"t": time, "wx": [1.0], "wy": [1.0], "wz": [1.0]})
    assert "'t' do not fit in int64 ns when they are s; che" in refusal(path, time_unit="s", **RAD)


def test_a_time_of_two_parts_may_overflow_as_a_sum(written):
    """Each of them alone fits."""
    rates = {name: [1.0] for name in RATES}
    for nanoseconds in (854_775_807, 854_775_808):
        path = written({"s": [9_223_372_036], "ns": [nanoseconds], **rates})
        if nanoseconds == 854_775_807:
            assert table_rates(path, time_col="s,ns", **RAD).t_ns == [2**63 - 1]
        else:
            assert "'s', 'ns' do not fit in int64 ns" in refusal(path, time_col="s,ns", **RAD)


def test_text_columns_are_refused(written):
    """A column of text is not parsed as numbers."""
    sentence = refusal(written({"t_ns": [1, 2], **RATES, "wx": ["1", "2"]}))
    assert sentence.startswith("column 'wx' holds text, not numbers; convert it")


def test_a_sample_rate_counts_rows_across_batches(written):
    """Rows are counted from the start of the file, not of the batch."""
    path = written(steady(200_000, np.sin(np.arange(200_000) / 50)).drop_columns("t_ns"))
    found = table_rates(path, sample_rate=1000.0, **RAD)
    assert found.t_ns == [*range(0, 200_000 * 1_000_000, 1_000_000)]
    last = propagate(path, sample_rate=1000.0, start="+199s", **RAD)
    assert (last.t_ns[0], len(last.t_ns)) == (199 * 10**9, 1000)


@pytest.mark.parametrize("save", [feather.write_feather, parquet.write_table])
def test_of_columns_of_one_name_none_is_read(tmp_path, save):
    """Not by its number either: what reads them goes by names."""
    numbers = [pa.array([1, 2]), *([pa.array([0.1, 0.2])] * 4)]
    save(pa.Table.from_arrays(numbers, ["t_ns", "wx", "wy", "wz", "wx"]), tmp_path / "log")
    sentence = "several columns are named 'wx'; rename all but one of them"
    assert refusal(tmp_path / "log", rate_cols=("1", "2", "3"), **RAD) == sentence


def test_a_parquet_file_without_row_groups_has_no_rows(tmp_path):
    """Its footer says what the columns are."""
    path = tmp_path / "log.parquet"
    parquet.ParquetWriter(path, steady(1).schema).close()
    assert table_rates(path).t_ns == []


def test_a_parquet_file_without_its_footer_is_refused(tmp_path):
    """A Parquet file that was not written to the end has no schema."""
    path = tmp_path / "log.parquet"
    parquet.write_table(steady(2), path)
    path.write_bytes(path.read_bytes()[:-20])
    assert refusal(path, DamagedLogError).endswith(
        "only there does a Parquet file say what its columns are, so none of its "
        f"{path.stat().st_size} bytes can be read; was it closed?"
    )


@pytest.mark.parametrize("kind", ["parquet", "indexed.parquet", "feather", "dictionary.feather"])
def test_joined_files_are_refused(tmp_path, kind):
    """Of two files in one, pyarrow sees the last only, and takes the bytes of the first for it."""
    first, second, both = (tmp_path / f"{name}.{kind}" for name in ("first", "second", "both"))
    for path, rows in ((first, 40), (second, 30_000)):
        note = pa.array(["a"] * 20 + ["b"] * (rows - 20)).dictionary_encode()
        table = steady(rows).append_column("note", note)
        if "parquet" in kind:
            parquet.write_table(table, path, write_page_index="indexed" in kind)
        elif "dictionary" in kind:
            feather.write_feather(table, path)
        else:
            feather.write_feather(table.drop_columns("note"), path, compression="uncompressed")
    data = second.read_bytes()
    missing = data[:99] + data[999:] if "parquet" in kind else data.replace(bytes(600), b"", 1)
    for one, other in ((first, data), (second, first.read_bytes()), (first, missing)):
        both.write_bytes(one.read_bytes() + other)
        place = "another file begins in it at byte"
        place += "" if other == missing else f" {one.stat().st_size}; split it there into two"
        assert refusal(both).startswith(place)
        assert len(table_rates(one).t_ns) in {40, 30_000}


def test_a_footer_need_not_list_dictionaries(tmp_path):
    """Some programs leave the list out where there are none; pyarrow writes an empty one."""
    path = tmp_path / "log.feather"
    feather.write_feather(steady(40), path)
    data = bytearray(path.read_bytes())
    footer = len(data) - 10 - int.from_bytes(data[-10:-6], "little")
    root = footer + int.from_bytes(data[footer : footer + 4], "little")
    offsets = root - int.from_bytes(data[root : root + 4], "little", signed=True)
    data[offsets + 8 : offsets + 10] = bytes(2)
    path.write_bytes(data)
    found = table_rates(path, **RAD)
    assert (found.t_ns, found.losses) == ([*range(40)], [])
    path.write_bytes(data + data)
    assert refusal(path).startswith(f"another file begins in it at byte {len(data)}")


def test_damaged_row_groups_are_lost_alone(tmp_path):
    """Damage inside a Parquet file costs its row group; those after it are read."""
    path = tmp_path / "log.parquet"
    table = steady(30_000, np.random.default_rng(1).normal(size=30_000))
    parquet.write_table(table, path, row_group_size=10_000, compression="zstd")
    data = bytearray(path.read_bytes())
    chunk = parquet.ParquetFile(path).metadata.row_group(1).column(2)
    begin = chunk.dictionary_page_offset or chunk.data_page_offset
    data[begin : begin + 2000] = bytes(2000)  # the head of a page and what follows
    path.write_bytes(data)
    t_ns, _, losses, _ = table_rates(path)
    assert t_ns == [*range(10_000), *range(20_000, 30_000)]
    assert [(loss.place, loss.messages) for loss in losses] == [("row group 1", 10_000)]


PAGES = [{}, {"data_page_version": "2.0"}, {"compression": "none", "use_dictionary": False}]


@pytest.mark.parametrize("options", PAGES, ids=str)
def test_no_flipped_bit_in_checked_pages_is_believed(tmp_path, options, monkeypatch):
    """A sign bit in a page with a checksum gave a wrong rate, one in its head a group less."""
    path = tmp_path / "log.parquet"
    rates = np.random.default_rng(3).normal(size=(40, 3))
    table = pa.table({"t_ns": np.arange(40), **dict(zip(RATES, rates.T, strict=True))})
    parquet.write_table(table, path, write_page_checksum=True, row_group_size=20, **options)
    good = path.read_bytes()
    groups = parquet.ParquetFile(path).metadata
    lost = 0
    for byte in range(4, len(good) - 8 - groups.serialized_size, 29):
        data = bytearray(good)
        data[byte] ^= 1 << byte % 8
        path.write_bytes(data)
        t_ns, rate, losses, _ = table_rates(path)
        assert np.array_equal(rate, rates[t_ns])
        assert 40 - len(t_ns) == sum(loss.messages for loss in losses)
        lost += len(losses)
    assert lost > 50
    column = groups.row_group(1).column(1)
    data = bytearray(good)
    data[column.data_page_offset + column.total_compressed_size - 2] ^= 1
    path.write_bytes(data)
    (loss,) = table_rates(path).losses
    reason = "could not verify page integrity, CRC checksum verification failed for page_ordinal 0"
    assert loss[1:] == (f"it is damaged: {reason}", 20)
    if "compression" in options:
        monkeypatch.setenv("QUATPROP_CHECKSUMS", "ignore")
        t_ns, rate, losses, _ = table_rates(path)
        assert (len(t_ns), losses) == (40, [])
        assert not np.array_equal(rate, rates)


def test_a_feather_file_cut_between_batches_is_reported_as_cut(tmp_path):
    """If a file ends after a whole batch, the remark is that more may have followed."""
    path = tmp_path / "log.feather"
    feather.write_feather(steady(3_000), path, compression="uncompressed", chunksize=100)
    data = path.read_bytes()
    # A message begins with this mark; the last is that of the end.
    path.write_bytes(data[: data.rindex(b"\xff\xff\xff\xff")])
    t_ns, _, (loss,), _ = table_rates(path)
    assert t_ns == [*range(3_000)]
    reason = "it is damaged: its footer is damaged or missing, so more batches may have followed"
    assert loss[:2] == ("end of the file", reason)


def test_feather_version_1_is_refused(tmp_path):
    """The first Feather format is another one; the sentence says what to do."""
    path = tmp_path / "log.feather"
    path.write_bytes(b"FEA1" + bytes(100))
    assert refusal(path).startswith("it is of Feather version 1; save it again")


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
    np.testing.assert_array_equal(table_rates(path, **RAD).rate, expected)


def test_long_lists_are_refused(tmp_path):
    """A file of one object with all columns is no table with a row a sample."""
    path = tmp_path / "log.json"
    for length in (1, 17, 40):
        path.write_text(json.dumps({"t_ns": 1, **{name: [*range(length)] for name in RATES}}))
        assert refusal(path).startswith("column 'wx' holds lists, not numbers")
    path.write_text(json.dumps({"t_ns": 1, **{name: [*range(16)] for name in RATES}}))
    found = table_rates(path, rate_cols=("wx[0]", "wy[1]", "wz[15]"), **RAD)
    assert found.rate.tolist() == [[0, 1, 15]]


def test_a_time_in_a_list_is_a_time(tmp_path):
    """It has no statistics under its own name, by which a range could be found."""
    path = tmp_path / "log.parquet"
    table = pa.table({"t": [[k, 0] for k in range(50)], "gyro": AXES.tolist()})
    parquet.write_table(table, path)
    found = propagate(path, time_col="t[0]", time_unit="ns", start="+40ns", **RAD)
    assert found.t_ns.tolist() == [*range(40, 50)]


def test_a_stream_of_arrow_is_read(tmp_path):
    """It is what a file of Arrow is without beginning and end."""
    path = tmp_path / "log.arrows"
    table = steady(50, AXES[:, 0])
    with pa.OSFile(str(path), "wb") as file, pa.ipc.new_stream(file, table.schema) as stream:
        stream.write_table(table, max_chunksize=20)
    assert table_rates(path).rate[:, 1].tolist() == AXES[:, 0].tolist()
