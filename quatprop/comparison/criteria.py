"""Criteria of a comparison: limits on errors, drift and coverage, each judged by itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quatprop.comparison.settings import Sigmas
from quatprop.errors import ComparisonError
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from quatprop.comparison.meter import CoveredTime
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.comparison.statistics import ErrorStatistics, SigmaStatistics, WindowStatistics


@dataclass(frozen=True, slots=True)
class Criterion:
    """A limit and whether it was kept.

    Parameters
    ----------
    setting
        The setting that gives the limit, such as ``"rms_tol"``.
    label
        What is limited.
    value, limit
        What was measured and what is allowed, in `unit`.
    unit
        ``"rad"``, ``"deg/h"``, ``"%"`` or ``"sigma"``.
    passed
        Whether the value is within the limit: not above it, or for a coverage not below it.
    """

    setting: str
    label: str
    value: float
    limit: float
    unit: str
    passed: bool


@dataclass(frozen=True, slots=True)
class Coverage:
    """How much of the reference, B, was compared, in percent.

    Parameters
    ----------
    time
        Of its time span without its own gaps: the time between neighbouring pairs, without gaps.
    samples
        Of its samples; None where they were interpolated, and so have no partners of their own.
    """

    time: float
    samples: float | None

    @classmethod
    def of(cls, pairs: CoveredTime, reference: CoveredTime, samples: float | None) -> Self:
        """Return how much of a reference pairs cover, and so many percent of its samples."""
        time = min(100 * pairs.ns / reference.ns, 100.0) if reference.ns else 100.0
        return cls(time, samples)

    @property
    def least(self) -> float:
        """The smaller of the two."""
        return self.time if self.samples is None else min(self.time, self.samples)


def judge(  # noqa: PLR0913, PLR0917  # everything that has a limit
    settings: ComparisonSettings,
    errors: ErrorStatistics,
    window: WindowStatistics | None,
    drift_deg_h: float | None,
    covered: Coverage,
    sigmas: SigmaStatistics | None,
) -> Iterator[Criterion]:
    """Yield the verdict on each criterion that the settings have.

    Raises
    ------
    ComparisonError
        There is a limit in standard deviations, and neither series has any; or one on the drift
        of a single pair.
    """
    for setting, label, name in (
        ("tol", "largest error", "max"),
        ("rms_tol", "RMS error", "rms"),
        ("final_tol", "final error", "final"),
        ("p95_tol", "95 % error", "p95"),
        ("max_sigma", "largest error", "max"),
    ):
        limit = getattr(settings, setting)
        if limit is None:
            continue
        if not isinstance(limit, Sigmas):
            value = getattr(errors, name)
            yield Criterion(setting, label, value, limit, "rad", value <= limit)
            continue
        if sigmas is None:
            shown = "" if setting == "max_sigma" else str(limit)
            raise ComparisonError(
                f"neither series has standard deviations, which {Setting(setting, shown)} needs; "
                f"write them with {Setting('sigma')}"
            )
        value = getattr(sigmas, name)
        yield Criterion(setting, label, value, limit.count, "sigma", value <= limit.count)
    others = [
        ("drift_tol", "drift", drift_deg_h or 0.0, "deg/h"),
        ("min_coverage", "coverage", covered.least, "%"),
    ]
    if window is not None:
        others = [
            ("window_tol", "worst error over windows", window.max_rad, "rad"),
            ("window_rms_tol", "RMS error over windows", window.rms_rad, "rad"),
            *others,
        ]
    if settings.drift_tol is not None and drift_deg_h is None:
        raise ComparisonError(
            f"one pair of attitudes shows no drift; leave {Setting('drift_tol')} out"
        )
    for setting, label, value, unit in others:
        if (limit := getattr(settings, setting)) is not None:
            passed = value >= limit if setting == "min_coverage" else abs(value) <= limit
            yield Criterion(setting, label, value, limit, unit, passed)
