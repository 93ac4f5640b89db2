"""A case run: its attitudes, what the run says of itself, and how it compares."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from quatprop.check.spelling import sentence
from quatprop.comparison import compare
from quatprop.errors import ComparisonError
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.pipeline.job import run
from quatprop.signals.compared_series import Reading, read_operand
from quatprop.times import duration_text

if TYPE_CHECKING:
    from quatprop.check.case import Case
    from quatprop.series import AttitudeSeries


@dataclass(frozen=True, slots=True)
class Measured:
    """What a run of a case gave.

    Parameters
    ----------
    series
        The attitudes that it wrote.
    report
        What the run says of itself: that of :func:`quatprop.pipeline.job.run`.
    """

    series: AttitudeSeries
    report: dict[str, Any]

    @property
    def samples(self) -> int:
        """How many samples were propagated."""
        return int(self.report["result"]["samples"])

    @property
    def final_wxyz(self) -> list[float]:
        """The last attitude."""
        return list(self.report["result"]["final_wxyz"])


@dataclass(frozen=True, slots=True)
class Difference:
    """How the attitudes of a case differ from what they are held against.

    Parameters
    ----------
    error_rad
        The worst error, rad.
    where
        Where that is, in words.
    passed
        Whether it is within the tolerance.
    reason
        Why it did not pass, in words; empty where it did.
    cause
        What explains the error, in words; empty where nothing is known to.
    report
        The report of the comparison; None for a lone attitude, which has none.
    """

    error_rad: float
    where: str
    passed: bool
    reason: str = ""
    cause: str = ""
    report: dict[str, Any] | None = None


def measured(case: Case, every: int | None) -> Measured:
    """Propagate the log of a case.

    Parameters
    ----------
    case
        The case.
    every
        Keep every so-manieth attitude, where the case does not say which.

    Raises
    ------
    QuatpropError
        The log cannot be propagated as the case asks.
    """
    with TemporaryDirectory(prefix="quatprop-") as folder:
        output = str(Path(folder) / "attitude.parquet")
        job = replace(case.job, output=output, to="parquet", report=None)
        report = run(job if chooses_rows(case) else replace(job, every=every))
        return Measured(read_operand(Reading(output, "parquet")).series, report)


def chooses_rows(case: Case) -> bool:
    """Return whether a case says which attitudes are kept."""
    return any(said is not None for said in (case.job.every, case.job.rate, case.job.at))


def difference(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> Difference:
    """Compare attitudes as a case asks.

    Raises
    ------
    ComparisonError
        They cannot be compared as asked.
    """
    if len(a) == len(b) == 1 and a.t_ns[0] == b.t_ns[0]:
        # A comparison wants pairs to associate; a log of one sample has one attitude.
        error = float(geodesic_angle(a.wxyz[0], b.wxyz[0]))
        limit = math.inf if case.settings.tolerance is None else case.settings.tolerance
        reason = "" if error <= limit else "the only attitude is above the tolerance"
        return Difference(error, "at the only sample", error <= limit, reason)
    found = compare(a, b, case.settings)
    first_ns = int(found.pairs.t_ns[0])
    reason = cause = ""
    if found.exceeded is not None:
        reason = (
            f"above the tolerance, first at {_since(found.exceeded.t_ns, first_ns)} "
            f"({found.exceeded.t_ns} ns)"
        )
    if found.cause is not None:
        cause = f"{found.cause.sentence} ({found.cause.name})"
    return Difference(
        error_rad=found.worst.error_rad,
        where=f"at {_since(found.worst.t_ns, first_ns)}",
        passed=found.passed,
        reason=reason,
        cause=cause,
        report=found.report(),
    )


def differing_stamps(a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Say how stamps differ from those of a reference; nothing where they are the same."""
    if len(a) != len(b):
        return f"there are {len(a)} attitudes, and {len(b)} in the reference"
    (differ,) = (a.t_ns != b.t_ns).nonzero()
    if not len(differ):
        return ""
    first = int(differ[0])
    return (
        f"{len(differ)} of {len(a)} stamps are not those of the reference, the first at attitude "
        f"{first}: {a.t_ns[first]} ns, not {b.t_ns[first]} ns"
    )


def compared(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> Difference | str:
    """Compare as :func:`difference`, but give the words of what hinders it."""
    try:
        return difference(case, a, b)
    except ComparisonError as error:
        return sentence(error)


def angle_text(angle: float, *, in_degrees: bool) -> str:
    """Return an angle in the unit in which the tolerance is written.

    Examples
    --------
    >>> angle_text(0.5, in_degrees=True)
    '28.6479 deg'
    """
    return f"{math.degrees(angle):.6g} deg" if in_degrees else f"{angle:.3g} rad"


def _since(t_ns: int, first_ns: int) -> str:
    return f"+{duration_text(t_ns - first_ns)}"
