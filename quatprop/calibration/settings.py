"""What is estimated, and from what: the settings of a calibration."""

from collections.abc import Collection
from typing import Annotated, TypedDict

from quatprop.errors import UsageError
from quatprop.settings.keyword import Keyword, keywords_of
from quatprop.settings.parsers import length, parts_of, signed_duration
from quatprop.settings.reading import End, Start
from quatprop.settings.rotations import Rotated, mounting
from quatprop.text import Setting, did_you_mean, listed, shown

ESTIMATED = ("bias", "scale", "misalignment", "mount", "offset", "drift")
"""What can be estimated, in the order in which it is shown."""

DEFAULT = ESTIMATED[:-1]
"""What is by default: what a calibration file or an option can correct."""


def estimated(value: object) -> tuple[str, ...]:
    """Return which parameters to estimate: text such as ``"bias,mount"``, ``"all"``, or names."""
    names = [str(name).strip() for name in parts_of(value)]
    names = [*ESTIMATED] if names == ["all"] else names
    for name in names:
        if name not in ESTIMATED:
            hint = did_you_mean(name, ESTIMATED, f"there are all, {listed(ESTIMATED)}")
            raise UsageError(f"{shown(name)} cannot be estimated{hint}")
    return tuple(name for name in ESTIMATED if name in names)


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
        signed_duration, "Added to the timestamps of the reference beforehand; the estimate is "
        "beyond it.", "0; if the offset is estimated, found from the angular speeds", "DUR",
        "Options")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting, f"Sensor-to-body rotation that is known beforehand, as for {Setting('mount')} of "
        "propagate; the estimate begins there.", "the same axes", "W,X,Y,Z|x,-y,-z|...",
        "Options")]
    # fmt: on
    start: Start
    end: End


CALIBRATE = keywords_of(CalibrateOptions)
"""How a calibration is estimated: name -> its row."""
