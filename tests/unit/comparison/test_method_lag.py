"""An estimated time offset contains the lag of the integration rules, which is stated with it."""

import json

import numpy as np
import pytest
from make.commands import run
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries, GyroSeries

STEP_NS = 20_000_000
T_NS = STEP_NS * np.arange(1500)
LATE_NS = 14_300_000
"""B's clock is this much ahead of A's."""
LAGS = {"start": 0.5, "end": -0.5, "mean": 0.0, "coning": 0.0, "cubic": 0.0}
LAGS_OF_AVERAGES = {"start": 1.0, "mean": 0.5, "end": 0.0, "coning": 0.0}


def angles(t_s):
    """Return the angles of a body that turns about all axes, slowly for the intervals."""
    waves = (((0.3, 0.0), (0.13, 1.0)), ((0.21, 0.5), (0.071, 2.0)), ((0.4, 1.5), (0.093, 0.2)))
    return np.stack([sum(np.sin(6 * f * t_s + p) for f, p in part) for part in waves], axis=1)


def attitude(t_ns):
    """Return the true attitudes."""
    return Rotation.from_euler("ZYX", angles(t_ns * 1e-9) * [0.8, 0.5, 0.9])


def mean_rate(begin_ns, end_ns):
    """Return the rates, rad/s, that turn the body from one time to another."""
    turn = attitude(begin_ns).inv() * attitude(end_ns)
    return turn.as_rotvec() / ((end_ns - begin_ns) * 1e-9)[:, None]


RATES = GyroSeries(T_NS, mean_rate(T_NS - 1000, T_NS + 1000))
AVERAGES = GyroSeries(T_NS, mean_rate(T_NS - STEP_NS, T_NS), is_interval_average=True)
B_NS = np.arange(0, T_NS[-1], 15_000_000)
B = AttitudeSeries(B_NS + LATE_NS, attitude(B_NS).as_quat(scalar_first=True))

CASES = [(RATES, method, lag) for method, lag in LAGS.items()] + [
    (AVERAGES, method, lag) for method, lag in LAGS_OF_AVERAGES.items()
]


def assert_found(offset, lag_ns, sign=1):
    """Without the lag, the offset is that of the clocks."""
    assert offset.method_lag_ns == sign * lag_ns
    assert offset.added_to_b_ns - offset.method_lag_ns == pytest.approx(
        -sign * LATE_NS, abs=0.01 * STEP_NS
    )


@pytest.mark.filterwarnings("ignore:.*average")
@pytest.mark.parametrize(("rates", "method", "lag"), CASES)
def test_the_clocks_differ_by_the_offset_without_the_lag(rates, method, lag):
    """Whichever of the two was propagated, whole or in part."""
    a = quatprop.propagate(rates, method=method)
    options = {"align": "first", "time_offset": "auto", "tol": 3.0}
    assert_found(quatprop.compare(a, B, **options).time_offset, lag * STEP_NS)
    assert_found(quatprop.compare(a[100:], B, **options).time_offset, lag * STEP_NS)
    assert_found(quatprop.compare(B, a, **options).time_offset, lag * STEP_NS, -1)


def test_two_series_of_one_rule_lag_equally():
    """The offset is then that of the clocks."""
    a = quatprop.propagate(RATES, method="start")
    b = AttitudeSeries(a.t_ns + LATE_NS, a.wxyz, lag_ns=a.lag_ns)
    assert_found(quatprop.compare(a, b, time_offset="auto", tol=3.0).time_offset, 0)


@pytest.mark.parametrize("options", [{}, {"every": 3}, {"rate": "80"}])
def test_a_file_records_the_rule(tmp_path, options):
    """The lag is that of the samples, whatever the interval of the output."""
    log, a, b = (tmp_path / name for name in ("rates.csv", "a.parquet", "b.parquet"))
    columns = np.column_stack([T_NS, RATES.rate])
    np.savetxt(
        log, columns, fmt=["%d", *["%.17g"] * 3], delimiter=",", header="t_ns,wx,wy,wz", comments=""
    )
    thinned = [text for name, value in options.items() for text in (f"--{name}", str(value))]
    run("propagate", log, "-o", a, "--method", "start", "--rate-unit", "rad/s", *thinned, code=0)
    quatprop.write(B, b)
    assert_found(quatprop.compare(a, b, time_offset="auto", tol=3.0).time_offset, STEP_NS / 2)
    command = ("compare", a, b, "--time-offset", "auto", "--tol", "3rad")
    found = json.loads(run(*command, "--json", code=0).stdout)["time_offset"]
    assert found["method_lag_ns"] == STEP_NS // 2
    said = run(*command, code=0).stdout
    clocks = f"{(found['added_to_b_ns'] - STEP_NS // 2) / 1e6:.6g} ms to the clocks if they lag"
    rules = "are due to the integration rules that the series state, and"
    assert f"\n          of which 10 ms {rules} {clocks} by nothing else\n" in said
    assert (
        "due to" not in run("compare", a, b, "--time-offset", "5ms", "--tol", "3rad", code=0).stdout
    )
    said = run("compare", b, a, "--time-offset", "auto", "--tol", "3rad", code=0).stdout
    assert f"\n          of which -10 ms {rules} 14." in said


def test_without_a_known_rule_no_lag_is_stated():
    """A lag that is not known counted as 0, and was stated as such."""
    recorded = AttitudeSeries(T_NS, attitude(T_NS).as_quat(scalar_first=True))
    assert recorded.lag_ns is None
    offset = quatprop.compare(recorded, B, time_offset="auto", tol=3.0).time_offset
    assert offset.method_lag_ns is None
