"""A picture of the Allan deviation of each axis, with the slopes of the noise terms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.errors import OutputError
from quatprop.plotting.accumulators import Quantity
from quatprop.plotting.lines import Line
from quatprop.plotting.picture import Curve, Page, Panel, Picture
from quatprop.plotting.target import PictureFile, kind_of
from quatprop.rendering import count_text
from quatprop.sensor_noise.covariance import laws
from quatprop.sensor_noise.result import UNITS
from quatprop.text import spelled
from quatprop.times import NS_PER_S, duration_text

if TYPE_CHECKING:
    from quatprop.sensor_noise.result import Noise


class AllanPicture(PictureFile):
    """A picture of the noise of a log."""

    def __init__(self, target: str, inputs: list[str], **options: Any) -> None:
        if kind_of(target) == "html":
            raise OutputError(target, "a picture of noise is an image; use .png, .svg or .pdf")
        super().__init__(target, inputs, **options)

    def draw(self, noise: Noise) -> None:
        """Draw the picture and publish it."""
        tau = noise.tau_s
        curves = [
            Curve(
                Line(tau, noise.deviation[:, axis]),
                axis,
                (tau, noise.low[:, axis], noise.high[:, axis]),
            )
            for axis in range(3)
        ]
        legend = ["x (confidence interval of 68 % shaded)", "y", "z"]
        for number, (name, unit) in enumerate(UNITS.items()):
            value = getattr(noise.combined, name).value
            if value is not None:
                slope = value * np.sqrt(laws(tau)[:, number])
                shown = slope >= noise.deviation.min() / 2
                curves.append(Curve(Line(tau[shown], slope[shown]), len(legend), None))
                legend.append(f"{name.replace('_', ' ')} {value:.3g} {unit}")
        time = duration_text(round(noise.samples * noise.interval_s * NS_PER_S))
        facts = (
            f"{count_text(noise.samples, 'sample')} at rest, {time} together",
            "straight lines: the terms, root mean square of the axes",
        )
        self.commit(
            Page(
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
        )
