"""What is irregular about the stamps of a batch, and why time steps back."""

from __future__ import annotations

from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from quatprop.timeline.outliers import Rows

if TYPE_CHECKING:
    from quatprop.arrays import Bool, Int64


Batch = TypeVar("Batch", bound=Rows)

_FAR = 10
"""A counter that has wrapped around goes on after at most so many intervals."""

COUNTERS = {"ns": 2**32, "us": 2**32 * 1_000, "ms": 2**32 * 1_000_000}
"""After how many ns a counter of 32 bits begins again, by its unit."""


class Examined(NamedTuple, Generic[Batch]):
    """A batch, and what is irregular about its stamps.

    `batch`: the samples
    `rows`: which of the samples that were read they are, shape ``(N,)``
    `outliers`, `back`: Masks of outliers, and of stamps that are earlier than one before
    """

    batch: Batch
    rows: Int64
    outliers: Bool
    back: Bool


def cause_of_step(t_ns: Int64, first: int) -> str:
    """Return the likely cause of a step back in time, if the stamps show one.

    `t_ns`: Stamps, ns
    """
    if first < 2:  # noqa: PLR2004  # it and two before
        return ""
    before, middle, after = t_ns[first - 2 : first + 1].tolist()
    for unit, period in COUNTERS.items():
        if 0 < period - (middle - after) <= min(_FAR * (middle - before), period // 1000):
            return f" as if a counter of 32 bits in {unit} had wrapped around"
    return ""
