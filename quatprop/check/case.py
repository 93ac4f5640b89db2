"""The nouns of a regression: a case, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from quatprop.check.lock import Pin
    from quatprop.comparison import Settings
    from quatprop.pipeline.job import Job
    from quatprop.signals.compared_series import Reading

Verdict = Literal["pass", "fail", "error"]


@dataclass(frozen=True, slots=True)
class Case:
    """A log, how it is propagated, and what it is held against.

    Parameters
    ----------
    name
        Its name in the suite.
    job
        How its log is propagated; the output is chosen when it is run.
    settings
        How the attitudes are compared, the tolerance included.
    reference
        Where an update stores the reference; None where `external` is what it is held against.
    external
        A series from elsewhere, or a topic of a log.
    options
        What the suite says of the propagation, as it is written, without what is the default.
    inputs
        What is read: the key of the suite -> its path.
    strict
        Whether the stamps have to be those of the reference.
    pins_log
        Whether the log has to be the same bytes; not so if what is tested makes it.
    in_degrees
        Whether the tolerance is written in degrees; angles are then told in them.
    line
        Where it begins in the suite.
    """

    name: str
    job: Job
    settings: Settings
    reference: str | None
    external: Reading | None
    options: dict[str, str]
    inputs: dict[str, str]
    strict: bool = True
    pins_log: bool = True
    in_degrees: bool = False
    line: int = 1


@dataclass(frozen=True, slots=True)
class BrokenCase:
    """A case that says something that cannot be used.

    Parameters
    ----------
    name, line
        As for :class:`Case`.
    reason
        What is wrong, in a sentence that names the suite, the case and the key.
    """

    name: str
    reason: str
    line: int = 1


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of a case.

    Parameters
    ----------
    name, line
        Those of the case.
    verdict
        ``"pass"``; ``"fail"``: it was measured and is not as it was, or not within the tolerance;
        ``"error"``: it could not be judged.
    reason
        Why, in sentences; empty for a pass.
    figure
        The worst error against the tolerance, and where, in words; empty where there is none.
    error_rad
        The worst error, rad; None where there is none.
    notes
        What else is to be said.
    changes
        What an update has changed.
    updated
        What an update has done: ``"new"``, ``"updated"``, ``"kept"``; None without one.
    comparison
        The report of the comparison, where there was one.
    pin
        What the case rests on now, after an update.
    seconds
        How long it took.
    """

    name: str
    verdict: Verdict
    reason: str = ""
    figure: str = ""
    error_rad: float | None = None
    notes: tuple[str, ...] = ()
    changes: tuple[str, ...] = ()
    updated: str | None = None
    comparison: dict[str, Any] | None = None
    pin: Pin | None = field(default=None, repr=False)
    seconds: float = 0.0
    line: int = 1

    def report(self) -> dict[str, Any]:
        """Return what a script needs, JSON-ready; the same at every run."""
        return {
            "name": self.name,
            "verdict": self.verdict,
            "reason": self.reason or None,
            "error_rad": self.error_rad,
            "notes": list(self.notes),
            "updated": self.updated,
            "changes": list(self.changes),
            "comparison": self.comparison,
        }


def exit_code(outcomes: list[Outcome]) -> int:
    """Return 0 if all pass, 2 if one could not be judged, else 1 if one failed.

    As with diff and grep, trouble comes before a difference: where something could not be judged,
    the answer is incomplete.
    """
    verdicts = {outcome.verdict for outcome in outcomes}
    return 2 if "error" in verdicts else int("fail" in verdicts)
