"""The library: what a notebook sees."""

import datetime as dt
import json
import pickle
import re
import sys
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet
import pytest
from make.commands import run
from make.places import SAMPLE_LOGS
from make.tables import write_rates
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.base.errors import LogError, NoRatesError, SeriesError, UsageError
from quatprop.base.text import Setting
from quatprop.settings import PROPAGATE
from quatprop.settings.command_options import COMPARE, CONVERT
from quatprop.settings.reading import NOISE, RATES_IN_MEMORY, READ_ATTITUDES

T_NS = np.array([1_700_000_000_000_000_000, 1_700_000_000_010_000_000, 1_700_000_000_020_000_001])
RATE = np.array([[0.1, 0.2, 0.3], [-0.4, 0.5, 0.6], [0.7, -0.8, 0.9]])


FRAME = pd.DataFrame({"t": T_NS, "wx": RATE[:, 0], "wy": RATE[:, 1], "wz": RATE[:, 2]})
COLUMNS = FRAME[["wx", "wy", "wz"]]
STILL = [[1, 0, 0, 0]] * 2
STAMPS = {
    "array": T_NS,
    "list": T_NS.tolist(),
    "tuple": tuple(T_NS.tolist()),
    "objects": np.array(T_NS.tolist(), object),
    "uint64": T_NS.astype(np.uint64),
    "pandas": FRAME["t"],
    "polars": pl.Series(T_NS),
    "arrow": pa.array(T_NS),
    "arrow chunks": pa.chunked_array([T_NS[:1], T_NS[1:]]),
    "datetime64": T_NS.astype("datetime64[ns]"),
    "pandas dates": pd.Series(T_NS.astype("datetime64[ns]")),
    "pandas dates with a zone": pd.Series(
        pd.to_datetime(T_NS, utc=True).tz_convert("Europe/Berlin")
    ),
    "pandas index": pd.to_datetime(T_NS),
    "polars dates": pl.Series(T_NS).cast(pl.Datetime("ns")),
    "arrow dates": pa.array(T_NS, pa.timestamp("ns", tz="UTC")),
}
RATES = {
    "array": RATE,
    "lists": RATE.tolist(),
    "Fortran order": np.asfortranarray(RATE),
    "pandas": COLUMNS,
    "polars": pl.DataFrame(COLUMNS.to_dict("list")),
    "arrow table": pa.table(COLUMNS.to_dict("list")),
    "pandas of Arrow": COLUMNS.convert_dtypes(dtype_backend="pyarrow"),
    "nullable pandas": COLUMNS.convert_dtypes(),
    "arrow lists": pa.FixedSizeListArray.from_arrays(pa.array(RATE.ravel()), 3),
}


@pytest.mark.parametrize("rate", RATES)
def test_series_take_columns_of_any_library(rate):
    """Arrays, lists, pandas, polars and Arrow give the same series."""
    for stamps in STAMPS.values():
        series = GyroSeries(stamps, RATES[rate])
        assert (series.t_ns.dtype, series.rate.dtype) == (np.int64, np.float64)
        assert series.t_ns.tolist() == T_NS.tolist()
        assert series.rate.tolist() == RATE.tolist()
        assert not series.rate.flags.writeable


def test_other_types_are_exact():
    """Coarser dates, lists of dates, which without a zone are in UTC, and shorter numbers."""
    for unit, per in (("us", 1000), ("ms", 1_000_000)):
        stamps = (T_NS // per).astype(f"datetime64[{unit}]")
        for column in (stamps, pd.Series(stamps), pl.Series(stamps)):
            assert GyroSeries(column, RATE).t_ns.tolist() == (T_NS // per * per).tolist()
    start = dt.datetime(2023, 11, 14, 22, 13, 20, tzinfo=dt.UTC)
    series = AttitudeSeries([start, start.replace(second=21, tzinfo=None)], STILL)
    assert series.t_ns.tolist() == [1_700_000_000_000_000_000, 1_700_000_001_000_000_000]
    single = RATE.astype(np.float32)
    assert GyroSeries(T_NS, single).rate.tolist() == single.astype(float).tolist()
    assert GyroSeries(T_NS, [[0, 0, 1]] * 3).rate.dtype == np.float64


def test_float_seconds_only_where_the_caller_says_so():
    """They are rounded to the nearest ns; elsewhere they are refused with the way out."""
    series = GyroSeries.from_seconds([0.1, 0.2, 1e9 + 0.25], RATE)
    assert series.t_ns.tolist() == [100_000_000, 200_000_000, 1_000_000_000_250_000_000]
    assert AttitudeSeries.from_seconds([-0.5], [[1, 0, 0, 0]]).t_ns.tolist() == [-500_000_000]
    with pytest.raises(SeriesError, match=r"got float64; for seconds as floats use from_seconds"):
        GyroSeries([0.1, 0.2, 0.3], RATE)
    for seconds in (["a"], [np.nan], [np.inf], [1e10], [[0.1]]):
        with pytest.raises(SeriesError, match=r"`t_s`"):
            AttitudeSeries.from_seconds(seconds, [[1, 0, 0, 0]])


@pytest.mark.parametrize(
    ("stamps", "rate", "sentence"),
    [
        (T_NS, RATE[:2], r"Expected `rate` to have shape \(3, 3\), got \(2, 3\)"),
        (T_NS[:2], RATE[:2].T, r"Expected `rate` to have shape \(2, 3\), got \(3, 2\); transpose"),
        (T_NS, COLUMNS.where(RATE > 0).convert_dtypes(), "`rate` has values that"),
        (T_NS, RATE.T[:2].T, r"Expected `rate` to have shape \(3, 3\), got \(3, 2\)"),
        (T_NS, RATE.ravel(), r"Expected `rate` to have shape \(3, 3\), got \(9,\)"),
        (T_NS, RATE.astype(str), "Expected `rate` to be numbers, got <U"),
        (T_NS, RATE.astype(complex), "Expected `rate` to be numbers, got complex128"),
        (T_NS, [[1, 2, 3], [1, 2], [1, 2, 3]], "`rate` has rows of different lengths"),
        (T_NS, None, r"Expected `rate` to have shape \(3, 3\), got \(\)"),
        (T_NS, pa.array([[1.0], [1.0, 2.0], []]), "`rate` has rows of different lengths"),
        (T_NS[None], RATE, r"Expected `t_ns` to have shape \(N,\), got \(1, 3\)"),
        (5, RATE, r"Expected `t_ns` to have shape \(N,\), got \(\)"),
        (["a", "b", "c"], RATE, "Expected `t_ns` to be int64 nanoseconds or dates, got <U1"),
        ([True, False, True], RATE, "Expected `t_ns` to be int64 nanoseconds or dates, got bool"),
        ([1, 2, 2**63], RATE, "`t_ns` has values that do not fit 64 bits"),
        ([1, 2, -(2**70)], RATE, "`t_ns` has values that do not fit 64 bits"),
        (pa.array([1, None, 3]), RATE, "`t_ns` has missing values"),
        (np.array(["2020", "NaT", "2021"], "M8[s]"), RATE, "`t_ns` has missing dates"),
        (np.array(["2020", "2021", "9020"], "M8[s]"), RATE, "dates that do not fit 64 bits"),
    ],
)
def test_what_is_no_series_is_one_sentence(stamps, rate, sentence):
    """Wrong shapes, types and values are refused by name."""
    with pytest.raises(SeriesError, match=sentence):
        GyroSeries(stamps, rate)


def test_series_as_arrays_and_tables(monkeypatch):
    """A layout is an order of columns; scipy reads the scalar-last one as the same rotation."""
    rates = GyroSeries(T_NS, RATE)
    assert rates.to_arrow().to_pydict() == {
        "t_ns": T_NS.tolist(), "wx": RATE[:, 0].tolist(), "wy": RATE[:, 1].tolist(),
        "wz": RATE[:, 2].tolist(),
    }  # fmt: skip
    assert rates.to_pandas().equals(rates.to_arrow().to_pandas())
    rotations = Rotation.random(3, random_state=1)
    series = AttitudeSeries(T_NS, rotations.as_quat(scalar_first=True))
    assert series.as_quat(scalar_first=True).tolist() == series.wxyz.tolist()
    again = Rotation.from_quat(series.as_quat(scalar_first=False))
    assert (again.inv() * rotations).magnitude().max() < 1e-15
    assert series.to_arrow().column_names == ["t_ns", "qw", "qx", "qy", "qz"]
    last = series.to_pandas(scalar_first=False)
    assert list(last.columns) == ["t_ns", "qx", "qy", "qz", "qw"]
    assert last["qw"].tolist() == series.wxyz[:, 0].tolist()
    with pytest.raises(UsageError, match=r"scalar_first=True is w, x, y, z, scalar_first=False x,"):
        series.as_quat()
    placed = AttitudeSeries([5], [[1, 0, 0, 0]], [[1.0, 2.0, 3.0]])
    assert placed.to_pandas().to_dict("records") == [
        {"t_ns": 5, "qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "px": 1.0, "py": 2.0, "pz": 3.0}
    ]
    # It is not a dependency.
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match="needs pandas; install it with pip install pandas"):
        rates.to_pandas()


def test_propagation_is_that_of_the_command_line(tmp_path):
    """A log, its rates in memory and the command give the same attitudes to the bit."""
    log, out = SAMPLE_LOGS / "tumbling.bag", tmp_path / "out.parquet"
    options = ["--method", "coning", "--mount", "y,-x,z", "--bias", "0.1,0,0", "--start", "+1s"]
    run("propagate", log, "-o", out, *options, code=0)
    expected = pyarrow.parquet.read_table(out)
    keywords = {"method": "coning", "mount": "y,-x,z", "bias": (0.1, 0, 0), "start": "+1s"}
    for source in (log, quatprop.read_rates(log)):
        result = quatprop.propagate(source, **keywords)
        assert result.to_arrow().equals(expected.select(range(5)).replace_schema_metadata())
        assert result.report.counts.samples_used == len(result) == 900
        assert result.report.convention.method == "coning"
    quatprop.write(quatprop.propagate(log, **keywords), tmp_path / "again.parquet")
    again = pyarrow.parquet.read_metadata(tmp_path / "again.parquet").metadata[b"quatprop"]
    kept = json.loads(pyarrow.parquet.read_metadata(out).metadata[b"quatprop"])
    assert json.loads(again)["convention"] == kept["convention"]


def test_policies_hold_for_rates_in_memory():
    """Stamps that go backwards are refused, or handled as asked."""
    series = GyroSeries(T_NS[[0, 2, 1]], RATE)
    with pytest.raises(LogError, match=r"^series: .*choose on_backwards='drop' or 'sort'"):
        quatprop.propagate(series)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert len(quatprop.propagate(series, on_backwards="drop")) == 2
    dropped, remark = (str(warning.message) for warning in caught)
    assert dropped == "series: 1 rows were dropped"
    assert remark.startswith("series: 1 non-monotonic timestamp (dropped), first at sample 2, t = ")
    with pytest.warns(quatprop.RemarkWarning, match=r"timestamp \(sorted\)"):
        assert quatprop.propagate(series, on_backwards="sort").t_ns.tolist() == T_NS.tolist()


def test_numbers_of_numpy_and_pandas_are_settings():
    """Whole numbers as they come out of a series, and durations with nanoseconds."""
    series = GyroSeries(T_NS, RATE)
    by_numpy = quatprop.propagate(series, start=series.t_ns[1], every=np.int32(1))
    assert by_numpy.t_ns.tolist() == T_NS[1:].tolist()
    for limit in (pd.Timedelta(20_000_001), np.timedelta64(20_000_001, "ns")):
        series = quatprop.propagate(GyroSeries(T_NS, RATE), max_gap=limit)
        assert series.report.policy.max_gap_ns == 20_000_001


IN_MEMORY = {
    "if they are in deg/s, use numpy.deg2rad": [0, 10**7],
    "choose on_backwards='drop' or 'sort', or another t_ns": [0, 5, 3],
    "so nothing turns; choose other timestamps with t_ns": [0] * 30,
    "in another unit, use t_ns in ns": list(range(0, 30 * 10**13, 10**13)),
    "check unit, the time column or t_ns": [-(2**63), 2**63 - 1],
    "choose other timestamps with t_ns": [10**9] * 5 + [2 * 10**9] * 5,
}
"""How advice ends on rates in memory, and stamps that it is given for, in ns."""


@pytest.mark.parametrize("advice", IN_MEMORY)
def test_advice_on_rates_in_memory_names_no_setting_for_logs(advice):
    """`rate_unit='deg/s'` was advised, and refused when it was typed."""
    t_ns = IN_MEMORY[advice]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            quatprop.propagate(GyroSeries(t_ns, [[100.0, 200.0, 300.0]] * len(t_ns)))
            said = [str(warning.message) for warning in caught]
        except LogError as error:
            said = [str(error)]
    assert any(sentence.endswith(advice) for sentence in said)
    assert not re.search("clock|time_col|time_unit|rate_unit", " ".join(said))


def test_what_looks_wrong_is_a_warning(tmp_path):
    """A gap is propagated across, or drawn, and said at the line that calls."""
    t_ns = np.append(np.arange(50), 1000) * 10_000_000
    series = GyroSeries(t_ns, np.tile([0, 0, 0.5], (51, 1)))
    log = write_rates(tmp_path / "log.csv", [(t, 0, 0, 0.5) for t in t_ns.tolist()])
    with pytest.warns(quatprop.RemarkWarning, match="^series: 1 interval longer than 100 ms"):
        quatprop.propagate(series)
    with pytest.warns(quatprop.RemarkWarning, match="1 interval longer than 100 ms") as seen:
        quatprop.plot(log, output=tmp_path / "a.svg", rate_unit="rad/s")
    assert {one.filename for one in seen} == {__file__}


@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ([2, 0, 0, 0], "1 of 1 rows are invalid quaternions"),
        ([np.nan, 0, 0, 0], "none of 1 rows holds an attitude"),
        ([0, 0, 0, 0], "1 of 1 rows are invalid quaternions"),
    ],
)
def test_what_is_no_rotation_is_neither_written_nor_compared(tmp_path, row, sentence):
    """As where it is read from a file."""
    series, good = (AttitudeSeries([0], [wxyz]) for wxyz in (row, [1, 0, 0, 0]))
    with pytest.raises(LogError, match=rf"^series: {sentence}"):
        quatprop.write(series, tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())
    with pytest.raises(LogError, match=rf"^b: {sentence}"):
        quatprop.compare(good, series)


def test_series_and_reports_are_shown_in_a_line(tmp_path):
    """A notebook shows what they hold, not all of it."""
    rates = GyroSeries(T_NS, RATE)
    assert repr(rates) == "<GyroSeries: 3 samples over 20 ms from t = 1700000000000000000 ns>"
    (tmp_path / "in.csv").write_text("t_ns,qw,qx,qy,qz\n1,0,0,0,0\n2,1,0,0,0\n")
    out = tmp_path / "out.csv"
    with pytest.warns(quatprop.DataLossWarning):
        converted = quatprop.convert(tmp_path / "in.csv", out, on_invalid="drop")
    assert repr(converted) == f"<ConversionReport: 1 of 2 rows in {out}>"
    result = quatprop.propagate(rates)
    assert repr(result).startswith("<PropagatedSeries: 3 attitudes over 20 ms")
    assert repr(result.report) == "<RunReport: 3 attitudes of 3 samples by method start>"
    assert result[1:].wxyz.tolist() == result.wxyz[1:].tolist()
    turned = AttitudeSeries([0, 1], [[1, 0, 0, 0], [0.5**0.5, 0, 0, 0.5**0.5]])
    still = AttitudeSeries([0, 1], STILL)
    assert repr(quatprop.compare(turned, still, tol="1deg")) == (
        "<Comparison: 2 pairs, max 90 deg, RMS 63.6396 deg, failed>"
    )
    empty = AttitudeSeries(T_NS[:0], result.wxyz[:0])
    assert repr(empty) == "<AttitudeSeries: no attitudes>"


def test_sentences_of_results_are_spelled_for_python(tmp_path):
    """No mark of a setting is left in what the functions return, or in an error that passes on."""
    log, out = SAMPLE_LOGS / "coning.mcap", tmp_path / "out.csv"
    late = quatprop.propagate(log)
    late = AttitudeSeries(late.t_ns + 40_000_000, late.wxyz)
    comparison = quatprop.compare(late, quatprop.propagate(log))
    assert "time_offset='40ms'" in comparison.likely_cause.remedy
    quatprop.write(late, tmp_path / "in.parquet")
    report = quatprop.convert(tmp_path / "in.parquet", out, convention="jpl")
    assert "add a comment in its header or write Parquet" in report.remarks[0]
    for error in (UsageError(f"choose {Setting('clock', 'log')}"), NoRatesError(log, ["/a"])):
        again = pickle.loads(pickle.dumps(error))  # noqa: S301  # our own
        assert repr(again) == repr(error)
        assert str(again) == str(error)
        assert "ue000" not in repr(error)
    for text in (repr(comparison), str(comparison.likely_cause), repr(report.remarks)):
        assert "ue000" not in text


def test_losses_are_warnings(tmp_path):
    """Unread data are never silent."""
    log = tmp_path / "cut.bag"
    content = (SAMPLE_LOGS / "tumbling.bag").read_bytes()
    log.write_bytes(content[: len(content) * 2 // 3])
    with pytest.warns(quatprop.DataLossWarning, match=r"cut\.bag: lost: ") as caught:
        series = quatprop.read_rates(log)
    assert caught[0].filename == __file__
    assert 0 < len(series) < 1000
    with pytest.warns(quatprop.DataLossWarning, match="lost"):
        quatprop.propagate(log)


@pytest.mark.parametrize(
    ("function", "settings"),
    [
        (quatprop.read_rates, RATES_IN_MEMORY),
        (quatprop.read_attitudes, READ_ATTITUDES),
        (quatprop.propagate, PROPAGATE),
        (quatprop.noise, NOISE),
        (quatprop.compare, COMPARE),
        (quatprop.convert, {"to", "layout", "extra_columns", "representation", *CONVERT}),
        (quatprop.write, {"to", "layout", "extra_columns"}),
    ],
)
def test_every_keyword_is_documented(function, settings):
    """Each setting stands before a colon, or in a list of them, in the parameters."""
    parameters = function.__doc__.split("Returns\n")[0]
    for name in settings:
        assert re.search(rf"\b{name}\b(?=[\w, \\\n]*( :|\n    ))", parameters), name


@pytest.mark.parametrize(
    ("called", "remedy"),
    [
        (lambda path: quatprop.compare(path, path),
         "name the columns with quat_cols, from_layout and time_col of read_attitudes"),
        (lambda path: quatprop.propagate(SAMPLE_LOGS / "spin.csv", q0=path),
         "name the columns with quat_cols, from_layout and time_col of convert"),
        (quatprop.read_attitudes, "name the columns with quat_cols, from_layout and time_col"),
        (lambda path: quatprop.convert(path, "a.csv"),
         "name the columns with quat_cols, from_layout and time_col"),
    ],
)  # fmt: skip
def test_a_way_out_names_the_function_that_has_it(tmp_path, called, remedy):
    """`compare` and `propagate` have no settings of the attitudes that they are given by path."""
    path = tmp_path / "odd.csv"
    path.write_text("t_ns,q_1,q_2,q_3,q_4\n1,1,0,0,0\n2,1,0,0,0\n")
    with pytest.raises(quatprop.QuatpropError) as error:
        called(path)
    assert str(error.value).endswith(remedy)


def test_the_public_names_are_listed():
    """`dir` shows what is public, and no package takes the name of a function."""
    assert set(quatprop.__all__) <= set(dir(quatprop))
    # Folders without modules are what a checkout of an older version has left.
    places = Path(quatprop.__file__).parent.iterdir()
    packages = {path.stem for path in places if path.suffix == ".py" or list(path.glob("*.py"))}
    assert not packages & set(quatprop.__all__)


def test_rates_that_are_not_finite_or_huge_give_no_warnings_of_numpy():
    """They are dropped and counted, assumed away, or refused in a sentence."""
    t_ns = np.arange(4) * 10_000_000
    rate = np.full((4, 3), 0.1)
    rate[1] = np.inf
    with (
        pytest.warns(quatprop.RemarkWarning, match="1 non-finite rate"),
        pytest.warns(quatprop.DataLossWarning, match="1 rows were dropped"),
    ):
        series = quatprop.propagate(GyroSeries(t_ns, rate), mount="y,-x,z", on_nonfinite="drop")
    assert series.t_ns.tolist() == [0, 20_000_000, 30_000_000]
    huge = GyroSeries(t_ns, np.full((4, 3), 1e200))
    with pytest.warns(quatprop.RemarkWarning):
        series = quatprop.propagate(huge, max_gap="1ns", on_gap="zero", rate=250)
    np.testing.assert_array_equal(series.wxyz, [[1, 0, 0, 0]] * 8)
    with pytest.raises(SeriesError, match=r"attitude of sample 1 is not finite; rates must be"):
        quatprop.propagate(huge, end="-0s")


def test_masked_values_are_missing():
    """A masked value is not a sample."""
    rate = np.ma.masked_array(np.ones((2, 3)), mask=[[True] * 3, [False] * 3])
    with pytest.raises(SeriesError, match=r"^`rate` has missing values$"):
        GyroSeries([0, 1], rate)
    series = GyroSeries(np.ma.masked_array([0, 1]), rate[1:].repeat(2, axis=0))
    assert type(series.rate) is type(series.t_ns) is np.ndarray


@pytest.mark.parametrize("variances", [[1, np.nan, 1], [1, -1, 1], [np.inf, 1, 1]])
def test_covariances_are_known_about_all_axes_or_none(tmp_path, variances):
    """A file of others could not be read again."""
    series = AttitudeSeries([5, 6], STILL, covariance=[np.full((3, 3), np.nan), np.diag(variances)])
    sentence = (
        "^series: `covariance` of row 1 has the variances .*; they are 0 or above, or all NaN"
    )
    with pytest.raises(SeriesError, match=sentence):
        quatprop.write(series, tmp_path / "out.parquet")
    assert not (tmp_path / "out.parquet").exists()
