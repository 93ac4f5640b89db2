"""Blocks of messages put together, and the stretches that hold messages."""

from itertools import chain, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quatprop.containers import coalesce as module
from quatprop.containers.base import MessageBlock
from quatprop.containers.chunks import GROUP, LARGE, in_groups
from quatprop.containers.coalesce import coalesce_blocks
from quatprop.stores.byte_ranges import ranges_of, ranges_worth_reading

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
def test_joined_blocks_have_the_same_messages(several, enough):
    """Whatever is put together, no message is lost, changed or moved."""
    blocks = [block_of(places, seed, bound=seed) for seed, places in enumerate(several)]
    before, module.ENOUGH_MESSAGES = module.ENOUGH_MESSAGES, enough
    try:
        together = list(coalesce_blocks(blocks))
    finally:
        module.ENOUGH_MESSAGES = before
    assert [*chain(*map(messages, together))] == [*chain(*map(messages, blocks))]
    bounds = [block.not_before_ns for block in together]
    assert bounds == sorted(bounds)
    assert not blocks or bounds[-1] == blocks[-1].not_before_ns
    large = enough // 2
    for one, other in pairwise(together):
        assert len(one) >= large or len(other) >= large or len(one) >= enough


def test_a_large_block_passes_as_it_is():
    """What is large enough is not copied."""
    small, large = block_of([(1, 2)] * 3), block_of([(0, 1)] * module.ENOUGH_MESSAGES)
    assert list(coalesce_blocks([small, large, small]))[1] is large


def test_waiting_messages_are_bounded_in_bytes():
    """Large messages come out before many of them are in memory."""
    half = module.ENOUGH_BYTES // 2
    blocks = (block_of([(0, half)], seed) for seed in range(6))
    assert [len(block) for block in coalesce_blocks(blocks)] == [2, 2, 2]


def test_small_blocks_keep_nothing_but_their_messages():
    """A block beside images does not hold on to them."""
    block = block_of([(10_000, 8)] * 5)
    (kept,) = coalesce_blocks([block])
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
