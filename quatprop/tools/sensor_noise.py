"""The noise of one log: find where the sensor is at rest, and fit the Allan variance there.

Samples are taken as equally spaced, by their mean interval: timestamps jitter more than sensors.
Gaps and the ends of rests divide them into pieces, which the variances are means over.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from quatprop.conditioning import GyroCorrection, GyroCorrectionInputs, condition
from quatprop.conditioning.rests import find_rests
from quatprop.conditioning.static_detection import AGREEMENT, NoRestError
from quatprop.conditioning.time_range import EndsFinder, clipping_remarks
from quatprop.errors import UsageError
from quatprop.logs.beside_rates import conditioning_inputs
from quatprop.logs.joined import JoinedLog, open_logs
from quatprop.logs.open_log import is_stream
from quatprop.logs.signals.rates import choose_rates
from quatprop.rendering import source_text
from quatprop.sensor_noise.allan import AllanSums
from quatprop.sensor_noise.covariance import covariances
from quatprop.sensor_noise.fit import chi_square, fit
from quatprop.sensor_noise.result import Noise, terms_of
from quatprop.settings.selection import RateSelection
from quatprop.settings.static_bias import StaticBias
from quatprop.stores.objects import without_secret
from quatprop.tables.base import TableLog
from quatprop.text import Remark, plain
from quatprop.timeline import Timeline
from quatprop.timeline.counts import Policy
from quatprop.timeline.counts import remarks as timeline_remarks
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.arrays import Float64
    from quatprop.conditioning.static_period import StaticPeriod
    from quatprop.logs.signals.signal import RateSignal
    from quatprop.sensor_noise.fit import TermFit
    from quatprop.series import GyroSeries
    from quatprop.tables.log import Log
    from quatprop.timeline.counts import Counts

REST: Final = StaticBias(between="nearest")
"""All stationary periods are used, found in windows of the default length."""

FEWEST: Final = 3
"""Minimum number of averaging times."""

IRREGULAR: Final = 0.05
"""Intervals are irregular if their mean differs from the median by more than this share."""

COPIED: Final = 0.4
"""Share of repeated timestamps from which several files are copies: half of two are."""

HIDDEN: Final = 0.03
"""Error of a mean, as a share of the step of the rates, if their noise is a third of a step."""

OF_ATTITUDE: Final = {"gaps", "jitter", "repeated-stamps"}
"""Codes of remarks that concern attitudes only."""


def measure_logs(paths: Sequence[str], values: Mapping[str, Any]) -> Noise:
    """Return the noise of a log, in one file or several, by parsed settings."""
    if any(map(is_stream, paths)):
        raise UsageError("stdin and pipes can be read only once, and noise reads a log twice")
    selection = RateSelection.of(values)
    with open_logs(paths, values.get("kind"), msg_path=selection.msg_path) as log:
        return measure(" + ".join(paths), choose_rates(log, selection), values, log)


def measure(path: str, source: RateSignal, values: Mapping[str, Any], log: Log | None) -> Noise:
    """Return the noise of rates at rest.

    `log`: the open log, which is read twice; None for rates in memory
    """
    at_rest = _sums_at_rest(path, source, values, log)
    counts, sums, ends = at_rest.counts, at_rest.sums, at_rest.ends
    samples, pieces = sum(sums.lengths), len(sums.lengths)
    m, variances = sums.variances()
    if len(m) < FEWEST or not at_rest.span_ns:
        raise UsageError(
            f"{plain(path)}: {samples} samples at rest are too few to measure noise; record the "
            "sensor at rest for a minute or longer"
        )
    if isinstance(log, JoinedLog) and counts.duplicates.count > COPIED * counts.used:
        raise UsageError(
            f"{plain(path)}: {counts.duplicates.count} of {counts.used} timestamps are repeated: "
            "the files are copies of one recording; name one of them"
        )
    first_ns, last_ns = counts.first_ns or 0, counts.last_ns or 0
    used = tuple(end for end in ends if end[1] >= first_ns and end[0] <= last_ns)
    interval_s = at_rest.span_ns / (samples - pieces) / NS_PER_S
    tau_s = np.asarray(m * interval_s)
    found = covariances(m, sums.lengths)
    fits = [fit(axis, found) if axis.all() else None for axis in variances.T]
    remarks = (
        *source.remarks,
        *at_rest.remarks,
        *_remarks(counts, interval_s, at_rest.rests, pieces - len(used)),
        *_fit_remarks(fits, tau_s),
        *(() if log is None else log.remarks),
    )
    unknown = np.full(len(m), np.nan)
    freedoms = np.stack([unknown if one is None else one.freedoms for one in fits], axis=1)
    deviation = np.sqrt(variances)
    return Noise(
        source=f"{without_secret(path)}: {source_text(source.name, source.type_name)}",
        topic=source.name if source.name.startswith("/") else "",
        samples=samples,
        rests=used,
        pieces=pieces,
        interval_s=interval_s,
        tau_s=tau_s,
        deviation=deviation,
        low=deviation * np.sqrt(freedoms / chi_square(freedoms, 1.0)),
        high=deviation * np.sqrt(freedoms / chi_square(freedoms, -1.0)),
        axes=tuple(terms_of([one], interval_s, tau_s) for one in fits),
        combined=terms_of(fits, interval_s, tau_s),
        dropped=counts.dropped,
        remarks=tuple(one for one in remarks if getattr(one, "code", "") not in OF_ATTITUDE),
        losses=() if log is None else tuple(log.losses),
    )


class SumsAtRest(NamedTuple):
    """Sums over the samples at rest.

    `ends`: first and last timestamp of each stationary period, ns
    `span_ns`: total duration of the pieces, ns
    `remarks`: on the timestamps and the part of the log
    """

    rests: Sequence[StaticPeriod]
    ends: list[tuple[int, int]]
    sums: AllanSums
    span_ns: int
    counts: Counts
    remarks: tuple[Remark, ...]


def _sums_at_rest(
    path: str, source: RateSignal, values: Mapping[str, Any], log: Log | None
) -> SumsAtRest:
    """Find the stationary periods of a log, and read it again for their sums."""
    names = ("on_backwards", "on_nonfinite") & values.keys()
    policy = Policy(
        on_gap="split", max_gap_ns=values.get("max_gap"), **{name: values[name] for name in names}
    )
    part = GyroCorrection(start=values.get("start"), end=values.get("end"))
    chosen_by = "time_col" if isinstance(log, TableLog) else "clock"
    timeline = Timeline(policy, path, chosen_by)
    is_sorted = policy.on_backwards == "sort"
    try:
        rests = find_rests(
            lambda note: timeline.looked_ahead(source.batches(), note),
            EndsFinder(earliest=is_sorted),
            REST,
            conditioning_inputs(log, source, RateSelection.of(values), part),
            "body",
        )
    except NoRestError as error:
        raise UsageError(
            f"{plain(path)}: {error.text}, and noise is measured at rest; record the sensor while "
            "it lies still"
        ) from None
    batches, done = condition(
        source.batches,
        timeline,
        part,
        1.0,
        GyroCorrectionInputs(),
        # Sorted, samples may belong to the range wherever they are in the log.
        part_reader=None if is_sorted else source.part_reader,
    )
    ends, sums = _joined(rests), AllanSums()
    segments = timeline.segments(timeline.measured(batches))
    span_ns = sum(_add(segment, ends, sums) for segment in segments)
    remarks = *timeline_remarks(timeline.counts, policy, chosen_by), *clipping_remarks(part, done)
    return SumsAtRest(rests, ends, sums, span_ns, timeline.counts, remarks)


def _joined(rests: Sequence[StaticPeriod]) -> list[tuple[int, int]]:
    """Return the first and last timestamp of each rest, ns; parts of slow drifts are joined."""
    ends = [(rest.first_ns, rest.last_ns) for rest in rests[:1]]
    for before, rest in pairwise(rests):
        apart = np.abs(rest.mean_rad_s - before.mean_rad_s).max()
        if rest.first_ns - before.last_ns <= REST.window_ns // 2 and apart <= 2 * AGREEMENT:
            ends[-1] = ends[-1][0], rest.last_ns
        else:
            ends.append((rest.first_ns, rest.last_ns))
    return ends


def _add(segment: Iterator[GyroSeries], ends: list[tuple[int, int]], sums: AllanSums) -> int:
    """Add the samples at rest of a segment without gaps; return their duration, ns."""
    at, first_ns, last_ns, total = -1, 0, 0, 0
    for block in segment:
        for number, (begin_ns, end_ns) in enumerate(ends):
            start, stop = np.searchsorted(block.t_ns, [begin_ns, end_ns + 1])
            if start == stop:
                continue
            if number != at:
                sums.begin_piece()
                total += last_ns - first_ns
                at, first_ns = number, int(block.t_ns[start])
            last_ns = int(block.t_ns[stop - 1])
            sums.add(block.rate[start:stop])
    return total + last_ns - first_ns


def _remarks(
    counts: Counts, interval_s: float, rests: Sequence[StaticPeriod], gaps: int
) -> Iterator[Remark]:
    """Yield what a reader should know of the samples.

    `gaps`: how many there are in rests
    """
    median_s = (counts.median_dt_ns or 0) / NS_PER_S
    if gaps:
        limit = duration_text(counts.gap_limit_ns or 0)
        yield Remark(
            "noise-gaps",
            f"gaps at rest, longer than {limit}: {gaps}; no difference is taken across one",
        )
    if counts.duplicates.count or abs(interval_s / median_s - 1) > IRREGULAR:
        yield Remark(
            "noise-irregular",
            f"the timestamps are irregular ({counts.duplicates.count} are repeated): the samples "
            f"are taken as equally spaced, by their mean interval of {interval_s * 1e3:.6g} ms "
            f"(the median is {median_s * 1e3:.6g} ms)",
        )
    steps = [levels for rest in rests for levels in rest.levels]
    hidden = max((each.step for each in steps if each.sigma > HIDDEN * each.step), default=0.0)
    if hidden:
        yield Remark(
            "noise-steps",
            f"the rates are in steps of up to {math.degrees(hidden):.3g} deg/s, and noise reaches "
            "hardly from one to the next: it is not that of the sensor that is measured",
        )


def _fit_remarks(fits: Sequence[TermFit | None], tau_s: Float64) -> Iterator[Remark]:
    """Yield what a reader should know of the terms."""
    for axis, found in zip("xyz", fits, strict=True):
        if found is None:
            text = f"no sum of noise terms fits the deviation of {axis}, so none is stated"
            yield Remark("noise-unexplained", text)
        elif found.first:
            how = "higher (vibration or motion)" if found.above else "lower (a filter)"
            yield Remark(
                "noise-short-times",
                f"below {tau_s[found.first]:.3g} s the deviation of {axis} is {how} than the "
                "noise terms, which are fitted to longer times",
            )
