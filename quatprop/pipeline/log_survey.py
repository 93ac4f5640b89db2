"""What a survey of a log gives: its signals, and what is known of each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from quatprop.provenance import JsonObject, entry_of
from quatprop.text import in_python, listed

if TYPE_CHECKING:
    from quatprop.tables.log import Loss
    from quatprop.text import Remark
    from quatprop.timeline.counts import Counts


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSurvey:
    """One signal of a log; None where something is unknown.

    `source`, `type`: topic and message type, or columns and dialect
    `rate_hz`, `span_s`: mean sample rate, Hz, and time from the first sample to the last, s
    `first_ns`, `last_ns`: first and last stamp, ns
    `median_dt_ns`, `min_dt_ns`, `max_dt_ns`: intervals, ns
    `gaps`, `duplicates`, `backwards`: intervals longer than 10 median ones, repeated timestamps,
        and those that go backwards or are outliers
    `missing`: what is not declared, and the settings that declare it; None if nothing is missing
    `remarks`: what a reader should know
    """

    source: str | None
    type: str = ""
    clock: str | None = None
    samples: int | None = None
    rate_hz: float | None = None
    span_s: float | None = None
    first_ns: int | None = None
    last_ns: int | None = None
    median_dt_ns: int | None = None
    min_dt_ns: int | None = None
    max_dt_ns: int | None = None
    gaps: int | None = None
    duplicates: int | None = None
    backwards: int | None = None
    missing: str | None = None
    remarks: tuple[Remark, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSurvey(SignalSurvey):
    """One signal of body rates; takes the parameters of :class:`SignalSurvey` too.

    `rate`, `rate_unit`: the field or the columns, and their unit
    `nonfinite`: samples that are NaN or infinite
    `max_rate_rad_s`, `max_rate_deg_s`: largest magnitude of the angular rate
    """

    rate: str | None = None
    rate_unit: str | None = None
    nonfinite: int | None = None
    max_rate_rad_s: float | None = None
    max_rate_deg_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSurvey(SignalSurvey):
    """One signal of attitudes; takes the parameters of :class:`SignalSurvey` too.

    `attitude`: the field or the columns
    `invalid`: rows that are no unit quaternions
    `method`, `made_from`, `q0_wxyz`: how they were made, as the metadata of their file say: the
        integration rule, the log of the rates, and the first attitude (Hamilton, body -> reference,
        scalar first)
    """

    attitude: str = ""
    layout: str | None = None
    convention: str | None = None
    direction: str | None = None
    invalid: int | None = None
    method: str | None = None
    made_from: str | None = None
    q0_wxyz: tuple[float, ...] | None = None


SignalT = TypeVar("SignalT", bound=SignalSurvey)


@dataclass(frozen=True, slots=True)
class LogSurvey:
    """What a log holds.

    Parameters
    ----------
    path, kind
        The log, and what it is.
    sources, attitudes
        Its signals of body rates and of attitudes. Each has a `source` (topic or columns), `type`,
        `clock`, `samples`, `rate_hz`, `span_s`, `first_ns`, `last_ns`, `gaps`, `duplicates`,
        `backwards`, `remarks`, and `missing`: the settings that it needs to be read.
    losses
        What could not be read.
    """

    path: str
    kind: str
    sources: tuple[RateSurvey, ...]
    attitudes: tuple[AttitudeSurvey, ...]
    losses: tuple[Loss, ...]

    def __repr__(self) -> str:
        sources = [f"{one.source} ({one.samples})" for one in (*self.sources, *self.attitudes)]
        return f"<LogSurvey: {self.path} ({self.kind}): {listed(sources) or 'nothing'}>"

    def in_python(self) -> LogSurvey:
        """Return it with settings spelled as keywords."""

        def spelled(one: SignalT) -> SignalT:
            missing = one.missing and in_python(one.missing)
            return replace(
                one,
                missing=missing,
                remarks=tuple(remark.spelled(in_python) for remark in one.remarks),
            )

        sources, attitudes = tuple(map(spelled, self.sources)), tuple(map(spelled, self.attitudes))
        return replace(self, sources=sources, attitudes=attitudes)


def timing(counts: Counts) -> dict[str, Any]:
    """Return what a survey says of stamps, by name."""
    span_s = counts.span_ns * 1e-9
    return {
        "rate_hz": (counts.used - 1) / span_s if span_s > 0 else None,
        "span_s": span_s,
        "first_ns": counts.first_ns,
        "last_ns": counts.last_ns,
        "median_dt_ns": counts.median_dt_ns,
        "min_dt_ns": counts.min_dt_ns,
        "max_dt_ns": counts.max_dt_ns,
        "gaps": counts.gaps.count,
        "duplicates": counts.duplicates.count,
        "backwards": counts.backwards.count + counts.outliers.count,
    }


def making(provenance: JsonObject) -> dict[str, Any]:
    """Return how attitudes were made; what is not as this package writes it is left out."""
    convention = entry_of(provenance, "convention", dict)
    q0 = entry_of(convention, "q0_wxyz", list)
    return {
        "method": entry_of(convention, "method", str) or None,
        "made_from": entry_of(entry_of(provenance, "source", dict), "path", str) or None,
        "q0_wxyz": tuple(q0) if [type(x) for x in q0] == [float] * 4 else None,
    }
