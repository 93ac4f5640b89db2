"""What is estimated, and from what: the settings of a calibration."""

import math
from collections.abc import Collection
from typing import Annotated, NamedTuple, TypedDict

from quatprop.comparison.settings import time_offset_ns
from quatprop.settings.keyword import Keyword, keywords_of
from quatprop.settings.parsers import Choice, length, parts_of
from quatprop.settings.reading import End, Start
from quatprop.settings.rotations import Rotated, mounting
from quatprop.text import Setting


class ParameterGroup(NamedTuple):
    """Parameters of one kind.

    `axes`: one name for each
    `limit`: standard deviation above which one counts as unobservable: rad/s, a ratio, rad or s
    `rank`: of parameters that cannot be separated, those of the highest rank are held
    `factor`, `unit`: those in which values are shown
    """

    axes: tuple[str, ...]
    limit: float
    rank: int
    factor: float
    unit: str


# fmt: off
GROUPS = {
    "bias": ParameterGroup(("x", "y", "z"), 0.01, 0, 180 / math.pi, "deg/s"),
    "scale": ParameterGroup(("x", "y", "z"), 0.01, 4, 100.0, "%"),
    "misalignment": ParameterGroup(("xy", "xz", "yz"), 0.01, 5, 180 / math.pi, "deg"),
    "mount": ParameterGroup(("x", "y", "z"), 0.02, 2, 180 / math.pi, "deg"),
    "offset": ParameterGroup(("",), 0.01, 1, 1e3, "ms, added in the middle of the reference"),
    "drift": ParameterGroup(("",), 1e-4, 3, 1e6, "ppm, by which that offset grows with time"),
}
"""What can be estimated; the limits are above the errors of usual MEMS gyroscopes and crystals."""
# fmt: on

DEFAULT = tuple(GROUPS)[:-1]
"""What is by default: what a calibration file or an option can correct."""


def estimated(value: object) -> tuple[str, ...]:
    """Return which parameters to estimate: text such as ``"bias,mount"``, ``"all"``, or names."""
    names = [Choice(*GROUPS, "all")(str(name).strip()) for name in parts_of(value)]
    return tuple(name for name in GROUPS if name in names or "all" in names)


class CalibrateOptions(TypedDict, total=False):
    """Keywords of :func:`quatprop.calibrate`."""

    # fmt: off
    estimate: Annotated[str | Collection[str] | None, Keyword(
        estimated, "What to estimate: bias, scale, misalignment (of the sensor axes among "
        "themselves), mount (the rotation from sensor to body), offset and drift of the "
        "clock; or all. What the motion does not show is held.", ",".join(DEFAULT), "NAMES",
        "Options")]
    window: Annotated[int | str | None, Keyword(
        length, "Length of the windows over which rotations are compared.",
        "the one of 0.1 to 5 s that shows the parameters best", "DUR", "Options")]
    time_offset: Annotated[int | str | None, Keyword(
        time_offset_ns, "Added to the timestamps of the reference beforehand; the estimate is "
        "beyond it. auto finds it from the angular speeds.", "auto if the offset is estimated, "
        "else 0", "DUR|auto", "Options")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting, f"Sensor-to-body rotation that is known beforehand, as for {Setting('mount')} of "
        "propagate; the estimate begins there.", "the same axes", "W,X,Y,Z|x,-y,-z|...",
        "Options")]
    # fmt: on
    start: Start
    end: End


CALIBRATE = keywords_of(CalibrateOptions)
"""How a calibration is estimated: name -> its row."""
