"""The likely cause of an error: a mistake whose remedy removes most of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.rendering import count_text
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from quatprop.arrays import Float64

CLEAR = 10.0
"""Errors this many times the RMS of all others are isolated."""

NO_ERROR = 1e-9
"""RMS error, rad, that is only rounding."""

ISOLATED = 0.01
"""Maximum share of samples with isolated errors."""


class Cause(NamedTuple):
    """A cause that explains most of an error.

    `name`: a short name, stable for scripts
    `sentence`: description, with the RMS error before and after the remedy
    `rms_before`, `rms_after`: RMS error before and after the remedy, rad, aligned as asked
    `remedy`: settings with which to read, propagate or compare, or another correction
    `also`: a second cause, which explains most of the error that remains
    `part_ns`: length of the part of the recording that was searched and measured, ns; None: all
    """

    name: str
    sentence: str
    rms_before: float
    rms_after: float
    remedy: str
    also: Cause | None = None
    part_ns: int | None = None

    @property
    def chain(self) -> list[Cause]:
        """The cause, and the further ones."""
        return [self, *(self.also.chain if self.also else [])]

    @property
    def advice(self) -> str:
        """The sentence with the remedy; not for regression tests, where it would hide the fault."""
        return f"{self.sentence}; {self.remedy}"


def isolated_samples(error: Float64) -> Cause | None:
    """Return a few outliers as the cause, or None; `error`: sorted, rad."""
    few = max(int(len(error) * ISOLATED), 1)
    before, rest = rms(error), rms(error[:-few])
    count = int((error > CLEAR * max(rest, NO_ERROR)).sum())
    if not 0 < count <= few or (after := rms(error[:-count])) > before / CLEAR:
        return None
    sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
    return Cause(
        "isolated samples", sentence, before, after, f"omit {count_text(count, 'sample')} of B"
    )
