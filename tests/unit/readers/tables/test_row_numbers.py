"""Numbers of rows beside rates at a sample rate: where they miss, rows are missing in time."""

import re
from itertools import cycle, product

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from make.commands import run
from make.table_rates import refusal, told
from make.tables import write_frame

from quatprop import propagate
from quatprop.base.errors import UndeclaredError
from quatprop.readers.tables.row_numbers import NumberedRows
from quatprop.readers.tables.turns import RowWatch

AXES = [f"w{axis}_rad_s" for axis in "xyz"]
ROWS = 4000
HZ = {"sample_rate": 100}


def numbered(path, name, numbers):
    """Write rates beside a column of numbers, and return the file."""
    frame = pd.DataFrame({name: numbers})
    frame[AXES] = np.random.default_rng(1).normal(size=(len(frame), 3))
    return write_frame(path, frame, 1500)


def without(*rows):
    """Return the numbers of rows of which some are missing."""
    return np.delete(np.arange(ROWS), rows)


def gaps(name, what, option=None):
    """Return the remark on a column."""
    return (
        f"'{name}' {what}, but rows are counted, as if all were there; to count by it, give "
        f"time_col='{option or name}' and sample_rate='100'"
    )


NAMES = ["frame", "index", "Unnamed: 0", "my_id", "line", "packet_id"]
PLACES = [
    *(("csv", name, 1001) for name in NAMES),
    *(
        (suffix, name, first)
        for name, (suffix, first) in zip(
            cycle(NAMES), product(["csv", "jsonl", "parquet", "npy"], [20, 1001, 3990])
        )
        if (suffix, first) != ("csv", 1001)
    ),
]
"""Every name in one kind of file, and every place in every kind."""


@pytest.mark.thorough
@pytest.mark.parametrize(("suffix", "name", "first"), PLACES)
def test_missing_numbers_are_said_wherever_they_are(tmp_path, suffix, name, first):
    """Behind the first 1,000 rows they were not looked at, and 7 s became 0 s."""
    path = numbered(tmp_path / f"log.{suffix}", name, without(*range(first, first + 7)))
    if name == "packet_id":  # a name of counters, which are used
        t_ns, remarks = told(path, **HZ)
        assert t_ns[-1] == (ROWS - 1) * 10**7
        assert remarks[-1] == "7 samples lost by the counter 'packet_id'"
        return
    option = "0" if name == "Unnamed: 0" else name
    remark = gaps(name, f"passes over 7 numbers before row {first + 1}", option)
    assert told(path, **HZ) == ([k * 10**7 for k in range(ROWS - 7)], [remark])
    t_ns, (remark,) = told(path, time_col=option, **HZ)
    assert t_ns[-1] == (ROWS - 1) * 10**7
    is_index = name != "my_id"
    assert (remark == f"7 samples lost by the counter '{name}'") == is_index
    assert remark.startswith("the numbers in 'my_id' are read as ticks") != is_index
    said = gaps(name, f"passes over 7 numbers before row {first + 1}", option)
    said = said.replace("as if all were there", "as requested")
    assert told(path, time_col="none", **HZ) == ([k * 10**7 for k in range(ROWS - 7)], [said])


@pytest.mark.parametrize(
    ("suffix", "name"),
    [
        ("csv", "frame"),
        ("csv", "Unnamed: 0"),
        ("jsonl", "Unnamed: 0"),
        ("parquet", "frame"),
        ("npy", "frame"),
    ],
)
def test_numbers_without_gaps_are_not_remarked_on(tmp_path, suffix, name):
    """Nor those of every tenth row, or that wrap around."""
    for numbers in (range(ROWS), range(7, 10 * ROWS, 10), np.arange(ROWS) % 256,
                    (np.arange(ROWS) + 65_000) % 65_536, np.arange(ROWS) % 100):  # fmt: skip
        path = numbered(tmp_path / f"log.{suffix}", name, numbers)
        assert told(path, **HZ)[1] == []
        assert told(path, time_col="none", **HZ)[1] == []


def test_the_first_column_of_pandas_has_no_name(tmp_path):
    """As `to_csv` writes it."""
    frame = pd.DataFrame(np.zeros((ROWS, 3)), columns=AXES).drop(index=[2000, 3000, 3001])
    frame.to_csv(tmp_path / "log.csv")
    remark = gaps("", "passes over 3 numbers in 2 places, first before row 2001", "0")
    assert told(tmp_path / "log.csv", **HZ)[1] == [remark]
    assert told(tmp_path / "log.csv", time_col="0", **HZ)[0][-1] == (ROWS - 1) * 10**7


BROKEN = {
    "repeats 2 numbers, first in row 1502": np.insert(np.arange(ROWS), [1501, 3000], [1500, 2999]),
    "steps back once, in row 2501": np.r_[:2500, :1500],
    "passes over 3 numbers before row 1501, and steps back once, in row 2498": np.r_[
        :1500, 1503:2500, 100:1200
    ],
}


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("what", BROKEN)
def test_numbers_that_repeat_or_step_back_are_said(tmp_path, what):
    """Rows were written twice, or another log begins there."""
    path = numbered(tmp_path / "log.csv", "frame", BROKEN[what])
    ((remark,),) = (told(path, **HZ)[1],)
    assert remark.startswith(f"'frame' {what}, but rows are counted")
    for name in ("frame", "my_id", "PacketCounter"):
        numbered(path, name, BROKEN[what])
        (remark,) = told(path, time_col="none", **HZ)[1]
        assert remark.startswith(f"'{name}' {what}, but rows are counted, as requested;")
    path = numbered(path, "frame", BROKEN[what])
    if "back" not in what:
        found = propagate(path, time_col="frame", sample_rate=100)
        assert found.t_ns[-1] == (ROWS - 1) * 10**7
        return
    assert remark.endswith(
        "; if another recording begins where it steps back, write that to its own log"
    )
    begin = int(np.flatnonzero(np.diff(BROKEN[what]) < 0)[0]) + 1
    for part in (BROKEN[what][:begin], BROKEN[what][begin:]):
        assert "steps back" not in "".join(told(numbered(path, "frame", part), **HZ)[1])


@pytest.mark.parametrize("at", [500, 2000])
def test_one_damaged_or_swapped_number_is_no_gap(tmp_path, at):
    """The numbers go on as before."""
    for numbers in ([7], [90_000], [at + 1, at], [at + 2, at, at + 1]):
        every = np.arange(ROWS)
        every[at : at + len(numbers)] = numbers
        assert told(numbered(tmp_path / "log.csv", "frame", every), **HZ)[1] == []
        assert told(tmp_path / "log.csv", time_col="none", **HZ)[1] == []


def test_rows_that_are_lost_to_damage_are_no_gap_in_their_numbers(tmp_path):
    """They took their time, and are counted as lost already."""
    path = numbered(tmp_path / "log.csv", "frame", range(ROWS))
    lines = path.read_text().splitlines()
    lines[2000] = lines[2000].replace(".", "x")
    lines[3000:3003] = [f"{k},?,1,2" for k in range(2999, 3002)]
    lines[3500] = "x" + lines[3500].lstrip("0123456789")
    path.write_text("\n".join([*lines, ""]))
    result = run("propagate", path, "-o", "-", "--sample-rate", "100", code=3)
    assert "passes over" not in result.stderr
    path.write_text("\n".join([*lines[:3700], *lines[3705:], ""]))
    result = run("propagate", path, "-o", "-", "--sample-rate", "100", code=3)
    assert "passes over 5 numbers before row 3700" in " ".join(result.stderr.split())


def test_a_counter_of_larger_steps_that_misses_some_late_is_refused(tmp_path):
    """As in the first rows: only the user knows what it counts."""
    path = numbered(tmp_path / "log.csv", "Counter", 5 * without(2000, 2001))
    assert refusal(path, UndeclaredError, **HZ) == (
        "whether the counter 'Counter', which usually steps by 5, but passes over 2 numbers before "
        "row 2001, counts samples is not declared; specify it with time_col='Counter' and "
        "sample_rate='100' if it does, or time_col='none' and sample_rate='100' to count rows"
    )
    assert told(path, time_col="none", **HZ)[0][-1] == (ROWS - 3) * 10**7
    assert len(told(path, time_col="Counter", **HZ)[0]) == ROWS - 2


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
@pytest.mark.parametrize("rows", [2, 10, 20])
@pytest.mark.parametrize("lost", [3, 150])
def test_a_packet_that_is_missing_is_said(tmp_path, rows, lost):
    """Each has several rows with its number."""
    packets = np.delete(np.arange(ROWS // rows), [lost, lost + 1])
    path = numbered(tmp_path / "log.csv", "packet", np.repeat(packets, rows))
    remark = f"'packet', which is the same in {rows} rows, passes over 2 numbers before row "
    ((said,),) = (told(path, **HZ)[1],)
    assert said.startswith(f"{remark}{lost * rows + 1}, but rows are counted")
    way = f"time_col='packet' and sample_rate='{100 / rows:g}' and regular_time"
    assert said.endswith(f"to count by it, give {way}")
    by_packet = propagate(path, time_col="packet", sample_rate=100 / rows, regular_time=True)
    assert by_packet.t_ns[-1] - by_packet.t_ns[0] == pytest.approx((ROWS - 1) * 1e7, rel=0.01)
    whole = np.arange(ROWS) // rows
    assert told(numbered(path, "packet", whole), **HZ)[1] == []
    assert told(numbered(path, "packet", whole % 64), **HZ)[1] == []


def test_numbers_of_a_series_are_those_of_its_rows(tmp_path):
    """The rows of the other one are not missing."""
    path = numbered(tmp_path / "log.csv", "frame", without(2000, 2001, 2002, 2003))
    frame = pd.read_csv(path)
    frame["sensor"] = np.where(frame["frame"] % 2, "left", "right")
    frame.to_csv(path, index=False)
    said = told(path, series="left", **HZ)[1]
    wanted = gaps("frame", "passes over 2 numbers before row 1001")
    # Every second frame is one of these rows.
    assert said[-1] == wanted.replace("'100'", "'200'")
    by_frame, by_row = (
        told(path, series="left", **given)[0]
        for given in ({"time_col": "frame", "sample_rate": 200}, HZ)
    )
    assert (by_frame[999] - by_frame[0], by_frame[-1] - by_frame[0]) == (
        by_row[999] - by_row[0],
        by_row[-1] - by_row[0] + 2 * 10**7,
    )


def test_info_says_it_too(tmp_path):
    """It reads the whole log."""
    path = numbered(tmp_path / "log.csv", "frame", without(2000))
    found = " ".join(run("info", path, "--sample-rate", "100").stdout.split())
    assert "passes over 1 number before row 2001" in found


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("seed", range(20))
def test_what_is_found_does_not_depend_on_where_batches_end(seed):
    """Missed, repeated and backward numbers, at any border, and row by row."""
    rng = np.random.default_rng(seed)
    steps = rng.choice(
        [1, 1, 1, 0, 2, 5, -30], ROWS, p=[0.9, 0.05, 0.03, 0.005, 0.005, 0.005, 0.005]
    )
    steps[:1000] = 1
    numbers = np.cumsum(steps)
    found = []
    for cuts in ([], rng.integers(0, ROWS, 9), range(1, ROWS)):
        watch = NumberedRows(0, found.append).watch(RowWatch(()))
        for part in np.split(np.arange(ROWS), np.sort([*cuts, 0]).astype(int)):
            texts = [f" {number}" for number in numbers[part]]
            watch.see_values(pa.array(texts, pa.string()), part)
        watch.finish()
    assert found[0] == found[1] == found[2]


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("seed", range(5))
def test_rows_that_were_written_twice_are_said(tmp_path, seed):
    """A share of them at random; numbers of a slower sensor are repeated at a beat."""
    rng = np.random.default_rng(seed)
    numbers = np.repeat(np.arange(ROWS), 1 + (rng.random(ROWS) < 0.2))
    first = int(np.flatnonzero(np.diff(numbers) == 0)[0]) + 2
    path = numbered(tmp_path / "log.csv", "row", numbers)
    repeated = len(numbers) - ROWS
    assert told(path, **HZ)[1] == [gaps("row", f"repeats {repeated} numbers, first in row {first}")]
    assert told(path, time_col="row", **HZ)[0][-1] == (ROWS - 1) * 10**7
    slower = (np.arange(ROWS) * rng.uniform(0.7, 0.95)).astype(int)
    assert told(numbered(path, "row", slower), **HZ)[1] == []


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_a_block_of_rows_that_is_missing_is_said(tmp_path):
    """In a column of any name, beside rates at a sample rate."""
    blocks = np.repeat(np.delete(np.arange(80), [40, 41, 42]), 50)
    ((remark,),) = (told(numbered(tmp_path / "log.csv", "block", blocks), **HZ)[1],)
    assert remark.startswith("'block', which is the same in 50 rows, passes over 3 numbers before")


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("steps", "shares"), [((1, 2), (0.8, 0.2)), ((0, 1, 2), (0.1, 0.8, 0.1)), ((1, -3), (0.9, 0.1))]
)
@pytest.mark.parametrize("rows", [ROWS, 20 * ROWS])
@pytest.mark.parametrize("regular", [0, 1500])
def test_an_irregular_counter_is_said_to_be_one(tmp_path, rows, steps, shares, regular):
    """All its steps were kept, and numbers that it passed over and repeated were said to be few."""
    size = np.random.default_rng(1).choice(steps, rows, p=shares)
    size[:regular] = 1
    numbers = np.cumsum(size)
    _, remarks = told(numbered(tmp_path / "log.csv", "line", numbers), **HZ)
    if not regular and steps[-1] < 0:
        assert not remarks  # it was never one
        return
    uneven = np.flatnonzero(np.diff(numbers) != 1) + 1
    if steps == (1, 2) and len(uneven) < 10_000:
        lost = f"passes over {len(uneven)} numbers in {len(uneven)} places, first before row "
        assert remarks == [gaps("line", f"{lost}{uneven[0] + 1}")]
        return
    (said,) = remarks
    found = re.match(
        r"'line' steps unevenly in (\d+) of its first (\d+) rows, first in row (\d+)", said
    )
    times, end, first = map(int, found.groups())
    assert times == np.count_nonzero(uneven < end) >= 200
    assert end == rows or times == 9_999
    assert first == uneven[0] + 1
    assert "; if it counts samples, give time_col='line' and sample_rate='100'" in said
    if steps[0] > 0 < steps[1]:
        assert (
            told(tmp_path / "log.csv", time_col="line", **HZ)[0][-1]
            == (numbers[-1] - numbers[0]) * 10**7
        )
