"""Settings for the errors of a gyroscope and the resulting uncertainty."""

from collections.abc import Collection
from os import PathLike
from typing import Annotated, Literal, TypeAlias, TypedDict, get_args

from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import Choice, flag, path
from quatprop.settings.quantities import (
    NOISE_DENSITIES,
    RAD_PER_UNIT,
    RATE_WALKS,
    RATES,
    RATIOS,
    angles,
    quantity_of,
)
from quatprop.text import Setting

SigmaAxes: TypeAlias = Literal["body", "reference"]
SIGMA_AXES: tuple[str, ...] = get_args(SigmaAxes)


class ErrorOptions(TypedDict, total=False):
    """Keywords about uncertainty."""

    # fmt: off
    noise_density: Annotated[str | float | None, Keyword(
        quantity_of(NOISE_DENSITIES, "a noise density", "0.2deg/sqrt(h)"), "Noise of the gyroscope "
        "(angle random walk), such as 0.2deg/sqrt(h) or 1.7e-4rad/s/sqrt(Hz), for the uncertainty "
        "of the result.", f"by {Setting('imu')} or {Setting('bias', 'static')}", "X",
        "Uncertainty")]
    bias_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RATES, "a rate", "20deg/h"), "Standard deviation of the constant bias, such as "
        "20deg/h: how well the bias is known: the turn-on repeatability, not the bias "
        "instability.",
        f"by {Setting('bias', 'static')}, else 0", "X", "Uncertainty")]
    random_walk: Annotated[str | float | None, Keyword(
        quantity_of(RATE_WALKS, "a rate random walk", "1e-5rad/s^2/sqrt(Hz)"),
        "Rate random walk of the bias, such as 1e-5rad/s^2/sqrt(Hz) or 3deg/h/sqrt(h).",
        f"by {Setting('imu')}, "
        f"else 0", "X", "Uncertainty")]
    scale_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RATIOS, "a ratio", "1000ppm or 0.1%"),
        "Standard deviation of the scale factors, such as 1000ppm or 0.1%.", "0", "X",
        "Uncertainty")]
    misalignment_sigma: Annotated[str | float | None, Keyword(
        quantity_of(RAD_PER_UNIT, "an angle", "5mrad"),
        "Standard deviation of the six small angles by which each sensor axis leans towards the "
        "two others, such as 5mrad; 1% of cross-axis sensitivity is 10mrad.", "0", "X",
        "Uncertainty")]
    q0_sigma: Annotated[str | float | Collection[str | float] | None, Keyword(
        angles,
        f"Standard deviation of {Setting('q0')}: one angle for every axis, or roll, pitch and "
        "yaw, such as 0.2deg,0.2deg,1deg.",
        f"by accelerometer noise after {Setting('q0', 'level')}, else 0", "X|ROLL,PITCH,YAW",
        "Uncertainty")]
    imu: Annotated[str | PathLike[str] | None, Keyword(
        path,
        "Noise density and random walk from a file in the format of kalibr or of an Allan "
        "variance tool.", takes="FILE.yaml", group="Uncertainty")]
    sigma: Annotated[bool | None, Keyword(
        flag, "Write the standard deviations of every attitude: columns sigma_x, sigma_y, sigma_z "
        "in rad, covariances in messages that have them.", group="Output", common=True)]
    sigma_axes: Annotated[SigmaAxes | None, Keyword(
        Choice(*SIGMA_AXES), "Axes of those columns.", "body", group="Uncertainty")]
    # fmt: on
