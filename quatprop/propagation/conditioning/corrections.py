"""Corrections of rates: bias, scale and misalignment, and the rotation to body axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from quatprop.base.arrays import Float64
    from quatprop.base.text import Remark
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.conditioning.biases import BiasSeries, BiasSeriesReport
    from quatprop.propagation.conditioning.correction_inputs import GyroCorrectionInputs
    from quatprop.propagation.conditioning.static_detection import RestBiases
    from quatprop.propagation.conditioning.static_period import StaticPeriod
    from quatprop.settings.reading import GyroCorrection
    from quatprop.timeline.time_range import PartOfLog


class GyroCorrectionReport(NamedTuple):
    """Corrections applied to the rates; None: not applied.

    `bias_rad_s`: constant bias subtracted from the rates, sensor axes, shape ``(3,)``, rad/s
    `rest`: stationary period from which it was estimated
    `rests`: stationary periods from which a bias over time was estimated, in order of time; empty
        for fewer than two
    `interpolated`: whether it was interpolated between them, instead of taking the nearest
    `bias_series`: series from which the bias was interpolated
    `calibration`: matrix that multiplies the rates after the bias is subtracted, shape ``(3, 3)``
    `mount`: matrix from sensor to body axes, shape ``(3, 3)``
    `mount_frames`: frames from the sensor's to the body's, if the mounting is from transforms
    `start_ns`: start of the time range that was used, included, ns
    `end_ns`: end of the time range that was used, included, ns
    `part`: the part of the log that was read; None: the whole log
    `remarks`: remarks on the calibration and the stationary periods
    """

    bias_rad_s: Float64 | None
    rest: StaticPeriod | None
    rests: tuple[StaticPeriod, ...]
    interpolated: bool
    bias_series: BiasSeriesReport | None
    calibration: Float64 | None
    mount: Float64 | None
    mount_frames: tuple[str, ...] | None
    start_ns: int | None
    end_ns: int | None
    part: PartOfLog | None
    remarks: tuple[Remark, ...]

    @property
    def all_rests(self) -> tuple[StaticPeriod, ...]:
        """The stationary periods from which the bias was estimated, in order of time."""
        return self.rests if self.rest is None else (self.rest,)

    @property
    def all_remarks(self) -> list[Remark]:
        """All remarks, after all samples were read."""
        return [*self.remarks, *(self.bias_series.remarks() if self.bias_series else ())]


def calibration_of(
    settings: GyroCorrection, inputs: GyroCorrectionInputs
) -> tuple[Float64 | None, Float64 | None, tuple[Remark, ...]]:
    """Return the matrix and the bias of a calibration, and remarks."""
    if settings.calibration is None:
        return None, None, ()
    from quatprop.propagation.conditioning.biases import read_calibration

    calibration = read_calibration(settings.calibration, inputs.topic)
    return calibration.matrix, calibration.bias_rad_s, calibration.remarks


def corrected(
    batches: Iterable[GyroSeries],
    *,
    bias: Float64 | BiasSeries | RestBiases | None = None,
    matrix: Float64 | None = None,
) -> Iterator[GyroSeries]:
    """Yield rates with the bias subtracted, in body axes.

    `batches`: raw rates in sensor axes, rad/s
    `bias`: sensor axes, shape ``(3,)``, rad/s; or a bias over time
    `matrix`: product of mounting and calibration, applied after the bias, shape ``(3, 3)``
    """
    if bias is None and matrix is None:
        yield from batches
        return
    for batch in batches:
        rate = batch.rate
        if bias is not None:
            rate = rate - (bias if isinstance(bias, np.ndarray) else bias.at(batch.t_ns))
        if matrix is not None:
            rate = _transformed(rate, matrix)
        yield batch.with_rate(rate)


def _transformed(rate: Float64, matrix: Float64) -> Float64:
    """Return ``rate @ matrix.T``, with rounding independent of the position in the batch.

    The rounding of a matrix product depends on the blocks and threads of BLAS.
    """
    x, y, z = rate.T
    # The policy for non-finite rates is applied elsewhere.
    with np.errstate(invalid="ignore", over="ignore"):
        return np.stack([x * row[0] + y * row[1] + z * row[2] for row in matrix], axis=1)
