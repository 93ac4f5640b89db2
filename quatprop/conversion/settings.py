"""How to convert one attitude series."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from quatprop.conventions import HAMILTON, Meaning
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.selection import AttitudeSelection

if TYPE_CHECKING:
    from quatprop.pipeline.settings import OutputSettings


@dataclass(frozen=True, slots=True)
class Conversion:
    """How to convert one attitude series.

    Parameters
    ----------
    log
        Path, or ``"-"`` for CSV on stdin.
    output
        Where the attitudes go, in which format and layout.
    kind
        Kind of the log; None: by content and suffix.
    selection
        Which attitudes, and what their numbers mean where the log does not say it.
    meaning
        What the written numbers mean.
    sign
        ``"keep"``, ``"continuous"`` or ``"positive"``. Rotation vectors of ``"keep"`` are the
        short ones, up to half a turn.
    representation
        ``"quaternion"``, a key of :data:`quatprop.conventions.REPRESENTATIONS`, or of
        :data:`quatprop.conversion.rates.RATES`.
    normalize
        Scale rows to unit length.
    drop
        Leave out invalid quaternions.
    """

    log: str
    output: OutputSettings
    kind: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    meaning: Meaning = HAMILTON
    sign: str = "keep"
    representation: str = QUATERNION
    normalize: bool = False
    drop: bool = False

    @property
    def applied_sign(self) -> str:
        """The sign that is applied: a rotation vector has none to keep, and is the short one."""
        if self.representation in REPRESENTATIONS and self.sign == "keep":
            return "positive"
        return self.sign
