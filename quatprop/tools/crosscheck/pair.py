"""Two sources of rotation, how one follows from the other, and statements about either."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from quatprop.base.rendering import decimals_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from quatprop.estimation.relation import Relation
    from quatprop.tools.crosscheck.sources import Source


FEW: Final = 100
"""Number of windows below which a loose relation means nothing."""


class Change(NamedTuple):
    """A change of the relation.

    `at`: when, s
    `of_a`, `of_b`: what changes, as it reads about A and about B, without the name of the other
    """

    at: float
    of_a: str
    of_b: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two sources, and how B follows from A.

    `status`: ``"related"``, ``"weak"``, ``"unrelated"``, ``"changing"``, ``"reversed"``,
        ``"repeating"``, ``"at rest"`` or ``"too short"``
    `fit`: the simplest relation that explains; None if too short
    `stated`: the same with the fewest differences that explain it
    `others`: relations that explain as well
    `before`: RMS of the difference of their rates about body axes, as recorded, rad/s
    `as_read`: residual RMS if nothing is misread, as a multiple of that of `fit`
    `agreement`, `backwards`: of the search, and of that with B's time reversed, 0 to 1
    `is_far`: whether the clocks have different zeros
    `steady`: constant difference: ``"bias"``, ``"drift"``, ``"both"``, or ``"bias or drift"`` where
        the motion does not distinguish them
    `repeats`: whether several offsets explain the motion
    `is_stepping`: whether the clock offset jumps, which is not a drift
    `change`: how the relation changes along the log
    """

    a: Source
    b: Source
    status: str
    fit: Relation | None = None
    stated: Relation | None = None
    others: tuple[Relation, ...] = ()
    before: float = 0.0
    as_read: float = 1.0
    agreement: float = 0.0
    backwards: float = 0.0
    is_far: bool = False
    steady: str = "bias"
    repeats: bool = False
    is_stepping: bool = False
    change: Change | None = None

    @property
    def names(self) -> tuple[str, str]:
        """The names of both sources."""
        return self.a.name, self.b.name

    @property
    def is_within(self) -> bool:
        """Whether one message carries both, so that both have one clock and one body."""
        return self.a.device == self.b.device and self.a.is_message

    @property
    def is_linked(self) -> bool:
        """Whether B is shown to follow A, if only loosely, in a part, or backwards."""
        if self.status == "weak":
            by_chance = self.repeats or self.is_far
            return self.fit is not None and self.fit.windows >= FEW and not by_chance
        return self.status in {"related", "changing", "reversed"}

    @property
    def is_flat(self) -> bool:
        """Whether the motion does not distinguish mirrored axes."""
        return self.fit is not None and self.fit.is_flat


def groups(names: Iterable[str], links: Iterable[Collection[str]]) -> list[set[str]]:
    """Return names in groups that links join, the largest group first."""
    found = [{name} for name in names]
    for link in links:
        joined = [group for group in found if not group.isdisjoint(link)]
        found = [group for group in found if group.isdisjoint(link)]
        found.append(set().union(*joined))
    return sorted(found, key=len, reverse=True)


# Statements about a pair, worded for either source, and the tolerances.


DEG: Final = math.radians(1.0)

SIGNIFICANT: Final = 5.0
"""Standard deviations beyond which a difference is stated."""


class Tolerances(NamedTuple):
    """Differences that do not matter, however significant.

    `offset`: s; 0.6 intervals of the slower source are tolerated in any case
    `mount`: rad
    `scale`: ratio
    `bias`: rad/s
    `drift`: of an orientation about its reference, rad/s
    `clock`: s/s
    """

    offset: float = 0.005
    mount: float = math.radians(2.0)
    scale: float = 0.02
    bias: float = math.radians(0.3)
    drift: float = math.radians(0.15)
    clock: float = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """How a statement reads if it is about one of the two sources.

    `text`: the statement about the source
    `settings`: what repairs it: setting -> value
    `remedy`: the same, as options of the commands that read it
    """

    text: str
    settings: Mapping[str, str] = field(default_factory=dict)
    remedy: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """One fact about a pair.

    `code`: as of :class:`.Finding`
    `a`, `b`: how it reads about each source; None: it cannot be about that one
    `numbers`: values with their standard deviations
    `is_sure`: whether no other reading explains it
    """

    code: str
    a: Side | None
    b: Side | None
    numbers: Mapping[str, Any] = field(default_factory=dict)
    is_sure: bool = True

    def about(self, side: str | None) -> Side:
        """Return how it reads about one side, ``"a"`` or ``"b"``, or about the only one."""
        if self.a is None or (self.b is not None and side == "b"):
            return self.b or Side(text="")
        return self.a

    @classmethod
    def one_sided(cls, code: str, side: Side, *, of_a: bool, **facts: Any) -> Statement:
        """Return a statement about one source only, A or B."""
        return cls(code=code, a=side if of_a else None, b=None if of_a else side, **facts)


def value_text(value: float, sigma: float, unit: str, factor: float = 1.0) -> str:
    """Return a value with its standard deviation, both with as many digits as are known."""
    shown = max(abs(sigma * factor), 1e-9)
    digits = decimals_of(shown, 6)
    return f"{value * factor:.{digits}f} +- {shown:.{digits}f}{unit}"


def repairable(text: str, settings: Mapping[str, str]) -> Side:
    """Return a side that settings repair, which are options of the same names."""
    # A bias may begin with a minus sign.
    options = (
        f"--{name.replace('_', '-')}{'=' if name == 'bias' else ' '}{value}"
        for name, value in settings.items()
    )
    return Side(text=text, settings=settings, remedy=" ".join(options))
