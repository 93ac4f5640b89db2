"""Measure the noise of a gyroscope at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from quatprop.api.propagation import refuse_log_settings
from quatprop.api.reading import paths_of, warn, with_keywords_of
from quatprop.series import GyroSeries
from quatprop.settings.reading import NOISE, NoiseOptions
from quatprop.settings.values import parse_all

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.api.reading import StrPath
    from quatprop.sensor_noise.result import Noise


@with_keywords_of(NoiseOptions)
def noise(log: StrPath | Sequence[StrPath] | GyroSeries, **options: Unpack[NoiseOptions]) -> Noise:
    """Measure the noise of a gyroscope while it is at rest, by its Allan deviation.

    Periods of rest are found by rate, accelerometer and orientation. The overlapping Allan variance
    over them [1]_ is explained by 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3, and
    a ramp, R^2 tau^2 / 2, so that a drift with temperature is no random walk: generalised least
    squares with the covariance of the variances, which follows from the terms [2]_.

    Parameters
    ----------
    log
        As for :func:`read_rates`, or rates in memory.
    **options
        Which samples of a log.

    Returns
    -------
    Noise
        The deviation with its confidence interval, and the terms of each axis and of all together:
        `combined` is what to use. What the recording does not show has a bound and no value.

    Raises
    ------
    QuatpropError
        The log cannot be read as asked, or is at rest nowhere, or too short.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read, or samples were dropped.
    RemarkWarning
        Something looks wrong, such as gaps, or a deviation that the terms do not explain.

    References
    ----------
    .. [1] IEEE Std 952-2020, Annex C.
    .. [2] C. A. Greenhall and W. J. Riley, "Uncertainty of Stability Variances Based on Finite
       Differences", 35th Precise Time and Time Interval Meeting, 2003.

    Examples
    --------
    >>> import numpy as np
    >>> rate = 1e-3 * np.random.default_rng(1).standard_normal((60_000, 3))
    >>> found = noise(GyroSeries(np.arange(60_000) * 10_000_000, rate))
    >>> density = found.combined.angle_random_walk  # the truth is 1e-3 / sqrt(100 Hz)
    >>> print(f"{density.value:.2e} {density.sigma:.0e} rad/s/sqrt(Hz)")
    1.00e-04 3e-07 rad/s/sqrt(Hz)
    """
    from quatprop.logs.signals.rates import signal_of_series
    from quatprop.sensor_noise.measure import measure, measure_logs

    values = parse_all(options, NOISE)
    if isinstance(log, GyroSeries):
        path = "series"
        refuse_log_settings(options)
        found = measure(path, signal_of_series(log), values, None)
    else:
        paths = paths_of("log", log, "make a GyroSeries from arrays")
        path = " + ".join(paths)
        found = measure_logs(paths, values)
    warn(path, found.losses, found.remarks, dropped=found.dropped)
    return found
