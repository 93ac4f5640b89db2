"""Stages in threads: order, errors, stopping early, and how many threads there are."""

import os
import threading
import time
from itertools import islice

import numpy as np
import pytest

from quatprop.base.threads import (
    OrderedThreadPool,
    in_background,
    prefetch,
    thread_count,
    use_threads,
)
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings


@pytest.fixture(params=[1, 2, 3, 8])
def count(request):
    """Work with so many threads."""
    with use_threads(request.param):
        yield request.param


@pytest.mark.usefixtures("count")
def test_results_keep_the_order_of_their_input():
    """However many threads there are, and whichever of them is first."""

    def slow_first(number):
        time.sleep(0.01 if number % 5 == 0 else 0)
        return number

    written, numbers = [], list(range(20))
    assert list(prefetch(slow_first, numbers)) == numbers
    assert list(in_background(map(slow_first, numbers))) == numbers
    pool = OrderedThreadPool(slow_first, written.append)
    for number in numbers:
        pool.submit(number)
    pool.drain()
    pool.shutdown()
    assert written == numbers


@pytest.mark.usefixtures("count")
def test_an_error_comes_after_the_items_before_it():
    """Nothing that was computed before an error is lost."""

    def failing():
        yield from range(7)
        raise ValueError("the eighth")

    items = in_background(failing())
    assert list(islice(items, 7)) == list(range(7))
    with pytest.raises(ValueError, match="the eighth"):
        next(items)


def test_stopping_early_closes_what_was_read_and_ends_the_thread(count):
    """A reader that is no longer wanted releases its file at once; memory stays flat till then."""
    computed, closed = [], []

    def endless():
        try:
            while True:
                computed.append(len(computed))
                yield computed[-1]
        finally:
            closed.append(True)

    before = set(threading.enumerate())
    items = in_background(endless(), ahead=3)
    assert [next(items), next(items)] == [0, 1]
    time.sleep(0.05)
    assert len(computed) <= 6
    items.close()
    assert set(threading.enumerate()) <= before
    assert closed == [True] or count == 1


def test_the_number_of_threads_reaches_the_threads_themselves():
    """Background work uses the number that was set where it was started."""
    with use_threads(5):
        assert list(in_background(thread_count() for _ in range(2))) == [5, 5]
        with use_threads(None):
            assert thread_count() == 5


@pytest.mark.parametrize(("cores", "count"), [(7, 7), (None, 1)])
def test_a_system_without_affinity_has_all_its_cores(monkeypatch, cores, count):
    """One, where even their number is unknown."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: cores)
    assert thread_count() == count


def test_a_small_log_starts_no_thread(tmp_path, monkeypatch):
    """Starting one takes longer than reading the log."""
    names = [("t_ns", int), ("wx", float), ("wy", float), ("wz", float)]
    np.save(tmp_path / "log.npy", np.array([(k, 0.1, 0.2, 0.3) for k in range(9)], names))
    job = Job(str(tmp_path / "log.npy"), OutputSettings(str(tmp_path / "out.parquet")))
    monkeypatch.setattr("quatprop.base.threads.available_cores", lambda: 4)
    started, start = [], threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda own: started.append(own) or start(own))
    run(job)
    assert not started
    monkeypatch.setattr("quatprop.propagation.job.SMALL_BYTES", 0)
    run(job)
    assert started


def test_an_interruption_while_a_thread_starts_is_passed_on(monkeypatch):
    """The thread was waited for, which is an error of its own before it has started."""

    def interrupted(_thread):
        raise KeyboardInterrupt

    monkeypatch.setattr(threading.Thread, "start", interrupted)
    with use_threads(2), pytest.raises(KeyboardInterrupt):
        next(in_background([1]))
