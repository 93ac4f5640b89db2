"""Samples of several sensors in one log without labels: in strict turn, or mixed at random.

No sample is changed here; the finding is one sentence with its place.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.text import Remark

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64, Int64
    from quatprop.propagation.checks.samples import Samples, Unit


JAGGED = 0.05
"""Variance of the difference of neighbouring samples, relative to white noise, below which samples
are those of one smooth motion."""

MOST_SENSORS = 4
"""Sensors that may take turns."""

ALTERNATING = 30.0
"""Ratio of the squared differences of neighbours to those of samples of one sensor: a vibration
that is near half the sample rate has up to 17 within 8 % of it."""

SMALLEST_JUMP = math.radians(1.0)
"""rad/s: RMS difference of neighbours below which it does not matter whose samples they are."""

ROUNDING = 1e-9
"""Rounding of sums, relative to those of squares."""

FEWEST_NEIGHBOURS = 40
"""Fewest samples that show that sensors take turns."""

MIXED = 160
"""Neighbouring samples of one axis in which two sensors are told apart."""

FIRST_LOOKS = 4
"""Parts of the first block that are looked at; of each further one, it is one part."""

LEAST_SHARE = 0.2
"""Smallest share of the samples of each of two sensors that are mixed."""

LEAST_SWITCHES, MOST_SWITCHES = 0.25, 0.95
"""Share of the samples that are not of the sensor of the one before; above, they take turns."""

MOST_EQUAL = 0.5
"""Largest share of equal changes of one sensor: zeros between rates are a dropout."""

APART = 3.0
"""Ratio of the small jumps between sensors to the large changes of one: a vibration has all values
between its extremes."""

REPEATING = 0.08, range(2, 17)
"""Squared differences, relative to those of neighbours, below which rates repeat, and after how
many samples. Vibrations of any frequency do; two sensors that are mixed have 0.2 and more."""


class Alternation(NamedTuple):
    """Samples of several sensors.

    `sensors`: their number
    `share`: share of the samples that are of another sensor than the one before
    `jump`, `same`: RMS change between sensors, and of one, rad/s
    """

    begin_ns: int
    sensors: int
    share: float
    jump: float
    same: float


class Turns:
    """Finds samples of several sensors that take turns, or are mixed, without labels."""

    def __init__(self) -> None:
        self._found: Alternation | None = None
        self._looks = FIRST_LOOKS

    def add(self, samples: Samples) -> None:
        """Add samples."""
        if self._found is not None or samples.size < FEWEST_NEIGHBOURS:
            return
        columns, t_ns = samples
        # Rates that are not finite, or whose squares overflow, alternate in no comparison.
        with np.errstate(invalid="ignore", over="ignore"):
            jump = float(_squared(columns, 1).mean())
            variance = float(columns.var(axis=1).sum())
            if not (jump > 2 * JAGGED * variance and jump > SMALLEST_JUMP**2):
                return
            for sensors in range(2, MOST_SENSORS + 1):
                same = float(_squared(columns, sensors).mean())
                if jump > ALTERNATING * same:
                    begin_ns = int(t_ns[_begin(columns, sensors)])
                    sizes = math.sqrt(jump), math.sqrt(same)
                    self._found = Alternation(begin_ns, sensors, 1.0, *sizes)
                    return
            self._look_for_mixed(columns, t_ns)

    def _look_for_mixed(self, columns: Float64, t_ns: Int64) -> None:
        """Look at some parts of a block for two sensors that are mixed."""
        for begin in np.linspace(0, columns.shape[1] - MIXED, self._looks, dtype=np.int64).tolist():
            if begin >= 0 and (mixed := _mixed(columns[:, begin : begin + MIXED])):
                self._found = mixed._replace(begin_ns=int(t_ns[begin]))
                return
        self._looks = 1

    def remarks(self, unit: Unit) -> Iterator[Remark]:
        """Yield a sentence if sensors take turns, or are mixed."""
        if self._found is None:
            return
        name, scale = unit
        begin_ns, sensors, share, jump, same = self._found
        if share < 1:
            yield Remark(
                "alternating",
                f"the rates near t = {begin_ns} ns are on two courses, with {share:.0%} of the "
                f"samples on another than the one before: there they change by {jump / scale:.3g} "
                f"{name} RMS, but on each course by {same / scale:.3g}: those of 2 sensors, mixed? "
                "write each to its own log",
            )
            return
        which = {2: "second", 3: "third", 4: "fourth"}[sensors]
        or_else = {2: ", or is it a vibration at half the sample rate"}.get(sensors, "")
        yield Remark(
            "alternating",
            f"the rates alternate from t = {begin_ns} ns on: they change by {jump / scale:.3g} "
            f"{name} RMS from sample to sample, but by {same / scale:.3g} from one to every "
            f"{which} after it: those of {sensors} sensors that take turns{or_else}? write each to "
            "its own log",
        )


@np.errstate(invalid="ignore", over="ignore")  # of rates of a damaged log
def may_take_turns(columns: Float64, motion: Float64) -> bool:
    """Return whether sums allow that samples but for the first are of several sensors.

    The limits are those of :meth:`Turns.add`, with room for the rounding of sums.

    `motion`: for each axis the sums of rates, of their squares, and of products with the sample
        before; shape ``(3, 3)``
    """
    count = columns.shape[1]
    if count < FEWEST_NEIGHBOURS:
        return False
    total, squares, products = motion.T
    rounding = ROUNDING * float(squares.sum())
    ends = columns[:, 0] ** 2 - columns[:, -1] ** 2
    jump = (float((2 * (squares - products) + ends).sum()) + rounding) / (count - 2)
    variance = (float((squares - total**2 / (count - 1)).sum()) - rounding) / count
    # Of rates that are not finite, neither is known.
    return not jump <= max(SMALLEST_JUMP**2, 2 * JAGGED * variance)


def _mixed(columns: Float64) -> Alternation | None:
    """Return how samples of two sensors are mixed; None if they may be those of one.

    Each sample goes on from the last one of either sensor, whichever is nearer. One axis is enough.
    """
    changes = np.einsum("ij,ij->i", np.diff(columns), np.diff(columns))
    rate = columns[int(changes.argmax())]
    mean = float(changes.max()) / (len(rate) - 1)
    if not SMALLEST_JUMP**2 < mean < math.inf:
        return None
    values = rate.tolist()
    last = [values[0], values[int(np.abs(rate[: MIXED // 8] - rate[0]).argmax())]]
    own: tuple[list[float], list[float]] = [], []
    jumps: list[float] = []
    sensor, before = 0, values[0]
    for value in values[1:]:
        nearer = int(abs(value - last[1]) < abs(value - last[0]))
        own[nearer].append(abs(value - last[nearer]))
        if nearer != sensor:
            jumps.append(abs(value - before))
        last[nearer] = before = value
        sensor = nearer
    share = len(jumps) / (len(values) - 1)
    if not LEAST_SWITCHES <= share <= MOST_SWITCHES:
        return None
    if any(
        len(each) < LEAST_SHARE * len(values) or each.count(0.0) > MOST_EQUAL * len(each)
        for each in own
    ):
        return None
    within = np.array(own[0] + own[1])
    same = float((within**2).mean())
    if mean <= ALTERNATING * same:
        return None
    is_apart = np.quantile(jumps, 0.1) > APART * np.quantile(within, 0.9)
    least, periods = REPEATING
    squared = (float(((rate[lag:] - rate[:-lag]) ** 2).mean()) for lag in periods)
    if not is_apart or min(squared) < least * mean:
        return None
    return Alternation(0, 2, share, float(np.sqrt(np.mean(np.square(jumps)))), math.sqrt(same))


def _squared(columns: Float64, lag: int) -> Float64:
    """Return the squared differences of samples at a distance, all axes together."""
    difference = columns[:, lag:] - columns[:, :-lag]
    squared: Float64 = np.einsum("ij,ij->j", difference, difference)
    return squared


def _begin(columns: Float64, sensors: int) -> int:
    """Return the first sample from which on some samples take turns."""
    sums = [np.cumsum(_squared(columns, lag)) for lag in (1, sensors)]
    count = min(map(len, sums)) - FEWEST_NEIGHBOURS
    jump, same = (each[FEWEST_NEIGHBOURS:][:count] - each[:count] for each in sums)
    found = np.flatnonzero(jump > ALTERNATING * same)
    return int(found[0]) if len(found) else 0
