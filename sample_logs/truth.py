# ruff: noqa: INP001  # a script, not a package
"""Show how close propagated attitudes come to the truth: ``truth.py TRUTH RESULT...``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet

from quatprop.quaternion import geodesic_angle


def attitudes(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and attitudes wxyz of a table, by the names of its columns."""
    read = pyarrow.parquet.read_table if path.suffix == ".parquet" else pyarrow.csv.read_csv
    table = read(path)
    columns = [table[name].to_numpy() for name in ("qw", "qx", "qy", "qz")]
    return table["t_ns"].to_numpy(), np.column_stack(columns).astype(np.float64)


def main(truth: Path, results: list[Path]) -> None:
    """Print one line for each result; q and -q are the same attitude."""
    true_ns, true = attitudes(truth)
    for result in results:
        t_ns, found = attitudes(result)
        if not np.array_equal(t_ns, true_ns):
            sys.exit(f"{result}: its stamps are not those of {truth}")
        error = geodesic_angle(true, found)
        line = f"{result!s:32} {error.max():10.1e} rad at most {error[-1]:10.1e} rad at the end"
        print(line)  # noqa: T201  # a script's output


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
