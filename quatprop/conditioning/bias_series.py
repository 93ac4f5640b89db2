"""A bias that changes with time, as an estimator or a reference gives it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64, Int64


@dataclass(frozen=True, slots=True)
class BiasSeriesReport:
    """Where a bias that changes with time was taken from.

    Parameters
    ----------
    source
        The file, or the topic of the log.
    field
        The message field or the columns.
    values
        How many biases there are.
    first_ns, last_ns
        Their first and last stamps, ns.
    outside
        Samples before the first and after the last, so far: they take the nearest.
    """

    source: str
    field: str
    values: int
    first_ns: int
    last_ns: int
    outside: list[int] = dataclasses.field(default_factory=lambda: [0, 0])

    def remarks(self) -> Iterator[str]:
        """Yield a remark where samples are outside the biases."""
        before, after = self.outside
        if before or after:
            yield (
                f"{before} samples before the first bias of {plain(self.source)} at "
                f"{self.first_ns} ns and {after} after the last at {self.last_ns} ns take the "
                "nearest; are both on the same clock?"
            )


class BiasSeries:
    """Biases at given times, interpolated linearly in between.

    Parameters
    ----------
    source, name
        For the report: the file or the topic, and the field or the columns.
    t_ns
        Stamps in any order, shape ``(N,)``, at least one, int64 ns.
    bias_rad_s
        Biases in the axes of the raw rates, shape ``(N, 3)``, rad/s.
    """

    def __init__(self, source: str, name: str, t_ns: Int64, bias_rad_s: Float64) -> None:
        order = np.argsort(t_ns, kind="stable")
        self._t_ns, self._bias = t_ns[order], bias_rad_s[order]
        first_ns, last_ns = int(self._t_ns[0]), int(self._t_ns[-1])
        self.report = BiasSeriesReport(source, name, len(t_ns), first_ns, last_ns)

    def at(self, t_ns: Int64) -> Float64:
        """Return the biases at some stamps, ``(M, 3)``, rad/s; outside the series the nearest."""
        self.report.outside[0] += int(np.count_nonzero(t_ns < self._t_ns[0]))
        self.report.outside[1] += int(np.count_nonzero(t_ns > self._t_ns[-1]))
        # Differences of whole nanoseconds are exact as floats over 104 days.
        wanted, known = (each - self._t_ns[0] for each in (t_ns, self._t_ns))
        return np.stack([np.interp(wanted, known, axis) for axis in self._bias.T], axis=1)
