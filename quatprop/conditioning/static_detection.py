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

AGREEMENT = 0.01
"""rad/s: mean rates that differ by more on an axis are not the same bias."""

LARGEST_BIAS = 0.2
"""rad/s: a steady rate above this is a rotation, not the bias of a gyroscope."""


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

    A window is quiet if its rates scatter at most :data:`REST_FACTOR` times as much as those of the
    quietest one. A body that turns steadily is quiet too: neighbouring windows are one period only
    where their means agree, and of periods that do not agree the slowest shows the bias.

    Parameters
    ----------
    windows
        Of a whole log, as :func:`windows_of` gives them.
    """
    windows = windows[windows["count"] > 1]
    if not len(windows):
        return None
    quiet = np.flatnonzero(_scatter(windows) <= REST_FACTOR * _scatter(windows).min())
    mean = _mean(windows)[quiet]
    apart = np.diff(windows["index"][quiet]) != 1
    apart |= np.abs(np.diff(mean, axis=0)).max(axis=1) > AGREEMENT
    periods = _merged(windows[quiet], np.append(0, np.flatnonzero(apart) + 1))
    mean = _mean(periods)
    slowest = mean[np.argmin((mean**2).sum(axis=1))]
    agrees = np.abs(mean - slowest).max(axis=1) <= AGREEMENT
    longest = int(np.argmax(np.where(agrees, periods["last_ns"] - periods["first_ns"], -1)))
    rest = periods[longest : longest + 1]
    return Rest(
        first_ns=int(rest["first_ns"][0]),
        last_ns=int(rest["last_ns"][0]),
        samples=int(rest["count"][0]),
        mean_rad_s=mean[longest],
        scatter_rad_s=float(_scatter(rest)[0]),
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


def _mean(windows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the mean rate of each window, ``(N, 3)``, rad/s."""
    mean: NDArray[np.float64] = windows["total"] / windows["count"][:, None]
    return mean


def _scatter(windows: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the RMS deviation from the mean in each window, rad/s."""
    variance = windows["squares"] / windows["count"] - (_mean(windows) ** 2).sum(axis=1)
    scatter: NDArray[np.float64] = np.sqrt(np.maximum(variance, 0.0))
    return scatter
