"""Read the rates and the reference of a calibration, from files or memory, and estimate it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.errors import Loss
from quatprop.base.rendering import count_text
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.attitude_input import load_attitudes
from quatprop.propagation.recording import ReadInput, open_recording, recording_of
from quatprop.stores.objects import split_topic
from quatprop.tools.calibration import calibrate
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.base.text import Remark
    from quatprop.propagation.attitude_input import AttitudeInput
    from quatprop.settings.reading import RateSelection
    from quatprop.tools.calibration import GyroCalibration


class Calibrated(NamedTuple):
    """A calibration, and remarks on its inputs; `reference`: None for one in memory."""

    result: GyroCalibration
    log: ReadInput
    reference: ReadInput | None

    @property
    def remarks(self) -> list[Remark]:
        """Remarks on the reference and the result."""
        return [*(self.reference.remarks if self.reference else ()), *self.result.remarks]

    @property
    def losses(self) -> list[Loss]:
        """Losses of both inputs, with the rows of the reference that were left out."""
        losses = [*self.log.losses]
        if self.reference is not None:
            losses += self.reference.losses
            if dropped := self.reference.dropped:
                what = count_text(dropped, "invalid quaternion")
                losses.append(Loss(self.reference.name, what, dropped))
        return losses


def calibrate_inputs(
    log: str | GyroSeries,
    reference: AttitudeInput | AttitudeSeries,
    values: Mapping[str, Any],
    selection: RateSelection | None = None,
    kind: str | None = None,
) -> Calibrated:
    """Estimate a calibration from a log and a reference.

    `values`: parsed settings, keys of :data:`quatprop.settings.command_options.CALIBRATE`
    `selection`, `kind`: the signals to read, and the kind of the log
    """
    with ExitStack() as stack:
        if isinstance(log, GyroSeries):
            recording = recording_of(log)
        else:
            recording = stack.enter_context(open_recording([log], selection, kind))
        about = None
        if not isinstance(reference, AttitudeSeries):
            loaded = load_attitudes(replace(reference, covariances=False))
            about, reference = loaded.about, loaded.series
        result = calibrate(recording, reference, values)
        remarks = [*dict.fromkeys((*recording.remarks, *result.remarks))]
        of_log = ReadInput(recording.name, recording.losses, remarks, result.dropped)
    return Calibrated(result, of_log, about)


def refuse_to_replace(log: str, reference: str, output: str | None) -> None:
    """Refuse an output that would replace an input, each ``LOG`` or ``LOG:TOPIC``."""
    refuse_overlap([split_topic(one)[0] for one in (log, reference)], [output])
