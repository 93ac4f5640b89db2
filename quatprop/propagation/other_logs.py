"""The attitude of a series at one time, interpolated."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from quatprop.errors import (
    LogError,
    NoAttitudesError,
    NoSamplesError,
    NoSuchTopicError,
    NotRotationsError,
    TimelineError,
    UsageError,
)
from quatprop.kinematics.quaternion import normalize, slerp
from quatprop.logs.attitude_input import errors_of
from quatprop.logs.beside_rates import own_orientation
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.quaternion_check import QuaternionCheck
from quatprop.settings.selection import AttitudeSelection, RateSelection, SignalSelection
from quatprop.stores.log_names import split_topic
from quatprop.text import Setting, plain, quoted
from quatprop.times import NS_PER_UNIT, duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.arrays import Float64
    from quatprop.logs.signals.signal import RateSignal
    from quatprop.series import AttitudeSeries
    from quatprop.tables.log import Log

    Row = tuple[int, Float64]

MAX_INTERPOLATION_NS = 10 * NS_PER_UNIT["s"]
"""Maximum interval that is interpolated, ns."""


def attitude_at(
    source: Path | str,
    t_ns: int,
    log: Log | None = None,
    selection: SignalSelection | None = None,
) -> Float64:
    """Return the attitude of a series at a time.

    `t_ns`: the time, ns
    `log`: an open log that can be read again; None for rates in memory
    `selection`: how its rates were selected
    `Returns`: wxyz, Hamilton, body -> reference, shape ``(4,)``. At a timestamp of the series the
        stored quaternion, else a unit quaternion on the shortest arc between its neighbours
    """
    path, topic = split_topic(str(source))
    wanted, clock = AttitudeSelection(topic=topic), None if selection is None else selection.clock
    is_file = Path(path).exists()
    if not is_file:
        topic = str(source)
        if log is None or not log.tables(topic):
            raise UsageError(
                f"{Setting('q0')} {plain(topic)} is neither four numbers W,X,Y,Z nor level or log, "
                "no such file is there, and the log has no such topic"
            )
        wanted = AttitudeSelection(topic=topic, clock=clock)
    with errors_of("q0"), ExitStack() as stack:
        if is_file or log is None:
            log = stack.enter_context(open_log(path))
        # Invalid rows elsewhere in the series do not matter.
        check = QuaternionCheck(log.path, drop=True)
        signal = choose_attitudes(log, wanted)
        try:
            return attitude_in(check.apply(signal.rows()), t_ns, log.path)
        except NoSamplesError:
            if not check.counts.read:
                raise NoSamplesError(log.path, signal.name) from None
            raise NotRotationsError(
                log.path, f"{quoted(signal.name)} has no orientation: {check.counts.summary}"
            ) from None


def first_orientation(log: Log, source: RateSignal, selection: RateSelection, t_ns: int) -> Float64:
    """Return the orientation recorded in a log at the start of its propagation.

    `Returns`: wxyz, Hamilton, body -> reference, as stored, shape ``(4,)``
    """
    try:
        with errors_of("q0"):
            signal = own_orientation(log, source, selection)
        signal.refuse_placeholder(log.path, f"give another {Setting('q0')}")
        batches = QuaternionCheck(log.path, drop=True).apply(signal.rows())
        return attitude_in(batches, t_ns, log.path)
    except NoSamplesError:
        absent = f"the orientation of {quoted(source.name)} is absent or invalid throughout"
    except (NoAttitudesError, NoSuchTopicError):
        absent = f"there is no orientation beside the rates of {quoted(source.name)}"
    raise LogError(log.path, f"{absent}; give another {Setting('q0')}, such as a file of attitudes")


def attitude_in(batches: Iterable[AttitudeSeries], t_ns: int, path: Path | str) -> Float64:
    """Return the attitude of a series at a time; see :func:`attitude_at`.

    `t_ns`: the time, ns
    """
    before: Row | None = None
    after: Row | None = None
    for series in batches:
        stamps = series.t_ns
        earlier, later = stamps <= t_ns, stamps >= t_ns
        if earlier.any():
            row = int(np.argmax(np.where(earlier, stamps, np.iinfo(np.int64).min)))
            if before is None or stamps[row] > before[0]:
                before = int(stamps[row]), series.wxyz[row]
            if before[0] == t_ns:
                return before[1]
        if later.any():
            row = int(np.argmin(np.where(later, stamps, np.iinfo(np.int64).max)))
            if after is None or stamps[row] < after[0]:
                after = int(stamps[row]), series.wxyz[row]
    if before is None and after is None:
        raise NoSamplesError(path, "its attitudes")
    if before is None or after is None:
        if before is None:
            stamp, word, side, way_out = cast("Row", after)[0], "first", "after", ""
            if stamp - t_ns < 24 * NS_PER_UNIT["h"]:  # the log may reach so far
                way_out = f" If so, begin there with {Setting('start', str(stamp))}"
        else:
            stamp, word, side, way_out = before[0], "last", "before", ""
        raise TimelineError(
            path,
            f"its {word} attitude is {duration_text(abs(stamp - t_ns))} {side} the first sample "
            f"that is used ({stamp} and {t_ns} ns); are both on the same clock?{way_out}",
        )
    if after[0] - before[0] > MAX_INTERPOLATION_NS:
        raise TimelineError(
            path,
            f"{t_ns} ns is in a gap of {duration_text(after[0] - before[0])} between its "
            f"attitudes; interpolation reaches over at most {duration_text(MAX_INTERPOLATION_NS)}",
        )
    fraction = (t_ns - before[0]) / (after[0] - before[0])
    return slerp(normalize(before[1]), normalize(after[1]), fraction)
