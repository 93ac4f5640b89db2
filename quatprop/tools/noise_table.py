"""The noise of a gyroscope: the result, its table, and the YAML file for kalibr and ``--imu``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base import __version__
from quatprop.base.errors import UsageError
from quatprop.base.rendering import count_text, lines_of, rows_html
from quatprop.base.text import plain
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.settings.quantities import NOISE_DENSITIES, RATE_WALKS, RATES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Float64
    from quatprop.base.errors import Loss
    from quatprop.base.rendering import Row
    from quatprop.base.text import Remark

UNITS = {
    "quantisation": "rad",
    "angle_random_walk": "rad/s/sqrt(Hz)",
    "bias_instability": "rad/s",
    "rate_random_walk": "rad/s^2/sqrt(Hz)",
}
"""The units of the terms."""


class NoiseTerm(NamedTuple):
    """One term of the noise, or how large it is at most.

    Parameters
    ----------
    value
        Its size, in the unit of the term; None where the recording does not show it.
    sigma
        Standard deviation of the value; None where there is none.
    at_most
        What a term that is not shown is at most, with 95 % confidence; None where it is shown, or
        where the recording is too short.
    """

    value: float | None = None
    sigma: float | None = None
    at_most: float | None = None

    @property
    def relative(self) -> float:
        """The standard deviation as a share of the value; NaN where there is no value."""
        return math.nan if self.value is None or self.sigma is None else self.sigma / self.value


class NoiseTerms(NamedTuple):
    """The noise of one axis, or that of all axes together.

    Parameters
    ----------
    quantisation
        Of angles, rad: the standard deviation of the white noise in the angle.
    angle_random_walk
        White noise of the rate, rad/s/sqrt(Hz).
    bias_instability
        Flicker noise of the rate, rad/s: the coefficient B, whose deviation is 0.664 B at any time.
    rate_random_walk
        Random walk of the rate, rad/s^2/sqrt(Hz).
    from_s
        The shortest averaging time that the terms explain, s; None where they explain nothing.
    """

    quantisation: NoiseTerm = NoiseTerm()
    angle_random_walk: NoiseTerm = NoiseTerm()
    bias_instability: NoiseTerm = NoiseTerm()
    rate_random_walk: NoiseTerm = NoiseTerm()
    from_s: float | None = None


class Noise(NamedTuple):
    """The noise of a gyroscope at rest.

    Parameters
    ----------
    source
        The log, and the part of it that was read.
    topic
        The topic of the rates; empty for a table.
    samples
        How many samples were at rest.
    rests
        First and last timestamp of each period at rest, ns.
    pieces
        Into how many pieces rests and gaps divide the samples; nothing is taken across.
    missing
        How many samples are missing between them, by the grid of their timestamps.
    interval_s
        Interval between samples that are not missing, s: they are taken as equally spaced.
    tau_s
        Averaging times, shape ``(T,)``, s.
    deviation
        Overlapping Allan deviation of x, y and z, shape ``(T, 3)``, rad/s.
    low, high
        Its confidence interval of 68 %, shape ``(T, 3)``, rad/s; NaN where no terms explain it.
    axes
        The noise of x, y and z.
    combined
        The value to use for all axes: the root of their mean square.
    dropped
        Samples that were read and not used, by `on_backwards` and `on_nonfinite`.
    remarks
        Remarks on the log and the result.
    losses
        Parts of the log that could not be read.
    """

    source: str
    topic: str
    samples: int
    rests: tuple[tuple[int, int], ...]
    pieces: int
    missing: int
    interval_s: float
    tau_s: Float64
    deviation: Float64
    low: Float64
    high: Float64
    axes: tuple[NoiseTerms, ...]
    combined: NoiseTerms
    dropped: int = 0
    remarks: tuple[Remark, ...] = ()
    losses: tuple[Loss, ...] = ()

    def __str__(self) -> str:
        return "\n".join(lines_of(noise_rows(self), width=18))

    def _repr_html_(self) -> str:
        """Return the noise as a table, for notebooks."""
        return rows_html("Noise of a gyroscope at rest", noise_rows(self))


# The table and the file.


DATA_SHEET = {
    "angle_random_walk": ("deg/sqrt(h)", NOISE_DENSITIES),
    "bias_instability": ("deg/h", RATES),
    "rate_random_walk": ("deg/h/sqrt(h)", RATE_WALKS),
}
"""Units that data sheets use."""

KALIBR = {
    "gyroscope_noise_density": "angle_random_walk",
    "gyroscope_random_walk": "rate_random_walk",
}
"""Names of terms in the file."""

NOTE = "in brackets: 1 sigma; <: 95 % upper bound, not shown by the recording; -: not determined"


def imu_yaml(noise: Noise) -> str:
    """Return the YAML for kalibr and ``--imu``, without values that are unknown."""
    if noise.combined.angle_random_walk.value is None:
        hidden = any(getattr(one, "code", "") == "noise-steps" for one in noise.remarks)
        remedy = "finer rates" if hidden else "the sensor at rest longer"
        raise UsageError(f"the recording shows no angle random walk to write; record {remedy}")
    lines = [
        f"# Gyroscope at rest, by quatprop {__version__}; values are RMS over the axes",
        f"# {plain(noise.source)}",
        "# kalibr also needs accelerometer_noise_density and accelerometer_random_walk.",
    ]
    for key, name in KALIBR.items():
        value, sigma, at_most = term = getattr(noise.combined, name)
        if value is not None and sigma is not None:
            percent = f"1 sigma {100 * term.relative:.2g} %"
            lines.append(f"{key}: {value:.4e}  # {UNITS[name]}, {percent}")
        else:
            bound = "unknown" if at_most is None else f"at most {at_most:.4e}, with 95 %"
            lines.append(f"# {key}: {bound}; the recording does not show it")
    lines += [f'rostopic: "{plain(noise.topic)}"'] if noise.topic else []
    return "\n".join([*lines, f"update_rate: {1 / noise.interval_s:.6g}\n"])


def noise_rows(noise: Noise) -> Iterator[Row]:
    """Yield the noise as labels and texts."""
    yield "source", plain(noise.source)
    yield "at rest", rest_text(noise)
    yield "", "".join(f"{name:>18}" for name in ("x", "y", "z", "root mean square"))
    sheet = []
    for name, unit in UNITS.items():
        terms = [getattr(axis, name) for axis in (*noise.axes, noise.combined)]
        yield name.replace("_", " "), f"{''.join(map(_cell, terms))}  {unit}"
        if name in DATA_SHEET and (value := terms[-1].value) is not None:
            usual, units = DATA_SHEET[name]
            sheet.append(f"{name.replace('_', ' ')} {value / units[usual]:.3g} {usual}")
    cells = "".join(f"{lowest:>18.3e}" for lowest in noise.deviation.min(axis=0))
    times = ", ".join(f"{noise.tau_s[row]:.3g}" for row in noise.deviation.argmin(axis=0))
    yield "lowest deviation", f"{cells}{'':>18}  rad/s, averaged over {times} s"
    if sheet:
        yield "data-sheet units", ", ".join(sheet)
    yield "", NOTE


def rest_text(noise: Noise) -> str:
    """Return what was measured: how many samples, in how many periods, and how long."""
    slots = noise.samples + noise.missing - noise.pieces
    time = duration_text(round(slots * noise.interval_s * NS_PER_S))
    rests = count_text(len(noise.rests), "period")
    pieces = f", {noise.pieces} pieces without gaps" if noise.pieces > len(noise.rests) else ""
    rate = f"{1 / noise.interval_s:.6g} Hz on average"
    missing = f", {noise.missing} missing" if noise.missing else ""
    return f"{count_text(noise.samples, 'sample')}{missing} in {rests}{pieces}: {time}, {rate}"


def _cell(term: NoiseTerm) -> str:
    """Return a term in a column of the table."""
    text = "-" if term.at_most is None else f"< {term.at_most:.2e}"
    if term.value is not None:
        percent = 100 * term.relative
        digits = sum(percent < limit for limit in (1, 10))
        text = f"{term.value:.3e} ({percent:.{digits}f}%)"
    return f"{text:>18}"
