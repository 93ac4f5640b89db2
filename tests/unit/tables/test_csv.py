"""Text tables: exact time, units, layouts, damaged rows, real recordings."""

import bz2
import gzip
import io
import json
import lzma
import math
import re
import subprocess
import sys
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from make.table_rates import rate_batches

from quatprop import read_rates
from quatprop.cli.commands import cli
from quatprop.errors import UndeclaredError, UnreadableLogError, UnsupportedLogError, UsageError
from quatprop.tables import text_stream, timestamps
from quatprop.tables.csv.log import CsvLog
from quatprop.tables.log import Loss

UNITS = {"rate_unit": "rad/s", "time_unit": "s"}
NUMBERED = {"rate_cols": ("1", "2", "3"), "time_col": "0", **UNITS}


def read(source, **options):
    """Return stamps, rates and losses of a table given as text, bytes or a path."""
    if isinstance(source, str):
        source = source.encode()
    log = CsvLog(io.BytesIO(source) if isinstance(source, bytes) else source)
    with log:
        batches = list(rate_batches(log, **options))
    t_ns = np.concatenate([np.empty(0, np.int64), *(batch.t_ns for batch in batches)])
    rate = np.concatenate([np.empty((0, 3)), *(batch.rate for batch in batches)])
    return t_ns, rate, log.losses


def stamps(*times, unit="s"):
    """Return the stamps that a table with these times is read with."""
    rows = "".join(f"{time},1,2,3\n" for time in times)
    t_ns, _, losses = read(f"t,wx,wy,wz\n{rows}", rate_unit="rad/s", time_unit=unit)
    assert losses == []
    return t_ns.tolist()


# Time


def test_decimal_seconds_are_exact():
    """Seconds since 1970 with nine places come out to the nanosecond, which no float64 holds."""
    assert stamps("1763590172.750467512", "0.1", "-0.000000001", "7") == [
        *(1763590172750467512, 100000000, -1, 7000000000)
    ]


@pytest.mark.parametrize("time", ["0.30000000000000004", "0.2999999999999999889", "3.0e-1"])
def test_more_digits_than_nanoseconds_are_rounded(time):
    """The 17 digits of a float printed in full are the nearest nanosecond."""
    assert stamps(time) == [300000000]


def test_halves_are_rounded_to_even():
    """A stamp exactly between two nanoseconds goes to the even one, as everywhere in decimals."""
    assert stamps("0.0000000005", "0.0000000015", "-0.0000000025") == [0, 2, -2]


def test_stamps_with_exponents_are_exact():
    """The way numpy.savetxt writes nanoseconds keeps every digit."""
    assert stamps("1.403715523912140000e+18", unit="ns") == [1403715523912140000]
    assert stamps("1.5e-30", "2.5E3") == [0, 2500000000000]


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_every_unit_counts_nanoseconds(unit):
    """One unit is its number of nanoseconds."""
    assert stamps("1", "-2", unit=unit) == [
        *({"s": 1, "ms": 10**-3, "us": 10**-6, "ns": 10**-9}[unit] * k * 10**9 for k in (1, -2))
    ]


@given(st.lists(st.decimals(-(10**9), 10**9, allow_nan=False, places=12), min_size=1, max_size=20))
def test_any_decimal_is_its_nearest_nanosecond(times):
    """Whatever is written, the stamp is the nearest nanosecond of exact arithmetic."""
    expected = [round(Fraction(time) * 10**9) for time in times]
    assert stamps(*(f"{time:f}" for time in times)) == expected
    assert [timestamps.from_text(str(time), "s") for time in times] == expected


@given(st.from_regex(r"-?[0-9]{1,45}(\.[0-9]{0,45})?(e[+-]?[0-9]{1,2})?", fullmatch=True))
def test_any_number_is_read_exactly_or_not_at_all(time):
    """Numbers too long for the fast way are read the slow way or told, never misread."""
    t_ns, _, losses = read(f"t,wx,wy,wz\n{time},1,2,3\n0,1,2,3\n1,1,2,3\n", **UNITS)
    expected = round(Fraction(time) * 10**9)
    fits = -(2**63) <= expected < 2**63
    assert t_ns.tolist() == [expected] * fits + [0, 10**9]
    assert len(losses) == (not fits)


@given(st.floats(-9e9, 9e9))
def test_a_float_stamp_is_its_exact_value_rounded(time):
    """A float column is not rounded twice on the way to nanoseconds."""
    found = timestamps.from_floats(np.array([time]), "s")
    assert found.tolist() == [round(Fraction(time) * 10**9)]


@given(st.integers(0, 10**9), st.one_of(st.integers(1, 10**5), st.floats(1e-3, 1e6)))
def test_counted_rows_do_not_drift(first, rate):
    """Row k of a steady table is at k / rate, rounded once, however far into the log."""
    period = 10**9 / Fraction(repr(float(rate)))
    if (first + 3) * period >= 2**63:
        with pytest.raises(UsageError, match="check sample_rate"):
            timestamps.row_stamps(first, 3, float(rate))
        return
    found = timestamps.row_stamps(first, 3, float(rate))
    assert found.tolist() == [round(k * period) for k in range(first, first + 3)]


def test_seconds_and_nanoseconds_are_added_exactly():
    """Two whole columns make one stamp, also where the nanoseconds exceed a second."""
    text = (
        "header.stamp.secs,header.stamp.nsecs,angular_velocity.x,angular_velocity.y,"
        "angular_velocity.z\n1432235497,988949113,1,2,3\n1432235498,1000000001,1,2,3\n"
    )
    t_ns, _, _ = read(text)
    assert t_ns.tolist() == [1432235497988949113, 1432235499000000001]


def test_a_time_that_overflows_is_told_with_its_unit():
    """Nanoseconds read as seconds do not fit; the sentence shows value and unit."""
    text = "t,gyro_x,gyro_y,gyro_z\n" + "1403715523912140000,1,2,3\n" * 3
    with pytest.raises(
        UnsupportedLogError,
        match=r"-: 3 of its first 3 rows do not fit \(line 2: 1403715523912140000 s in column "
        r"'t' does not fit in int64 ns, but would in ns\); check .* units, such as time_unit, or",
    ):
        read(text, **UNITS)


def test_dates_are_read_to_the_nanosecond():
    """A time as text carries its own unit, and a damaged one is told like any other."""
    rows = "2026-01-01T00:00:00.123456789Z,1,2,3\n2026-01-01T01:00:01+01:00,1,2,3\n"
    text = f"when,gyro_x,gyro_y,gyro_z\n{rows}{rows}2026-13-01T00:00:00Z,1,2,3\n"
    t_ns, _, losses = read(text, rate_unit="rad/s")
    assert t_ns.tolist() == [1767225600_123456789, 1767225601_000000000] * 2
    assert losses == [Loss("line 6", "'2026-13-01T00:00:00Z' in column 'when' is not a time", 1)]


def test_dates_without_a_zone_are_taken_as_they_stand():
    """Differences are what counts; without a zone the clock is read as UTC."""
    t_ns, _, _ = read("time,gyro_x,gyro_y,gyro_z\n1970-01-01 00:00:01.5,1,2,3\n", rate_unit="rad/s")
    assert t_ns.tolist() == [1500000000]


# Rates


def test_degrees_become_radians():
    """A deg/s column times pi/180 is rad/s."""
    _, rate, _ = read(
        "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)\n0,180,90,-1\n"
    )
    assert rate.tolist() == [[math.pi, math.pi / 2, -math.pi / 180]]


def test_cells_that_are_not_a_number_are_kept_as_nan():
    """Empty and nan rates stay in the series, for the timeline policy to decide."""
    _, rate, losses = read("t,wx,wy,wz\n0,nan,,1\n1,NaN,null,inf\n", **UNITS)
    assert np.isnan(rate[:, :2]).all()
    assert rate[:, 2].tolist() == [1, math.inf]
    assert losses == []


# Layouts

SAME = {
    "comma": "t,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "semicolon": "t;wx;wy;wz\n0.5;1.5;2;3\n1.5;4;5;-6e-1\n",
    "decimal commas": "t;wx;wy;wz\n0,5;1,5;2;3\n1,5;4;5;-6e-1\n",
    "quoted decimal commas": 't,wx,wy,wz\n"0,5","1,5",2,3\n"1,5","4,0",5,"-6e-1"\n',
    "quoted decimal commas between semicolons": 't;wx;wy;wz\n"0,5";"1,5";2;3\n"1,5";4;5;-0,6\n',
    "tab": "t\twx\twy\twz\n 0.5\t1.5\t2\t3\n 1.5\t4\t5\t-6e-1\n",
    "trailing tab": "t\twx\twy\twz\n 0.5\t1.5\t2\t3\t\n 1.5\t4\t5\t-6e-1\t\n",
    "trailing tab in the header": "t\twx\twy\twz\t\n0.5\t1.5\t2\t3\n1.5\t4\t5\t-6e-1\n",
    "spaces": "# t   wx wy  wz\n  0.5 1.5  2   3\n1.5   4 5 -6e-1  \n",
    "byte-order mark": "\ufefft,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "CRLF": "t,wx,wy,wz\r\n0.5,1.5,2,3\r\n1.5,4,5,-6e-1\r\n",
    "no end of line": "t,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1",
    "blank lines": "\n\nt,wx,wy,wz\n\n0.5,1.5,2,3\n\n1.5,4,5,-6e-1\n\n",
    "rows of blanks": "t,wx,wy,wz\n0.5,1.5,2,3\n , , ,\n1.5,4,5,-6e-1\n",
    "comments before": "// Sample: 3\n// by 1, 2\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "comments between": "t,wx,wy,wz\n0.5,1.5,2,3\n# paused, 1, 2, 3\n1.5,4,5,-6e-1\n",
    "keys before": "device,7\nfirmware,2.5\nt,wx,wy,wz\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "repeated header": "t,wx,wy,wz\n0.5,1.5,2,3\nt,wx,wy,wz\n1.5,4,5,-6e-1\n",
    "quotes": '"t","wx","wy","wz"\n"0.5","1.5","2","3"\n"1.5","4","5","-6e-1"\n',
    "line breaks in cells": 't,wx,wy,wz,raw\n0.5,1.5,2,3,"a\r\n"\n1.5,4,5,-6e-1,"b\n,""c"\n',
    "columns of text": "t,frame,wx,wy,wz\n0.5,imu,1.5,2,3\n1.5,imu,4,5,-6e-1\n",
    "row of units": "t,wx,wy,wz\ns,rad/s,rad/s,rad/s\n0.5,1.5,2,3\n1.5,4,5,-6e-1\n",
    "groups over names": "t;gyro;;;acc;;\n;x;y;z;x;y;z\n0.5;1.5;2;3;0;0;0\n1.5;4;5;-6e-1;0;0;0\n",
}


@pytest.mark.parametrize("layout", SAME)
def test_every_layout_gives_the_same_series(layout):
    """Separators, marks, comments and line ends are not part of the data."""
    t_ns, rate, losses = read(SAME[layout], **UNITS)
    assert t_ns.tolist() == [500000000, 1500000000]
    assert rate.tolist() == [[1.5, 2, 3], [4, 5, -0.6]]
    assert losses == []


@pytest.mark.parametrize("rows", ['"1,234",1,2,3', '"1,234",0.5,2,3', '"0,5",1.5,2,3'])
def test_a_quoted_comma_that_may_be_one_of_thousands_is_no_decimal_comma(rows):
    """1,234 is not read as 1.234, nor any comma beside numbers with a point."""
    with pytest.raises(
        UnsupportedLogError, match=r"1 of its first 1 rows do not fit .*is not a ti"
    ):
        read(f"t,wx,wy,wz\n{rows}\n", **UNITS)


@pytest.mark.parametrize("row", ["1,000;0.5;2;3", "1.000;0,5;2;3", "1,5;1.000;2;3"])
@pytest.mark.parametrize("delimiter", ";\t")
def test_points_beside_decimal_commas_are_refused(row, delimiter):
    """One of the two is between thousands, and nothing says which."""
    row = row.replace(";", delimiter)
    with pytest.raises(UnsupportedLogError, match=r"' is not a (time|number) with a decimal comma"):
        read(f"t;wx;wy;wz\n{row}\n".replace(";", delimiter), **UNITS)


def test_a_table_without_a_header_has_numbered_columns():
    """Columns are named by number where the file does not name them."""
    text = b"0.5 1.5 2 3\n1.5 4 5 6\n"
    assert CsvLog(io.BytesIO(text)).names == ["0", "1", "2", "3"]
    t_ns, rate, _ = read(text, **NUMBERED)
    assert t_ns.tolist() == [500000000, 1500000000]
    assert rate[1].tolist() == [4, 5, 6]


def test_a_table_with_a_header_and_no_rows_is_an_empty_series():
    """Nothing was recorded, and that is not an error of the file."""
    t_ns, _, losses = read("t_ns,wx,wy,wz\n")
    assert len(t_ns) == 0
    assert losses == []


def test_gcsv_is_scaled():
    """The key tscale makes the time seconds and gscale makes the counts rad/s."""
    text = (
        "GYROFLOW IMU LOG\nversion,1.3\norientation,YxZ\ntscale,0.001\ngscale,0.25\n"
        "t,gx,gy,gz,ax,ay,az\n0,39,86,-183,0,0,0\n1,4,8,12,0,0,0\n"
    )
    t_ns, rate, _ = read(text)
    assert t_ns.tolist() == [0, 1000000]
    assert rate.tolist() == [[9.75, 21.5, -45.75], [1, 2, 3]]


@pytest.mark.parametrize(
    ("letters", "mount"),
    [("XYZ", ""), ("YxZ", "y,-x,z"), ("zXy", "-z,x,-y"), ("XXZ", ""), ("north", "")],
)
def test_the_orientation_of_a_gcsv_is_a_mounting(tmp_path, letters, mount):
    """Small letters are axes turned around; what is no orientation says nothing."""
    path = tmp_path / "log.gcsv"
    path.write_text(
        f"GYROFLOW IMU LOG\norientation,{letters}\ntscale,0.001\ngscale,1\nt,gx,gy,gz\n0,1,2,3\n"
    )
    assert CsvLog(path).notes.mount == mount


def test_a_gcsv_with_an_odd_time_scale_is_refused():
    """A tick that is no decimal unit would not be exact."""
    text = "GYROFLOW IMU LOG\ntscale,0.002\ngscale,1\nt,gx,gy,gz\n0,1,2,3\n"
    with pytest.raises(UnsupportedLogError, match=r"its tscale 0.002 is not 1, 0.001"):
        read(text)


def test_the_sample_rate_in_the_comments_is_the_time():
    """A table that declares its rate needs no time column, and lost rows keep their place."""
    text = "// Sample rate: 2.0Hz\nn\tGyr_X\tGyr_Y\tGyr_Z\n7\t1\t2\t3\n8\t1\n9\t4\t5\t6\n"
    t_ns, rate, losses = read(text, rate_unit="rad/s")
    assert t_ns.tolist() == [0, 1000000000]
    assert rate.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert losses == [Loss("line 4", "it has 2 columns instead of 4", 1)]


def test_a_time_too_small_for_decimals_is_read_exactly(tmp_path):
    """It is zero ns, and does not end the process, which is why it is tried in one of its own."""
    path = tmp_path / "log.csv"
    path.write_text("t,wx,wy,wz\n17e-40000000,1,2,3\n1,1,2,3e-50\n2,1,2,3\n")
    command = [sys.executable, "-m", "quatprop", "propagate", path, "-o", "-", "-q"]
    units = ["--time-unit", "s", "--rate-unit", "rad/s"]
    done = subprocess.run([*command, *units], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    stamps = [row.split(",")[0] for row in done.stdout.splitlines()[1:]]
    assert stamps == ["0", "1000000000", "2000000000"]


def test_sample_rates_that_differ_in_the_comments_are_not_the_time():
    """That of another sensor would stretch the time; rates that agree are one."""
    text = "# Accelerometer sample rate: 50 Hz\n# Gyroscope sample rate: {} Hz\nn,wx,wy,wz\n"
    rows = "0,1,2,3\n1,1,2,3\n"
    with pytest.raises(UndeclaredError, match=r"whether 'n' is the time is not declared"):
        read(text.format(100) + rows, rate_unit="rad/s")
    assert read(text.format(50) + rows, rate_unit="rad/s")[0].tolist() == [0, 20_000_000]


def test_a_sample_rate_too_low_for_the_clock_is_refused():
    """Rows that would last for centuries are a mistake in the sample rate."""
    with pytest.raises(
        UsageError, match=r"at 1e-10 Hz the times of 2 samples do not fit .*; check sample"
    ):
        read("wx,wy,wz\n1,2,3\n4,5,6\n", rate_unit="rad/s", sample_rate=1e-10)


# Damage


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("1,2,3", "it has 3 columns instead of 4"),
        ("1,2,3,4,5", "it has 5 columns instead of 4"),
        ("1,2,x3,4", "'x3' in column 'wx' is not a number"),
        ("1e999999999,2,3,4", "1e999999999 s in column 't' does not fit"),
        ("inf,2,3,4", "'inf' in column 't' is not a time"),
        ("1e,2,3,4", "'1e' in column 't' is not a time"),
        (",2,3,4", "'' in column 't' is not a time"),
        ("99999999999999999999,2,3,4", "99999999999999999999 s in column 't' does not fit"),
    ],
)
def test_a_row_that_does_not_fit_is_left_out_and_told(row, reason):
    """A damaged row is lost alone, with its line and the reason."""
    row = row.replace("2,x3", "x3,2")
    t_ns, _, losses = read(f"t,wx,wy,wz\n0,1,2,3\n\n{row}\n2,1,2,3\n3,1,2,3\n", **UNITS)
    assert t_ns.tolist() == [0, 2000000000, 3000000000]
    (loss,) = losses
    assert (loss.place, loss.messages) == ("line 4", 1)
    assert loss.reason.startswith(reason)


def test_a_torn_last_line_is_told():
    """A recording that was cut off loses the row it was writing."""
    t_ns, _, losses = read("t,wx,wy,wz\n0,1,2,3\n1,1,2,3\n2,1,", **UNITS)
    assert len(t_ns) == 2
    assert losses == [Loss("line 4", "it has 3 columns instead of 4", 1)]


def test_many_losses_are_told_together():
    """Losses are counted by place, so that a bad log does not fill the memory with sentences."""
    rows = ["1,1,2,3"] * 99
    rows[2:90:9] = ["1"] * len(rows[2:90:9])
    _, _, losses = read("t,wx,wy,wz\n" + "\n".join(rows), **UNITS)
    assert losses == [
        Loss(
            "lines 4 to 85",
            "10 of these rows do not fit; the first: it has 1 columns instead of 4",
            10,
        )
    ]


def test_damage_far_into_a_log_is_told_by_its_line(tmp_path):
    """Line numbers hold across blocks, and the rest of the block is read."""
    rows = [f"{k},1,2,3" for k in range(600_000)]
    rows[500_000] = "torn"
    path = tmp_path / "log.csv"
    path.write_text("t,wx,wy,wz\n" + "\n".join(rows) + "\n")
    for source in (path, path.read_bytes()):
        t_ns, _, losses = read(source, **UNITS)
        assert len(t_ns) == 599_999
        assert losses == [Loss("line 500002", "it has 1 columns instead of 4", 1)]


def test_a_stray_quote_does_not_swallow_the_log():
    """A quote that is never closed costs the rows near it, not the rest of the file."""
    rows = [f"{k},1,2,3" for k in range(600_000)]
    rows[300_000] = '300000,"1,2,3'
    t_ns, _, losses = read("t,wx,wy,wz\n" + "\n".join(rows) + "\n", **UNITS)
    assert len(t_ns) > 590_000
    assert t_ns[-1] == 599_999 * 10**9
    assert losses


def test_a_log_is_read_again_from_the_start(tmp_path):
    """A file can be read twice; what was lost is told once."""
    path = tmp_path / "log.csv"
    path.write_text("t,wx,wy,wz\n0,1,2,3\n1\n2,1,2,3\n")
    with CsvLog(path) as log:
        for _ in range(2):
            assert sum(map(len, rate_batches(log, **UNITS))) == 2
        assert len(log.losses) == 1


def test_stdin_is_read_once():
    """A stream cannot be started again, and that is said."""
    log = CsvLog(io.BytesIO(b"t_ns,wx,wy,wz\n0,1,2,3\n"))
    assert len(list(rate_batches(log))) == 1
    with pytest.raises(UsageError, match="stdin can be read only once"):
        list(rate_batches(log))


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
def test_packed_tables_are_unpacked_on_the_way(pack):
    """A packed stream gives the same series."""
    t_ns, _, losses = read(pack(b"t_ns,wx,wy,wz\n7,1,2,3\n"))
    assert t_ns.tolist() == [7]
    assert losses == []


def test_an_empty_file_is_told(tmp_path):
    """A file without a byte was never written to."""
    path = tmp_path / "log.csv"
    path.touch()
    with pytest.raises(
        UnreadableLogError, match=r"log.csv: it is empty; was the recording closed\?"
    ):
        CsvLog(path)


def test_a_missing_file_is_told(tmp_path):
    """A path that leads nowhere is told as the system tells it."""
    with pytest.raises(UnreadableLogError, match="no such file or folder; check the path"):
        CsvLog(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("content", "what"),
    [
        ("\ufefft,wx\n".encode("utf-16-le"), "it is UTF-16 text"),
        ("\ufefft,wx\n".encode("utf-16-be"), "it is UTF-16 text"),
        (b"\x00\x01\x02", "it holds NUL bytes, as no text does"),
    ],
)
def test_what_is_not_utf8_text_is_refused(content, what):
    """Bytes that are no text are refused with the way out."""
    with pytest.raises(UnsupportedLogError, match=f"{what}; if it is a table, save it again as a"):
        read(content)


@given(st.data())
def test_the_series_does_not_depend_on_where_blocks_end(data):
    """However small the blocks, they are whole records and make up the text."""
    cell = st.sampled_from(["1", "2.5", "", '"a\nb"', '"c""d"', '"\r\n"'])
    rows = data.draw(st.lists(st.lists(cell, min_size=1, max_size=4).map(",".join), min_size=1))
    text = "\n".join(rows).encode()
    stream = text_stream.TextStream(io.BytesIO(text))
    cut = [
        bytes(block.data)
        for block in text_stream.record_blocks(stream, 1, data.draw(st.integers(64, 99)))
    ]
    assert b"".join(cut) == text
    assert all(block.count(b'"') % 2 == 0 for block in cut)


# Tables and files of other programs


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:12\n",
            "get the log with git",
        ),
        (lzma.compress(b"t_ns,wx,wy,wz\n"), "it is an archive; unpack it"),
        (b"log.csv".ljust(257, b"\0") + b"ustar\0", "it is a tar archive; unpack it"),
        (b"\xa3\x95\x80\x80\x59FMT", "convert it to CSV with mavlogdump.py"),
        (b"H Product:Blackbox flight data recorder\n", "convert it with blackbox_decode"),
        (b'[\n {"t_ns": 0, "wx": 1}]\n', r"such as with jq -c '.\[\]'"),
    ],
)
@pytest.mark.parametrize("name", ["log.csv", "log.mcap", "log"])
def test_other_formats_are_refused_with_the_way_out(tmp_path, name, content, reason):
    """Whatever the name of the file says."""
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnsupportedLogError, match=reason):
        read_rates(path)


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
def test_a_row_of_units_beside_the_names_may_have_units_of_other_sensors(head):
    """Those of the time and of the rates are what counts."""
    t_ns, rate, losses = read(f"{head}0\t180\t0\t0\t9.8\n10\t0\t90\t0\t9.8\n".encode())
    assert t_ns.tolist() == [0, 10_000_000]
    assert rate.tolist() == [[np.pi, 0, 0], [0, np.pi / 2, 0]]
    assert losses == []


@pytest.mark.parametrize("row", ["float,float,float,float", "s,d/s,d/s,d/s", "(s),(x),(x),(x)"])
def test_what_repeats_below_the_names_is_no_name(row):
    """They are types or units that are not known: columns are found, and the user settles it."""
    header = f"t,gyro_x,gyro_y,gyro_z\n{row}\n"
    t_ns, rate, losses = read(f"{header}0,1,2,3\n1,4,5,6\n", **UNITS)
    assert (t_ns.tolist(), rate.tolist(), losses) == ([0, 10**9], [[1, 2, 3], [4, 5, 6]], [])


@pytest.mark.parametrize("names", [("sensor", "axis"), (None, None)])
@pytest.mark.parametrize("index", ["time", None])
def test_columns_of_several_levels_of_pandas_are_read(names, index):
    """The levels are joined, and the name of the index stands below them."""
    columns = pd.MultiIndex.from_product([["acc", "gyro"], ["x", "y", "z"]], names=names)
    times = pd.to_datetime([0, 10**9], utc=True).rename(index)
    text = pd.DataFrame([[0, 0, 9, 1, 2, 3], [0, 0, 9, 4, 5, 6]], times, columns).to_csv()
    t_ns, rate, losses = read(text, rate_unit="rad/s")
    assert (t_ns.tolist(), rate.tolist(), losses) == ([0, 10**9], [[1, 2, 3], [4, 5, 6]], [])


MIXED = "GYRO,{0},1,2,3\nACC,{0},0,0,9.8\n"


@pytest.mark.parametrize("header", ["GYRO,t_ns,wx,wy,wz\n", "# GYRO,t_ns,wx,wy,wz\n"])
def test_rows_that_begin_with_their_kind_are_refused(header):
    """Accelerations among the rates would be taken for rates."""
    text = header + "".join(map(MIXED.format, range(9)))
    with pytest.raises(UnsupportedLogError, match="its rows begin with 'ACC', 'GYRO', so"):
        read(text.encode())


@pytest.mark.parametrize("header", ["t_s,wz,wy,wx", "t_s,ax,ay,az", "t_s,wx_dps,wy_dps,wz_dps"])
def test_a_second_header_of_other_columns_is_refused(header):
    """The rows below it would be read as what the first header says."""
    first = "t_s,wx,wy,wz\n" + "".join(f"{k},1,2,3\n" for k in range(9))
    with pytest.raises(
        UnsupportedLogError, match=r"^-: another table begins at line 11; split it "
    ):
        read(f"{first}{header}\n9,4,5,6\n".encode(), rate_unit="rad/s")


@pytest.mark.parametrize("commas", [["", ""], [",", ","], [",,,", ",,,"], ["", ",,"], [",,", ","]])
@pytest.mark.parametrize("names", ["t_ns,wx,wy,wz,a,b", "t_ns,wx,wy,wz,a,b,"])
@pytest.mark.parametrize("rest", ["1,2", ",2", ","])
def test_cells_of_trailing_commas_have_no_names(names, rest, commas):
    """SensorLog ends its rows with several; the whole header was discarded."""
    rows = [f"{k},1,2,3,{rest}{commas[k % 2]}\n" for k in range(9)]
    t_ns, rate, losses = read(f"{names}\n{''.join(rows)}".encode())
    # A row that is narrower than the first has lost its end.
    assert len(losses) == sum(row.count(",") < rows[0].count(",") for row in rows)
    assert len(t_ns) + len(losses) == 9
    assert rate[0].tolist() == [1, 2, 3]


def test_times_on_lines_of_their_own_are_refused_with_a_way_to_join_them():
    """Each was a lost row that took a sample period: twice the time."""
    rows = "".join(f"2023-11-14 22:13:{k:02d}.5\n0.1,0.2,0.3\n" for k in range(30))
    with pytest.raises(UnsupportedLogError) as caught:
        read(rows.encode(), rate_cols=("0", "1", "2"), rate_unit="rad/s", sample_rate=100)
    assert str(caught.value) == (
        "-: times such as '2023-11-14 22:13:01.5' are on lines of their own between its rows; "
        "write each on the line of its row, such as with paste -d, - -"
    )
    joined = rows.replace(".5\n", ".5,")
    named = {"rate_cols": ("1", "2", "3"), "time_col": "0"}
    t_ns, _, losses = read(joined.encode(), rate_unit="rad/s", **named)
    assert (len(t_ns), losses) == (30, [])
    assert {*np.diff(t_ns).tolist()} == {10**9}


@pytest.mark.parametrize("time", ["14.11.2023 22:13:20", "22:13:20.5", "1700000000.5"])
def test_a_time_in_any_form_between_rows_is_no_row(time):
    """With a header above, joining pairs of lines would not do, and is not advised."""
    text = "wx,wy,wz\n" + f"0.1,0.2,0.3\n{time}\n" * 9
    with pytest.raises(UnsupportedLogError, match=r"write each on the line of its row$"):
        read(text.encode(), rate_unit="rad/s", sample_rate=100)


def test_checksums_at_the_end_of_rows_are_no_numbers():
    """VectorNav's sentences of NMEA; what takes them off is said, and works."""
    rows = "".join(f"$VNIMU,{k / 100},+00.1,-00.2,+00.3*{k + 16:02X}\n" for k in range(30))
    with pytest.raises(UnsupportedLogError) as caught:
        read(rows.encode())
    assert str(caught.value) == (
        "-: its rows end in NMEA checksums, such as '*10'; take them off, such as with sed -E "
        r"'s/\*[0-9A-Fa-f]{2}//'"
    )
    bare = re.sub(r"\*[0-9A-Fa-f]{2}", "", rows)
    named = {"rate_cols": ("2", "3", "4"), "time_col": "1", "time_unit": "s"}
    t_ns, rate, _ = read(bare.encode(), rate_unit="rad/s", **named)
    assert (t_ns[1], rate[0].tolist()) == (10**7, [0.1, -0.2, 0.3])


@pytest.mark.parametrize(
    "comment",
    [
        "data_rate = 2000.0 Hz",
        "Output Rate: 2 kHz",
        "sample-rate 2000Hz",
        "Sampling frequency=2kHz",
    ],
)
def test_a_rate_in_a_comment_goes_by_many_names(comment):
    """It counts the rows of a table without a time."""
    t_ns, _, _ = read(f"# {comment}\nwx,wy,wz\n1,2,3\n1,2,3\n".encode(), rate_unit="rad/s")
    assert t_ns.tolist() == [0, 500_000]


def test_a_row_of_a_date_and_words_is_no_header():
    """A logger that could not read its sensor says so in its rows."""
    text = "time,wx,wy,wz\n2023-11-14T22:13:20Z,1,2,3\n2023-11-14T22:13:21Z,ERR,ERR,ERR\n"
    t_ns, _, losses = read(text + "2023-11-14T22:13:22Z,1,2,3\n", rate_unit="rad/s")
    assert len(t_ns) == 2
    assert losses == [Loss("line 3", "'ERR' in column 'wx' is not a number", 1)]


def test_rows_of_one_kind_have_the_header_of_their_kind():
    """Loggers describe all kinds of records first, each in a comment."""
    text = "# GYRO,t_ns,wx [rad/s],wy [rad/s],wz [rad/s]\n# ACC,t_ns,ax,ay,az\n" + "".join(
        f"GYRO,{k},1,2,3\n" for k in range(9)
    )
    t_ns, rate, losses = read(text.encode())
    assert (t_ns.tolist(), rate[0].tolist(), losses) == (list(range(9)), [1, 2, 3], [])


@pytest.mark.parametrize(
    "text",
    [
        9 * "  <x/>\n",
        9 * "t=590 gx=0.1 gy=0.2 gz=0.3\n",
        9 * "1.0D+0 2.0D+0 3.0D+0\n",
        "Red, green, and blue.\n" + 8 * "Nothing but words\n",
    ],
)
def test_a_text_without_rows_of_numbers_is_refused(text):
    """Its words are no names of columns."""
    with pytest.raises(UnsupportedLogError, match="none of its first 9 lines is a row of"):
        read(text.encode())


@pytest.mark.parametrize(
    "cell", ["2023/11/14 22:13:20.5", "11/14/2023 10:13:20 PM", "14.11.2023 22:13:20", "22:13:20.5"]
)
def test_dates_that_may_be_read_in_several_ways_are_refused(cell):
    """The sentence says how to write them, and that rows may be counted."""
    text = "time,wx,wy,wz\n" + 9 * f"{cell},1,2,3\n"
    with pytest.raises(UnsupportedLogError) as caught:
        read(text.encode(), rate_unit="rad/s")
    assert str(caught.value) == (
        "-: 'time' holds dates that are not of ISO 8601; write them as 2023-11-14T22:13:20.5, name "
        "another column with time_col='C', or count rows at a steady rate with sample_rate='HZ'"
    )


# Real recordings

OPTIONS = {
    "csv/xio_fusion_degs.csv": {},
    "csv/xio_gait_duplicates_degs.csv": {},
    "csv/xio3/Inertial.csv": {},
    "csv/px4/sample_sensor_combined_0.csv": {},
    "csv/rostopic_echo.csv": {},
    "csv/euroc_v102/imu0_data.csv": {},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_recorded_tables_are_recognised(shared_logs, name):
    """Real tables give the stamps and the largest rate of an independent reader, unasked."""
    expected = json.loads((shared_logs / "expected.json").read_text())[name]
    t_ns, rate, losses = read(shared_logs / name)
    assert losses == []
    assert len(t_ns) == expected["samples"]
    assert (t_ns[0], t_ns[-1]) == (expected["first_ns"], expected["last_ns"])
    steps = np.diff(t_ns)
    assert (steps.min(), steps.max()) == (expected["min_dt_ns"], expected["max_dt_ns"])
    largest = np.linalg.norm(rate, axis=1).max()
    assert largest == pytest.approx(expected["max_rate_rad_s"], rel=1e-15)


def test_a_recording_with_line_breaks_in_its_cells_is_read(shared_logs):
    """The driver's raw sentences end in a line break; rows are still rows."""
    path = shared_logs / "nested_imu/kiran_car_circle_data_0_imu.csv"
    with pytest.raises(UndeclaredError, match=r"rate_unit=.* and time_unit="):
        read(path)
    t_ns, rate, losses = read(path, **UNITS)
    assert (len(t_ns), losses) == (2530, [])
    assert t_ns[0] == int(Decimal("1763590172.7504675").scaleb(9))
    assert rate[0].tolist() == [0.037773, 0.029186, -0.272747]


def test_an_export_with_two_clocks_is_read_by_the_one_named(shared_logs):
    """Of two clocks the user chooses; the export agrees with the recording to its last digit."""
    path = shared_logs / "nested_imu/kiran_11sec_motion/11sec_motion_0.csv"
    t_ns, _, _ = read(path, time_col="ros_t", **UNITS)
    assert len(t_ns) == 414
    assert abs(t_ns[-1] - 1761940429719152646) < 200


def test_a_recording_with_a_counter_is_read_at_its_declared_rate(shared_logs):
    """Xsens text declares 50 Hz in a comment, but not the unit of its rates."""
    path = shared_logs / "csv/data_xsens.txt"
    with pytest.raises(UndeclaredError, match="the unit of the rates 'Gyr_X', 'Gyr_Y', 'Gyr_Z'"):
        read(path)
    t_ns, rate, losses = read(path, rate_unit="rad/s")
    assert (len(t_ns), t_ns[-1], losses) == (953, 952 * 20_000_000, [])
    assert rate[0].tolist() == [0.059158, -0.030138, 0.050860]


def test_a_file_of_several_record_types_is_refused(shared_logs):
    """Rows of different kinds in one file are not a table."""
    with pytest.raises(UnsupportedLogError, match="its rows have 7, 8, 11 columns, so it holds"):
        CsvLog(Path(shared_logs / "csv/reject_mixed_records.csv"))


@pytest.mark.parametrize(
    ("options", "contradiction"),
    [
        (["--time-unit", "us"], "--time-unit says us, but by header or convention 't_ns' is in ns"),
        (
            ["--rate-unit", "rad/s"],
            "--rate-unit says rad/s, but by header or convention 'wx_dps', 'wy_dps', 'wz_dps' are",
        ),
    ],
)
def test_a_unit_applies_where_the_header_says_otherwise(tmp_path, options, contradiction):
    """The summary says what the header says, whether or not the columns are named too."""
    path, out = tmp_path / "a.csv", tmp_path / "out.csv"
    path.write_text("t_ns,wx_dps,wy_dps,wz_dps\n0,.1,0,0\n10000000,.1,0,0\n")
    named = ["--time-col", "t_ns", "--rate-cols", "1,2,3"]
    results = [
        CliRunner().invoke(cli, ["propagate", str(path), "-o", str(out), *options, *others])
        for others in ([], named)
    ]
    for result in results:
        assert result.exit_code == 0
        assert f"warning: {contradiction}" in result.stderr
        assert f"; read in {options[1]}, as asked for" in result.stderr


def test_a_unit_of_time_of_attitudes_that_the_header_contradicts_is_told(tmp_path):
    """In convert as in propagate."""
    path = tmp_path / "a.csv"
    path.write_text("time_ms,qw,qx,qy,qz\n0,1,0,0,0\n10,1,0,0,0\n")
    arguments = ["convert", str(path), "-", "--time-col", "0", "--time-unit", "s"]
    result = CliRunner().invoke(cli, arguments)
    assert (
        "note: --time-unit says s, but by header or convention 'time_ms' is in ms; read in s"
    ) in result.stderr
