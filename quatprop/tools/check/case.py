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
    """A log, the settings of its propagation, and the reference of its attitudes.

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

    def angle_text(self, angle: float) -> str:
        """Return an angle, rad, in the unit of the tolerance."""
        return f"{math.degrees(angle):.6g} deg" if self.in_degrees else f"{angle:.3g} rad"


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
    `left`: the margin, such as ``"79 % left"``; empty if the limit is exceeded
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
