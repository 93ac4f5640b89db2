"""The result of a comparison: errors, statistics, how they were obtained, a likely cause."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.kinematics.quaternion import conjugate, log, multiply
from quatprop.provenance import as_json

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.arrays import Float64, Int64
    from quatprop.comparison.alignment import Alignment
    from quatprop.comparison.association import Matching, Pairs
    from quatprop.comparison.clocks import ClockOffset
    from quatprop.comparison.criteria import Coverage, Criterion
    from quatprop.comparison.hypotheses import Cause
    from quatprop.comparison.meter import ComparedSample
    from quatprop.comparison.statistics import ErrorStatistics, SigmaStatistics, WindowStatistics
    from quatprop.text import Text

_ARRAYS = ("pairs", "errors")
"""Fields of a comparison that its report leaves out."""
_ARRAYS_OF = {"window": ("begins_ns", "errors"), "sigmas": ("one_sigma_rad", "axes_rad")}


@dataclass(frozen=True, slots=True)
class AppliedOffset:
    """The time offset of a comparison.

    Parameters
    ----------
    added_to_b_ns
        What was added to B's stamps, ns.
    found
        How it was estimated; None where it was given.
    """

    added_to_b_ns: int
    found: ClockOffset | None


@dataclass(frozen=True, slots=True)
class Comparison:
    """The geodesic error between two attitude series A and B.

    Parameters
    ----------
    pairs
        What was compared; None where files were compared while they were read, which keeps nothing
        of a pair.
    errors
        Geodesic errors of the pairs, shape ``(N,)``, rad; empty where there are no pairs.
    association
        How the attitudes were matched in time.
    time_offset
        What was added to B's stamps.
    alignment
        How B was rotated.
    error_rad
        Statistics of the errors, rad.
    drift_deg_h
        Slope of the errors in time, deg/h; None where all stamps are equal.
    worst
        The pair with the largest error.
    window
        Errors of the rotations over windows, where they were asked for.
    sigmas
        The errors in standard deviations; None where neither series has any.
    coverage
        How much of B was compared.
    tolerance_rad
        The largest error that passes, rad; None: every error does.
    criteria
        The verdict on each criterion.
    passed
        Whether all criteria passed.
    first_exceeding
        The first pair with an error above the tolerance.
    likely_cause
        What explains the error, where something does and a criterion failed or none was given.
    remarks
        What else a reader should know.
    """

    pairs: Pairs | None
    errors: Float64
    association: Matching
    time_offset: AppliedOffset
    alignment: Alignment
    error_rad: ErrorStatistics
    drift_deg_h: float | None
    worst: ComparedSample
    window: WindowStatistics | None
    sigmas: SigmaStatistics | None
    coverage: Coverage
    tolerance_rad: float | None
    criteria: tuple[Criterion, ...]
    passed: bool
    first_exceeding: ComparedSample | None
    likely_cause: Cause | None
    remarks: tuple[str | Text, ...]

    @property
    def t_ns(self) -> Int64:
        """Times of the pairs, shape ``(N,)``, ns, in A's clock."""
        return np.empty(0, np.int64) if self.pairs is None else self.pairs.t_ns

    @property
    def error_vectors(self) -> Float64:
        """Rotation vectors that turn B into A, shape ``(N, 3)``, rad, about the body axes."""
        if self.pairs is None:
            return np.empty((0, 3))
        step = multiply(conjugate(self.alignment.apply(self.pairs.b)), self.pairs.a)
        return log(step * np.where(step[:, :1] < 0, -1.0, 1.0))

    def report(self) -> Mapping[str, Any]:
        """Return everything but the arrays, JSON-ready."""
        names = [name for name in self.__slots__ if name not in _ARRAYS]
        report = {name: as_json(getattr(self, name)) for name in names}
        for part, arrays in _ARRAYS_OF.items():
            for name in arrays if report[part] else ():
                del report[part][name]
        return report
