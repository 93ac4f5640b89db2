"""Lines of a text table that are no rows: headers, comments, separators, rows of other kinds."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make.commands import refused, run
from make.table_rates import refusal, table_rates

from quatprop.base.errors import LogError, QuatpropError, UnsupportedLogError, UsageError
from quatprop.kinematics.quaternion import exp

MARKS = ("", "#", "# ", "%", "//")
DELIMITERS = (",", ";", "\t")
UNIT = " [rad/s]"
NAMES = [["t_ns", "wx", "wy", "wz"], ["timestamp [ns]", *(f"g{c}{UNIT}" for c in "xyz")]]
RAD = {"rate_unit": "rad/s"}
NUMBERED = {**RAD, "rate_cols": ("1", "2", "3"), "time_col": "0", "time_unit": "ns"}


def rates_of(count):
    """Return distinct rates, shape ``(count, 3)``."""
    return np.arange(3 * count).reshape(-1, 3) / 8 - 1


def rows_of(rate, delimiter=",", first=0):
    """Return rows of stamps 10 ms apart and rates, as texts."""
    cells = ([10**7 * (first + k), *row] for k, row in enumerate(rate.tolist()))
    return [delimiter.join(map(str, row)) for row in cells]


# A second header


OTHERS = {
    "unit": lambda names: [name.replace("rad", "deg") for name in names],
    "other names": lambda names: [names[0], "ax", "ay", "az"],
    "a name more": lambda names: [*names, "temperature"],
    "a name less": lambda names: names[:-1],
    **{
        f"order {order}": lambda names, order=order: [names[0], *(names[k] for k in order)]
        for order in itertools.permutations((1, 2, 3))
    },
}


@settings(max_examples=150)
@given(
    st.tuples(*(st.sampled_from(each) for each in (MARKS, MARKS, DELIMITERS, sorted(OTHERS)))),
    *(st.integers(1, 30), st.integers(1, 30)),
)
def test_no_row_below_another_header_is_read_under_the_first(form, m, n):
    """One that began with a comment mark was a comment, and the rows had other units and axes."""
    mark, second, between, other = form
    names, rate = NAMES[1], rates_of(m + n)
    header = OTHERS[other](names)
    lines = [mark + between.join(names), *rows_of(rate[:m], between)]
    lines += [second + between.join(header), *rows_of(rate[m:], between, m)]
    text = "\n".join(lines) + "\n"
    if header == names:
        assert table_rates(text).rate.tolist() == rate.tolist()
        return
    place = f"another table begins at line {m + 2}; split it there into two"
    assert refusal(text, QuatpropError) == place


@pytest.mark.parametrize("above", [[], ["# device 7"], ["Device,7", "Rate,high,low,x,5"]])
def test_joined_files_repeat_all_lines_above_their_rows(above):
    """Only the header was recognised, and the lines above it were lost rows."""
    head = [*above, "# t_ns,wx,wy,wz", *rows_of(rates_of(9))]
    t_ns, rate, losses, _ = table_rates("\n".join([*head, *head, ""]), **RAD)
    assert (len(t_ns), rate.tolist(), losses) == (18, 2 * rates_of(9).tolist(), [])


# Comments, and what looks like them


@pytest.mark.parametrize("mark", MARKS)
@pytest.mark.parametrize("error", ["#N/A", "#VALUE!", "########", "#DIV/0!", "#NAME?", "#WERT!"])
def test_no_row_with_an_error_of_excel_vanishes(error, mark):
    """A quarter of the rows were comments: read, refused or counted, whatever the column is."""
    for column in range(5):
        rows = [f"{row},20.5".split(",") for row in rows_of(rates_of(20))]
        for row in rows[7:12]:
            row[column] = error
        text = "\n".join([f"{mark}t_ns,wx,wy,wz,temp", *map(",".join, rows), ""])
        t_ns, rate, losses, _ = table_rates(text, **RAD)
        assert len(t_ns) + sum(loss.messages for loss in losses) == 20, column
        is_rate = column in {1, 2, 3}
        assert len(losses) == 5 * (column == 0 or (is_rate and error != "#N/A")), column
        assert np.isnan(rate).any(axis=1).sum() == 5 * (is_rate and error == "#N/A"), column


@pytest.mark.parametrize("mark", ["#", "%", "//"])
@pytest.mark.parametrize("above", [*MARKS, "device: "])
def test_a_comment_between_rows_has_the_mark_of_one_above(mark, above):
    """Another line that is no row is counted."""
    rows = rows_of(rates_of(9))
    rows.insert(4, f"{mark} paused, 1, 2, 3")
    losses = table_rates("\n".join([f"{above}7", "t_ns,wx,wy,wz", *rows, ""]), **RAD).losses
    assert [loss.place for loss in losses] == ["line 7"] * (above.strip() != mark)


# Separators


@pytest.mark.parametrize("line", ["9999", "0", "-----", "=== 2 ===", "END", "*,*,*"])
@pytest.mark.parametrize("every", [1, 7, 30])
def test_a_separator_takes_no_time_at_a_sample_rate(line, every):
    """Each was a lost row, and what followed was later by its interval."""
    rows = [row.partition(",")[2] for row in rows_of(rates_of(40))]
    text = "".join(f"{row}\n" + f"{line}\n" * (k % every == 0) for k, row in enumerate(rows))
    if every == 1 and line in {"9999", "0"}:
        return  # refused: times on lines of their own
    t_ns, rate, losses, _ = table_rates(f"wx,wy,wz\n{text}", sample_rate=100, **RAD)
    assert (t_ns, rate.tolist()) == ([10**7 * k for k in range(40)], rates_of(40).tolist())
    assert sum(loss.messages for loss in losses) == len(range(0, 40, every))


# Numbers above the header


STATED = {
    "LabVIEW": ["Channels\t3", "Samples\t20\t20\t20", "X0\t0.0\t0.0\t0.0", "Delta_X\t1\t1\t1"],
    "LabVIEW with units": ["Samples\t20\t20\t20", "Unit\trad/s\trad/s\trad/s", "X0\t0\t0\t0"],
    "a matrix": ["1\t0\t0", "0\t1\t0", "0\t0\t1"],
}


@pytest.mark.parametrize("stated", STATED)
@pytest.mark.parametrize("mark", MARKS)
def test_numbers_above_the_header_are_no_samples(stated, mark):
    """Those in the header of LabVIEW were integrated."""
    text = "\n".join([*STATED[stated], f"{mark}t_ns\twx\twy\twz", *rows_of(rates_of(20), "\t"), ""])
    t_ns, rate, losses, _ = table_rates(text, **RAD)
    assert (len(t_ns), rate.tolist(), losses) == (20, rates_of(20).tolist(), [])


def motive(bodies):
    """Return a table of OptiTrack's Motive, and the quaternions in it, scalar last."""
    wxyz = exp(rates_of(30))
    kinds = [*["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error"]
    heads = [
        "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Units,Meters",
        "",
        ",Type" + ",Rigid Body" * 8 * len(bodies),
        ",Name," + ",".join(name for name in bodies for _ in kinds),
        ",ID" + ',"1"' * 8 * len(bodies),
        ",," + ",".join(kinds * len(bodies)),
        "Frame,Time (Seconds)" + ",X,Y,Z,W,X,Y,Z," * len(bodies),
    ]
    rows = []
    for k, (w, *xyz) in enumerate(wxyz.tolist()):
        body = ",".join(map(str, [*xyz, w, 0.1, 0.2, 0.3, 0.0001]))
        rows.append(f"{k},{k / 100},{','.join([body] * len(bodies))}")
    return "\n".join([*heads, *rows, ""])


@pytest.mark.parametrize(("bodies", "way"), [(["imu"], ()), (["imu", "cam"], ("imu", "cam"))])
def test_an_export_of_motive_is_one_table(tmp_path, bodies, way):
    """Its header is of several lines, of which some hold numbers: several kinds of records."""
    path = tmp_path / "take.csv"
    path.write_text(motive(bodies))
    if len(bodies) > 1:
        assert "'imu.Rotation.W', 'cam.Rotation.W'" in refused("convert", path, "-")
    for body in way or [""]:
        names = ",".join(f"{body}.Rotation.{c}".lstrip(".") for c in "XYZW")
        output = run("convert", path, "-", "--quat-cols", names, "--time-col", "1").stdout
        found = np.loadtxt(output.splitlines(), delimiter=",", skiprows=1)
        wxyz = exp(rates_of(30))
        assert np.abs(np.abs((found[:, 1:5] * wxyz).sum(1)) - 1).max() < 1e-15


@pytest.mark.parametrize("names", ["gx,gy,gz,note", "gx,gy,gz,ax,ay,az", "gx,gy"])
def test_a_header_that_does_not_fit_its_rows_is_said(names):
    """Its names were unknown columns, and without options the log had no rates."""
    text = "\n".join([f"t_ns,{names}", *rows_of(rates_of(9)), ""])
    why = f"its header has {2 + names.count(',')} names and its rows have 4 cells"
    named = {**RAD, "rate_cols": ("gx", "gy", "gz")}
    assert why in refusal(text, UsageError, **named)
    assert refusal(text, UnsupportedLogError).startswith(why)
    assert table_rates(text, **NUMBERED).rate.tolist() == rates_of(9).tolist()


# The ends of rows


@pytest.mark.parametrize(
    ("delimiter", "end"),
    [pair for pair in itertools.product(", ;\t|", ";,|") if pair[0] != pair[1]],
)
@pytest.mark.parametrize("named", ["", "header", "header with it"])
@pytest.mark.parametrize("line_end", ["\n", " \r\n"])
def test_rows_may_end_in_a_mark(delimiter, end, named, line_end):
    """The last cell was no number, and all rows were lost."""
    rate = rates_of(20)
    lines = [row + end for row in rows_of(rate, delimiter)]
    if named:
        lines.insert(0, delimiter.join(NAMES[0]) + end * (named == "header with it"))
    text = line_end.join(lines)
    for whole in (text, text + line_end):
        t_ns, found, losses, remarks = table_rates(whole, **NUMBERED)
        assert (len(t_ns), found.tolist(), losses, remarks) == (20, rate.tolist(), [], [])
    cut = table_rates(text[:-2], **NUMBERED)
    assert (len(cut.t_ns), [loss.messages for loss in cut.losses]) == (19, [1])


# Rows of other kinds


def interleaved(topics, *, is_shared, lost=(), blank=""):
    """Return a table of 40 rates between the rows of other topics, and the number of these."""
    heads = ["t_ns", *([] if is_shared else ["imu.t_ns"]), *NAMES[0][1:], "ax", *topics]
    lines, count = [",".join(heads)], 0
    for k, row in enumerate(rates_of(40).tolist()):
        cells = [10**7 * k, *([] if is_shared else [10**7 * k + 5]), *row, 9.8]
        if k in lost:
            cells[-4:-1] = [blank] * 3
        lines.append(",".join(map(str, [*cells, *[blank] * len(topics)])))
        for place, every in enumerate(topics.values()):
            if k % every == 0:
                values = [blank] * len(topics)
                values[place] = "7"
                lines.append(",".join([str(10**7 * k + 9), *[blank] * (len(cells) - 1), *values]))
                count += 1
    return "\n".join([*lines, ""]), count


@pytest.mark.parametrize("is_shared", [True, False])
@pytest.mark.parametrize("blank", ["", "nan"])
@pytest.mark.parametrize("topics", [{"odom": 1}, {"odom": 5}, {"odom": 2, "gps": 20}])
def test_rows_of_other_topics_are_said_and_not_lost(topics, blank, is_shared):
    """PlotJuggler and Tobii write all topics into one table: their rows were damage."""
    text, count = interleaved(topics, is_shared=is_shared, blank=blank)
    named = {
        **RAD,
        "time_col": "t_ns" if is_shared else "imu.t_ns",
        "rate_cols": tuple(NAMES[0][1:]),
    }
    t_ns, rate, losses, remarks = table_rates(text, **named)
    assert t_ns == [10**7 * k + 5 * (not is_shared) for k in range(40)]
    assert (rate.tolist(), losses) == (rates_of(40).tolist(), [])
    rows, were = ("rows of other kinds", "were") if count > 1 else ("row of another kind", "was")
    assert remarks == [f"{count} {rows}, without 'wx', 'wy', 'wz', {were} not read"]


def test_a_row_that_lacks_its_own_rates_is_no_row_of_another_topic():
    """A sensor that failed leaves the other columns of its own topic."""
    text, _ = interleaved({"odom": 5}, is_shared=True, lost=(7, 8))
    _, rate, losses, _ = table_rates(text, **RAD, time_col="t_ns", rate_cols=tuple(NAMES[0][1:]))
    assert np.flatnonzero(np.isnan(rate).all(axis=1)).tolist() == [7, 8]
    assert (len(rate), losses) == (40, [])


@pytest.mark.parametrize("last", ["Comment", "Temp"])
def test_x_of_labview_is_seconds_where_the_last_column_is_its_comment(last):
    """Files with the names alone; of other programs the time is asked for."""
    rows = "".join(f"{k / 100},1,2,3\n" for k in range(60))
    text = f"X_Value,gyro_x,gyro_y,gyro_z,{last}\n{rows}"
    if last == "Comment":
        found = table_rates(text, rate_unit="rad/s")
        assert found.t_ns == [10_000_000 * k for k in range(60)]
    else:
        with pytest.raises(LogError):
            table_rates(text, rate_unit="rad/s")


@pytest.mark.parametrize("words", [(), ("--rate-cols", "2,4,6", "--rate-unit", "deg/s")])
def test_decimal_commas_between_commas_are_refused(tmp_path, words):
    """Columns counted as told have no decimals; a narrow header of other numbers is no sign."""
    path = tmp_path / "log.csv"
    rows = "".join(f"0,{k:02}0,1,0919,-2,0414,0,{k:04}\n" for k in range(50))
    path.write_text("Time (s),Gyro X (deg/s),Gyro Y (deg/s),Gyro Z (deg/s)\n" + rows)
    said = refused("propagate", path, *words, "-o", "-")
    assert "its header has 4 names and its rows have 8 cells, each second of them the dec" in said
    assert "as in 0,000: commas separate the numbers, too; export it with another separator" in said
    path.write_text(path.read_text().replace(",0", ",1"))
    assert "each second" not in refused("propagate", path, "-o", "-")


def test_a_comment_between_rows_is_shown_where_it_is_lost(tmp_path):
    """It may say that the unit of the rates behind it is another."""
    rows = [f"{k / 100},1.{k:02},2.5,3.5" for k in range(50)]
    rows[20:20] = ["# firmware 2.1,gyro now in rad/s"]
    path = tmp_path / "log.csv"
    path.write_text("time_s,gx (deg/s),gy (deg/s),gz (deg/s)\n" + "\n".join(rows) + "\n")
    said = run("propagate", path, "-o", tmp_path / "o.csv", code=3).stderr
    assert "it has 2 columns instead of 4: '# firmware 2.1,gyro now in rad/s'\n" in said
