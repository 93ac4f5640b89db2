"""Every row of WRITERS that is no container of messages: exact text, exact numbers elsewhere."""

import json
import zipfile
from functools import partial

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from evo.tools import file_interface
from make.writing import write_series
from pyarrow import csv, feather, parquet

from quatprop.base.errors import OutputError, UsageError
from quatprop.kinematics.series import AttitudeSeries
from quatprop.stores.kinds import READERS
from quatprop.writers import open_table, open_writer
from quatprop.writers.formats import WRITERS, kind_of, layout_of
from quatprop.writers.trajectories import seconds

TOLD = {"convention": {"layout": "scalar-first"}, "n": "ø", "q0_wxyz": [1.0, 0.0, 0.0, 0.0]}
TABLES = [kind for kind, known in WRITERS.items() if known.columns]
OTHERS = [kind for kind, known in WRITERS.items() if not known.encodings]
NAMES = {"scalar-first": ["qw", "qx", "qy", "qz"], "scalar-last": ["qx", "qy", "qz", "qw"]}
SHORT = AttitudeSeries(
    np.array([1_700_000_000_000_000_001, -5]),
    np.array([[1.0, -0.0, 0.0, 0.0], [0.5, -0.5, 0.1 + 0.2, 1e-320]]),
)


def write(target, series=SHORT, kind=None, **options):
    """Write a series, and return the bytes."""
    return write_series(target, series, kind=kind, told=TOLD, **options).read_bytes()


def noise(n):
    """Return attitudes whose components take every sort of float64, and whose stamps vary."""
    rng = np.random.default_rng(8)
    bits = rng.integers(-(2**63), 2**63, 5 * n, dtype=np.int64).view(np.float64)
    values = bits[np.isfinite(bits)][: 4 * n].reshape(-1, 4)
    values[0] = [0.0, -0.0, 1.0, -1.0]
    return AttitudeSeries(rng.integers(-(2**62), 2**62, n), values)


# Text

TEXTS = {
    ("csv", "wxyz"): b"t_ns,qw,qx,qy,qz\n"
    b"1700000000000000001,1,-0,0,0\n"
    b"-5,0.5,-0.5,0.30000000000000004,1e-320\n",
    ("csv", "scalar-last"): b"t_ns,qx,qy,qz,qw\n"
    b"1700000000000000001,-0,0,0,1\n"
    b"-5,-0.5,0.30000000000000004,1e-320,0.5\n",
    ("tsv", None): b"t_ns\tqw\tqx\tqy\tqz\n"
    b"1700000000000000001\t1\t-0\t0\t0\n"
    b"-5\t0.5\t-0.5\t0.30000000000000004\t1e-320\n",
    ("jsonl", None): b'{"t_ns":1700000000000000001,"qw":1,"qx":-0.0,"qy":0,"qz":0}\n'
    b'{"t_ns":-5,"qw":0.5,"qx":-0.5,"qy":0.30000000000000004,"qz":1e-320}\n',
    ("tum", "xyzw"): b"# timestamp tx ty tz qx qy qz qw\n"
    b"1700000000.000000001 0 0 0 -0 0 0 1\n"
    b"-0.000000005 0 0 0 -0.5 0.30000000000000004 1e-320 0.5\n",
    ("euroc", "scalar-first"): b"#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], "
    b"q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    b"1700000000000000001,0,0,0,1,-0,0,0\n"
    b"-5,0,0,0,0.5,-0.5,0.30000000000000004,1e-320\n",
    ("sto", "scalar-first"): b"DataType=Quaternion\nversion=3\nOpenSimVersion=4.5\nendheader\n"
    b"time\ta\n"
    b"1700000000.000000001\t1,-0,0,0\n"
    b"-0.000000005\t0.5,-0.5,0.30000000000000004,1e-320\n",
}


@pytest.mark.parametrize(("kind", "layout"), TEXTS)
def test_text_is_written_to_the_byte(tmp_path, capfdbinary, kind, layout):
    """The lines are these, in a file and on standard output, which stays open."""
    text = TEXTS[kind, layout]
    assert write(tmp_path / "a", kind=kind, layout=layout) == text
    if kind == "sto":  # whose column has the name of the file
        text = text.replace(b"time\ta", b"time\timu")
    write_series("-", SHORT, kind=kind, told=TOLD, layout=layout)
    print("still open", flush=True)
    assert capfdbinary.readouterr().out == text + b"still open\n"


def test_every_text_has_its_lines_here():
    """Rows of matrices are those of KITTI, whose numbers are computed."""
    assert {kind for kind, _ in TEXTS} == {k for k, known in WRITERS.items() if known.is_text} - {
        "kitti"
    }


@pytest.mark.parametrize("kind", [kind for kind, known in WRITERS.items() if known.comments])
def test_a_comment_holds_the_provenance(tmp_path, kind):
    """Asked for, it is one line of JSON ahead of what the file would be without it."""
    bare = write(tmp_path / "bare", kind=kind)
    first, rest = write(tmp_path / "a", kind=kind, comment=True).split(b"\n", 1)
    assert first.startswith(b"# quatprop {")
    assert json.loads(first.removeprefix(b"# quatprop ")) == TOLD
    assert rest == bare
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "bare"]


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
        table.write_rows(np.array([1]), [np.array([np.nan]), np.array([np.inf])])
        table.commit({})
    assert (tmp_path / "a.jsonl").read_bytes() == b'{"t_ns":1,"x":null,"y":null}\n'


# Through other software


def of_records(path):
    """Return the fields of a structured array, which needs no pickle."""
    rows = np.load(path)
    return {name: rows[name] for name in rows.dtype.names}


def of_archive(path):
    """Return the arrays of an archive, whose checksums hold."""
    assert zipfile.ZipFile(path).testzip() is None
    with np.load(path) as archive:
        return {name: archive[name] for name in archive.files if name != "quatprop"}


def of_lines(path):
    """Return what the standard library reads, as the numbers that it says."""
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    kinds = {name: np.int64 if name == "t_ns" else np.float64 for name in rows[0]}
    return {name: np.array([row[name] for row in rows], kinds[name]) for name in rows[0]}


def of_trajectory(path, separator, places):
    """Return what Python's own numbers make of a trajectory at the origin."""
    rows = [line.split(separator) for line in path.read_text().splitlines()[1:]]
    assert {tuple(row[1:4]) for row in rows} == {("0", "0", "0")}
    columns = {"t_ns": np.array([int(row[0].replace(".", "")) for row in rows])}
    return columns | {
        name: np.array([float(row[place]) for row in rows]) for name, place in places.items()
    }


def arrow_columns(read, path):
    """Return the columns of an Arrow table."""
    table = read(path)
    return {name: table[name].to_numpy() for name in table.column_names}


def frame_columns(read, path):
    """Return the columns of a data frame."""
    frame = read(path)
    return {name: frame[name].to_numpy() for name in frame.columns}


CELLS = csv.ConvertOptions(column_types=dict.fromkeys(NAMES["scalar-first"], "float64"))
TAB = csv.ParseOptions(delimiter="\t")
EXACT = {"float_precision": "round_trip"} if pd.__version__ < "3" else {}
"""Reads numbers to the last bit, as pandas 3 does by itself."""

EXACT_READERS = {
    "csv": partial(arrow_columns, partial(csv.read_csv, convert_options=CELLS)),
    "tsv": partial(arrow_columns, partial(csv.read_csv, convert_options=CELLS, parse_options=TAB)),
    "jsonl": of_lines,
    "parquet": partial(arrow_columns, parquet.read_table),
    "feather": partial(arrow_columns, feather.read_table),
    "npy": of_records,
    "npz": of_archive,
    "tum": partial(of_trajectory, separator=" ", places={"qx": 4, "qy": 5, "qz": 6, "qw": 7}),
    "euroc": partial(of_trajectory, separator=",", places={"qw": 4, "qx": 5, "qy": 6, "qz": 7}),
}
"""A reader of each kind that is exact for every float64."""

FRAMES = {
    "csv-pandas": partial(pd.read_csv, **EXACT),
    "csv-polars": pl.read_csv,
    "tsv-pandas": partial(pd.read_csv, sep="\t", **EXACT),
    "tsv-polars": partial(pl.read_csv, separator="\t"),
    "jsonl-pandas": partial(pd.read_json, lines=True, precise_float=True),
    "jsonl-polars": pl.read_ndjson,
    "parquet-pandas": pd.read_parquet,
    "parquet-polars": pl.read_parquet,
    "feather-pandas": pd.read_feather,
    "feather-polars": pl.read_ipc,
}


def check_columns(found, series, layout):
    """Assert names, order, types and every bit of what a reader found."""
    assert list(found) == ["t_ns", *NAMES[layout]]
    assert found["t_ns"].dtype == np.int64
    assert found["t_ns"].tolist() == series.t_ns.tolist()
    stored = np.column_stack([found[name] for name in NAMES["scalar-first"]])
    assert stored.tobytes() == series.wxyz.tobytes()


@pytest.mark.thorough
@pytest.mark.parametrize("layout", NAMES)
@pytest.mark.parametrize("kind", EXACT_READERS)
def test_every_bit_comes_back_through_other_readers(tmp_path, kind, layout):
    """Any stamp and any float64, minus zero and denormals included, in the layouts there are."""
    layout = WRITERS[kind].layout or layout
    # Arrow's files are written in groups of rows, of which these are two.
    series, path = noise(300_000 if kind in {"parquet", "feather"} else 5_000), tmp_path / "a"
    write(path, series, kind, layout=layout)
    check_columns(EXACT_READERS[kind](path), series, layout)


@pytest.mark.parametrize("reader", FRAMES)
def test_tables_open_in_pandas_and_polars(tmp_path, reader):
    """Unit quaternions at stamps that float64 has not are the same to the bit."""
    wxyz = np.random.default_rng(8).normal(size=(500, 4))
    wxyz /= np.linalg.norm(wxyz, axis=1, keepdims=True)
    series = AttitudeSeries(1_700_000_000_123_456_789 + np.arange(500) * 5_000_001, wxyz)
    path = tmp_path / f"a.{reader.split('-')[0]}"
    write(path, series)
    check_columns(frame_columns(FRAMES[reader], path), series, "scalar-first")


def test_evo_reads_trajectories(tmp_path):
    """It has stamps as float64 seconds."""
    series = AttitudeSeries(SHORT.t_ns[:1].repeat(9) + np.arange(9) * 10**9, np.eye(4)[[1] * 9])
    write(tmp_path / "a.tum", series)
    write(tmp_path / "a.csv", series, "euroc")
    for trajectory in (
        file_interface.read_tum_trajectory_file(tmp_path / "a.tum"),
        file_interface.read_euroc_csv_trajectory(tmp_path / "a.csv"),
    ):
        assert trajectory.check()[0]
        np.testing.assert_array_equal(trajectory.orientations_quat_wxyz, series.wxyz)
        np.testing.assert_array_equal(trajectory.positions_xyz, np.zeros((9, 3)))
        np.testing.assert_allclose(trajectory.timestamps, series.t_ns / 1e9, rtol=0, atol=2.4e-7)


@pytest.mark.parametrize("kind", OTHERS)
def test_a_file_without_rows_is_still_one(tmp_path, kind):
    """Committing without a write gives a file that is read as empty, or the head alone."""
    path = write_series(tmp_path / f"a.{kind}", kind=kind)
    if WRITERS[kind].is_text:
        (tmp_path / "full").mkdir()
        lines = write(tmp_path / "full" / path.name, kind=kind).splitlines(keepends=True)
        of_head = {"jsonl": 0, "kitti": 0, "sto": 5}.get(kind, 1)
        assert path.read_bytes() == b"".join(lines[:of_head])
    else:
        assert EXACT_READERS[kind](path)["t_ns"].shape == (0,)


@pytest.mark.parametrize("kind", TABLES)
def test_tables_take_columns_of_any_name(tmp_path, kind):
    """One column is as good as four."""
    path = tmp_path / f"a.{kind}"
    with open_table(path, ["x"], kind) as table:
        table.write_rows(np.array([3]), [np.array([0.25])])
        table.commit({})
    found = EXACT_READERS[kind](path)
    assert {name: column.tolist() for name, column in found.items()} == {"t_ns": [3], "x": [0.25]}


# Provenance


def test_provenance_is_where_other_software_finds_it(tmp_path):
    """Keys of a schema, a string in an archive that needs no pickle: JSON on one line."""
    for kind in ("parquet", "feather", "npz"):
        write(tmp_path / f"a.{kind}")
    kept = parquet.read_metadata(tmp_path / "a.parquet").metadata[b"quatprop"]
    assert json.loads(kept) == TOLD
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert archive.files == ["t_ns", "qw", "qx", "qy", "qz", "quatprop"]
        assert json.loads(archive["quatprop"].item()) == TOLD
    with pa.memory_map(str(tmp_path / "a.feather")) as source:
        file = pa.ipc.open_file(source)
        assert json.loads(file.schema.metadata[b"quatprop"]) == TOLD
        # Its batches can be used in place.
        before = pa.total_allocated_bytes()
        batch = file.get_batch(0)
        assert pa.total_allocated_bytes() == before
        assert batch.num_rows == 2
        del batch, file


# The format that is asked for


@pytest.mark.parametrize(
    ("target", "kind"),
    [("a.csv", "csv"), ("A.CSV", "csv"), ("a.b.parquet", "parquet"), ("a.pq", "parquet")],
)
def test_the_suffix_tells_the_kind(target, kind):
    """In either case of letters."""
    assert kind_of(target) == kind


@pytest.mark.parametrize("target", ["a", "a.out", "a.feather", "a.v2", "s3://bucket/a.bin"])
def test_the_kind_that_is_given_overrules_a_suffix_of_no_format(tmp_path, target):
    """The file is what was asked for."""
    assert kind_of(target, "feather") == "feather"
    if "://" not in target:
        assert write(tmp_path / target, kind="feather")[:6] == b"ARROW1"


FORMAT_SUFFIXES = [
    suffix for row in (*READERS.values(), *WRITERS.values()) for suffix in row.suffixes
]
TEXT_SUFFIXES = {".csv", ".tsv", ".txt", ".dat", ".gcsv", ".tum", ".kitti", ".jsonl", ".ndjson"}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_is_not_named_as_another_format(kind):
    """``-o x.mat --to npz`` wrote an archive of NumPy that no MATLAB could load."""
    form = WRITERS[kind]
    own = form.suffixes[0] if form.suffixes else ".txt"
    for suffix in sorted({*FORMAT_SUFFIXES} - {""}):
        fits = suffix in form.suffixes or (form.is_text and suffix in TEXT_SUFFIXES)
        is_unclear = suffix in {".txt", ".dat", ".gcsv", ".active", ".arrows"}
        if fits or is_unclear or kind.startswith("rosbag2"):
            assert kind_of(f"x{suffix}", kind) == kind, suffix
            continue
        said = ""
        try:
            kind_of(f"x{suffix.upper()}", kind)
        except OutputError as error:
            said = str(error)
        assert f"the suffix {suffix} is that of" in said
        assert f"name the file *{own}" in said
        assert kind_of(f"x{own}", kind) == kind
        if "or omit" in said:
            assert kind_of(f"x{suffix}") != kind, suffix


def refusal(target, kind=None, **options):
    """Return the sentence with which a writer is refused."""
    with pytest.raises((OutputError, UsageError)) as raised:
        open_writer(target, kind, **options)
    return str(raised.value)


@pytest.mark.parametrize("kind", [kind for kind, known in WRITERS.items() if known.layout])
def test_a_format_with_a_layout_of_its_own_refuses_the_other(tmp_path, kind):
    """A prescribed layout can be given, but not changed."""
    prescribed = WRITERS[kind].layout
    assert layout_of(kind, prescribed).name == prescribed
    (other,) = set(NAMES) - {prescribed}
    assert refusal(tmp_path / "a", kind, layout=other) == (
        f"{kind} is {prescribed} by its own definition, not {other}; omit layout"
    )


def test_what_cannot_be_written_is_refused_before_there_is_a_file(tmp_path):
    """Each sentence says what would do."""
    suffixes = [suffix for form in WRITERS.values() for suffix in form.suffixes if suffix]
    target = tmp_path / "a.xyz"
    assert refusal(target) == (
        f"{target}: the suffix does not determine the output format; use one of "
        f"{', '.join(suffixes)}, none for a ROS 2 bag folder, or specify to="
        + " or ".join(map(repr, WRITERS))
    )
    assert refusal(target, "xls") == f"{target}: no output kind 'xls'; choose {'|'.join(WRITERS)}"
    assert refusal(target, "csv", layout="jpl") == (
        "no layout 'jpl'; choose one of 'scalar-first', 'scalar-last', 'wxyz', 'xyzw'"
    )
    assert refusal(target, "jsonl", comment=True) == ("jsonl has no comments; omit header_comment")
    words = f": kind 'tum' holds quaternions only; choose {', '.join(map(repr, TABLES))}$"
    with pytest.raises(OutputError, match=words):
        open_table(tmp_path / "a.tum", ["x"])
    assert list(tmp_path.iterdir()) == []
