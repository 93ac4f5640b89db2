"""The noise of one log: find where the sensor is at rest, and fit the Allan variance there.

Samples are taken as equally spaced, by their mean interval: timestamps jitter more than sensors.
Gaps and the ends of rests divide them into pieces, which the variances are means over.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import UsageError
from quatprop.base.rendering import count_text, source_text
from quatprop.base.text import Remark, plain
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.propagation.conditioning import GyroCorrectionInputs, clipping_remarks, condition
from quatprop.propagation.conditioning.correction_inputs import conditioning_inputs
from quatprop.propagation.conditioning.static_detection import AGREEMENT, NoRestError, find_rests
from quatprop.readers.open_log import JoinedLog, is_stream, open_logs
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.tables.table_log import TableLog
from quatprop.settings.parsers import StaticBias
from quatprop.settings.quantities import NOISE_DENSITIES, RATE_WALKS, RATES
from quatprop.settings.reading import GyroCorrection, RateSelection
from quatprop.stores.objects import without_secret
from quatprop.timeline import Timeline
from quatprop.timeline.counts import Policy
from quatprop.timeline.counts import remarks as timeline_remarks
from quatprop.timeline.time_range import EndsFinder
from quatprop.tools.allan import BOUND, SHOWN, AllanSums, chi_square, covariances, fit

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.base.errors import Loss
    from quatprop.base.rendering import Row
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.conditioning.static_period import StaticPeriod
    from quatprop.readers.signal import RateSignal
    from quatprop.readers.tables.model import Log
    from quatprop.timeline.counts import Counts
    from quatprop.tools.allan import TermFit


# The noise of a gyroscope, as values with their units.


class NoiseTerm(NamedTuple):
    """One term of the noise, or how large it is at most.

    Parameters
    ----------
    value
        Its size, in the unit of the term; None where the recording does not show it.
    sigma
        Standard deviation of the value; None where there is none.
    at_most
        What a term that is not shown is at most, with 95 % confidence; None where it is shown, or
        where the recording is too short to tell.
    """

    value: float | None = None
    sigma: float | None = None
    at_most: float | None = None

    @property
    def relative(self) -> float:
        """The standard deviation as a share of the value; NaN where there is no value."""
        return math.nan if self.value is None or self.sigma is None else self.sigma / self.value


class NoiseTerms(NamedTuple):
    """The noise of one axis, or that of all axes together.

    Parameters
    ----------
    quantisation
        Of angles, rad: the standard deviation of the white noise in the angle.
    angle_random_walk
        White noise of the rate, rad/s/sqrt(Hz).
    bias_instability
        Flicker noise of the rate, rad/s: the coefficient B, whose deviation is 0.664 B at any time.
    rate_random_walk
        Random walk of the rate, rad/s^2/sqrt(Hz).
    from_s
        The shortest averaging time that the terms explain, s; None where they explain nothing.
    """

    quantisation: NoiseTerm = NoiseTerm()
    angle_random_walk: NoiseTerm = NoiseTerm()
    bias_instability: NoiseTerm = NoiseTerm()
    rate_random_walk: NoiseTerm = NoiseTerm()
    from_s: float | None = None


UNITS = {
    "quantisation": "rad",
    "angle_random_walk": "rad/s/sqrt(Hz)",
    "bias_instability": "rad/s",
    "rate_random_walk": "rad/s^2/sqrt(Hz)",
}
"""The units of the terms."""


class Noise(NamedTuple):
    """The noise of a gyroscope at rest.

    Parameters
    ----------
    source
        The log, and what was read of it.
    topic
        The topic of the rates; empty for a table.
    samples
        How many samples were at rest.
    rests
        First and last timestamp of each period at rest, ns.
    pieces
        Into how many pieces rests and gaps divide the samples; nothing is taken across.
    interval_s
        Mean interval between samples, s: they are taken as equally spaced.
    tau_s
        Averaging times, shape ``(T,)``, s.
    deviation
        Overlapping Allan deviation of x, y and z, shape ``(T, 3)``, rad/s.
    low, high
        Its confidence interval of 68 %, shape ``(T, 3)``, rad/s; NaN where no terms explain it.
    axes
        The noise of x, y and z.
    combined
        The value to use for all axes: the root of their mean square.
    dropped
        Samples that were read and not used, by `on_backwards` and `on_nonfinite`.
    remarks
        What a reader should know.
    losses
        What of the log could not be read.
    """

    source: str
    topic: str
    samples: int
    rests: tuple[tuple[int, int], ...]
    pieces: int
    interval_s: float
    tau_s: Float64
    deviation: Float64
    low: Float64
    high: Float64
    axes: tuple[NoiseTerms, ...]
    combined: NoiseTerms
    dropped: int = 0
    remarks: tuple[Remark, ...] = ()
    losses: tuple[Loss, ...] = ()


def terms_of(fits: Sequence[TermFit | None], interval_s: float, tau_s: Float64) -> NoiseTerms:
    """Return the root mean square of the terms of some axes, or the terms of one."""
    found = [each for each in fits if each is not None]
    if not found:
        return NoiseTerms()
    units = (interval_s, math.sqrt(interval_s), 1.0, 1 / math.sqrt(interval_s))
    squares = np.mean([each.terms for each in found], axis=0)
    sigmas = np.sqrt(np.sum([each.sigmas**2 for each in found], axis=0)) / len(found)
    terms = {
        name: _term(float(square), float(sigma), unit)
        for name, square, sigma, unit in zip(UNITS, squares, sigmas, units, strict=False)
    }
    return NoiseTerms(**terms, from_s=float(tau_s[max(each.first for each in found)]))


def _term(square: float, sigma: float, unit: float) -> NoiseTerm:
    """Return a term from its square and the standard deviation of that."""
    if math.isnan(sigma):
        return NoiseTerm()
    if square < SHOWN * sigma:
        return NoiseTerm(at_most=unit * math.sqrt(max(square, 0.0) + BOUND * sigma))
    return NoiseTerm(unit * math.sqrt(square), unit * sigma / (2 * math.sqrt(square)))


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

OF_ATTITUDE: Final = {"gaps", "jitter", "packets", "repeated-stamps"}
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


# The noise as a table for people, and as the YAML file for kalibr and ``--imu``.


DATA_SHEET = {
    "angle_random_walk": ("deg/sqrt(h)", NOISE_DENSITIES),
    "bias_instability": ("deg/h", RATES),
    "rate_random_walk": ("deg/h/sqrt(h)", RATE_WALKS),
}
"""Units that data sheets use."""

KALIBR = {
    "gyroscope_noise_density": "angle_random_walk",
    "gyroscope_random_walk": "rate_random_walk",
}
"""Names of terms in the file."""

NOTE = "in brackets: 1 sigma; <: 95 % upper bound, not shown by the recording; -: not determined"


def imu_yaml(noise: Noise) -> str:
    """Return the YAML for kalibr and ``--imu``, without values that are unknown."""
    if noise.combined.angle_random_walk.value is None:
        raise UsageError(
            "the recording shows no angle random walk to write; record the sensor at rest longer"
        )
    lines = [
        f"# Gyroscope at rest, by quatprop {__version__}; values are RMS over the axes",
        f"# {plain(noise.source)}",
        "# kalibr also needs accelerometer_noise_density and accelerometer_random_walk.",
    ]
    for key, name in KALIBR.items():
        value, sigma, at_most = term = getattr(noise.combined, name)
        if value is not None and sigma is not None:
            percent = f"1 sigma {100 * term.relative:.2g} %"
            lines.append(f"{key}: {value:.4e}  # {UNITS[name]}, {percent}")
        else:
            bound = "unknown" if at_most is None else f"at most {at_most:.4e}, with 95 %"
            lines.append(f"# {key}: {bound}; the recording is too short to show it")
    lines += [f'rostopic: "{plain(noise.topic)}"'] if noise.topic else []
    return "\n".join([*lines, f"update_rate: {1 / noise.interval_s:.6g}\n"])


def noise_rows(noise: Noise) -> Iterator[Row]:
    """Yield the noise as labels and texts."""
    yield "source", plain(noise.source)
    yield "at rest", rest_text(noise)
    yield "", "".join(f"{name:>18}" for name in ("x", "y", "z", "root mean square"))
    sheet = []
    for name, unit in UNITS.items():
        terms = [getattr(axis, name) for axis in (*noise.axes, noise.combined)]
        yield name.replace("_", " "), f"{''.join(map(_cell, terms))}  {unit}"
        if name in DATA_SHEET and (value := terms[-1].value) is not None:
            usual, units = DATA_SHEET[name]
            sheet.append(f"{name.replace('_', ' ')} {value / units[usual]:.3g} {usual}")
    cells = "".join(f"{lowest:>18.3e}" for lowest in noise.deviation.min(axis=0))
    times = ", ".join(f"{noise.tau_s[row]:.3g}" for row in noise.deviation.argmin(axis=0))
    yield "lowest deviation", f"{cells}{'':>18}  rad/s, averaged over {times} s"
    if sheet:
        yield "data sheet", ", ".join(sheet)
    yield "", NOTE


def rest_text(noise: Noise) -> str:
    """Return what was measured: how many samples, in how many periods, and how long."""
    time = duration_text(round((noise.samples - noise.pieces) * noise.interval_s * NS_PER_S))
    rests = count_text(len(noise.rests), "period")
    pieces = f", {noise.pieces} pieces without gaps" if noise.pieces > len(noise.rests) else ""
    rate = f"{1 / noise.interval_s:.6g} Hz on average"
    return f"{count_text(noise.samples, 'sample')} in {rests}{pieces}: {time}, {rate}"


def _cell(term: NoiseTerm) -> str:
    """Return a term in a column of the table."""
    text = "-" if term.at_most is None else f"< {term.at_most:.2e}"
    if term.value is not None:
        percent = 100 * term.relative
        digits = sum(percent < limit for limit in (1, 10))
        text = f"{term.value:.3e} ({percent:.{digits}f}%)"
    return f"{text:>18}"
