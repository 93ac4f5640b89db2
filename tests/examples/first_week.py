"""Programs of four kinds of users in their first week, as the documents say it.

``slow/test_examples.py`` runs it in threads and one of them in a process, with warnings as errors;
type checkers read it.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import quatprop

LOGS = Path(__file__).resolve().parents[2] / "sample_logs"
BAG, TRUTH = LOGS / "tumbling.bag", LOGS / "tumbling.truth.csv"


def ros_student(out: Path) -> None:
    """Look at a bag, propagate it, compare it with the truth, and draw both."""
    found = quatprop.info(BAG)
    assert found.sources[0].source == "/imu"
    topic: str | None = found.sources[0].source
    rates = quatprop.read_rates(BAG, topic=topic)
    assert len(rates) == found.sources[0].samples
    print(rates, rates[0], rates.t_ns[0], rates.rate[-1])
    attitudes = quatprop.propagate(BAG, topic="/imu", method="coning")
    print(attitudes.report, attitudes.report.convention.method, attitudes._repr_html_()[:80])
    result = quatprop.compare(attitudes, TRUTH, align="first", tol="0.05deg")
    assert result.passed
    print(result, np.degrees(result.error_rad.max), result.error_rad.rms)
    worse = quatprop.compare(quatprop.propagate(BAG), TRUTH, tol=1e-4)
    assert not worse.passed
    quatprop.write(attitudes, out / "attitude.csv")
    quatprop.write(attitudes, out / "attitude_bag")
    again = quatprop.read_attitudes(out / "attitude_bag")
    np.testing.assert_array_equal(again.t_ns, attitudes.t_ns)
    x, y, z, w = again.as_quat(scalar_first=False)[-1]
    assert abs(np.linalg.norm([x, y, z, w]) - 1) < 1e-12
    quatprop.convert(out / "attitude.csv", out / "enu.csv", left="ned-to-enu", right="frd-to-flu")
    half = Rotation.from_euler("z", 180, degrees=True)
    quatprop.convert(out / "attitude.csv", out / "half.csv", right=half, sign="positive")
    report = quatprop.convert(out / "attitude.csv", out / "xyzw.csv", layout="scalar-last")
    print(report)
    ax = quatprop.plot(attitudes, TRUTH, ax=Figure().subplots())
    ax.set_title("tumbling")
    quatprop.plot(out / "attitude.csv", TRUTH, output=out / "attitudes.html")


def drone_engineer(out: Path) -> None:
    """Propagate with biases and error bars, at the frames of a camera, many logs at once."""
    rates, truth = quatprop.simulate(
        motion="coning", rate=200, duration="5s", noise=1e-4, bias=(0.01, 0, -0.02), seed=7
    )
    first = truth[0]
    plain = quatprop.propagate(rates, q0=first, bias=[0, 0, 0], mount=(1, 0, 0, 0))
    fixed = quatprop.propagate(rates, q0=first, bias=(0.01, 0, -0.02))
    assert fixed.relative_to(truth).as_rotvec()[-1] @ [1, 1, 1] < 0.01
    assert plain.between("+1s", "+2s").t_ns[0] == rates.t_ns[0] + 10**9
    drifting = quatprop.GyroSeries(rates.t_ns[[0, -1]], [[0.01, 0, -0.02]] * 2)
    by_series = quatprop.propagate(rates, q0=truth, bias=drifting)
    np.testing.assert_allclose(by_series.wxyz, fixed.wxyz, atol=1e-12)
    bars = quatprop.propagate(
        rates,
        noise_density=1e-4,
        bias_sigma="20deg/h",
        q0_sigma=("0.2deg", "0.2deg", 0.02),
        sigma=True,
    )
    assert bars.sigma is not None
    assert bars.covariance is not None
    assert bars.report.uncertainty is not None
    assert bars.sigma.shape == (1000, 3)
    frames = rates.t_ns[0] + 33_000_000 * np.arange(100)
    at_frames = quatprop.propagate(rates, at=frames, mount=np.eye(3), threads=1)
    turned = Rotation.from_euler("z", 90, degrees=True)
    same = quatprop.propagate(rates, at=frames.tolist(), q0=turned)
    assert len(at_frames) == len(same) == 100
    slow = quatprop.propagate(rates, rate=50, mount=turned)
    fast = quatprop.propagate(rates, method="quintic", every=2)
    assert len(slow) < len(fast)
    try:
        quatprop.propagate(rates, max_gap="1ms", on_gap="error")
    except quatprop.QuatpropError as error:
        print(error)
    entries = quatprop.batch(LOGS / "*.bag", out / "fleet", to="npy", processes=1)
    assert [entry.state for entry in entries] == ["done"]
    assert quatprop.batch(LOGS / "*.bag", out / "fleet", to="npy", skip_existing=True) == []


def data_scientist(out: Path) -> None:
    """Take columns of pandas and polars, and give tables back."""
    import pandas as pd
    import polars as pl
    import pyarrow as pa

    recorded, _ = quatprop.simulate(motion="tumbling", start="2024-05-01T12:00:00Z")
    recorded.to_pandas().to_csv(out / "log.csv", index=False)
    table = pd.read_csv(out / "log.csv")
    rates = quatprop.GyroSeries(table["t_ns"], table[["wx", "wy", "wz"]])
    attitudes = quatprop.propagate(rates)
    frame = attitudes.to_pandas()
    assert list(frame) == ["t_ns", "qw", "qx", "qy", "qz"]
    assert pl.DataFrame(attitudes).height == len(attitudes)
    assert pa.table(attitudes).num_rows == len(attitudes)
    assert np.asarray(attitudes).shape == (len(attitudes), 4)
    dated = quatprop.GyroSeries(pd.to_datetime(table["t_ns"]), table[["wx", "wy", "wz"]])
    assert dated == rates
    seconds = quatprop.GyroSeries.from_seconds(np.arange(100) * 0.01, rates.rate[:100])
    assert quatprop.propagate(seconds).wxyz[0].tolist() == [1, 0, 0, 0]
    turning = attitudes[attitudes.wxyz[:, 0] > 0.5]
    print(turning, sum(len(row) for row in attitudes[:10]))
    quatprop.write(attitudes, out / "a.parquet", extra_columns="euler-zyx-deg")
    assert "yaw_deg" in pd.read_parquet(out / "a.parquet")
    same = quatprop.read_attitudes(out / "a.parquet")
    assert quatprop.compare(same, attitudes, match="exact", tol=1e-9).passed
    report = attitudes.report.as_json()
    print(report["convention"], attitudes.report.counts.samples_used)


def biomechanist(out: Path) -> None:
    """Angles of a joint between two sensors, from their static pose on."""
    thigh, _ = quatprop.simulate(motion="tumbling", rate=100, duration="4s")
    shank, _ = quatprop.simulate(motion="coning", rate=100, duration="4s")
    upper = quatprop.propagate(thigh, method="coning")
    lower = quatprop.propagate(shank, method="coning", q0=[1, 0, 0, 0])
    knee = lower.relative_to(upper)
    angles = knee.as_euler("ZXY", degrees=True)
    assert angles.shape == (400, 3)
    product = upper.inv() * lower
    np.testing.assert_allclose(np.abs(np.sum(product.wxyz * knee.wxyz, axis=1)), 1, atol=1e-12)
    assert knee.as_matrix().shape == (400, 3, 3)
    turns = Rotation.from_quat(knee.as_quat(scalar_first=True), scalar_first=True)
    np.testing.assert_allclose(
        turns.magnitude(), np.linalg.norm(knee.as_rotvec(), axis=1), atol=1e-9
    )
    start = datetime(2023, 11, 14, 22, 13, 21, tzinfo=UTC)
    trial = knee.between(start, "-500ms")
    assert trial.t_ns[0] == thigh.t_ns[0] + 10**9
    split = quatprop.propagate(thigh, max_gap=timedelta(seconds=1), on_gap="split")
    assert split.report.counts.gaps.count == 0
    own = quatprop.AttitudeSeries.from_seconds([0, 0.01], [[1, 0, 0, 0], [1, 0, 0, 0]])
    short = quatprop.GyroSeries([0, 10_000_000], [[0, 0, 1], [0, 0, 2]])
    reference = quatprop.AttitudeSeries(np.arange(2) * 10_000_000, np.eye(4)[[0, 0]].tolist())
    spans = np.array([[0, 10_000_000]])
    print(quatprop.compare(quatprop.propagate(short), reference, tol=None, judge=spans))
    quatprop.write(own, out / "own.csv", layout="scalar-last")
    judged = quatprop.compare(knee, knee, judge="+1s..+2s", align="mean", window="500ms")
    assert judged.error_rad.max < 1e-7
    axes = quatprop.plot(knee, start="+1s", end="+3s", unwrap=True, ax=Figure().subplots())
    assert axes.get_ylabel() == "deg"
    try:
        quatprop.read_rates(out / "missing.csv", rate_unit="deg/s")
    except quatprop.QuatpropError as error:
        print(error)


def mistakes() -> None:
    """Each is found by type checkers, for which a comment that nothing needs is an error."""
    quatprop.propagate("log.mcap", method="rk4")  # type: ignore[arg-type]
    quatprop.propagate("log.mcap", on_gap="stop")  # type: ignore[arg-type]
    quatprop.compare("a.csv", "b.csv", align="best")  # type: ignore[arg-type]
    quatprop.read_rates("log.mcap", rate_units="deg/s")  # type: ignore[call-arg]


USERS = ros_student, drone_engineer, data_scientist, biomechanist


def in_own_folder(number: int) -> None:
    """Do what a user does, in a folder of its own."""
    out = Path(sys.argv[1]) / f"{USERS[number].__name__}_{os.getpid()}"
    out.mkdir(parents=True)
    USERS[number](out)


def missing() -> None:
    """Fail, in another process."""
    quatprop.read_rates("missing.csv")


if __name__ == "__main__":
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(in_own_folder, range(4)))
    with ProcessPoolExecutor(1, get_context("spawn")) as processes:
        processes.submit(in_own_folder, 0).result()
        print("error:", processes.submit(missing).exception())
