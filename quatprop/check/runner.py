"""Many cases, one after the other or in processes, their outcomes in the order of the suite."""

from __future__ import annotations

from fnmatch import fnmatchcase
from functools import partial
from typing import TYPE_CHECKING

from quatprop.check.case import BrokenCase, Case, Outcome
from quatprop.check.judge import judge, settled
from quatprop.check.lock import write_lock
from quatprop.check.update import update
from quatprop.parallel import KILLED, map_processes

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
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
    pairs = [(case, pins.get(case.name)) for case in cases]
    work = partial(_outcome, updating=updating)
    yield from map_processes(work, pairs, processes, _killed, record)


def _outcome(pair: tuple[Case | BrokenCase, Pin | None], *, updating: bool) -> Outcome:
    case, pin = pair
    return settled(case, pin=pin, work=update if updating else judge)


def _killed(pair: tuple[Case | BrokenCase, Pin | None]) -> Outcome:
    case, _ = pair
    return Outcome(case.name, "error", KILLED, line=case.line)


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
