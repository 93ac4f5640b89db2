"""Attitudes of a body in the axes of another one, such as the angle of a joint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.errors import TimelineError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.rendering import count_text
from quatprop.settings.selection import AttitudeSelection
from quatprop.stores.log_names import split_topic
from quatprop.text import Remark, Setting, plain
from quatprop.timeline.stamps import GAP_FACTOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.series import AttitudeSeries


class RelativeTo:
    """Turns attitudes of one body into those relative to another, which it holds in memory."""

    def __init__(self, source: str) -> None:
        path, topic = split_topic(source)
        wanted = AttitudeInput(path, selection=AttitudeSelection(topic=topic), side="relative_to")
        loaded = load_attitudes(wanted)
        self._source, self._other = source, loaded.series
        self.losses = loaded.losses
        self._steps = np.diff(self._other.t_ns)
        if (self._steps <= 0).any():
            raise TimelineError(
                path,
                "the timestamps of its attitudes do not rise, so none can be found between them; "
                f"give {Setting('relative_to')} a series in order",
            )
        self._gap_ns = GAP_FACTOR * int(np.median(self._steps)) if len(self._steps) else 0
        self._left_out = 0

    def applied(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield q_other* q where the other series has attitudes on both sides."""
        t_ns, kept = self._other.t_ns, 0
        for series in batches:
            after = np.searchsorted(t_ns, series.t_ns).clip(0, len(t_ns) - 1)
            near = np.insert(self._steps <= self._gap_ns, 0, values=False)[after]
            is_known = (t_ns[after] == series.t_ns) | (near & (series.t_ns < t_ns[-1]))
            self._left_out += int(np.count_nonzero(~is_known))
            if is_known.any():
                kept += 1
                yield series[is_known].relative_to(self._other)
        if self._left_out and not kept:
            raise TimelineError(
                self._source,
                "it has no attitudes at the times of those that are to be relative to it; are both "
                "on the same clock?",
            )

    def remarks(self) -> Iterator[Remark]:
        """Yield what was left out, if anything."""
        if self._left_out:
            yield Remark(
                "not-covered",
                f"{count_text(self._left_out, 'row')} left out, at times at which "
                f"{plain(self._source)} has no attitude: before, after or in a gap of it",
            )
