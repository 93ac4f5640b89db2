"""The cases of a suite and their results."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from quatprop.check.lock import Pin
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.logs.attitude_input import AttitudeInput
    from quatprop.pipeline.settings import PropagationSettings
    from quatprop.text import Remark

Verdict = Literal["pass", "fail", "error", "skip", "xfail", "xpass"]


class Case(NamedTuple):
    """A log, how it is propagated, and what the attitudes are compared with.

    `comparison`: how the attitudes are compared, with the tolerance
    `reference`: path of the stored reference, which an update writes; None where there is
        `external`
    `external`: an independent attitude series, such as motion capture, or a topic of a log
    `options`: the propagation settings of the suite that are not the default, as text
    `comparison_options`: the settings of the comparison and of the reference, by key, as text
    `inputs`: the files that are read: key of the suite -> path
    `strict`: whether the timestamps must be those of the reference, all of them and no others
    `pins_log`: whether the log must be the same bytes; False where the system under test makes the
        log
    `in_degrees`: whether the tolerance is written in degrees; results are then shown in degrees
    `xfail`: why the case is known to fail; empty where it must pass
    `line`: line of the suite where the case begins
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
    strict: bool = True
    pins_log: bool = True
    in_degrees: bool = False
    xfail: str = ""
    line: int = 1

    def angle_text(self, angle: float) -> str:
        """Return an angle, rad, in the unit of the tolerance."""
        return f"{math.degrees(angle):.6g} deg" if self.in_degrees else f"{angle:.3g} rad"


class CaseNotRun(NamedTuple):
    """A case that the suite skips, or with a key or a value that cannot be used.

    `reason`: why it is skipped; or what is wrong, with the suite, the case and the key
    `verdict`: ``"skip"`` or ``"error"``
    """

    name: str
    reason: str
    verdict: Verdict = "error"
    line: int = 1


class CaseResult(NamedTuple):
    """The result of a case.

    `verdict`: ``"pass"``; ``"fail"``: above the tolerance, or not the samples that were pinned;
        ``"error"``: there is no result, because an input is missing or something has changed;
        ``"skip"``: it was not run; ``"xfail"``: it failed, as it is known to do; ``"xpass"``: it
        passed, though it is known to fail
    `reason`: why it did not pass; empty for a pass
    `summary`: the worst error, the tolerance and where, or what an update wrote; may be empty
    `error_rad`: the worst error, rad; None where nothing was compared
    `notes`: remarks that do not change the verdict
    `remarks`: on the log, as a propagation makes them
    `updated`: ``"new"``, ``"updated"`` or ``"kept"``; None if this was no update
    `comparison`: the report of the comparison, JSON-ready; None where nothing was compared
    """

    name: str
    verdict: Verdict
    reason: str = ""
    summary: str = ""
    error_rad: float | None = None
    notes: tuple[str, ...] = ()
    remarks: tuple[Remark, ...] = ()
    changes: tuple[str, ...] = ()
    updated: str | None = None
    comparison: Mapping[str, object] | None = None
    pin: Pin | None = None
    seconds: float = 0.0
    line: int = 1

    def report(self) -> dict[str, object]:
        """Return the fields that are the same in every run, for JSON."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "reason": self.reason or None,
            "error_rad": self.error_rad,
            "notes": self.notes,
            "remarks": self.remarks,
            "updated": self.updated,
            "changes": self.changes,
            "comparison": self.comparison,
        }


def exit_code(results: Iterable[CaseResult], *, strict: bool = False) -> int:
    """Return 0 if no case fails, 2 if there was an error, else 1.

    As with diff and grep, an error comes before a difference: the answer is incomplete. If it is
    `strict`, a case that passes unexpectedly is a failure.
    """
    verdicts = {result.verdict for result in results}
    return 2 if "error" in verdicts else int("fail" in verdicts or (strict and "xpass" in verdicts))
