"""What conditioning takes from a log and from files, besides the rates and the settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.conditioning.bias_series import BiasSeries
    from quatprop.conditioning.cells import Rows
    from quatprop.conditioning.mounting import FrameMounting


FROM_TRANSFORMS = "tf:"
"""Begins a mounting that is taken from the transforms of the log."""


@dataclass(frozen=True, slots=True)
class ConditioningInputs:
    """What is known of a log besides its rates; None where it is not there or not asked for.

    Parameters
    ----------
    force
        Reads stamps and specific forces, shape ``(N, 3)``, any unit, sensor axes.
    orientation
        Reads stamps and the log's own orientation, wxyz body -> reference, shape ``(N, 4)``.
    biases
        The series of biases.
    mounting
        That from the transforms of the log.
    topic
        That of the rates.
    """

    force: Callable[[], Rows] | None = None
    orientation: Callable[[], Rows] | None = None
    biases: BiasSeries | None = None
    mounting: FrameMounting | None = None
    topic: str = ""
