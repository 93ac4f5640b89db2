"""Which mistake explains the differences between rotations over windows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.cause_sentences import MISREADINGS
from quatprop.comparison.hypotheses import EXACT
from quatprop.comparison.trials import ClockDrift, RateRatio, TimeOffset, Trial, size
from quatprop.kinematics.quaternion import IDENTITY, geodesic_angle

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.arrays import Float64
    from quatprop.comparison.windows import Angles


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

DISCRETE = {*MISREADINGS, "side", "rate sign", "axes"}
"""Mistakes without free parameters."""

FITTED = {"scale", "time offset", "clock drift"}
"""Mistakes with one or two."""

TIE = 1.02
"""Trials within this factor of the best explain the windows as well."""


class WindowTrials:
    """All trials over windows of one length, and which of them explain the differences."""

    def __init__(self, length: float, starts: Float64, angles: Angles, tried: list[Trial]) -> None:
        self.length = length
        self.before, *self._tried = tried
        self._motion = max(size(part) for part in angles.over(starts, length))
        # Overlapping windows repeat each other.
        self._freedom = 3 * min(len(starts), float(starts[-1] - starts[0]) / length)
        self._offset = next(trial for trial in tried if trial.name == "time offset")
        self._less_offset = min(self.before, self._offset, key=lambda trial: trial.rms)
        interpolation = min(angles.interpolation, MAX_INTERPOLATION * self.before.rms)
        self._negligible = max(EXACT, NEGLIGIBLE * self.before.rms, interpolation)

    @property
    def unexplained(self) -> float:
        """Share of the rotation that remains in the best trial."""
        least = min(trial.rms for trial in (self.before, *self._tried))
        return least / self._motion if self._motion else np.inf

    @property
    def offset_std(self) -> float:
        """Standard deviation of the time offset, s, in case of white noise."""
        offset = self._offset.value
        return offset.white_std if isinstance(offset, TimeOffset) else np.inf

    def found(
        self, interval: float, *, turned: bool, only: Collection[str] = ()
    ) -> tuple[Trial, list[Trial]] | None:
        """Return the trial that explains the differences, and what explains them as well."""
        if self.before.rms <= NO_DIFFERENCE or self.unexplained > MAX_UNEXPLAINED:
            return None
        accepted = [
            trial
            for trial in self._tried
            if (not only or trial.name in only)
            and (turned or trial.name != "body frame")
            and self._gain(self._compared_with(trial), trial) >= MIN_GAIN
            and _is_material(trial, self.before, interval)
        ]
        if any(trial.name == "clock drift" for trial in accepted):
            # It contains the offset.
            accepted = [trial for trial in accepted if trial.name != "time offset"]
        for kind in (DISCRETE, FITTED, {"body frame"}):
            some = [trial for trial in accepted if trial.name in kind]
            if not some:
                continue
            best = min(some, key=lambda trial: trial.rms)
            least = min(trial.rms for trial in accepted)
            if not self._is_negligible(best) and least < MUCH_BETTER * best.rms:
                continue
            chosen = next(trial for trial in some if not self._worse(trial, best))
            # Among mistakes with parameters one may look like another; they always fit somewhat
            # better than those without.
            also = [
                trial
                for trial in accepted
                if trial.name != chosen.name
                and not self._worse(trial, best)
                and (trial.name in DISCRETE or chosen.name not in DISCRETE)
            ]
            return chosen, sorted(also, key=lambda trial: trial.name)
        return None

    def _compared_with(self, trial: Trial) -> Trial:
        """Return what a trial must be better than."""
        return self._less_offset if trial.name == "clock drift" else self.before

    def _gain(self, worse: Trial, better: Trial) -> float:
        """Return by how much the likelihood of the better trial is greater, as a logarithm."""
        with np.errstate(divide="ignore"):
            return self._freedom * float(np.log(worse.rms) - np.log(better.rms))

    def _is_negligible(self, trial: Trial) -> bool:
        """Tell whether what remains may be due to interpolation and rounding alone."""
        return trial.rms <= self._negligible

    def _worse(self, trial: Trial, best: Trial) -> bool:
        if self._is_negligible(trial) or trial.rms <= TIE * best.rms:
            return False
        return self._gain(trial, best) >= MIN_GAIN


def _is_material(trial: Trial, before: Trial, interval: float) -> bool:
    """Tell whether a mistake is large enough to be one."""
    remaining = trial.rms / before.rms
    match trial.value:
        case TimeOffset(seconds, std, _):
            large = abs(seconds) > max(SIGNIFICANT * std, MIN_OFFSET * interval)
            return large and remaining <= MAX_REMAINING_OFFSET
        case ClockDrift(ratio, std, _, _, span):
            large = abs(ratio) > max(SIGNIFICANT_DRIFT * std, MIN_DRIFT * interval / span)
            return large and remaining <= MAX_REMAINING_OFFSET
        case RateRatio(value, least, most):
            outside = not least <= 1 <= most and abs(np.log(value)) > MIN_SCALE
            return outside and remaining <= MAX_REMAINING_OFFSET
        case np.ndarray() if trial.name == "body frame":
            turn = float(geodesic_angle(IDENTITY, trial.value))
            return turn > MIN_TURN and remaining <= MAX_REMAINING_TURN
        case _:
            return remaining <= MAX_REMAINING
