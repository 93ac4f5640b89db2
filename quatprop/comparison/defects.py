"""Defects that no setting can correct: dead axes, and motion lost across gaps or at a rate limit.

Lost motion is only reported if replacing it by that of the other series removes most of the error.
"""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Remark
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.comparison.alignment import (
    align,
    align_pairs,
    aligned_rms,
    between_gaps,
    body_angle,
    common_beginning,
    rms_between,
)
from quatprop.comparison.association import associate
from quatprop.comparison.mistakes import NO_ERROR, Sides, recomposed
from quatprop.estimation.cells import gap_ns
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.kinematics.quaternion import conjugate, geodesic_angle, multiply
from quatprop.kinematics.series import AttitudeSeries
from quatprop.kinematics.time_series import rms
from quatprop.settings.command_options import BY_ALL

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Bool, Float64, Int64, Intp
    from quatprop.comparison.association import JudgedPairs
    from quatprop.comparison.mistakes import Mistake
    from quatprop.settings.command_options import ComparisonSettings


WINDOWS = 100
"""Approximate number of windows over which rotations are compared, long enough to average noise."""

MIN_TURN = np.radians(1.0)
"""Minimum RMS rotation over windows about each principal axis, rad, of motion about all three."""

MIN_SHARE = 0.05
"""The same, as a share of the largest of the three."""

DEAD = 1e-6
"""Share of the largest variation below which the variation of a rate is rounding."""

NOISE_FACTOR = 2.0
"""Rotations over n samples above this many times sqrt(n) of those over one are not noise."""

AT_LIMIT = 1e-3
"""Tolerance of rates at a limit, as a share of the range of their magnitudes."""

MIN_AT_LIMIT = 0.04
"""Minimum share of samples at a limit; for a sine, it is 0.03."""

MAX_SHARE_OF_DEFECT = 0.5
"""Maximum share of the error that remains when lost motion is replaced."""


def defects(
    a: AttitudeSeries,
    b: AttitudeSeries,
    settings: ComparisonSettings,
    part: JudgedPairs | None = None,
) -> tuple[Remark, ...]:
    """Return remarks on defects that no setting can correct.

    `part`: the pairs that are judged; None: all
    """
    of_a, of_b = (one if part is None else part.judged_samples(one) for one in (a, b))
    if dead := tuple(dead_axes(of_a, of_b)):
        return dead
    if step := step_at_gaps(Sides(a, b), settings, settings.align, part):
        return (step,)
    # Between the time ranges to judge, an extreme is not a limit of the series.
    return () if part is not None else tuple(_at_limits(a, b, settings))


def _at_limits(
    a: AttitudeSeries, b: AttitudeSeries, settings: ComparisonSettings
) -> Iterator[Remark]:
    """Yield rate limits that cause most of the error."""
    pairs = associate(a, b, settings)
    name = "mount" if settings.align == "mount" else "mean"
    ours, theirs = pairs.a, align_pairs(name, pairs, a, b).apply(pairs.b)
    before = rms_between(ours, theirs)
    if before <= max(NO_ERROR, MAX_SHARE_OF_DEFECT * aligned_rms(settings.align, pairs.a, pairs.b)):
        return  # most of the error comes from different frames
    seconds = np.diff(pairs.t_ns)[:, None] / NS_PER_S
    for of, own, other in (("A", ours, theirs), ("B", theirs, ours)):
        steps, true_steps = rotation_vectors_between(own), rotation_vectors_between(other)
        lost = _at_limit(steps / seconds)
        mended = recomposed(AttitudeSeries(pairs.t_ns, own), np.where(lost, true_steps, steps)).wxyz
        left = aligned_rms("mean", mended, other)
        # Even an error that occurs all the time falls by the share of steps that is replaced.
        if left <= MAX_SHARE_OF_DEFECT * before * (1 - float(lost.mean(axis=0).max())):
            share = f"{float(lost.any(axis=1).mean()):.2%}"
            yield Remark(
                "motion-lost",
                f"{of} loses motion while its rates are at a limit, in {share} of the steps: with "
                f"the motion of the other there, the RMS error with aligned frames is "
                f"{degrees_text(left, 4)} in place of {degrees_text(before, 4)}",
            )


def _at_limit(rate: Float64) -> Bool:
    """Return which rates are at the limit of their axis, shape ``(N - 1, 3)``."""
    sizes = np.abs(rate)
    at_limit = sizes >= sizes.max(axis=0) - AT_LIMIT * np.ptp(sizes, axis=0)
    return np.asarray(at_limit & (at_limit.mean(axis=0) >= MIN_AT_LIMIT))


def dead_axes(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Remark]:
    """Yield a remark if one series turns about all axes and the other has constant rates."""
    both = zip("AB", common_beginning(a, b), strict=True)
    spreads = {name: _spreads(series) for name, series in both}
    for name, other in (("A", "B"), ("B", "A")):
        own, whole = spreads[name][0], spreads[other][1]
        axes = [axis for axis, spread in zip("xyz", own, strict=True) if spread <= DEAD * whole[-1]]
        least = whole[-1] if len(axes) == len(own) else whole[0]
        if not least > max(MIN_TURN, MIN_SHARE * whole[-1]):
            continue
        if axes:
            text = f"the rate of {name} about its {' and '.join(axes)} axis never changes, and "
            text += f"{other} turns about all three: are rates missing?"
            if len(axes) == len(own):
                text = f"{name} turns at a constant rate and {other} does not: "
                text += f"is {name} a placeholder?"
            yield Remark("dead-axis", text)


def _spreads(series: AttitudeSeries) -> tuple[Float64, Float64]:
    """Return the RMS rotations between samples about the body axes, less the mean rate, rad.

    The second result is over windows about the principal axes, smallest first; 0 if it is noise.
    """
    seconds, angle = body_angle(series, int(series.t_ns[0]))
    span = max(float(seconds[-1]), 1e-9)
    varying = angle - seconds[:, None] / span * angle[-1]
    steps = np.diff(varying, axis=0)
    stride = max(len(varying) // WINDOWS, 1)
    windows = np.diff(varying[::stride], axis=0)
    of_steps, powers = (np.linalg.eigvalsh(x.T @ x / len(x)) for x in (steps, windows))
    powers[powers <= NOISE_FACTOR**2 * stride * of_steps] = 0.0
    return np.sqrt((steps**2).mean(axis=0)), np.sqrt(np.maximum(powers, 0.0))


# Steps of the error across gaps: lost samples, pauses, or times at which one series was lost.


STEP_FACTOR = 4.0
"""An error that changes by this many times the usual change over as much time makes a step."""

CHANGE_FACTOR = 2.0
"""A step is larger than what a change of the rates makes of it by this factor: a constant rate is
subtracted from the rotation over a gap as if its axis were constant."""

OF_RATES = {"rate bias", "scale", "rate sign", "side", "axes", "method"}
"""Mistakes whose correction changes the rates."""

MAX_SPANS = 2_000
"""Approximate number of spans of time from which the usual change is determined."""

PER_SERIES = 4
"""Minimum number of such spans one after the other; over longer times, the change is scaled."""


class Gaps(NamedTuple):
    """Gaps of either series, as pairs see them; arrays of shape ``(M,)``.

    `begin`, `end`: the last pair before and the first one after each
    `angle`: by how much the error changes there, rad
    """

    begin: Intp
    end: Intp
    angle: Float64


def step_at_gaps(  # noqa: PLR0913, PLR0917  # a comparison and its conditions
    sides: Sides,
    settings: ComparisonSettings,
    name: str,
    part: JudgedPairs | None = None,
    condition: str = "",
    least: float = NO_ERROR,
    changes: Sequence[tuple[AttitudeSeries, AttitudeSeries]] = (),
) -> Remark | None:
    """Return a remark if the error steps across gaps, and most of it comes from there.

    `sides`: both series, whole
    `name`: how B is aligned
    `part`: the pairs that are judged; None: all
    `condition`: when the remark holds, with a comma; may be empty
    `least`: minimum RMS error, rad
    `changes`: A before and after its rates were changed
    """
    pairs = associate(sides.a, sides.b, settings)
    crossing = between_gaps(pairs.t_ns, sides.a.t_ns, sides.b.t_ns)
    if not crossing.any():
        return None
    mount = align_pairs(name, pairs, sides.a, sides.b).mount_wxyz
    turned = multiply(pairs.b, mount)
    in_a, in_b = (AttitudeSeries(pairs.t_ns, wxyz) for wxyz in (pairs.a, turned))
    paired = Sides(in_a, in_b, crossing)
    gaps = _gaps(paired)
    least_step = STEP_FACTOR * _usual_change(paired, gaps)
    for before_it, after_it in changes:
        at = [np.searchsorted(before_it.t_ns, pairs.t_ns[rows]) for rows in gaps[:2]]
        begin, end = (np.minimum(rows, len(before_it) - 1) for rows in at)
        changed = _changes(Sides(before_it, after_it), begin, end)
        least_step = np.maximum(least_step, CHANGE_FACTOR * changed)
    steps = np.flatnonzero(gaps.angle > least_step)
    if not len(steps):
        return None
    stepping = np.zeros(len(crossing), np.bool_)
    for step in steps.tolist():
        stepping[gaps.begin[step] : gaps.end[step]] = True
    mended = paired._replace(crossing=stepping).mended()
    rows = slice(None) if part is None else part.contains(pairs.t_ns)
    fitted = rows if settings.align_range == "judged" else slice(None)
    by = "mean" if name == "mount" else name
    before, left = (
        rms_between(a[rows], align(by, a[fitted], turned[fitted]).apply(turned[rows]))
        for a in (pairs.a, mended.a.wxyz)
    )
    if left > MAX_SHARE_OF_DEFECT * before or before <= least:
        return None
    largest = int(steps[np.argmax(gaps.angle[steps])])
    around = int(pairs.t_ns[gaps.begin[largest]]), int(pairs.t_ns[gaps.end[largest]])
    of = {name: _gap(one.t_ns, *around) for name, one in (("A", sides.a), ("B", sides.b))}
    names = [key for key, gap in of.items() if gap]
    begin_ns, length_ns = max(filter(None, of.values()), key=lambda gap: gap[1])
    change = degrees_text(float(gaps.angle[largest]), 4)
    since = duration_text(begin_ns - int(pairs.t_ns[0]))
    where = f"of {duration_text(length_ns)} in {' and '.join(names)}, which begins {since} after "
    where += f"the first pair, at {begin_ns} ns"
    text = f"{condition}the error changes by {change} across a gap {where}"
    if len(steps) > 1:
        gaps_of = f"{len(steps)} gaps, most by {change} across one {where}"
        text = f"{condition}the error changes across {gaps_of}"
    other = "B" if "A" in names else "A"
    return Remark(
        "step-at-gap",
        f"{text}: with the motion of {other} there, the RMS error is "
        f"{degrees_text(left, 4)} in place of {degrees_text(before, 4)}",
    )


def remaining_step(  # noqa: PLR0913, PLR0917  # what was found so far
    sides: Sides,
    settings: ComparisonSettings,
    undone: Sequence[Mistake],
    left: Sequence[Mistake],
    part: JudgedPairs | None,
    least: float,
) -> Remark | None:
    """Return a remark if most of what is left of the error steps across gaps, or None.

    `undone`: the likely causes
    `left`: mistakes that do not explain most of the error by themselves
    `least`: minimum RMS error that is left, rad
    """
    tried = [(undone, settings.align, "without that cause, ")] if undone else []
    if not undone and settings.align not in BY_ALL:
        tried.append(((), "mean", "with aligned frames, "))
    if left:
        tried.append(((*undone, *left), settings.align, "without what else differs, "))
    for mistakes, align_by, condition in tried:
        changed, changes, name = sides, [], align_by
        for mistake in mistakes:
            before, changed, name = changed, mistake.undo(changed), mistake.align or name
            if mistake.name in OF_RATES:
                changes.append((before.a, changed.a))
        with suppress(ComparisonError):
            found = step_at_gaps(changed, settings, name, part, condition, least, changes)
            if found:
                return found
    return None


def _gaps(paired: Sides) -> Gaps:
    """Return the gaps between pairs."""
    edges = np.flatnonzero(np.diff(np.asarray(paired.crossing), prepend=False, append=False))
    begin, end = edges[::2], edges[1::2]
    return Gaps(begin, end, _changes(paired, begin, end))


def _changes(paired: Sides, begin: Intp, end: Intp) -> Float64:
    """Return the angles by which the error changes between pairs, rad, ``(M,)``."""
    turns = (multiply(conjugate(one.wxyz[begin]), one.wxyz[end]) for one in (paired.a, paired.b))
    return geodesic_angle(*turns)


def _usual_change(paired: Sides, gaps: Gaps) -> Float64:
    """Return by how much the error usually changes over as much time as gaps last, rad, ``(M,)``.

    It is the RMS over spans of time without what happens across gaps; over longer times than the
    pairs show, it grows with time.
    """
    t_ns, mended = paired.a.t_ns, paired.mended()
    interval = float(np.median(np.diff(t_ns)))
    lasts = np.maximum((t_ns[gaps.end] - t_ns[gaps.begin]) / interval, 1.0)
    powers = np.ceil(np.log2(lasts)).astype(np.int64)
    longest = max(int(np.log2(max(len(t_ns) // PER_SERIES, 1))), 0)
    usual = np.empty(len(lasts))
    for power in np.unique(powers).tolist():
        span = 1 << min(power, longest)
        begin = np.arange(0, len(t_ns) - span, max(len(t_ns) // MAX_SPANS, 1))
        change = rms(_changes(mended, begin, begin + span))
        rows = powers == power
        usual[rows] = change * np.maximum(lasts[rows] / span, 1.0)
    return usual


def _gap(t_ns: Int64, begin_ns: int, end_ns: int) -> tuple[int, int] | None:
    """Return the begin and the length, ns, of the longest gap of a series in a span of time."""
    rows = slice(
        max(int(np.searchsorted(t_ns, begin_ns, side="right")) - 1, 0),
        int(np.searchsorted(t_ns, end_ns)) + 1,
    )
    inside = t_ns[rows]
    intervals = np.diff(inside)
    if not len(intervals) or intervals.max() <= gap_ns(t_ns):
        return None
    longest = int(np.argmax(intervals))
    return int(inside[longest]), int(intervals[longest])
