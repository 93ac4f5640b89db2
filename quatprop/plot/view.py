"""What to draw of files, and what is shown of each."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from quatprop.conditioning import Conditioning
from quatprop.selection import AttitudeSelection, RateSelection

if TYPE_CHECKING:
    from quatprop.containers.base import Loss
    from quatprop.plot.picture import PlottedFile
    from quatprop.rendering import Row
    from quatprop.text import Text


@dataclass(frozen=True, slots=True)
class View:
    """What to draw of files.

    Parameters
    ----------
    kind
        A key of :data:`quatprop.log_kinds.READERS`; None: by content and suffix.
    show
        None: the rates of a file that has some, else its attitudes.
    rates, attitudes
        Which samples.
    components
        Draw quaternions as they are instead of as angles.
    unwrap
        Draw angles beyond half a turn.
    part
        Start and end of the part to draw, ends included.
    """

    kind: str | None = None
    show: Literal["rates", "attitude"] | None = None
    rates: RateSelection = field(default_factory=RateSelection)
    attitudes: AttitudeSelection = field(default_factory=AttitudeSelection)
    components: bool = False
    unwrap: bool = False
    part: Conditioning = field(default_factory=Conditioning)


@dataclass(frozen=True, slots=True)
class FileView:
    """What is shown of one file.

    Parameters
    ----------
    plotted
        What is drawn of it, labelled with its path.
    meaning
        Unit and clock of its numbers, or convention and method.
    samples
        How many, over which time.
    facts
        Rows of its table.
    remarks
        What a reader should know.
    losses
        What could not be read.
    """

    plotted: PlottedFile
    meaning: str
    samples: str
    facts: tuple[Row, ...]
    remarks: tuple[str | Text, ...]
    losses: tuple[Loss, ...]
