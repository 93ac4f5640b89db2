"""Estimate a calibration from rates and a reference, and validate it on held-out windows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from quatprop.base import __version__
from quatprop.base.errors import ComparisonError, OutputError, UsageError
from quatprop.base.rendering import count_text, decimals_of, degrees_text, lines_of, rows_html
from quatprop.base.text import Remark, Setting
from quatprop.base.times import NS_PER_S, duration_text
from quatprop.estimation.estimate import MIN_WINDOWS, CalibrationEstimate, Question, estimate
from quatprop.estimation.model import OF_GROUP
from quatprop.kinematics.conventions import mounting
from quatprop.kinematics.quaternion import IDENTITY, from_matrix, rotation_matrix
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.rate_stream import OF_ATTITUDE, RateSettings, RateStream
from quatprop.settings.command_options import GROUPS
from quatprop.settings.reading import GyroCorrection
from quatprop.timeline.counts import Policy
from quatprop.timeline.stamps import StampChecks

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from os import PathLike

    from quatprop.base.arrays import Float64
    from quatprop.base.rendering import Row
    from quatprop.propagation.recording import Recording


# An estimated calibration: the values, how certain they are, and what they improve.


SIGNIFICANT = 2.0
"""Standard deviations by which an improvement must differ from none."""

SIGNIFICANTLY_WORSE = 6.0
"""Standard deviations by which a file must increase errors before it is by more than chance: of a
gyroscope without errors, a file increases them by 1 on average, and by 4 once in 100 times."""

WORTH_A_REMARK = math.radians(0.1)
"""Change of a bias that gets a remark, rad/s; smaller ones are in its standard deviation alone."""

MIN_OFFSET_NS = 1000
"""Offset that is shown for a comparison, ns."""


class CalibrationParameter(NamedTuple):
    """One requested parameter.

    `group`, `axis`: such as ``"scale"`` and ``"x"``; the mounting is a rotation vector
    `value`: rad/s, a ratio, rad or s
    `sigma`: its standard deviation; None if the motion does not determine it: then the value is
        the most likely one, and the standard deviations of the others include its uncertainty
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
        Offset to add to the timestamps of the reference in its middle, ns.
    clock_drift
        Relative clock drift: further offset to add, per unit of time since that middle.
    parameters
        The requested parameters, each with its standard deviation.
    covariance
        Of the parameters that have a standard deviation, in their order; SI units.
    window_ns
        Length of the windows over which rotations were compared, ns.
    windows_used
        Number of windows from which the parameters were estimated.
    outliers
        Number of windows that were omitted because the reference jumps there.
    validation_windows
        Number of windows that were kept for validation.
    rms_uncalibrated_rad, rms_clock_corrected_rad, rms_calibrated_rad
        RMS error of the rotations over them, rad: as given, with the clock corrected, and with the
        calibration as well. The difference of the last two is the improvement by the file.
    clock_gain_sigma_rad, gain_sigma_rad
        Standard deviations of the differences of the first two and of the last two, rad.
    valleys
        Pairs of parameters that this motion hardly distinguishes, and how one trades for the other.
    dropped
        Number of samples of the log that were dropped according to the settings.
    remarks
        Remarks on the log and the result.
    """

    matrix: Float64
    bias_rad_s: Float64
    mount_wxyz: Float64
    time_offset_ns: int
    clock_drift: float
    parameters: tuple[CalibrationParameter, ...]
    covariance: Float64
    window_ns: int
    windows_used: int
    outliers: int
    validation_windows: int
    rms_uncalibrated_rad: float
    rms_clock_corrected_rad: float
    rms_calibrated_rad: float
    clock_gain_sigma_rad: float
    gain_sigma_rad: float
    valleys: tuple[str, ...] = ()
    dropped: int = 0
    remarks: tuple[Remark, ...] = ()

    def __str__(self) -> str:
        return "\n".join(lines_of(calibration_rows(self), width=12))

    def _repr_html_(self) -> str:
        """Return the calibration as a table, for notebooks."""
        return rows_html("Calibration of a gyroscope", calibration_rows(self))

    @property
    def is_better(self) -> bool:
        """Whether the file reduces the error over windows that were not used, by two sigma."""
        return (
            self.rms_clock_corrected_rad - self.rms_calibrated_rad
            > SIGNIFICANT * self.gain_sigma_rad
        )

    @property
    def is_worse(self) -> bool:
        """Whether the file increases the error over windows that were not used: it is refused."""
        return self.rms_calibrated_rad > self.rms_clock_corrected_rad

    def write(self, path: str | PathLike[str]) -> None:
        """Write matrix and bias to a file, as `calibration` of :func:`quatprop.propagate` takes it.

        Parameters
        ----------
        path
            Where; YAML. It is replaced when the new content is complete.

        Raises
        ------
        QuatpropError
            The path is not writable, the axes of the log are mirrored, or the error over windows
            that were not used is larger with the file.
        """
        if np.linalg.det(self.matrix) < 0:
            raise OutputError(
                str(path),
                "the axes of the log are left-handed, which no calibration corrects; correct the "
                "sign of the axis in the log",
            )
        if self.is_worse:
            raise OutputError(
                str(path),
                "no calibration is written, since windows kept for validation are worse with it; "
                "record for longer, with more motion",
            )
        from quatprop.writers.atomic import write_atomic

        rows = [f"  - {list(map(float, row))}" for row in self.matrix]
        lines = [
            f"# quatprop {__version__}: rate = matrix (raw - bias), rad/s, body axes",
            *(f"# {label:<12} {value}" for label, value in calibration_rows(self)),
            "matrix:",
            *rows,
            f"bias: {list(map(float, self.bias_rad_s))}",
        ]
        write_atomic(str(path), "".join(f"{line}\n" for line in lines))


def calibration_rows(result: GyroCalibration) -> Iterator[Row]:
    """Yield the parameters, the windows that they come from, and the improvement."""
    left_out = f", {result.outliers} more left out as outliers" if result.outliers else ""
    yield "windows", f"{result.windows_used} of {duration_text(result.window_ns)}{left_out}"
    unshown = []
    for name, group in GROUPS.items():
        values = []
        for _, axis, value, sigma in (one for one in result.parameters if one.group == name):
            if sigma is None:
                unshown.append(f"{name} {axis}".rstrip())
            else:
                size = group.factor * sigma
                digits = decimals_of(size)
                values.append(f"{axis} {group.factor * value:+.{digits}f} +- {size:.2g}".lstrip())
        if values:
            yield name, f"{'  '.join(values)} {group.unit}"
    if unshown:
        yield (
            "unknown",
            f"{', '.join(unshown)}: not determined by this motion; the most likely values are used",
        )
    for text in result.valleys:
        yield "together", text
    if abs(result.time_offset_ns) >= MIN_OFFSET_NS:
        yield "time offset", f"{result.time_offset_ns / NS_PER_S:.6f}s, for compare"
    given, clock, after = (
        degrees_text(angle, 4)
        for angle in (
            result.rms_uncalibrated_rad,
            result.rms_clock_corrected_rad,
            result.rms_calibrated_rad,
        )
    )
    over = f"over {result.validation_windows} windows kept for validation"
    yield (
        "error",
        f"{given} RMS as given, {clock} with the clock, {after} with the file too, {over}",
    )
    gain = degrees_text(abs(result.rms_clock_corrected_rad - result.rms_calibrated_rad), 3)
    by_clock = degrees_text(result.rms_uncalibrated_rad - result.rms_clock_corrected_rad, 3)
    sigmas = [
        degrees_text(sigma, 2) for sigma in (result.gain_sigma_rad, result.clock_gain_sigma_rad)
    ]
    if result.is_worse:
        worse = "not written: it makes windows that were not used worse, by"
        yield "file", f"{worse} {gain} +- {sigmas[0]}"
    else:
        nothing = "" if result.is_better else ": not significant"
        yield "improvement", f"{gain} +- {sigmas[0]} by the file{nothing}"
    if result.rms_uncalibrated_rad != result.rms_clock_corrected_rad:
        yield "clock alone", f"{by_clock} +- {sigmas[1]}, which is not in the file"


AnySeries = TypeVar("AnySeries", GyroSeries, AttitudeSeries)


def calibrate(
    recording: Recording, reference: AttitudeSeries, settings: Mapping[str, Any]
) -> GyroCalibration:
    """Estimate a calibration of the rates of a recording.

    `settings`: parsed values of :data:`quatprop.settings.command_options.CALIBRATE`
    """
    rates, stream = _rates_of(recording, settings)
    # No window is across a gap, and other remarks on timestamps are about attitudes.
    remarks = [one for one in stream.remarks() if one.code not in OF_ATTITUDE]
    rates = _rising("log", rates, remarks)
    reference = _rising("reference", reference, remarks)
    question = _question(settings)
    found = estimate(rates, reference, question)
    model, of_windows = found.estimate.model, found.estimate.linear.used
    sigmas = np.sqrt(found.covariance.diagonal())
    values = model.values
    values[OF_GROUP == "offset"] += model.added_ns / NS_PER_S
    axes = [(name, axis) for name, group in GROUPS.items() for axis in group.axes]
    asked = np.flatnonzero(np.isin(OF_GROUP, question.names))
    validation = found.validation
    determined = found.determined[asked]
    known = np.flatnonzero(found.determined)
    return GyroCalibration(
        matrix=model.matrix @ found.mirror,
        bias_rad_s=found.mirror @ model.bias,
        mount_wxyz=model.mount,
        time_offset_ns=model.added_ns + round(model.offset * NS_PER_S),
        clock_drift=model.drift,
        parameters=tuple(
            CalibrationParameter(*axes[k], float(values[k]), float(sigmas[k]) if seen else None)
            for k, seen in zip(asked, determined, strict=True)
        ),
        covariance=found.covariance[np.ix_(known, known)],
        window_ns=found.windows.length_ns,
        windows_used=int(of_windows.sum()),
        outliers=int((~of_windows).sum()),
        validation_windows=validation.windows,
        rms_uncalibrated_rad=validation.given_rad,
        rms_clock_corrected_rad=validation.clock_rad,
        rms_calibrated_rad=validation.all_rad,
        clock_gain_sigma_rad=validation.clock_sigma_rad,
        gain_sigma_rad=validation.file_sigma_rad,
        valleys=tuple(_valleys(found)),
        dropped=stream.counts.dropped,
        remarks=(*remarks, *_remarks(found, rates, reference)),
    )


def _rates_of(recording: Recording, settings: Mapping[str, Any]) -> tuple[GyroSeries, RateStream]:
    """Return the samples that are used, and the stream that they come from."""
    names = ("on_backwards", "on_nonfinite") & settings.keys()
    part = GyroCorrection(start=settings.get("start"), end=settings.get("end"))
    policy = Policy(**{name: settings[name] for name in names})
    stream = RateStream(recording, RateSettings(policy, part))
    return GyroSeries.gathered(stream), stream


def _rising(name: str, series: AnySeries, remarks: list[Remark]) -> AnySeries:
    """Return the finite samples of a series, the first of each time; refuse steps back."""
    for _ in StampChecks(name, Policy()).examined([series], attrgetter("t_ns")):
        pass
    keep = np.isfinite(np.asarray(series)).all(axis=1)
    keep[1:] &= np.diff(series.t_ns) > 0
    if not keep.all():
        text = (
            f"{(~keep).sum()} samples of the {name} were omitted: not finite, or of the same time"
        )
        remarks.append(Remark("omitted", text))
        series = series[keep]
    if len(series) < MIN_WINDOWS:
        remedy = "record for longer" if name == "log" else "a few poses are not enough"
        raise ComparisonError(
            f"the {name} has {count_text(len(series), 'sample')}; a calibration needs at least "
            f"{MIN_WINDOWS}: {remedy}"
        )
    return series


def _question(settings: Mapping[str, Any]) -> Question:
    """Return the parameters to estimate, with their priors."""
    names = settings.get("estimate", tuple(GROUPS))
    offset_ns, mount = settings.get("time_offset"), settings.get("mount")
    if offset_ns == "auto":
        offset_ns = None
        if "offset" not in names:
            raise UsageError(
                f"{Setting('time_offset', 'auto')} is for offsets that are estimated; add offset "
                f"to {Setting('estimate')}, or give a duration"
            )
    return Question(
        names,
        {name: group.prior for name, group in GROUPS.items()} | settings.get("prior", {}),
        offset_ns,
        IDENTITY if mount is None else from_matrix(mounting(mount)),
        settings.get("window"),
    )


def _valleys(found: CalibrationEstimate) -> Iterator[str]:
    """Yield which parameters are hardly distinguished, and how much of one equals the other."""
    axes = [(name, axis) for name, group in GROUPS.items() for axis in group.axes]
    for i, j, slope in found.valleys():
        one, other = (GROUPS[axes[k][0]] for k in (i, j))
        names = [" ".join(axes[k]).strip() for k in (i, j)]
        units = [group.unit.split(",")[0] for group in (one, other)]
        # A change of the second that is one of its units.
        trade = slope * one.factor / other.factor
        yield f"{names[0]} and {names[1]}: 1 {units[1]} trades for {trade:+.2g} {units[0]}"


def _remarks(
    found: CalibrationEstimate, rates: GyroSeries, reference: AttitudeSeries
) -> Iterator[Remark]:
    """Yield remarks on the estimated values."""
    if (flipped := np.flatnonzero(found.mirror.diagonal() < 0)).size:
        axis = "xyz"[flipped[0]]
        yield Remark(
            "mirrored-axes",
            f"the axes of the log are left-handed: {axis} has the wrong sign; the values are for "
            f"rates with -{axis}, and no calibration file can state that: correct the log",
        )
    validation = found.validation
    sigma = validation.file_sigma_rad
    if (more := validation.all_rad - validation.clock_rad) > SIGNIFICANTLY_WORSE * sigma:
        yield Remark(
            "not-better",
            "windows that were not used are worse with the file by "
            f"{degrees_text(more, 3)} +- {degrees_text(sigma, 2)}, which is not chance: the errors "
            "of the rates change, or the reference does not show their motion, and the standard "
            "deviations are too small",
        )
    model = found.estimate.model
    if len(model.jumps) and np.abs(model.jumps).max() > WORTH_A_REMARK:
        changes = [
            f"by {', '.join(f'{value:+.2g}' for value in np.degrees(jump))} deg/s (x, y, z) at "
            f"{at_ns} ns, {duration_text(at_ns - int(rates.t_ns[0]))} after the first sample"
            for at_ns, jump in zip(model.jumps_ns, model.jumps, strict=True)
        ]
        yield Remark(
            "bias-jumps",
            f"the bias is not constant: it changes {'; '.join(changes)}. Its mean is stated, with "
            "a standard deviation that contains this. It improves short windows, but the error "
            "over the whole log may grow: compare shows it; calibrate and propagate the parts "
            f"between such changes one by one, with {Setting('start')} and {Setting('end')}",
        )
    unseen, alone = found.followed.unseen, ""
    if len(unseen) == 2:  # noqa: PLR2004  # axes of three
        (seen,) = {0, 1, 2} - {*unseen}
        turned = rotation_matrix(reference.wxyz) @ found.followed.axes[:, seen]
        alone = f", which turns about ({_axis_text(turned.mean(axis=0))}) of its own frame alone,"
    for k in unseen:
        axis = _axis_text(found.followed.axes[:, k])
        yield Remark(
            "reference-axis",
            f"the reference{alone} shows {found.followed.share[k]:.0%} of the rotation about the "
            f"body axis ({axis}), {degrees_text(found.followed.turn_rad[k], 2)} RMS by the "
            "gyroscope; what this rotation would show is not estimated",
        )


def _axis_text(axis: Float64) -> str:
    return ", ".join(f"{value:.2f}" for value in axis.round(2) + 0.0)
