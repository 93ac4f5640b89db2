"""Timing and the table it is printed in."""

import statistics
import time
from collections.abc import Callable


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


class Table:
    """Rows of ns a sample, each with its ratio to the first row.

    Parameters
    ----------
    title
        Printed above.
    """

    def __init__(self, title: str) -> None:
        print(f"\n{title}\n{'':44s} {'ns/sample':>10s} {'x quatprop':>11s}")
        self.reference = 0.0

    def row(self, name: str, seconds: float, samples: int) -> None:
        """Print one row; the first is what the others are compared with."""
        ns = seconds / samples * 1e9
        self.reference = self.reference or ns
        print(f"  {name:42s} {ns:10.1f} {ns / self.reference:10.2f}x", flush=True)
