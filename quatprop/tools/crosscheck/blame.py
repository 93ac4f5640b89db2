"""Which source a difference is about: one finding for each fact.

Sources of one message contradict themselves. Of different devices, each is compared with the one
that most others agree with; where only two remain, either may be the one that is wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from quatprop.estimation.relation import BIAS
from quatprop.settings.crosscheck_options import FACTS
from quatprop.tools.crosscheck.pair import (
    DEG,
    FEW,
    SIGNIFICANT,
    Pair,
    Side,
    Statement,
    Tolerances,
    groups,
    repairable,
    value_text,
)
from quatprop.tools.crosscheck.result import Finding
from quatprop.tools.crosscheck.statements import not_shown, statements_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.estimation.turning import Turning
    from quatprop.tools.crosscheck.sources import Source

Statements: TypeAlias = tuple[Pair, list[Statement]]
"""A pair, and the statements on it."""

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

REMARKS: Final = frozenset({"bias", "drift"})
"""Facts that every sensor shows: no reason to fail."""

CLEAR: Final = 0.3
"""Share of the motion that is left, below which a pair is a witness."""


class Blame:
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


# The rates and the orientation of one device, as other devices see them.
#
# Some faults look the same within a device: mirrored rates next to a conjugate look like rates of
# the reference frame, and a bias like a drift. A third source decides.


def as_others_see(
    pair: Pair, own: list[Statement], between: Sequence[Statements], tolerances: Tolerances
) -> list[Statement]:
    """Return the statements on the rates and the orientation of a device, corrected by others."""
    if pair.status != "related" or pair.a.is_rates == pair.b.is_rates:
        return own
    rates, orientation = (pair.a, pair.b) if pair.a.is_rates else (pair.b, pair.a)
    plain = [*_plain(rates, between)]
    mirrored = [
        one
        for other, statements in between
        if other.a is rates and not other.is_flat
        for one in statements
        if one.code == "mirrored"
    ]
    codes = {one.code for one in own}
    if mirrored and plain and "inertial" in codes:
        text = "is conjugate (reference to body), as the rates next to it are mirrored"
        side = repairable(text, {"from_direction": "ref-to-body"})
        return [mirrored[0], Statement.one_sided("reading", side, of_a=orientation is pair.a)]
    fits = any(not other.is_flat for other in _plain(orientation, between))
    if fits and not plain and "reading" in codes:
        text = "rates are about the axes of the reference frame, as other devices confirm"
        side = repairable(text, {"rates": "inertial"})
        inertial = Statement.one_sided("inertial", side, of_a=rates is pair.a)
        return [inertial if one.code == "reading" else one for one in own]
    if mirrored and pair.is_flat:
        return [one for one in own if one.code not in {"axes", "mount"}] + mirrored[:1]
    drift = _drift(pair, between, tolerances) if pair.a is rates else None
    if drift is not None:
        return [one for one in own if one.code not in REMARKS] + [drift]
    return own


def _plain(source: Source, between: Sequence[Statements]) -> Iterator[Pair]:
    """Yield the pairs of a source with other devices in which no reading is needed."""
    for other, _ in between:
        is_plain = other.fit is not None and other.fit.is_plain
        if source in (other.a, other.b) and other.status == "related" and is_plain:
            yield other


def _drift(pair: Pair, between: Sequence[Statements], tolerances: Tolerances) -> Statement | None:
    """Return that an orientation turns away, if others confirm the rates next to it."""
    if pair.steady in {"drift", "both"}:
        return None  # the motion shows it without others
    own = gyro_bias(pair)
    biases = [
        gyro_bias(other)
        for other in _plain(pair.a, between)
        if other.a is pair.a and other.fit is not None and other.fit.score < CLEAR
    ]
    others = [one for one in biases if one is not None]
    if own is None or not others:
        return None
    weights = [1 / np.maximum(sigma, 1e-5) ** 2 for _, sigma in others]
    total = np.sum(weights, axis=0)
    mean = np.sum([bias * w for (bias, _), w in zip(others, weights, strict=True)], axis=0)
    difference = own[0] - mean / total
    sigma = np.sqrt(own[1] ** 2 + 1 / total)
    at = int(np.argmax(np.abs(difference) / sigma))
    if abs(difference[at]) < max(tolerances.bias, SIGNIFICANT * sigma[at]):
        return None
    size, certainty = float(np.linalg.norm(difference)), float(np.linalg.norm(sigma))
    about = ", ".join(f"{x / size:.2f}" for x in difference)
    count = f"{len(others)} other comparison{'s' * (len(others) > 1)}"
    text = (
        f"turns {value_text(size, certainty, ' deg/s', 1 / DEG)} about body ({about}) away from "
        f"the rates next to it, which {count} confirm{'s' * (len(others) == 1)}"
    )
    numbers = {"deg_s": size / DEG, "sigma_deg_s": certainty / DEG}
    return Statement(code="drift", a=None, b=Side(text=text), numbers=numbers)


def gyro_bias(pair: Pair) -> tuple[Float64, Float64] | None:
    """Return the bias of A's rates in their axes and B's unit, and its deviations, rad/s."""
    fit = pair.fit
    if fit is None or not pair.a.is_rates or not fit.is_plain:
        return None
    back = fit.matrix.T
    sigma = np.where(fit.shown, fit.sigma[BIAS], 10.0)
    bias = -back @ np.where(fit.shown, fit.bias, 0.0)
    return bias, np.sqrt(back**2 @ sigma**2)
