"""Attitudes of a body relative to another one, such as the angle of a joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import TimelineError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.rendering import count_text
from quatprop.settings.selection import AttitudeSelection
from quatprop.stores.log_names import split_topic
from quatprop.text import Remark, plain
from quatprop.timeline.stamps import GAP_FACTOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.series import AttitudeSeries


class RelativeTo:
    """Makes attitudes relative to those of another body, which are held in memory."""

    def __init__(self, source: str) -> None:
        path, topic = split_topic(source)
        wanted = AttitudeInput(path, selection=AttitudeSelection(topic=topic), side="relative_to")
        loaded = load_attitudes(wanted)
        self._source, self._other = source, loaded.series
        self.losses, steps = loaded.losses, np.diff(self._other.t_ns)
        if (steps <= 0).any():
            raise TimelineError(path, "its timestamps do not increase; write them in order")
        # Whether the interval before each attitude is no gap; False for the first attitude.
        gap_ns = GAP_FACTOR * np.median(steps) if len(steps) else 0
        self._near = np.insert(steps <= gap_ns, 0, values=False)
        self._omitted = 0

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield q_other* q at times between attitudes of the other series."""
        t_ns, used = self._other.t_ns, 0
        for series in batches:
            after = np.searchsorted(t_ns, series.t_ns).clip(0, len(t_ns) - 1)
            is_known = (t_ns[after] == series.t_ns) | (self._near[after] & (series.t_ns < t_ns[-1]))
            used += (count := int(np.count_nonzero(is_known)))
            self._omitted += len(series) - count
            yield series[is_known].relative_to(self._other)
        if self._omitted and not used:
            reason = "it has no attitudes at these times; are both on the same clock?"
            raise TimelineError(self._source, reason)

    def remarks(self) -> Iterator[Remark]:
        """Yield a remark on the omitted rows, if there are any."""
        if self._omitted:
            where = "before, after or in a gap of the attitudes of"
            text = f"omitted {count_text(self._omitted, 'row')} {where} {plain(self._source)}"
            yield Remark("not-covered", text)
