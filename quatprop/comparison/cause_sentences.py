"""Sentences about the mistakes found in rotations over windows, and their remedies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.trials import ClockError, RateRatio, Trial
from quatprop.rendering import degrees_text
from quatprop.text import Setting
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.arrays import Float64

MISREADINGS = {
    "conjugate": (
        "B is the conjugate of A: the direction (reference to body) or the JPL convention of one "
        "of them was not taken into account"
    ),
    "layout": "B is scalar-last and was read as scalar-first, or A the other way round",
    "layout-first": "B is scalar-first and was read as scalar-last, or A the other way round",
}
"""Name of a misreading -> what it means."""

ALTERNATIVES = {
    "conjugate": "a wrong direction or JPL convention",
    "layout": "a wrong layout",
    "layout-first": "a wrong layout",
    "side": "body rates taken for inertial rates",
    "rate sign": "rates of the opposite sign",
    "axes": "swapped or reversed axes",
}
"""Name of a mistake -> what else the windows may show."""

RATE_SIGN = (
    "the rates of A and B have opposite signs; or one of them is the conjugate of what inertial "
    "rates taken for body rates give"
)

SCALES = {
    2.0: ": a factor 1/2 is missing in one of them",
    180 / np.pi: ": one of them took degrees for radians",
}
"""Ratio of rates -> the mistake that gives it."""

SCALE_TOLERANCE = 0.03
"""Relative difference from such a ratio; gyroscopes are not calibrated much better."""

WITHIN_STDS = 2.0
"""Standard deviations by which an offset of half or one interval may differ from that."""

ROUNDED = 0.01
"""What it may always differ by, as a share of the interval: timestamps are rounded."""

NEAR_INTERVAL = 0.15
"""What it may differ by at most, as a share of the interval, however uncertain it is."""


def described(
    trial: Trial, alternatives: Sequence[Trial], intervals: Sequence[float]
) -> tuple[str, str, str | None]:
    """Return the name of a cause, a sentence, and the remedy.

    `intervals`: median intervals of A and B, s
    """
    sentence, remedy = _sentence_and_remedy(trial, intervals)
    if alternatives:
        others = " or ".join(dict.fromkeys(map(_alternative, alternatives)))
        sentence += f"; this motion does not distinguish it from {others}"
        names = {one.name for one in alternatives}
        match trial.value:
            case ClockError(seconds) if trial.name == "time offset" and "body frame" in names:
                # Motion that looks the same in turned axes may have a constant speed, by which no
                # offset is found.
                offset = Setting("time_offset", f"{seconds * 1000:.6g}ms")
                remedy = f"{offset} or {ALIGN_MOUNT}"
    return trial.name, sentence, remedy


def _alternative(trial: Trial) -> str:
    match trial.value:
        case ClockError(seconds) if trial.name == "time offset":
            return f"a time offset of {duration_text(round(abs(seconds) * NS_PER_S))}"
        case ClockError(_, ratio):
            return f"clocks that differ by {abs(ratio) * 1e6:.3g} ppm"
        case RateRatio(value):
            return f"rates that differ by a factor of {max(value, 1 / value):.6g}"
        case float(turn):
            return f"body frames that differ by {degrees_text(turn)}"
        case _:
            return " with ".join(ALTERNATIVES[name] for name in trial.name.split(" and "))


def _sentence_and_remedy(trial: Trial, intervals: Sequence[float]) -> tuple[str, str | None]:
    match trial.value:
        case ClockError() as clock:
            return _offset(clock, intervals) if trial.name == "time offset" else _drift(clock)
        case RateRatio(value):
            return f"B turns {1 / value:.6g} times as fast as A{_scale_meaning(value)}", RATE_UNIT
        case float(turn):
            return f"the body frames differ by {degrees_text(turn)}", ALIGN_MOUNT
        case (str(of_a), str(of_b)):
            return _methods(of_a, of_b, intervals[0])
        case np.ndarray():
            return _axes(trial.value)
        case _:
            return _misreading(trial)


def _misreading(trial: Trial) -> tuple[str, str | None]:
    if trial.name == "rate sign":
        return RATE_SIGN, None
    side = trial.side
    if trial.name == "side":
        which, other = ("A", "B") if side == "a" else ("B", "A")
        sentence = (
            f"what multiplies on the left in {which} multiplies on the right in {other}: body "
            "rates against inertial rates"
        )
        return sentence, f"propagate with {Setting('rates', 'body|inertial')}"
    sentence = "; also, ".join(MISREADINGS[name] for name in trial.name.split(" and "))
    remedies = []
    if trial.name.startswith("layout"):
        # Where B is scalar-last, or A scalar-first.
        last = trial.name.startswith("layout-first") == (side == "a")
        layout = "scalar-last" if last else "scalar-first"
        remedies.append(f"{Setting('from_layout', layout, side)}")
    if trial.name.endswith("conjugate"):
        direction = Setting("from_direction", "ref-to-body", side)
        remedies.append(f"{direction} or {Setting('from_convention', 'jpl', side)}")
    return sentence, f"if it is {side.upper()}, read it with {' and '.join(remedies)}"


def _offset(offset: ClockError, intervals: Sequence[float]) -> tuple[str, str | None]:
    late = "late" if offset.seconds < 0 else "early"
    amount, std = (round(value * NS_PER_S) for value in (abs(offset.seconds), offset.std))
    sentence = f"B is {_rounded(amount, std)} {late}"
    remedy = f"{Setting('time_offset', 'auto')} takes the offset out"
    for name, interval in zip("AB", intervals, strict=True):
        within = min(max(WITHIN_STDS * offset.std, ROUNDED * interval), NEAR_INTERVAL * interval)
        for share, text in ((0.5, "half a sampling interval"), (1.0, "one sampling interval")):
            if abs(abs(offset.seconds) - share * interval) <= within:
                sentence += f" ({text} of {name}): a clock offset, or another integration rule"
                return sentence, f"{remedy}, {Setting('method')} changes the rule"
    return sentence, remedy


RATE_UNIT = f"see {Setting('rate_unit', 'rad/s|deg/s')} where the rates are read"

ALIGN_MOUNT = f"{Setting('align', 'mount')} takes it out"


def _drift(drift: ClockError) -> tuple[str, str]:
    ppm, std = abs(drift.ratio) * 1e6, max(drift.std * 1e6, 0.01)
    digits = max(1 - math.floor(math.log10(std)), 0)
    pace = "slow" if drift.ratio > 0 else "fast"
    moved, span = (
        duration_text(round(value * NS_PER_S))
        for value in (round(abs(drift.ratio) * drift.span, 4), round(drift.span, 1))
    )
    sentence = (
        f"B's clock is {pace} by {ppm:.{digits}f} +- {std:.{digits}f} ppm against A's: the offset "
        f"between their timestamps changes by {moved} in {span}"
    )
    return sentence, f"correct the stamps; {Setting('time_offset', 'auto')} leaves the change in"


def _rounded(amount_ns: int, std_ns: int) -> str:
    """Return a duration with its uncertainty, to two digits of that."""
    if not std_ns or std_ns * 1_000_000 < amount_ns:
        return duration_text(amount_ns)
    digits = max(len(str(std_ns)) - 2, 0)
    amount, std = (duration_text(round(value, -digits)) for value in (amount_ns, std_ns))
    return f"{amount} +- {std}"


def _methods(of_a: str, of_b: str, interval: float) -> tuple[str, str]:
    sentence = f"the same rates lead to A with method {of_a}, and to B with method {of_b}"
    if {of_a, of_b} == {"start", "end"}:
        amount = duration_text(round(interval * NS_PER_S))
        sentence += f", or their timestamps are one interval, {amount}, apart"
    return sentence, _if_propagated("method", of_b, of_a)


def _if_propagated(setting: str, a: str, b: str) -> str:
    """Return how either series may be propagated to arrive at the other: one may be a truth."""
    of_a, of_b = Setting(setting, a), Setting(setting, b)
    return f"if A was propagated, propagate it with {of_a}; if B was, with {of_b}"


def _axes(matrix: Float64) -> tuple[str, str]:
    """Describe y = M x, x in B's axes and y in A's."""
    sentence = f"the body axes x, y, z of A are {_signed(matrix)} of B"
    if np.linalg.det(matrix) > 0:
        mounts = (_signed(turn).replace(" ", "") for turn in (matrix.T, matrix))
        return sentence, f"{_if_propagated('mount', *mounts)}; {ALIGN_MOUNT}"
    return (
        f"{sentence}, which is left-handed: an axis is reversed, or two are swapped",
        "see the order and the signs of the rates that were propagated",
    )


def _signed(matrix: Float64) -> str:
    axes = [("-" if row.sum() < 0 else "") + "xyz"[np.argmax(np.abs(row))] for row in matrix]
    return ", ".join(axes)


def _scale_meaning(scale: float) -> str:
    ratio = max(scale, 1 / scale)
    near = (SCALES[named] for named in SCALES if abs(ratio / named - 1) < SCALE_TOLERANCE)
    return next(near, "")
