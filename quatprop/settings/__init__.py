"""The settings for reading and propagating a log: their names, and how their values are parsed.

The names are those of the library's keywords. The command line spells them as options
(``on_gap`` is ``--on-gap``), a suite as keys (``on-gap``). Each has one row in a class of keywords
here: the types that the library accepts, the parser, which accepts text, TOML values and Python
values, and the text for help and documents. Nothing heavy is imported, so that ``quatprop --help``
is quick.
"""

from collections.abc import Collection, Sequence
from fractions import Fraction
from os import PathLike
from typing import Annotated, Any, Literal

from quatprop.settings.choices import FRAMES, LAYOUTS, METHODS, Frame, Layout, Method
from quatprop.settings.error_options import ErrorOptions
from quatprop.settings.keyword import Keyword, keywords_of
from quatprop.settings.parsers import Choice, column_list, count, frequency, number, path
from quatprop.settings.reading import (
    End,
    MaxGap,
    OnBackwards,
    OnNonfinite,
    RateOptions,
    RegularTime,
    Start,
)
from quatprop.settings.rotations import Rotated, Timed, initial_attitude, mounting, place, times
from quatprop.settings.static_bias import bias
from quatprop.text import Setting


class RunOptions(RateOptions, total=False):
    """Keywords that determine attitudes, besides those of :class:`RateOptions`."""

    # fmt: off
    start: Start
    end: End
    method: Annotated[Method | None, Keyword(
        Choice(*METHODS), "Integration rule: the rate over an interval is that of the sample at "
        "its start, of the one at its end, their mean, linear between them (coning), a cubic "
        "through four samples (cubic) or a quintic through six (quintic, for sensors with next to "
        "no noise). The last three also correct averages and increments for coning.",
        "start (averages: end)",
        group="Integration", common=True)]
    rates: Annotated[Frame | None, Keyword(
        Choice(*FRAMES),
        "Frame that the rates are resolved in: body multiplies on the right; inertial (or "
        "reference: the axes of the reference frame) on the left.", "body", group="Integration")]
    earth_rate: Annotated[float | Collection[float] | None, Keyword(
        place,
        "Remove the rotation of the Earth at this latitude, deg, so that attitudes are relative "
        "to the ground. The reference frame is east-north-up, or north-east-down if its z axis "
        "points down; AZIMUTH is the direction of a different x axis, deg clockwise from north.",
        "attitudes relative to an inertial reference frame", "LAT[,AZIMUTH]", "Integration")]
    q0: Annotated[
        str | PathLike[str] | Collection[float] | Rotated | Timed | None, Keyword(
        initial_attitude,
        "Initial attitude, body-to-ref: four numbers; level, roll and pitch from gravity at "
        "rest; log, the orientation recorded with the rates; or an attitude series, FILE or "
        "TOPIC of the log, at that time.", "identity",
        "W,X,Y,Z|level|log|FILE|TOPIC", "Initial "
        "attitude", common=True)]
    heading: Annotated[float | None, Keyword(
        number, f"For {Setting('q0', 'level')}: rotation about the z axis of the reference frame, "
        "deg, right-handed: 90 points body x along reference y.", "0", "DEG", "Initial attitude")]
    reference_z: Annotated[Literal["up", "down"] | None, Keyword(
        Choice("up", "down"),
        f"For {Setting('q0', 'level')} and {Setting('earth_rate')}: where the z axis of the "
        "reference frame points (down for north-east-down).", "up", group="Initial "
        "attitude")]
    accel_cols: Annotated[str | Sequence[str | int] | None, Keyword(
        column_list("X,Y,Z"), f"Accelerometer columns, in any unit, for "
        f"{Setting('q0', 'level')} and {Setting('bias', 'static')}; by name or number from 0.",
        "by their names", "X,Y,Z", "Initial attitude")]
    q0_layout: Annotated[Layout | None, Keyword(
        Choice(*LAYOUTS), f"Order of the four numbers of {Setting('q0')}.", "scalar-first",
        group="Initial attitude")]
    bias: Annotated[str | PathLike[str] | Collection[float] | Timed | None, Keyword(
        bias,
        f"Subtracted from the rates; in {Setting('rate_unit')}. static is the mean rate over a "
        "stationary period of at least DUR (1s), found in the whole log by rate, accelerometer "
        "and orientation, or over the time from START to END; static:nearest uses the period "
        "nearest in time, static:interpolate interpolates between periods; FILE or TOPIC is a "
        "series, interpolated.",
        takes="X,Y,Z|static[:nearest|:interpolate][:DUR]|static@START..END|FILE|TOPIC",
        group="Rates", common=True)]
    calibration: Annotated[str | PathLike[str] | None, Keyword(
        path, "Scale, misalignment and bias of the gyroscope: YAML or JSON with matrix (3x3) and "
        "bias (rad/s), applied as matrix (w - bias), or kalibr's file of an IMU.", takes="FILE",
        group="Rates")]
    mount: Annotated[str | Collection[float] | Rotated | None, Keyword(
        mounting,
        "Sensor-to-body rotation: a quaternion with v_body = m v_sensor m*; the "
        "sensor axes that become x, y and z; roll, pitch and yaw of the sensor in the body "
        "(deg, as in URDF); a name such as frd-to-flu; or a frame in the log's own /tf_static.",
        "the "
        "same", "W,X,Y,Z|x,-y,-z|rpy:R,P,Y|ned-to-enu|frd-to-flu|tf:FRAME", "Rates", common=True)]
    on_backwards: OnBackwards
    on_nonfinite: OnNonfinite
    regular_time: RegularTime
    max_gap: MaxGap
    on_gap: Annotated[Literal["hold", "zero", "split", "error"] | None, Keyword(
        Choice("hold", "zero", "split", "error"),
        "How gaps are handled: hold integrates across the gap like any other interval, by "
        f"{Setting('method')}, and warns; zero assumes a rate of zero; split starts again at "
        f"{Setting('q0')}; error refuses.", "hold", group="Timestamps",
        common=True)]
    every: Annotated[int | None, Keyword(
        count, "Write only every N-th attitude.", "all", "N", "Output")]
    rate: Annotated[float | Fraction | str | None, Keyword(
        frequency,
        "Output rate; the attitudes at these times are exact under the method.", "at the samples",
        "HZ", "Output", common=True)]
    at: Annotated[str | PathLike[str] | Timed | Collection[Any] | None, Keyword(
        times,
        "Write attitudes at the timestamps of this file (attitudes, rates, or only timestamps) "
        "or TOPIC of the log, exact under the method; times outside the log are omitted.", "at the "
        "samples", "FILE|TOPIC", "Output")]
    threads: Annotated[int | None, Keyword(
        count, "Number of threads; the output does not depend on it.", "the "
        "cores of this machine", "N", "Execution")]
    # fmt: on


class PropagateOptions(RunOptions, ErrorOptions, total=False):
    """Keywords of :func:`quatprop.propagate`."""


PROPAGATE = keywords_of(PropagateOptions)
"""Everything that determines the attitudes of a log, and the number of threads: name -> its row."""
