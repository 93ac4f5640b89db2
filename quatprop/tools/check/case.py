"""The cases of a suite and their results."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from quatprop.base.errors import ComparisonError
from quatprop.base.rendering import degrees_text
from quatprop.base.text import Setting, plain, spelled
from quatprop.base.times import duration_text
from quatprop.comparison.comparison import compare
from quatprop.comparison.result import criterion_text, matching_text, with_names
from quatprop.propagation.attitude_input import AttitudeInput, LoadedAttitudes, load_attitudes
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings
from quatprop.settings import suite_key
from quatprop.settings.command_options import ComparisonSettings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from quatprop.base.text import Remark
    from quatprop.comparison.result import Comparison, Criterion
    from quatprop.kinematics.series import AttitudeSeries
    from quatprop.propagation.report import RunReport
    from quatprop.propagation.settings import PropagationSettings
    from quatprop.tools.check.expect import Expectations
    from quatprop.tools.check.lock import Pin


Verdict = Literal["pass", "fail", "error", "skip", "xfail", "xpass", "deleted"]


class Case(NamedTuple):
    """A log, the settings of its propagation, and the reference of its attitudes.

    `more`: further files of the same recording
    `comparison`: how the attitudes are compared, with the tolerance
    `reference`: path of the stored reference, which an update writes; None with `external`
    `external`: an independent attitude series, such as motion capture, or a topic of a log
    `options`: the propagation settings that differ from the default, as text
    `comparison_options`: the settings of the comparison and of the reference, by key, as text
    `inputs`: the files that are read: key of the suite -> path
    `strict`: whether the timestamps must equal those of the reference
    `pins_log`: whether the log must be the same bytes; False if the system under test makes it
    `in_degrees`: whether the limits are in degrees; results are then shown in degrees
    `xfail`: why the case is known to fail; empty if it must pass
    `suite`, `line`: the suite, and the line where the case begins
    `expect`: expectations of the log itself; None: nothing
    """

    name: str
    log: str
    propagation: PropagationSettings
    comparison: ComparisonSettings
    reference: str | None
    external: AttitudeInput | None
    options: Mapping[str, str]
    comparison_options: Mapping[str, str]
    inputs: Mapping[str, str]
    strict: bool
    pins_log: bool
    in_degrees: bool
    xfail: str
    suite: str
    line: int
    more: tuple[str, ...] = ()
    expect: Expectations | None = None

    @property
    def logs(self) -> tuple[str, ...]:
        """All files that are read as one log."""
        return (self.log, *self.more)

    @property
    def is_gate(self) -> bool:
        """Whether the log has no reference, but expectations."""
        return self.reference is None and self.external is None

    def angle_text(self, angle: float) -> str:
        """Return an angle, rad, in the unit of the tolerance."""
        return f"{math.degrees(angle):.6g} deg" if self.in_degrees else f"{angle:.3g} rad"


def is_log(key: str) -> bool:
    """Return whether the key of an input is that of a file of the log: ``log``, ``log-2``..."""
    return re.fullmatch(r"log(-\d+)?", key) is not None


class CaseNotRun(NamedTuple):
    """A case that is skipped, invalid, or only in the lock.

    `reason`: why it is skipped, or the error, with the suite, the case and the key
    `verdict`: ``"skip"``, ``"error"`` or ``"deleted"``
    """

    name: str
    reason: str
    verdict: Verdict = "error"
    line: int = 1


class Limit(NamedTuple):
    """A limit of a case and the measured value, as text.

    `key`: the key of the limit in the suite, such as ``"window-rms-tol"``
    `limit`: the limit with its word, such as ``"limit 0.1 deg"`` or ``"minimum 99 %"``
    `margin`: such as ``", margin 79 %"``; empty if the limit is exceeded, or nothing of it is used
    """

    key: str
    label: str
    value: str
    limit: str
    margin: str

    def __str__(self) -> str:
        return f"{self.label} {self.value} ({self.limit}{self.margin})"


class CaseResult(NamedTuple):
    """The result of a case.

    `verdict`: ``"pass"``; ``"fail"``: above the tolerance, or another number of samples than was
        pinned; ``"error"``: no result, because an input is missing or something pinned has changed;
        ``"skip"``: not run; ``"xfail"``: failed as expected; ``"xpass"``: passed unexpectedly;
        ``"deleted"``: pinned, but not in the suite
    `reason`: why the case did not pass; empty for a pass
    `summary`: the worst error, its time and the limits, or the output of an update; may be empty
    `error_rad`: the worst error, rad; None if nothing was compared
    `limits`: each limit with the measured value
    `notes`: remarks that do not change the verdict
    `remarks`: remarks on the log and on an independent reference
    `unpinned`: codes of the remarks that are not pinned
    `changes`: the changes of an update, and the distance of the new attitudes from the old ones
    `updated`: ``"new"``, ``"updated"`` or ``"kept"``; None without an update
    `comparison`: the report of the comparison, JSON-ready; None if nothing was compared
    `trace`: the error over time, rad: the maximum of each of at most 64 parts
    `evidence`: the folder with the evidence; None if none was kept
    """

    name: str
    verdict: Verdict
    reason: str = ""
    summary: str = ""
    error_rad: float | None = None
    limits: tuple[Limit, ...] = ()
    notes: tuple[str, ...] = ()
    remarks: tuple[Remark, ...] = ()
    unpinned: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    updated: str | None = None
    comparison: Mapping[str, object] | None = None
    trace: tuple[float, ...] = ()
    evidence: str | None = None
    pin: Pin | None = None
    seconds: float = 0.0
    line: int = 1

    def report(self) -> dict[str, object]:
        """Return the fields that do not change from run to run, for JSON."""
        fields = self._asdict()
        for name in ("trace", "pin", "seconds", "line"):
            del fields[name]
        return {**fields, "reason": self.reason or None}


def exit_code(results: Iterable[CaseResult]) -> int:
    """Return 0 if no case fails, 2 if there was an error, else 1.

    As with diff and grep, an error comes before a difference: the answer is incomplete.
    """
    verdicts = {result.verdict for result in results}
    return 2 if "error" in verdicts else int("fail" in verdicts)


# Run a case: propagate its log, and compare the attitudes.


MEASURE = ComparisonSettings(tol=math.inf, min_coverage=0.0)
"""Accepts every error, so that no causes are looked for."""

ALL = 99.9999
"""Coverage of a reference, %, that counts as complete: less only by rounding."""

SHOWN_DEG = 1e-6
"""Smallest rotation of an alignment that is shown, deg; smaller ones are rounding errors."""

TRACE_PARTS = 64
"""Number of points in a small plot of the error over time."""


class CaseRun(NamedTuple):
    """The attitudes of a case, and the file that contains them.

    `every`: every N-th attitude was kept; None if the case has settings for that, or all were kept
    """

    attitudes: LoadedAttitudes
    report: RunReport
    every: int | None

    @property
    def series(self) -> AttitudeSeries:
        """The attitudes themselves."""
        return self.attitudes.series

    @property
    def samples(self) -> int:
        """Number of samples that were propagated."""
        return self.report.result.samples


class CaseComparison(NamedTuple):
    """The comparison of the attitudes of a case with its reference.

    `result`: None if they cannot be compared
    `impossible`: why they cannot be compared; empty if they can
    `summary`: the worst error, its time, and the margin of each limit; empty without a result
    `failure`: why the error is not accepted; empty if it is accepted
    `cause`: the likely cause of the error; empty if unknown
    `trace`: the error over time, rad: the maximum of each part
    """

    result: Comparison | None
    impossible: str = ""
    summary: str = ""
    limits: tuple[Limit, ...] = ()
    failure: str = ""
    cause: str = ""
    trace: tuple[float, ...] = ()

    @property
    def covers_reference(self) -> bool:
        """Whether the required share of the reference was compared; all of it if none is set."""
        if self.result is None:
            return False
        asked = [one.passed for one in self.result.criteria if one.setting == "min_coverage"]
        return all(asked) if asked else self.result.coverage.least > ALL


def propagate_case(case: Case, every: int | None, folder: Path) -> CaseRun:
    """Propagate the log of a case to a file in a folder."""
    output = str(folder / f"attitude-{every}.parquet")
    settings = case.propagation
    if chooses_rows(case):
        every = None
    else:
        settings = replace(settings, every=every)
    report = run(Job(case.log, OutputSettings(output, to="parquet"), settings, case.more))
    return CaseRun(load_attitudes(AttitudeInput(output, "parquet")), report, every)


def propagate_all(case: Case, folder: Path) -> CaseRun:
    """Propagate the log of a case, keeping all attitudes whatever its settings."""
    settings = replace(case.propagation, every=None, rate=None, at=None)
    (place := folder / "all").mkdir(exist_ok=True)
    return propagate_case(case._replace(propagation=settings), None, place)


def chooses_rows(case: Case) -> bool:
    """Return whether the case has settings for the attitudes to keep."""
    settings = case.propagation
    return any(choice is not None for choice in (settings.every, settings.rate, settings.at))


def compare_case(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> CaseComparison:
    """Compare the attitudes of a case, `a`, with the reference, `b`."""
    named = partial(with_names, a="the log's attitudes", b="the reference series")
    try:
        result = compare(a, b, case.comparison)
    except ComparisonError as error:
        return CaseComparison(None, _no_overlap(case, a, b) or named(str(error)))

    def since(t_ns: int) -> str:
        return f"+{duration_text(t_ns - result.matching.first_ns)}"

    failures, first = [], result.first_exceeding
    if first is not None:
        failures.append(f"above the tolerance, first at {since(first.t_ns)} ({first.t_ns} ns)")
    limits, tolerance, others = [], "", []
    for criterion in result.criteria:
        limits.append(limit := _limit(case, criterion))
        if (criterion.setting, criterion.unit) == ("tol", "rad"):
            # The summary begins with the worst error; `failures` has the first one above.
            tolerance = f" ({limit.limit}{limit.margin})"
            continue
        others.append(str(limit))
        if not criterion.passed:
            failures.append(named(criterion_text(criterion, result)))
    if {"match", "max-dt"} & case.comparison_options.keys():
        others.append(named(matching_text(result.matching)))
    if judged := case.comparison_options.get("judge"):
        others.append(f"judged at {plain(judged)} alone")
    others += _alignment_texts(result)
    worst = case.angle_text(result.worst.error_rad)
    cause = result.likely_cause
    causes = cause.chain if cause else []
    parts = np.array_split(result.errors, min(TRACE_PARTS, len(result.errors)))
    return CaseComparison(
        result,
        summary="; ".join([f"max error {worst} at {since(result.worst.t_ns)}{tolerance}", *others]),
        limits=tuple(limits),
        failure="; ".join(failures),
        cause="; ".join(f"{named(step.sentence)} ({step.name})" for step in causes),
        trace=tuple(float(part.max()) for part in parts),
    )


def _alignment_texts(result: Comparison) -> Iterator[str]:
    """Yield the time offset and the rotations by which the reference was aligned."""
    if offset := result.time_offset.added_to_b_ns:
        yield f"with the reference timestamps shifted by {duration_text(offset)}"
    for frame, angle in (
        ("reference frame", result.alignment.reference_rad),
        ("body frame", result.alignment.mount_rad),
    ):
        if math.degrees(angle) > SHOWN_DEG:
            yield f"with the {frame} of the reference attitudes rotated by {degrees_text(angle)}"


def _limit(case: Case, criterion: Criterion) -> Limit:
    """Return a criterion as text."""
    key = suite_key(criterion.setting)
    if criterion.unit == "%":
        limit = f"minimum {criterion.limit:.6g} %"
        return Limit(key, "coverage", f"{criterion.value:.4g} %", limit, "")
    if criterion.unit == "rad":
        value, limit = case.angle_text(criterion.value), case.angle_text(criterion.limit)
    else:
        value = f"{criterion.value:.3g} {criterion.unit}"
        limit = f"{criterion.limit:.6g} {criterion.unit}"
    used = abs(criterion.value) / criterion.limit if criterion.limit else 1.0
    shows_margin = criterion.passed and used > 0
    margin = f", margin {100 * (1 - used):.0f} %" if shows_margin else ""
    return Limit(key, criterion.label, value, f"limit {limit}", margin)


def _no_overlap(case: Case, a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Return an error if two series have no time in common; empty if they overlap.

    It does not suggest the offset between them, which would be different in the next run.
    """
    offset = case.comparison.time_offset
    t_a, t_b = a.t_ns, b.t_ns + (offset if isinstance(offset, int) else 0)
    if not len(a) or not len(b) or (t_a.min() <= t_b.max() and t_b.min() <= t_a.max()):
        return ""
    spans = [f"from {t.min()} to {t.max()} ns" for t in (t_a, t_b)]
    ways = [Setting("clock"), Setting("start"), Setting("time_unit")]
    if case.external is not None:
        ways += [Setting("clock", side="b"), Setting("time_offset", "auto")]
    return spelled(
        f"the log's attitudes ({spans[0]}) and the reference attitudes ({spans[1]}) have no "
        f"time in "
        "common: their timestamps are from different clocks or different recordings; see "
        f"{', '.join(ways)}"
    )


def distance_text(a: AttitudeSeries, b: AttitudeSeries) -> tuple[str, float]:
    """Return the distance between attitudes, without alignment, as text, or why it is unknown.

    The second value is the percentage of `b` that was compared.
    """
    try:
        result = compare(a, b, MEASURE)
    except ComparisonError as error:
        named = with_names(str(error), a="the new attitudes", b="the old reference")
        return f"not comparable with the old reference: {named}", 0.0
    sizes = zip(("max", "RMS", "final"), largest_errors(result), strict=True)
    # Rounding errors are not a change.
    sentence = ", ".join(f"{name} {degrees_text(round(size, 12))}" for name, size in sizes)
    share = result.coverage.least
    part = "the old reference" if share > ALL else f"the {share:.4g} % of the old reference covered"
    return f"{sentence} from {part}", share


def largest_errors(result: Comparison) -> tuple[float, float, float]:
    """Return the worst, the RMS and the final error, rad."""
    return result.error_rad.max, result.error_rad.rms, result.error_rad.final


def compare_timestamps(a: AttitudeSeries, b: AttitudeSeries) -> str:
    """Return how timestamps differ from those of a reference; empty if they do not."""
    if len(a) != len(b):
        return f"there are {len(a)} attitudes, and {len(b)} reference attitudes"
    (differing,) = (a.t_ns != b.t_ns).nonzero()
    if not len(differing):
        return ""
    first = int(differing[0])
    return (
        f"{len(differing)} of {len(a)} timestamps differ from those of the reference file, "
        f"the first at attitude "
        f"{first}: {a.t_ns[first]} ns, not {b.t_ns[first]} ns"
    )
