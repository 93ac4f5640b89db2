"""Run a case: propagate its log, and compare the attitudes."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from quatprop.comparison.compare import compare
from quatprop.comparison.summary import criterion_text, with_names
from quatprop.errors import ComparisonError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.pipeline.job import Job, run
from quatprop.pipeline.settings import OutputSettings
from quatprop.text import Remark, spelled
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.check.case import Case
    from quatprop.comparison.result import Criterion
    from quatprop.pipeline.report import RunReport
    from quatprop.series import AttitudeSeries


class CaseRun(NamedTuple):
    """The attitudes of a case."""

    series: AttitudeSeries
    report: RunReport

    @property
    def samples(self) -> int:
        """Number of samples that were propagated."""
        return self.report.result.samples

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """What a propagation says of the log, spelled as the keys of a suite."""
        return tuple(remark.spelled(spelled) for remark in self.report.remarks)


class CaseComparison(NamedTuple):
    """How the attitudes of a case differ from the reference.

    `error_rad`: the worst error, rad; None where they cannot be compared
    `where`: the time of the worst error
    `summary`: the worst error, the tolerance, where, and what else was judged: errors in sigma, and
        how much of the reference was compared; empty where they cannot be compared
    `failure`: why the error is not accepted; empty where it is
    `cause`: the likely cause of the error; empty where none is known
    """

    error_rad: float | None
    where: str = ""
    summary: str = ""
    failure: str = ""
    cause: str = ""
    report: Mapping[str, object] | None = None


def propagate_case(case: Case, every: int | None) -> CaseRun:
    """Propagate the log of a case."""
    with TemporaryDirectory(prefix="quatprop-") as folder:
        output = str(Path(folder) / "attitude.parquet")
        settings = case.propagation
        if not chooses_rows(case):
            settings = replace(settings, every=every)
        report = run(Job(case.log, OutputSettings(output, to="parquet"), settings))
        return CaseRun(load_attitudes(AttitudeInput(output, "parquet")).series, report)


def chooses_rows(case: Case) -> bool:
    """Return whether the case itself says which attitudes are kept."""
    settings = case.propagation
    return any(choice is not None for choice in (settings.every, settings.rate, settings.at))


def compare_case(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> CaseComparison:
    """Compare the attitudes of a case, `a`, with others, `b`."""
    result = compare(a, b, case.comparison)
    named = partial(with_names, a="the log's attitudes", b="the reference")

    def since(t_ns: int) -> str:
        return f"+{duration_text(t_ns - result.association.first_ns)}"

    failures, first = [], result.first_exceeding
    if first is not None:
        failures.append(f"above the tolerance, first at {since(first.t_ns)} ({first.t_ns} ns)")
    failures += [
        named(criterion_text(one, result))
        for one in result.criteria
        if not one.passed and (one.setting, one.unit) != ("tol", "rad")
    ]
    cause = result.likely_cause
    causes = filter(None, (cause, cause and cause.also))
    sizes = filter(math.isfinite, (result.worst.error_rad, case.comparison.limit_rad))
    where, also = f"at {since(result.worst.t_ns)}", "".join(map(_also, result.criteria))
    return CaseComparison(
        error_rad=result.worst.error_rad,
        where=where,
        summary=f"{' of '.join(map(case.angle_text, sizes))} {where}{also}",
        failure="; ".join(failures),
        cause="; ".join(f"{named(one.sentence)} ({one.name})" for one in causes),
        report=result.report(),
    )


def try_compare(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> CaseComparison:
    """Compare as :func:`compare_case`, where attitudes that cannot be compared are a failure."""
    try:
        return compare_case(case, a, b)
    except ComparisonError as error:
        return CaseComparison(None, failure=str(error))


def compare_timestamps(a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Return how timestamps differ from those of a reference; empty where they do not."""
    if len(a) != len(b):
        return f"there are {len(a)} attitudes, and {len(b)} in the reference"
    (differing,) = (a.t_ns != b.t_ns).nonzero()
    if not len(differing):
        return ""
    first = int(differing[0])
    return (
        f"{len(differing)} of {len(a)} timestamps differ from the reference, the first at attitude "
        f"{first}: {a.t_ns[first]} ns, not {b.t_ns[first]} ns"
    )


def _also(criterion: Criterion) -> str:
    """Return the summary of a criterion other than the worst error; a failure says more itself."""
    if criterion.unit == "%":
        return f", {criterion.value:.4g} % of the reference covered"
    if criterion.unit == "sigma" and criterion.passed:
        return f", {criterion.label} {criterion.value:.3g} of {criterion.limit:.6g} sigma"
    return ""
