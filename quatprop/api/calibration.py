"""Estimate the calibration of a gyroscope from a reference attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

from quatprop.api.reading import path_text, read_rates, warn, with_keywords_of
from quatprop.calibration.settings import CALIBRATE, CalibrateOptions
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings.values import parse_all
from quatprop.text import in_python

if TYPE_CHECKING:
    from quatprop.api.reading import StrPath
    from quatprop.calibration.result import GyroCalibration


@with_keywords_of(CalibrateOptions)
def calibrate(
    log: StrPath | GyroSeries,
    reference: StrPath | AttitudeSeries,
    **options: Unpack[CalibrateOptions],
) -> GyroCalibration:
    """Estimate bias, scale, misalignment, mounting and clock of a gyroscope from a reference.

    Rotations over windows are compared, so the reference frame is free; outliers are left out. A
    third of the windows is not used, and shows what the calibration improves.

    Parameters
    ----------
    log
        Raw rates: a path as for :func:`read_rates`, or a series in memory.
    reference
        Attitudes of the body: a path as for :func:`read_attitudes`, or a series in memory.
    **options
        What to estimate, and from what.

    Returns
    -------
    GyroCalibration
        The values with their covariance, and the error without and with them.

    Raises
    ------
    QuatpropError
        The series cannot be read, or have too little in common.

    Notes
    -----
    Gauss-Newton minimises the differences between the rotations by the rates and those of the
    reference. The covariance is that of white noise, or larger where parts of the recording differ
    by more. Of a recording with more than 200,000 windows, about that many are used, evenly spaced.
    """
    from quatprop.calibration.calibrate import calibrate as calibrate_series
    from quatprop.logs.attitude_input import attitude_input, load_attitudes

    values = parse_all(options, CALIBRATE)
    if not isinstance(log, GyroSeries):
        log = read_rates(path_text("log", log, "make a GyroSeries from arrays"))
    if not isinstance(reference, AttitudeSeries):
        path = path_text("reference", reference, "make an AttitudeSeries from arrays")
        loaded = load_attitudes(replace(attitude_input(path, {}), covariances=False))
        warn(path, loaded.losses, loaded.signal.remarks, dropped=loaded.counts.invalid)
        reference = loaded.series
    log = log.between(options.get("start"), options.get("end"))
    result = calibrate_series(log, reference, values)
    return replace(result, remarks=tuple(one.spelled(in_python) for one in result.remarks))
