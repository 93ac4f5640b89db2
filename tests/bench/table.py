"""Timing, and the tables in which it is printed."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence


def best_of(
    repeats: int, work: Callable[[], object], clock: Callable[[], float] = time.perf_counter
) -> float:
    """Return the shortest of several runs, in seconds."""
    return min(_times(repeats, work, clock))


def median_of(repeats: int, work: Callable[[], object]) -> float:
    """Return the median of several runs, in seconds: writing waits for disks now and then."""
    return statistics.median(_times(repeats, work, time.perf_counter))


def _times(repeats: int, work: Callable[[], object], clock: Callable[[], float]) -> list[float]:
    seconds = []
    for _ in range(repeats):
        began = clock()
        work()
        seconds.append(clock() - began)
    return seconds


PYTHON, QUATPROP = [sys.executable, "-c"], [sys.executable, "-m", "quatprop"]

LAUNCH = """
import os, subprocess, sys, time
began = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
seconds, cpu = time.perf_counter() - began, usage.ru_utime + usage.ru_stime
print(seconds, cpu, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
"""Runs a command; a process of its own, since a command inherits the peak of who starts it."""


def command(repeats: int, words: Sequence[object], *, is_cpu: bool = False) -> tuple[float, float]:
    """Return seconds and peak MB of the shortest run; a command that compares may end with 1.

    `is_cpu`: whether the seconds are CPU time of all threads
    """
    launch = [sys.executable, "-S", "-c", LAUNCH, *map(str, words)]
    runs = []
    for _ in range(repeats):
        told = subprocess.run(launch, check=True, capture_output=True, text=True).stdout.split()
        if told[3] not in {"0", "1"}:
            raise subprocess.CalledProcessError(int(told[3]), launch[4:])
        runs.append((float(told[is_cpu]), float(told[2]) / 1024))
    return min(runs)


class Table:
    """Rows of ns a sample, each with its ratio to the first row."""

    def __init__(self, title: str) -> None:
        print(f"\n{title}\n{'':44s} {'ns/sample':>10s} {'x first':>11s} {'peak MB':>9s}")
        self.reference = 0.0

    def row(self, name: str, seconds: float, samples: int, megabytes: float | None = None) -> None:
        """Print one row; the first is what the others are compared with."""
        ns = seconds / samples * 1e9
        self.reference = self.reference or ns
        memory = "" if megabytes is None else f"{megabytes:.0f}"
        print(f"  {name:42s} {ns:10.1f} {ns / self.reference:10.2f}x {memory:>9s}", flush=True)


def compared(title: str, rows: dict[str, list[object]], samples: int, repeats: int, **how) -> None:
    """Print a table of commands on a log of so many samples."""
    table = Table(title)
    for name, words in rows.items():
        seconds, megabytes = command(1 if "script" in name else repeats, words, **how)
        table.row(name, seconds, samples, megabytes)
