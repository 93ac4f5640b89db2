"""What conditioning takes from a log besides its rates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conditioning import FROM_TRANSFORMS, ConditioningInputs
from quatprop.errors import LogError, UsageError
from quatprop.signals.quaternion_check import QuaternionCheck

if TYPE_CHECKING:
    from quatprop.conditioning import Conditioning
    from quatprop.conditioning.cells import Rows
    from quatprop.containers.base import MessageLog
    from quatprop.selection import RateSelection
    from quatprop.signals.signal import RateSignal
    from quatprop.tables.base import TableLog


def conditioning_inputs(
    log: MessageLog | TableLog | None,
    source: RateSignal,
    selection: RateSelection,
    wanted: Conditioning,
) -> ConditioningInputs:
    """Return what is needed besides the rates.

    Parameters
    ----------
    log
        An open log that can be read again; None for rates in memory.
    source, selection
        Its rates, and how they were chosen.
    wanted
        What is to be done to them.

    Raises
    ------
    LogError, UsageError
        The biases or the mounting that are asked for cannot be read.
    """
    biases = mounting = None
    if wanted.bias_from is not None:
        from quatprop.signals.biases import read_biases

        biases = read_biases(wanted.bias_from, log, selection)
    if wanted.mount is not None and wanted.mount.startswith(FROM_TRANSFORMS):
        from quatprop.signals.static_transforms import frame_mounting

        mounting = frame_mounting(log, source, wanted.mount.removeprefix(FROM_TRANSFORMS))
    if log is None:
        return ConditioningInputs(biases=biases, mounting=mounting)
    return ConditioningInputs(
        force=lambda: _force(log, source, selection),
        orientation=lambda: _orientation(log, source, selection),
        biases=biases,
        mounting=mounting,
        topic=source.name,
    )


def _force(log: MessageLog | TableLog, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield specific forces, if the log has some that can be read."""
    from quatprop.signals.beside_rates import specific_forces

    try:
        yield from specific_forces(log, source, selection) or ()
    except (LogError, UsageError):
        return


def _orientation(log: MessageLog | TableLog, source: RateSignal, selection: RateSelection) -> Rows:
    """Yield the log's own orientation, if it has one that was ever set."""
    from quatprop.signals.beside_rates import own_orientation

    try:
        own = own_orientation(log, source, selection)
    except (LogError, UsageError):
        return
    if not own.placeholder:
        for series in QuaternionCheck(log.path, drop=True).apply(own.rows()):
            yield series.t_ns, series.wxyz
