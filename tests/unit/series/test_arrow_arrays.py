"""Columns between NumPy and Arrow."""

import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.places import SAMPLE_LOGS

from quatprop.series.arrow_arrays import to_arrow, to_numpy

CODES = ["f8", "f4", "f2", "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1", "?"]


@pytest.mark.parametrize("code", CODES)
def test_a_column_goes_there_and_back(code):
    """Every type of number, and booleans, which Arrow packs into bits; Arrow agrees."""
    for count in (0, 1, 7, 8, 9, 100):
        values = np.random.default_rng(3).integers(0, 2 if code == "?" else 100, count).astype(code)
        column = to_arrow(values)
        column.validate(full=True)
        assert column.to_pylist() == values.tolist()
        assert to_numpy(column).dtype == values.dtype
        assert to_numpy(column).tolist() == values.tolist()
    # Other programs give no memory for a column without rows.
    empty = to_numpy(pa.Array.from_buffers(column.type, 0, [None, None]))
    assert (empty.dtype, empty.shape) == (values.dtype, (0,))


def test_a_column_that_is_strided_or_of_other_byte_order_is_copied():
    """Arrow has neither."""
    values = np.arange(12.0).reshape(6, 2)[:, 1]
    assert to_arrow(values).to_pylist() == values.tolist()
    assert to_arrow(values.astype(">f8")).to_pylist() == values.tolist()


@given(st.lists(st.none() | st.floats(width=32), max_size=40), st.integers(0, 40))
def test_nulls_of_floats_are_nan(values, begin):
    """Also in a slice, whose bits do not begin with a byte."""
    column = pa.array(values, pa.float64())[begin:]
    wanted = [np.nan if value is None else value for value in values[begin:]]
    np.testing.assert_array_equal(to_numpy(column), wanted)


@given(st.lists(st.lists(st.booleans(), max_size=20), max_size=4))
def test_chunks_are_put_together(chunks):
    """A column of several chunks, of one, of none."""
    column = pa.chunked_array([pa.array(chunk, pa.bool_()) for chunk in chunks], pa.bool_())
    assert to_numpy(column).tolist() == [value for chunk in chunks for value in chunk]


def test_pandas_is_not_imported(tmp_path):
    """Where it is installed, nothing waits for it, whatever is read and written."""
    pytest.importorskip("pandas")
    code = (
        "import sys\n"
        "from quatprop.pipeline.job import Job, run\n"
        "from quatprop.pipeline.settings import OutputSettings\n"
        "kinds = 'csv jsonl parquet feather npz tum'.split()\n"
        "for log, kind in zip(2 * sys.argv[2:], kinds, strict=True):\n"
        "    run(Job(log, OutputSettings(sys.argv[1], to=kind)))\n"
        "    assert 'pandas' not in sys.modules, (log, kind)"
    )
    logs = [SAMPLE_LOGS / name for name in ("spin.csv", "rest.parquet", "tumbling.bag")]
    subprocess.run([sys.executable, "-c", code, tmp_path / "out", *logs], check=True)
