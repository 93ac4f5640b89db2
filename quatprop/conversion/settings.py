"""How to convert one attitude series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from quatprop.conventions import HAMILTON, Meaning
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.writers import kind_of, layout_of

if TYPE_CHECKING:
    from quatprop.conventions.layout import Layout
    from quatprop.pipeline.settings import OutputSettings
    from quatprop.signals.attitude_input import AttitudeInput


@dataclass(frozen=True, slots=True)
class Conversion:
    """How to convert one attitude series.

    Parameters
    ----------
    source
        Which attitudes.
    output
        Where they go, in which format and layout.
    meaning
        What the written numbers mean.
    sign
        ``"keep"``, ``"continuous"`` or ``"positive"``. Rotation vectors of ``"keep"`` are the
        short ones, up to half a turn.
    representation
        ``"quaternion"``, a key of :data:`quatprop.conventions.REPRESENTATIONS`, or of
        :data:`quatprop.conversion.rates.RATES`.
    """

    source: AttitudeInput
    output: OutputSettings
    meaning: Meaning = HAMILTON
    sign: str = "keep"
    representation: str = QUATERNION

    @property
    def kind(self) -> str:
        """The format that is written, a key of :data:`quatprop.writers.WRITERS`."""
        return kind_of(self.output.path, self.output.to)

    @property
    def layout(self) -> Layout:
        """The layout of quaternions, where those are written."""
        return layout_of(self.kind, self.output.layout)

    @property
    def applied_sign(self) -> str:
        """The sign that is applied: a rotation vector has none to keep, and is the short one."""
        if self.representation in REPRESENTATIONS and self.sign == "keep":
            return "positive"
        return self.sign
