"""Sums over the samples so far, with bits that do not depend on batches."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from quatprop.arrays import Float64


TILE: Final = 8192
"""Samples that are summed together, from fixed sample indices: few enough for the caches."""


class PrefixSums(dict[str, "Float64"]):
    """Sums up to the last sample so far, by name, each of several rows."""

    def after(self, name: str, steps: Float64) -> Float64:
        """Return a sum after each of its next terms, ``(rows, n)``; n is at most a tile."""
        count = steps.shape[1]
        sums = steps
        if count < TILE:
            # A partly filled tile is summed by the same tree.
            sums = np.zeros((len(steps), TILE))
            sums[:, :count] = steps
        sums[:, 0] += self.last(name, len(steps))
        # Even and odd terms are summed as complex numbers, faster than one by one.
        pairs = np.cumsum(sums.view(np.complex128), axis=1).view(np.float64)
        np.add(pairs[:, 1:], pairs[:, :-1], out=sums[:, 1:])
        self[name] = sums[:, count - 1].copy()
        return sums[:, :count]

    def last(self, name: str, rows: int) -> Float64:
        """Return a sum up to the last sample so far, ``(rows,)``."""
        return self.get(name, np.zeros(rows))


def with_previous(values: Float64, last: Float64) -> Float64:
    """Return each sample, ``(rows, n)``, plus the previous one; `last` precedes the first."""
    sums = np.empty(values.shape)
    np.add(values[:, 1:], values[:, :-1], out=sums[:, 1:])
    np.add(values[:, :1], last, out=sums[:, :1])
    return sums
