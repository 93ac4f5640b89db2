"""JSON Lines: names, nested objects, exact numbers and times, lines that are no rows."""

import json

import numpy as np
import pytest
from make.commands import refused, run
from make.table_rates import refusal, table_rates

from quatprop.base.errors import LogError, NoRatesError, UndeclaredError, UnsupportedLogError

ROW = '{"t_ns":%d,"wx":%r,"wy":%r,"wz":%r}\n'
RAD = {"rate_unit": "rad/s"}


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a text as a file."""

    def write(text, name="log.jsonl"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_stamps_and_numbers_are_exact(written):
    """Integers beyond 2**53 and every float64 come out as they were written; names are no hint."""
    t_ns = [-(2**63) + 1, 0, 1_700_000_000_123_456_789, 2**63 - 1]
    rates = np.random.default_rng(3).integers(0, 2**63, (4, 3)).view(np.float64)
    rates[0] = [5e-324, -0.0, 1.7976931348623157e308]
    text = "".join(ROW % (t, *row) for t, row in zip(t_ns, rates.tolist(), strict=True))
    found = table_rates(written(text, "log"))
    assert (found.t_ns, found.rate.tobytes(), found.losses) == (t_ns, rates.tobytes(), [])


@pytest.mark.parametrize(
    ("stamp", "unit", "t_ns"),
    [
        ("1700000000.123456789", "s", 1_700_000_000_123_456_789),
        ("1.7e9", "s", 1_700_000_000_000_000_000),
        ("0.30000000000000004", "s", 300_000_000),
        ('"1700000000123456789"', "ns", 1_700_000_000_123_456_789),
        ("12.5", "us", 12_500),
        ('"2026-01-01T00:00:00.123456789Z"', None, 1767225600_123456789),
    ],
)
def test_times_are_decimals_or_dates(written, stamp, unit, t_ns):
    """A decimal is taken as written, in quotes or not, and never rounded; a date has no unit."""
    path = written(f'{{"time":{stamp},"wx":1,"wy":2,"wz":3}}\n')
    found = table_rates(path, time_unit=unit, **RAD)
    assert (found.t_ns, found.rate.tolist()) == ([t_ns], [[1, 2, 3]])


@pytest.mark.parametrize("form", ["columns", "list", "object"])
def test_numbers_written_as_text_are_read(written, form):
    """They were refused; one that is no number is lost alone, and a remark says what they are."""
    rates = np.random.default_rng(4).normal(0, 1, (20, 3))
    rows = []
    for k, rate in enumerate(rates.tolist()):
        texts = [f" {x!r}" if k % 2 else f"{x:+.17e}" for x in rate]
        if k == 7:
            texts[1] = "n/a"
        own = dict(zip("xyz", texts, strict=True))
        columns = {f"gyro_{axis}": text for axis, text in own.items()}
        forms = {"columns": columns, "list": {"gyro": texts}, "object": {"gyro": own}}
        rows.append(json.dumps({"t_ns": str(k), **forms[form]}) + "\n")
    found = table_rates(written("".join(rows)), **RAD)
    assert found.rate.tobytes() == np.delete(rates, 7, axis=0).tobytes()
    assert [loss.place for loss in found.losses] == ["line 8"]
    (remark,) = found.remarks
    assert remark.startswith("the numbers of 'gyro")


def test_nested_objects_are_opened(written):
    """Messages as they are commonly dumped are found by their fields; the rest is not read."""
    rate = {"x": 1.5, "y": -2, "z": None}
    stamps = [{"sec": 3, "nanosec": k} for k in range(3)]
    header = {"frame_id": "imu", "covariance": [1, 2]}
    rows = [{"header": {**header, "stamp": stamp}, "angular_velocity": rate} for stamp in stamps]
    t_ns, rates, losses, _ = table_rates(written("".join(json.dumps(row) + "\n" for row in rows)))
    assert (t_ns, losses) == ([3_000_000_000, 3_000_000_001, 3_000_000_002], [])
    np.testing.assert_array_equal(rates, [[1.5, -2, np.nan]] * 3)


def test_a_column_may_come_up_late_or_be_null_at_first(written):
    """Rows without it have NaN there."""
    path = written('{"t_ns":1,"wx":null,"wy":2}\n{"wz":3,"t_ns":2,"wy":2,"wx":1}\n')
    found = table_rates(path)
    assert found.t_ns == [1, 2]
    np.testing.assert_array_equal(found.rate, [[np.nan, 2, np.nan], [1, 2, 3]])


def test_lines_that_do_not_fit_are_told(written):
    """They are left out with their line numbers; the rest is as it was, at its own times."""
    lines = [ROW % (k, k, k, k) for k in range(40_000)]
    lines[7] = '{"t_ns":7,"wx":"one","wy":1,"wz":1}\n'
    lines[30_000] = "\n"
    lines[39_999] = lines[39_999][:-9]
    t_ns, rates, losses, _ = table_rates(written("".join(lines)))
    kept = [k for k in range(39_999) if k not in {7, 30_000}]
    assert (t_ns, rates.tolist()) == (kept, [[k, k, k] for k in kept])
    assert [loss.place for loss in losses] == ["line 8", "line 40000"]
    assert losses[0].reason == "Column(/wx) changed from number to string"


def test_empty_lines_are_no_rows(written):
    """Not next to damage either."""
    text = ROW % (1, 1, 2, 3) + "\n" + "{\n" + "\n\n" + ROW % (2, 1, 2, 3) + ROW % (3, 1, 2, 3)
    t_ns, _, losses, _ = table_rates(written(text))
    assert (t_ns, [loss.place for loss in losses]) == ([1, 2, 3], ["line 3"])


def test_rows_that_are_counted_keep_their_times_around_damage(written):
    """A line that is lost leaves its place in a steady rate."""
    lines = [f'{{"wx":{k},"wy":0,"wz":0}}\n' for k in range(6)]
    lines[2] = "{\n"
    found = table_rates(written("".join(lines)), sample_rate=1.0, **RAD)
    assert found.t_ns == [0, 10**9, 3 * 10**9, 4 * 10**9, 5 * 10**9]
    assert found.rate[:, 0].tolist() == [0, 1, 3, 4, 5]


NAMED = {
    "gx,gy,gz": lambda xyz: dict(zip(("gx", "gy", "gz"), xyz, strict=True)),
    "gy[0],gy[1],gy[2]": lambda xyz: {"gy": xyz},
    "imu.w\u00fc.x,imu.w\u00fc.y,imu.w\u00fc.z": lambda xyz: {
        "imu": {"w\u00fc": dict(zip("xyz", xyz, strict=True))}
    },
}


@pytest.mark.thorough
@pytest.mark.parametrize("names", NAMED)
@pytest.mark.parametrize("is_escaped", [True, False])
@pytest.mark.parametrize("stamp", ["ts", "other"])
def test_lines_of_other_kinds_are_said_and_not_lost(written, names, is_escaped, stamp):
    """Their rates were not finite; those of a line with the name and no number still are."""
    lines = []
    for k in range(3000):
        xyz = [None] * 3 if k in {7, 8} else [k, 1, 2]
        lines += [{"ts": 2 * k, **NAMED[names](xyz)}, {stamp: 2 * k + 1, "imu": {"acc": [1, 2, k]}}]
    text = "".join(json.dumps(line, ensure_ascii=is_escaped) + "\n" for line in lines)
    named = {"rate_cols": tuple(names.split(",")), "time_col": "ts", "time_unit": "ns"}
    t_ns, rate, losses, remarks = table_rates(written(text), **named, **RAD)
    assert (t_ns, losses) == ([*range(0, 6000, 2)], [])
    assert np.flatnonzero(np.isnan(rate[:, 0])).tolist() == [7, 8]
    columns = ", ".join(f"'{name}'" for name in names.split(","))
    assert remarks == [f"3000 rows of other kinds, without {columns}, were not read"]


@pytest.mark.parametrize("escaped", [r"\/", r"\u002f", r"\u002F"])
def test_names_are_the_same_however_they_are_escaped(written, escaped):
    """Pandas escapes slashes: next to one null, all rows were taken for those of another kind."""
    names = [f"gyro_{axis} (rad/s)" for axis in "xyz"]
    lines = [json.dumps({"t_ns": k, **dict.fromkeys(names, 0.1 if k else None)}) for k in range(9)]
    text = "".join(line.replace("/", escaped) + "\n" for line in lines)
    t_ns, rate, losses, remarks = table_rates(written(text))
    assert (t_ns, losses, remarks) == ([*range(9)], [], [])
    assert np.isnan(rate[:, 0]).tolist() == [True] + [False] * 8


def test_a_line_that_is_no_object_takes_no_time(written):
    """Rows after a separator were late by an interval."""
    lines = [f'{{"wx":{k},"wy":0,"wz":0}}\n' for k in range(6)]
    lines[2:2] = ["-----\n"] * 2
    found = table_rates(written("".join(lines)), sample_rate=1.0, **RAD)
    assert found.t_ns == [k * 10**9 for k in range(6)]
    assert [loss.messages for loss in found.losses] == [1, 1]


@pytest.mark.parametrize("block", ["\\u00e9", '\\"', "} null"])
def test_text_next_to_the_numbers_is_passed_over(written, block):
    """Escapes and what looks like a row do not confuse where a row ends, in many blocks."""
    pad = 500 * "x"
    row = '{"note":"%s%s","t_ns":%d,"wx":1,"wy":2,"wz":3}\n'
    text = "".join(row % (block * (k % 3), pad, k) for k in range(9_000))
    t_ns, _, losses, _ = table_rates(written(text))
    assert (t_ns, losses) == ([*range(9_000)], [])


@pytest.mark.parametrize(
    ("text", "error", "sentence"),
    [
        (
            '{\n\n {\n  "t_ns": 1\n }\n]',
            UnsupportedLogError,
            "its first lines are not JSON objects;",
        ),
        (
            '{"t_ns":1,"wx":"half","wy":"1","wz":"2"}\n',
            UnsupportedLogError,
            "column 'wx' holds text, not numbers; convert it",
        ),
        (
            ROW % (1, 1, 2, 3) + '{"t_ns":1,"wx":[],"wy":1,"wz":2}\n' * 3000,
            UnsupportedLogError,
            "1001 of its first 1002 rows do not fit (l",
        ),
        ('{"t":1,"a":{"b":2}}\n', NoRatesError, "no body rates found; its columns are 't', 'a.b';"),
        (
            '{"t":1,"wx_rad_s":1,"wy_rad_s":2,"wz_rad_s":3}\n',
            UndeclaredError,
            "the unit of the time 't' is not declared",
        ),
        # Nesting, numbers without end, and names given twice.
        ('{"a":' * 5000, LogError, ""),
        ('{"t_ns":' + "9" * 5000 + ',"wx":1,"wy":1,"wz":1}\n', LogError, ""),
        ('{"t_ns":1e999999999,"wx":1,"wy":1,"wz":1}\n', LogError, ""),
        ('{"t_ns":1,"wx":1e999,"wy":1,"wz":1}\n', LogError, ""),
        ('{"t_ns":1,"wx":1,"wx":2,"wy":1,"wz":1}\n', LogError, ""),
        ('{"w":1,"w":{"x":1}}\n{"t_ns":1}\n', LogError, ""),
        ('{"t_ns":9300000000000000000,"wx":1,"wy":1,"wz":1}\n', LogError, ""),
    ],
)
def test_what_is_no_table_is_refused(written, text, error, sentence):
    """Each is a sentence, however hostile the text is."""
    assert refusal(written(text), error).startswith(sentence)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        # Arrow's parser does not survive a null, nor return from a number so small.
        *((row, "it is not a JSON object") for row in ("null", " null", "5", "[1]", '"text"')),
        *((row, "it is not a JSON object") for row in ("true", "{} null")),
        *(
            (f'{{"t_ns":{tiny},"wx":1,"wy":1,"wz":1}}', "its time is a number below 1e-39")
            for tiny in ("17e-40000000", "1E-2147483647", "1e-40", "1e-100")
        ),
        # The log was refused as a whole.
        (f'{{"t_ns":{10**25},"wx":1,"wy":1,"wz":1}}', "its time does not fit in int64 ns"),
    ],
)
@pytest.mark.parametrize("place", [0, 3, 9])
def test_a_row_that_cannot_be_one_is_lost_alone(written, row, reason, place):
    """It is noted with its line, wherever it is, and does not end the process."""
    lines = [ROW % (k, 1, 2, 5e-324) for k in range(9)]
    lines.insert(place, row + "\n")
    t_ns, rate, losses, _ = table_rates(written("".join(lines)))
    assert (t_ns, rate[:, 2].tolist()) == ([*range(9)], [5e-324] * 9)
    assert [(loss.place, loss.reason) for loss in losses] == [(f"line {place + 1}", reason)]


@pytest.mark.parametrize("indent", [None, 1])
@pytest.mark.parametrize("count", [1, 5000])
def test_one_object_with_all_rows_is_named_as_such(written, indent, count):
    """Movesense writes one, and its rows were said to be no JSON objects."""
    row = {"gyro": {"Timestamp": 10, "ArrayGyro": [{"x": 1.5, "y": 2, "z": 3}]}}
    assert refusal(written(json.dumps({"data": [row] * count}, indent=indent))) == (
        "it is one JSON object with its rows in the list 'data'; write one row per line, for "
        "example with "
        "jq -c '.data[]'"
    )
    line = '{"list":[{"a":1}],"t_ns":1,"wx":1,"wy":2,"wz":3,"t":[1,2]}'
    assert table_rates(written(line)).rate.tolist() == [[1, 2, 3]]
    sentence = refusal(written(line), time_col="t[0]", time_unit="s")
    assert sentence == "a time in a list is not read; name another column"


@pytest.mark.thorough
@pytest.mark.parametrize("size", [2, 10, 200])
@pytest.mark.parametrize("row", [[1.0, 2.0, 3.0], {"x": 1.0, "y": 2.0, "z": 3.0}])
@pytest.mark.parametrize("name", ["gyro_dps", "samples"])
def test_columns_of_several_samples_a_row_are_named(tmp_path, size, row, name):
    """Their columns were asked for, which do not exist; one sample a row is read."""
    path = tmp_path / "log.jsonl"
    lines = [json.dumps({"t_ms": 100 * k, "imu": {name: [row] * size}}) for k in range(9)]
    path.write_text("\n".join(lines) + "\n")
    said = refused("propagate", path, "-o", "-")
    assert f"'imu.{name}' holds several samples a row, which is not read: write one sample" in said
    cells = row if isinstance(row, list) else [*row.values()]
    lines = [json.dumps({"t_ms": 10 * k, "gyro_dps": cells}) for k in range(9 * size)]
    path.write_text("\n".join(lines) + "\n")
    run("propagate", path, "-o", tmp_path / "o.csv", code=0)
