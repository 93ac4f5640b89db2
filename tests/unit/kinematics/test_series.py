"""Series as sequences, arrays, tables and rotations, against NumPy, SciPy, pandas and polars."""

import copy
import pickle
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from make.places import SAMPLE_LOGS
from scipy.spatial.transform import Rotation, Slerp

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.base.arrow_arrays import to_arrow, to_numpy
from quatprop.base.errors import SeriesError, UsageError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.settings.quantities import EULER_SEQUENCES

NS = 1_000_000_000
TURNS = Rotation.random(40, np.random.default_rng(3))
A = AttitudeSeries(np.arange(40) * NS, TURNS.as_quat(scalar_first=True))
W = GyroSeries(np.arange(5), np.arange(15.0).reshape(5, 3))


@pytest.mark.parametrize("expected", [0, 3, 40, 4000, 1 << 62])
@pytest.mark.parametrize("step", [1, 7, 40])
def test_a_number_of_rows_that_a_log_states_may_be_wrong(step, expected):
    """It makes room ahead, and changes nothing else."""
    parts = (A[start : start + step] for start in range(0, 40, step))
    assert AttitudeSeries.gathered(parts, expected) == A


@pytest.mark.parametrize("series", [A, W])
def test_a_row_and_all_rows_one_by_one(series):
    """A number chose an array of no dimension, which is no series."""
    assert len(series[0]) == len(series[-1]) == 1
    assert series[-1].t_ns[0] == series.t_ns[-1]
    assert [int(row.t_ns[0]) for row in series] == series.t_ns.tolist()
    assert series[1:3] == type(series).joined([series[1], series[np.int64(2)]])
    with pytest.raises(IndexError):
        series[len(series)]


@pytest.mark.parametrize("series", [A, W, quatprop.propagate(W)])
def test_equality_is_that_of_all_columns(series):
    """NumPy's is row by row, and Python asked which of them."""
    assert series == copy.copy(series) == pickle.loads(pickle.dumps(series))  # noqa: S301
    assert series != series[:-1]
    assert series != series.t_ns.tolist()
    assert A != W
    assert AttitudeSeries([0], [[np.nan] * 4]) == AttitudeSeries([0], [[np.nan] * 4])
    assert AttitudeSeries(A.t_ns, A.wxyz, position=np.zeros((40, 3))) != A
    assert AttitudeSeries(A.t_ns, A.wxyz, read_layout="scalar-last") == A
    averages = GyroSeries(W.t_ns, W.rate, is_interval_average=True)
    assert W != averages == GyroSeries(W.t_ns, W.rate, is_interval_average=True)


XYZW = TURNS.as_quat()
GIVEN = {
    "array": XYZW,
    "float32": XYZW.astype(np.float32),
    "list": XYZW.tolist(),
    "data frame": pd.DataFrame(XYZW, columns=list("xyzw")),
    "polars": pl.DataFrame(XYZW),
    "arrow": pa.table(dict(zip("xyzw", XYZW.T, strict=True))),
}


@pytest.mark.parametrize("layout", ["scalar-last", "xyzw"])
@pytest.mark.parametrize("kind", GIVEN)
def test_the_layout_is_the_order_of_the_numbers_that_are_given(layout, kind):
    """They were taken for w, x, y, z whatever it said: identity became half a turn."""
    series = AttitudeSeries(A.t_ns, GIVEN[kind], layout=layout)
    np.testing.assert_allclose(series.wxyz, A.wxyz, atol=1e-7)
    assert series.read_layout == "scalar-last"
    by_seconds = AttitudeSeries.from_seconds(np.arange(40.0), GIVEN[kind], layout=layout)
    assert by_seconds == series
    # Series made from it have their numbers in the right order already.
    for copied in (
        replace(series, position=np.zeros((40, 3))), copy.deepcopy(series),
        pickle.loads(pickle.dumps(series)), series[np.arange(40)], series[::1],  # noqa: S301
        AttitudeSeries.joined([series[:20], series[20:]]), series.between(end=int(A.t_ns[-1])),
    ):  # fmt: skip
        assert np.array_equal(copied.wxyz, series.wxyz)
        assert copied.read_layout == "scalar-last"
    for same in ("scalar-first", "wxyz"):
        assert AttitudeSeries(A.t_ns, A.wxyz, layout=same) == A
    assert quatprop.compare(series, A, tol=1e-6).passed


def test_an_unknown_layout_is_refused():
    """It was kept as it was."""
    with pytest.raises(UsageError, match=r"^no layout 'last'; choose one of 'scalar-first', 'scal"):
        AttitudeSeries(A.t_ns, A.wxyz, layout="last")


def test_other_libraries_take_a_series_as_it_is():
    """Through NumPy's and Arrow's protocols."""
    np.testing.assert_array_equal(np.asarray(A), A.wxyz)
    np.testing.assert_array_equal(np.asarray(W, np.float32), W.rate.astype(np.float32))
    for table in (pa.table(A), pl.DataFrame(A).to_arrow(), pa.RecordBatchReader.from_stream(A)):
        found = table.read_all() if isinstance(table, pa.RecordBatchReader) else table
        assert found.column_names == ["t_ns", "qw", "qx", "qy", "qz"]
        np.testing.assert_array_equal(found["qy"].to_numpy(), A.wxyz[:, 2])
    if hasattr(pd.DataFrame, "from_arrow"):
        assert pd.DataFrame.from_arrow(W)["wz"].tolist() == W.rate[:, 2].tolist()


@pytest.mark.parametrize(
    ("limits", "rows"),
    [
        (("+2s", "-3s"), slice(2, 37)), ((2 * NS, None), slice(2, 40)),
        ((None, "+0s"), slice(0, 1)),
        (("1970-01-01T00:00:05Z", datetime(1970, 1, 1, 0, 0, 7, tzinfo=UTC)), slice(5, 8)),
        (("+90s", None), slice(0, 0)),
    ],
)  # fmt: skip
def test_the_rows_between_two_times(limits, rows):
    """Both included."""
    assert A.between(*limits) == A[rows]
    assert A[:0].between("+1s") == A[:0]


@pytest.mark.parametrize("limits", [("+1s", "+0s"), (2 * NS, NS), ("+90s", "-1s"), ("-1s", "+2s")])
def test_a_range_that_ends_before_it_begins_is_refused(limits):
    """It gave an empty series silently."""
    with pytest.raises(UsageError, match="after the end; swap them, or check units"):
        A.between(*limits)


def test_forms_of_a_rotation_are_those_of_scipy():
    """Angles in its spelling of intrinsic rotations."""
    np.testing.assert_allclose(A.as_matrix(), TURNS.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(A.as_rotvec(), TURNS.as_rotvec(), atol=1e-14)
    for name in EULER_SEQUENCES:
        expected = TURNS.as_euler(name.upper(), degrees=True)
        found = A.as_euler(name.upper(), degrees=True)
        np.testing.assert_allclose(np.radians(found), A.as_euler(name.upper()), atol=1e-15)
        np.testing.assert_allclose((found - expected + 180) % 360, 180, atol=1e-10)
    with pytest.raises(UsageError, match="small letters are extrinsic rotations in scipy"):
        A.as_euler("zyx")
    with pytest.raises(UsageError, match="'XYW' is not one of 'ZYX', 'XYZ'"):
        A.as_euler("XYW")


def test_products_and_inverses():
    """Row by row, as SciPy has them."""
    other = AttitudeSeries(A.t_ns, TURNS[::-1].as_quat(scalar_first=True))
    expected = (TURNS * TURNS[::-1]).as_quat(scalar_first=True)
    assert geodesic_angle((A * other).wxyz, expected).max() < 1e-14
    assert geodesic_angle(A.inv().wxyz, TURNS.inv().as_quat(scalar_first=True)).max() < 1e-15
    assert geodesic_angle((A * A.inv()).wxyz, [1, 0, 0, 0]).max() < 1e-14
    with pytest.raises(SeriesError, match=r"relative_to\(\) interpolates"):
        A * other[1:]
    with pytest.raises(TypeError):
        A * 2


def test_covariances_are_about_the_new_body_after_inversion():
    """The old reference; an error about body x at q = 90 deg about z is one about reference y."""
    covariance = np.diag([4.0, 1.0, 1.0])[None]
    q = Rotation.from_rotvec([0, 0, np.pi / 2]).as_quat(scalar_first=True)[None]
    back = AttitudeSeries([0], q, covariance=covariance).inv()
    np.testing.assert_allclose(back.covariance[0], np.diag([1.0, 4.0, 1.0]), atol=1e-15)
    np.testing.assert_allclose(back.inv().covariance, covariance, atol=1e-15)


def test_the_angle_of_a_joint():
    """One body in the axes of another, at its own stamps within the other's."""
    t_ns = np.arange(-5, 45) * NS + NS // 3
    turns = Rotation.random(50, np.random.default_rng(4))
    thigh = AttitudeSeries(t_ns, turns.as_quat(scalar_first=True))
    knee = thigh.relative_to(A)
    (inside,) = np.nonzero((t_ns >= 0) & (t_ns <= 39 * NS))
    np.testing.assert_array_equal(knee.t_ns, t_ns[inside])
    at = Slerp(A.t_ns / NS, TURNS)(t_ns[inside] / NS)
    expected = at.inv() * Rotation.from_quat(thigh.wxyz[inside], scalar_first=True)
    assert geodesic_angle(knee.wxyz, expected.as_quat(scalar_first=True)).max() < 1e-13
    one = A.relative_to(A[3])
    assert len(one) == 1
    assert geodesic_angle(one.wxyz, [1, 0, 0, 0]).max() < 1e-15
    assert len(A.relative_to(A[:0])) == 0


def test_a_notebook_shows_the_first_and_the_last_rows():
    """All of a short series."""
    page = A._repr_html_()
    assert page.startswith("<p>AttitudeSeries: 40 attitudes over 39 s from t = 0 ns</p><table>")
    assert page.count("<tr>") == 1 + 3 + 1 + 3
    assert f"<td>{39 * NS}</td><td>{A.wxyz[-1, 0]:.9g}</td>" in page
    assert W._repr_html_().count("<tr>") == 6
    assert "no samples" in W[:0]._repr_html_()


def test_stamps_beyond_64_bits_are_refused():
    """Of unsigned integers, too; the last that fits is one less."""
    rate = np.zeros((2, 3))
    for t_ns in ([-1, 2**63], np.array([0, 2**63], np.uint64)):
        with pytest.raises(SeriesError, match="`t_ns` has values that do not fit 64 bits"):
            GyroSeries(t_ns, rate)
    assert GyroSeries(np.array([0, 2**63 - 1], np.uint64), rate).t_ns[1] == 2**63 - 1


# Columns between NumPy and Arrow.

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
        "from quatprop.propagation.job import Job, run\n"
        "from quatprop.propagation.settings import OutputSettings\n"
        "kinds = 'csv jsonl parquet feather npz tum'.split()\n"
        "for log, kind in zip(2 * sys.argv[2:], kinds, strict=True):\n"
        "    run(Job(log, OutputSettings(sys.argv[1], to=kind)))\n"
        "    assert 'pandas' not in sys.modules, (log, kind)"
    )
    logs = [SAMPLE_LOGS / name for name in ("spin.csv", "rest.parquet", "tumbling.bag")]
    subprocess.run([sys.executable, "-c", code, tmp_path / "out", *logs], check=True)
