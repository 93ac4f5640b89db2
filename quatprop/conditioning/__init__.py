"""Conditioning of rates before they are propagated: calibration, mounting, time range.

Each step is a map over batches, so memory stays constant. The order is fixed: stamps that go
backwards, the time range, rates that are not finite; then the bias is subtracted in the axes of the
raw rates, scale and misalignment are corrected, and sensor axes are converted to body axes.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.conditioning.mounting import FrameMounting, mounting
from quatprop.conditioning.time_range import (
    Ends,
    EndsFinder,
    PartOfLog,
    PartReader,
    absolute_range,
    clipped,
    length_text,
    pause_remarks,
)
from quatprop.errors import UsageError
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from quatprop.arrays import Float64
    from quatprop.conditioning.calibration import BiasSeries, BiasSeriesReport
    from quatprop.conditioning.rests import RestBiases
    from quatprop.conditioning.static_period import StaticPeriod
    from quatprop.conditioning.window_sums import Rows
    from quatprop.series import GyroSeries
    from quatprop.settings.rotations import InMemory
    from quatprop.settings.static_bias import StaticBias
    from quatprop.text import Remark
    from quatprop.timeline import Timeline
    from quatprop.times import Instant


class GyroCorrection(NamedTuple):
    """What to do to the rates; None is nothing.

    `bias`: subtracted from every rate, x, y, z, in the unit of the source
    `static`: take the mean over a rest of the log as the bias
    `bias_from`: take the bias from a series of them: a file, a topic of the log, or in memory
    `calibration`: path of a calibration, as
        :func:`quatprop.conditioning.calibration.read_calibration` reads it. A bias given beside it
        takes the place of its own
    `mount`: sensor axes to body axes, as :func:`mounting` reads it, or ``"tf:FRAME"``
    `rates`: ``"body"`` or ``"inertial"``: the frame in which the rates are resolved. Those in the
        reference frame are not rotated by the mounting
    `start`, `end`: the part of the log to use, ends included
    """

    bias: tuple[float, ...] | None = None
    static: StaticBias | None = None
    bias_from: str | InMemory | None = None
    calibration: str | None = None
    mount: str | None = None
    rates: str = "body"
    start: Instant | None = None
    end: Instant | None = None

    @property
    def interpolates(self) -> bool:
        """Whether the bias changes linearly between rests."""
        return self.static is not None and self.static.between == "interpolate"

    @property
    def looks_ahead(self) -> bool:
        """Whether the log has to be read once before it is read for the propagation."""
        origins = {instant.origin for instant in (self.start, self.end) if instant is not None}
        return self.static is not None or bool(origins - {"clock"})


FROM_TRANSFORMS = "tf:"
"""Begins a mounting that is taken from the transforms of the log."""


class GyroCorrectionInputs(NamedTuple):
    """What is known of a log besides its rates; None if it is not there or not asked for.

    `force`: reads stamps and specific forces, shape ``(N, 3)``, any unit, sensor axes
    `orientation`: reads stamps and the log's own orientation, wxyz body -> reference, shape ``(N,
        4)``
    `mounting`: that from the transforms of the log
    """

    force: Callable[[], Rows] | None = None
    orientation: Callable[[], Rows] | None = None
    biases: BiasSeries | None = None
    mounting: FrameMounting | None = None
    topic: str = ""


class GyroCorrectionReport(NamedTuple):
    """What was done to the rates; None is nothing.

    `bias_rad_s`: subtracted from every rate, sensor axes, shape ``(3,)``, rad/s
    `rest`: the rest from which it was taken
    `rests`: those from which a bias over time was taken, in the order of time; none for fewer than
        two
    `interpolated`: whether it was interpolated between them, or is the bias of the nearest
    `bias_series`: the series from which it was taken, interpolated in time
    `calibration`: what the rates are multiplied by after the bias is subtracted, shape ``(3, 3)``
    `mount`: matrix from sensor to body axes, shape ``(3, 3)``
    `mount_frames`: where the mounting is from the log's transforms: the frames from the sensor's to
        the body's
    `start_ns`, `end_ns`: the part of the log that was used, ends included, ns
    `outside`: samples left out before and after that part, so far; those that were read
    `remarks`: what of the calibration is not applied, and pauses from which relative times count
    `part`, `length`: the part of the log that was read, where it was not the whole; how long it is
        in words
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
        """The rests from which the bias was taken, in the order of time."""
        return self.rests if self.rest is None else (self.rest,)

    @property
    def all_remarks(self) -> list[Remark]:
        """What a reader should know, once all samples have passed."""
        return [*self.remarks, *(self.bias_series.remarks() if self.bias_series else ())]


def condition(  # noqa: PLR0913  # samples, what to do, and what is known
    read: Callable[[], Iterable[GyroSeries]],
    timeline: Timeline,
    settings: GyroCorrection,
    unit: float,
    inputs: GyroCorrectionInputs,
    *,
    part_reader: Callable[[], PartReader | None] | None = None,
    begun: Callable[[Iterable[GyroSeries]], Iterable[GyroSeries]] = iter,
) -> tuple[Iterator[GyroSeries], GyroCorrectionReport]:
    """Return the conditioned samples, and what is done to them.

    `unit`: rad/s in the unit of the bias
    `begun`: looks at the samples as the log has them
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
        from quatprop.conditioning.rests import RestBiases, worst_of

        remarks = (*remarks, *worst_of(rests).remarks)
        bias = rests[0].mean_rad_s
        if len(rests) > 1:
            over_time = RestBiases(rests, interpolated=settings.interpolates)
    if settings.bias is not None:
        bias = np.array(settings.bias) * unit
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
    """Return the matrix and the bias of a calibration, and remarks about it."""
    if settings.calibration is None:
        return None, None, ()
    from quatprop.conditioning.calibration import read_calibration

    calibration = read_calibration(settings.calibration, inputs.topic)
    return calibration.matrix, calibration.bias_rad_s, calibration.remarks


def _look_ahead(
    read: Callable[[], Iterable[GyroSeries]],
    timeline: Timeline,
    settings: GyroCorrection,
    inputs: GyroCorrectionInputs,
    parts: PartReader | None,
) -> tuple[Ends, tuple[StaticPeriod, ...]]:
    """Return the first and the last sample, and the rests, where they matter."""
    if not settings.looks_ahead:
        return Ends(0, 0), ()
    static = settings.static
    if static is None and parts is not None and (ends := parts.ends()) is not None:
        return ends, ()
    finder = EndsFinder(earliest=timeline.policy.on_backwards == "sort")
    if static is None:
        deque(timeline.looked_ahead(read(), finder.add), maxlen=0)
        return finder.ends(), ()
    from quatprop.conditioning.rests import find_rests
    from quatprop.conditioning.static_detection import NoRestError

    try:
        rests = find_rests(
            lambda note: timeline.looked_ahead(read(), note), finder, static, inputs, settings.rates
        )
    except NoRestError as error:
        shorter = Setting("bias", "static:DUR")
        raise UsageError(
            f"{error.text}; give {Setting('bias', 'X,Y,Z')}, or look for a shorter one with "
            f"{shorter}"
        ) from None
    return finder.ends(), rests


def conditioned(
    batches: Iterable[GyroSeries],
    *,
    bias: Float64 | BiasSeries | RestBiases | None = None,
    matrix: Float64 | None = None,
) -> Iterator[GyroSeries]:
    """Yield rates without their bias, in body axes.

    `batches`: raw rates in sensor axes, rad/s
    `bias`: subtracted from every rate, shape ``(3,)``, rad/s, sensor axes; or biases over time
    `matrix`: what the rates are multiplied by then, shape ``(3, 3)``: calibration and mounting
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
    """Return ``rate @ matrix.T``, each row rounded alike wherever it is in its batch.

    How a matrix product rounds depends on the blocks and threads it is computed with.
    """
    x, y, z = rate.T
    # What is not finite is found where the policy for it is known.
    with np.errstate(invalid="ignore", over="ignore"):
        return np.stack([x * row[0] + y * row[1] + z * row[2] for row in matrix], axis=1)
