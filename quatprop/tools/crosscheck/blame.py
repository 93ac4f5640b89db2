"""Which source a difference is about: one finding for each fact.

Sources of one message contradict themselves. Of different devices, each is compared with the one
that most others agree with; where only two remain, either may be the one that is wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.settings.crosscheck_options import FACTS
from quatprop.tools.crosscheck.facts import DEG, Side, Statement, Tolerances
from quatprop.tools.crosscheck.pair import FEW, groups
from quatprop.tools.crosscheck.result import Finding
from quatprop.tools.crosscheck.statements import not_shown, statements_of
from quatprop.tools.crosscheck.witnesses import REMARKS, as_others_see

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.sources import Source
    from quatprop.tools.crosscheck.witnesses import Statements

FAULTS: Final = frozenset({"reading", "inertial", "mirrored", "unit", "reversed"})
"""Facts that are faults even between devices."""

APART: Final = frozenset({"unit", "reading", "inertial", "scale", "bias"})
"""Statements about one source that leave the pair as good a witness as any for all else."""

USUAL: Final = frozenset({"axes", "mount", "offset", "clock"})
"""Facts in which sound devices differ."""

SERIOUS: Final = frozenset({"axes", "mirrored", "reversed"})
"""Statements that make a pair a worse witness than others."""

SLOW: Final = 5 * DEG
"""Motion below which a loose relation means nothing, rad/s."""


class Judgement:
    """The statements of all pairs, and what they say about each source."""

    def __init__(
        self,
        pairs: Sequence[Pair],
        turning: dict[str, Turning],
        broken: dict[str, int],
        tolerances: Tolerances,
        allowed: Collection[str],
    ) -> None:
        self._statements = [(pair, statements_of(pair, tolerances)) for pair in pairs]
        self._turning = turning
        self._broken = broken
        self._tolerances = tolerances
        self._allowed = allowed
        self._known: set[tuple[str, str]] = set()

    def findings(self) -> list[Finding]:
        """Return one finding for each fact."""
        within = [each for each in self._statements if each[0].a.device == each[0].b.device]
        between = [each for each in self._statements if each[0].a.device != each[0].b.device]
        return [*self._within(within, between), *self._between(between)]

    # Sources of one device.

    def _within(self, within: list[Statements], between: list[Statements]) -> Iterator[Finding]:
        for pair, statements in within:
            for statement in as_others_see(pair, statements, between, self._tolerances):
                source, side, is_sure = self._suspect(pair, statement, between)
                self._known |= {(statement.code, source.name), (statement.code, source.device)}
                other = pair.b if source is pair.a else pair.a
                yield self._finding(pair, statement, source.name, side, other, sure=is_sure)

    def _suspect(
        self, pair: Pair, statement: Statement, between: list[Statements]
    ) -> tuple[Source, Side, bool]:
        """Return which source of a pair a statement is about, and whether that is sure."""
        if statement.a is None:
            return pair.b, statement.about(None), True
        if statement.b is None:
            return pair.a, statement.a, True
        codes = {statement.code, "axes", "mount", "unrelated", "mirrored"}
        blamed = [
            sum(
                any(one.code in codes for one in statements)
                for other, statements in between
                if source in (other.a, other.b) and other.status != "too short"
            )
            for source in (pair.a, pair.b)
        ]
        if blamed[0] > blamed[1]:
            return pair.a, statement.a, True
        if statement.code == "scale" and pair.a.is_rates and blamed[0] == blamed[1]:
            return pair.a, statement.a, True  # an orientation next to them has none
        return pair.b, statement.b, blamed[1] > blamed[0]

    # Devices.

    def _between(self, between: list[Statements]) -> Iterator[Finding]:
        best: dict[frozenset[str], tuple[tuple[bool, int, float], Statements]] = {}
        for pair, statements in between:
            if pair.status == "too short":
                continue
            key = frozenset((pair.a.device, pair.b.device))
            doubtful = sum((code, each.name) in self._known for each in (pair.a, pair.b)
                           for code in SERIOUS | {"drift"})  # fmt: skip
            rank = _rank(pair, statements, doubtful)
            if key not in best or rank < best[key][0]:
                best[key] = rank, (pair, statements)
        witnesses = {key: found for key, (_, found) in best.items()}
        sources = {each.name: each for pair, _ in between for each in (pair.a, pair.b)}
        devices = list(dict.fromkeys(each.device for each in sources.values()))
        if len(devices) < 2:  # noqa: PLR2004  # to compare
            return
        linked = [key for key, (pair, _) in witnesses.items() if pair.is_linked]
        apart = groups(devices, linked)
        roots = [self._root(group, [*sources.values()], witnesses) for group in apart]
        for device in devices:
            own = next(root for root, group in zip(roots, apart, strict=True) if device in group)
            # What has nothing in common with others still has to agree with its like.
            for root in dict.fromkeys((own, roots[0])):
                found = witnesses.get(frozenset((device, root)))
                if device != root and found is not None:
                    yield from self._against_root(device, root, found, witnesses)

    def _root(
        self, group: set[str], sources: list[Source], witnesses: dict[frozenset[str], Statements]
    ) -> str:
        """Return the device of a group that most others of it agree with."""
        devices = [each for each in dict.fromkeys(one.device for one in sources) if each in group]

        def cost(device: str) -> tuple[int, int, int, float]:
            own = [each for each in sources if each.device == device]
            against = [found for key, found in witnesses.items() if device in key and key <= group]
            faults = sum(
                _doubt(statements) + 8 * (pair.status != "related") for pair, statements in against
            )
            faults += 2 * sum(self._broken.get(each.name, 0) for each in own)
            faults += 18 * (len(devices) - 1 - len(against))
            faults += 18 * all(each.frames is not None for each in own)
            shown = max(int(self._turning[each.name].shown.sum()) for each in own)
            faults += 6 * (shown < 3)  # noqa: PLR2004  # a plane shows no other axes
            return faults, -len(own), -shown, min(self._turning[e.name].interval for e in own)

        return min(devices, key=cost)

    def _against_root(
        self, device: str, root: str, found: Statements, witnesses: dict[frozenset[str], Statements]
    ) -> Iterator[Finding]:
        pair, statements = found
        mine, other = (pair.a, pair.b) if pair.a.device == device else (pair.b, pair.a)
        third = [
            statements
            for key, (each, statements) in witnesses.items()
            if root in key and device not in key and each.status == "related"
        ]
        for one in statements:
            agree = sum(not any(each.code == one.code for each in some) for some in third)
            statement = one
            if one.code == "scale":
                statement = self._of_rates(pair, one, witnesses, root if agree else "")
            only = statement.a is None or statement.b is None
            blamed = other if self._is_alone(root, one.code, witnesses) else mine
            side = statement.about("a" if blamed is pair.a else "b")
            about = (pair.b if statement.a is None else pair.a).name if only else blamed.device
            if (statement.code, about) in self._known:
                continue
            doubled = {(statement.code, each.name) for each in (pair.a, pair.b)}
            if statement.code in APART and doubled & self._known:
                continue
            self._known.add((statement.code, about))
            against = mine if about in (other.name, other.device) else other
            yield self._finding(
                pair, statement, about, side, against,
                sure=only or agree > 0 or blamed is other, confirmed=agree, others=len(third),
            )  # fmt: skip

    @staticmethod
    def _is_alone(root: str, code: str, witnesses: dict[frozenset[str], Statements]) -> bool:
        """Return whether a fact is between one device and all others, but not between these."""
        linked = [key for key, (pair, _) in witnesses.items() if pair.status == "related"]
        near = {device for key in linked if root in key for device in key}
        found = [
            (root in key, any(one.code == code for one in witnesses[key][1]))
            for key in linked
            if key <= near
        ]
        return (False, False) in found and all(own == differs for own, differs in found)

    def _of_rates(
        self,
        pair: Pair,
        statement: Statement,
        witnesses: dict[frozenset[str], Statements],
        confirmed: str,
    ) -> Statement:
        """Return a statement on scale about the rates, unless the orientation differs from more.

        Rates have a scale; but so have the orientations of wheels.

        `confirmed`: the device that others agree with, or none
        """
        if pair.a.is_rates == pair.b.is_rates:
            return statement
        differ = [
            sum(
                any(one.code == statement.code for one in statements)
                for key, (_, statements) in witnesses.items()
                if source.device in key
            )
            for source in (pair.a, pair.b)
        ]
        of_a, of_b = differ if pair.a.is_rates else reversed(differ)
        rates = pair.a if pair.a.is_rates else pair.b
        if of_b > of_a:
            return statement
        is_a = pair.a.is_rates != (of_a == of_b and rates.device == confirmed)
        return replace(statement, b=None) if is_a else replace(statement, a=None)

    # Findings.

    def _finding(  # noqa: PLR0913  # a statement, and who it is about
        self,
        pair: Pair,
        statement: Statement,
        source: str,
        side: Side,
        other: Source,
        *,
        sure: bool,
        confirmed: int = 0,
        others: int = 0,
    ) -> Finding:
        return Finding(
            level=self._level(pair, statement),
            code=statement.code,
            source=source,
            text=side.text + ("" if sure else " (or that one is wrong)"),
            against=other.name,
            remedy=side.remedy,
            settings=side.settings,
            confirmed=confirmed,
            others=others,
            numbers=statement.numbers,
        )

    def _level(self, pair: Pair, statement: Statement) -> str:
        code = statement.code
        of_frames = pair.a.frames is not None or pair.b.frames is not None
        if code in self._allowed or code in REMARKS:
            return "remark"
        if code in {"weak", "unrelated"} and (of_frames or _means_little(pair)):
            return "remark"
        if code == "weak" or (of_frames and code in {"axes", "mount"}):
            return "differs" if code == "weak" else "remark"
        if code in FAULTS:
            return "fault"
        if code in FACTS and (code == "offset" or not pair.is_within):
            return "differs"
        return "fault"


def _means_little(pair: Pair) -> bool:
    """Return whether a pair is too short or too slow for a loose relation to mean anything."""
    fit = pair.fit
    if fit is None or (pair.status == "weak" and fit.windows < FEW):
        return True
    most = max(fit.motion, float(np.sqrt(np.trace(fit.excited) / 3)))
    return most < SLOW or (pair.status == "weak" and fit.motion < SLOW)


def _doubt(statements: Sequence[Statement]) -> int:
    """Return how much statements speak against either source: devices may be mounted otherwise.

    Axes are shown only next to the reading of one that is misread, so they are not counted.
    """
    is_misread = any(one.code == "reading" for one in statements)
    free = REMARKS | ({"axes", "mount"} if is_misread else set())
    return sum(0 if one.code in free else 2 if one.code in USUAL else 4 for one in statements)


def _rank(pair: Pair, statements: list[Statement], doubtful: int) -> tuple[bool, int, float]:
    """Return how good a witness a pair of two devices is; the least is the best.

    `doubtful`: number of findings on its sources
    """
    estimates = sum(each.is_rates and not each.measured for each in (pair.a, pair.b))
    faults = sum(
        2 if one.code in SERIOUS else 1
        for one in statements
        if one.code not in APART or (one.code == "reading" and not one.is_sure)
    )
    # Two orientations do not tell a layout from a direction.
    faults += pair.a.is_rates == pair.b.is_rates and any(
        one.code == "reading" for one in statements
    )
    score = 9.0 if pair.fit is None else pair.fit.score
    return pair.status not in {"related", "reversed"}, estimates + faults + 2 * doubtful, score


def all_not_shown(pairs: Sequence[Pair]) -> tuple[str, ...]:
    """Return the relations that the motion does not determine, one sentence for each source."""
    sources: dict[tuple[str, str], list[str]] = {}
    for pair in pairs:
        for text, about, against in not_shown(pair):
            sources.setdefault((text, about), []).append(against)
    return tuple(
        f"{text} of {about} against {others[0] if len(others) == 1 else f'{len(others)} others'}"
        for (text, about), others in sources.items()
    )
