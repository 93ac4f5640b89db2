"""`convert` writes further columns of a table: carried along, in seconds, as lists."""

from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
import pytest
from make.commands import refused, run
from scipy.spatial.transform import Rotation

T_NS = 1_700_000_000_000_000_000 + np.arange(200) * 20_000_000
TURNS = Rotation.from_rotvec(np.arange(200)[:, None] * [0.01, 0.002, -0.005])
TEMPERATURE, PHASE = 20 + np.arange(200) / 8, np.arange(200) % 7
READ = {
    "csv": pyarrow.csv.read_csv,
    "parquet": pyarrow.parquet.read_table,
    "feather": pyarrow.feather.read_table,
}


@pytest.fixture(autouse=True)
def attitudes(tmp_path, monkeypatch):
    """Write attitudes with two other columns of numbers and one of text."""
    monkeypatch.chdir(tmp_path)
    rows = zip(T_NS, TURNS.as_quat(scalar_first=True), TEMPERATURE, PHASE, strict=True)
    lines = (f"{t},{','.join(map(repr, map(float, q)))},{c},{p},on" for t, q, c, p in rows)
    (tmp_path / "in.csv").write_text("t_ns,qw,qx,qy,qz,temp,gait phase,state\n" + "\n".join(lines))


@pytest.mark.parametrize("kind", READ)
@pytest.mark.parametrize("form", ["quaternion", "euler-zyx", "rotvec", "matrix"])
def test_columns_are_carried_along_in_any_representation(kind, form):
    """In the order that is asked for, behind the attitude, of the rows that are written."""
    options = ("--as", form, "--keep", "gait phase,temp", "--start", "+1s", "--seconds", "-q")
    run("convert", "in.csv", f"out.{kind}", *options, code=0)
    table = READ[kind](f"out.{kind}")
    assert table.column_names[:2] == ["t_ns", "seconds"]
    assert table.column_names[-2:] == ["gait phase", "temp"]
    np.testing.assert_array_equal(table["t_ns"], T_NS[50:])
    np.testing.assert_allclose(table["seconds"], np.arange(150) * 0.02, atol=1e-12)
    np.testing.assert_array_equal(table["temp"], TEMPERATURE[50:])
    np.testing.assert_array_equal(table["gait phase"], PHASE[50:])


def test_rows_that_are_dropped_take_their_columns_with_them():
    """Also where the attitude is that of a joint, whose other body is not known at both ends."""
    lines = Path("in.csv").read_text().splitlines()
    lines[5] = lines[5].replace(lines[5].split(",")[1], "nan", 1)
    Path("bad.csv").write_text("\n".join(lines))
    Path("other.csv").write_text("\n".join([lines[0], *lines[20:100]]))
    options = ("--keep", "temp", "--on-invalid", "drop", "-q")
    run("convert", "bad.csv", "out.csv", *options, code=3)
    np.testing.assert_array_equal(READ["csv"]("out.csv")["temp"], np.delete(TEMPERATURE, 4))
    options = ("--keep", "temp", "--relative-to", "other.csv", "--left", "ned-to-enu", "-q")
    run("convert", "in.csv", "out.csv", *options, code=0)
    np.testing.assert_array_equal(READ["csv"]("out.csv")["temp"], TEMPERATURE[19:99])


@pytest.mark.parametrize("kind", ["parquet", "feather"])
@pytest.mark.parametrize(("form", "size"), [("quaternion", 4), ("euler-zyx", 3), ("matrix", 9)])
def test_an_attitude_is_one_column_of_lists(kind, form, size):
    """As data sets for robot learning have it; it is read again by its elements."""
    out = f"out.{kind}"
    options = ("--as", form, "--list-column", "observation.state", "--keep", "temp", "-q")
    run("convert", "in.csv", out, *options, code=0)
    table = READ[kind](out)
    assert table.column_names == ["t_ns", "observation.state", "temp"]
    numbers = np.array(table["observation.state"].to_pylist())
    assert numbers.shape == (200, size)
    if form == "quaternion":
        np.testing.assert_array_equal(numbers, TURNS.as_quat(scalar_first=True))
        names = ",".join(f"observation.state[{part}]" for part in range(4))
        options = ("--quat-cols", names, "--from-layout", "wxyz", "-q")
        run("convert", out, "again.csv", *options, code=0)
        again = np.column_stack(READ["csv"]("again.csv").columns[1:])
        np.testing.assert_array_equal(again, numbers)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("out.tum --seconds", "--seconds: tum has no place for it; choose 'csv'"),
        ("out.mcap --keep temp", "--keep: mcap has no place for it; choose 'csv'"),
        ("out.csv --list-column x", "--list-column: csv has no place for it; choose 'parquet'"),
        ("out.csv --keep tmp", "--keep: no column 'tmp'; did you mean 'temp'?"),
        ("out.csv --keep qw", "'qw' is the name of another column of the output; name others"),
        ("out.csv --seconds --keep seconds", "'seconds' is the name of another column of"),
        ("out.parquet --list-column t_ns", "'t_ns' is the name of another column of the output"),
        ("out.parquet --list-column temp --keep temp", "'temp' is the name of another column"),
        ("out.csv --keep temp,temp", "'temp,temp' names a column twice"),
        ("out.csv --keep temp --rate 5", "--keep is for rows that are as in the source, not for"),
        ("out.csv --keep temp --as body-rates", "--keep is for rows that are as in the source"),
        ("out.csv --keep state", "'on' in column 'state' is not a number"),
    ],
)
def test_columns_without_a_place_are_refused(tmp_path, arguments, sentence):
    """With what has one; nothing is written."""
    assert sentence in refused("convert", "in.csv", *arguments.split())
    assert [path.name for path in tmp_path.iterdir()] == ["in.csv"]
