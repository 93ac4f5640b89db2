"""Cross-check sources of rotation: health of each, pairs, and who is to blame."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Final, NamedTuple

from quatprop.base.times import NS_PER_S
from quatprop.estimation.turning import turning_of_attitudes, turning_of_rates
from quatprop.settings.crosscheck_options import READ
from quatprop.tools.crosscheck.blame import Blame, all_not_shown
from quatprop.tools.crosscheck.health import constant_findings, copies, frozen_findings, health_of
from quatprop.tools.crosscheck.pair import Tolerances
from quatprop.tools.crosscheck.pairs import compare_pair, ordered
from quatprop.tools.crosscheck.repairs import applied
from quatprop.tools.crosscheck.result import LEVELS, CrossCheck, Finding
from quatprop.tools.crosscheck.sources import Sources, sources_of

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from typing import Any

    from quatprop.estimation.turning import Turning
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.tools.crosscheck.health import Health
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.sources import Source

MAX_FOR_ALL: Final = 8
"""Number of sources above which each is compared with one root only, and within its device."""

OTHER_CLOCK_NS: Final = 10**15
"""Sources that begin farther apart have clocks with different zeros, ns: 11 days."""


class Analysis(NamedTuple):
    """A cross-check, and what it was computed from.

    `turning`: integrals of each usable source, by its name
    `zeros_ns`: see :func:`zeros_ns`
    """

    result: CrossCheck
    turning: Mapping[str, Turning]
    zeros_ns: Mapping[str, int]


def crosscheck(
    sources: Sequence[Source],
    *,
    tolerances: Tolerances | None = None,
    allowed: Collection[str] = (),
    read: Sources | None = None,
) -> Analysis:
    """Return the faults of sources of rotation, and the differences between them.

    `allowed`: codes of differences that are remarks, not reasons to fail
    `read`: unread sources, losses and remarks of the logs
    """
    read, limits = read or Sources([], [], [], []), tolerances or Tolerances()
    states = [health_of(source) for source in sources]
    usable = [state for state in states if state.usable]
    same = copies([state.source for state in usable])
    findings = [finding for state in states for finding in state.findings]
    if not usable:  # a body that does not turn has no rates
        findings = [replace(one, level="remark") for one in findings if one.code == "dead"]
    findings += [
        Finding(
            level="remark", code="copy", source=copy, against=first,
            text=f"a copy of {first}, not a second measurement",
        )
        for copy, first in same.items()
    ]  # fmt: skip
    usable = [state for state in usable if state.source.name not in same]
    turning: dict[str, Turning] = {}
    pairs: list[Pair] = []
    zeros: dict[str, int] = {}
    if usable:
        zeros = zeros_ns([state.source for state in usable])
        turning = {one.source.name: _turning(one, zeros[one.source.name]) for one in usable}
        pairs = [
            compare_pair(a, b, turning[a.name], turning[b.name], limits)
            for one, other in _to_compare([state.source for state in usable], turning)
            for a, b in (ordered(one, other, turning),)
        ]
        findings += frozen_findings(usable, pairs, turning, zeros)
        findings += constant_findings(usable, pairs, turning)
    broken: dict[str, int] = {}
    for finding in findings:
        broken[finding.source] = broken.get(finding.source, 0) + 1
    judged = Blame(pairs, turning, broken, limits, allowed)
    findings += judged.findings()
    findings.sort(key=lambda one: LEVELS.index(one.level))
    result = CrossCheck(
        sources=tuple(sources),
        findings=tuple(findings),
        pairs=tuple(pairs),
        not_shown=all_not_shown(pairs),
        notes={state.source.name: state.notes for state in states},
        unread=tuple(read.unread),
        losses=tuple(read.losses),
        remarks=tuple(read.remarks),
        allowed=tuple(allowed),
    )
    return Analysis(result, turning, zeros)


def crosscheck_logs(
    logs: Sequence[str | GyroSeries | AttitudeSeries], values: Mapping[str, Any]
) -> Analysis:
    """Return the cross-check of every source in logs, and of series in memory.

    `values`: parsed settings of a cross-check
    """
    read = sources_of(logs, {name: values[name] for name in READ if name in values})
    given = {name: values.get(f"tol_{name}") for name in ("mount", "scale", "bias")}
    if (offset := values.get("tol_offset")) is not None:
        given["offset"] = float(offset) / NS_PER_S
    tolerances = Tolerances(**{name: one for name, one in given.items() if one is not None})
    return crosscheck(
        applied(read.found, values.get("correct", {})),
        tolerances=tolerances,
        allowed=values.get("allow", ()),
        read=read,
    )


def zeros_ns(sources: Sequence[Source]) -> dict[str, int]:
    """Return the zero of the clock of each source by name: when the first one on that clock begins.

    A zero for each source would hide the offset of two that are on one clock.
    """
    zeros: dict[str, int] = {}
    zero = before = 0
    for source in sorted(sources, key=lambda one: int(one.t_ns[0])):
        begin = int(source.t_ns[0])
        if not zeros or begin - before > OTHER_CLOCK_NS:
            zero = begin
        zeros[source.name], before = zero, begin
    return zeros


def _turning(state: Health, zero_ns: int) -> Turning:
    """Return the integrals of the rates of a source.

    `zero_ns`: of its clock
    """
    source = state.source
    if source.is_rates:
        return turning_of_rates(
            source.t_ns, source.values, zero_ns, state.shown, is_average=source.is_average
        )
    return turning_of_attitudes(source.t_ns, source.values, zero_ns, state.shown, state.jumps)


def _to_compare(
    sources: Sequence[Source], turning: dict[str, Turning]
) -> list[tuple[Source, Source]]:
    """Return the pairs to compare: all, or of many those with one root and within a device.

    Two transforms are about different bodies, so they are not compared.
    """
    pairs = [(a, b) for a, b in combinations(sources, 2) if a.frames is None or b.frames is None]
    if len(sources) <= MAX_FOR_ALL:
        return pairs

    def rank(source: Source) -> tuple[bool, int, bool, float]:
        own = turning[source.name]
        return source.frames is not None, -int(own.shown.sum()), not source.is_rates, own.interval

    root = min(sources, key=rank)
    return [(a, b) for a, b in pairs if root in (a, b) or a.device == b.device]
