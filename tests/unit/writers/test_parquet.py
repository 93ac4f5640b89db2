"""Parquet: types, provenance, and bytes that depend on the data alone."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer
from quatprop.writers.tables.arrow import GROUP


@pytest.mark.parametrize(
    ("layout", "names"),
    [
        ("scalar-first", ["t_ns", "qw", "qx", "qy", "qz"]),
        ("scalar-last", ["t_ns", "qx", "qy", "qz", "qw"]),
    ],
)
def test_columns_are_named_typed_and_filled_by_layout(tmp_path, layout, names):
    """The time is a plain int64, the components are float64 under their own names."""
    with open_writer(tmp_path / "a.parquet", layout=layout) as writer:
        writer.write(AttitudeSeries(np.array([5, 9]), np.array([[1.0, 2, 3, 4], [5, 6, 7, 8]])))
        writer.commit({})
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.schema.names == names
    assert table.schema.types == [pa.int64(), *[pa.float64()] * 4]
    assert table.to_pydict() == {
        "t_ns": [5, 9],
        "qw": [1.0, 5.0],
        "qx": [2.0, 6.0],
        "qy": [3.0, 7.0],
        "qz": [4.0, 8.0],
    }


def test_provenance_is_kept_as_json(tmp_path):
    """What the writer is told at the end stands in the file's metadata under one key."""
    told = {"convention": {"layout": "scalar-first"}, "q0_wxyz": [1.0, 0.0, 0.0, 0.0], "n": "ø"}
    with open_writer(tmp_path / "a.parquet") as writer:
        writer.commit(told)
    metadata = pq.read_metadata(tmp_path / "a.parquet").metadata
    assert json.loads(metadata[b"quatprop"]) == told


def test_batches_of_any_size_give_the_same_bytes(tmp_path):
    """Row groups sit at fixed rows, wherever a batch happened to end."""
    n = GROUP + 1000
    rng = np.random.default_rng(7)
    t_ns, wxyz = np.arange(n) * 1_000_003, rng.standard_normal((n, 4))
    files = []
    for cuts in ([], [1, 17, 17, 70_000, GROUP + 1], [GROUP]):
        path = tmp_path / f"{len(files)}.parquet"
        with open_writer(path) as writer:
            for rows in np.split(np.arange(n), cuts):
                writer.write(AttitudeSeries(t_ns[rows], wxyz[rows]))
            writer.commit({"n": n})
        files.append(path.read_bytes())
    assert files[0] == files[1] == files[2]
    table = pq.read_table(tmp_path / "0.parquet")
    np.testing.assert_array_equal(table["t_ns"].to_numpy(), t_ns)
    np.testing.assert_array_equal(table["qz"].to_numpy(), wxyz[:, 3])
    metadata = pq.read_metadata(tmp_path / "0.parquet")
    assert [metadata.row_group(k).num_rows for k in range(2)] == [GROUP, 1000]
