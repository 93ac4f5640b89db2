"""Gyroscope errors from settings, a file and periods at rest, and the resulting uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.guarded_text import read_yaml_file, unusable
from quatprop.base.text import Setting, listed
from quatprop.base.times import NS_PER_S
from quatprop.kinematics.uncertainty import ErrorGrowth, RestErrors, SensorErrors
from quatprop.propagation.conditioning.static_period import WIDENS
from quatprop.settings.parsers import number
from quatprop.settings.quantities import LARGEST

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from quatprop.propagation.conditioning.corrections import GyroCorrectionReport
    from quatprop.propagation.conditioning.static_period import StaticPeriod

IMU_KEYS: Final = {
    "gyroscope_noise_density": "noise_density",
    "gyroscope_random_walk": "random_walk",
}
"""Keys of the files that Kalibr reads and Allan variance tools write, in rad/s/sqrt(Hz) and
rad/s^2/sqrt(Hz), and what they are here."""


BY_ACCELEROMETER: Final = "accelerometer noise, without its bias and without that of the heading"
"""Origin of the standard deviation of a levelled attitude."""


@dataclass(frozen=True, slots=True)
class ErrorSettings:
    """The known errors of a gyroscope, and whether to compute their growth.

    `q0_sigma`: of the first attitude, rad: one number for all axes, or roll, pitch and yaw
    `imu`: a file in YAML with the keys of :data:`IMU_KEYS`; what is given goes before it
    `sigma`: whether to compute the standard deviations of every attitude
    `sigma_axes`: ``"body"`` or ``"reference"``: the axes of the columns of standard deviations
    """

    noise_density: float | None = None
    bias_sigma: float | None = None
    random_walk: float | None = None
    scale_sigma: float | None = None
    misalignment_sigma: float | None = None
    q0_sigma: tuple[float, ...] | None = None
    imu: str | None = None
    sigma: bool = False
    sigma_axes: str | None = None

    def __post_init__(self) -> None:
        if self.sigma_axes is not None and not self.sigma:
            raise UsageError(f"{Setting('sigma_axes')} requires {Setting('sigma')}")

    def refuse_unknown_errors(self) -> None:
        """Refuse to compute standard deviations if no error of the gyroscope is known."""
        known = (self.imu, self.q0_sigma, *(getattr(self, name) for name in SensorErrors._fields))
        if self.sigma and all(value is None for value in known):
            raise UsageError(
                f"{Setting('sigma')} needs the errors of the gyroscope; give "
                f"{Setting('noise_density')}, {Setting('bias_sigma')}, {Setting('random_walk')}, "
                f"{Setting('scale_sigma')} or {Setting('misalignment_sigma')}, a file with "
                f"{Setting('imu')}, or {Setting('bias', 'static')}"
            )

    @property
    def columns_axes(self) -> str | None:
        """The axes of the columns of standard deviations; None without such columns."""
        return (self.sigma_axes or "body") if self.sigma else None


class UncertaintyReport(NamedTuple):
    """Standard deviations of the final attitude, from the given gyroscope errors.

    `errors`: standard deviations of the gyroscope's errors
    `origins`: where each of them comes from: ``"given"``, a file, ``"rest"``, or for the initial
        attitude :data:`BY_ACCELEROMETER`
    `q0_sigma_rad`: standard deviations of the initial attitude about body axes, shape ``(3,)``,
        rad; None if it is taken to be exact
    `columns_axes`: the axes of the columns of standard deviations; None if there are none
    `sigma_rad`: standard deviations of the final attitude about body axes, shape ``(3,)``, rad
    `largest`: the error that contributes most
    `largest_share`: its share of the variance
    """

    errors: SensorErrors
    origins: Mapping[str, str]
    q0_sigma_rad: NDArray[np.float64] | None
    columns_axes: str | None
    sigma_rad: NDArray[np.float64]
    largest: str
    largest_share: float


class KnownErrors(NamedTuple):
    """The known errors of a gyroscope.

    `origins`: where each of them comes from, as in :class:`UncertaintyReport`
    `rests`: errors of the bias at rest; None if the bias was not measured at rest
    """

    errors: SensorErrors
    origins: Mapping[str, str]
    rests: RestErrors | None = None

    @classmethod
    def of(
        cls, found: Mapping[str, tuple[float, str]], rests: RestErrors | None = None
    ) -> KnownErrors:
        """Return the errors given by pairs of value and origin."""
        errors = SensorErrors(**{name: value for name, (value, _) in found.items()})
        return cls(errors, {name: origin for name, (_, origin) in found.items()}, rests)


def known_errors(settings: ErrorSettings, report: GyroCorrectionReport) -> KnownErrors | None:
    """Return the known errors of a gyroscope; None if there are none.

    `report`: has the rests that the bias was measured at. The scatter of their rates gives the
        noise density N; the error of the bias over the time T is N / sqrt(T), with the error due
        to quantisation, or the difference between rests if that is larger. A rest of one value
        shows neither, unless the quantisation step is known
    """
    given = {name: getattr(settings, name) for name in SensorErrors._fields}
    found = {name: (value, "given") for name, value in given.items() if value is not None}
    if settings.imu is not None:
        for name, value in read_imu(settings.imu).items():
            found.setdefault(name, (value, settings.imu))
    rests = [rest for rest in report.all_rests if rest.span_s > 0]
    if not rests:
        return KnownErrors.of(found) if found or settings.q0_sigma is not None else None
    hidden = any(rest.hides_errors for rest in rests)
    if hidden and "bias_sigma" not in found:
        if settings.sigma:
            raise UsageError(
                f"{Setting('sigma')} needs the error of the bias, and the rates at rest do not "
                f"change and are in no known steps; give {Setting('bias_sigma')}"
            )
        return None
    if not hidden:
        found.setdefault("noise_density", (noise_density_of(rests), "rest"))
    density, _ = found.get("noise_density", (0.0, ""))
    sigmas = np.array([rest.bias_sigma(density) for rest in rests])
    neighbours = zip(pairwise(rests), pairwise(sigmas), strict=True)
    walks = np.array([_walk(*two, *their_sigmas) for two, their_sigmas in neighbours])
    if len(rests) == 1:
        sigmas = np.maximum(sigmas, rests[0].spread_rad_s)
    bias_sigma, origin = found.setdefault("bias_sigma", (float(sigmas.max()), "rest"))
    known = RestErrors(
        np.array([rest.first_ns for rest in rests]),
        np.array([rest.last_ns for rest in rests]),
        sigmas if origin == "rest" else np.full(len(rests), bias_sigma),
        walks,
        report.interpolated,
        float(np.median([rest.span_s / (rest.samples - 1) for rest in rests])) * NS_PER_S,
    )
    return KnownErrors.of(found, known)


def noise_density_of(rests: Sequence[StaticPeriod]) -> float:
    """Return the noise density at rest, rad/s/sqrt(Hz)."""
    squares = sum(rest.samples * rest.noise_density**2 for rest in rests)
    return math.sqrt(squares / sum(rest.samples for rest in rests))


def _walk(rest: StaticPeriod, after: StaticPeriod, sigma: float, sigma_after: float) -> float:
    """Return the random walk that explains the difference of two means, rad/s/sqrt(s).

    `sigma`, `sigma_after`: standard deviations of the means due to noise, rad/s
    """
    apart = float(np.abs(after.mean_rad_s - rest.mean_rad_s).max())
    between_s = (after.first_ns - rest.last_ns) / NS_PER_S
    return apart / math.sqrt(between_s) if apart > WIDENS * math.hypot(sigma, sigma_after) else 0.0


def uncertainty_report(
    known: KnownErrors,
    q0: NDArray[np.float64] | None,
    growth: ErrorGrowth,
    settings: ErrorSettings,
) -> UncertaintyReport:
    """Return the uncertainty of the attitude at the last sample.

    `q0`: covariance of the initial attitude about body axes, shape ``(3, 3)``, rad^2; None if
        unknown
    """
    errors, origins = known.errors, dict(known.origins)
    walk = 0.0 if known.rests is None else float(known.rests.walk.max(initial=0.0))
    if walk > errors.random_walk:
        errors, origins["random_walk"] = errors._replace(random_walk=walk), "rests that differ"
    if q0 is not None:
        origins["q0_sigma"] = BY_ACCELEROMETER if settings.q0_sigma is None else "given"
    largest = max(growth.variances, key=lambda name: growth.variances[name])
    total = sum(growth.variances.values())
    return UncertaintyReport(
        errors,
        origins,
        None if q0 is None else q0.diagonal() ** 0.5,
        settings.columns_axes,
        growth.final.diagonal() ** 0.5,
        largest,
        growth.variances[largest] / total if total else 0.0,
    )


def read_imu(path: str) -> dict[str, float]:
    """Return the errors listed in a file, by their names in :class:`ErrorSettings`.

    `path`: a file like Kalibr's ``imu.yaml`` or EuRoC's ``sensor.yaml``; its keys may be below
        the name of a single IMU, as in the results of Kalibr
    """
    content = read_yaml_file("imu", path)
    blocks = [content, *content.values()]
    imus = [block for block in blocks if isinstance(block, dict) and IMU_KEYS.keys() & block.keys()]
    if len(imus) != 1:
        none = f"it has none of the keys {listed(IMU_KEYS)}"
        raise unusable("imu", path, f"it describes {len(imus)} IMUs" if imus else none)
    return dict(_values(imus[0], path))


def _values(imu: Mapping[str, object], path: str) -> Iterator[tuple[str, float]]:
    for key, name in IMU_KEYS.items():
        if (stated := imu.get(key)) is None:
            continue
        try:
            value = number(stated)
        except UsageError as error:
            raise unusable("imu", path, f"{key}: {error.text}") from None
        if value < 0:
            raise unusable("imu", path, f"{key} is below 0")
        if value > LARGEST:
            raise unusable("imu", path, f"{key} is larger than that of a gyroscope can be")
        yield name, value
