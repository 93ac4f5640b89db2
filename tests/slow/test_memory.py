"""Memory that functions of the library take beside the arrays that they return."""

import tracemalloc

import numpy as np
import pytest

import quatprop
from quatprop import AttitudeSeries, GyroSeries

N = 1_000_000
RATES = GyroSeries(np.arange(N) * 5_000_000, np.sin(np.arange(3 * N)).reshape(N, 3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Write a million rates and attitudes."""
    import pyarrow.parquet as pq

    folder = tmp_path_factory.mktemp("million")
    pq.write_table(RATES.to_arrow(), folder / "rates.parquet")
    still = AttitudeSeries(RATES.t_ns, np.tile([1.0, 0, 0, 0], (N, 1)))
    pq.write_table(still.to_arrow(), folder / "attitudes.parquet")
    return folder


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
    tracemalloc.start()
    series = work(folder)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(series) == N
    columns = (getattr(series, name) for name in series.__match_args__)
    size = sum(values.nbytes for values in columns if isinstance(values, np.ndarray))
    assert most < 1.75 * size
