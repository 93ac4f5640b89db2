"""Remarks on the log and the reference of a case, by the codes that a lock pins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.comparison.summary import with_names
from quatprop.text import Remark, plain, spelled

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.check.case import Case
    from quatprop.check.case_run import CaseComparison, CaseRun
    from quatprop.logs.attitude_input import LoadedAttitudes


def remarks_of(
    case: Case, run: CaseRun, reference: LoadedAttitudes | None, comparison: CaseComparison | None
) -> dict[str, Remark]:
    """Return the remarks on the log and on an independent reference, by code."""
    remarks = [remark.spelled(spelled) for remark in run.report.remarks]
    if case.external is not None and reference is not None:
        result = comparison and comparison.result
        for remark in (*reference.signal.remarks, *(result.remarks if result else ())):
            text = with_names(spelled(remark), a="the log's attitudes", b="the reference series")
            remarks.append(Remark(f"reference: {remark.code}", text))
    remarks += loss_notes(case, run, reference)
    return {remark.code: remark for remark in remarks}


def loss_notes(case: Case, run: CaseRun, reference: LoadedAttitudes | None) -> Iterator[Remark]:
    """Yield a note if data of the log or of the reference were lost."""
    lost = "data of {} were lost or omitted, see {}"
    if run.report.data_lost:
        yield Remark("data-lost", lost.format(plain(case.log), "propagate"))
    if case.external is not None and reference is not None and reference.data_lost:
        text = lost.format(plain(case.external.path), "compare")
        yield Remark("reference: data-lost", text)
