"""Log times of attitudes that are added to a log: those of the messages they come from.

Stamps and log times need not be of one clock: some devices count from when they were switched on.
Players and plots sort by log time, so attitudes logged at their stamps could be fifty years away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Int64 = NDArray[np.int64]


class LogTimes:
    """Finds log times by stamps, both in order, and keeps no more than it needs.

    Parameters
    ----------
    pairs
        Stamps and log times, shapes ``(N,)``, int64 ns, batch after batch in order of log times.
        Stamps that step back are ignored.

    Examples
    --------
    >>> times = LogTimes(iter([(np.array([10, 20]), np.array([1005, 1017]))]))
    >>> times.at(np.array([10, 14, 20, 30]))
    array([1005, 1009, 1017, 1027])
    """

    def __init__(self, pairs: Iterator[tuple[Int64, Int64]]) -> None:
        self._pairs = pairs
        self._stamps = np.empty(0, np.int64)
        self._logged = np.empty(0, np.int64)
        self._latest = np.iinfo(np.int64).min
        self._ended = False

    def at(self, t_ns: Int64) -> Int64:
        """Return when attitudes are logged, shape ``(N,)``, int64 ns.

        An attitude between messages is logged as long after the one before it as its stamp is
        after that one's, and never before the attitude ahead of it.

        Parameters
        ----------
        t_ns
            Their stamps, shape ``(N,)``, in order, none before those of earlier calls.
        """
        if not len(t_ns):
            return t_ns
        while not self._ended and not (len(self._stamps) and self._stamps[-1] > t_ns[-1]):
            self._fetch()
        if not len(self._stamps):
            return t_ns
        before = np.maximum(np.searchsorted(self._stamps, t_ns, "right") - 1, 0)
        log_ns: Int64 = self._logged[before] + (t_ns - self._stamps[before])
        log_ns = np.maximum(np.maximum.accumulate(log_ns), self._latest)
        self._latest = log_ns[-1]
        self._stamps, self._logged = self._stamps[before[-1] :], self._logged[before[-1] :]
        return log_ns

    def _fetch(self) -> None:
        """Read another batch, without stamps that are not later than all before them."""
        batch = next(self._pairs, None)
        if batch is None:
            self._ended = True
            return
        stamps, logged = batch
        last = self._stamps[-1:] if len(self._stamps) else stamps[:1] - 1
        latest = np.maximum.accumulate(np.concatenate([last, stamps]))[:-1]
        is_later = stamps > latest
        self._stamps = np.concatenate([self._stamps, stamps[is_later]])
        self._logged = np.concatenate([self._logged, logged[is_later]])
