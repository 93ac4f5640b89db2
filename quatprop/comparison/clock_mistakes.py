"""Mistakes in timestamps: an offset and a drift of B's clock."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.association import interval_ns, shifted
from quatprop.comparison.clock_error import ClockError, clock_errors
from quatprop.comparison.mistakes import Mistake, Sides
from quatprop.kinematics.quaternion import conjugate, log, multiply, shorter
from quatprop.kinematics.rates import rotation_vectors_between
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from quatprop.comparison.alignment import Alignment

SIGNIFICANT = 5.0
"""A clock drift is significant above this many standard deviations."""


def clock_mistakes(
    sides: Sides, begin_ns: int, coarse_ns: int, given_ns: int, *, turned: bool
) -> tuple[Mistake | None, Mistake | None]:
    """Return the offset and the drift of B's clock, each None if the motion does not show it.

    `begin_ns`: first timestamp of all of B, ns
    `coarse_ns`: approximate offset, ns
    `given_ns`: time already added to B's timestamps, ns
    `turned`: whether the body frames may differ
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


MAX_DRIFT = 0.01
"""Maximum drift of a clock: that of the worst crystal is far smaller."""


def drift_by_errors(sides: Sides, alignment: Alignment) -> Mistake | None:
    """Return the drift of B's clock that fits the errors best, whether or not it is significant.

    `sides`: with equal timestamps
    """
    a, b = sides
    error = log(shorter(multiply(conjugate(a.wxyz), alignment.apply(b.wxyz))))
    seconds = (a.t_ns - a.t_ns[0])[:, None] / NS_PER_S
    rate = np.gradient(np.cumsum(rotation_vectors_between(a.wxyz), axis=0), seconds[1:, 0], axis=0)
    # A delay makes an error of rate times delay.
    design = np.stack([rate.ravel(), (rate * seconds[1:]).ravel()], axis=1)
    (offset, ratio), *_ = np.linalg.lstsq(design, error[1:].ravel(), rcond=None)
    if abs(ratio) > MAX_DRIFT:
        return None
    first_ns = int(a.t_ns[0])
    clock = ClockError(offset, ratio, 0.0, 0.0, 0.0, float(seconds[-1, 0]))
    return _clock_drift(clock, 0, first_ns, first_ns)


NEAR_INTERVAL = 0.02
"""Tolerance of an offset of one interval or half, as a share of the interval."""


def _offset(clock: ClockError, coarse_ns: int, given_ns: int, interval_ns: int) -> Mistake:
    offset_ns = coarse_ns + round(clock.seconds * NS_PER_S)
    late = "late" if offset_ns < 0 else "early"
    amount = _rounded(abs(offset_ns), round(clock.std * NS_PER_S))
    sentence = f"B is {amount} {late}"
    for share, text in ((0.5, "half a sampling interval"), (1.0, "one sampling interval")):
        if abs(abs(offset_ns) / interval_ns - share) <= NEAR_INTERVAL:
            sentence += f" ({text} of A: a clock offset, or another integration rule)"
    setting = Setting("time_offset", f"{(offset_ns + given_ns) / 1e6:.9g}ms")
    return Mistake(
        "time offset",
        f"a time offset of {duration_text(abs(offset_ns))}",
        sentence,
        f"{setting} removes it",
        lambda sides: sides._replace(b=shifted(sides.b, offset_ns)),
    )


def _clock_drift(clock: ClockError, coarse_ns: int, begin_ns: int, first_ns: int) -> Mistake:
    """`first_ns`: origin of the times of the clock error, ns."""
    at_first = np.array((begin_ns - first_ns + coarse_ns) / NS_PER_S)
    # The error of the clock is a function of A's time, and what to add one of B's.
    of_b = 1 / (1 - clock.ratio)
    first_ms = 1e3 * of_b * float(clock.at(at_first)) + coarse_ns / 1e6
    ratio = of_b * clock.ratio
    ppm, std = abs(clock.ratio) * 1e6, max(clock.std * 1e6, 0.01)
    digits = max(1 - math.floor(math.log10(std)), 0)
    pace = "slow" if clock.ratio > 0 else "fast"
    moved, span = (
        duration_text(round(value * NS_PER_S))
        for value in (round(abs(clock.ratio) * clock.span, 4), round(clock.span, 1))
    )

    def undo(sides: Sides) -> Sides:
        added = np.rint(first_ms * 1e6 + ratio * (sides.b.t_ns - begin_ns)).astype(np.int64)
        return sides._replace(b=shifted(sides.b, added))

    return Mistake(
        "clock drift",
        f"clocks that differ by {float(f'{ppm:.3g}'):g} ppm",
        f"B's clock is {pace} by {ppm:.{digits}f} +- {std:.{digits}f} ppm against A's: the offset "
        f"between their timestamps changes by {moved} in {span}",
        f"add {first_ms:.6g} ms to B's timestamps, and {ratio * 1e6:.6g} ppm of the time "
        "since its first",
        undo,
    )


def _rounded(amount_ns: int, std_ns: int) -> str:
    """Return a duration with its uncertainty to two digits."""
    if not std_ns or std_ns * 1_000_000 < amount_ns:
        return duration_text(amount_ns)
    digits = max(len(str(std_ns)) - 2, 0)
    amount, std = (duration_text(round(value, -digits)) for value in (amount_ns, std_ns))
    return f"{amount} +- {std}"
