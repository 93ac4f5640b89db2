"""Defects that a source shows by itself: dead, frozen, damaged, clipped, planar, or a copy."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.rendering import count_text
from quatprop.estimation.turning import BLOCK
from quatprop.kinematics.propagate import rotation_vectors_between
from quatprop.tools.crosscheck.result import Finding

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.base.arrays import Bool, Float64
    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.sources import Source

MIN_SAMPLES: Final = 30
MIN_SPAN: Final = 2.0
"""Sources with fewer samples, or over less time in s, are not compared."""

SPIKE: Final = 20.0
BEYOND: Final = 70.0
"""A rate is damaged if it is above this many times what 99 % are below, and above this, rad/s."""

CLIPPED: Final = 3
"""Number of consecutive samples at the extreme, at least twice, that is not a coincidence."""

PLANAR: Final = 1e-6
"""An orientation is planar by construction if other axes turn less than this share."""

HELD: Final = 0.2
"""Share of repeated samples that is noted."""

FROZEN: Final = 1.0, 20.0
"""A source is frozen if it repeats a sample for longer than this, s, and this many intervals."""

JUMP: Final = np.radians(25.0)
JUMPS: Final = 3, 0.002
"""An orientation jumps by more than this, rad; at most so many times, and this share of samples."""

STEADY: Final = np.radians(5.0)
"""Rate above which a steady turn cannot be a bias, rad/s."""

MOVING: Final = np.radians(2.0)
"""Rate of another source, rad/s, at which a frozen one is wrong."""


SAME_BODY: Final = frozenset({"related", "weak", "changing"})
"""States of pairs of different devices that turn together; other devices are other bodies."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """The state of one source.

    `source`: without damaged samples
    `usable`: whether it can be compared
    `shown`: which body axes are measured, shape ``(3,)``
    `constant`: axes of rates that never change, shape ``(3,)``
    `jumps`: intervals in which its frame jumps, ``(N - 1,)``
    `frozen`: stretches of repeated samples: first and last index
    `notes`: observations that are not faults
    """

    source: Source
    usable: bool = True
    shown: Bool = field(default_factory=lambda: np.ones(3, np.bool_))
    constant: Bool = field(default_factory=lambda: np.zeros(3, np.bool_))
    jumps: Bool | None = None
    frozen: tuple[tuple[int, int], ...] = ()
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def axes_named(axes: Bool) -> str:
    """Return the names of axes, such as ``"x and y"``."""
    return " and ".join("xyz"[i] for i in np.flatnonzero(axes))


def health_of(source: Source) -> Health:
    """Return the state of a source."""
    count = len(source.t_ns)
    if count < MIN_SAMPLES or source.span < MIN_SPAN:
        few = f"{count_text(count, 'sample')} over {source.span:.3g} s: too few to compare"
        return Health(source=source, usable=False, notes=(few,))
    if not np.ptp(source.values, axis=0).any() and not (source.is_rates and source.values.any()):
        return _dead(source)
    state = _of_rates(source) if source.is_rates else _of_orientation(source)
    source = state.source
    same = np.ones(len(source.t_ns) - 1, np.bool_)
    for column in source.values.T:
        same &= column[1:] == column[:-1]
    notes = state.notes
    if same.mean() > HELD:
        percent = f"{100 * same.mean():.0f} %"
        notes += (f"{percent} of the samples repeat the one before: its values are held",)
    return replace(state, notes=notes, frozen=_frozen(source, same))


def _dead(source: Source) -> Health:
    value = source.values[0]
    if source.is_rates:
        text = "dead: every rate is zero"
        finding = Finding(level="fault", code="dead", source=source.name, text=text)
        # Estimates that nobody fills in, as of an odometry without a twist, are not broken.
        finding = finding if source.measured else replace(finding, level="remark")
        return Health(source=source, usable=False, findings=(finding,))
    is_identity = abs(value[0]) == 1.0
    note = "is the identity throughout" if is_identity else "never changes"
    return Health(source=source, usable=False, notes=(f"not estimated: it {note}",))


def _of_rates(source: Source) -> Health:
    rate, findings, notes = source.values, [], []
    size = np.maximum(np.maximum(np.abs(rate[:, 0]), np.abs(rate[:, 1])), np.abs(rate[:, 2]))
    usual = float(np.percentile(size, 99))
    spikes = size > max(BEYOND, SPIKE * usual)
    if spikes.any():
        first = float(source.t_ns[int(np.argmax(spikes))] - source.t_ns[0]) * 1e-9
        text = (
            f"{count_text(int(spikes.sum()), 'damaged sample')} of {len(rate)}: up to "
            f"{size.max():.4g} rad/s, where 99 % are below {usual:.3g}, the first after "
            f"{first:.3f} s; left out here"
        )
        findings.append(Finding(level="fault", code="spikes", source=source.name, text=text))
        source = replace(source, t_ns=source.t_ns[~spikes], values=rate[~spikes])
        rate = source.values
    still = np.array([np.ptp(column) == 0 for column in rate.T])
    if still.any():
        notes.append(f"the rate about {axes_named(still)} never changes, and is not compared")
    findings += [
        Finding(level="remark", code="clipped", source=source.name, text=text)
        for axis in range(3)
        if (text := _clipped(rate[:, axis], "xyz"[axis]))
    ]
    # An estimate of a vehicle in a plane has no other axes.
    is_planar = not rate[0][still].any() and (not source.measured or still.sum() == 2)  # noqa: PLR2004
    constant = still & (not is_planar)
    shown = ~still if not still.all() else still
    return Health(
        source=source, shown=shown, constant=constant, notes=tuple(notes), findings=tuple(findings)
    )


def _clipped(rate: Float64, axis: str) -> str:
    """Return a text if the largest rates are all the same; ``""``: they are not."""
    limit = float(np.abs(rate).max())
    if limit < 1.0:
        return ""
    for sign in (1, -1):
        edges = np.flatnonzero(np.diff(sign * rate == limit, prepend=False, append=False))
        lengths = edges[1::2] - edges[::2]
        if (lengths >= CLIPPED).sum() > 1:
            many = count_text(int(lengths.sum()), "sample")
            return f"axis {axis} is clipped at {sign * limit:.4g} rad/s in {many}"
    return ""


def _of_orientation(source: Source) -> Health:
    size, typical = _turns_of(source.values)
    still = (typical < PLANAR * typical.max()) & (typical.max() > 0)
    notes, findings = [], []
    if still.any():
        notes.append(
            f"planar: it never turns about body {axes_named(still)}, which is not compared"
        )
    jumps = size > max(JUMP, 15 * float(np.percentile(size, 99)))
    if jumps.any() and jumps.sum() <= max(JUMPS[0], JUMPS[1] * len(size)):
        at = int(np.argmax(jumps))
        when = float(source.t_ns[at + 1] - source.t_ns[0]) * 1e-9
        times = count_text(int(jumps.sum()), "jump")
        text = f"{times}, the first by {np.degrees(size[at]):.0f} deg after {when:.3f} s: a reset?"
        findings.append(Finding(level="remark", code="jumps", source=source.name, text=text))
    else:
        jumps = np.zeros(len(size), np.bool_)
    return Health(
        source=source, shown=~still, jumps=jumps, notes=tuple(notes), findings=tuple(findings)
    )


def _turns_of(wxyz: Float64) -> tuple[Float64, Float64]:
    """Return the angles between attitudes, ``(N - 1,)``, and their RMS about each axis, rad."""
    size, squares = np.empty(len(wxyz) - 1), np.zeros(3)
    for first in range(0, len(size), BLOCK):
        turned = rotation_vectors_between(wxyz[first : first + BLOCK + 1])
        size[first : first + BLOCK] = np.linalg.norm(turned, axis=1)
        squares += (turned**2).sum(axis=0)
    return size, np.sqrt(squares / len(size))


def _frozen(source: Source, same: Bool) -> tuple[tuple[int, int], ...]:
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False))
    seconds = source.t_ns * 1e-9
    longest = max(FROZEN[0], FROZEN[1] * source.interval)
    return tuple(
        (int(first), int(last))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
        if seconds[last] - seconds[first] > longest
    )


def frozen_findings(
    states: Sequence[Health],
    pairs: Sequence[Pair],
    turning: dict[str, Turning],
    zeros: dict[str, int],
) -> list[Finding]:
    """Return where a source repeats a sample while another one of the same body turns.

    `zeros`: those of the clocks, ns
    """
    findings = []
    for state in states:
        source = state.source
        others = [
            (turning[other.name], added)
            for pair in pairs
            if source.name in pair.names
            for other, added in (_of_same_body(pair, source),)
            if added is not None
        ]
        for first, last in state.frozen:
            zero_ns = zeros[source.name]
            begin, end = (float(source.t_ns[k] - zero_ns) * 1e-9 for k in (first, last))
            own = float(np.linalg.norm(source.values[first])) if source.is_rates else 0.0
            moves = [_motion(other, begin + added, end + added, own) for other, added in others]
            fastest = max(moves, default=0.0)
            if fastest > MOVING:
                text = (
                    f"frozen for {end - begin:.3g} s from {begin:.3f} s on, while another source "
                    f"turns {np.degrees(fastest):.3g} deg/s"
                )
                findings.append(
                    Finding(level="fault", code="frozen", source=source.name, text=text)
                )
    return findings


def _of_same_body(pair: Pair, source: Source) -> tuple[Source, float | None]:
    """Return the other source, and what is added to times for its clock, s; None: another body."""
    is_a = pair.a.name == source.name
    other = pair.b if is_a else pair.a
    if pair.fit is not None and pair.status in SAME_BODY:
        return other, -pair.fit.offset if is_a else pair.fit.offset
    return other, 0.0 if other.device == source.device else None


def constant_findings(
    states: Sequence[Health], pairs: Sequence[Pair], turning: dict[str, Turning]
) -> list[Finding]:
    """Return the axes of rates that never change while another source changes about them."""
    findings = []
    for state in states:
        name, value = state.source.name, state.source.values[0]
        axes = state.constant
        if not axes.any():
            continue
        others = [_rates_of_other(pair, name, turning) for pair in pairs if name in pair.names]
        moves = [rate[:, axes].std(axis=0).max() for rate in others if rate is not None]
        is_dead = max(moves, default=0.0) > MOVING
        values = ", ".join(f"{x:.3g}" for x in value[axes])
        text = f"axis {axes_named(axes)} is dead: it never changes ({values} rad/s)"
        if axes.all():
            text = f"dead: the rate never changes ({values} rad/s)"
            is_dead = is_dead or float(np.abs(value).max()) > BEYOND
        if is_dead:
            code = "dead" if axes.all() else "dead-axis"
            findings.append(Finding(level="fault", code=code, source=name, text=text))
    return findings


def _rates_of_other(pair: Pair, name: str, turning: dict[str, Turning]) -> Float64 | None:
    """Return the rates of the other source in the axes of the named one, over seconds."""
    fit, is_a = pair.fit, pair.a.name == name
    other = turning[(pair.b if is_a else pair.a).name]
    begin = np.arange(other.seconds[0], other.seconds[-1] - 1.0, 1.0)
    if not len(begin):
        return None
    rate = other.mean_rate("body", begin, 1.0)
    if pair.status != "related" or fit is None:
        # Without a relation any axis may be meant: all have to move.
        return np.asarray(rate.std(axis=0).min() * np.array([[-1.0] * 3, [1.0] * 3]))
    return np.asarray(rate @ (fit.matrix if is_a else fit.matrix.T))


def _motion(turning: Turning, begin: float, end: float, repeated: float) -> float:
    """Return how fast a source turns in a stretch, rad/s; 0 if it does not cover most of it.

    `repeated`: the rate that the other source repeats, rad/s; a steady turn of this size is no
        motion that it lacks
    """
    covered = min(turning.seconds[-1], end) - max(turning.seconds[0], begin)
    if covered < 0.8 * (end - begin):  # most of it
        return 0.0
    edges = np.linspace(begin, end, 12)
    rate = turning.mean_rate("body", edges[:-1], float(edges[1] - edges[0]))
    steady = float(np.linalg.norm(rate.mean(axis=0)))
    changing = float(np.sqrt((rate.std(axis=0) ** 2).sum()))
    if steady < STEADY or abs(steady - repeated) < 0.1 * steady:  # the same
        return changing
    return max(changing, steady)


def copies(sources: Sequence[Source]) -> dict[str, str]:
    """Return the sources that have the same numbers as an earlier one: name -> that one."""
    found: dict[str, str] = {}
    for a, b in combinations(sources, 2):
        if a.kind == b.kind and a.name not in found and _are_equal(a, b):
            found.setdefault(b.name, a.name)
    return found


def _are_equal(a: Source, b: Source) -> bool:
    _, in_a, in_b = np.intersect1d(a.t_ns, b.t_ns, return_indices=True)
    if len(in_a) > 0.9 * min(len(a.t_ns), len(b.t_ns)):  # of the shorter one
        u, v = a.values[in_a], b.values[in_b]
    elif len(a.t_ns) == len(b.t_ns):
        u, v = a.values, b.values
    else:
        return False
    if not a.is_rates:
        v = v * np.where((u * v).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    if not np.ptp(u, axis=0).any():
        return False
    equal = np.abs(u - v).max(axis=1) <= 1e-9 * np.abs(u).max()
    return bool(equal.mean() > 0.98)  # noqa: PLR2004  # nearly all
