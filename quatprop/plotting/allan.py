"""A picture of the Allan deviation of each axis, with the slopes of the noise terms."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.plotting.accumulators import Quantity
from quatprop.plotting.lines import Line
from quatprop.plotting.picture import Curve, Page, Panel, Picture
from quatprop.sensor_noise.covariance import laws
from quatprop.sensor_noise.files import rest_text
from quatprop.sensor_noise.result import UNITS
from quatprop.text import spelled

if TYPE_CHECKING:
    from quatprop.sensor_noise.result import Noise


def allan_page(noise: Noise) -> Page:
    """Return the picture of the noise of a log."""
    tau, deviation = noise.tau_s, noise.deviation
    bands = [(tau, noise.low[:, axis], noise.high[:, axis]) for axis in range(3)]
    curves = [Curve(Line(tau, deviation[:, axis]), axis, bands[axis]) for axis in range(3)]
    legend = ["x (confidence interval of 68 % shaded)", "y", "z"]
    for law, (name, unit) in zip(laws(tau).T, UNITS.items(), strict=False):
        value = getattr(noise.combined, name).value
        if value is not None:
            slope = value * np.sqrt(law)
            shown = slope >= deviation.min() / 2
            curves.append(Curve(Line(tau[shown], slope[shown]), len(legend), None))
            legend.append(f"{name.replace('_', ' ')} {value:.3g} {unit}")
    lines = "straight lines: the terms, root mean square of the axes"
    facts = (f"at rest: {rest_text(noise)}", lines)
    return Page(
        title=noise.source,
        facts=facts,
        lead=facts,
        picture=Picture(
            time="averaging time, s",
            panels=(Panel(Quantity("Allan deviation", "rad/s"), tuple(curves)),),
            gaps=(),
            starts=(),
            bin_s=0.0,
            legend=tuple(legend),
            is_log=True,
        ),
        warnings=tuple(map(spelled, noise.remarks)),
        tables=(),
    )
