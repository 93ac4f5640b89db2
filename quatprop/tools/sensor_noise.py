"""The noise of one log: find where the sensor is at rest, and fit the Allan variance there.

Samples are taken as equally spaced, but for those that are missing: timestamps jitter more than
sensors. Gaps and the ends of rests divide them into pieces, which the variances are means over.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from itertools import compress, pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from quatprop.base.errors import OutputError, UsageError
from quatprop.base.places import without_secret
from quatprop.base.rendering import source_text
from quatprop.base.text import Remark, Setting, plain
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.propagation.conditioning.static_detection import AGREEMENT, NoRestError
from quatprop.propagation.rate_stream import OF_ATTITUDE, RateSettings, RateStream
from quatprop.propagation.recording import Recording, open_recording
from quatprop.readers.open_log import is_stream
from quatprop.settings.bias import StaticBias
from quatprop.settings.reading import GyroCorrection, RateSelection
from quatprop.stores.objects import split_topics
from quatprop.timeline.counts import Policy
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.tools.allan import BOUND, SHOWN, chi_square, covariances, fit
from quatprop.tools.noise_table import UNITS, Noise, NoiseTerm, NoiseTerms, imu_yaml
from quatprop.tools.rest_samples import RestSamples, Spacing, Trend, spacing_of
from quatprop.writers.atomic import write_atomic
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.propagation.conditioning.static_period import StaticPeriod
    from quatprop.readers.signal import RateSignal
    from quatprop.timeline.counts import Counts
    from quatprop.tools.allan import TermFit


# The noise of a gyroscope, as values with their units.


def terms_of(
    fits: Sequence[TermFit | None],
    interval_s: float,
    tau_s: Float64,
    mean_s: float | None = None,
) -> NoiseTerms:
    """Return the root mean square of the terms of some axes, or the terms of one.

    `interval_s`: interval between samples, s
    `mean_s`: the same with those that are missing between them; None if none are
    """
    found = [each for each in fits if each is not None]
    if not found:
        return NoiseTerms()
    # White noise is that of a sample; a random walk goes on where samples are missing.
    units = (interval_s, math.sqrt(interval_s), 1.0, 1 / math.sqrt(mean_s or interval_s))
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


HIDES: Final = 0.65
"""Scatter of the rates, as a share of their step, below which it is that of the steps: of noise of
0.6 steps it is more, and exceeds the noise by that of rounding, step / sqrt(12)."""

WHITE_TERM, WALKS = 1, [2, 3]
"""Indices of the terms of white noise, and of flicker noise and random walk."""

IN_WINDOW: Final = 8
"""Minimum number of samples in a window in which rest is searched for."""

BEGINNING: Final = 1 << 16
"""Number of samples that show how they are spaced."""


def measure_files(
    names: Sequence[str],
    values: Mapping[str, Any],
    output: str | None,
    plot: str | None,
    command: str,
) -> Noise:
    """Measure the noise of a log, in one file or several, and write the requested files.

    `names`, `values`: as for :func:`measure_logs`
    `output`, `plot`: where the file for ``--imu`` and the picture go; None is nowhere
    `command`: the command line, for the metadata of the picture
    """
    paths, topic = split_topics(names, values.get("topic"))
    refuse_overlap(paths, [output, plot])
    with ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import allan_page
            from quatprop.tools.plot.page import PictureFile, kind_of

            if kind_of(plot) == "html":
                raise OutputError(plot, "a picture of noise is an image; use .png, .svg or .pdf")
            picture = stack.enter_context(PictureFile(plot, paths, command=command))
        noise = measure_logs(paths, {**values, "topic": topic})
        if plot is not None:
            picture.commit(allan_page(noise))
        if output is not None:
            write_atomic(output, imu_yaml(noise))
    return noise


def measure_logs(names: Sequence[str], values: Mapping[str, Any]) -> Noise:
    """Return the noise of a log, in one file or several, by parsed settings."""
    if any(map(is_stream, names)):
        raise UsageError("stdin and pipes can be read only once, and noise reads a log twice")
    with open_recording(
        names, RateSelection.from_settings(values), values.get("kind")
    ) as recording:
        return measure(recording, values)


def measure(recording: Recording, values: Mapping[str, Any]) -> Noise:
    """Return the noise of rates at rest; the recording is read twice."""
    path, source = recording.name, recording.rate_signal()
    search = _find_rests(recording, source, values)
    at_rest, counts, of_stream = _gathered(recording, source, search)
    samples, pieces = at_rest.samples, len(at_rest.sums.lengths)
    m, variances = at_rest.sums.variances()
    if len(m) < FEWEST or not at_rest.mean_s:
        raise UsageError(
            f"{plain(path)}: {samples} samples at rest are too few to measure noise; record the "
            "sensor at rest for a minute or longer"
        )
    first_ns, last_ns = counts.first_ns or 0, counts.last_ns or 0
    used = tuple(end for end in search.ends if end[1] >= first_ns and end[0] <= last_ns)
    missing, mean_s = at_rest.missing, at_rest.mean_s
    interval_s = mean_s * (samples - pieces) / (samples - pieces + missing)
    tau_s = np.asarray(m * interval_s)
    steps = at_rest.steps()
    hidden = [0 < math.sqrt(v) < HIDES * q for v, q in zip(variances[0], steps, strict=True)]
    fits = _fits(at_rest, steps, hidden)
    together = terms_of(fits, interval_s, tau_s)
    walks = (together.bias_instability.value, together.rate_random_walk.value) != (None, None)
    smooth = [
        drifts and not hides and (walks or _is_doubtful(one))
        for one, drifts, hides in zip(fits, at_rest.drifts(), hidden, strict=True)
    ]
    if any(smooth):
        level, *_ = _gathered(recording, source, search, at_rest.trend(smooth))
        again = map(_without_walks, _fits(level, steps, hidden))
        fits = [
            new if drifts else old for old, new, drifts in zip(fits, again, smooth, strict=True)
        ]
    remarks = (
        *of_stream,
        *_remarks(counts, interval_s, pieces - len(used), is_grid=missing > 0),
        *_fit_remarks(fits, tau_s, hidden),
        *_value_remarks(hidden, steps, smooth),
    )
    unknown = np.full(len(m), np.nan)
    degrees_of_freedom = np.stack(
        [unknown if one is None else one.degrees_of_freedom for one in fits], axis=1
    )
    deviation = np.sqrt(variances)
    return Noise(
        source=f"{without_secret(path)}: {source_text(source.name, source.type_name)}",
        topic=source.name if source.name.startswith("/") else "",
        samples=samples,
        rests=used,
        pieces=pieces,
        missing=missing,
        interval_s=interval_s,
        tau_s=tau_s,
        deviation=deviation,
        low=deviation * np.sqrt(degrees_of_freedom / chi_square(degrees_of_freedom, 1.0)),
        high=deviation * np.sqrt(degrees_of_freedom / chi_square(degrees_of_freedom, -1.0)),
        axes=tuple(terms_of([one], interval_s, tau_s, mean_s) for one in fits),
        combined=terms_of(fits, interval_s, tau_s, mean_s),
        dropped=counts.dropped,
        remarks=tuple(one for one in remarks if getattr(one, "code", "") not in OF_ATTITUDE),
        losses=recording.losses,
    )


def _refuse_bursts(path: str, spacing: Spacing) -> None:
    """Refuse samples in bursts with gaps between them: how they were measured is unknown."""
    bursts, limit_ns = spacing.bursts, GAP_FACTOR * spacing.usual_ns
    if bursts is None or bursts.period_ns - bursts.span_ns <= limit_ns:
        return
    whole = duration_text(2 * bursts.period_ns).replace(" ", "")
    raise UsageError(
        f"{plain(path)}: the samples come in bursts of {bursts.size} within "
        f"{duration_text(bursts.span_ns)}, every {duration_text(bursts.period_ns)}; give "
        f"{Setting('max_gap', whole)} if they were measured evenly and delivered so, or "
        f"{Setting('max_gap', f'{limit_ns}ns')} if they were measured in bursts"
    )


def _of_sensor(found: TermFit | None, step: float) -> TermFit | None:
    """Return a fit without the noise by rounding to steps, (rad/s)^2 / 12 of a sample."""
    if found is None or not step:
        return found
    terms = found.terms.copy()
    terms[WHITE_TERM] -= step * step / 12
    return found._replace(terms=terms)


def _fits(
    at_rest: RestSamples, steps: Sequence[float], hidden: Sequence[bool]
) -> list[TermFit | None]:
    """Return the terms of each axis; None if they are hidden by steps, or do not fit."""
    m, variances = at_rest.sums.variances()
    known = covariances(m, at_rest.sums.lengths)
    return [
        None if hides or not axis.all() else _of_sensor(fit(axis, known), step)
        for axis, hides, step in zip(variances.T, hidden, steps, strict=True)
    ]


def _is_doubtful(found: TermFit | None) -> bool:
    """Return whether a fit may be that of a drift: where it leaves times out, or shows a walk."""
    if found is None or found.first:
        return True
    return bool((found.terms[WALKS] >= SHOWN * found.sigmas[WALKS]).any())


def _without_walks(found: TermFit | None) -> TermFit | None:
    """Return a fit whose flicker noise and random walk are not determined."""
    if found is None:
        return None
    terms, sigmas = found.terms.copy(), found.sigmas.copy()
    terms[WALKS] = sigmas[WALKS] = np.nan
    return found._replace(terms=terms, sigmas=sigmas)


class RestSearch(NamedTuple):
    """The periods at rest of a log, and how it is read.

    `settings`: which samples are used
    `spacing`: how the samples are spaced
    `ends`: first and last timestamp of each stationary period, ns
    """

    settings: RateSettings
    spacing: Spacing
    ends: list[tuple[int, int]]


def _find_rests(recording: Recording, source: RateSignal, values: Mapping[str, Any]) -> RestSearch:
    """Find the stationary periods of a log."""
    names = ("on_backwards", "on_nonfinite") & values.keys()
    policy = Policy(
        on_gap="split", max_gap_ns=values.get("max_gap"), **{name: values[name] for name in names}
    )
    spacing = spacing_of(_beginning(source))
    if policy.max_gap_ns is None:
        _refuse_bursts(recording.name, spacing)
    period_ns = 0 if spacing.bursts is None else spacing.bursts.period_ns
    in_window = max(IN_WINDOW * spacing.usual_ns, 2 * period_ns)
    static = REST._replace(window_ns=max(REST.window_ns, in_window))
    part = GyroCorrection(start=values.get("start"), end=values.get("end"))
    settings = RateSettings(policy, part)
    try:
        rests = RateStream(recording, RateSettings(policy), source).stationary_periods(static)
    except NoRestError as error:
        raise UsageError(
            f"{plain(recording.name)}: {error.text}, and noise is measured at rest; record the "
            "sensor while it lies still"
        ) from None
    return RestSearch(settings, spacing, _joined(rests, static.window_ns))


def _gathered(
    recording: Recording, source: RateSignal, search: RestSearch, trend: Trend | None = None
) -> tuple[RestSamples, Counts, tuple[Remark, ...]]:
    """Read the samples at rest.

    `trend`: the trend to subtract from them
    `Returns`: the samples; counts of the timestamps; remarks on the rates
    """
    stream = RateStream(recording, search.settings, source)
    at_rest = RestSamples(search.ends, search.spacing, trend)
    for segment in stream.timeline.segments(stream):
        at_rest.add(segment)
    return at_rest, stream.counts, tuple(stream.remarks())


def _beginning(source: RateSignal) -> Int64:
    """Return the first timestamps, ns."""
    parts, count = [np.empty(0, np.int64)], 0
    for batch in source.batches():
        parts.append(batch.t_ns)
        if (count := count + len(batch)) >= BEGINNING:
            break
    return np.concatenate(parts)[:BEGINNING]


def _joined(rests: Sequence[StaticPeriod], window_ns: int) -> list[tuple[int, int]]:
    """Return the first and last timestamp of each rest, ns; parts of slow drifts are joined."""
    ends = [(rest.first_ns, rest.last_ns) for rest in rests[:1]]
    for before, rest in pairwise(rests):
        apart = np.abs(rest.mean_rad_s - before.mean_rad_s).max()
        if rest.first_ns - before.last_ns <= window_ns // 2 and apart <= 2 * AGREEMENT:
            ends[-1] = ends[-1][0], rest.last_ns
        else:
            ends.append((rest.first_ns, rest.last_ns))
    return ends


def _remarks(counts: Counts, interval_s: float, gaps: int, *, is_grid: bool) -> Iterator[Remark]:
    """Yield remarks on the timestamps.

    `gaps`: how many there are in rests
    `is_grid`: whether the interval is that of a grid, instead of the mean one
    """
    median_s = (counts.median_dt_ns or 0) / NS_PER_S
    if gaps:
        limit = duration_text(counts.gap_limit_ns or 0)
        yield Remark(
            "noise-gaps",
            f"gaps at rest, longer than {limit}: {gaps}; no difference is taken across one",
        )
    is_apart = not is_grid and abs(interval_s / median_s - 1) > IRREGULAR
    if counts.duplicates.count or is_apart:
        yield Remark(
            "noise-irregular",
            f"the timestamps are irregular ({counts.duplicates.count} are repeated): the samples "
            f"are taken as equally spaced, by their mean interval of {interval_s * 1e3:.6g} ms "
            f"(the median is {median_s * 1e3:.6g} ms)",
        )


def _value_remarks(
    hidden: Sequence[bool], steps: Sequence[float], smooth: Sequence[bool]
) -> Iterator[Remark]:
    """Yield remarks on the rates.

    `hidden`: whether the steps of each axis hide its noise
    `steps`: the steps, rad/s
    `smooth`: whether each axis drifts as a sensor that warms up
    """
    if any(hidden):
        step = math.degrees(max(compress(steps, hidden)))
        yield Remark(
            "noise-steps",
            f"the rates of {', '.join(compress('xyz', hidden))} are in steps of up to {step:.3g} "
            "deg/s, coarser than the noise of the sensor: they do not show it; record finer ones",
        )
    if any(smooth):
        yield Remark(
            "noise-warm-up",
            f"the rates of {', '.join(compress('xyz', smooth))} drift along a smooth curve, as a "
            "sensor does that warms up, so their random walk and bias instability are not "
            f"determined; begin later with {Setting('start', '+DUR')}",
        )


def _fit_remarks(
    fits: Sequence[TermFit | None], tau_s: Float64, hidden: Sequence[bool]
) -> Iterator[Remark]:
    """Yield remarks on the terms, such as those that quantisation hides."""
    for axis, found, hides in zip("xyz", fits, hidden, strict=True):
        if hides:
            continue
        if found is None:
            text = f"no sum of noise terms fits the deviation of {axis}, so none is stated"
            yield Remark("noise-unexplained", text)
        elif found.first:
            how = (
                "higher (vibration or motion)"
                if found.has_unexplained_short_term
                else "lower (a filter)"
            )
            yield Remark(
                "noise-short-times",
                f"below {tau_s[found.first]:.3g} s the deviation of {axis} is {how} than the "
                "noise terms, which are fitted to longer times",
            )
