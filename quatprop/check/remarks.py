"""Remarks on the log and the reference of a case, and the codes by which they are pinned."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from quatprop.comparison.summary import with_names
from quatprop.text import plain, spelled

if TYPE_CHECKING:
    from quatprop.check.case import Case
    from quatprop.check.case_run import CaseComparison, CaseRun
    from quatprop.logs.attitude_input import LoadedAttitudes

MAX_CODE = 100
"""Characters of a code."""


def code_of(remark: str) -> str:
    """Return by what a remark is recognised when its sentence or its numbers change."""
    if code := getattr(remark, "code", ""):
        return str(code)
    masked = re.sub(r"'[^']*'|[-+]?\d[\d.,]*(e[-+]?\d+)?", "#", spelled(remark))
    return masked[:MAX_CODE].rstrip()


def remarks_of(
    case: Case, run: CaseRun, reference: LoadedAttitudes | None, comparison: CaseComparison | None
) -> dict[str, str]:
    """Return what was remarked on the log and on an independent reference: code -> sentence."""
    found = {code_of(remark): spelled(remark) for remark in run.report.remarks}
    if case.external is not None and reference is not None:
        result = comparison and comparison.result
        names = {"a": "the log's attitudes", "b": "the reference"}
        for remark in (*reference.signal.remarks, *(result.remarks if result else ())):
            found[f"reference: {code_of(remark)}"] = with_names(spelled(remark), **names)
    return found | loss_notes(case, run, reference)


def loss_notes(case: Case, run: CaseRun, reference: LoadedAttitudes | None) -> dict[str, str]:
    """Return a note where data of the log or of the reference were lost: code -> sentence."""
    notes = {}
    if run.report.data_lost:
        notes["data-lost"] = f"data of {plain(case.log)} were lost or left out, see propagate"
    if case.external is not None and reference is not None and reference.data_lost:
        lost = f"data of {plain(case.external.path)} were lost or left out, see compare"
        notes["reference: data-lost"] = lost
    return notes
