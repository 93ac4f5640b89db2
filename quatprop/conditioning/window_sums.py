"""Sums of a signal over windows of equal duration, for its mean and scatter."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from quatprop.series.blocks import BLOCK

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from quatprop.arrays import Bool, Float64, Int64, Intp

    Rows: TypeAlias = Iterable[tuple[Int64, Float64]]
    WindowSums: TypeAlias = NDArray[np.void]


def window_sums(
    rows: Rows, window_ns: int, origin_ns: int | None = None, width: int = 3
) -> WindowSums:
    """Return the sums of every window, in order of time, over finite rows.

    The result does not depend on how rows are divided into batches, to the last bit.

    `rows`: timestamps, ns, and values, shape ``(N, width)``
    `window_ns`: length of a window, ns
    `origin_ns`: start of the first window, ns; None: the first timestamp
    """
    kind = np.dtype(
        [(name, np.int64) for name in ("index", "first_ns", "last_ns")]
        + [("count", np.float64), ("total", np.float64, width), ("squares", np.float64, width)]
    )
    parts = [np.zeros(0, dtype=kind)]
    for t_ns, values in _in_blocks(rows):
        origin_ns = int(t_ns[0]) if origin_ns is None else origin_ns
        finite: Bool = np.logical_and.reduce(np.isfinite(values), axis=1)
        known = np.where(finite[:, None], values, 0.0)
        index = (t_ns - origin_ns) // window_ns
        starts = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        sums = np.zeros(len(starts), dtype=kind)
        sums["index"] = index[starts]
        sums["first_ns"] = np.minimum.reduceat(t_ns, starts)
        sums["last_ns"] = np.maximum.reduceat(t_ns, starts)
        sums["count"] = np.add.reduceat(finite, starts, dtype=np.float64)
        sums["total"] = np.add.reduceat(known, starts, axis=0)
        with np.errstate(over="ignore"):
            sums["squares"] = np.add.reduceat(known**2, starts, axis=0)
        parts.append(sums)
    sums = np.concatenate(parts)
    return _by_index(sums[np.argsort(sums["index"], kind="stable")])


def _in_blocks(rows: Rows) -> Rows:
    """Yield rows in blocks of fixed size, independent of their batches."""
    held: list[tuple[Int64, Float64]] = []
    room = BLOCK
    for t_ns, values in rows:
        start = 0
        while len(t_ns) - start >= room:
            held.append((t_ns[start : start + room], values[start : start + room]))
            yield _joined(held)
            start, room, held = start + room, BLOCK, []
        if start < len(t_ns):
            held.append((t_ns[start:], values[start:]))
            room -= len(t_ns) - start
    if held:
        yield _joined(held)


def _joined(rows: list[tuple[Int64, Float64]]) -> tuple[Int64, Float64]:
    if len(rows) == 1:
        return rows[0]
    return np.concatenate([t_ns for t_ns, _ in rows]), np.concatenate([each for _, each in rows])


def aligned_window_sums(
    rates: WindowSums, rows: Rows, window_ns: int, width: int = 3
) -> WindowSums | None:
    """Return the sums of another signal in the windows of the rates; None if it is absent.

    Without an accelerometer, drivers leave its fields empty, NaN or zero.
    """
    origin_ns = int(rates["first_ns"][np.searchsorted(rates["index"], 0)])
    sums = window_sums(rows, window_ns, origin_ns, width)
    aligned = np.zeros(len(rates), dtype=sums.dtype)
    _, ours, theirs = np.intersect1d(rates["index"], sums["index"], return_indices=True)
    aligned[ours] = sums[theirs]
    return aligned if aligned["squares"].any() else None


def between(rows: Rows, first_ns: int, last_ns: int) -> Rows:
    """Yield the rows in a time range, ends included."""
    for t_ns, values in rows:
        inside = (t_ns >= first_ns) & (t_ns <= last_ns)
        yield t_ns[inside], values[inside]


def outer_products(rows: Rows) -> Rows:
    """Yield q q^T, ``(N, 16)``, for quaternions: equal for q and -q."""
    for t_ns, wxyz in rows:
        yield t_ns, np.einsum("ij,ik->ijk", wxyz, wxyz).reshape(-1, 16)


def _by_index(rows: WindowSums) -> WindowSums:
    """Sum neighbouring rows of the same window."""
    if not len(rows):
        return rows
    return merged(rows, np.flatnonzero(np.diff(rows["index"], prepend=rows["index"][0] - 1)))


def merged(rows: WindowSums, starts: Intp) -> WindowSums:
    """Sum the rows from each start to the next."""
    merged = rows[starts]
    merged["first_ns"] = np.minimum.reduceat(rows["first_ns"], starts)
    merged["last_ns"] = np.maximum.reduceat(rows["last_ns"], starts)
    for name in ("count", "total", "squares"):
        merged[name] = np.add.reduceat(rows[name], starts, axis=0)
    return merged


def mean_of(sums: WindowSums) -> Float64:
    """Return the mean of each window, ``(N, width)``; NaN if empty."""
    with np.errstate(invalid="ignore"):
        return np.asarray(sums["total"] / sums["count"][:, None])


def variances_of(sums: WindowSums) -> Float64:
    """Return the variance of each column in each window, ``(N, width)``; NaN where it is empty."""
    with np.errstate(over="ignore", invalid="ignore"):
        variances = sums["squares"] / sums["count"][:, None] - mean_of(sums) ** 2
    variances[np.isinf(sums["squares"])] = np.inf
    return np.asarray(np.maximum(variances, 0.0))


def scatter_of(sums: WindowSums) -> Float64:
    """Return the RMS deviation from the mean in each window; NaN if empty."""
    return np.asarray(np.sqrt(variances_of(sums).sum(axis=1)))
