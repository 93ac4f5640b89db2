"""Static detection: the period of a log in which the sensor was at rest, from sums over windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from quatprop.series import GyroSeries

REST_WINDOW_NS = 1_000_000_000
"""Rest is looked for in windows of this length by default."""

AT_REST = 0.05
"""rad/s: rates that scatter more than this are not at rest."""

REST_FACTOR = 2.0
"""A window is at rest if its rates scatter at most this much more than the quietest window's."""


@dataclass(frozen=True, slots=True)
class Rest:
    """The period of a log in which the sensor was at rest.

    Parameters
    ----------
    first_ns, last_ns
        Its first and last stamps, ns.
    samples
        How many samples it holds.
    mean_rad_s
        The mean rate, shape ``(3,)``: the bias, if this is rest.
    scatter_rad_s
        Root mean square deviation of the rates from the mean, over all three axes.
    """

    first_ns: int
    last_ns: int
    samples: int
    mean_rad_s: NDArray[np.float64]
    scatter_rad_s: float


def longest_rest(windows: NDArray[np.void]) -> Rest | None:
    """Return the longest quiet period, or None where no window holds two finite samples.

    The quietest window is the one whose rates scatter least about their mean; the rest is the
    longest run of neighbouring windows that scatter at most :data:`REST_FACTOR` times as much.

    Parameters
    ----------
    windows
        Of a whole log, as :func:`windows_of` gives them.
    """
    windows = windows[windows["count"] > 1]
    if not len(windows):
        return None
    quiet = _scatter(windows) <= REST_FACTOR * _scatter(windows).min()
    start, stop = _longest_run(quiet, np.diff(windows["index"]) == 1)
    rest = windows[start:stop]
    whole = _merged(rest, np.zeros(1, dtype=np.intp))
    return Rest(
        first_ns=int(rest["first_ns"][0]),
        last_ns=int(rest["last_ns"][-1]),
        samples=int(whole["count"][0]),
        mean_rad_s=whole["total"][0] / whole["count"][0],
        scatter_rad_s=float(_scatter(whole)[0]),
    )


_WINDOW = np.dtype(
    [
        ("index", np.int64),
        ("first_ns", np.int64),
        ("last_ns", np.int64),
        ("count", np.float64),
        ("total", np.float64, 3),
        ("squares", np.float64),
    ]
)
"""Sums over the samples of one window: enough for their mean and their scatter."""


def windows_of(batches: Iterable[GyroSeries], window_ns: int) -> NDArray[np.void]:
    """Return the sums of every window, in the order of the log; only finite rates are counted."""
    parts = [np.zeros(0, dtype=_WINDOW)]
    origin = None
    for batch in batches:
        if not len(batch):
            continue
        origin = int(batch.t_ns[0]) if origin is None else origin
        finite: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(batch.rate), axis=1)
        rate = np.where(finite[:, None], batch.rate, 0.0)
        rows = np.zeros(len(batch), dtype=_WINDOW)
        rows["index"] = (batch.t_ns - origin) // window_ns
        rows["first_ns"] = rows["last_ns"] = batch.t_ns
        rows["count"] = finite
        rows["total"] = rate
        rows["squares"] = (rate**2).sum(axis=1)
        parts.append(_by_index(rows))
    return _by_index(np.concatenate(parts))


def _by_index(rows: NDArray[np.void]) -> NDArray[np.void]:
    """Add up neighbouring rows of the same window."""
    if not len(rows):
        return rows
    return _merged(rows, np.flatnonzero(np.diff(rows["index"], prepend=rows["index"][0] - 1)))


def _merged(rows: NDArray[np.void], starts: NDArray[np.intp]) -> NDArray[np.void]:
    """Add up the rows from each start to the next."""
    merged = rows[starts]
    merged["first_ns"] = np.minimum.reduceat(rows["first_ns"], starts)
    merged["last_ns"] = np.maximum.reduceat(rows["last_ns"], starts)
    for name in ("count", "total", "squares"):
        merged[name] = np.add.reduceat(rows[name], starts, axis=0)
    return merged


def _scatter(windows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the RMS deviation from the mean in each window, rad/s."""
    mean = windows["total"] / windows["count"][:, None]
    variance = windows["squares"] / windows["count"] - (mean**2).sum(axis=1)
    scatter: NDArray[np.float64] = np.sqrt(np.maximum(variance, 0.0))
    return scatter


def _longest_run(quiet: NDArray[np.bool_], adjacent: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the longest run of quiet windows without a hole between them."""
    joined = quiet[1:] & quiet[:-1] & adjacent
    starts = np.flatnonzero(quiet & ~np.append(False, joined))
    stops = np.flatnonzero(quiet & ~np.append(joined, False)) + 1
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest])
