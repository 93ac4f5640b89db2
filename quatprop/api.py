"""The library: read, propagate, convert, compare and write attitude from Python.

Thin wrappers around the code that the command line uses, with the same settings by the same names.
A value may be given as text, as on the command line, or as a Python value.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from inspect import cleandoc
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np

from quatprop.errors import DataLossWarning, RemarkWarning, SeriesError, UsageError
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings import (
    READ_ATTITUDES,
    READ_RATES,
    AttitudeOptions,
    PropagateOptions,
    RateOptions,
    SelectOptions,
    SeriesOptions,
)
from quatprop.settings.values import parse_all, refuse_unknown
from quatprop.text import Setting, Text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from os import PathLike
    from typing import Unpack

    from numpy.typing import NDArray

    from quatprop.comparison.result import Comparison
    from quatprop.comparison.settings import CompareOptions
    from quatprop.containers.base import Log, Loss
    from quatprop.conversion.job import ConversionReport
    from quatprop.pipeline.attitude_stream import AttitudeStream
    from quatprop.pipeline.report import RunReport
    from quatprop.pipeline.settings import PropagationSettings

    StrPath: TypeAlias = str | PathLike[str]

Function = TypeVar("Function", bound="Callable[..., object]")


def with_keywords_of(*classes: type) -> Callable[[Function], Function]:
    """Return a decorator that adds the keywords of classes to the parameters in a docstring."""

    def documented(function: Function) -> Function:
        # Without docstrings, as by python -OO, there is nothing to add to.
        if function.__doc__:
            added = [cleandoc(one.__doc__ or "").partition("---\n")[2] for one in classes]
            head, returns, rest = cleandoc(function.__doc__).partition("\n\nReturns\n")
            function.__doc__ = "\n".join([head, *added]) + returns + rest
        return function

    return documented


@dataclass(frozen=True, slots=True, repr=False)
class PropagatedSeries(AttitudeSeries):
    """Attitudes that were propagated, and the report of how.

    Takes the parameters of :class:`quatprop.AttitudeSeries` too.

    Parameters
    ----------
    report
        What was read, done, counted and lost.
    """

    report: RunReport = field(kw_only=True, compare=False, repr=False)

    def __getitem__(  # type: ignore[override]  # of no series with a report
        self, chosen: slice | NDArray[np.bool_] | NDArray[np.intp]
    ) -> AttitudeSeries:
        """Return some attitudes; the report is about all of them."""
        return AttitudeSeries(self.t_ns, self.wxyz, covariance=self.covariance)[chosen]


@with_keywords_of(SelectOptions, RateOptions)
def read_rates(log: StrPath, **options: Unpack[RateOptions]) -> GyroSeries:
    """Read the body rates of a log.

    Parameters
    ----------
    log
        A file, a ROS 2 bag folder, or the address of one in an object store.
    **options
        What to read of it, and what its numbers mean.

    Returns
    -------
    GyroSeries
        All samples in the order of the log: stamps in ns, rates in rad/s. Irregular timestamps are
        left as they are; :func:`propagate` handles them.

    Raises
    ------
    QuatpropError
        The log cannot be read as asked.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read.
    RemarkWarning
        Something was inferred, or looks wrong.
    """
    from quatprop.formats import open_log
    from quatprop.pipeline.settings import propagation_settings
    from quatprop.signals.rates import choose_rates

    path = _path("log", log)
    settings = propagation_settings(parse_all(options, READ_RATES))
    with open_log(path, settings.kind, msg_path=settings.selection.msg_path) as opened:
        signal = choose_rates(opened, settings.selection)
        batches = list(signal.batches())
        _warn(path, opened.losses, (*signal.remarks, *opened.remarks))
    return GyroSeries.joined(batches or [GyroSeries(np.zeros(0, np.int64), np.zeros((0, 3)))])


@with_keywords_of(SelectOptions, SeriesOptions, AttitudeOptions)
def read_attitudes(log: StrPath, **options: Unpack[AttitudeOptions]) -> AttitudeSeries:
    """Read an attitude series, of a log or of a table.

    Parameters
    ----------
    log
        As for :func:`read_rates`.
    **options
        What to read of it, and what its numbers mean.

    Returns
    -------
    AttitudeSeries
        Hamilton, body to reference, scalar first, whatever the file has; with the positions beside
        them, where there are any.

    Raises
    ------
    QuatpropError
        The log cannot be read as asked.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read, or rows were dropped.
    RemarkWarning
        Something was inferred.
    """
    from quatprop.signals.attitude_input import attitude_input, load_attitudes

    path = _path("log", log)
    loaded = load_attitudes(replace(attitude_input(path, options), positions=True))
    _warn(path, loaded.losses, loaded.signal.remarks, dropped=loaded.counts.invalid)
    return loaded.series


@with_keywords_of(SelectOptions, RateOptions, PropagateOptions)
def propagate(log: StrPath | GyroSeries, **options: Unpack[PropagateOptions]) -> PropagatedSeries:
    """Turn body rates into attitudes.

    The exact constant-rate step of each sample is accumulated: q[k+1] = q[k] * dq[k] for body rates
    (eq. 36), q[k+1] = dq[k] * q[k] for inertial ones (eq. 33), with dq = exp(w dt / 2) (eq. 35).

    Parameters
    ----------
    log
        A path as for :func:`read_rates`, or rates in memory.
    **options
        Which samples of a log, and how they are propagated.

    Returns
    -------
    PropagatedSeries
        N samples give N attitudes, the first is q0; `report` holds what was read, done, counted and
        lost.

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

    >>> rates = GyroSeries(np.arange(9) * 125_000_000, [[0, 0, np.pi]] * 9)
    >>> propagate(rates).as_quat(scalar_first=True)[-1].round(12).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    from quatprop.concurrency.threads import use_threads
    from quatprop.formats import open_log
    from quatprop.pipeline.attitude_stream import AttitudeStream
    from quatprop.pipeline.settings import propagation_settings
    from quatprop.signals.rates import choose_rates, signal_of_series

    settings = propagation_settings(options)
    if isinstance(log, GyroSeries):
        _refuse_log_settings(options)
        if not len(log):
            raise SeriesError("Expected a series with samples, got an empty one")
        in_memory = AttitudeStream("series", signal_of_series(log), settings, None)
        return _propagated("series", in_memory, settings, None)
    path = _path("log", log, "a GyroSeries")
    with (
        use_threads(settings.threads),
        open_log(path, settings.kind, msg_path=settings.selection.msg_path) as opened,
    ):
        signal = choose_rates(opened, settings.selection)
        stream = AttitudeStream(path, signal, settings, opened)
        return _propagated(path, stream, settings, opened)


def compare(
    a: StrPath | AttitudeSeries, b: StrPath | AttitudeSeries, **options: Unpack[CompareOptions]
) -> Comparison:
    """Measure the geodesic error between two attitude series.

    Parameters
    ----------
    a, b
        Paths as for :func:`read_attitudes`, or series in memory.
    tol, rms_tol, final_tol, p95_tol : str or float
        Limits on the worst, the RMS and the final error and on their 95th percentile: text such as
        ``"0.1deg"``, or rad; or ``"3sigma"``, of series that have standard deviations.
    window_tol, window_rms_tol : str or float
        Limits on the worst and the RMS error of rotations over windows.
    drift_tol : str
        Limit on the drift of the error, such as ``"10deg/h"``; with `align` none or first.
    min_coverage : float
        Percentage of B, of its samples and of its time, that must be compared.
    max_sigma : float
        Limit on the largest error in standard deviations (the Mahalanobis distance), of series
        that have them.
    align : str
        What B is rotated by first: ``"none"`` (the default), ``"first"``, ``"mean"`` or
        ``"mount"``.
    time_offset : str or int
        Added to B's stamps: text such as ``"-12ms"``, ns, or ``"auto"`` to find it.
    match : str
        ``"exact"``, ``"nearest"`` or ``"interpolate"``; by default what fits the stamps.
    max_dt : str or int
        How far apart samples that are matched may be: text such as ``"5ms"``, or ns.
    min_matched : float
        Percentage of the shorter series that must be matched, 50 by default.
    window : str or int
        Compare also the rotations over windows of this length: text such as ``"1s"``, or ns.

    Returns
    -------
    Comparison
        The errors, their statistics, and what explains them; `passed` tells whether every limit is
        kept.

    Raises
    ------
    QuatpropError
        The series cannot be read, or not compared as asked.

    Examples
    --------
    >>> a = AttitudeSeries([0, 1], [[1, 0, 0, 0], [1, 0, 0, 0]])
    >>> compare(a, a, tol="1e-9rad").passed
    True
    """
    from quatprop.comparison.compare import compare as compare_series
    from quatprop.comparison.settings import comparison_settings

    settings = comparison_settings(**options)
    return compare_series(_attitudes("a", a), _attitudes("b", b), settings)


def write(
    series: AttitudeSeries,
    path: StrPath,
    *,
    to: str | None = None,
    layout: str | None = None,
    beside: str | None = None,
    **unknown: object,
) -> None:
    """Write an attitude series to a file.

    Parameters
    ----------
    series
        What to write; where it has covariances, tables get the columns of :meth:`to_arrow
        <quatprop.AttitudeSeries.to_arrow>`.
    path
        Where; it is replaced when the new content is complete.
    to
        Format; by default that of the suffix. A name without a suffix is a ROS 2 bag folder.
    layout
        ``"scalar-first"`` or ``"scalar-last"``; by default what the format prescribes, or
        scalar-first where it leaves the choice.
    beside
        What else to write of each attitude into columns of a table, such as ``"euler-zyx-deg"``;
        a representation of :func:`convert`.

    Raises
    ------
    QuatpropError
        The path is not writable, the format does not support the settings, or rows are no unit
        quaternions.

    Warns
    -----
    RemarkWarning
        The series has positions, and the format has no place for them.
    """
    from quatprop.pipeline.report import convention_of
    from quatprop.writers import WRITERS, kind_of, layout_of, open_writer

    refuse_unknown(unknown, ("to", "layout", "beside"))
    if not isinstance(series, AttitudeSeries):
        raise SeriesError(f"Expected an AttitudeSeries, got {type(series).__name__}")
    _valid("series", series)
    place = _path("path", path)
    kind = kind_of(place, to)
    order = layout_of(kind, layout).name
    sigma = "body" if series.covariance is not None and WRITERS[kind].columns else None
    if isinstance(series, PropagatedSeries):
        report = series.report
        convention = replace(report.convention, layout=order)
        provenance = replace(report, convention=convention).as_json()
        if sigma and report.uncertainty is not None:
            sigma = report.uncertainty.columns_axes or sigma
    else:
        provenance = convention_of(order)
    with open_writer(place, to, layout=order, sigma=sigma, beside=beside) as writer:
        writer.write(series)
        writer.commit(provenance)


def convert(  # noqa: PLR0913  # one keyword for each option
    source: StrPath,
    output: StrPath,
    *,
    to: str | None = None,
    layout: str | None = None,
    beside: str | None = None,
    convention: str = "hamilton",
    direction: str = "body-to-ref",
    sign: str = "keep",
    representation: str = "quaternion",
    **options: Unpack[AttitudeOptions],
) -> ConversionReport:
    """Write an attitude series in another layout, convention, direction, form or format.

    Parameters
    ----------
    source, **options
        What to read, as for :func:`read_attitudes`.
    output, to, layout, beside
        Where and how to write, as for :func:`write`.
    convention
        ``"hamilton"`` or ``"jpl"``.
    direction
        ``"body-to-ref"`` or ``"ref-to-body"``.
    sign
        Of q and -q ``"keep"`` what is there, ``"continuous"`` the one nearer to the row before, or
        ``"positive"`` the one with w >= 0.
    representation
        ``"quaternion"``, ``"rotvec"`` (rad), ``"matrix"``, ``"euler-zyx"`` (rad) or
        ``"euler-zyx-deg"`` and so every other sequence of intrinsic rotations, or the rates that
        lead from each attitude to the next, ``"body-rates"`` or ``"inertial-rates"`` (rad/s):
        propagated by ``start`` they give the attitudes back.

    Returns
    -------
    ConversionReport
        What was read, done, counted and lost.

    Raises
    ------
    QuatpropError
        The source cannot be read as asked, or the output cannot be written.

    Warns
    -----
    DataLossWarning
        A part of the source could not be read, or rows were dropped.
    """
    from quatprop.conventions import Meaning
    from quatprop.conversion.convert import convert as convert_file
    from quatprop.conversion.job import Conversion
    from quatprop.pipeline.settings import OutputSettings
    from quatprop.signals.attitude_input import attitude_input

    own = ("to", "layout", "beside", "convention", "direction", "sign", "representation")
    refuse_unknown(options, (*own, *READ_ATTITUDES))
    wanted = attitude_input(_path("source", source), options)
    report = convert_file(
        Conversion(
            source=wanted,
            output=OutputSettings(_path("output", output), to=to, layout=layout, beside=beside),
            meaning=Meaning(convention, direction),
            sign=sign,
            representation=str(representation).lower(),
        )
    )
    if report.data_lost:
        warnings.warn(f"{wanted.path}: rows were lost or dropped", DataLossWarning, stacklevel=2)
    return report


def _path(name: str, path: StrPath, series: str = "") -> str:
    """Return a path as text; `series` is what arrays are made, where that is taken as well."""
    from quatprop.settings.parsers import path as parse_path

    try:
        return parse_path(path)
    except UsageError as error:
        hint = f"; make {series} of arrays" if series and not isinstance(path, str) else ""
        raise UsageError(f"{Setting(name)}: ", error.text, hint) from None


def _attitudes(name: str, source: StrPath | AttitudeSeries) -> AttitudeSeries:
    """Return one side of a comparison."""
    if isinstance(source, AttitudeSeries):
        return _valid(name, source)
    return read_attitudes(_path(name, source, "an AttitudeSeries"))


def _valid(name: str, series: AttitudeSeries) -> AttitudeSeries:
    """Return a series of attitudes; refuse others, as where they are read from a file."""
    from quatprop.signals.quaternion_check import QuaternionCheck

    check = QuaternionCheck(name)
    for _ in check.apply([(series.t_ns, series.wxyz)]):
        pass
    if series.covariance is not None:
        variances = np.diagonal(series.covariance, axis1=1, axis2=2)
        is_known = (np.isfinite(variances) & (variances >= 0)).all(axis=1)
        (others,) = np.nonzero(~is_known & ~np.isnan(variances).all(axis=1))
        if len(others):
            raise SeriesError(
                f"{name}: `covariance` of row {others[0]} has the variances "
                f"{variances[others[0]]}; they are 0 or above, or all NaN"
            )
    return series


def _refuse_log_settings(options: Mapping[str, object]) -> None:
    """Refuse settings that say what to read of a log, for rates in memory."""
    for name, value in options.items():
        if name in READ_RATES and value is not None:
            hint = "; scale the rates, with numpy.deg2rad" if name == "rate_unit" else ""
            raise UsageError(f"{Setting(name)} is for logs, not for rates in memory{hint}")


def _propagated(
    path: str, stream: AttitudeStream, settings: PropagationSettings, log: Log | None
) -> PropagatedSeries:
    from quatprop.pipeline.report import digests_of_inputs

    series = AttitudeSeries.joined(list(stream))
    report = replace(stream.report(), files=digests_of_inputs(settings.inputs, log))
    _warn(path, report.losses, report.remarks, dropped=report.counts.dropped, depth=4)
    return PropagatedSeries(series.t_ns, series.wxyz, covariance=series.covariance, report=report)


def _warn(
    path: str,
    losses: Iterable[Loss],
    remarks: Iterable[str | Text],
    *,
    dropped: int = 0,
    depth: int = 3,
) -> None:
    """Warn of losses and remarks at the line of the user's call, `depth` calls up."""
    for loss in losses:
        message = f"{path}: lost: {loss.place}: {loss.reason}"
        warnings.warn(message, DataLossWarning, stacklevel=depth)
    if dropped:
        warnings.warn(f"{path}: {dropped} rows were dropped", DataLossWarning, stacklevel=depth)
    for remark in remarks:
        warnings.warn(f"{path}: {remark}", RemarkWarning, stacklevel=depth)
