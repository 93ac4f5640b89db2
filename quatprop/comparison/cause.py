"""What explains an error: a mistake whose remedy takes most of it away."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from quatprop.rendering import count_text
from quatprop.series.blocks import rms

if TYPE_CHECKING:
    from quatprop.arrays import Float64

CLEAR = 10.0
"""Errors that are this many times larger than those of all other samples are isolated."""

NO_ERROR = 1e-9
"""RMS error, rad, that needs no explanation."""

ISOLATED = 0.01
"""Share of the samples that may be isolated errors."""


class Cause(NamedTuple):
    """What explains most of an error.

    `name`: a short name, stable for scripts
    `sentence`: what it is, with the RMS error before and after
    `rms_before`, `rms_after`: RMS error as it is, and after the remedy, rad, aligned as was asked
    `remedy`: the settings with which to read, propagate or compare, or what else mends it
    `also`: another cause, which explains most of what is left after the remedy of this one
    `part_ns`: length of the part of a recording in which the cause was looked for and the errors
        were measured, ns; None: all of it
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
        """The cause, and those of what is left after it."""
        return [self, *(self.also.chain if self.also else [])]

    @property
    def advice(self) -> str:
        """The sentence with the remedy; not for a regression, which the remedy would hide."""
        return f"{self.sentence}; {self.remedy}"


def isolated_samples(error: Float64) -> Cause | None:
    """Return a few outliers as the cause, if they are; the errors are in rising order."""
    few = max(int(len(error) * ISOLATED), 1)
    before, rest = rms(error), rms(error[:-few])
    count = int((error > CLEAR * max(rest, NO_ERROR)).sum())
    if not 0 < count <= few or (after := rms(error[:-count])) > before / CLEAR:
        return None
    sentence = f"{count} of {len(error)} samples carry the error, and the others are right"
    return Cause(
        "isolated samples", sentence, before, after, f"omit {count_text(count, 'sample')} of B"
    )
