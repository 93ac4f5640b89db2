"""Mistakes in timestamps: an offset of B's clock, and one that changes."""

from __future__ import annotations

import math

import numpy as np

from quatprop.comparison.association import interval_ns, shifted
from quatprop.comparison.clock_error import ClockError, clock_errors
from quatprop.comparison.undoing import Sides, Undoing
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

SIGNIFICANT = 5.0
"""An error of a clock is real if it is this many standard deviations from none."""


def clocks(
    sides: Sides, begin_ns: int, coarse_ns: int, given_ns: int, *, turned: bool
) -> tuple[Undoing | None, Undoing | None]:
    """Return the offset of B's clock, and how much faster or slower it is, where motion shows it.

    `begin_ns`: the first timestamp of the whole of B, ns
    `coarse_ns`: about the offset, ns
    `given_ns`: what was added to B's timestamps already, ns
    `turned`: whether the bodies may be turned against each other
    """
    found = clock_errors(*sides, coarse_ns, turned=turned)
    if found is None:
        return None, None
    offset, change, first_ns = found
    return (
        _offset(offset, coarse_ns, given_ns, interval_ns(sides.a))
        if math.isfinite(offset.std)
        else None,
        _clock_drift(change, coarse_ns, begin_ns, first_ns)
        if abs(change.ratio) > SIGNIFICANT * change.std
        else None,
    )


NEAR_INTERVAL = 0.02
"""Share of an interval by which an offset may differ from one, or from half of one."""


def _offset(clock: ClockError, coarse_ns: int, given_ns: int, interval_ns: int) -> Undoing:
    offset_ns = coarse_ns + round(clock.seconds * NS_PER_S)
    late = "late" if offset_ns < 0 else "early"
    amount = _rounded(abs(offset_ns), round(clock.std * NS_PER_S))
    sentence = f"B is {amount} {late}"
    for share, text in ((0.5, "half a sampling interval"), (1.0, "one sampling interval")):
        if abs(abs(offset_ns) / interval_ns - share) <= NEAR_INTERVAL:
            sentence += f" ({text} of A: a clock offset, or another integration rule)"
    setting = Setting("time_offset", f"{(offset_ns + given_ns) / 1e6:.9g}ms")
    return Undoing(
        "time offset",
        f"a time offset of {duration_text(abs(offset_ns))}",
        sentence,
        f"{setting} removes it",
        lambda sides: sides._replace(b=shifted(sides.b, offset_ns)),
    )


def _clock_drift(clock: ClockError, coarse_ns: int, begin_ns: int, first_ns: int) -> Undoing:
    """`first_ns`: from where the times of the clock's error count, ns."""
    at_first = np.array((begin_ns - first_ns + coarse_ns) / NS_PER_S)
    first_ms = 1e3 * float(clock.at(at_first)) + coarse_ns / 1e6
    ppm, std = abs(clock.ratio) * 1e6, max(clock.std * 1e6, 0.01)
    digits = max(1 - math.floor(math.log10(std)), 0)
    pace = "slow" if clock.ratio > 0 else "fast"
    moved, span = (
        duration_text(round(value * NS_PER_S))
        for value in (round(abs(clock.ratio) * clock.span, 4), round(clock.span, 1))
    )

    def apply(sides: Sides) -> Sides:
        added = np.rint(first_ms * 1e6 + clock.ratio * (sides.b.t_ns - begin_ns)).astype(np.int64)
        return sides._replace(b=shifted(sides.b, added))

    return Undoing(
        "clock drift",
        f"clocks that differ by {ppm:.3g} ppm",
        f"B's clock is {pace} by {ppm:.{digits}f} +- {std:.{digits}f} ppm against A's: the offset "
        f"between their timestamps changes by {moved} in {span}",
        f"add {first_ms:.6g} ms to B's timestamps, and {clock.ratio * 1e6:.6g} ppm of the time "
        "since its first",
        apply,
    )


def _rounded(amount_ns: int, std_ns: int) -> str:
    """Return a duration with its uncertainty, to two digits of that."""
    if not std_ns or std_ns * 1_000_000 < amount_ns:
        return duration_text(amount_ns)
    digits = max(len(str(std_ns)) - 2, 0)
    amount, std = (duration_text(round(value, -digits)) for value in (amount_ns, std_ns))
    return f"{amount} +- {std}"
