"""Which mistake explains the differences between rotations over windows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.hypotheses import EXACT
from quatprop.comparison.trials import ClockError, RateRatio, Trial, rms_length
from quatprop.comparison.windows import MISREADINGS, Angles

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.arrays import Float64


NO_DIFFERENCE = 1e-9
"""RMS difference, rad, that needs no explanation."""

MAX_UNEXPLAINED = 0.5
"""Largest share of the rotation over windows that may remain when a mistake is undone."""

MAX_REMAINING = 0.9
"""Largest share of the difference over windows that may remain when a mistake is undone."""

MAX_REMAINING_OFFSET = 0.97
"""The same for a time offset, which is known better than its effect is large."""

MAX_REMAINING_TURN = 0.7
"""The same for a rotation, whose three angles always fit somewhat better than none."""

MIN_GAIN = 12.0
"""Least gain in log likelihood that is no coincidence among some forty trials."""

MIN_SCALE = 0.04
"""Least relative difference of rates that is more than a gyroscope's scale factor."""

MIN_TURN = np.radians(1.0)
"""Least rotation of the body frame, rad, that is more than a misalignment within a sensor."""

MIN_OFFSET = 0.4
"""Least time offset, in intervals: half of one is what integration rules differ by."""

MIN_DRIFT = 1.0
"""Least change of a time offset, in intervals: clocks that are kept together differ by less."""

SIGNIFICANT = 5.0
"""An offset is real if it is this many standard deviations from none."""

SIGNIFICANT_DRIFT = 7.0
"""The same for an offset that changes: noise that wanders looks like one."""

MUCH_BETTER = 0.7
"""A mistake with free parameters is preferred to one without only where less than this remains."""

NEGLIGIBLE = 1e-4
"""Share of the differences that says nothing against a mistake."""

MAX_INTERPOLATION = 0.02
"""The same where interpolation between samples may leave as much."""

DISCRETE = {*MISREADINGS, "rate sign", "axes"}
"""Mistakes without free parameters."""

CLOCKS = {"time offset", "clock drift"}
"""Mistakes in timestamps, which matter more the faster rates change."""

FITTED = {"scale", *CLOCKS}
"""Mistakes with one or two parameters."""

MISTAKES = DISCRETE | FITTED | {"body frame"}
"""All mistakes."""

TIE = 1.02
"""Trials within this factor of the best explain the windows as well."""


class WindowTrials:
    """All trials over windows of one length, and which of them explain the differences."""

    def __init__(self, length: float, starts: Float64, angles: Angles, tried: list[Trial]) -> None:
        self.length = length
        self.before, *self._tried = tried
        self._motion = max(rms_length(angle.over(starts, length)) for angle in (angles.a, angles.b))
        # Overlapping windows repeat each other.
        self._freedom = 3 * min(len(starts), float(starts[-1] - starts[0]) / length)
        offset = next(trial for trial in tried if trial.name == "time offset")
        self.offset_std = offset.value.white_std if isinstance(offset.value, ClockError) else np.inf
        # What a trial must be better than, where it is not the differences as they are.
        self._others = {"clock drift": min(self.before, offset, key=lambda trial: trial.rms)}
        interpolation = min(angles.interpolation, MAX_INTERPOLATION * self.before.rms)
        self._negligible = max(EXACT, NEGLIGIBLE * self.before.rms, interpolation)

    @property
    def unexplained(self) -> float:
        """Share of the rotation that remains in the best trial."""
        least = min(trial.rms for trial in (self.before, *self._tried))
        return least / self._motion if self._motion else np.inf

    def found(self, interval: float, names: Collection[str]) -> tuple[Trial, list[Trial]] | None:
        """Return the mistake that explains the differences, and others that do so equally well.

        `interval`: the shorter median interval of the two series, s
        """
        if self.before.rms <= NO_DIFFERENCE or self.unexplained > MAX_UNEXPLAINED:
            return None
        accepted = [
            trial
            for trial in self._tried
            if trial.name in names
            and self._is_better(trial, self._others.get(trial.name, self.before))
            and _is_material(trial, self.before, interval)
        ]
        if any(trial.name == "clock drift" for trial in accepted):
            # It contains the offset.
            accepted = [trial for trial in accepted if trial.name != "time offset"]
        for kind in (DISCRETE, FITTED, {"body frame"}):
            some = [trial for trial in accepted if trial.name in kind]
            best = min(some, key=lambda trial: trial.rms, default=None)
            if best is None:
                continue
            least = min(trial.rms for trial in accepted)
            if best.rms > self._negligible and least < MUCH_BETTER * best.rms:
                continue
            as_good = [
                trial
                for trial in accepted
                if trial.rms <= max(self._negligible, TIE * best.rms)
                or not self._is_better(best, trial)
            ]
            chosen = next(trial for trial in as_good if trial.name in kind)
            # Among mistakes with parameters one may look like another; they always fit somewhat
            # better than those without.
            also = [
                trial
                for trial in as_good
                if trial.name != chosen.name
                and (trial.name in DISCRETE or chosen.name not in DISCRETE)
            ]
            return chosen, sorted(also, key=lambda trial: trial.name)
        return None

    def _is_better(self, trial: Trial, other: Trial) -> bool:
        """Tell whether a trial is significantly more likely than another."""
        with np.errstate(divide="ignore"):
            gain = self._freedom * float(np.log(other.rms) - np.log(trial.rms))
        return gain >= MIN_GAIN


def _is_material(trial: Trial, before: Trial, interval: float) -> bool:
    """Tell whether a mistake is large enough to be one."""
    large, most = True, MAX_REMAINING_OFFSET
    match trial.value:
        case ClockError(seconds, _, std) if trial.name == "time offset":
            large = abs(seconds) > max(SIGNIFICANT * std, MIN_OFFSET * interval)
        case ClockError(_, ratio, std, _, _, span):
            large = abs(ratio) > max(SIGNIFICANT_DRIFT * std, MIN_DRIFT * interval / span)
        case RateRatio(value, low, high):
            large = not low <= 1 <= high and abs(np.log(value)) > MIN_SCALE
        case float(turn):
            large, most = turn > MIN_TURN, MAX_REMAINING_TURN
        case _:
            most = MAX_REMAINING
    return large and trial.rms / before.rms <= most
