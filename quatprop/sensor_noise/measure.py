"""The noise of one log: find where the sensor is at rest, and fit the Allan variance there.

Samples are taken as equally spaced, by their mean interval: timestamps jitter more than sensors.
Gaps and the ends of rests divide them into pieces, which the variances are means over.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

from quatprop.conditioning import GyroCorrection, GyroCorrectionInputs, condition
from quatprop.conditioning.rests import find_rests
from quatprop.conditioning.static_detection import AGREEMENT, NoRestError
from quatprop.conditioning.time_range import EndsFinder, clipping_remarks
from quatprop.errors import UsageError
from quatprop.logs.beside_rates import conditioning_inputs
from quatprop.logs.joined import open_logs
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

HIDDEN: Final = 0.03
"""Error of a mean, as a share of the step of the rates, if their noise is a third of a step."""

OF_ATTITUDE: Final = {"gaps", "jitter", "repeated-stamps"}
"""Codes of remarks that concern attitudes only."""


class NoiseSettings(NamedTuple):
    """Which samples to use."""

    selection: RateSelection
    policy: Policy
    part: GyroCorrection

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return the settings from parsed values."""
        policy = {name: values[name] for name in ("on_backwards", "on_nonfinite") if name in values}
        return cls(
            RateSelection.of(values),
            Policy(on_gap="split", max_gap_ns=values.get("max_gap"), **policy),
            GyroCorrection(start=values.get("start"), end=values.get("end")),
        )


def measure_logs(paths: Sequence[str], values: Mapping[str, Any]) -> Noise:
    """Return the noise of a log, in one file or several, by parsed settings."""
    if any(map(is_stream, paths)):
        raise UsageError("stdin and pipes can be read only once, and noise reads a log twice")
    settings = NoiseSettings.of(values)
    with open_logs(paths, values.get("kind"), msg_path=settings.selection.msg_path) as log:
        source = choose_rates(log, settings.selection)
        return measure(" + ".join(paths), source, settings, log)


def measure(path: str, source: RateSignal, settings: NoiseSettings, log: Log | None) -> Noise:
    """Return the noise of rates at rest.

    `log`: the open log, which is read twice; None for rates in memory
    """
    chosen_by = "time_col" if isinstance(log, TableLog) else "clock"
    timeline = Timeline(settings.policy, path, chosen_by)
    rests = _rests(path, source, settings, log, timeline)
    batches, done = condition(
        source.batches,
        timeline,
        settings.part,
        1.0,
        GyroCorrectionInputs(),
        # Sorted, samples may belong to the range wherever they are in the log.
        part_reader=None if settings.policy.on_backwards == "sort" else source.part_reader,
    )
    ends, sums, span_ns = _joined(rests), AllanSums(), 0
    for segment in timeline.segments(timeline.measured(batches)):
        span_ns += _add(segment, ends, sums)
    counts, samples, pieces = timeline.counts, sum(sums.lengths), len(sums.lengths)
    m, variances = sums.variances()
    if len(m) < FEWEST or not span_ns:
        raise UsageError(
            f"{plain(path)}: {samples} samples at rest are too few to measure noise; record the "
            "sensor at rest for a minute or longer"
        )
    first_ns, last_ns = counts.first_ns or 0, counts.last_ns or 0
    used = tuple(end for end in ends if end[1] >= first_ns and end[0] <= last_ns)
    interval_s = span_ns / (samples - pieces) / NS_PER_S
    tau_s = np.asarray(m * interval_s)
    found = covariances(m, sums.lengths)
    fits = [fit(axis, found) if axis.all() else None for axis in variances.T]
    said = (
        *source.remarks,
        *timeline_remarks(counts, settings.policy, chosen_by),
        *clipping_remarks(settings.part, done),
        *_remarks(counts, interval_s, rests, pieces - len(used)),
        *_fit_remarks(fits, tau_s),
        *(() if log is None else log.remarks),
    )
    deviation = np.sqrt(variances)
    freedoms = np.stack(
        [np.full(len(m), np.nan) if one is None else one.freedoms for one in fits]
    ).T
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
        remarks=tuple(one for one in said if getattr(one, "code", "") not in OF_ATTITUDE),
        losses=() if log is None else tuple(log.losses),
    )


def _rests(
    path: str,
    source: RateSignal,
    settings: NoiseSettings,
    log: Log | None,
    timeline: Timeline,
) -> Sequence[StaticPeriod]:
    """Return the stationary periods in order of time."""
    finder = EndsFinder(earliest=settings.policy.on_backwards == "sort")
    inputs = conditioning_inputs(log, source, settings.selection, settings.part)

    def read(note: Any) -> Iterator[GyroSeries]:
        return timeline.looked_ahead(source.batches(), note)

    try:
        return find_rests(read, finder, REST, inputs, "body")
    except NoRestError as error:
        raise UsageError(
            f"{plain(path)}: {error.text}, and noise is measured at rest; record the sensor while "
            "it lies still"
        ) from None


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
    bounds = np.array(ends) + np.array([0, 1])
    at, first_ns, last_ns, total = -1, 0, 0, 0
    for block in segment:
        # Even positions are outside of rests, odd ones inside.
        cuts = np.searchsorted(block.t_ns, bounds.ravel())
        for place in range(np.searchsorted(cuts, 0, side="right"), len(cuts) + 1):
            start = cuts[place - 1] if place else 0
            stop = cuts[place] if place < len(cuts) else len(block)
            if start == stop or place % 2 == 0:
                continue
            if place != at:
                sums.begin_piece()
                total += last_ns - first_ns
                at, first_ns = place, int(block.t_ns[start])
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
            yield Remark(
                "noise-unexplained",
                f"the deviation of {axis} follows none of the slopes: nothing is stated of it",
            )
        elif found.first:
            why = (
                "larger, as with vibration or motion" if found.above else "smaller, as by a filter"
            )
            yield Remark(
                "noise-short-times",
                f"below {tau_s[found.first]:.3g} s the deviation of {axis} follows none of the "
                f"slopes: it is {why}; the terms are those of longer times",
            )
