"""Refusals are one sentence, in the words of Python; nothing is written."""

import datetime as dt

import numpy as np
import pandas as pd
import polars as pl
import pytest
from make.commands import begins
from make.places import SAMPLE_LOGS

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.api.attitudes import ARRAYS, MAKE_ATTITUDES, MAKE_RATES
from quatprop.base.errors import (
    ComparisonError,
    LogError,
    OutputError,
    QuatpropError,
    SeriesError,
    UsageError,
)

BAG, TRUTH = SAMPLE_LOGS / "tumbling.bag", SAMPLE_LOGS / "tumbling.truth.csv"
SPIN = SAMPLE_LOGS / "spin.csv"
RATES = GyroSeries(10**9 + np.arange(3) * 10_000_000, np.eye(3))
STILL = AttitudeSeries([0, 1], [[1, 0, 0, 0]] * 2)
SPANS = "Expected `integration_time_ns` of shape (2,), got (1,)"
EMPTY = "Expected a series with samples, got an empty one"
NOT_FINITE = GyroSeries([0, 1, 2], np.full((3, 3), np.nan))


class Scalar:
    """An array of no dimension, as some libraries have it: it cannot be iterated after all."""

    def __iter__(self):
        raise TypeError


PROPAGATE = [
    ({"q0": "level"}, "q0='level' needs a log, not rates in memory"),
    ({"q0": (0, 0, 0, 0)}, "q0 0.0,0.0,0.0,0.0 has the length 0, so it is not an attitude"),
    ({"q0": "inf,0,0,0"}, "q0: 'inf,0,0,0' is not W,X,Y,Z, 4 finite numbers"),
    ({"q0": object()}, "q0: "),
    ({"bias": Scalar()}, "bias: a value of type Scalar is not X,Y,Z, 3 finite numbers"),
    ({"q0": RATES}, "q0: GyroSeries has no attitudes"),
    ({"q0": STILL[:1]}, "q0: its last attitude is"),
    ({"bias": [np.nan, 0, 0]}, "bias: 'nan,0,0' is not X,Y,Z, 3 finite numbers"),
    ({"bias": STILL}, "a series of biases is a GyroSeries"),
    ({"bias": "/imu/bias"}, "bias /imu/bias is not three numbers X,Y,Z, static[:DUR], a file"),
    ({"metod": "end"}, "there is no setting 'metod'; did you mean 'method'"),
    ({"heading": 5}, "heading requires q0='level'"),
    ({"every": 2, "rate": 5}, "every, rate and at each say which attitudes to write"),
    ({"earth_rate": 91}, "earth_rate: '91' is not a latitude: give -90 to 90 deg"),
    ({"earth_rate": (1, 2, 3)}, "'1,2,3' is not LAT,AZIMUTH, 2 finite numbers"),
    ({"reference_z": "down"}, "reference_z requires q0='level' or earth_rate"),
    ({"earth_rate": 90, "rates": "reference"}, "earth_rate ... with bias='0,0,7.292115e-05rad/s'"),
    ({"earth_rate": 45, "bias": "static"}, "bias='static' subtracts ... give bias as numbers"),
    ({"earth_rate": 45, "on_gap": "split"}, "earth_rate counts ... choose on_gap='hold' or"),
    ({"mount": "x,y,-z"}, "the mounting 'x,y,-z' is left-handed, so it is not a rotation"),
    ({"start": dt.datetime(2024, 1, 1)}, "start: "),  # noqa: DTZ001  # no zone is the mistake
    ({"at": [0.5]}, "Expected `at` to be int64 nanoseconds or dates"),
    ({"at": dt.datetime(2020, 1, 1, tzinfo=dt.UTC)}, "... is not a path"),
    ({"at": RATES.t_ns[0]}, "... is not a path"),
    # Settings of logs would be ignored silently otherwise.
    *(
        ({name: value}, f"{name} is for logs, not for rates in memory")
        for name, value in {
            "rate_unit": "deg/s", "topic": "/imu", "clock": "log", "rate_cols": "a,b,c",
            "kind": "csv", "msg_path": "a.msg",
        }.items()
    ),
]  # fmt: skip
COMPARE = [
    ({"tol": -1}, "tol: '-1' is below 0"),
    ({"tol": np.nan}, "tol: 'nan' is not a finite number"),
    ({"max_dt": -5}, "max_dt: '-5' is not a duration above 0"),
    ({"align": "best"}, "align: 'best' is not one of 'none', 'first', 'yaw'"),
    ({"align": 7}, "align: '7' is not one of 'none', 'first', 'yaw'"),
    ({"match": "fuzzy"}, "match: 'fuzzy' is not one of 'exact', 'nearest', 'interpolate'"),
    ({"min_matched": 101}, "min_matched: '101' is not a percentage from 0 to 100"),
    ({"max_dt": "soon"}, "max_dt: 'soon' is not a duration; write a number with a unit"),
    ({"size": 1}, "there is no setting 'size'; there are 'tol', 'rms_tol', 'final_tol'"),
    ({"window_tol": "1deg"}, "window_tol needs windows; give their length with win"),
    ({"align": "yaw", "drift_tol": "1deg/h"}, "drift_tol needs ... an alignment by all pairs"),
    # They were refused with a list of the limits, without a way out.
    ({"topic_b": "x"}, "there is no setting 'topic_b'; give ... returns with topic=..."),
    ({"from_layout_a": "x"}, "there is no setting ... returns with from_layout=..."),
    ({"time_col": "x"}, "there is no setting 'time_col'; give ... returns with time_col=..."),
]
SIMULATE = [
    ({"axis": "1,0,0", "motion": "rest"}, "axis requires motion='spin'"),
    ({"samples": 3, "duration": "1s"}, "samples and duration exclude each other"),
    ({"noise": -1}, "noise: '-1' is below 0"),
    # The log held infinite rates.
    ({"noise": 1e308}, "noise: '1e+308' is larger than a noise density can be"),
    ({"motion": "random-walk", "walk": 1e308}, "walk: '1e+308' is larger than a rate random walk"),
    # Its last timestamps were negative.
    ({"start": 2**63 - 808, "samples": 3}, "the timestamps of 3 samples from 92233720368547750"),
    ({"start": 2**63 - 10**9, "duration": "2s"}, "the timestamps of 200 samples ... exceed 64 b"),
    ({"start": 10**20}, "the timestamps of 2,000 samples from 100000000000000000000 ns on exceed"),
    ({"start": "+5s"}, "start: '+5s' is not a time"),
    ({"bais": 1}, "there is no setting 'bais'; did you mean 'bias'"),
]
CONVERT = [
    ({name: "rotvec"}, f"there is no setting '{name}'; {meant}")
    for name, meant in {
        "with_": "did you mean 'extra_columns'?",
        "with": "did you mean 'extra_columns'?",
        "as_": "did you mean 'representation'?",
        "from_": "did you mean 'kind'?",
        "layot": "did you mean 'layout'?",
        "euler_unit": "it is part of a representation's name, such as 'euler-zyx-deg'",
    }.items()
]
WRITE = [
    ({"with_": "rotvec"}, "there is no setting 'with_'; did you mean 'extra_columns'?"),
    (
        {"representation": "rotvec"},
        "there is no setting 'representation'; there are 'to', 'layout', 'extra_columns'",
    ),
]
PLOT = [
    ([], {}, "there is nothing to draw"),
    ([TRUTH, "a.png"], {}, "name the picture with output='a.png'"),
    ([RATES], {"topic": "/imu"}, "topic is for files"),
    ([RATES], {"output": "a.png"}, "output is for files; ... figure.savefig"),
    ([TRUTH], {"output": "a.png", "reference": STILL}, "output is for files; ... figure.savefig"),
    ([TRUTH], {"output": "a.png", "components": True, "unwrap": True}, "unwrap cannot be"),
    ([TRUTH], {"components": True, "show": "rates"}, "components requires show="),
    ([RATES], {"unwrap": True}, "series 1 has no attitude to show"),
    ([RATES[:0]], {}, "series 1 has no rows"),
    ([RATES], {"reference": TRUTH}, "Expected attitudes"),
    ([np.eye(3)], {}, "a value of type ndarray is not a path; make a series from arrays"),
]
BATCH = [
    ({"at": [1, 2]}, "at of batch() is a file"),
    ({"verify": True}, "verify requires skip_existing"),
    ({"shard": "3/2"}, "'3/2' is not I/N"),
    ({"to": "doc"}, "no output kind 'doc'"),
    ({"methods": "end"}, "there is no setting 'methods'; did you mean 'method'"),
    ({"logs": []}, "... is not a path"),
    ({"logs": "."}, "there are no logs in '.'; name files, folders or patterns"),
]
OTHERS = [
    # A bias is not subtracted by reading.
    (lambda: quatprop.read_rates(BAG, bias="1,2,3"), "there is no setting 'bias'"),
    (lambda: quatprop.write(RATES, "a.csv"), "Expected an AttitudeSeries, got GyroSeries"),
    (
        lambda: quatprop.propagate(NOT_FINITE, on_nonfinite="drop"),
        "no samples in 'series'; 3 with rates that are not finite",
    ),
    (lambda: quatprop.propagate(RATES[:0]), EMPTY),
    (lambda: quatprop.propagate(RATES, at=[]), "at holds no timestamps"),
    (lambda: quatprop.read_rates(TRUTH), "no body rates ... with rate_cols and time_col"),
    (lambda: quatprop.read_attitudes(SPIN), "no attitudes found; ... with quat_cols, from_"),
    (lambda: quatprop.convert(SPIN, "a.csv"), "no attitudes ... from_layout and time_col"),
    (
        lambda: quatprop.propagate(RATES, max_gap="1ms", on_gap="error"),
        "a gap ends at ... choose on_gap='hold' or 'zero' or 'split' or a longer max_gap",
    ),
    (
        lambda: quatprop.compare(STILL, AttitudeSeries([5, 6], STILL.wxyz)),
        "A and B have no time in common ... give time_offset='-5ns'",
    ),
    (lambda: quatprop.write(STILL, "a.unknown"), "the suffix does not determine the output"),
    (
        lambda: quatprop.info(SPIN, time_col="t", sample_rate=3),
        (
            "... does not count samples or ticks, so that time_col and sample_rate contradict each "
            "other; give one"
        ),
    ),
    (lambda: quatprop.plot(STILL, RATES), "series 1 shows yaw in deg ... choose with show"),
    (lambda: GyroSeries([0, 1], np.zeros((2, 3)), [1]), SPANS),
    # Of what is no path the type is named, and no table is shown.
    (lambda: quatprop.propagate(RATES.to_pandas()), f"... is not a path; {ARRAYS}"),
    (lambda: quatprop.read_rates(RATES.to_pandas()), f"... is not a path; {MAKE_RATES}"),
    (lambda: quatprop.noise(RATES.to_arrow()), f"... is not a path; {MAKE_RATES}"),
    (lambda: quatprop.read_attitudes(STILL.to_pandas()), f"... path; {MAKE_ATTITUDES}"),
    (lambda: quatprop.propagate(SPIN, RATES.rate), "w goes with an array of timestamps, not with"),
    (lambda: quatprop.propagate(RATES, RATES.rate), "w goes with an array of timestamps, not with"),
    (lambda: quatprop.propagate([0, 1], RATES.rate), "Expected `w` to have shape (2, 3), got"),
    (lambda: quatprop.propagate([0.0, np.inf, 1], RATES.rate), "`t` has seconds that are not"),
    (lambda: quatprop.propagate(["a", "b", "c"], RATES.rate), "Expected `t` to be int64"),
    (
        lambda: quatprop.compare(STILL, STILL.wxyz),
        f"... is not a path; {MAKE_ATTITUDES}",
    ),
    (
        lambda: quatprop.calibrate(RATES, 7),
        f"reference: '7' is not a path; {MAKE_ATTITUDES}",
    ),
    (lambda: quatprop.convert(STILL, "a.csv"), "... is not a path; write() takes a series"),
    *(
        (lambda path=path, read=read: read(path), "... is not a path")
        for path in (7, None, b"", "", "a\0b")
        for read in (quatprop.read_rates, quatprop.read_attitudes, quatprop.propagate)
    ),
]


@pytest.mark.parametrize("table", [pd.DataFrame, pl.DataFrame])
def test_the_advice_for_a_table_works(table):
    """Its columns go where the advice says, of pandas and of polars."""
    columns = {"t_ns": RATES.t_ns, **dict(zip(("wx", "wy", "wz"), RATES.rate.T, strict=True))}
    advised = f"quatprop.{ARRAYS.split('such as ')[1]}"
    made = eval(advised, {"quatprop": quatprop, "table": table(columns)})  # noqa: S307
    assert made == quatprop.propagate(RATES)


KINDS = {
    ComparisonError: ["A and B have no time in common ... give time_offset='-5ns'"],
    LogError: [
        "a gap ends at ... choose on_gap='hold' or 'zero' or 'split' or a longer max_gap",
        "no attitudes found; ... with quat_cols, from_",
        "no body rates ... with rate_cols and time_col",
        "no samples in 'series'; 3 with rates that are not finite",
        "q0: its last attitude is",
        "no attitudes ... from_layout and time_col",
    ],
    OutputError: ["no output kind 'doc'", "the suffix does not determine the output"],
    SeriesError: [
        "Expected an AttitudeSeries, got GyroSeries",
        "Expected `at` to be int64 nanoseconds or dates",
        "Expected attitudes",
        SPANS,
        EMPTY,
        "series 1 has no rows",
        "Expected `w` to have shape (2, 3), got",
        "`t` has seconds that are not",
        "Expected `t` to be int64",
    ],
}
"""Refusals that are not errors of usage."""


def calls():
    """Yield every call with its sentence."""
    for settings, said in PROPAGATE:
        yield lambda settings=settings: quatprop.propagate(RATES, **settings), said
    for settings, said in COMPARE:
        yield lambda settings=settings: quatprop.compare(STILL, STILL, **settings), said
    for settings, said in SIMULATE:
        yield lambda settings=settings: quatprop.simulate(**settings), said
    for settings, said in CONVERT:
        yield lambda settings=settings: quatprop.convert(TRUTH, "a.csv", **settings), said
    for settings, said in WRITE:
        yield lambda settings=settings: quatprop.write(STILL, "a.csv", **settings), said
    for drawn, settings, said in PLOT:
        yield lambda drawn=drawn, settings=settings: quatprop.plot(*drawn, **settings), said
    for settings, said in BATCH:
        given = {"logs": BAG, "output": "out", **settings}
        yield lambda given=given: quatprop.batch(**given), said
    yield from OTHERS


CALLS = list(calls())


@pytest.mark.parametrize(("call", "sentence"), CALLS, ids=range(len(CALLS)))
def test_it_is_one_sentence_and_nothing_is_written(tmp_path, monkeypatch, call, sentence):
    """Never an AttributeError from inside, and never an option of the command line."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(QuatpropError) as caught:
        call()
    said = str(caught.value)
    assert begins(said, sentence), said
    kinds = [kind for kind, sentences in KINDS.items() if sentence in sentences]
    assert isinstance(caught.value, (*kinds, UsageError)[0])
    assert " --" not in said
    assert "quatprop " not in said
    assert len(said) < 400
    assert list(tmp_path.iterdir()) == []
