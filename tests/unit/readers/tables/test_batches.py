"""Batches of streams brought into time order with promises and bounded memory."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.readers.tables.model import NO_BOUND, RowBatch, merge_by_time


def columns(log_ns, first=0, promise=NO_BOUND):
    """Return a batch whose values tell where each row comes from."""
    log_ns = np.array(log_ns, np.int64)
    names = first + np.arange(len(log_ns))
    return RowBatch(log_ns, (names, np.stack([names * 1.0, log_ns * 1.0], axis=1)), promise)


def all_rows(batches):
    """Return the log times and names of the rows, and check that the columns stay together."""
    rows = []
    for batch in batches:
        assert len(batch.log_ns) == len(batch.values[0]) == len(batch.values[1]) > 0
        assert (batch.values[1] == np.stack([batch.values[0], batch.log_ns], axis=1)).all()
        assert batch.watermark_ns == batch.log_ns[-1]
        rows += zip(batch.log_ns.tolist(), batch.values[0].tolist(), strict=True)
    return rows


@st.composite
def promised_streams(draw):
    """Draw streams of batches with promises that are kept."""
    name, streams = 0, []
    for _ in range(draw(st.integers(0, 4))):
        times = draw(st.lists(st.lists(st.integers(-20, 20), max_size=6), max_size=6))
        batches = []
        for number, batch in enumerate(times):
            later = [time for following in times[number + 1 :] for time in following]
            latest = min(later, default=30)
            promise = draw(st.integers(min(latest, -25), latest))
            if promise == -25 and all(time >= max(batch, default=99) for time in later):
                promise = NO_BOUND
            batches.append(columns(batch, name, promise))
            name += len(batch)
        streams.append(batches)
    return streams


@given(promised_streams())
def test_the_merge_is_a_stable_sort_of_everything(streams):
    """With promises that are kept, rows come as one stable sort by time would give them."""
    expected = [
        (time, name)
        for stream in streams
        for batch in stream
        for time, name in zip(batch.log_ns.tolist(), batch.values[0].tolist(), strict=True)
    ]
    expected.sort(key=lambda row: row[0])
    assert all_rows(merge_by_time(streams)) == expected


@given(st.lists(st.lists(st.lists(st.integers(0, 9), max_size=5), max_size=5), max_size=3))
def test_no_row_is_lost_without_promises(times):
    """Streams that promise nothing and keep no order still give every row once."""
    name, streams = 0, []
    for stream in times:
        streams.append([])
        for batch in stream:
            streams[-1].append(columns(batch, name))
            name += len(batch)
    assert sorted(row[1] for row in all_rows(merge_by_time(streams))) == list(range(name))


@pytest.mark.parametrize("promise", [None, 3, 5])
def test_batches_in_order_pass_without_copies_and_one_at_a_time(promise):
    """One stream in order is neither copied nor held, whether it promises or not."""
    given_out = []

    def stream():
        for number in range(5):
            bound = NO_BOUND if promise is None else promise + 10 * number
            batch = columns([10 * number, 10 * number + 3], promise=bound)
            given_out.append(batch)
            yield batch

    for number, batch in enumerate(merge_by_time([stream()])):
        assert len(given_out) == number + 1
        assert batch.log_ns is given_out[-1].log_ns
        assert batch.values[1] is given_out[-1].values[1]


LOW, HIGH = -(2**63), 2**63 - 1


@pytest.mark.parametrize(
    ("streams", "rows"),
    [
        # Equal times come in order of streams, even when the second stream has them first.
        (
            [[([1], 0, 5), ([5, 5], 10, 9)], [([2, 5], 100, 5), ([5, 6], 200, 7)]],
            [(1, 0), (2, 100), (5, 10), (5, 11), (5, 101), (5, 200), (6, 201)],
        ),
        # A broken promise costs the order, not the rows.
        (
            [[([1, 5], 0, 6), ([2, 7], 10, 8), ([9], 20, 9)]],
            [(1, 0), (5, 1), (2, 10), (7, 11), (9, 20)],
        ),
        # The first and last nanosecond of int64 are times like any other.
        (
            [[([LOW, HIGH], 0, HIGH)], [([LOW, 0, HIGH], 10, HIGH)]],
            [(LOW, 0), (LOW, 10), (0, 11), (HIGH, 1), (HIGH, 12)],
        ),
    ],
)
def test_rows_come_in_this_order(streams, rows):
    """Rows at a bound wait for an earlier stream; those later than promised come out late."""
    assert all_rows(merge_by_time([columns(*one) for one in stream] for stream in streams)) == rows


def test_only_what_overlaps_is_held():
    """With promises, memory holds the overlap and not the log."""
    alive = 0
    most = 0

    class Counted(np.ndarray):
        def __del__(self):
            nonlocal alive
            if self.base is None:
                alive -= 1

    def stream(offset):
        nonlocal alive, most
        for number in range(100):
            times = 100 * number + offset + np.arange(0, 150)
            data = np.ndarray.__new__(Counted, (150, 2))
            alive += 1
            most = max(most, alive)
            yield RowBatch(times, (data,), 100 * (number + 1) + offset)
            del data

    assert sum(len(batch) for batch in merge_by_time([stream(0), stream(30)])) == 2 * 100 * 150
    assert most <= 8
