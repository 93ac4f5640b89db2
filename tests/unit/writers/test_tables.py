"""Tables and trajectories in every format: exact text, exact numbers through other readers."""

import json
import os
import re

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
import pytest

from quatprop.errors import OutputError, UsageError
from quatprop.series import AttitudeSeries
from quatprop.writers import open_table, open_writer
from quatprop.writers.formats import WRITERS, layout_of
from quatprop.writers.tables.trajectories import seconds

TOLD = {"convention": {"layout": "scalar-first"}, "n": "ø", "q0_wxyz": [1.0, 0.0, 0.0, 0.0]}
TABLES = [kind for kind, known in WRITERS.items() if known.columns]
COMMENTED = [kind for kind, known in WRITERS.items() if known.comments]
SHORT = AttitudeSeries(
    np.array([1_700_000_000_000_000_001, -5]),
    np.array([[1.0, -0.0, 0.0, 0.0], [0.5, -0.5, 0.1 + 0.2, 1e-320]]),
)


def write(target, series=SHORT, kind=None, cuts=(), **options):
    """Write a series, cut into batches, and return the bytes."""
    with open_writer(target, kind, **options) as writer:
        for rows in np.split(np.arange(len(series)), cuts):
            writer.write(AttitudeSeries(series.t_ns[rows], series.wxyz[rows]))
        writer.commit(TOLD)
    return target.read_bytes()


def noise(n):
    """Return attitudes whose components take every sort of float64, and whose stamps vary."""
    rng = np.random.default_rng(8)
    bits = rng.integers(-(2**63), 2**63, 5 * n, dtype=np.int64).view(np.float64)
    values = bits[np.isfinite(bits)][: 4 * n].reshape(-1, 4)
    values[0] = [0.0, -0.0, 1.0, -1.0]
    return AttitudeSeries(rng.integers(-(2**62), 2**62, n), values)


# Text

TEXTS = {
    "tsv": b"t_ns\tqw\tqx\tqy\tqz\n"
    b"1700000000000000001\t1\t-0\t0\t0\n"
    b"-5\t0.5\t-0.5\t0.30000000000000004\t1e-320\n",
    "jsonl": b'{"t_ns":1700000000000000001,"qw":1,"qx":-0.0,"qy":0,"qz":0}\n'
    b'{"t_ns":-5,"qw":0.5,"qx":-0.5,"qy":0.30000000000000004,"qz":1e-320}\n',
    "tum": b"# timestamp tx ty tz qx qy qz qw\n"
    b"1700000000.000000001 0 0 0 -0 0 0 1\n"
    b"-0.000000005 0 0 0 -0.5 0.30000000000000004 1e-320 0.5\n",
    "euroc": b"#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    b"q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    b"1700000000000000001,0,0,0,1,-0,0,0\n"
    b"-5,0,0,0,0.5,-0.5,0.30000000000000004,1e-320\n",
}


@pytest.mark.parametrize("kind", TEXTS)
def test_text_is_written_to_the_byte(tmp_path, kind):
    """The lines are these, in the layout that the format has by default or by definition."""
    assert write(tmp_path / "a", kind=kind) == TEXTS[kind]


@pytest.mark.parametrize("kind", COMMENTED)
def test_a_comment_holds_the_provenance(tmp_path, kind):
    """Asked for, it is one line of JSON ahead of what the file would be without it."""
    bare = write(tmp_path / "bare", kind=kind)
    first, rest = write(tmp_path / "a", kind=kind, comment=True).split(b"\n", 1)
    assert first.startswith(b"# quatprop {")
    assert json.loads(first.removeprefix(b"# quatprop ")) == TOLD
    assert rest == bare
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "bare"]


def test_a_format_without_comments_refuses_one(tmp_path):
    """JSON Lines has no comments."""
    with pytest.raises(UsageError, match=r"^jsonl has no comments; leave header_comment out$"):
        write(tmp_path / "a.jsonl", comment=True)


def test_seconds_are_exact_to_the_ends_of_int64():
    """Nine decimals hold every nanosecond, before and after zero."""
    stamps = [-(2**63), -(10**9), -1, 0, 5, 10**9, 2**63 - 1]
    assert seconds(np.array(stamps)).to_pylist() == [
        "-9223372036.854775808",
        "-1.000000000",
        "-0.000000001",
        "0.000000000",
        "0.000000005",
        "1.000000000",
        "9223372036.854775807",
    ]


def test_json_has_null_where_there_is_no_number(tmp_path):
    """Not-a-number and infinity have no word in JSON."""
    with open_table(tmp_path / "a.jsonl", ["x", "y"]) as table:
        table.write(np.array([1]), [np.array([np.nan]), np.array([np.inf])])
        table.commit({})
    assert (tmp_path / "a.jsonl").read_bytes() == b'{"t_ns":1,"x":null,"y":null}\n'


# Layouts


@pytest.mark.parametrize(("kind", "other"), [("tum", "wxyz"), ("euroc", "xyzw")])
def test_a_format_with_a_layout_of_its_own_refuses_the_other(tmp_path, kind, other):
    """What the definition prescribes can be said, but not changed."""
    prescribed = layout_of(kind).name
    assert layout_of(kind, prescribed).name == prescribed
    words = (
        rf"^{kind} is {prescribed} by its own definition, not scalar-(first|last); "
        r"leave layout out$"
    )
    with pytest.raises(UsageError, match=words):
        open_writer(tmp_path / "a", kind, layout=other)
    assert list(tmp_path.iterdir()) == []


# Through other readers


def read_csv(path, **options):
    """Return t_ns and the components wxyz of delimited text, read by pyarrow."""
    names = ["qw", "qx", "qy", "qz"]
    table = pyarrow.csv.read_csv(
        path,
        parse_options=pyarrow.csv.ParseOptions(**options),
        convert_options=pyarrow.csv.ConvertOptions(
            column_types={"t_ns": "int64", **dict.fromkeys(names, "float64")}
        ),
    )
    return columns_of(table)


def columns_of(table):
    """Return t_ns and wxyz of an Arrow table."""
    return table["t_ns"].to_numpy(), np.column_stack([table[f"q{c}"].to_numpy() for c in "wxyz"])


def read_jsonl(path):
    """Return what the standard library reads."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    wxyz = [[float(row[name]) for name in ("qw", "qx", "qy", "qz")] for row in rows]
    return np.array([row["t_ns"] for row in rows]), np.array(wxyz)


def read_npy(path):
    """Return what NumPy reads out of a structured array, or out of an archive of columns."""
    with np.load(path) if path.suffix == ".npz" else memory_map(path) as data:
        return data["t_ns"].copy(), np.column_stack([data[f"q{c}"] for c in "wxyz"])


class memory_map:  # noqa: N801  # stands where a function would
    """A mapped array as a context."""

    def __init__(self, path):
        self.data = np.load(path, mmap_mode="r")

    def __enter__(self):
        return self.data

    def __exit__(self, *_):
        del self.data


def read_tum(path):
    """Return what Python's own numbers make of the text."""
    rows = [line.split() for line in path.read_text().splitlines()[1:]]
    stamps = [int(row[0].replace(".", "")) for row in rows]
    assert {tuple(row[1:4]) for row in rows} == {("0", "0", "0")}
    return np.array(stamps), np.array([[float(row[k]) for k in (7, 4, 5, 6)] for row in rows])


def read_euroc(path):
    """Return what Python's own numbers make of the text."""
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    return (
        np.array([int(row[0]) for row in rows]),
        np.array([[float(value) for value in row[4:8]] for row in rows]),
    )


READ_BY_OTHERS = {
    "csv": read_csv,
    "tsv": lambda path: read_csv(path, delimiter="\t"),
    "jsonl": read_jsonl,
    "parquet": lambda path: columns_of(pyarrow.parquet.read_table(path)),
    "feather": lambda path: columns_of(pyarrow.feather.read_table(path)),
    "npy": read_npy,
    "npz": read_npy,
    "tum": read_tum,
    "euroc": read_euroc,
}


@pytest.mark.parametrize("kind", READ_BY_OTHERS)
def test_every_bit_comes_back_through_other_readers(tmp_path, kind):
    """Stamps and components are the same to the bit, minus zero and denormals included."""
    series = noise(20_000)
    path = tmp_path / (WRITERS[kind].suffixes or (".csv",))[0].replace(".", "a.")
    write(path, series, kind)
    t_ns, wxyz = READ_BY_OTHERS[kind](path)
    np.testing.assert_array_equal(t_ns, series.t_ns)
    np.testing.assert_array_equal(wxyz.view(np.int64), series.wxyz.view(np.int64))


@pytest.mark.parametrize("kind", READ_BY_OTHERS)
def test_batches_of_any_size_give_the_same_bytes(tmp_path, kind):
    """How a series is cut into batches cannot be seen in the file, nor when it was written."""
    series = noise(300_000)
    whole = write(tmp_path / "whole", series, kind)
    assert write(tmp_path / "cut", series, kind, (1, 1, 700, 70_000, 262_145)) == whole


@pytest.mark.parametrize("kind", READ_BY_OTHERS)
def test_a_file_without_rows_is_still_one(tmp_path, kind):
    """Committing without a write gives a file that is read as empty."""
    path = tmp_path / f"a.{kind}"
    with open_writer(path, kind) as writer:
        writer.commit({})
    if kind not in {"tum", "euroc", "jsonl"}:
        t_ns, _ = READ_BY_OTHERS[kind](path)
        assert t_ns.shape == (0,)
    assert (
        len(path.read_bytes().splitlines()) == (0 if kind == "jsonl" else 1)
        or not WRITERS[kind].is_text
    )


@pytest.mark.parametrize("kind", TABLES)
def test_scalar_last_moves_the_names_with_the_numbers(tmp_path, kind):
    """Read by name, a table of the other layout is the same."""
    path = tmp_path / f"a.{kind}"
    write(path, kind=kind, layout="scalar-last")
    t_ns, wxyz = READ_BY_OTHERS[kind](path)
    np.testing.assert_array_equal(t_ns, SHORT.t_ns)
    np.testing.assert_array_equal(wxyz, SHORT.wxyz)


# Provenance


def test_feather_keeps_the_provenance_in_its_schema(tmp_path):
    """Under the key quatprop, as JSON; the batches can be used in place."""
    write(tmp_path / "a.feather")
    with pa.memory_map(str(tmp_path / "a.feather")) as source:
        file = pa.ipc.open_file(source)
        assert json.loads(file.schema.metadata[b"quatprop"]) == TOLD
        before = pa.total_allocated_bytes()
        batch = file.get_batch(0)
        assert pa.total_allocated_bytes() == before
        assert batch.num_rows == 2
        del batch, file


def test_npz_keeps_the_provenance_as_a_string(tmp_path):
    """It is one string of JSON, which needs no pickle."""
    write(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert archive.files == ["t_ns", "qw", "qx", "qy", "qz", "quatprop"]
        assert json.loads(archive["quatprop"].item()) == TOLD


def test_npy_is_one_structured_array_in_the_order_of_the_layout(tmp_path):
    """The fields have the names and types of any table."""
    write(tmp_path / "a.npy", layout="scalar-last")
    array = np.load(tmp_path / "a.npy", allow_pickle=False)
    assert array.dtype.descr == [("t_ns", "<i8"), *((f"q{c}", "<f8") for c in "xyzw")]
    assert array[1].item() == (-5, -0.5, 0.1 + 0.2, 1e-320, 0.5)


# Places


def test_npy_refuses_a_pipe(tmp_path):
    """The number of rows stands at the beginning, which has gone when it is known."""
    pipe = tmp_path / "a.npy"
    os.mkfifo(pipe)
    words = f"^{re.escape(str(pipe))}: a pipe or a device cannot take a NumPy file, whose beginning"
    with pytest.raises(OutputError, match=words):
        open_writer(pipe, "npy")
    assert pipe.is_fifo()


@pytest.mark.parametrize("kind", ["tsv", "jsonl", "tum", "euroc"])
def test_text_goes_to_stdout(capfdbinary, kind):
    """Every kind of text can be asked for on standard output."""
    with open_writer("-", kind) as writer:
        writer.write(SHORT)
        writer.commit({})
    assert capfdbinary.readouterr().out == TEXTS[kind]


def test_other_columns_go_into_tables_only(tmp_path):
    """A trajectory has no room for columns of any name."""
    words = f": kind 'tum' holds quaternions only; choose {', '.join(map(repr, TABLES))}"
    with pytest.raises(OutputError, match=words):
        open_table(tmp_path / "a.tum", ["x"])


@pytest.mark.parametrize("kind", TABLES)
def test_tables_take_columns_of_any_name(tmp_path, kind):
    """One column is as good as four."""
    path = tmp_path / f"a.{kind}"
    with open_table(path, ["x"], kind) as table:
        table.write(np.array([3]), [np.array([0.25])])
        table.commit({})
    assert path.stat().st_size > 0
