"""Blocks of messages that are decoded together, and the stretches that hold messages."""

import gc
import weakref
from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.base.errors import DamagedLogError
from quatprop.readers.containers import topic_table
from quatprop.readers.containers.parts import GROUP, LARGE, in_groups
from quatprop.readers.containers.topic_table import FirstBlocks, decoded_together
from quatprop.readers.messages.blocks import MessageBlock
from quatprop.stores.file_source import ranges_of, ranges_worth_reading

PLACES = st.lists(st.tuples(st.integers(0, 40), st.integers(0, 30)), min_size=1, max_size=30)
"""Gap before each message, and its length."""


def block_of(places, seed=0, bound=0):
    """Return a block of random bytes with messages at these places."""
    steps = np.array(places, np.int64)
    ends = np.cumsum(steps.sum(axis=1))
    starts = ends - steps[:, 1]
    data = np.random.default_rng(seed).integers(0, 256, int(ends[-1]) + 7, np.uint8)
    stamps = seed * 1000 + np.arange(len(places), dtype=np.int64)
    return MessageBlock(data, starts, ends, stamps, stamps + 1, bound)


def messages(block):
    """Return the bytes and stamps of each message."""
    ends = zip(block.starts, block.ends, block.log_ns, block.publish_ns, strict=True)
    return [(block.data[a:b].tobytes(), int(log), int(sent)) for a, b, log, sent in ends]


@given(PLACES, st.integers(0, 40))
def test_stretches_hold_the_messages_and_only_short_gaps(places, gap):
    """Side by side, the stretches have the same messages; gaps that are longer are left out."""
    block = block_of(places)
    spans = ranges_of(block.starts, block.ends, gap)
    data = spans.of(block.data)
    assert len(data) == spans.size
    for start, end, by in zip(block.starts, block.ends, spans.moved, strict=True):
        assert data[start - by : end - by].tobytes() == block.data[start:end].tobytes()
    apart = zip(spans.ends[:-1], spans.begins[1:], strict=True)
    assert all(begin - end > gap for end, begin in apart)
    between = sum(min(before, gap + 1) <= gap and before for before, _ in places[1:])
    assert spans.size == sum(length for _, length in places) + between


def test_messages_out_of_place_are_in_stretches_of_their_own():
    """A message that lies before the one in front of it begins another stretch."""
    spans = ranges_of(np.array([50, 10, 20]), np.array([55, 18, 25]), gap=1000)
    assert spans.begins.tolist() == [50, 10]
    assert spans.ends.tolist() == [55, 25]
    assert spans.moved.tolist() == [50, 5, 5]


@given(st.lists(PLACES, max_size=12), st.integers(1, 40))
def test_blocks_are_decoded_together_in_their_order(several, enough):
    """None is left out, and those that wait are few: the first is not held back."""
    blocks = [block_of(places, seed, bound=seed) for seed, places in enumerate(several)]
    before, topic_table.ENOUGH_MESSAGES = topic_table.ENOUGH_MESSAGES, enough
    try:
        together = list(decoded_together(blocks))
    finally:
        topic_table.ENOUGH_MESSAGES = before
    assert [*chain(*together)] == blocks
    assert [len(each) for each in together[:1]] == [1][: len(blocks)]
    for each in together:
        assert sum(map(len, each[:-1])) < enough
    counts = [sum(map(len, each)) for each in together]
    for one, other in pairwise(counts[:-1]):
        assert other >= min(enough, 2 * one)


def test_blocks_that_wait_are_bounded_in_bytes():
    """Large messages are decoded before many of them are in memory."""
    half = topic_table.ENOUGH_BYTES // 2
    blocks = (block_of([(0, half)], seed) for seed in range(6))
    assert [len(each) for each in decoded_together(blocks)] == [1, 2, 2, 1]


def test_a_compacted_block_holds_nothing_but_its_messages():
    """A block next to images does not hold on to them."""
    block = block_of([(10_000, 8)] * 5)
    kept = block.compacted()
    assert len(kept.data) == 5 * 8
    assert messages(kept) == messages(block)


def test_a_few_messages_of_a_chunk_are_worth_picking():
    """Parts that are far from each other are ranges of their own."""
    starts, ends = np.array([100_000, 900_000]), np.array([100_500, 900_300])
    spans = ranges_worth_reading(starts, ends, 900_300)
    assert (spans.begins.tolist(), spans.ends.tolist()) == ([100_000, 900_000], [100_500, 900_300])
    assert spans.size == 800


@pytest.mark.parametrize("size", [2000, 1999])
def test_a_quarter_of_a_chunk_is_the_most_that_is_picked(size):
    """Of more, reading all of it is as quick."""
    spans = ranges_worth_reading(np.array([0]), np.array([500]), size)
    assert (spans is None) == (size < 2000)


@pytest.mark.parametrize(
    ("starts", "ends"),
    [([], []), ([-30_000, 10], [10, 20]), ([10], [5_000_000]), ([1_000_010], [1_000_000])],
)
def test_an_index_that_points_elsewhere_picks_nothing(starts, ends):
    """Before the records, behind them, or where a message would end behind them."""
    places = np.array(starts, np.int64), np.array(ends, np.int64)
    assert ranges_worth_reading(*places, 1_000_000) is None


@given(st.lists(st.just(0) | st.integers(1, LARGE + 9), max_size=30))
def test_chunks_are_loaded_in_groups_in_their_order(sizes):
    """Each is in one group, and those of a group are no more than it may have; large ones alone."""
    groups = list(in_groups(list(enumerate(sizes))))
    assert [chunk for chunks, _ in groups for chunk in chunks] == list(range(len(sizes)))
    for chunks, is_large in groups:
        shares = [sizes[k] or GROUP // 16 for k in chunks]
        assert is_large == (max(shares) > LARGE)
        assert len(chunks) == 1 or sum(shares) <= GROUP


# The first blocks of a topic are held for whoever reads it next, while there is room.


class Topic:
    """A log of one topic, whose blocks hold a byte array each; it counts those in memory."""

    def __init__(self, count, size=0, error=None):
        self.count, self.size, self.error = count, size, error
        self.read, self.held, self.closed = 0, 0, False

    def _free(self):
        self.held -= 1

    def blocks(self, _channel, *_within):
        """Yield the blocks, each with its number for a stamp; then fail where that is asked for."""
        try:
            for number in range(self.count):
                data = np.zeros(self.size, np.uint8)
                weakref.finalize(data, self._free)
                self.read += 1
                self.held += 1
                place = np.array([0]), np.array([self.size])
                yield MessageBlock(data, *place, *[np.array([number])] * 2)
                del data
            if self.error:
                raise self.error
        finally:
            self.closed = True


def test_a_long_topic_is_not_kept(monkeypatch):
    """Once there is no room for a topic, nothing of it is held, by whoever reads on either."""
    monkeypatch.setattr(topic_table, "ROOM", 1000)
    topic = Topic(100, size=100)
    held = [topic.held for _ in FirstBlocks(topic, "topic")]
    assert max(held) < 15  # ten have room


def test_an_error_is_not_taken_for_the_end_of_a_topic():
    """Who begins to read a topic after another met an error in it meets the error too."""
    blocks = FirstBlocks(Topic(1, error=DamagedLogError("log", "broken")), "topic")
    for _ in range(2):
        with pytest.raises(DamagedLogError, match=r"^log: broken"):
            list(blocks)


def test_what_was_held_is_read_on_after_its_release():
    """Who began before and goes on after it reads nothing twice, and holds nothing."""
    topic = Topic(50, size=1000)
    first = FirstBlocks(topic, "topic")
    next(iter(first))
    blocks = iter(first)
    first.release()
    assert [int(block.log_ns[0]) for block in blocks] == list(range(50))
    assert (topic.read, topic.held <= 2) == (50, True)


def test_a_reading_that_nobody_goes_on_with_ends_at_once():
    """Its threads are not left to the garbage collector, which may run in one of them."""
    topic = Topic(50)
    gc.disable()
    try:
        blocks = FirstBlocks(topic, "topic")
        next(iter(blocks))
        blocks.release()
        assert topic.closed
    finally:
        gc.enable()
