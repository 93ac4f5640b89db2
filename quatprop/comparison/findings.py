"""What is wrong with a series and has no remedy: an axis about which it never turns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.comparison.windows import body_angle, common_beginning
from quatprop.text import Remark

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.arrays import Float64
    from quatprop.series import AttitudeSeries

WINDOWS = 100
"""Windows over which rotations are compared, about: noise of attitudes hardly counts in them."""

MIN_TURN = np.radians(1.0)
"""rad: RMS rotation over windows, about the axis with least, of a body that turns about all."""

MIN_SHARE = 0.05
"""The same, as a share of that about the axis with most."""

DEAD = 1e-6
"""Share of its largest spread below which a rate does not vary but by rounding."""


def dead_axes(a: AttitudeSeries, b: AttitudeSeries) -> Iterator[Remark]:
    """Yield a sentence where one series turns about all axes and the other at no varying rate."""
    both = zip("AB", common_beginning(a, b), strict=True)
    spreads = {name: _spreads(series) for name, series in both}
    for name, other in (("A", "B"), ("B", "A")):
        own, whole = spreads[name][0], spreads[other][1]
        axes = [axis for axis, spread in zip("xyz", own, strict=True) if spread <= DEAD * whole[-1]]
        least = whole[-1] if len(axes) == len(own) else whole[0]
        if not least > max(MIN_TURN, MIN_SHARE * whole[-1]):
            continue
        if axes:
            text = f"the rate of {name} about its {' and '.join(axes)} axis never changes, and "
            text += f"{other} turns about all three: are rates missing?"
            if len(axes) == len(own):
                text = f"the rate of {name} never changes, and that of {other} does: is one dead?"
            yield Remark("dead-axis", text)


def _spreads(series: AttitudeSeries) -> tuple[Float64, Float64]:
    """Return the RMS rotations from sample to sample about the body axes, less the mean rate, rad.

    The second result is of windows, about their principal axes, the smallest first.
    """
    seconds, angle = body_angle(series, int(series.t_ns[0]))
    span = max(float(seconds[-1]), 1e-9)
    varying = angle - seconds[:, None] / span * angle[-1]
    steps = np.diff(varying, axis=0)
    windows = np.diff(varying[:: max(len(varying) // WINDOWS, 1)], axis=0)
    powers = np.linalg.eigvalsh(windows.T @ windows / len(windows))
    return np.sqrt((steps**2).mean(axis=0)), np.sqrt(np.maximum(powers, 0.0))
