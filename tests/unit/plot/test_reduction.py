"""The reduction of a series to what a picture can show: against brute force, in flat memory."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quatprop.plot.reduction import BINS, PENDING, Reduction


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
    """First, lowest, highest and last value of each bin are those of all its samples, however
    the series was cut into batches and whatever order its stamps are in.
    """
    t_ns = np.array([t for t, _ in rows], dtype=np.int64)
    values = np.array([value for _, value in rows])
    in_time = np.argsort(t_ns, kind="stable")
    want = whole(t_ns[in_time], values[in_time], bins)
    got = reduced(t_ns, values, sorted(min(cut, len(rows)) for cut in cuts), bins)
    assert len(got) <= bins
    assert got[:, :2].tolist() == want[:, :2].tolist()
    np.testing.assert_array_equal(got[:, 2:].astype(float), want[:, 2:].astype(float))


@pytest.mark.parametrize("place", [0, 1, 499_999, 123_457, 999_999])
def test_a_spike_of_one_sample_stays(place):
    """One sample out of a million stands out in the result as it does in the series."""
    values = np.zeros(1_000_000)
    values[place] = 7.0
    reduction = Reduction(1)
    reduction.add(np.arange(1_000_000) * 1_000_000, values[None])
    assert reduction.result().high.max() == 7.0
    assert (reduction.result().high == 7.0).sum() == 1


def test_a_short_series_stays_as_it_is():
    """Where there is a bin for every sample, nothing is lost."""
    t_ns = np.arange(1000) * 5_000_000 + 1_700_000_000_000_000_000
    values = np.sin(np.arange(1000))
    reduction = Reduction(1)
    reduction.add(t_ns, values[None])
    assert reduction.result().first_ns.tolist() == t_ns.tolist()
    assert reduction.result().first[0].tolist() == values.tolist()


def test_the_bins_span_at_least_half_of_their_number():
    """A long series is not left with a handful of bins."""
    for samples in (5_000, 66_000, 130_000):
        reduction = Reduction(1)
        reduction.add(np.arange(samples) * 5_000_000, np.zeros((1, samples)))
        assert BINS / 2 <= len(reduction.result()) <= BINS


def test_memory_does_not_grow_with_the_series():
    """Six and a half million samples take no more memory than four hundred thousand."""
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

    assert peak(100) < 1.1 * peak(6)


def test_nothing_gives_nothing():
    """A series without samples has no bins."""
    reduction = Reduction(2)
    reduction.add(np.empty(0, np.int64), np.empty((2, 0)))
    assert len(reduction.result()) == 0
    assert reduction.result().low.shape == (2, 0)
