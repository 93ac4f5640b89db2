"""Comparisons of long series, and of many: memory, and uncertainties over many draws of noise."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.comparison import files
from quatprop.comparison.compare import compare
from quatprop.comparison.settings import ComparisonSettings, comparison_settings
from quatprop.kinematics.quaternion import exp, multiply
from quatprop.logs.attitude_input import AttitudeInput


def test_the_uncertainty_of_an_offset_is_honest():
    """Over many noisy series the errors are as large as their standard deviations say."""
    seconds = np.arange(0, 30, 0.01)
    t_ns = (seconds * 1e9).round().astype(np.int64)
    phases = seconds[:, None] * [1.3, 2.1, 0.7] + [0.0, 1.0, 2.0]
    rates = np.sin(phases) + 0.4 * np.sin(3.3 * phases + 1)
    true_ns, squares = 12_300_000, []
    truth = quatprop.propagate(GyroSeries(t_ns, rates), method="cubic").wxyz
    turn = Rotation.from_rotvec([0.3, -2.0, 0.5]).as_quat(scalar_first=True)
    settings = comparison_settings(time_offset="auto", tol=10.0)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        measured = rates + 0.03 * rng.normal(size=rates.shape) + 0.01
        a = quatprop.propagate(GyroSeries(t_ns, measured), method="mean")
        noise = exp(np.radians(0.5) * rng.normal(size=rates.shape))
        b = AttitudeSeries(t_ns + true_ns, multiply(multiply(truth, noise), turn))
        offset = compare(AttitudeSeries(t_ns, a.wxyz), b, settings).time_offset
        squares.append(((offset.added_to_b_ns + true_ns) / offset.found.std_ns) ** 2)
    # chi-squared of 8 degrees of freedom: 99 % between 1.34 and 21.95
    assert 1.34 < np.sum(squares) < 21.95


@pytest.fixture
def peak():
    """Return a function that returns how much memory a call takes at most, bytes."""

    def measure(work):
        tracemalloc.start()
        work()
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    return measure


def test_unit_quaternions_are_compared_where_they_lie(peak):
    """Two long series of unit length take no memory for copies of them."""
    t_ns, wxyz = np.arange(600_000), np.tile([0.6, 0.8, 0.0, 0.0], (600_000, 1))
    a, b = AttitudeSeries(t_ns, wxyz), AttitudeSeries(t_ns, wxyz.copy())
    assert peak(lambda: compare(a, b, ComparisonSettings(tol=1.0))) < 1.5 * wxyz.nbytes


def test_a_comparison_of_files_keeps_only_errors(tmp_path, monkeypatch, peak):
    """Memory holds 8 bytes of a pair, and of the beginning what causes are looked for in."""

    def refuse(*_anything):
        raise AssertionError("compared in memory")

    monkeypatch.setattr(files, "compare", refuse)
    monkeypatch.setattr("quatprop.tables.arrow.BATCH_ROWS", 1 << 14)
    monkeypatch.setattr(files, "SHORT", 0)
    monkeypatch.setattr(files, "MAX_SAMPLES", 1000)
    t_ns = np.arange(800_000)
    sides = []
    for seed in range(2):
        steps = np.random.default_rng(seed).normal(scale=0.05, size=(len(t_ns), 3))
        wxyz = Rotation.from_rotvec(np.cumsum(steps, axis=0)).as_quat(scalar_first=True)
        columns = dict(zip(("t_ns", "qw", "qx", "qy", "qz"), (t_ns, *wxyz.T), strict=True))
        pq.write_table(pa.table(columns), tmp_path / f"{seed}.parquet")
        sides.append(AttitudeInput(str(tmp_path / f"{seed}.parquet")))
    settings = comparison_settings(tol="4rad")
    for side in sides:
        few = pq.read_table(side.path).slice(0, 2000)
        pq.write_table(few, f"{side.path}.few.parquet")
    # Modules that are imported when they are needed are no memory of this comparison.
    few = (replace(side, path=f"{side.path}.few.parquet") for side in sides)
    files.compare_files(*few, settings, keep=False)
    most = peak(lambda: files.compare_files(*sides, settings, keep=False))
    assert most < 3 * 8 * len(t_ns)
