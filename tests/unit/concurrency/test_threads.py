"""Stages in threads: order, errors, stopping early, and how many threads there are."""

import threading
import time
from itertools import islice

import numpy as np
import pytest

from quatprop.concurrency.threads import (
    OrderedThreadPool,
    in_background,
    prefetch,
    thread_count,
    use_threads,
)
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings

COUNTS = (1, 2, 3, 8)


def slow_first(number):
    """Return the number; later ones are sooner ready."""
    time.sleep(0.01 if number % 5 == 0 else 0)
    return number


@pytest.mark.parametrize("count", COUNTS)
def test_results_keep_the_order_of_their_input(count):
    """However many threads there are, and whichever of them is first."""
    written = []
    with use_threads(count):
        assert list(prefetch(slow_first, range(40))) == list(range(40))
        assert list(in_background(map(slow_first, range(40)))) == list(range(40))
        pool = OrderedThreadPool(slow_first, written.append)
        for number in range(40):
            pool.submit(number)
        pool.drain()
        pool.shutdown()
    assert written == list(range(40))


@pytest.mark.parametrize("count", COUNTS)
def test_an_error_comes_after_the_items_before_it(count):
    """Nothing that was computed before an error is lost."""

    def failing():
        yield from range(7)
        raise ValueError("the eighth")

    seen = []
    with use_threads(count):
        items = in_background(failing())
        seen.extend(islice(items, 7))
        with pytest.raises(ValueError, match="the eighth"):
            next(items)
    assert seen == list(range(7))


@pytest.mark.parametrize("count", COUNTS)
def test_stopping_early_closes_what_was_read_and_ends_the_thread(count):
    """A reader that is no longer wanted releases its file at once."""
    closed = []

    def endless():
        try:
            number = 0
            while True:
                yield number
                number += 1
        finally:
            closed.append(number)

    before = threading.active_count()
    with use_threads(count):
        items = in_background(endless(), ahead=3)
        assert next(items) == 0
        assert next(items) == 1
        items.close()
    assert threading.active_count() == before
    assert len(closed) == 1 or count == 1
    assert all(number <= 6 for number in closed), "more was computed ahead than asked for"


def test_no_more_is_computed_ahead_than_was_asked_for():
    """Memory stays flat while the consumer is busy."""
    computed = []

    def numbers():
        for number in range(100):
            computed.append(number)
            yield number

    with use_threads(2):
        items = in_background(numbers(), ahead=2)
        next(items)
        time.sleep(0.05)
        assert len(computed) <= 4
        items.close()


def test_the_number_of_threads_reaches_the_threads_themselves():
    """What runs in the background sees the number that was set where it was started."""
    with use_threads(5):
        assert list(in_background(thread_count() for _ in range(2))) == [5, 5]
        with use_threads(None):
            assert thread_count() == 5


def test_a_small_log_starts_no_thread(tmp_path, monkeypatch):
    """Starting one takes longer than reading the log."""
    log = tmp_path / "log.npy"
    names = [("t_ns", int), ("wx", float), ("wy", float), ("wz", float)]
    np.save(log, np.array([(k, 0.1, 0.2, 0.3) for k in range(9)], names))
    monkeypatch.setattr("quatprop.concurrency.threads.available_cores", lambda: 4)
    started, start = [], threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda own: started.append(own) or start(own))
    run(Job(str(log), OutputSettings(str(tmp_path / "out.parquet"))))
    assert not started
    monkeypatch.setattr("quatprop.pipeline.job.SMALL_BYTES", 0)
    run(Job(str(log), OutputSettings(str(tmp_path / "out.parquet"))))
    assert started
