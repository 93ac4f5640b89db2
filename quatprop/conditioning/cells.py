"""Sums over cells of equal time: enough for the mean and the scatter of a signal in each."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from quatprop.arrays import Bool, Float64, Int64, Intp

    Rows: TypeAlias = Iterable[tuple[Int64, Float64]]
    Cells: TypeAlias = NDArray[np.void]


def cells_of(rows: Rows, cell_ns: int, origin_ns: int | None = None, width: int = 3) -> Cells:
    """Return the sums of every cell, in the order of time; only finite rows are counted.

    `rows`: Stamps, ns, and values, shape ``(N, width)``
    `cell_ns`: the length of a cell, ns
    `origin_ns`: where the first cell begins, ns; None for the first stamp
    """
    kind = np.dtype(
        [(name, np.int64) for name in ("index", "first_ns", "last_ns")]
        + [("count", np.float64), ("total", np.float64, width), ("squares", np.float64)]
    )
    parts = [np.zeros(0, dtype=kind)]
    for t_ns, values in rows:
        if not len(t_ns):
            continue
        origin_ns = int(t_ns[0]) if origin_ns is None else origin_ns
        finite: Bool = np.logical_and.reduce(np.isfinite(values), axis=1)
        known = np.where(finite[:, None], values, 0.0)
        cells = np.zeros(len(t_ns), dtype=kind)
        cells["index"] = (t_ns - origin_ns) // cell_ns
        cells["first_ns"] = cells["last_ns"] = t_ns
        cells["count"] = finite
        cells["total"] = known
        with np.errstate(over="ignore"):
            cells["squares"] = (known**2).sum(axis=1)
        parts.append(_by_index(cells))
    cells = np.concatenate(parts)
    return _by_index(cells[np.argsort(cells["index"], kind="stable")])


def cells_beside(rates: Cells, rows: Rows, cell_ns: int, width: int = 3) -> Cells | None:
    """Return the cells of another signal at those of the rates; None where none is measured.

    Drivers of sensors without an accelerometer leave its fields empty, NaN or zero.
    """
    origin_ns = int(rates["first_ns"][np.searchsorted(rates["index"], 0)])
    cells = cells_of(rows, cell_ns, origin_ns, width)
    aligned = np.zeros(len(rates), dtype=cells.dtype)
    _, ours, theirs = np.intersect1d(rates["index"], cells["index"], return_indices=True)
    aligned[ours] = cells[theirs]
    return aligned if aligned["squares"].any() else None


def outer_products(rows: Rows) -> Rows:
    """Yield q q^T instead of quaternions, ``(N, 16)``: the same for q and -q."""
    for t_ns, wxyz in rows:
        yield t_ns, np.einsum("ij,ik->ijk", wxyz, wxyz).reshape(-1, 16)


def _by_index(rows: Cells) -> Cells:
    """Add up neighbouring rows of the same cell."""
    if not len(rows):
        return rows
    return merged(rows, np.flatnonzero(np.diff(rows["index"], prepend=rows["index"][0] - 1)))


def merged(rows: Cells, starts: Intp) -> Cells:
    """Add up the rows from each start to the next."""
    merged = rows[starts]
    merged["first_ns"] = np.minimum.reduceat(rows["first_ns"], starts)
    merged["last_ns"] = np.maximum.reduceat(rows["last_ns"], starts)
    for name in ("count", "total", "squares"):
        merged[name] = np.add.reduceat(rows[name], starts, axis=0)
    return merged


def mean_of(cells: Cells) -> Float64:
    """Return the mean of each cell, ``(N, width)``; NaN where it is empty."""
    with np.errstate(invalid="ignore"):
        return np.asarray(cells["total"] / cells["count"][:, None])


def scatter_of(cells: Cells) -> Float64:
    """Return the RMS deviation from the mean in each cell; NaN where it is empty."""
    with np.errstate(invalid="ignore"):
        variance = cells["squares"] / cells["count"] - (mean_of(cells) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
