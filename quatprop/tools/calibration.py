"""Estimate a calibration from rates and a reference, and validate it on held-out windows."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import ComparisonError, UsageError
from quatprop.base.rendering import count_text, degrees_text, lines_of, rows_html
from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.comparison.alignment import find_mounting
from quatprop.comparison.clock_offset import coarse_offset
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.propagate import Propagation
from quatprop.kinematics.quaternion import IDENTITY, conjugate, from_matrix, geodesic_angle
from quatprop.kinematics.resample import every, interpolate
from quatprop.kinematics.series import AttitudeSeries, GyroSeries, rms
from quatprop.settings.command_options import DEFAULT, GROUPS
from quatprop.tools.calibration_model import (
    METHOD,
    OF_GROUP,
    REJECTED,
    Estimate,
    Model,
    RotationWindows,
    errors_of,
    fit,
    solve,
    windows_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from os import PathLike

    from quatprop.base.arrays import Bool, Float64
    from quatprop.base.rendering import Row


# An estimated calibration: the values, how certain they are, and what they improve.


SIGNIFICANT = 2.0
"""Standard deviations by which an improvement must differ from none."""


class CalibrationParameter(NamedTuple):
    """One number that was asked for.

    `group`, `axis`: such as ``"scale"`` and ``"x"``; the mounting is a rotation vector
    `value`: rad/s, a ratio, rad or s
    `sigma`: its standard deviation; None where the motion does not show it, and it was held
    """

    group: str
    axis: str
    value: float
    sigma: float | None


@dataclass(frozen=True, slots=True, eq=False)
class GyroCalibration:
    """A calibration of a gyroscope, estimated from a reference attitude.

    Calibrated rates are w = M (w_raw - b), with M = R (I + U): the scale corrections are the
    diagonal of U, those of misalignment the elements above it, and R is the mounting.

    Parameters
    ----------
    matrix
        M, shape ``(3, 3)``: raw rates to body axes.
    bias_rad_s
        b, shape ``(3,)``, rad/s, in the axes of the raw rates.
    mount_wxyz
        R as a unit quaternion, scalar first, v_body = m v_sensor m*, shape ``(4,)``.
    time_offset_ns
        What is to be added to the timestamps of the reference in its middle, ns.
    clock_drift
        What more is to be added, as a share of the time since its middle.
    parameters
        What was asked for, with its standard deviation; None where the motion does not show it.
    covariance
        Of the parameters that have a standard deviation, in their order; SI units.
    window_ns
        Length of the windows over which rotations were compared, ns.
    used
        Number of windows from which the parameters were estimated.
    outliers
        Number of further ones that were left out, since the reference jumps there.
    held_out
        Number of windows that were kept for the two errors.
    before_rad, after_rad
        RMS error of the rotations over those, as given and calibrated, rad.
    gain_sigma_rad
        Standard deviation of the difference of these two, rad.
    remarks
        What else a reader should know.
    """

    matrix: Float64
    bias_rad_s: Float64
    mount_wxyz: Float64
    time_offset_ns: int
    clock_drift: float
    parameters: tuple[CalibrationParameter, ...]
    covariance: Float64
    window_ns: int
    used: int
    outliers: int
    held_out: int
    before_rad: float
    after_rad: float
    gain_sigma_rad: float
    remarks: tuple[Remark, ...] = ()

    def __str__(self) -> str:
        return "\n".join(lines_of(calibration_rows(self), width=12))

    def _repr_html_(self) -> str:
        """Return the calibration as a table, for notebooks."""
        return rows_html("Calibration of a gyroscope", calibration_rows(self))

    @property
    def is_better(self) -> bool:
        """Whether the error over windows that were not used falls by more than two sigma."""
        return self.before_rad - self.after_rad > SIGNIFICANT * self.gain_sigma_rad

    def write(self, path: str | PathLike[str]) -> None:
        """Write matrix and bias to a file, as `calibration` of :func:`quatprop.propagate` takes it.

        Parameters
        ----------
        path
            Where; YAML. It is replaced when the new content is complete.

        Raises
        ------
        QuatpropError
            The path is not writable.
        """
        from quatprop.writers.atomic import open_atomic

        rows = [f"  - {list(map(float, row))}" for row in self.matrix]
        lines = [
            f"# quatprop {__version__}: rate = matrix (raw - bias), rad/s, body axes",
            *(f"# {label:<12} {value}" for label, value in calibration_rows(self)),
            "matrix:",
            *rows,
            f"bias: {list(map(float, self.bias_rad_s))}",
        ]
        with open_atomic(str(path)) as file:
            file.write("".join(f"{line}\n" for line in lines).encode())


def calibration_rows(result: GyroCalibration) -> Iterator[Row]:
    """Yield the parameters, what they were estimated from, and what they improve."""
    left_out = f", {result.outliers} more left out as outliers" if result.outliers else ""
    yield "windows", f"{result.used} of {duration_text(result.window_ns)}{left_out}"
    held = []
    for name, group in GROUPS.items():
        values = []
        for _, axis, value, sigma in (one for one in result.parameters if one.group == name):
            if sigma is None:
                held.append(f"{name} {axis}".rstrip())
            else:
                # Two digits of the standard deviation show.
                size = group.factor * sigma
                digits = min(max(1 - math.floor(math.log10(size)), 0), 9)
                values.append(f"{axis} {group.factor * value:+.{digits}f} +- {size:.2g}".lstrip())
        if values:
            yield name, f"{'  '.join(values)} {group.unit}"
    if held:
        yield "held", f"{', '.join(held)}: this motion does not show it, so it is not corrected"
    before, after = (degrees_text(angle, 4) for angle in (result.before_rad, result.after_rad))
    yield (
        "error",
        f"{before} RMS before, {after} after, over {result.held_out} windows kept for validation",
    )
    gain = degrees_text(result.before_rad - result.after_rad, 3)
    nothing = "" if result.is_better else ": nothing is to be gained"
    yield "improvement", f"{gain} +- {degrees_text(result.gain_sigma_rad, 2)}{nothing}"


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

    `settings`: parsed values of :data:`quatprop.settings.command_options.CALIBRATE`
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
