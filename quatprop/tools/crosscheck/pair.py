"""Two sources of rotation, and the result of comparing them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

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
