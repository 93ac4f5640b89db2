"""Estimate a calibration from rates and a reference, and validate it on held-out windows."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np

from quatprop.calibration.estimate import REJECTED, Estimate, fit, solve
from quatprop.calibration.model import OF_GROUP, Model
from quatprop.calibration.result import CalibrationParameter, GyroCalibration
from quatprop.calibration.settings import DEFAULT, GROUPS
from quatprop.calibration.windows import METHOD, RotationWindows, errors_of, windows_of
from quatprop.comparison.alignment import find_mounting
from quatprop.comparison.clocks import coarse_offset
from quatprop.conditioning.mounting import mounting
from quatprop.errors import ComparisonError, UsageError
from quatprop.kinematics.interpolation import interpolate
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import IDENTITY, conjugate, from_matrix, geodesic_angle
from quatprop.kinematics.resample import every
from quatprop.rendering import count_text
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.series.blocks import rms
from quatprop.text import Remark, Setting
from quatprop.times import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.arrays import Bool

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

NEAR_NS: Final = 100_000_000
"""Clock offsets below this need no coarse search: least squares converges."""

NEAR_RAD: Final = 0.2
"""The same for the mounting."""

MAX_PROPAGATED: Final = 2_000_000
"""Approximate number of propagated attitudes from which clock and mounting are estimated first."""

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
    free = np.isin(OF_GROUP, settings.get("estimate", DEFAULT))
    given, begin = _beginnings(rates, reference, settings)
    windows, length_ns, found = _best(rates, reference, begin, free, settings.get("window"))
    model, used = found.model, int(found.used.sum())
    sigmas = dict(
        zip(np.flatnonzero(found.free), np.sqrt(found.covariance.diagonal()), strict=True)
    )
    axes = [(name, axis) for name, group in GROUPS.items() for axis in group.axes]
    return GyroCalibration(
        matrix=model.matrix,
        bias_rad_s=model.bias,
        mount_wxyz=model.mount,
        time_offset_ns=model.added_ns + round(model.offset * NS_PER_S),
        clock_drift=model.drift,
        parameters=tuple(
            CalibrationParameter(*axes[k], float(model.values[k]), sigmas.get(k))
            for k in np.flatnonzero(free)
        ),
        covariance=found.covariance,
        window_ns=length_ns,
        used=used,
        outliers=len(found.used) - used,
        **_validated(rates, windows.where(~_is_used(windows)), given, found),
        remarks=tuple(remarks),
    )


def _rising(name: str, series: AnySeries, remarks: list[Remark]) -> AnySeries:
    """Return the finite samples of a series in order of time; add a remark on omitted ones."""
    finite = np.isfinite(np.asarray(series)).all(axis=1)
    if not (finite.all() and (np.diff(series.t_ns) > 0).all()):
        before, series = len(series), series[finite]
        _, first = np.unique(series.t_ns, return_index=True)
        series = series[first]
        if left_out := before - len(series):
            text = f"{left_out} samples of the {name} were omitted: not finite, or of the same time"
            remarks.append(Remark("omitted", text))
    if len(series) < MIN_WINDOWS:
        raise ComparisonError(
            f"the {name} has {count_text(len(series), 'sample')}; a calibration needs at least "
            f"{MIN_WINDOWS}: record for longer"
        )
    return series


def _beginnings(
    rates: GyroSeries, reference: AttitudeSeries, settings: Mapping[str, Any]
) -> tuple[Model, Model]:
    """Return the model that the user gave, and one close enough for least squares to converge."""
    estimate, mount = settings.get("estimate", DEFAULT), settings.get("mount")
    added_ns = settings.get("time_offset", "auto" if "offset" in estimate else 0)
    is_unknown = added_ns == "auto"
    if is_unknown and "offset" not in estimate:
        raise UsageError(
            f"{Setting('time_offset', 'auto')} is for offsets that are estimated; add offset to "
            f"{Setting('estimate')}, or give a duration"
        )
    begin = given = Model(
        mount=IDENTITY if mount is None else from_matrix(mounting(mount)),
        added_ns=0 if is_unknown else added_ns,
        middle_ns=(int(reference.t_ns[0]) + int(reference.t_ns[-1])) // 2,
    )
    attitudes = (q for _, q in Propagation(IDENTITY, METHOD, "body").run([rates]))
    step = max(len(rates) // MAX_PROPAGATED, 1)
    propagated = AttitudeSeries.joined([*every(attitudes, step)])
    if is_unknown:
        with suppress(ComparisonError):
            added_ns, _ = coarse_offset(propagated, reference)
            begin = begin._replace(added_ns=added_ns if abs(added_ns) > NEAR_NS else 0)
    t_ns = begin.times_of(reference.t_ns)
    (common,) = np.nonzero((t_ns >= rates.t_ns[0]) & (t_ns <= propagated.t_ns[-1]))
    if not len(common):
        raise ComparisonError(
            f"the log, {rates.t_ns[0]} to {rates.t_ns[-1]} ns, and the reference, "
            f"{reference.t_ns[0]} to {reference.t_ns[-1]} ns, have no time in common; add their "
            f"difference with {Setting('time_offset')}"
        )
    if "mount" in estimate:
        common = common[:: max(len(common) // MAX_PAIRS, 1)]
        by_rates, _ = interpolate(propagated, t_ns[common])
        with suppress(ComparisonError):
            to_sensor, _ = find_mounting(reference.wxyz[common], by_rates)
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
    lengths_ns = [length_ns] if length_ns else LENGTHS_NS
    candidates = {each: windows_of(rates, reference, begin, each) for each in lengths_ns}
    enough = {each: windows for each, windows in candidates.items() if len(windows) >= MIN_WINDOWS}
    if not enough:
        raise ComparisonError(
            f"the log and the reference have {max(map(len, candidates.values()))} windows in "
            f"common, and a calibration needs {MIN_WINDOWS}; record for longer, or choose a "
            f"shorter {Setting('window')}"
        )

    def fitted(length_ns: int) -> Estimate:
        windows = enough[length_ns]
        return fit(rates, windows.where(_is_used(windows)), begin, free)

    def information(length_ns: int) -> float:
        vectors, slope = errors_of(rates, enough[length_ns], found.model)
        blocks = solve(vectors, slope, found.free).blocks.sum(axis=(0, 1))
        return float(np.linalg.slogdet(blocks[np.ix_(found.free, found.free)])[1])

    first = max((each for each in enough if each <= FIRST_NS), default=min(enough))
    found = fitted(first)
    best = max(enough, key=information)
    return enough[best], best, found if best == first else fitted(best)


def _validated(
    rates: GyroSeries, windows: RotationWindows, given: Model, found: Estimate
) -> dict[str, Any]:
    """Return the errors before and after over windows; those that are outliers of both omitted.

    `Returns`: the fields of a :class:`GyroCalibration` about windows that were held out
    """
    vectors = [errors_of(rates, windows, model)[0] for model in (given, found.model)]
    squares = np.stack(vectors) ** 2
    usual = ((squares / found.noise).sum(axis=2) < REJECTED**2).any(axis=0)
    before, after = squares.sum(axis=2)[:, usual]
    rms_before, rms_after = rms(np.sqrt(before)), rms(np.sqrt(after))
    parts = [part.mean() for part in np.array_split(before - after, PARTS // 3) if len(part)]
    spread = float(np.std(parts, ddof=1)) / np.sqrt(len(parts))
    return {
        "held_out": int(usual.sum()),
        "before_rad": rms_before,
        "after_rad": rms_after,
        # sigma(a - b) = sigma(a^2 - b^2) / (a + b)
        "gain_sigma_rad": spread / max(rms_before + rms_after, np.finfo(float).tiny),
    }
