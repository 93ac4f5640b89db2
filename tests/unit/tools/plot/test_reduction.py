"""The reduction of a series to what a picture can show: against brute force, in flat memory."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quatprop.tools.plot.reduction import BINS, PENDING, Reduction


def whole(t_ns, values, bins):
    """Return index, stamps and values of the bins by going through every sample in Python."""
    shift = 0
    while (int(t_ns.max()) >> shift) - (int(t_ns.min()) >> shift) >= bins:
        shift += 1
    kept = {}
    for t, value in zip(t_ns.tolist(), values.tolist(), strict=True):
        kept.setdefault(t >> shift, []).append((t, value))
    found = []
    for index in sorted(kept):
        stamps, numbers = zip(*kept[index], strict=True)
        there = [number for number in numbers if np.isfinite(number)] or [np.nan]
        ends = [number if np.isfinite(number) else np.nan for number in numbers]
        found.append((stamps[0], stamps[-1], ends[0], min(there), max(there), ends[-1]))
    return np.array(found, dtype=object)


def reduced(t_ns, values, cuts, bins):
    """Return the same by the reduction, the series cut into batches at `cuts`."""
    reduction = Reduction(1, bins)
    for times, part in zip(np.split(t_ns, cuts), np.split(values, cuts), strict=True):
        reduction.add(times, part[None])
        reduction.result()
    got = reduction.result()
    columns = got.first_ns, got.last_ns, got.first[0], got.low[0], got.high[0], got.last[0]
    return np.array(list(zip(*(column.tolist() for column in columns), strict=True)), dtype=object)


numbers = st.one_of(
    st.floats(-1e9, 1e9), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, 1.0, -1.0])
)
samples = st.lists(
    st.tuples(st.integers(-(2**62), 2**62) | st.integers(-50, 50), numbers), min_size=1, max_size=60
)


@given(samples, st.lists(st.integers(0, 60), max_size=5), st.integers(2, 20))
@example([(0, 0.0), (0, 0.0), (-1, 0.0), (-2, 0.0), (1, 0.0)], [4], 3)
def test_bins_hold_what_every_sample_says(rows, cuts, bins):
    """First, lowest, highest and last value are those of all samples, in any batches and order."""
    t_ns = np.array([t for t, _ in rows], dtype=np.int64)
    values = np.array([value for _, value in rows])
    in_time = np.argsort(t_ns, kind="stable")
    want = whole(t_ns[in_time], values[in_time], bins)
    got = reduced(t_ns, values, sorted(min(cut, len(rows)) for cut in cuts), bins)
    assert len(got) <= bins
    assert got[:, :2].tolist() == want[:, :2].tolist()
    np.testing.assert_array_equal(got[:, 2:].astype(float), want[:, 2:].astype(float))


@pytest.mark.parametrize("samples", [1000, 5_000, 66_000, 130_000])
def test_a_spike_of_one_sample_stays(samples):
    """The reduced series keeps its height, and has enough bins."""
    for place in (0, 1, samples // 3, samples // 2 - 1, samples - 1):
        values = np.zeros(samples)
        values[place] = 7.0
        reduction = Reduction(1)
        reduction.add(np.arange(samples) * 5_000_000, values[None])
        result = reduction.result()
        assert (result.high == 7.0).sum() == 1
        assert result.high.max() == 7.0
        assert min(samples, BINS / 2) <= len(result) <= BINS


def test_memory_does_not_grow_with_the_series():
    """Two million samples take no more memory than four hundred thousand."""
    batch = np.random.default_rng(0).normal(size=(3, PENDING))

    def peak(batches):
        tracemalloc.start()
        reduction = Reduction(3)
        for number in range(batches):
            reduction.add((np.arange(PENDING) + number * PENDING) * 5_000_000, batch)
        assert len(reduction.result()) > 1000
        _, highest = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return highest

    assert peak(30) < 1.1 * peak(6)


def test_nothing_gives_nothing():
    """A series without samples has no bins."""
    reduction = Reduction(2)
    reduction.add(np.empty(0, np.int64), np.empty((2, 0)))
    assert reduction.result().low.shape == (2, 0)
