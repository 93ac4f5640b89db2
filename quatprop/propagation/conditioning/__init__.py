"""Conditioning of rates before they are propagated: calibration, mounting, time range.

Each step is a map over batches, so memory is constant. The order is fixed: non-monotonic
timestamps, the time range, non-finite rates; then the bias is subtracted in the axes of the raw
rates, scale and misalignment are corrected, and sensor axes are rotated to body axes.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import Remark, Setting
from quatprop.kinematics.conventions import FrameMounting, mounting
from quatprop.settings.bias import StaticBias
from quatprop.timeline.time_range import (
    Ends,
    EndsFinder,
    PartOfLog,
    PartReader,
    absolute_range,
    clipped,
    idle_remarks,
    length_text,
    pause_remarks,
)

if TYPE_CHECKING:
    from quatprop.settings.reading import GyroCorrection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from quatprop.base.arrays import Float64
    from quatprop.kinematics.series import GyroSeries
    from quatprop.propagation.conditioning.biases import BiasSeries, BiasSeriesReport
    from quatprop.propagation.conditioning.static_detection import RestBiases
    from quatprop.propagation.conditioning.static_period import Rows, StaticPeriod
    from quatprop.timeline import Timeline


FROM_TRANSFORMS = "tf:"
"""Prefix of a mounting from the transforms of the log."""


class GyroCorrectionInputs(NamedTuple):
    """Inputs from a log besides its rates; None if absent or not needed.

    `force`: reads timestamps and specific forces, shape ``(N, 3)``, any unit, sensor axes
    `orientation`: reads timestamps and recorded orientations, wxyz body -> reference, ``(N, 4)``
    `mounting`: the mounting from the transforms of the log
    """

    force: Callable[[], Rows] | None = None
    orientation: Callable[[], Rows] | None = None
    biases: BiasSeries | None = None
    mounting: FrameMounting | None = None
    topic: str = ""


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
    `start_ns`, `end_ns`: time range that was used, ends included, ns
    `outside`: number of samples read before and after this range
    `remarks`: remarks on the calibration, and on pauses at the origin of relative times
    `part`: the part of the log that was read; None: the whole log
    `length`: length of the log as text, for a time range relative to its ends
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
    outside: list[int]
    remarks: tuple[Remark, ...]
    part: PartOfLog | None
    length: str

    @property
    def all_rests(self) -> tuple[StaticPeriod, ...]:
        """The stationary periods from which the bias was estimated, in order of time."""
        return self.rests if self.rest is None else (self.rest,)

    @property
    def all_remarks(self) -> list[Remark]:
        """All remarks, after all samples were read."""
        return [*self.remarks, *(self.bias_series.remarks() if self.bias_series else ())]


def condition(  # noqa: PLR0913  # samples, settings, and inputs
    read: Callable[[], Iterable[GyroSeries]],
    timeline: Timeline,
    settings: GyroCorrection,
    unit: float,
    inputs: GyroCorrectionInputs,
    *,
    part_reader: Callable[[], PartReader | None] | None = None,
    begun: Callable[[Iterable[GyroSeries]], Iterable[GyroSeries]] = iter,
) -> tuple[Iterator[GyroSeries], GyroCorrectionReport]:
    """Return the conditioned samples, and the report of their corrections.

    `unit`: rad/s per unit of a bias without its own
    `begun`: inspects the samples before conditioning
    `Returns`: the samples, rad/s, body axes
    """
    mount = None if settings.mount is None or inputs.mounting else mounting(settings.mount)
    mount = inputs.mounting.matrix if inputs.mounting else mount
    matrix, bias, remarks = _calibration_of(settings, inputs)
    clips = settings.start is not None or settings.end is not None
    parts = part_reader() if clips and part_reader is not None else None
    ends, rests = _look_ahead(read, timeline, settings, inputs, parts)
    start_ns, end_ns = absolute_range(settings, ends)
    remarks = (*remarks, *pause_remarks(settings, ends))
    over_time: BiasSeries | RestBiases | None = inputs.biases
    if rests:
        from quatprop.propagation.conditioning.static_detection import RestBiases, worst_of

        remarks = (*remarks, *worst_of(rests).remarks)
        bias = rests[0].mean_rad_s
        if len(rests) > 1:
            over_time = RestBiases(rests, interpolated=settings.interpolates)
    if settings.bias is not None:
        bias = np.array(settings.bias.rad_s(unit))
    part, batches = (parts and parts.read(start_ns, end_ns)) or (None, iter(read()))
    report = GyroCorrectionReport(
        bias_rad_s=bias if over_time is None else None,
        rest=rests[0] if len(rests) == 1 else None,
        rests=rests if len(rests) > 1 else (),
        interpolated=settings.interpolates,
        bias_series=None if inputs.biases is None else inputs.biases.report,
        calibration=matrix,
        mount=mount,
        mount_frames=None if inputs.mounting is None else inputs.mounting.frames,
        start_ns=start_ns,
        end_ns=end_ns,
        outside=[0, 0],
        remarks=remarks,
        part=part,
        length=length_text(settings, ends),
    )
    numbered, outside = timeline.ordered(begun(batches)), report.outside
    if clips:
        inside = clipped(numbered, settings, start_ns, end_ns, outside)
        numbered = timeline.without(inside, outside)
    # Rates in the reference frame are not rotated by the mounting.
    if mount is not None and settings.rates == "body":
        matrix = mount if matrix is None else mount @ matrix
    used = timeline.finite(numbered)
    return conditioned(used, bias=over_time or bias, matrix=matrix), report


def _calibration_of(
    settings: GyroCorrection, inputs: GyroCorrectionInputs
) -> tuple[Float64 | None, Float64 | None, tuple[Remark, ...]]:
    """Return the matrix and the bias of a calibration, and remarks."""
    if settings.calibration is None:
        return None, None, ()
    from quatprop.propagation.conditioning.biases import read_calibration

    calibration = read_calibration(settings.calibration, inputs.topic)
    return calibration.matrix, calibration.bias_rad_s, calibration.remarks


def _look_ahead(
    read: Callable[[], Iterable[GyroSeries]],
    timeline: Timeline,
    settings: GyroCorrection,
    inputs: GyroCorrectionInputs,
    parts: PartReader | None,
) -> tuple[Ends, tuple[StaticPeriod, ...]]:
    """Return the ends of the log and its stationary periods, if they are needed."""
    if not settings.looks_ahead:
        return Ends(0, 0), ()
    static = settings.static
    if static is None and parts is not None and (ends := parts.ends()) is not None:
        return ends, ()
    finder = EndsFinder(earliest=timeline.policy.on_backwards == "sort")
    if static is None:
        deque(timeline.looked_ahead(read(), finder.add), maxlen=0)
        return finder.ends(), ()
    from quatprop.propagation.conditioning.static_detection import NoRestError, find_rests

    try:
        rests = find_rests(
            lambda note: timeline.looked_ahead(read(), note), finder, static, inputs, settings.rates
        )
    except NoRestError as error:
        way_out = f"; give {Setting('bias', 'X,Y,Z')}"
        if static.window_ns >= StaticBias().window_ns:
            way_out += f", or look for a shorter one with {Setting('bias', 'static:DUR')}"
        raise UsageError(error.text + way_out) from None
    return finder.ends(), rests


def conditioned(
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


def clipping_remarks(settings: GyroCorrection, report: GyroCorrectionReport) -> Iterator[Remark]:
    """Yield a remark for each absolute end without effect, and on parts that were not read."""
    outside = report.outside if report.part is None else report.part.leaves_out
    yield from idle_remarks(settings, *outside)
    if report.part is not None:
        yield Remark(
            "part-read",
            "only the part of the log around the time range was read, by its index: what is "
            "damaged or lost elsewhere is not reported, and there is no SHA-256 of the log",
        )
