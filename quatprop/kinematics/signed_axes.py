"""Exchanges of axes and changes of their signs, as matrices and as text."""

from __future__ import annotations

from itertools import permutations, product
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from quatprop.base.arrays import Float64

SIGNED_PERMUTATIONS: Final = sorted(
    (
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ),
    key=lambda matrix: -float(np.trace(matrix)),
)
"""All exchanges and changes of sign of three axes, those with the fewest changes first."""


def axes_text(matrix: Float64) -> str:
    """Return a signed permutation as a mounting, such as ``"-z,y,x"``."""
    return ",".join(
        ("-" if row.sum() < 0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix
    )
