"""One row of the vocabulary is all that a new device needs, for its messages and its files."""

import re
import struct

import numpy as np
import pandas as pd
import pytest
from make.mcap import Topic, write_topics
from rosbags.rosbag1 import Writer as BagWriter

from quatprop import DataLossWarning, RemarkWarning, read_attitudes, read_rates
from quatprop.base.errors import NoRatesError
from quatprop.readers import vocabulary
from quatprop.readers.messages.schema import ros_name
from quatprop.readers.vocabulary import PARTS, WXYZ, XYZ, Row
from quatprop.settings.quantities import LAYOUTS, METHODS, RATE_UNITS, TIME_UNITS

NAME = "my_msgs/msg/Gyro"
ROW = Row(
    "Made up",
    (NAME,),
    rate="turn" + XYZ,
    quat="att" + WXYZ,
    unit="deg/s",
    layout="scalar-first",
    stamps=("stamp_us",),
    time_unit="us",
)
DEFINITION = "uint64 stamp_us\nfloat64[3] turn\nfloat64[4] att\n"
STAMPS = 1_700_000_000_000_000 + 10_000 * np.arange(20)
RATES = np.random.default_rng(1).uniform(-90.0, 90.0, (20, 3)).round(3)
ATTITUDES = np.tile([0.5, -0.5, 0.5, 0.5], (20, 1))


def write(path, kind):
    """Write the samples as one kind of log."""
    rows = [*zip(STAMPS.tolist(), RATES.tolist(), ATTITUDES.tolist(), strict=True)]
    plain = [struct.pack("<Q7d", stamp, *rate, *attitude) for stamp, rate, attitude in rows]
    if kind == "cdr":
        messages = [b"\0\1\0\0" + data for data in plain]
        topic = Topic(NAME, messages, DEFINITION.encode(), "ros2msg", "cdr")
        write_topics(path, {"/gyro": topic})
    elif kind == "json":
        named = [dict(zip(("stamp_us", "turn", "att"), row, strict=True)) for row in rows]
        write_topics(path, {"/gyro": Topic(NAME, named)})
    elif kind == "bag":
        with BagWriter(path) as writer:
            connection = writer.add_connection("/gyro", NAME, msgdef=DEFINITION, md5sum="*")
            for stamp, data in zip(STAMPS.tolist(), plain, strict=True):
                writer.write(connection, stamp * 1000, data)
    else:
        names = [*(f"turn[{k}]" for k in range(3)), *(f"att[{k}]" for k in range(4))]
        frame = pd.DataFrame(np.hstack((RATES, ATTITUDES)), columns=names)
        frame.insert(0, "stamp_us", STAMPS)
        frame.to_csv(path, index=False) if kind == "csv" else frame.to_parquet(path)
    return path


@pytest.mark.parametrize("kind", ["cdr", "bag", "json", "csv", "parquet"])
def test_a_row_is_read_from_every_kind_of_log(tmp_path, monkeypatch, kind):
    """Unit, time and layout are those of the row, whatever the log."""
    monkeypatch.setattr(vocabulary, "ROWS", (*vocabulary.ROWS, ROW))
    monkeypatch.setitem(vocabulary.TYPES, NAME, ROW)
    path = write(tmp_path / "log", kind)
    rates, attitudes = read_rates(path), read_attitudes(path)
    for series in (rates, attitudes):
        assert series.t_ns.tolist() == (STAMPS * 1000).tolist()
    np.testing.assert_array_equal(rates.rate, RATES * (np.pi / 180.0))
    np.testing.assert_array_equal(attitudes.wxyz, ATTITUDES)


@pytest.mark.parametrize("row", vocabulary.ROWS, ids=lambda row: row.name or row.types[0])
def test_rows_say_what_can_be_read(row):
    """A misspelled type, unit or pattern would find nothing, or fail on some log."""
    assert row.name or row.types
    assert [ros_name(name) for name in row.types] == [*row.types]
    assert row.unit in {"", *RATE_UNITS}
    assert row.time_unit in {"", *TIME_UNITS}
    assert row.angle_unit in {"", "rad", "deg"}
    assert row.layout in {"", *LAYOUTS}
    assert row.method in {None, *METHODS}
    for quantity in PARTS:
        if pattern := getattr(row, quantity):
            assert "part" in re.compile(pattern).groupindex, quantity
            assert is_component(quantity, pattern), quantity
    assert all(isinstance(names, tuple) for names in (row.types, row.stamps, row.needs))
    for pattern in (*row.stamps, row.file):
        re.compile(pattern)


def is_component(quantity, pattern):
    """Return whether the group of a pattern has a spelling of every component, or its number."""
    (part,) = re.findall(r"\(\?P<part>((?:[^()]|\[[^]]*\])*)\)", pattern)
    spellings = [each.split("|") for each in PARTS[quantity]]
    numbers = [[str(k + 1)] for k in range(len(spellings))]
    return any(
        all(any(re.fullmatch(part, one, re.IGNORECASE) for one in each) for each in every)
        for every in (spellings, numbers)
    )


@pytest.mark.parametrize(
    ("part", "is_good"),
    [("[xyz]", True), ("[123]", True), ("roll|pitch|yaw", True), ("[abc]", False), ("[xy]", False)],
)
def test_a_row_names_every_component(part, is_good):
    """A row with other letters passed, and was a bug for the user."""
    assert is_component("rate", f"turn_(?P<part>{part})") == is_good


@pytest.mark.parametrize("first", [0, 1])
def test_components_are_numbered_from_0_or_1(tmp_path, monkeypatch, first):
    """From 1 on, they were a bug for the user; a fourth one is no component."""
    row = Row("Made up", rate=r"spin#(?P<part>\d)", unit="deg/s", stamps=("clk",), time_unit="us")
    monkeypatch.setattr(vocabulary, "ROWS", (*vocabulary.ROWS, row))
    path = tmp_path / "log.csv"
    names = [f"spin#{first + k}" for k in range(3)]
    path.write_text(f"clk,{','.join(names)}\n" + "".join(f"{k},1,2,{k}\n" for k in range(3)))
    rates = read_rates(path)
    np.testing.assert_allclose(np.rad2deg(rates.rate), [(1, 2, k) for k in range(3)])
    path.write_text(f"clk,{','.join(names)},spin#{first + 3}\n0,1,2,3,4\n")
    with pytest.raises(NoRatesError):
        read_rates(path)


def test_a_type_has_one_row():
    """Of two rows the first would never be read."""
    assert sorted(name for row in vocabulary.ROWS for name in row.types) == sorted(vocabulary.TYPES)


@pytest.mark.parametrize("rate", ["P(?P<part>[XYZ])", "p(?P<part>[xyz])"])
def test_columns_are_named_as_spelled_or_by_key(tmp_path, monkeypatch, rate):
    """The letters of the axes may be capitals in both."""
    row = Row("Made up", rate=rate, unit="deg/s", stamps=("MyTick",), time_unit="us")
    monkeypatch.setattr(vocabulary, "ROWS", (*vocabulary.ROWS, row))
    path = tmp_path / "log.csv"
    path.write_text("MyTick,PX,PY,PZ\n" + "".join(f"{k}000,1,2,{k}\n" for k in range(3)))
    rates = read_rates(path)
    assert rates.t_ns.tolist() == [0, 1_000_000, 2_000_000]
    np.testing.assert_allclose(np.rad2deg(rates.rate), [(1, 2, k) for k in range(3)])


def test_increments_of_PX4_are_read_from_its_tables(tmp_path):
    """The row of VehicleImu serves ulog2csv: angles over the time that the sensor integrated."""
    path = tmp_path / "log_vehicle_imu_0.csv"
    angles = np.random.default_rng(2).normal(0.0, 1e-3, (20, 3))
    frame = pd.DataFrame(angles, columns=[f"delta_angle[{k}]" for k in range(3)])
    frame.assign(delta_angle_dt=5000, timestamp_sample=np.arange(20) * 5000).to_csv(path)
    with pytest.warns(RemarkWarning, match="the samples are angle increments"):
        rates = read_rates(path)
    np.testing.assert_allclose(rates.rate, angles / 0.005, rtol=1e-15)
    assert rates.integration_time_ns.tolist() == [5_000_000] * 20


def test_bursts_of_PX4_are_read_from_its_tables(tmp_path):
    """The row of SensorGyroFifo serves ulog2csv; a row that cannot be is lost and counted."""
    path = tmp_path / "log_sensor_gyro_fifo_0.csv"
    stored = np.random.default_rng(3).integers(-900, 900, (6, 12))
    frame = pd.DataFrame(stored, columns=[f"{axis}[{k}]" for axis in "xyz" for k in range(4)])
    frame.insert(0, "timestamp_sample", (np.arange(6) + 1) * 1000)
    frame = frame.assign(dt=250.0, scale=0.001, samples=[4, 4, 4, 9, 4, 4])
    frame.to_csv(path, index=False)
    with (
        pytest.warns(RemarkWarning, match="rate_unit says deg/s"),
        pytest.warns(RemarkWarning, match="several samples per message"),
        pytest.warns(DataLossWarning, match="counts 9 samples"),
    ):
        rates, overruled = read_rates(path), read_rates(path, rate_unit="deg/s")
    kept = stored[[0, 1, 2, 4, 5]].reshape(5, 3, 4).swapaxes(1, 2).reshape(-1, 3)
    np.testing.assert_array_equal(rates.rate, kept * 0.001)
    np.testing.assert_allclose(overruled.rate, np.radians(rates.rate), rtol=1e-15)
    assert rates.t_ns[:4].tolist() == [250_000, 500_000, 750_000, 1_000_000]
