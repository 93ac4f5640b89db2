"""Many cases, one after the other or in processes, their outcomes in the order of the suite."""

from __future__ import annotations

import multiprocessing
import signal
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from fnmatch import fnmatchcase
from functools import partial
from typing import TYPE_CHECKING

from quatprop.check.case import BrokenCase, Case, Outcome
from quatprop.check.judge import judge, settled
from quatprop.check.lock import write_lock
from quatprop.check.update import update

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from concurrent.futures import Future
    from pathlib import Path

    from quatprop.check.lock import Pin


def chosen(cases: Sequence[Case | BrokenCase], patterns: Sequence[str]) -> list[Case | BrokenCase]:
    """Return the cases whose names match one of the patterns; all where there are none.

    Parameters
    ----------
    cases
        The cases.
    patterns
        Parts of names, or with ``*``, ``?`` or ``[...]`` patterns of whole names.
    """

    def wanted(name: str) -> bool:
        return not patterns or any(
            fnmatchcase(name, pattern) if set(pattern) & set("*?[") else pattern in name
            for pattern in patterns
        )

    return [case for case in cases if wanted(case.name)]


def outcomes(
    cases: Sequence[Case | BrokenCase],
    pins: dict[str, Pin],
    *,
    updating: bool = False,
    processes: int = 1,
    record: Callable[[Outcome], None] = lambda _outcome: None,
) -> Generator[Outcome]:
    """Yield what comes of each case, in their order, as soon as those before are done.

    Parameters
    ----------
    cases
        The cases.
    pins
        What they rested on, by name.
    updating
        Make references anew instead of judging.
    processes
        How many cases at a time; the outcomes are the same for any number.
    record
        Called with each outcome as soon as it is there, which may be long before its turn.
    """
    work = partial(settled, work=update if updating else judge)
    known = [pins.get(case.name) for case in cases]
    if processes == 1 or len(cases) == 1:
        for case, pin in zip(cases, known, strict=True):
            outcome = work(case, pin=pin)
            record(outcome)
            yield outcome
        return
    # Processes start afresh, as everywhere but on Linux they must: no lock is copied half-taken.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        min(processes, len(cases)), context, signal.signal, (signal.SIGINT, signal.SIG_IGN)
    )
    try:
        futures = [
            pool.submit(_interruptible, work, case, pin)
            for case, pin in zip(cases, known, strict=True)
        ]
        for future in futures:
            future.add_done_callback(partial(_recorded, record))
        for case, future in zip(cases, futures, strict=True):
            try:
                yield future.result()
            except BrokenExecutor:
                yield Outcome(
                    case.name,
                    "error",
                    "the process that ran it, or one beside it, was killed; is there enough "
                    "memory? Run fewer at a time with -j",
                    line=case.line,
                )
    finally:
        pool.shutdown(cancel_futures=True)


def _interruptible(
    work: Callable[..., Outcome], case: Case | BrokenCase, pin: Pin | None
) -> Outcome:
    """Do something with a case in a process that hears Ctrl-C only meanwhile.

    So a case ends tidily, and a process that waits for the next one does not end in a traceback.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        return work(case, pin=pin)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _recorded(record: Callable[[Outcome], None], future: Future[Outcome]) -> None:
    """Record the outcome of a case that came to its end."""
    if not future.cancelled() and future.exception() is None:
        record(future.result())


def updates(
    cases: Sequence[Case | BrokenCase], pins: dict[str, Pin], lock: Path, *, processes: int = 1
) -> Generator[Outcome]:
    """Yield what comes of updating each case, and write what they pin into the lock at the end.

    Parameters
    ----------
    cases, processes
        As for :func:`outcomes`.
    pins
        What is pinned; of cases that are not updated it stays.
    lock
        The lock of the suite.
    """
    made = dict(pins)

    def record(outcome: Outcome) -> None:
        if outcome.pin is not None:
            made[outcome.name] = outcome.pin

    try:
        yield from outcomes(cases, pins, updating=True, processes=processes, record=record)
    finally:
        # Interrupted or not: the references that were written have to be known.
        write_lock(lock, made)
