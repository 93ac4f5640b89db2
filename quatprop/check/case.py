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

Verdict = Literal["pass", "fail", "error", "skip", "xfail", "xpass", "deleted"]


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
    `in_degrees`: whether the limits are written in degrees; results are then shown in degrees
    `xfail`: why the case is known to fail; empty where it must pass
    `suite`, `line`: the suite, and its line where the case begins
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
    suite: str = ""
    line: int = 1

    def angle_text(self, angle: float) -> str:
        """Return an angle, rad, in the unit of the tolerance."""
        return f"{math.degrees(angle):.6g} deg" if self.in_degrees else f"{angle:.3g} rad"


class CaseNotRun(NamedTuple):
    """A case that is skipped, cannot be used as written, or is in the lock alone.

    `reason`: why it is skipped; or what is wrong, with the suite, the case and the key
    `verdict`: ``"skip"``, ``"error"`` or ``"deleted"``
    """

    name: str
    reason: str
    verdict: Verdict = "error"
    line: int = 1


class Limit(NamedTuple):
    """A limit of a case, and what was measured, as text.

    `key`: the key of the suite that gives the limit, such as ``"window-rms-tol"``
    `left`: what is left of it, such as ``"79 % left"``; empty where nothing is
    """

    key: str
    label: str
    value: str
    limit: str
    left: str

    def __str__(self) -> str:
        rest = f", {self.left}" if self.left else ""
        return f"{self.label} {self.value} of {self.limit}{rest}"


class CaseResult(NamedTuple):
    """The result of a case.

    `verdict`: ``"pass"``; ``"fail"``: above the tolerance, or not the samples that were pinned;
        ``"error"``: there is no result, because an input is missing or something has changed;
        ``"skip"``: it was not run; ``"xfail"``: it failed, as it is known to do; ``"xpass"``: it
        passed, though it is known to fail; ``"deleted"``: it is pinned, and not in the suite
    `reason`: why it did not pass; empty for a pass
    `summary`: the worst error, the limits and where, or what an update wrote; may be empty
    `error_rad`: the worst error, rad; None where nothing was compared
    `limits`: each limit, with what was measured
    `notes`: remarks that do not change the verdict
    `remarks`: on the log and an independent reference
    `unpinned`: codes of those that are not pinned
    `changes`: what an update replaces, and how far the new attitudes are from the old ones
    `updated`: ``"new"``, ``"updated"`` or ``"kept"``; None if this was no update
    `comparison`: the report of the comparison, JSON-ready; None where nothing was compared
    `trace`: the error over time, rad, the largest of each of at most 64 parts
    `evidence`: the folder with the evidence; None where none was kept
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
        """Return the fields that are the same in every run, for JSON."""
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
