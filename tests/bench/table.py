"""Timing, and the tables in which it is printed or written as Markdown."""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple


def best_of(repeats: int, work: Callable[[], object]) -> float:
    """Return the shortest of several runs, in seconds."""
    shortest = float("inf")
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        shortest = min(shortest, time.perf_counter() - began)
    return shortest


def median_of(repeats: int, work: Callable[[], object]) -> float:
    """Return the median of several runs, in seconds: writing waits for disks now and then."""
    return statistics.median(best_of(1, work) for _ in range(repeats))


class Ran(NamedTuple):
    """How long a command took, and how much memory it had at most."""

    seconds: float
    megabytes: float


LAUNCH = """
import os, subprocess, sys, time
began = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(time.perf_counter() - began, usage.ru_maxrss, os.waitstatus_to_exitcode(status))
"""
"""Runs a command; a process of its own, since a command inherits the peak of who starts it."""


def command(repeats: int, words: Sequence[object]) -> Ran:
    """Return the shortest of several runs of a command; one that compares may end with 1."""
    launch = [sys.executable, "-S", "-c", LAUNCH, *map(str, words)]
    runs = []
    for _ in range(repeats):
        told = subprocess.run(launch, check=True, capture_output=True, text=True).stdout.split()
        if told[2] not in {"0", "1"}:
            raise subprocess.CalledProcessError(int(told[2]), launch[4:])
        runs.append(Ran(float(told[0]), float(told[1]) / 1024))
    return min(runs)


MARKDOWN: list[str] = []
"""All tables so far, as Markdown."""


class Table:
    """Rows of ns a sample, each with its ratio to the first row.

    Parameters
    ----------
    title
        Printed above.
    """

    def __init__(self, title: str) -> None:
        print(f"\n{title}\n{'':44s} {'ns/sample':>10s} {'x first':>11s} {'peak MB':>9s}")
        MARKDOWN.extend(["", f"| {title} | ns a sample | times the first | peak MB |"])
        MARKDOWN.append("|---|---:|---:|---:|")
        self.reference = 0.0

    def row(self, name: str, seconds: float, samples: int, megabytes: float | None = None) -> None:
        """Print one row; the first is what the others are compared with."""
        ns = seconds / samples * 1e9
        self.reference = self.reference or ns
        memory = "" if megabytes is None else f"{megabytes:.0f}"
        ratio = ns / self.reference
        print(f"  {name:42s} {ns:10.1f} {ratio:10.2f}x {memory:>9s}", flush=True)
        MARKDOWN.append(f"| {name} | {ns:.1f} | {ratio:.2f} | {memory} |")

    def ran(self, name: str, ran: Ran, samples: int) -> None:
        """Print the row of a command."""
        self.row(name, ran.seconds, samples, ran.megabytes)


def write_markdown(path: Path) -> None:
    """Write all tables so far."""
    path.write_text("\n".join(MARKDOWN[1:]) + "\n")
