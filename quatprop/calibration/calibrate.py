"""Estimate a calibration from rates and a reference, and validate it on held-out windows."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np

from quatprop.calibration.estimate import REJECTED, Estimate, fit, normal_equations, robust_noise
from quatprop.calibration.model import OF_GROUP, PARAMETERS, Model
from quatprop.calibration.result import CalibrationParameter, GyroCalibration
from quatprop.calibration.settings import DEFAULT, ESTIMATED
from quatprop.calibration.windows import METHOD, RotationWindows, covered, errors_of, windows_of
from quatprop.comparison.alignment import find_mounting
from quatprop.comparison.clocks import coarse_offset
from quatprop.conditioning.mounting import mounting
from quatprop.errors import ComparisonError
from quatprop.kinematics.interpolation import interpolate
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import IDENTITY, conjugate, from_matrix, geodesic_angle
from quatprop.rendering import count_text
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.series.blocks import rms
from quatprop.text import Remark, Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.arrays import Bool, Float64

AnySeries = TypeVar("AnySeries", GyroSeries, AttitudeSeries)

LENGTHS_NS: Final = tuple(int(1e8 * length) for length in (1, 2, 5, 10, 20, 50))
"""Candidate lengths of windows. Noise of the reference dominates short ones, noise of the rates
long ones: the length with the smallest determinant of the covariance is used."""

FIRST_NS: Final = 1_000_000_000
"""Length of the windows of the first estimate, with which the lengths are compared."""

MIN_WINDOWS: Final = 60
"""Minimum number of windows."""

PARTS: Final = 30
"""Parts of the recording, of which every third is held out of the estimate."""

SPARE_NS: Final = 200_000_000
"""Margin around each window for a clock offset that is still unknown."""

NEAR_NS: Final = 100_000_000
"""Clock offsets below this need no coarse search: least squares converges."""

NEAR_RAD: Final = 0.2
"""The same for the mounting."""

MAX_PAIRS: Final = 20_000
"""Approximate number of attitudes from which the first mounting is estimated."""


def calibrate(
    rates: GyroSeries, reference: AttitudeSeries, settings: Mapping[str, Any]
) -> GyroCalibration:
    """Estimate a calibration.

    `settings`: parsed values of :data:`quatprop.calibration.settings.CALIBRATE`
    """
    remarks: list[Remark] = []
    rates, reference = _rising("log", rates, remarks), _rising("reference", reference, remarks)
    estimate = settings.get("estimate", DEFAULT)
    given, begin = _beginnings(rates, reference, settings, estimate)
    free = np.isin(OF_GROUP, estimate)
    windows, length_ns, found = _best(rates, reference, begin, free, settings.get("window"))
    validation = _validate(
        rates, windows.where(~_is_used(windows)), (given, found.model), found.noise
    )
    model, used = found.model, int(found.used.sum())
    sigma = np.full(len(PARAMETERS), np.nan)
    sigma[found.free] = np.sqrt(found.covariance.diagonal())
    order = sorted(np.flatnonzero(free), key=lambda k: ESTIMATED.index(PARAMETERS[k].group))
    rows = [list(np.flatnonzero(found.free)).index(k) for k in order if found.free[k]]
    return GyroCalibration(
        matrix=model.matrix,
        bias_rad_s=model.bias,
        mount_wxyz=model.mount,
        time_offset_ns=model.added_ns + round(model.offset * NS_PER_S),
        clock_drift=model.drift,
        parameters=tuple(
            CalibrationParameter(
                PARAMETERS[k].group,
                PARAMETERS[k].axis,
                float(model.values[k]),
                float(sigma[k]) if found.free[k] else None,
            )
            for k in order
        ),
        covariance=found.covariance[np.ix_(rows, rows)],
        window_ns=length_ns,
        used=used,
        outliers=len(found.used) - used,
        **validation._asdict(),
        remarks=tuple(remarks),
    )


def _rising(name: str, series: AnySeries, remarks: list[Remark]) -> AnySeries:
    """Return the finite samples of a series in order of time; add a remark on omitted ones."""
    (finite,) = np.nonzero(np.isfinite(np.asarray(series)).all(axis=1))
    t_ns, first = np.unique(series.t_ns[finite], return_index=True)
    if len(t_ns) < len(series):
        left_out = len(series) - len(t_ns)
        text = f"{left_out} samples of the {name} were omitted: not finite, or of the same time"
        remarks.append(Remark("omitted", text))
    if len(t_ns) < MIN_WINDOWS:
        raise ComparisonError(
            f"the {name} has {count_text(len(t_ns), 'sample')}; a calibration needs at least "
            f"{MIN_WINDOWS}: record for longer"
        )
    return series[finite[first]]


def _beginnings(
    rates: GyroSeries,
    reference: AttitudeSeries,
    settings: Mapping[str, Any],
    estimate: tuple[str, ...],
) -> tuple[Model, Model]:
    """Return the model that the user gave, and one close enough for least squares to converge."""
    mount = settings.get("mount")
    given = Model(
        mount=IDENTITY if mount is None else from_matrix(mounting(mount)),
        added_ns=settings.get("time_offset", 0),
        middle_ns=(int(reference.t_ns[0]) + int(reference.t_ns[-1])) // 2,
    )
    q = Propagation(IDENTITY, METHOD, "body").advance(rates)
    propagated = AttitudeSeries(rates.t_ns, q)
    begin = given
    if "offset" in estimate and "time_offset" not in settings:
        with suppress(ComparisonError):
            added_ns, _ = coarse_offset(propagated, reference)
            begin = begin._replace(added_ns=added_ns if abs(added_ns) > NEAR_NS else 0)
    t_ns = begin.times_of(reference.t_ns)
    common = (t_ns >= rates.t_ns[0]) & (t_ns <= rates.t_ns[-1])
    if not common.any():
        raise ComparisonError(
            f"the log, {rates.t_ns[0]} to {rates.t_ns[-1]} ns, and the reference, "
            f"{reference.t_ns[0]} to {reference.t_ns[-1]} ns, have no time in common; add their "
            f"difference with {Setting('time_offset')}"
        )
    if "mount" in estimate:
        (some,) = np.nonzero(common)
        some = some[:: max(len(some) // MAX_PAIRS, 1)]
        with suppress(ComparisonError):
            to_sensor, _ = find_mounting(
                reference.wxyz[some], interpolate(propagated, t_ns[some]).wxyz
            )
            if geodesic_angle(conjugate(to_sensor), given.mount) > NEAR_RAD:
                begin = begin._replace(mount=conjugate(to_sensor))
    return given, begin


def _is_used(windows: RotationWindows) -> Bool:
    """Return which windows are used for the estimate; the others are held out."""
    part = np.arange(len(windows)) * PARTS // len(windows)
    return np.asarray(part % 3 != 1)


def _best(
    rates: GyroSeries, reference: AttitudeSeries, begin: Model, free: Bool, length_ns: int | None
) -> tuple[RotationWindows, int, Estimate]:
    """Return the windows with the smallest uncertainty, their length, and the estimate."""
    several = {
        length: covered(rates, windows_of(reference, length), begin, SPARE_NS)
        for length in ([length_ns] if length_ns else LENGTHS_NS)
    }
    enough = {length: each for length, each in several.items() if len(each) >= MIN_WINDOWS}
    if not enough:
        most = max(map(len, several.values()))
        raise ComparisonError(
            f"the log and the reference have {most} windows in common, and a calibration needs "
            f"{MIN_WINDOWS}; record for longer, or choose a shorter {Setting('window')}"
        )
    first = max((length for length in enough if length <= FIRST_NS), default=min(enough))
    found = fit(rates, enough[first].where(_is_used(enough[first])), begin, free)
    if len(enough) == 1:
        return enough[first], first, found

    def volume(windows: RotationWindows) -> float:
        errors = errors_of(rates, windows, found.model)
        information, _ = normal_equations(errors, *robust_noise(errors.vectors))
        return -float(np.linalg.slogdet(information.sum(axis=0)[np.ix_(found.free, found.free)])[1])

    best = min(enough, key=lambda length: volume(enough[length]))
    if best != first:
        found = fit(rates, enough[best].where(_is_used(enough[best])), begin, free)
    return enough[best], best, found


class Validation(NamedTuple):
    """RMS errors over the held-out windows, as in :class:`GyroCalibration`."""

    held_out: int
    before_rad: float
    after_rad: float
    gain_sigma_rad: float


def _validate(
    rates: GyroSeries, windows: RotationWindows, models: tuple[Model, Model], noise: Float64
) -> Validation:
    """Return the errors of two models over windows; outliers of both are omitted."""
    squares = np.stack([errors_of(rates, windows, model).vectors ** 2 for model in models])
    usual = ((squares / noise).sum(axis=2) < REJECTED**2).any(axis=0)
    before, after = squares.sum(axis=2)[:, usual]
    rms_before, rms_after = (rms(np.sqrt(each)) for each in (before, after))
    parts = [part.mean() for part in np.array_split(before - after, PARTS // 3) if len(part)]
    spread = float(np.std(parts, ddof=1)) / np.sqrt(len(parts))
    # sigma(a - b) = sigma(a^2 - b^2) / (a + b)
    total = max(rms_before + rms_after, np.finfo(float).tiny)
    return Validation(int(usual.sum()), rms_before, rms_after, spread / total)
