"""Propagate the rates of a log, or rates in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, SupportsIndex, Unpack

from quatprop.api.reading import paths_of, warn, with_keywords_of
from quatprop.errors import QuatpropError, SeriesError, UsageError
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings import PropagateOptions
from quatprop.settings.reading import READ_RATES
from quatprop.text import Setting, in_python, with_settings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.api.reading import StrPath
    from quatprop.pipeline.attitude_stream import AttitudeStream
    from quatprop.pipeline.report import RunReport
    from quatprop.pipeline.settings import PropagationSettings
    from quatprop.tables.log import Log


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class PropagatedSeries(AttitudeSeries):
    """Propagated attitudes with the report of their propagation.

    Also takes the parameters of :class:`quatprop.AttitudeSeries`.

    Parameters
    ----------
    report
        Facts, settings, counts and losses of the propagation.
    """

    report: RunReport = field(kw_only=True, compare=False, repr=False)

    def __getitem__(  # type: ignore[override]  # of no series with a report
        self, chosen: SupportsIndex | slice | NDArray[np.bool_] | NDArray[np.intp]
    ) -> AttitudeSeries:
        """Return some attitudes, without the report, which is about all of them."""
        return AttitudeSeries(self.t_ns, self.wxyz, covariance=self.covariance)[chosen]


@with_keywords_of(PropagateOptions)
def propagate(
    log: StrPath | Sequence[StrPath] | GyroSeries, **options: Unpack[PropagateOptions]
) -> PropagatedSeries:
    """Turn body rates into attitudes.

    The exact constant-rate step of each sample is accumulated: q[k+1] = q[k] * dq[k] for body rates
    (eq. 36), q[k+1] = dq[k] * q[k] for inertial ones (eq. 33), with dq = exp(w dt / 2) (eq. 35).

    Parameters
    ----------
    log
        As for :func:`read_rates`, or rates in memory.
    **options
        Selection of samples, and settings of the propagation.

    Returns
    -------
    PropagatedSeries
        N samples give N attitudes, the first of which is q0; `report` has facts, counts and losses.

    Raises
    ------
    QuatpropError
        The log or the settings cannot be used.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read, or samples were dropped.
    RemarkWarning
        Something was inferred, or looks wrong: gaps, rates beyond any gyroscope...

    Examples
    --------
    Half a turn about z in one second:

    >>> import numpy as np
    >>> rates = GyroSeries(np.arange(9) * 125_000_000, [[0, 0, np.pi]] * 9)
    >>> propagate(rates).as_quat(scalar_first=True)[-1].round(12).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    from quatprop.pipeline.settings import propagation_settings

    settings = propagation_settings(options)
    if isinstance(log, GyroSeries):
        path = "series"
        refuse_log_settings(options)
        series = _propagated_in_memory(log, settings)
    else:
        paths = paths_of("log", log, "make a GyroSeries from arrays")
        path = " + ".join(paths)
        series = _propagated_log(paths, settings)
    report = series.report
    warn(path, report.losses, report.remarks, dropped=report.counts.dropped)
    return series


def _propagated_log(paths: Sequence[str], settings: PropagationSettings) -> PropagatedSeries:
    from quatprop.concurrency.threads import use_threads
    from quatprop.logs.joined import open_logs
    from quatprop.logs.signals.rates import choose_rates
    from quatprop.pipeline.attitude_stream import AttitudeStream

    kind, msg_path = settings.kind, settings.selection.msg_path
    with use_threads(settings.threads), open_logs(paths, kind, msg_path=msg_path) as log:
        rates = choose_rates(log, settings.selection)
        stream = AttitudeStream(" + ".join(paths), rates, settings, log)
        return _propagated(stream, settings, log)


def _propagated_in_memory(rates: GyroSeries, settings: PropagationSettings) -> PropagatedSeries:
    from quatprop.logs.signals.rates import signal_of_series
    from quatprop.pipeline.attitude_stream import AttitudeStream

    if not len(rates):
        raise SeriesError("Expected a series with samples, got an empty one")
    try:
        stream = AttitudeStream("series", signal_of_series(rates), settings, None)
        return _propagated(stream, settings, None)
    except QuatpropError as error:
        error.reason = _in_memory(error.reason)
        raise


_IN_MEMORY = {
    "rate_unit": "numpy.deg2rad",
    "time_unit": "unit",
    "time_col": "other stamps",
    "clock": "t_ns",
}
"""Setting in advice for logs -> the equivalent for rates in memory."""


def _in_memory(sentence: str) -> str:
    """Return a sentence with settings for logs replaced for rates in memory."""

    def advised(name: str, value: str, side: str) -> str:
        if name == "time_unit" and value:
            return "t_ns in ns"
        return _IN_MEMORY.get(name) or Setting(name, value, side)

    return in_python(with_settings(sentence, advised))


def refuse_log_settings(options: Mapping[str, object]) -> None:
    """Refuse settings for reading logs, which do not apply to rates in memory."""
    for name, value in options.items():
        if name in READ_RATES and value is not None:
            hint = "; scale the rates, with numpy.deg2rad" if name == "rate_unit" else ""
            raise UsageError(f"{Setting(name)} is for logs, not for rates in memory{hint}")


def _propagated(
    stream: AttitudeStream, settings: PropagationSettings, log: Log | None
) -> PropagatedSeries:
    from quatprop.pipeline.report import digests_of_inputs

    series = AttitudeSeries.gathered(stream)
    report = replace(stream.report(), files=digests_of_inputs(settings.inputs, log))
    spell = _in_memory if log is None else in_python
    report = replace(report, remarks=tuple(one.spelled(spell) for one in report.remarks))
    return PropagatedSeries(series.t_ns, series.wxyz, covariance=series.covariance, report=report)
