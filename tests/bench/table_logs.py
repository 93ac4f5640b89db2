"""Logs that are tables: reading them, and whole commands, in CPU time of all threads."""

import json
import tempfile
import time
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pyarrow.csv
import pyarrow.feather
import pyarrow.parquet
from decode import ours
from table import PYTHON, QUATPROP, Table, best_of, compared

READ_CSV = "import sys, pyarrow.csv as c; c.read_csv(sys.argv[1])"
READ_PARQUET = "import sys, pyarrow.parquet as p; [p.read_table(name) for name in sys.argv[1:]]"
TO_CSV = """
import sys, pyarrow.parquet as p, pyarrow.csv as c
c.write_csv(p.read_table(sys.argv[1]), sys.argv[2])
"""
POLARS_TO_CSV = "import sys, polars as p; p.read_parquet(sys.argv[1]).write_csv(sys.argv[2])"
POLARS_TO_PARQUET = "import sys, polars as p; p.read_csv(sys.argv[1]).write_parquet(sys.argv[2])"
POLARS_READ = "import sys, polars as p; [p.read_parquet(name) for name in sys.argv[1:]]"


def as_hdf5(path: Path, _samples: int) -> None:
    """Write the table next to it as datasets of one dimension."""
    table = pyarrow.parquet.read_table(path.with_name("imu.parquet"))
    with h5py.File(path, "w") as file:
        for name in table.column_names:
            file[name] = table[name].to_numpy()


def with_h5py(path: Path) -> list[object]:
    """Read every dataset."""
    with h5py.File(path) as file:
        return [dataset[:] for dataset in file.values()]


def with_json(path: Path) -> list[object]:
    """Parse line by line."""
    with path.open() as file:
        return [json.loads(line) for line in file]


def as_array(read, path: Path) -> object:
    """Read with another library, and put the rates side by side, as they are propagated."""
    table = read(path)
    return np.column_stack([table[name].to_numpy() for name in ("wx", "wy", "wz")])


AS_ARRAY = "the same, and an array (N, 3)"
PARQUET, FEATHER = pyarrow.parquet.read_table, pyarrow.feather.read_table
READERS = {
    "imu.csv": (7, {"pyarrow.csv.read_csv": pyarrow.csv.read_csv}),
    "imu.parquet": (
        50, {"pyarrow.parquet.read_table": PARQUET, AS_ARRAY: partial(as_array, PARQUET)},
    ),
    "imu.feather": (
        50, {"pyarrow.feather.read_table": FEATHER, AS_ARRAY: partial(as_array, FEATHER)},
    ),
    "imu.jsonl": (3, {"polars.read_ndjson": pl.read_ndjson, "json.loads": with_json}),
    "imu.h5": (50, {"h5py": with_h5py}),
}  # fmt: skip
"""Log -> how often it is read, and what others read it with."""


def measure(folder: Path, samples: int) -> None:
    """Print one table a format, and one a command."""
    for name, (repeats, readers) in READERS.items():
        table = Table(f"read {name}, {samples:,} rows, CPU time")
        for reader, read in {"quatprop": ours, **readers}.items():
            seconds = best_of(repeats, partial(read, folder / name), time.process_time)
            table.row(reader, seconds, samples)
    with tempfile.TemporaryDirectory() as scratch:
        for title, rows in _commands(folder, Path(scratch)).items():
            compared(f"{title}, {samples:,} samples, CPU time", rows, samples, 5, is_cpu=True)


def _commands(folder: Path, out: Path) -> dict[str, dict[str, list[object]]]:
    """Return commands that are compared with one another; later ones read what the first write."""
    a, b, text, back = (out / name for name in ("a.parquet", "b.parquet", "c.csv", "d.parquet"))
    run = [*QUATPROP, "propagate", "-q"]
    return {
        "propagate imu.csv to Parquet": {
            "quatprop": [*run, folder / "imu.csv", "-o", a],
            "pyarrow.csv.read_csv": [*PYTHON, READ_CSV, folder / "imu.csv"],
        },
        "propagate imu.parquet to Parquet": {
            "quatprop": [*run, folder / "imu.parquet", "-o", b],
            "pyarrow.parquet.read_table": [*PYTHON, READ_PARQUET, folder / "imu.parquet"],
        },
        "convert Parquet to CSV": {
            "quatprop convert": [*QUATPROP, "convert", a, text, "--layout", "xyzw"],
            "polars": [*PYTHON, POLARS_TO_CSV, a, text],
            "pyarrow read_table and write_csv": [*PYTHON, TO_CSV, a, text],
        },
        "convert CSV to Parquet": {
            "quatprop convert": [*QUATPROP, "convert", text, back],
            "polars": [*PYTHON, POLARS_TO_PARQUET, text, back],
        },
        "compare two Parquet files": {
            "quatprop compare": [*QUATPROP, "compare", a, b],
            "polars.read_parquet of both": [*PYTHON, POLARS_READ, a, b],
            "pyarrow.parquet.read_table of both": [*PYTHON, READ_PARQUET, a, b],
        },
    }
