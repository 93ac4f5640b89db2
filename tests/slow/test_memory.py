"""Memory that functions of the library take in addition to what they return, and for long logs."""

import sys
import tracemalloc
from dataclasses import replace
from subprocess import run as run_process

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.comparison import file_comparison
from quatprop.comparison.comparison import compare
from quatprop.propagation.attitude_input import AttitudeInput
from quatprop.propagation.job import Job
from quatprop.propagation.settings import OutputSettings
from quatprop.settings.command_options import ComparisonSettings, comparison_settings
from quatprop.tools.batch.execution import Batch
from quatprop.tools.batch.log_search import LogSearch
from quatprop.tools.batch.manifest import Manifest
from quatprop.tools.batch.planning import BatchSettings, Shard

N = 1_000_000
RATES = GyroSeries(np.arange(N) * 5_000_000, np.sin(0.1 * np.arange(3 * N)).reshape(N, 3))
MEASURED = """
import sys, quatprop
density = quatprop.noise(sys.argv[1]).combined.angle_random_walk
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(density.value, density.sigma, status["VmHWM"].split()[0])
"""
"""Prints what is stated, and the most memory, kB."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Write a million rates and attitudes."""
    folder = tmp_path_factory.mktemp("million")
    pq.write_table(RATES.to_arrow(), folder / "rates.parquet")
    still = AttitudeSeries(RATES.t_ns, np.tile([1.0, 0, 0, 0], (N, 1)))
    pq.write_table(still.to_arrow(), folder / "attitudes.parquet")
    return folder


def traced(work):
    """Return what a function returns, and how much memory it left and took at most, bytes."""
    tracemalloc.start()
    result = work()
    left, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return result, left, most


@pytest.mark.parametrize(
    "work",
    [
        lambda folder: quatprop.read_rates(folder / "rates.parquet", rate_unit="rad/s"),
        lambda folder: quatprop.read_attitudes(folder / "attitudes.parquet"),
        lambda _: quatprop.propagate(RATES, sigma=True, noise_density=1e-4),
    ],
    ids=["rates", "attitudes", "covariances"],
)
def test_a_long_series_is_not_held_twice(folder, work):
    """All blocks were kept until they were joined: twice what is returned, and what is read."""
    series, _, most = traced(lambda: work(folder))
    assert len(series) == N
    columns = (getattr(series, name) for name in series.__match_args__)
    size = sum(values.nbytes for values in columns if isinstance(values, np.ndarray))
    assert most < 1.75 * size


def test_unit_quaternions_are_compared_where_they_lie():
    """Two long series of unit length take no memory for copies of them."""
    t_ns, wxyz = np.arange(600_000), np.tile([0.6, 0.8, 0.0, 0.0], (600_000, 1))
    a, b = AttitudeSeries(t_ns, wxyz), AttitudeSeries(t_ns, wxyz.copy())
    *_, most = traced(lambda: compare(a, b, ComparisonSettings(tol=1.0)))
    assert most < 1.5 * wxyz.nbytes


def test_a_comparison_of_files_keeps_only_errors(tmp_path, monkeypatch):
    """Memory holds 8 bytes of a pair, and of the beginning what causes are looked for in."""

    def refuse(*_anything):
        raise AssertionError("compared in memory")

    monkeypatch.setattr(file_comparison, "compare", refuse)
    monkeypatch.setattr("quatprop.readers.tables.arrow.BATCH_ROWS", 1 << 14)
    monkeypatch.setattr(file_comparison, "SHORT", 0)
    monkeypatch.setattr(file_comparison, "MAX_SAMPLES", 1000)
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
    file_comparison.compare_files(*few, settings, keep=False)
    *_, most = traced(lambda: file_comparison.compare_files(*sides, settings, keep=False))
    assert most < 3 * 8 * len(t_ns)


def planned(folder, count):
    """Return a batch of so many listed logs."""
    settings = BatchSettings.for_job(Job("LOG", OutputSettings("OUT", to="npy")), str(folder))
    search = LogSearch("/data/fleet", str(folder), suffix=".npy")
    for number in range(count):
        search.add(f"/data/fleet/vehicle{number % 997:03d}/ride-{number:07d}.mcap")
    manifest = Manifest(str(folder))
    made = Batch(search, settings, manifest, Shard(0, 1), skip=True, verify=False)
    assert len(made.plan.tasks) == count
    return search, made


def test_a_million_names_fit_into_500_mb(tmp_path):
    """The names of listed logs were held twice while logs were propagated: 630 MB."""
    planned(tmp_path, 1)  # imports
    count = 10_000
    kept, left, most = traced(lambda: planned(tmp_path, count))
    del kept
    assert left < 240 * count
    assert most < 330 * count


def test_the_noise_of_ten_million_samples(tmp_path):
    """It takes less than 300 MB."""
    random, path = np.random.default_rng(8), tmp_path / "long.parquet"
    samples = 10_000_000
    t_ns = np.arange(samples) * 5_000_000
    axes = {name: 1e-3 * random.standard_normal(samples) for name in ("wx", "wy", "wz")}
    # Nothing repeats itself: to look for that takes twice as long as to write it.
    plain = {"use_dictionary": False, "compression": "none"}
    pq.write_table(pa.table({"t_ns": t_ns, **axes}), path, **plain)
    done = run_process([sys.executable, "-c", MEASURED, path], check=True, capture_output=True)
    *_, facts = done.stdout.decode().splitlines()
    value, sigma, memory_kb = map(float, facts.split())
    assert abs(value - 1e-3 / np.sqrt(200)) < 4 * sigma
    assert memory_kb < 300 * 1024
