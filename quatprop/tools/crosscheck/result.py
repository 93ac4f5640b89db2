"""The result of a cross-check: findings, with their numbers, remedies and exit code."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

from quatprop.base.rendering import count_text
from quatprop.base.text import in_python, plain
from quatprop.tools.crosscheck.pair import groups

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.base.errors import Loss
    from quatprop.base.text import Remark
    from quatprop.tools.crosscheck.pair import Pair
    from quatprop.tools.crosscheck.sources import Source, Unread

SCHEMA: Final = "quatprop-crosscheck-1"
"""Name of the JSON; its keys stay, others may be added."""

COMPARED: Final = frozenset({"related", "weak", "unrelated", "changing", "reversed"})
"""States of pairs that are worth a picture."""

EXIT_CODES: Final = {
    "consistent": 0, "inconsistent": 1, "consistent in part": 2, "nothing to compare": 2,
}  # fmt: skip
"""The exit code of each state."""

LEVELS: Final = ("fault", "differs", "remark")
"""Levels of findings: a source is wrong, devices differ, or a mere remark."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One statement about one source.

    Parameters
    ----------
    level
        ``"fault"``: the source is wrong; ``"differs"``: it differs from another device, where
        either may be right; ``"remark"``: no reason to fail.
    code
        Its kind: ``"reading"``, ``"unit"``, ``"axes"``, ``"mount"``, ``"mirrored"``,
        ``"offset"``, ``"clock"``, ``"scale"``, ``"bias"``, ``"drift"``, ``"inertial"``,
        ``"reversed"``, ``"changes"``, ``"weak"``, ``"unrelated"``, ``"dead"``, ``"dead-axis"``,
        ``"frozen"``, ``"spikes"``, ``"clipped"``, ``"jumps"``, ``"copy"``.
    source
        The source or the device that it is about.
    text
        The statement.
    against
        The source that shows it; empty if the source itself does.
    remedy
        Options of the commands that read the source; empty if no option repairs it.
    settings
        The same for `correct` of :func:`quatprop.crosscheck`.
    confirmed, others
        How many other devices agree with the one that shows it, of how many.
    numbers
        Values with their standard deviations, by name with unit.
    """

    level: str
    code: str
    source: str
    text: str
    against: str = ""
    remedy: str = ""
    settings: Mapping[str, str] = field(default_factory=dict)
    confirmed: int = 0
    others: int = 0
    numbers: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossCheck:
    """The result of :func:`quatprop.crosscheck`.

    Parameters
    ----------
    sources
        Every source of rotation that was read.
    findings
        Faults and differences, faults first.
    pairs
        The sources that were compared.
    not_shown
        Relations that the motion does not determine.
    notes
        Notes on each source that are not faults, by its name.
    unread
        Sources that could not be read, with the reason.
    losses
        Parts of the logs that could not be read, and omitted samples.
    remarks
        Remarks on the logs and their sources.
    allowed
        Codes of differences that are no reason to fail.
    """

    sources: tuple[Source, ...]
    findings: tuple[Finding, ...]
    pairs: tuple[Pair, ...]
    not_shown: tuple[str, ...]
    notes: Mapping[str, tuple[str, ...]]
    unread: tuple[Unread, ...]
    losses: tuple[Loss, ...]
    remarks: tuple[Remark, ...] = ()
    allowed: tuple[str, ...] = ()

    @property
    def agreeing(self) -> tuple[str, ...]:
        """The names of the sources that follow each other: of most, if there are groups."""
        copies = [(one.source, one.against) for one in self.findings if one.code == "copy"]
        linked = [pair.names for pair in self.pairs if pair.is_linked]
        every = groups([one.name for one in self.sources], [*linked, *copies])
        first = next(iter(every), set())
        return tuple(one.name for one in self.sources if one.name in first and len(first) > 1)

    @property
    def unconfirmed(self) -> tuple[str, ...]:
        """The names of the sources that should agree with another, but do not."""
        agreeing = set(self.agreeing)
        apart = {name for names in self._required() if agreeing.isdisjoint(names) for name in names}
        return tuple(one.name for one in self.sources if one.name in apart)

    @property
    def state(self) -> str:
        """``"consistent"``, that ``in part``, ``"inconsistent"`` or ``"nothing to compare"``."""
        if any(one.level != "remark" for one in self.findings):
            return "inconsistent"
        if not any(pair.is_linked or pair.status in self.allowed for pair in self.pairs):
            return "nothing to compare"
        return "consistent in part" if self.unconfirmed else "consistent"

    def _required(self) -> Iterator[tuple[str, ...]]:
        """Yield the sources that must agree with others, unless their difference is allowed.

        Transforms are about other bodies; short sources and those at rest cannot agree.
        """
        for pair in self.pairs:
            if pair.is_linked:
                yield pair.names
            elif pair.status not in {"too short", "at rest", *self.allowed}:
                yield from ((one.name,) for one in (pair.a, pair.b) if one.frames is None)

    @property
    def exit_code(self) -> int:
        """0: consistent; 1: not; 2: nothing to compare, or some; 3: as 0, but samples are lost."""
        code = EXIT_CODES[self.state]
        return code or (3 if self.losses else 0)

    @property
    def passed(self) -> bool:
        """Whether the sources are consistent."""
        return self.state == "consistent"

    def __repr__(self) -> str:
        return f"<CrossCheck: {self.headline}>"

    @property
    def headline(self) -> str:
        """The first line of the text."""
        head = f"{count_text(len(self.sources), 'source')} of rotation, "
        agreeing = self.agreeing
        others = [one.name for one in self.sources if one.name not in agreeing]
        if not self.state.startswith("consistent") or not others:
            return head + self.state
        if not agreeing:
            return f"{head}whose differences are allowed"
        return f"{head}{len(agreeing)} consistent, nothing shown of {', '.join(map(plain, others))}"

    def in_python(self) -> CrossCheck:
        """Return it with settings in sentences spelled as keywords."""
        unread = tuple(one._replace(reason=in_python(one.reason)) for one in self.unread)
        remarks = tuple(one.spelled(in_python) for one in self.remarks)
        return replace(self, unread=unread, remarks=remarks)

    def settings(self) -> dict[str, dict[str, str]]:
        """Return the settings that repair what can be repaired: source -> setting -> value.

        Of a difference one side is corrected, so none that was measured against a corrected one.
        """
        device = {one.name: one.device for one in self.sources}
        repairs: dict[str, dict[str, str]] = {}
        against: set[tuple[str, str]] = set()
        for finding in self.findings:
            others = {finding.against, device.get(finding.against, "")}
            done = {name for other in others for name in repairs.get(other, ())}
            done |= {name for name in finding.settings if (finding.source, name) in against}
            if finding.level != "remark" and done.isdisjoint(finding.settings):
                repairs.setdefault(finding.source, {}).update(finding.settings)
                against |= {(other, name) for other in others for name in finding.settings}
        return {source: own for source, own in repairs.items() if own}

    def lines(self) -> Iterator[str]:
        """Yield the text: one line if all is well and the motion shows everything."""
        yield self.headline
        shown = [one for one in self.findings if one.level in LEVELS]
        width = min(40, max((len(plain(one.source)) for one in shown), default=0))
        for one in shown:
            remedy = f"   {one.remedy}" if one.remedy else ""
            yield f"{one.level:8} {plain(one.source):{width}}  {plain(one.text)}{remedy}"
        yield from (f"not shown: {plain(text)}" for text in self.not_shown)
        for name, reason in self.unread:
            yield f"not read: {plain(name)}: {reason}"

    def report(self) -> dict[str, Any]:
        """Return everything as JSON values; docs/crosscheck.md explains the keys."""
        return {
            "schema": SCHEMA,
            "state": self.state,
            "exit": self.exit_code,
            "sources": [_source(one, self.notes.get(one.name, ())) for one in self.sources],
            "findings": [
                {name: getattr(one, name) for name in Finding.__slots__} for one in self.findings
            ],
            "pairs": [_pair(one) for one in self.pairs],
            "agreeing": list(self.agreeing),
            "not_shown": list(self.not_shown),
            "unread": [one._asdict() for one in self.unread],
            "losses": [loss._asdict() for loss in self.losses],
            "remarks": [{"code": one.code, "text": str(one)} for one in self.remarks],
        }


def rounded(value: float) -> float:
    """Return a number with six significant digits."""
    return float(f"{value:.6g}")


def _source(source: Source, notes: tuple[str, ...]) -> dict[str, Any]:
    return {
        "name": source.name,
        "kind": source.kind,
        "device": source.device,
        "type": source.type,
        "samples": len(source.t_ns),
        "interval_s": rounded(source.interval),
        "span_s": rounded(source.span),
        "assumed": dict(source.assumed),
        "omitted_invalid": source.omitted[0],
        "omitted_backwards": source.omitted[1],
        "omitted_repeated": source.omitted[2],
        "notes": list(notes),
    }


def _pair(pair: Pair) -> dict[str, Any]:
    report: dict[str, Any] = {"a": pair.a.name, "b": pair.b.name, "status": pair.status}
    if (fit := pair.fit) is None:
        return report
    sigma = [rounded(float(each)) for each in fit.sigma]
    return report | {
        "axes": [fit.axes_a, fit.axes_b],
        "rotation": [[rounded(float(x)) for x in row] for row in fit.matrix],
        "rotation_sigma_rad": sigma[:3],
        "scale": rounded(fit.scale),
        "scale_sigma": sigma[3],
        "bias_rad_s": [rounded(float(x)) for x in fit.bias],
        "bias_sigma_rad_s": sigma[4:7],
        "offset_s": rounded(fit.offset),
        "offset_sigma_s": sigma[10],
        "clock": rounded(fit.clock),
        "clock_sigma": sigma[11],
        "before_rad_s": rounded(pair.before),
        "after_rad_s": rounded(fit.noise),
        "motion_rad_s": rounded(fit.motion),
        "windows": fit.windows,
        "window_s": rounded(fit.length),
    }
