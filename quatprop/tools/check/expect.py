"""Expectations on the log of a case: rate, gaps, topics, and that its sources agree.

They need no reference, so they are a gate for new logs too.
"""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from quatprop.base.errors import UsageError, os_reason
from quatprop.base.guarded_text import ContentError, read_toml
from quatprop.base.rendering import count_text, degrees_text
from quatprop.base.text import did_you_mean, listed, plain, quoted, spelled
from quatprop.base.times import NS_PER_S
from quatprop.propagation.conditioning.static_detection import NoRestError
from quatprop.propagation.rate_stream import RateSettings, RateStream
from quatprop.propagation.recording import open_recording
from quatprop.settings.bias import StaticBias
from quatprop.settings.crosscheck_options import CROSSCHECK, READ, allowed
from quatprop.settings.parsers import Choice, frequency, parts_of
from quatprop.settings.quantities import RATE_UNITS, RATES, RATIOS, quantity_of
from quatprop.timeline.counts import Policy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from quatprop.base.errors import Loss
    from quatprop.propagation.settings import PropagationSettings
    from quatprop.tools.crosscheck.result import Finding

RATE_TOLERANCE: Final = 0.01
"""Tolerance of the expected sample rate, unless the case sets another one."""


class Expectations(NamedTuple):
    """Expectations on a log; None: none.

    `rate`: usual sample rate, Hz, within `rate_tol`, a ratio
    `gaps`, `drops`: greatest number of gaps, and of samples that are lost or cannot be used
    `topics`: names of topics that must be there
    `unit`: of the rates
    `noise`: greatest RMS of the rates at rest about their mean, on the noisiest axis, rad/s
    `agree`: limits of the differences between the sources of rotation, as text
    `allow`: differences between them that are no failure
    """

    rate: float | None = None
    rate_tol: float = RATE_TOLERANCE
    gaps: int | None = None
    drops: int | None = None
    topics: tuple[str, ...] = ()
    unit: str | None = None
    noise: float | None = None
    agree: Mapping[str, Any] | None = None
    allow: tuple[str, ...] = ()

    @property
    def given(self) -> list[str]:
        """The names of what is expected."""
        values = self._asdict()
        names = [name for name, value in values.items() if value not in (None, ())]
        return [name for name in names if name != "rate_tol" or self.rate is not None]


def _at_most(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise UsageError(f"{quoted(value)} is not a whole number; write 0 or more")
    return value


def _limits(value: object) -> dict[str, Any]:
    """Return the parsed limits by name.

    `orientation` is the limit of the rotation between the rates and the orientation of one device
    """
    if not isinstance(value, dict):
        raise UsageError('this is a table of limits, such as { offset = "20ms", mount = "3deg" }')
    names = {"orientation": "tol_mount"}
    names |= {name: f"tol_{name}" for name in ("offset", "mount", "scale", "bias")}
    for name in value:
        if name not in names:
            hint = did_you_mean(name, sorted(names))
            raise UsageError(
                f"{quoted(name)} is not a limit{hint}; there are {listed(sorted(names))}"
            )
    return {name: CROSSCHECK[names[name]](limit) for name, limit in value.items()}


PARSERS: Final[Mapping[str, Callable[[object], Any]]] = {
    "rate": lambda value: float(frequency(value)),
    "rate-tol": quantity_of({**RATIOS, "": 1.0}, "a ratio", "2%"),
    "gaps": _at_most,
    "drops": _at_most,
    "topics": lambda value: tuple(str(name) for name in parts_of(value)),
    "unit": Choice(*RATE_UNITS),
    "noise": quantity_of(RATES, "a rate", "0.2deg/s"),
    "agree": _limits,
    "allow": allowed,
}
"""Key of the table ``expect`` -> parser of its value."""


def expectations(table: Mapping[str, object]) -> Expectations:
    """Return the expectations of a table ``expect``."""
    values = {}
    for key, value in table.items():
        if key not in PARSERS:
            hint = did_you_mean(key, sorted(PARSERS), f"there are {listed(sorted(PARSERS))}")
            raise UsageError(f"'expect' has no key {quoted(key)}{hint}")
        try:
            values[key.replace("-", "_")] = PARSERS[key](value)
        except UsageError as error:
            raise UsageError(f"'expect', {quoted(key)}: {error}") from error
    return Expectations(**values)


def read_expectations(source: str | Mapping[str, object]) -> Expectations:
    """Return the expectations in a TOML file, or in a mapping, with the same keys."""
    if not isinstance(source, str):
        return expectations(source)
    try:
        return expectations(read_toml(Path(source).read_bytes()))
    except (ContentError, UsageError) as error:
        raise UsageError(f"{plain(source)}: {error}") from error
    except OSError as error:
        raise UsageError(f"{plain(source)}: {os_reason(error)}") from error


def unmet(logs: Sequence[str], reading: PropagationSettings, wanted: Expectations) -> Iterator[str]:
    """Yield a sentence for each unmet expectation of a recording, in one file or several.

    `reading`: how its rates are read
    """
    with open_recording(logs, reading.selection, reading.kind) as recording:
        names = [table.name for table in recording.tables.tables()]
        for topic in wanted.topics:
            if topic not in names:
                there = listed(sorted(filter(None, names))) or "none"
                yield f"topic {quoted(topic)} is missing; the topics are {there}"
        if any(getattr(wanted, name) is not None for name in ("rate", "gaps", "drops", "unit")):
            stream = RateStream(recording, RateSettings(Policy("drop", "drop")))
            deque(stream, maxlen=0)
            yield from _of_rates(stream, wanted, recording.losses)
        if wanted.noise is not None:
            stream = RateStream(recording, RateSettings(Policy("drop", "drop")))
            yield from _at_rest(stream, wanted.noise)
    if wanted.agree is not None:
        yield from _agreeing(logs, reading, wanted)


def _of_rates(stream: RateStream, wanted: Expectations, losses: Sequence[Loss]) -> Iterator[str]:
    counts = stream.counts
    if wanted.rate is not None:
        rate = NS_PER_S / counts.median_dt_ns if counts.median_dt_ns else 0.0
        if abs(rate - wanted.rate) > wanted.rate_tol * wanted.rate:
            tolerance = f"{100 * wanted.rate_tol:.3g} %"
            yield f"the sample rate is {rate:.6g} Hz, expected {wanted.rate:.6g} Hz +- {tolerance}"
    if wanted.gaps is not None and counts.gaps.count > wanted.gaps:
        first = f", the first before {counts.gaps.first_ns} ns"
        yield f"{count_text(counts.gaps.count, 'gap')}, expected at most {wanted.gaps}{first}"
    dropped = counts.dropped + sum(one.messages or 1 for one in losses)
    if wanted.drops is not None and dropped > wanted.drops:
        least = "at least " if any(one.messages is None for one in losses) else ""
        yield f"{least}{count_text(dropped, 'sample')} lost, expected at most {wanted.drops}"
    if wanted.unit is not None and stream.source.unit != wanted.unit:
        yield f"the rates are in {stream.source.unit}, expected {wanted.unit}"


def _at_rest(stream: RateStream, limit: float) -> Iterator[str]:
    try:
        rests = stream.stationary_periods(StaticBias())
    except NoRestError as error:
        yield f"the noise at rest is unknown: {spelled(error.text)}"
        return
    noisiest = max(rest.noisiest_rad_s for rest in rests)
    if noisiest > limit:
        found, most = (degrees_text(rate, 4) for rate in (noisiest, limit))
        yield f"the noise at rest is {found}/s, expected at most {most}/s"


def _agreeing(
    logs: Sequence[str], reading: PropagationSettings, wanted: Expectations
) -> Iterator[str]:
    from quatprop.tools.crosscheck.analysis import crosscheck_logs
    from quatprop.tools.crosscheck.pair import Tolerances

    limits = dict(wanted.agree or {})
    usual = Tolerances().mount
    of_mount, of_device = limits.pop("mount", usual), limits.pop("orientation", usual)
    values = {f"tol_{name}": limit for name, limit in limits.items()}
    values["tol_mount"] = min(of_mount, of_device)
    own = {name: getattr(reading.selection, name, None) for name in READ if name != "topic"}
    values |= {name: value for name, value in own.items() if value is not None}
    values |= {"kind": reading.kind} if reading.kind else {}
    result = crosscheck_logs(logs, {**values, "allow": wanted.allow}).result
    if result.state == "nothing to compare":
        yield "there are no two sources of rotation to compare"
    if result.state == "consistent in part":
        yield f"no other source agrees with {listed(result.unconfirmed)}"
    devices = {each.name: each.device for each in result.sources}

    def is_within(finding: Finding) -> bool:
        """Return whether another limit than that which was used allows a rotation."""
        owner = devices.get(finding.source, finding.source)
        limit = of_device if devices.get(finding.against) == owner else of_mount
        is_mount = finding.code == "mount" and limit is not None
        return is_mount and finding.numbers["deg"] <= math.degrees(limit)

    for finding in result.findings:
        if finding.level != "remark" and not is_within(finding):
            remedy = f" ({finding.remedy})" if finding.remedy else ""
            yield f"{plain(finding.source)} {plain(finding.text)}{remedy}"
