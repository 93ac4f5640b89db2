"""Rows of one body after those of another, as a column tells."""

import numpy as np
import pandas as pd
import pytest
from make.table_rates import told

ROWS = 3000


def labelled(path, name, labels):
    """Write rates beside labels, and return the file."""
    frame = pd.DataFrame({"t_ms": np.arange(len(labels)) * 10, name: labels})
    frame[[f"w{axis}_rad_s" for axis in "xyz"]] = np.random.default_rng(1).normal(size=(ROWS, 3))
    frame.to_parquet(path) if path.suffix == ".parquet" else frame.to_csv(path, index=False)
    return path


@pytest.mark.thorough
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("name", ["subject", "participant_id", "Sensor", "device_id"])
@pytest.mark.parametrize(
    "labels", [("S1", "S2"), (1, 2), ("Doe, John", "Roe, J."), ("a=b", "a=c,d")]
)
@pytest.mark.parametrize("row", [30, 1500, 2990])
def test_another_body_from_a_row_on_is_said(tmp_path, suffix, name, labels, row):
    """One attitude was propagated over both; they do not take turns."""
    cells = [labels[0]] * row + [labels[1]] * (ROWS - row)
    path = labelled(tmp_path / f"log.{suffix}", name, cells)
    one, other = labels
    (remark,) = told(path)[1]
    assert remark == (
        f"the rows are of '{one}' in column '{name}', and from row {row + 1} on of '{other}', and "
        f"are read as those of one body; to read those of the first, choose series='{name}={one}'"
    )
    assert told(path, series="all")[1] == []
    t_ns, (remark,) = told(path, series=f"{name}={one}")
    assert (len(t_ns), "were not read" in remark) == (row, True)


@pytest.mark.parametrize(
    ("name", "labels"),
    [("subject", ["S1"]), ("activity", ["walk", "run"]), ("trial", [1, 2]), ("sensor", ["", "a"]),
     ("mode", ["a", "b"]), ("subject", [""]), ("state", [0, 1])],
)  # fmt: skip
def test_what_a_body_does_may_change(tmp_path, name, labels):
    """So may a trial, within one recording, and a label that begins late."""
    cells = np.repeat(labels, ROWS // len(labels)).tolist()
    assert told(labelled(tmp_path / "log.csv", name, cells))[1] == []


def test_many_bodies_are_said_too(tmp_path):
    """More than are told apart were none."""
    cells = [f"S{k // 40}" for k in range(ROWS)]
    (remark,) = told(labelled(tmp_path / "log.csv", "subject", cells))[1]
    assert remark.startswith("the rows are of 'S0' in column 'subject', and from row 41 on of 'S1'")


@pytest.mark.parametrize("first", ["", "S3"])
def test_a_label_with_commas_may_begin_late(tmp_path, first):
    """It is not among the first rows."""
    cells = [first] * 1500 + ["Doe, John"] * (ROWS - 1500)
    path = labelled(tmp_path / "log.csv", "subject", cells)
    assert len(told(path, series="subject=Doe, John")[0]) == ROWS - 1500
