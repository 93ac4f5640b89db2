"""The noise as a table for people, and as the YAML file for kalibr and ``--imu``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.rendering import count_text
from quatprop.sensor_noise.result import UNITS
from quatprop.settings.quantities import NOISE_DENSITIES, RATE_WALKS, RATES
from quatprop.text import plain
from quatprop.times import NS_PER_S, duration_text
from quatprop.version import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.rendering import Row
    from quatprop.sensor_noise.result import Noise, NoiseTerm

DATA_SHEET = {
    "angle_random_walk": ("deg/sqrt(h)", NOISE_DENSITIES),
    "bias_instability": ("deg/h", RATES),
    "rate_random_walk": ("deg/h/sqrt(h)", RATE_WALKS),
}
"""Units that data sheets use."""

NOTE = "in brackets: 1 sigma; <: 95 % upper bound, not shown by the recording; -: not determined"

TOO_SHORT = "the recording is too short to show it"

HEAD = """\
# Noise of a gyroscope at rest, by quatprop {version}: root mean square over its axes.
# {source}
# kalibr also needs accelerometer_noise_density and accelerometer_random_walk.
"""


def imu_yaml(noise: Noise) -> str:
    """Return the YAML for kalibr and ``--imu``, without values that are unknown."""
    terms = noise.combined
    if terms.angle_random_walk.value is None:
        raise UsageError(
            "the recording shows no angle random walk to write; record the sensor at rest longer"
        )
    lines = [HEAD.format(version=__version__, source=plain(noise.source))]
    named = {
        "gyroscope_noise_density": (terms.angle_random_walk, UNITS["angle_random_walk"]),
        "gyroscope_random_walk": (terms.rate_random_walk, UNITS["rate_random_walk"]),
    }
    for name, (term, unit) in named.items():
        if term.value is None:
            lines.append(f"# {name}: {_bound(term)}; {TOO_SHORT}\n")
        else:
            lines.append(
                f"{name}: {term.value:.4e}  # {unit}, 1 sigma {100 * term.relative:.2g} %\n"
            )
    lines += [f'rostopic: "{plain(noise.topic)}"\n'] if noise.topic else []
    return "".join([*lines, f"update_rate: {1 / noise.interval_s:.6g}\n"])


def noise_rows(noise: Noise) -> Iterator[Row]:
    """Yield the noise as labels and texts."""
    yield "source", plain(noise.source)
    time_ns = round((noise.samples - noise.pieces) * noise.interval_s * NS_PER_S)
    time = f"{duration_text(time_ns)}, {1 / noise.interval_s:.6g} Hz on average"
    rests = count_text(len(noise.rests), "period")
    pieces = f", {noise.pieces} pieces without gaps" if noise.pieces > len(noise.rests) else ""
    yield "at rest", f"{count_text(noise.samples, 'sample')} in {rests}{pieces}: {time}"
    columns = [*noise.axes, noise.combined]
    yield "", "".join(f"{name:>18}" for name in ("x", "y", "z", "root mean square"))
    for name, unit in UNITS.items():
        cells = "".join(f"{_cell(getattr(terms, name)):>18}" for terms in columns)
        yield name.replace("_", " "), f"{cells}  {unit}"
    lowest = noise.deviation.argmin(axis=0)
    cells = "".join(f"{noise.deviation[row, axis]:>18.3e}" for axis, row in enumerate(lowest))
    times = ", ".join(f"{noise.tau_s[row]:.3g}" for row in lowest)
    yield "lowest deviation", f"{cells}{'':>18}  rad/s, averaged over {times} s"
    values = ((name, getattr(noise.combined, name).value, *row) for name, row in DATA_SHEET.items())
    known = [
        f"{name.replace('_', ' ')} {value / units[unit]:.3g} {unit}"
        for name, value, unit, units in values
        if value is not None
    ]
    if known:
        yield "data sheet", ", ".join(known)
    yield "", NOTE


def _bound(term: NoiseTerm) -> str:
    return "unknown" if term.at_most is None else f"at most {term.at_most:.4e}, with 95 %"


def _cell(term: NoiseTerm) -> str:
    if term.value is None:
        return "-" if term.at_most is None else f"< {term.at_most:.2e}"
    percent = 100 * term.relative
    digits = sum(percent < limit for limit in (1, 10))
    return f"{term.value:.3e} ({percent:.{digits}f}%)"
