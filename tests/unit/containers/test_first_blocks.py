"""The first blocks of a topic are held for whoever reads it next, while there is room."""

import gc
import weakref

import numpy as np
import pytest

from quatprop.containers import first_blocks
from quatprop.containers.first_blocks import FirstBlocks
from quatprop.errors import DamagedLogError
from quatprop.messages.blocks import MessageBlock


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
    monkeypatch.setattr(first_blocks, "ROOM", 1000)
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
