"""Text tables: exact times, dialects, and what stands above and between the rows."""

import gzip
import io
import lzma
import math
import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from make.commands import run
from make.table_rates import refusal, table_rates

from quatprop import read_rates
from quatprop.base.errors import (
    LogError,
    Loss,
    NoRatesError,
    UndeclaredError,
    UnreadableLogError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.base.times import NS_PER_UNIT
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.tables import exact_times, text_rows
from quatprop.readers.tables.arrow import ParquetLog
from quatprop.readers.tables.csv import CsvLog
from quatprop.settings.reading import RateSelection

UNITS = {"rate_unit": "rad/s", "time_unit": "s"}


@pytest.mark.parametrize(
    ("time", "unit", "t_ns"),
    [
        ("1763590172.750467512", "s", 1763590172750467512),
        ("0.1", "s", 100000000),
        ("-0.000000001", "s", -1),
        ("0.30000000000000004", "s", 300000000),
        ("0.2999999999999999889", "s", 300000000),
        ("3.0e-1", "s", 300000000),
        ("0.0000000005", "s", 0),
        ("0.0000000015", "s", 2),
        ("-0.0000000025", "s", -2),
        ("1.403715523912140000e+18", "ns", 1403715523912140000),
        ("1.5e-30", "s", 0),
        ("17e-40000000", "s", 0),
        ("2.5E3", "s", 2500000000000),
        ("-2", "s", -2000000000),
        ("-2", "ms", -2000000),
        ("-2", "us", -2000),
        ("-2", "ns", -2),
    ],
)
def test_a_time_is_its_nearest_nanosecond(time, unit, t_ns):
    """Decimals that no float64 holds are exact, and halves go to the even nanosecond."""
    rows = f"t,wx,wy,wz\n{time},1,2,3e-50\n"
    assert table_rates(rows, rate_unit="rad/s", time_unit=unit)[::2] == ([t_ns], [])


@pytest.mark.parametrize(
    ("time", "t_ns"),
    [
        *((" 7 ", 7), ("007", 7), ("+7", 7), ("-7", -7), ("7.5", 8), ("7e1", 70)),
        *((f"{2**63 - 1}", 2**63 - 1), (f"{2**63}", None), ("0x7", None), ("0X7", None)),
        *(("7_0", None), ("7,", None)),
    ],
)
def test_a_time_among_integers_is_read_as_among_decimals(time, t_ns):
    """How the first time is written does not decide what another one is."""
    for first in ("3", "3.0"):
        rows = f"t,wx,wy,wz\n{first},1,2,3\n{time},1,2,3\n4,1,2,3\n"
        found, _, losses, _ = table_rates(rows, rate_unit="rad/s", time_unit="ns")
        assert found == [3, *([] if t_ns is None else [t_ns]), 4]
        assert sum(loss.messages for loss in losses) == (t_ns is None)


@pytest.mark.parametrize("number", ["17e-40", "1E-100", "1e-2147483647"])
def test_a_tiny_number_is_refused_wherever_it_is(number):
    """The text is searched in pieces: also where the number is in two of them."""
    for place in [0, *range((1 << 16) - 6, (1 << 16) + 2), 1 << 17]:
        text = b" " * place + number.encode()
        for whole in (text, text + b"," + bytes(1 << 16)):
            with pytest.raises(exact_times.TimestampRangeError):
                exact_times.refuse_tiny_numbers(memoryview(whole))
        for harmless in (b"1e-39", b"1e+40", b"1e-4"):
            exact_times.refuse_tiny_numbers(b" " * place + harmless)


NUMBERS = st.from_regex(r"-?[0-9]{1,45}(\.[0-9]{0,45})?(e[+-]?[0-9]{1,2})?", fullmatch=True)


@settings(max_examples=15)
@given(st.lists(NUMBERS, min_size=1, max_size=7))
@example(["0", "1", "700000000"])  # a sum beyond int64 made it the next turn of a counter
def test_any_number_is_read_exactly_or_not_at_all(times):
    """Numbers too long for the fast way are read the slow way or told, never misread."""
    rows = "".join(f"{time},1,2,3\n0,1,2,3\n0,1,2,3\n" for time in times)
    t_ns, _, losses, _ = table_rates(f"t,wx,wy,wz\n{rows}", **UNITS)
    expected = [stamp for time in times for stamp in (round(Fraction(time) * 10**9), 0, 0)]
    assert t_ns == [stamp for stamp in expected if -(2**63) < stamp < 2**63]
    assert sum(loss.messages for loss in losses) == len(expected) - len(t_ns)


@given(st.floats(-9e9, 9e9))
def test_a_float_stamp_is_its_exact_value_rounded(time):
    """A float column is not rounded twice on the way to nanoseconds."""
    found = exact_times.from_floats(np.array([time]), "s")
    assert found.tolist() == [round(Fraction(time) * 10**9)]


@given(st.integers(0, 10**9), st.one_of(st.integers(1, 10**5), st.floats(1e-3, 1e6)))
def test_counted_rows_do_not_drift(first, rate):
    """Row k of a steady table is at k / rate, rounded once, however far into the log."""
    period = 10**9 / Fraction(repr(float(rate)))
    if (first + 3) * period >= 2**63:
        with pytest.raises(UsageError, match="check sample_rate"):
            exact_times.row_stamps(first, 3, float(rate))
        return
    found = exact_times.row_stamps(first, 3, float(rate))
    assert found.tolist() == [round(k * period) for k in range(first, first + 3)]


def test_a_time_that_overflows_is_told_with_its_unit():
    """Nanoseconds read as seconds do not fit; the sentence shows value and unit."""
    sentence = refusal("t,gyro_x,gyro_y,gyro_z\n" + "1403715523912140000,1,2,3\n" * 3, **UNITS)
    assert sentence.startswith(
        "3 of its first 3 rows do not fit (line 2: 1403715523912140000 s in column 't' does not "
        "fit in int64 ns, but would in ns); check "
    )
    assert " units, such as time_unit, or" in sentence


def test_dates_are_read_to_the_nanosecond():
    """A time as text carries its own unit; without a zone it is read as UTC."""
    rows = "2026-01-01T00:00:00.123456789Z,1,2,3\n2026-01-01T01:00:01+01:00,1,2,3\n"
    text = f"when,gyro_x,gyro_y,gyro_z\n{rows}{rows}2026-13-01T00:00:00Z,1,2,3\n"
    t_ns, _, losses, _ = table_rates(text, rate_unit="rad/s")
    assert t_ns == [1767225600_123456789, 1767225601_000000000] * 2
    assert losses == [Loss("line 6", "'2026-13-01T00:00:00Z' in column 'when' is not a time", 1)]
    local = "time,gyro_x,gyro_y,gyro_z\n1970-01-01 00:00:01.5,1,2,3\n"
    assert table_rates(local, rate_unit="rad/s").t_ns == [1500000000]


def test_cells_that_are_not_a_number_are_kept_as_nan():
    """Empty and nan rates stay in the series, for the timeline policy to decide."""
    _, rate, losses, _ = table_rates("t,wx,wy,wz\n0,nan,,1\n1,NaN,null,inf\n", **UNITS)
    np.testing.assert_array_equal(rate, [[np.nan, np.nan, 1], [np.nan, np.nan, math.inf]])
    assert losses == []


# Dialects

SAME = {
    "comma": "t,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "semicolon": "t;wx;wy;wz\n0.5;1.5;2;3\n1.5;4;5;-6e-1\n",
    "decimal commas": "t;wx;wy;wz\n0,5;1,5;2;3\n1,5;4;5;-6e-1\n",
    "quoted decimal commas": 't,wx,wy,wz\n"0,5","1,5",2,3\n"1,5","4,0",5,"-6e-1"\n',
    "quoted decimal commas between semicolons": 't;wx;wy;wz\n"0,5";"1,5";2;3\n"1,5";4;5;-0,6\n',
    "tab": "t\twx\twy\twz\n 0.5\t1.5\t2\t3\n 1.5\t4\t5\t-6e-1\n",
    "trailing tab": "t\twx\twy\twz\n 0.5\t1.5\t2\t3\t\n 1.5\t4\t5\t-6e-1\t\n",
    "trailing tab in the header": "t\twx\twy\twz\t\n0.5\t1.5\t2\t3\n1.5\t4\t5\t-6e-1\n",
    "runs of tabs": "t\t\twx\twy\twz\n0.5\t1.5\t2\t3\n1.5\t\t4\t5\t\t-6e-1\n",
    "spaces": "# t   wx wy  wz\n  0.5 1.5  2   3\n1.5   4 5 -6e-1  \n",
    "byte-order mark": "\ufefft,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "CRLF": "t,wx,wy,wz\r\n0.5,1.5,2,3\r\n1.5,4,5,-6e-1\r\n",
    "old Macintosh": "t,wx,wy,wz\r0.5,1.5,2,3\r1.5,4,5,-6e-1\r",
    "blank lines": "\n\nt,wx,wy,wz\n\n0.5,1.5,2,3\n\n1.5,4,5,-6e-1\n\n",
    "rows of blanks": "t,wx,wy,wz\n0.5,1.5,2,3\n , , ,\n1.5,4,5,-6e-1\n",
    "comments before": "// Sample: 3\n// by 1, 2\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "comments between": "# log\nt,wx,wy,wz\n0.5,1.5,2,3\n# paused, 1, 2, 3\n1.5,4,5,-6e-1\n",
    "keys before": "device,7\nfirmware,2.5\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "wide keys before": "device,7,,\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "delimiters before": ",,,\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "repeated header": "t,wx,wy,wz\n0.5,1.5,2,3\nt,wx,wy,wz\n1.5,4,5,-6e-1\n",
    "repeated header with blanks": "t,wx,wy,wz\n0.5,1.5,2,3\nt, wx, wy, wz\n1.5,4,5,-6e-1\n",
    "quotes": '"t","wx","wy","wz"\n"0.5","1.5","2","3"\n"1.5","4","5","-6e-1"\n',
    "line breaks in cells": 't,wx,wy,wz,raw\n0.5,1.5,2,3,"a\r\n"\n1.5,4,5,-6e-1,"b\n,""c"\n',
    "columns of text": "t,frame,wx,wy,wz\n0.5,imu,1.5,2,3\n1.5,imu,4,5,-6e-1\n",
    "row of units": "t,wx,wy,wz\ns,rad/s,rad/s,rad/s\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "row of types": "t,wx,wy,wz\nfloat,float,float,float\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "row of unknown units": "t,wx,wy,wz\ns,u/s,u/s,u/s\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "minus signs": "t,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,\u22120.6\n",
    "minus signs and decimal commas": "t;wx;wy;wz\n0,5;1,5;2;3\n1,5;4;5;\u22126e\u22121\n",
    "row of brackets": "t,wx,wy,wz\n(s),(x),(x),(x)\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "groups over names": "t;gyro;;;acc;;\n;x;y;z;x;y;z\n0.5;1.5;2;3;0;0;0\n1.5;4;5;-6e-1;0;0;0\n",
}


@pytest.mark.parametrize("layout", SAME)
def test_every_layout_gives_the_same_series(layout):
    """Separators, marks, comments and line ends are not part of the data."""
    t_ns, rate, losses, _ = table_rates(SAME[layout], **UNITS)
    assert (t_ns, rate.tolist()) == ([500000000, 1500000000], [[1.5, 2, 3], [4, 5, -0.6]])
    assert losses == []


@pytest.mark.parametrize(
    "text",
    [
        't,wx,wy,wz\n0.5,1.5,2,3\n1.5,"-1,234.5",2,"12,345,678.25"\n',
        "t;wx;wy;wz\n0,5;1,5;2;3\n1,5;-1.234,5;2;12.345.678,25\n",
    ],
)
def test_marks_of_thousands_next_to_another_decimal_mark_are_left_out(text):
    """Such rows were lost; of two marks only the last is that of the decimals."""
    t_ns, rate, losses, _ = table_rates(text, **UNITS)
    assert t_ns == [500000000, 1500000000]
    assert rate.tolist() == [[1.5, 2, 3], [-1234.5, 2, 12345678.25]]
    assert losses == []


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('t,wx,wy,wz\n"1,234",1,2,3\n', "is not a time"),
        ('t,wx,wy,wz\n"1,234",0.5,2,3\n', "is not a time"),
        ('t,wx,wy,wz\n"0,5",1.5,2,3\n', "is not a time"),
        ("t;wx;wy;wz\n1,000;0.5;2;3\n", "is not a number with a decimal comma"),
        ("t;wx;wy;wz\n1.000;0,5;2;3\n", "is not a time with a decimal comma"),
        ("t;wx;wy;wz\n1,5;1.000;2;3\n", "is not a number with a decimal comma"),
    ],
)
def test_a_mark_that_may_be_one_of_thousands_is_no_decimal_mark(text, reason):
    """1,234 was 1.234; of points and commas one is between thousands, and nothing says which."""
    for variant in (text, text.replace(";", "\t")):
        assert reason in refusal(variant, **UNITS)


@given(st.data())
@settings(max_examples=40)
def test_the_series_does_not_depend_on_where_blocks_end(data):
    """However small the blocks, they are whole records and make up the text."""
    cell = st.sampled_from(["1", "2.5", "", '"a\nb"', '"c""d"', '"\r\n"'])
    rows = data.draw(st.lists(st.lists(cell, min_size=1, max_size=4).map(",".join), min_size=1))
    text = "\n".join(rows).encode()
    blocks = text_rows.record_blocks(
        text_rows.TextStream(io.BytesIO(text)), 1, data.draw(st.integers(64, 99))
    )
    cut = [bytes(block.data) for block in blocks]
    assert b"".join(cut) == text
    assert all(block.count(b'"') % 2 == 0 for block in cut)


@pytest.mark.parametrize(
    "head",
    [
        '"sep=\t"\nTime\tGyro_X_CAL\tGyro_Y_CAL\tGyro_Z_CAL\tAcc\t\nms\tdeg/s\tdeg/s\tdeg/s\tg\t\n',
        "time\tgyro_x\tgyro_y\tgyro_z\tacc_x\n[ms]\t[deg/s]\t[deg/s]\t[deg/s]\t[m/s^2]\n",
        "time\tgyroX\tgyroY\tgyroZ\taccelX\n(ms)\t(deg.s^-1)\t(deg.s^-1)\t(deg.s^-1)\t(g)\n",
        "ms\tdeg/s\tdeg/s\tdeg/s\tg\ntime\tgyro_x\tgyro_y\tgyro_z\tacc_x\n",
        "# a\tb\tc\td\te\ntime [ms]\twx [deg/s]\twy [deg/s]\twz [deg/s]\tacc_x [g]\n",
    ],
)
def test_a_row_of_units_next_to_the_names_may_have_units_of_other_sensors(head):
    """Those of the time and of the rates are what counts."""
    t_ns, rate, losses, _ = table_rates(f"{head}0\t180\t0\t0\t9.8\n10\t0\t90\t0\t9.8\n")
    assert (t_ns, losses) == ([0, 10_000_000], [])
    assert rate.tolist() == [[np.pi, 0, 0], [0, np.pi / 2, 0]]


def table_of_two_units(place, unit, below, time_unit="s", time_below="s"):
    """Return a table whose names state one unit, and a row next to them another."""
    names = [place.format(f"gyro_{axis}", unit) for axis in "xyz"]
    names = ",".join([place.format("time", time_unit), *names])
    units = f"{time_below},{below},{below},{below}"
    return f"{names}\n{units}\n0,180,0,0\n10,0,90,0\n"


RATES_IN = {"rad/s": ["rad_s", "radps"], "deg/s": ["deg_s", "dps"]}
TIMES_IN = {"s": ["s", "Seconds"], "ms": ["ms", "msec"], "us": ["us"], "ns": ["ns"]}
PLACES = ["{} ({})", "{} [{}]", "{}_{}"]
PAIRS = [(one, other) for one in RATES_IN for other in RATES_IN]


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("unit", "below"), PAIRS)
def test_two_units_of_a_rate_must_agree(place, unit, below):
    """A row of units won over the names without a word; neither is known to be right."""
    half_turn = {"rad/s": 180, "deg/s": np.pi}
    for one, other in zip(RATES_IN[unit], RATES_IN[below], strict=True):
        text = table_of_two_units(place, one, other)
        if unit == below:
            assert table_rates(text).rate[0, 0] == half_turn[unit]
            continue
        reason = refusal(text)
        assert f"are declared in {unit}, but also {below}; correct the wrong unit, or" in reason
        assert f"of the numbers with rate_unit='{unit}' or '{below}'" in reason
        for way in (unit, below):
            read = table_rates(text, rate_unit=way)
            assert read.rate[0, 0] == half_turn[way]
            assert any("declared in" in remark for remark in read.remarks)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("unit", TIMES_IN)
@pytest.mark.parametrize("below", TIMES_IN)
def test_two_units_of_a_time_must_agree(place, unit, below):
    """The time is read only in the unit that the user then names."""
    for one in TIMES_IN[unit]:
        text = table_of_two_units(place, "dps", "deg/s", one, TIMES_IN[below][-1])
        if unit == below:
            assert table_rates(text).t_ns == [0, 10 * NS_PER_UNIT[unit]]
            continue
        assert f"is declared in {unit}, but also {below}; correct the wrong" in refusal(text)
        for way in (unit, below):
            assert table_rates(text, time_unit=way).t_ns == [0, 10 * NS_PER_UNIT[way]]


@pytest.mark.parametrize("names", [("sensor", "axis"), (None, None)])
@pytest.mark.parametrize("index", ["time", None])
def test_columns_of_several_levels_of_pandas_are_read(names, index):
    """The levels are joined, and the name of the index stands below them."""
    columns = pd.MultiIndex.from_product([["acc", "gyro"], ["x", "y", "z"]], names=names)
    times = pd.to_datetime([0, 10**9], utc=True).rename(index)
    text = pd.DataFrame([[0, 0, 9, 1, 2, 3], [0, 0, 9, 4, 5, 6]], times, columns).to_csv()
    t_ns, rate, losses, _ = table_rates(text, rate_unit="rad/s")
    assert (t_ns, rate.tolist(), losses) == ([0, 10**9], [[1, 2, 3], [4, 5, 6]], [])


@pytest.mark.parametrize("commas", [["", ""], [",", ","], [",,,", ",,,"], ["", ",,"], [",,", ","]])
@pytest.mark.parametrize("names", ["t_ns,wx,wy,wz,a,b", "t_ns,wx,wy,wz,a,b,"])
@pytest.mark.parametrize("rest", ["1,2", ",2", ","])
def test_cells_of_trailing_commas_have_no_names(names, rest, commas):
    """SensorLog ends its rows with several; the whole header was discarded."""
    rows = [f"{k},1,2,3,{rest}{commas[k % 2]}\n" for k in range(9)]
    t_ns, rate, losses, _ = table_rates(f"{names}\n{''.join(rows)}")
    # A row that is narrower than the first has lost its end.
    assert len(losses) == sum(row.count(",") < rows[0].count(",") for row in rows)
    assert len(t_ns) + len(losses) == 9
    assert rate[0].tolist() == [1, 2, 3]


# Lines above the rows

GCSV = (
    "GYROFLOW IMU LOG\nversion,1.3\norientation,{}\ntscale,{}\ngscale,0.25\nt,gx,gy,gz,ax,ay,az\n"
)
MOUNTED = "the file says how its sensor is mounted, and rates are used as they are; "


@pytest.mark.parametrize(
    ("letters", "remark"),
    [
        ("YxZ", MOUNTED + "to turn them into the camera's axes use mount='y,-x,z'"),
        ("zXy", MOUNTED + "to turn them into the camera's axes use mount='-z,x,-y'"),
        ("XYz", MOUNTED + "as the mounting x,y,-z is left-handed, it cannot be right"),
        *((letters, "") for letters in ("XYZ", "XXZ", "north")),
    ],
)
def test_a_gcsv_is_scaled_and_says_how_its_sensor_is_mounted(letters, remark):
    """The key tscale makes the time seconds, gscale the counts rad/s; small letters are -x."""
    rows = "0,39,86,-183,0,0,0\n1,4,8,12,0,0,0\n"
    t_ns, rate, _, remarks = table_rates(GCSV.format(letters, 0.001) + rows)
    assert (t_ns, rate.tolist()) == ([0, 1000000], [[9.75, 21.5, -45.75], [1, 2, 3]])
    assert remarks == [remark] * bool(remark)


@pytest.mark.parametrize("scale", ["0.002", "10", "0.01", "0.0000305175", "1e-7", "2.5e-6"])
def test_a_gcsv_has_ticks_of_any_length(scale):
    """They were refused, except for decimal units; each is rounded to ns by itself."""
    ticks = [0, 7, 12_345, 2_000_003]
    rows = "".join(f"{tick},1,2,3,0,0,0\n" for tick in ticks)
    found = table_rates(GCSV.format("XYZ", scale) + rows).t_ns
    assert found == [round(tick * Fraction(scale) * 10**9) for tick in ticks]


def test_a_gcsv_without_a_time_scale_is_refused():
    """Or with one in which no time passes."""
    sentence = refusal(GCSV.format("XYZ", "ms") + "0,1,2,3,0,0,0\n")
    assert sentence == "its tscale or gscale is not a number"
    sentence = refusal(GCSV.format("XYZ", "0") + "0,1,2,3,0,0,0\n")
    assert sentence == "its tscale 0 is not a length of time above 0"


def test_a_header_may_be_of_latin_1():
    """As programs of Windows write the sign of a degree."""
    text = "t [s],wx [\u00b0/s],wy [\u00b0/s],wz [\u00b0/s]\n0,180,0,0\n".encode("latin-1")
    assert table_rates(text).rate.tolist() == [[np.pi, 0, 0]]


@pytest.mark.parametrize(
    "comment",
    [
        "Sample rate: 2000.0Hz",
        "data_rate = 2000.0 Hz",
        "Output Rate: 2 kHz",
        "sample-rate 2000Hz",
        "Sampling frequency=2kHz",
        "Accelerometer sample rate: 2 kHz\n# Gyroscope sample rate: 2000 Hz",
    ],
)
def test_the_sample_rate_in_the_comments_is_the_time(comment):
    """It goes by many names; no time column is needed, and lost rows keep their place."""
    text = f"# {comment}\nn\tGyr_X\tGyr_Y\tGyr_Z\n7\t1\t2\t3\n8\t1\n9\t4\t5\t6\n"
    t_ns, rate, losses, _ = table_rates(text, rate_unit="rad/s")
    assert (t_ns, rate.tolist()) == ([0, 1_000_000], [[1, 2, 3], [4, 5, 6]])
    line = 4 + comment.count("\n")
    assert losses == [Loss(f"line {line}", "it has 2 columns instead of 4", 1)]


def test_sample_rates_that_differ_in_the_comments_are_not_the_time():
    """That of another sensor would stretch the time."""
    text = "# Accelerometer sample rate: 50 Hz\n# Gyroscope sample rate: 100 Hz\nn,wx,wy,wz\n"
    sentence = refusal(f"{text}0,1,2,3\n1,1,2,3\n", UndeclaredError, rate_unit="rad/s")
    assert "whether 'n' is the time is not declared" in sentence


def test_a_sample_rate_too_low_for_the_clock_is_refused():
    """Rows that would last for centuries are a mistake in the sample rate."""
    text = "wx,wy,wz\n1,2,3\n4,5,6\n"
    sentence = refusal(text, UsageError, rate_unit="rad/s", sample_rate=1e-10)
    assert "at 1e-10 Hz the times of 2 samples do not fit " in sentence
    assert "; check sample" in sentence


def test_rows_of_one_kind_have_the_header_of_their_kind():
    """Loggers describe all kinds of records first, each in a comment."""
    rows = "".join(f"GYRO,{k},1,2,3\n" for k in range(9))
    head = "# GYRO,t_ns,wx [rad/s],wy [rad/s],wz [rad/s]\n# ACC,t_ns,ax,ay,az\n"
    t_ns, rate, losses, _ = table_rates(head + rows)
    assert (t_ns, rate[0].tolist(), losses) == ([*range(9)], [1, 2, 3], [])


def test_a_unit_of_time_of_attitudes_that_the_header_contradicts_is_told(tmp_path):
    """In convert as in propagate."""
    path = tmp_path / "a.csv"
    path.write_text("time_ms,qw,qx,qy,qz\n0,1,0,0,0\n10,1,0,0,0\n")
    assert (
        "note: --time-unit says s, but by header or convention 'time_ms' is in ms; read in s"
    ) in run("convert", path, "-", "--time-col", "0", "--time-unit", "s").stderr


# Texts that are not one table


MANY = 20_000


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_rows_that_are_appended_to_a_large_table_are_not_read(tmp_path, name):
    """Of a small one they were not, and of one beyond 256 KiB they were."""
    rows = "".join(f"{k}000000,0.1,0.2,0.3\n" for k in range(MANY))
    data = f"t_ns,wx,wy,wz\n{rows}".encode()
    log, is_packed = tmp_path / name, name.endswith(".gz")
    log.write_bytes(gzip.compress(data) if is_packed else data)
    with open_log(log) as opened:
        with log.open("ab") as file:
            more = f"{MANY}000000,0,0,0\n".encode()
            file.write(gzip.compress(more) if is_packed else more)
        batches = choose_rates(opened, RateSelection()).batches()
        assert sum(map(len, batches)) == MANY
        assert not opened.losses


def test_a_stream_of_nothing_is_refused():
    """As an empty file is."""
    assert refusal("", UnreadableLogError) == "it is empty; was the recording closed?"


@pytest.mark.parametrize("kind", [CsvLog, ParquetLog])
def test_a_file_that_vanishes_is_told(tmp_path, kind):
    """A path that leads nowhere is told as the system tells it."""
    with pytest.raises(UnreadableLogError, match=r"no such file or folder; check the path$"):
        kind(tmp_path / "none")


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:12\n", "get the log with git"),
        (lzma.compress(b"t_ns,wx,wy,wz\n"), "it is an archive; unpack it"),
        (b"log.csv".ljust(257, b"\0") + b"ustar\0", "it is a tar archive; unpack it"),
        (b"\xa3\x95\x80\x80\x59FMT", "convert it to CSV with mavlogdump.py"),
        (b"H Product:Blackbox flight data recorder\n", "convert it with blackbox_decode"),
        (b'[\n {"t_ns": 0, "wx": 1}]\n', "for example with jq -c '.[]'"),
    ],
)
@pytest.mark.parametrize("name", ["log.csv", "log.mcap", "log"])
def test_other_formats_are_refused_with_the_way_out(tmp_path, name, content, reason):
    """Whatever the name of the file says."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnsupportedLogError, match=re.escape(reason)):
        read_rates(path)


@pytest.mark.parametrize("suffix", ["parquet", "mcap", "feather", "npz", "h5", "db3"])
def test_a_table_of_text_with_the_suffix_of_another_format_is_told(tmp_path, suffix):
    """It was called damaged; the way out reads it."""
    path = tmp_path / f"log.{suffix}"
    path.write_text("t_ns,wx,wy,wz\n0,1,2,3\n1,4,5,6\n")
    with pytest.raises(UnsupportedLogError, match="it is text, and no log of kind") as caught:
        read_rates(path)
    kind = re.search("kind='(.*?)'", str(caught.value))[1]
    assert read_rates(path, kind=kind).rate.tolist() == [[1, 2, 3], [4, 5, 6]]


SEVERAL = "t_s,wx,wy,wz\n" + "".join(f"{k},1,2,3\n" for k in range(9))
MIXED = "GYRO,t_ns,wx,wy,wz\n" + "".join(f"GYRO,{k},1,2,3\nACC,{k},0,0,9.8\n" for k in range(9))
NO_ROWS = "none of its first 9 lines is a row of"
NO_TEXT = "it holds NUL bytes, as no text does; if it is a table, save it again as a"
UTF16 = "it is UTF-16 text; if it is a table, save it again as a"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("\ufefft,wx\n".encode("utf-16-le"), UTF16),
        ("\ufefft,wx\n".encode("utf-16-be"), UTF16),
        (b"\x00\x01\x02", NO_TEXT),
        (bytes(10_000), NO_TEXT),
        (MIXED, "its rows begin with 'ACC', 'GYRO', so"),
        (f"# {MIXED}", "its rows begin with 'ACC', 'GYRO', so"),
        # Of the rows but the last, which may be cut, most are not as wide as the first.
        ("1,2,3\n1,2,3,4\n1,2,3,4,5\n1,2,3,4,5,6\n", "its rows have 3, 4, 5 columns, so it"),
        (f"{SEVERAL}t_s,wz,wy,wx\n9,4,5,6\n", "another table begins at line 11; split it "),
        (f"{SEVERAL}t_s,ax,ay,az\n9,4,5,6\n", "another table begins at line 11; split it "),
        (f"{SEVERAL}t_s,wx_dps,wy_dps,wz_dps\n9,4,5,6\n", "another table begins at line 11; spl"),
        (9 * "  <x/>\n", NO_ROWS),
        (9 * "t=590 gx=0.1 gy=0.2 gz=0.3\n", NO_ROWS),
        (9 * "1.0D+0 2.0D+0 3.0D+0\n", NO_ROWS),
        ("Red, green, and blue.\n" + 8 * "Nothing but words\n", NO_ROWS),
    ],
)
def test_what_is_no_table_is_refused(text, reason):
    """Rows below another header, or of another kind, would be taken for rates."""
    assert refusal(text, LogError, rate_unit="rad/s").startswith(reason)


def test_times_on_lines_of_their_own_are_refused_with_a_way_to_join_them():
    """Each was a lost row that took a sample period: twice the time."""
    for count in (3, 30):
        rows = "".join(f"2023-11-14 22:13:{k:02d}.5\n0.1,0.2,0.3\n" for k in range(count))
        assert refusal(rows, rate_cols=("0", "1", "2"), rate_unit="rad/s", sample_rate=100) == (
            "times such as '2023-11-14 22:13:01.5' are on lines of their own between its rows; "
            "write each on the line of its row, such as with paste -d, - -"
        )
    for between in ("", "# no time"):
        text = "t,wx,wy,wz\n" + "".join(f"{k},1,2,3\n{between}\n" for k in range(9))
        assert len(table_rates(text, **UNITS).t_ns) == 9
    named = {"rate_cols": ("1", "2", "3"), "time_col": "0", "rate_unit": "rad/s"}
    t_ns, _, losses, _ = table_rates(rows.replace(".5\n", ".5,"), **named)
    assert (len(t_ns), {*np.diff(t_ns).tolist()}, losses) == (30, {10**9}, [])
    for time in ("14.11.2023 22:13:20", "22:13:20.5", "1700000000.5"):
        text = "wx,wy,wz\n" + f"0.1,0.2,0.3\n{time}\n" * 9
        sentence = refusal(text, rate_unit="rad/s", sample_rate=100)
        # With a header above, joining pairs of lines would not do.
        assert sentence.endswith("write each on the line of its row")


def test_a_table_without_names_shows_what_its_columns_hold():
    """Of `ros2 topic echo --csv` the option was looked for by trial: numbers of columns alone."""
    rows = "7,imu,0.5,0.6,0.7\n8,imu,0.5,0.6,0.7\n"
    seen = "its columns are '0: 7', '1: imu', '2: 0.5', '3: 0.6', '4: 0.7'; name the columns"
    assert seen in refusal(rows, NoRatesError)
    cells = "0,0,0,1," + "0," * 9 + "0.1,0.2,0.3," + ",".join("0" * 21)
    text = "".join(f"1700000000,{k}0000000,imu,{cells}\n" for k in range(1, 9))
    named = {"rate_cols": ("16", "17", "18"), "time_col": "0,1", "rate_unit": "rad/s"}
    t_ns, rate, *_ = table_rates(text, **named)  # as formats.md says of sensor_msgs/Imu
    assert (t_ns[0], rate[0].tolist()) == (1_700_000_000_010_000_000, [0.1, 0.2, 0.3])


def test_quaternions_of_opensim_are_refused_with_a_way_to_take_cells_apart():
    """They were seven columns of no names, cut in the middle of quaternions."""
    rows = "".join(f"{k / 10}\t0.8,0.6,0,0\t1,0,0,0\n" for k in range(9))
    head = "DataRate=10\nDataType=Quaternion\nversion=3\nendheader\n"
    assert refusal(f"{head}time\tpelvis\ttibia\n{rows}") == (
        "it is an OpenSim table, with a quaternion in a cell; write one number a cell with "
        r"sed '1,/^time/d' FILE | tr , '\t', and read the first sensor with quat_cols='1,2,3,4' "
        "from_layout='wxyz' time_col='0' time_unit='s'"
    )


def test_checksums_at_the_end_of_rows_are_no_numbers():
    """VectorNav's NMEA sentences; the refusal names the command that removes them, and it works."""
    rows = "".join(f"$VNIMU,{k / 100},+00.1,-00.2,+00.3*{k + 16:02X}\n" for k in range(30))
    assert refusal(rows) == (
        "its rows end in NMEA checksums, such as '*10'; remove them, for example with sed -E "
        r"'s/\*[0-9A-Fa-f]{2}//'"
    )
    bare = re.sub(r"\*[0-9A-Fa-f]{2}", "", rows)
    t_ns, rate, *_ = table_rates(bare, rate_cols=("2", "3", "4"), time_col="1", **UNITS)
    assert (t_ns[1], rate[0].tolist()) == (10**7, [0.1, -0.2, 0.3])


def test_a_row_of_a_date_and_words_is_no_header():
    """A logger that could not read its sensor says so in its rows."""
    text = "time,wx,wy,wz\n2023-11-14T22:13:20Z,1,2,3\n2023-11-14T22:13:21Z,ERR,ERR,ERR\n"
    t_ns, _, losses, _ = table_rates(text + "2023-11-14T22:13:22Z,1,2,3\n", rate_unit="rad/s")
    assert len(t_ns) == 2
    assert losses == [Loss("line 3", "'ERR' in column 'wx' is not a number", 1)]


def test_recordings_ask_for_what_they_do_not_say(shared_logs):
    """Line breaks in cells, a counter at a declared rate, two clocks of which one is named."""
    path = shared_logs / "nested_imu/kiran_car_circle_data_0_imu.csv"
    assert "specify them with rate_unit=" in refusal(path, UndeclaredError)
    t_ns, rate, losses, _ = table_rates(path, **UNITS)
    assert (len(t_ns), t_ns[0], losses) == (2530, int(Decimal("1763590172.7504675") * 10**9), [])
    assert rate[0].tolist() == [0.037773, 0.029186, -0.272747]
    path = shared_logs / "csv/data_xsens.txt"
    assert "the unit of the rates 'Gyr_X', 'Gyr_Y', 'Gyr_Z'" in refusal(path, UndeclaredError)
    t_ns, rate, losses, _ = table_rates(path, rate_unit="rad/s")
    assert (len(t_ns), t_ns[-1], losses) == (953, 952 * 20_000_000, [])
    assert rate[0].tolist() == [0.059158, -0.030138, 0.050860]
    path = shared_logs / "nested_imu/kiran_11sec_motion/11sec_motion_0.csv"
    t_ns = table_rates(path, time_col="ros_t", **UNITS).t_ns
    # The export is rounded to its last digit.
    assert (len(t_ns), abs(t_ns[-1] - 1761940429719152646) < 200) == (414, True)
