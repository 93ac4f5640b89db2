"""JSON Lines: names, nested objects, exact numbers and times, damage."""

import gzip
import json
import subprocess
import sys

import numpy as np
import pytest
from make.table_rates import rate_batches

from quatprop.errors import NoRatesError, UndeclaredError, UnsupportedLogError
from quatprop.logs.open_log import open_log

ROW = '{"t_ns":%d,"wx":%r,"wy":%r,"wz":%r}\n'


def written(tmp_path, text, name="log.jsonl"):
    """Write a file."""
    path = tmp_path / name
    path.write_text(text)
    return path


def read(path, **options):
    """Return stamps, rates and losses of a file."""
    with open_log(path) as log:
        batches = list(rate_batches(log, **options))
        t_ns = [stamp for batch in batches for stamp in batch.t_ns.tolist()]
        rates = [row for batch in batches for row in batch.rate.tolist()]
        return t_ns, rates, [(loss.place, loss.reason) for loss in log.losses]


def test_stamps_and_numbers_are_exact(tmp_path):
    """Integers beyond 2**53 and every float64 come out as they were written; names are no hint."""
    random = np.random.default_rng(3)
    t_ns = [-(2**63) + 1, 0, 1_700_000_000_123_456_789, 2**63 - 1]
    rates = random.integers(0, 2**63, (4, 3)).view(np.float64)
    rates[0] = [5e-324, -0.0, 1.7976931348623157e308]
    text = "".join(ROW % (t, *row) for t, row in zip(t_ns, rates.tolist(), strict=True))
    found = read(written(tmp_path, text, "log"))
    assert found[0] == t_ns
    assert np.array(found[1]).tobytes() == rates.tobytes()
    assert found[2] == []


@pytest.mark.parametrize(
    ("stamp", "unit", "t_ns"),
    [
        ("1700000000.123456789", "s", 1_700_000_000_123_456_789),
        ("1.7e9", "s", 1_700_000_000_000_000_000),
        ("0.30000000000000004", "s", 300_000_000),
        ('"1700000000123456789"', "ns", 1_700_000_000_123_456_789),
        ("12.5", "us", 12_500),
    ],
)
def test_times_are_decimals(tmp_path, stamp, unit, t_ns):
    """A decimal is taken as written, in quotes or not, and never rounded to a float64."""
    path = written(tmp_path, f'{{"time":{stamp},"wx":1,"wy":2,"wz":3}}\n')
    assert read(path, time_unit=unit, rate_unit="rad/s")[:2] == ([t_ns], [[1, 2, 3]])


def test_dates_know_their_unit(tmp_path):
    """A time of day with its date is a stamp; it needs no unit."""
    path = written(tmp_path, '{"when":"2026-01-01T00:00:00.123456789Z","wx":1,"wy":2,"wz":3}\n')
    t_ns, _, _ = read(path, rate_unit="rad/s")
    assert t_ns == [1767225600_123456789]


def test_nested_objects_are_opened(tmp_path):
    """Messages as they are commonly dumped are found by their fields; the rest is not read."""
    rows = [
        {"header": {"stamp": {"sec": 3, "nanosec": k}, "frame_id": "imu"}, "covariance": [1, 2],
         "angular_velocity": {"x": 1.5, "y": -2, "z": None}}
        for k in range(3)
    ]  # fmt: skip
    path = written(tmp_path, "".join(json.dumps(row) + "\n" for row in rows))
    t_ns, rates, losses = read(path)
    assert t_ns == [3_000_000_000, 3_000_000_001, 3_000_000_002]
    assert rates[0][:2] == [1.5, -2.0]
    assert np.isnan([row[2] for row in rates]).all()
    assert losses == []


def test_a_column_may_come_up_late_or_be_null_at_first(tmp_path):
    """Rows without it have NaN there."""
    text = '{"t_ns":1,"wx":null,"wy":2}\n{"wz":3,"t_ns":2,"wy":2,"wx":1}\n'
    t_ns, rates, _ = read(written(tmp_path, text))
    assert t_ns == [1, 2]
    np.testing.assert_array_equal(rates, [[np.nan, 2, np.nan], [1, 2, 3]])


def test_lines_that_do_not_fit_are_told(tmp_path):
    """They are left out with their line numbers; the rest is as it was, at its own times."""
    lines = [ROW % (k, k, k, k) for k in range(40_000)]
    lines[7] = '{"t_ns":7,"wx":"one","wy":1,"wz":1}\n'
    lines[30_000] = "\n"
    lines[39_999] = lines[39_999][:-9]
    t_ns, rates, losses = read(written(tmp_path, "".join(lines)))
    kept = [k for k in range(39_999) if k not in {7, 30_000}]
    assert t_ns == kept
    assert rates == [[k, k, k] for k in kept]
    assert [place for place, _ in losses] == ["line 8", "line 40000"]
    assert losses[0][1] == "Column(/wx) changed from number to string"


def test_empty_lines_are_no_rows(tmp_path):
    """Not beside damage either."""
    text = ROW % (1, 1, 2, 3) + "\n" + "{\n" + "\n\n" + ROW % (2, 1, 2, 3) + ROW % (3, 1, 2, 3)
    t_ns, _, losses = read(written(tmp_path, text))
    assert t_ns == [1, 2, 3]
    assert [place for place, _ in losses] == ["line 3"]


def test_rows_that_are_counted_keep_their_times_around_damage(tmp_path):
    """A line that is lost leaves its place in a steady rate."""
    lines = [f'{{"wx":{k},"wy":0,"wz":0}}\n' for k in range(6)]
    lines[2] = "{\n"
    found = read(written(tmp_path, "".join(lines)), sample_rate=1.0, rate_unit="rad/s")
    assert found[0] == [0, 10**9, 3 * 10**9, 4 * 10**9, 5 * 10**9]
    assert [row[0] for row in found[1]] == [0, 1, 3, 4, 5]


@pytest.mark.parametrize("block", ["\\u00e9", '\\"'])
def test_text_beside_the_numbers_is_passed_over(tmp_path, block):
    """Escapes in text do not confuse where a row ends, however many blocks there are."""
    rows = [
        f'{{"note":"{block * (k % 3)}{k}","t_ns":{k},"wx":1,"wy":2,"wz":3}}\n'
        for k in range(90_000)
    ]
    t_ns, _, losses = read(written(tmp_path, "".join(rows)))
    assert t_ns == list(range(90_000))
    assert losses == []


def test_packed_lines_are_read(tmp_path):
    """A log that was packed as a whole is unpacked on the way."""
    path = tmp_path / "log.jsonl.gz"
    path.write_bytes(gzip.compress((ROW % (1, 1, 2, 3)).encode()))
    assert read(path)[:2] == ([1], [[1, 2, 3]])


def test_what_is_no_table_is_refused(tmp_path):
    """One object over many lines, numbers in quotes, and nothing but damage are each a sentence."""
    whole = json.dumps([{"t_ns": 1}], indent=1)[1:]
    with pytest.raises(UnsupportedLogError, match="its first lines are no JSON objects; write eac"):
        read(written(tmp_path, "{\n" + whole))
    with pytest.raises(UnsupportedLogError, match="'wx' holds text, not numbers; convert it"):
        read(written(tmp_path, '{"t_ns":1,"wx":"0.5","wy":"1","wz":"2"}\n'))
    lines = ROW % (1, 1, 2, 3) + '{"t_ns":1,"wx":[],"wy":1,"wz":2}\n' * 5000
    with pytest.raises(UnsupportedLogError, match=r"of its first \d+ rows do not fit \(l"):
        read(written(tmp_path, lines))
    with pytest.raises(NoRatesError, match=r"its columns are 't', 'a\.b'; name the columns"):
        read(written(tmp_path, '{"t":1,"a":{"b":2}}\n'))
    with pytest.raises(UndeclaredError, match="the unit of the time 't' is not declared"):
        read(written(tmp_path, '{"t":1,"wx_rad_s":1,"wy_rad_s":2,"wz_rad_s":3}\n'))


@pytest.mark.parametrize("tiny", ["17e-40000000", "1E-2147483647", "1e-40", "1e-100"])
def test_times_smaller_than_anything_do_not_end_the_process(tmp_path, tiny):
    """A row with such a number is lost and told; pyarrow is not asked, for it would not return."""
    text = "".join(ROW % (k, k, k, 5e-324) for k in range(4))
    text += f'{{"t_ns":{tiny},"wx":1,"wy":1,"wz":1}}\n'
    t_ns, _, losses = read(written(tmp_path, text))
    assert t_ns == [0, 1, 2, 3]
    assert losses == [("line 5", "its time is a number below 1e-39")]


@pytest.mark.parametrize(
    "text",
    [
        '{"a":' * 5000,
        '{"t_ns":' + "9" * 5000 + ',"wx":1,"wy":1,"wz":1}\n',
        '{"t_ns":1e999999999,"wx":1,"wy":1,"wz":1}\n',
        '{"t_ns":1,"wx":1e999,"wy":1,"wz":1}\n',
        '{"t_ns":1,"wx":1,"wx":2,"wy":1,"wz":1}\n',
        '{"w":1,"w":{"x":1}}\n{"t_ns":1}\n',
        '{"t_ns":9300000000000000000,"wx":1,"wy":1,"wz":1}\n',
    ],
)
def test_hostile_lines_are_a_sentence(tmp_path, text):
    """Nesting, numbers without end, and names given twice end in a refusal."""
    with pytest.raises((UnsupportedLogError, NoRatesError)):
        read(written(tmp_path, text))


@pytest.mark.parametrize("row", ["null", " null", "5", "[1]", '"text"', "true", "{} null"])
@pytest.mark.parametrize("place", [0, 3, 9])
def test_a_row_that_is_no_object_is_rejected(tmp_path, row, place):
    """It is noted with its line, wherever it is."""
    lines = [ROW % (k, 1, 2, 3) for k in range(9)]
    lines.insert(place, row + "\n")
    t_ns, _, losses = read(written(tmp_path, "".join(lines)))
    assert t_ns == list(range(9))
    assert losses == [(f"line {place + 1}", "it is not a JSON object")]


def test_null_as_the_first_row_does_not_end_the_process(tmp_path):
    """Arrow's parser does not survive it."""
    path = written(tmp_path, "null\n" + ROW % (0, 1, 0, 0) + ROW % (10, 1, 0, 0))
    command = [sys.executable, "-m", "quatprop", "propagate", path, "-o", tmp_path / "out.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3, done.stderr
    assert "line 1: it is not a JSON object" in done.stderr


def test_a_null_inside_of_text_is_no_row(tmp_path):
    """What only looks like a row of its own is read as what it is."""
    text = '{"t_ns":1,"note":"} null","wx":1,"wy":2,"wz":3}\n'
    assert read(written(tmp_path, text)) == ([1], [[1, 2, 3]], [])


@pytest.mark.parametrize("indent", [None, 1])
@pytest.mark.parametrize("count", [1, 5000])
def test_one_object_with_all_rows_is_named_as_such(tmp_path, indent, count):
    """Movesense writes one, and its rows were said to be no JSON objects."""
    row = {"gyro": {"Timestamp": 10, "ArrayGyro": [{"x": 1.5, "y": 2, "z": 3}]}}
    with pytest.raises(UnsupportedLogError) as error:
        read(written(tmp_path, json.dumps({"data": [row] * count}, indent=indent)))
    assert str(error.value).endswith(
        "it is one JSON object with its rows in the list 'data'; write a row a line, such as with "
        "jq -c '.data[]'"
    )
    line = '{"list":[{"a":1}],"t_ns":1,"wx":1,"wy":2,"wz":3}'
    assert read(written(tmp_path, line))[:2] == ([1], [[1, 2, 3]])


def test_a_time_that_no_integer_holds_loses_its_row(tmp_path):
    """As in a table of text; the log was refused as a whole."""
    text = "".join(ROW % (k, k, k, 1) for k in range(40))
    text += f'{{"t_ns":{10**25},"wx":1,"wy":1,"wz":1}}\n'
    t_ns, _, losses = read(written(tmp_path, text))
    assert t_ns == list(range(40))
    assert losses == [("line 41", "its time does not fit in int64 ns")]
