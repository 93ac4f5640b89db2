"""Functions on series: read, propagate, compare, convert, write."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, field, replace
from inspect import cleandoc
from itertools import chain
from os import PathLike
from typing import TYPE_CHECKING, Any, SupportsIndex, TypeAlias, TypeVar, Unpack, cast

import numpy as np

from quatprop.base.errors import (
    DataLossWarning,
    QuatpropError,
    RemarkWarning,
    SeriesError,
    UsageError,
)
from quatprop.base.rendering import loss_text
from quatprop.base.text import Remark, Setting, in_python, quoted, spelled, with_settings
from quatprop.kinematics.array_conversion import rows_of, times_of
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import Series
from quatprop.settings import PropagateOptions, parse_all, refuse_unknown
from quatprop.settings.command_options import (
    COMPARE,
    CONVERT,
    TERMS,
    CompareOptions,
    ConvertOptions,
)
from quatprop.settings.parsers import parameters
from quatprop.settings.parsers import path as parse_path
from quatprop.settings.reading import (
    RATES_IN_MEMORY,
    READ_ATTITUDES,
    READ_RATES,
    AttitudeOptions,
    ReadOptions,
)
from quatprop.stores.objects import split_topics

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from quatprop.base.errors import Loss, QuatpropWarning
    from quatprop.comparison.mistakes import Cause
    from quatprop.comparison.result import Comparison
    from quatprop.propagation.recording import Recording
    from quatprop.propagation.report import RunReport
    from quatprop.propagation.settings import PropagationSettings
    from quatprop.settings.quantities import Layout
    from quatprop.tools.conversion import ConversionReport

    StrPath: TypeAlias = str | PathLike[str]


# Read body rates and attitudes of a log into memory.


Function = TypeVar("Function", bound="Callable[..., object]")


def with_keywords_of(
    options: type, signal: str = "rates", log: str = "the log"
) -> Callable[[Function], Function]:
    """Return a decorator that adds the keywords of a class to the parameters in a docstring."""

    def documented(function: Function) -> Function:
        # python -OO removes docstrings.
        if function.__doc__:
            head, returns, rest = cleandoc(function.__doc__).partition("\n\nReturns\n")
            function.__doc__ = f"{head}\n{parameters(options, signal, log)}{returns}{rest}"
        return function

    return documented


@with_keywords_of(ReadOptions)
def read_rates(log: StrPath | Sequence[StrPath], **options: Unpack[ReadOptions]) -> GyroSeries:
    """Read the body rates of a log.

    Parameters
    ----------
    log
        A file, a ROS 2 bag folder, or an address in an object store; several files of one recording
        are read as one log, in order of time.
    **options
        Selection of rates, and their units and timestamps.

    Returns
    -------
    GyroSeries
        All samples in the order of the log: timestamps in ns, rates in rad/s. Irregular timestamps
        are unchanged unless `regular_time` is set; :func:`propagate` handles them.

    Raises
    ------
    QuatpropError
        The log cannot be read as requested.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read.
    RemarkWarning
        Something was inferred, or looks wrong.
    """
    from quatprop.propagation.plausibility import clock_watch_of
    from quatprop.propagation.recording import open_recording
    from quatprop.settings.reading import RateSelection
    from quatprop.timeline.counts import OBSERVE
    from quatprop.timeline.policies import Timeline

    values = parse_all(options, RATES_IN_MEMORY)
    names, selection = paths_of("log", log, MAKE_RATES), RateSelection.from_settings(values)
    with open_recording(names, selection, values.get("kind")) as recording:
        signal = recording.rate_signal()
        clock = clock_watch_of(recording.log, signal)
        batches = signal.batches(watch=len if clock is None else clock.add_rows)
        if values.get("regular_time"):
            regular = OBSERVE._replace(regular_time=True)
            batches = Timeline(regular, recording.name).apply(batches)
        first = next(batches, GyroSeries(np.zeros(0, np.int64), np.zeros((0, 3))))
        series = GyroSeries.gathered(chain([first], batches), signal.row_count())
        said = clock.remarks() if clock else ()
        warn(recording.name, recording.losses, (*signal.remarks, *said, *recording.remarks))
    return series


@with_keywords_of(AttitudeOptions, "attitudes")
def read_attitudes(log: StrPath, **options: Unpack[AttitudeOptions]) -> AttitudeSeries:
    """Read an attitude series from a log or a table.

    Parameters
    ----------
    log
        As for :func:`read_rates`.
    **options
        Selection of attitudes, and their conventions and timestamps.

    Returns
    -------
    AttitudeSeries
        Attitudes converted to Hamilton, body to reference, scalar first; with positions, if there
        are any.

    Raises
    ------
    QuatpropError
        The log cannot be read as requested.

    Warns
    -----
    DataLossWarning
        A part of the log could not be read, or rows were dropped.
    RemarkWarning
        Something was inferred.
    """
    from quatprop.propagation.attitude_input import attitude_input, load_attitudes

    path = path_text("log", log, MAKE_ATTITUDES)
    loaded = load_attitudes(replace(attitude_input(path, options), positions=True))
    warn(path, loaded.losses, loaded.signal.remarks, dropped=loaded.counts.invalid)
    return loaded.series


def read_metadata(path: StrPath, *, topic: str | None = None) -> dict[str, Any]:
    """Return how an output was made, as it says itself.

    Parameters
    ----------
    path
        An output of quatprop that has metadata: Parquet, Feather, NPZ, MCAP, a bag, or text with
        ``--header-comment``.
    topic
        The topic of the attitudes, if there are several.

    Returns
    -------
    dict
        What JSON reports have: ``source``, ``settings``, ``convention``, ``counts``, ``losses``...

    Raises
    ------
    QuatpropError
        The file cannot be read, or has no metadata of quatprop.
    """
    from quatprop.propagation.survey import provenance_of
    from quatprop.settings.reading import RateSelection

    name = path_text("path", path)
    provenance = provenance_of(name, None, RateSelection(topic=topic))
    if not provenance:
        raise UsageError(
            f"{name}: it does not say how it was made; outputs of quatprop do in Parquet, Feather, "
            "NPZ, MCAP and bags"
        )
    return provenance


ARRAYS = (
    "arrays and columns of a table are propagate(t, w), such as "
    "propagate(table['t_ns'], table[['wx', 'wy', 'wz']])"
)
MAKE_RATES = "GyroSeries(t_ns, rate) takes arrays and columns of a table"
MAKE_ATTITUDES = "AttitudeSeries(t_ns, wxyz) takes arrays and columns of a table"
"""Advice for values in memory in place of a path."""


def path_text(name: str, path: StrPath, hint: str = "") -> str:
    """Return a path as text; `hint`: advice for arrays or series."""
    try:
        return parse_path(path)
    except UsageError as error:
        hint = f"; {hint}" if hint and not isinstance(path, str) else ""
        raise UsageError(f"{Setting(name)}: {error.text}{hint}") from None


def paths_of(name: str, paths: StrPath | Sequence[StrPath], hint: str = "") -> list[str]:
    """Return one path, or several, as texts."""
    several = paths if isinstance(paths, list | tuple) and paths else [paths]
    return [path_text(name, path, hint) for path in cast("Sequence[StrPath]", several)]


def warn(
    path: str,
    losses: Iterable[Loss],
    remarks: Iterable[Remark],
    *,
    dropped: int = 0,
) -> None:
    """Warn of losses and remarks."""
    lost = [(loss_text(loss), loss.messages) for loss in losses]
    for text, messages in [*lost, *[(f"{dropped} rows were dropped", dropped)] * bool(dropped)]:
        loss_warning = DataLossWarning(f"{path}: {text}")
        loss_warning.messages = messages
        issue(loss_warning)
    for remark in remarks:
        warning = RemarkWarning(f"{path}: {spelled(remark)}")
        warning.code = remark.code
        issue(warning)


def issue(warning: QuatpropWarning) -> None:
    """Issue a warning at the line in the user's code that called the library."""
    level, frame = 2, sys._getframe(1)  # noqa: SLF001  # no public equivalent
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("quatprop."):
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


# Propagate the rates of a log, or rates in memory.


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

    @property
    def sigma_axes(self) -> str:  # type: ignore[override]  # a constant of other attitudes
        """The axes of the standard deviations in tables, ``"body"`` or ``"reference"``."""
        stated = self.report.uncertainty
        return (stated and stated.columns_axes) or "body"

    def __getitem__(  # type: ignore[override]  # of no series with a report
        self, chosen: SupportsIndex | slice | NDArray[np.bool_] | NDArray[np.intp]
    ) -> AttitudeSeries:
        """Return some attitudes, without the report, which describes all of them."""
        kept = AttitudeSeries(
            self.t_ns,
            self.wxyz,
            covariance=self.covariance,
            lag_ns=self.lag_ns,
            sensitivity=self.sensitivity,
        )
        return kept[chosen]


@with_keywords_of(PropagateOptions)
def propagate(
    log: StrPath | Sequence[StrPath] | GyroSeries | ArrayLike,
    w: ArrayLike | None = None,
    **options: Unpack[PropagateOptions],
) -> PropagatedSeries:
    """Turn body rates into attitudes.

    The exact constant-rate step of each sample is accumulated: q[k+1] = q[k] * dq[k] for body rates
    (eq. 36), q[k+1] = dq[k] * q[k] for inertial ones (eq. 33), with dq = exp(w dt / 2) (eq. 35).

    Parameters
    ----------
    log
        As for :func:`read_rates`, or rates in memory: a series, or the timestamps of `w`.
    w
        Rates in memory, shape ``(N, 3)``, rad/s, in place of a log; then `log` has their
        timestamps, shape ``(N,)``: floats in seconds, integers in ns, or dates.
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
    >>> t = np.arange(9) / 8
    >>> propagate(t, [[0, 0, np.pi]] * 9).as_quat(scalar_first=True)[-1].round(12).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    from quatprop.propagation.settings import propagation_settings

    if w is not None:
        log = _series_of(log, w)
    if isinstance(log, GyroSeries):
        settings = propagation_settings(options)
        refuse_log_settings(options)
        series = _propagated_in_memory(log, settings)
    else:
        names = paths_of("log", cast("StrPath", log), ARRAYS)
        paths, topic = split_topics(names, options.get("topic"))
        settings = propagation_settings({**options, "topic": topic})
        series = _propagated_log(paths, settings)
    report = series.report
    warn(report.source.path, report.losses, report.remarks, dropped=report.counts.dropped)
    return series


def _series_of(t: object, w: object) -> GyroSeries:
    """Return a series of bare arrays of timestamps and rates."""
    if isinstance(t, str | PathLike | Series):
        raise UsageError(f"{Setting('w')} goes with an array of timestamps, not with a log")
    t_ns = times_of("t", t)
    return GyroSeries(t_ns, rows_of("w", w, len(t_ns), 3))


def _propagated_log(names: Sequence[str], settings: PropagationSettings) -> PropagatedSeries:
    from quatprop.base.threads import use_threads
    from quatprop.propagation.recording import open_recording

    with (
        use_threads(settings.threads),
        open_recording(names, settings.selection, settings.kind) as recording,
    ):
        return _propagated(recording, settings)


def _propagated_in_memory(rates: GyroSeries, settings: PropagationSettings) -> PropagatedSeries:
    from quatprop.propagation.recording import recording_of

    if not len(rates):
        raise SeriesError("Expected a series with samples, got an empty one")
    try:
        return _propagated(recording_of(rates), settings)
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


def _propagated(recording: Recording, settings: PropagationSettings) -> PropagatedSeries:
    from quatprop.propagation.attitude_stream import AttitudeStream
    from quatprop.propagation.report import digests_of_inputs, lag_ns, sensitivity

    stream = AttitudeStream(recording, settings)
    series = AttitudeSeries.gathered(stream)
    report = replace(stream.report(), files=digests_of_inputs(settings.inputs, recording.log))
    spell = _in_memory if recording.log is None else in_python
    report = replace(report, remarks=tuple(one.spelled(spell) for one in report.remarks))
    rule = report.convention.samples, report.convention.method
    return PropagatedSeries(
        series.t_ns,
        series.wxyz,
        covariance=series.covariance,
        lag_ns=lag_ns(*rule, report.counts.median_dt_ns),
        sensitivity=sensitivity(
            *rule, report.result.next_method, report.result.method_sensitivity_rad
        ),
        report=report,
    )


@with_keywords_of(CompareOptions, log="`b`")
def compare(
    a: StrPath | AttitudeSeries, b: StrPath | AttitudeSeries, **options: Unpack[CompareOptions]
) -> Comparison:
    """Measure the geodesic error between two attitude series.

    Parameters
    ----------
    a, b
        Paths as for :func:`read_attitudes`, or series in memory.
    **options
        Limits on the error, in rad or as text with a unit, and how the series are aligned and
        matched.

    Returns
    -------
    Comparison
        The errors, their statistics, and a likely cause; `passed` is whether all limits are met.

    Raises
    ------
    QuatpropError
        The series cannot be read, or not be compared as requested.

    Examples
    --------
    >>> a = AttitudeSeries([0, 1], [[1, 0, 0, 0], [1, 0, 0, 0]])
    >>> compare(a, a, tol="1e-9rad").passed
    True
    """
    from quatprop.comparison.comparison import compare as compare_series
    from quatprop.settings.command_options import comparison_settings

    _refuse_settings_of_a_side(options)
    settings = comparison_settings(**options)
    result = compare_series(_side("a", a), _side("b", b), settings)
    remarks = tuple(one.spelled(in_python) for one in result.remarks)
    return replace(result, remarks=remarks, likely_cause=_in_python(result.likely_cause))


def write(
    series: AttitudeSeries,
    path: StrPath,
    *,
    to: str | None = None,
    layout: Layout | None = None,
    extra_columns: str | None = None,
    **unknown: object,
) -> None:
    """Write an attitude series to a file.

    Parameters
    ----------
    series
        The attitudes; covariances are written to tables as by :meth:`to_arrow
        <quatprop.AttitudeSeries.to_arrow>`.
    path
        The output; an existing file is replaced once the new content is complete.
    to
        Format; by default from the suffix. A name without a suffix is a ROS 2 bag folder.
    layout
        ``"scalar-first"`` or ``"scalar-last"``; by default that of the format, or scalar-first if
        it allows both.
    extra_columns
        A further representation for columns of a table, such as ``"euler-zyx-deg"``; see
        :func:`convert`.

    Raises
    ------
    QuatpropError
        The path is not writable, the format does not support the settings, or rows are not unit
        quaternions.

    Warns
    -----
    RemarkWarning
        The format has no place for the timestamps, the positions or the covariances.
    """
    from quatprop.propagation.report import convention_of
    from quatprop.writers import open_writer
    from quatprop.writers.formats import WRITERS, format_remarks, kind_of, layout_of

    refuse_unknown(unknown, ("to", "layout", "extra_columns"))
    if not isinstance(series, AttitudeSeries):
        raise SeriesError(f"Expected an AttitudeSeries, got {type(series).__name__}")
    _valid("series", series)
    place = path_text("path", path)
    kind = kind_of(place, to)
    order = layout_of(kind, layout).name
    sigma = "body" if series.covariance is not None and WRITERS[kind].columns else None
    if isinstance(series, PropagatedSeries):
        report = series.report
        convention = report.convention._replace(layout=order)
        provenance = replace(report, convention=convention).as_json()
        sigma = sigma and series.sigma_axes
    else:
        provenance = convention_of(order)
    with open_writer(place, to, layout=order, sigma=sigma, extra_columns=extra_columns) as writer:
        writer.write(series)
        writer.commit(provenance)
    lost = {
        "positions_lost": series.position is not None and not writer.holds_positions,
        "sigma_lost": series.covariance is not None and sigma is None,
    }
    warn(place, (), format_remarks(place, to, **lost))


@with_keywords_of(ConvertOptions, "attitudes", "the source")
def convert(  # noqa: PLR0913  # parameters of write(), and the source
    source: StrPath,
    output: StrPath,
    *,
    to: str | None = None,
    layout: Layout | None = None,
    extra_columns: str | None = None,
    representation: str = "quaternion",
    **options: Unpack[ConvertOptions],
) -> ConversionReport:
    """Convert an attitude series to another layout, convention, representation or format.

    Parameters
    ----------
    source
        Path, as for :func:`read_attitudes`.
    output, to, layout, extra_columns
        As `path` and the others of :func:`write`.
    representation
        ``"quaternion"``, ``"rotvec"`` (rad), ``"matrix"``; ``"euler-zyx"`` (rad) or
        ``"euler-zyx-deg"``, and likewise any other sequence of intrinsic rotations; or the rates
        between consecutive attitudes, ``"body-rates"`` or ``"inertial-rates"`` (rad/s), from which
        method ``start`` restores the attitudes.
    **options
        What to read from the source, and the conventions of the output.

    Returns
    -------
    ConversionReport
        Facts, counts and losses of the conversion.

    Raises
    ------
    QuatpropError
        The source cannot be read as requested, or the output cannot be written.

    Warns
    -----
    DataLossWarning
        A part of the source could not be read, or rows were dropped.
    """
    from quatprop.propagation.attitude_input import attitude_input
    from quatprop.propagation.settings import OutputSettings
    from quatprop.tools.conversion import Conversion, terms_of
    from quatprop.tools.conversion import convert as convert_file

    refuse_unknown(options, ("to", "layout", "extra_columns", "representation", *CONVERT))
    terms = parse_all({name: value for name, value in options.items() if name in TERMS}, TERMS)
    reading = {name: value for name, value in options.items() if name not in TERMS}
    wanted = attitude_input(path_text("source", source, "write() takes a series"), reading)
    written = OutputSettings(
        path_text("output", output), to=to, layout=layout, extra_columns=extra_columns
    )
    form = str(representation).lower()
    report = convert_file(Conversion(wanted, written, representation=form, **terms_of(terms)))
    if report.data_lost:
        issue(DataLossWarning(f"{wanted.path}: rows were lost or dropped"))
    # This setting exists only on the command line.
    comment = Setting("header_comment"), "a comment in its header"
    remarks = (Remark(one.code, one.replace(*comment)) for one in report.remarks)
    return replace(report, remarks=tuple(one.spelled(in_python) for one in remarks))


def _in_python(cause: Cause | None) -> Cause | None:
    """Return a cause with settings spelled as in Python."""
    if cause is None:
        return None
    return cause._replace(
        sentence=in_python(cause.sentence),
        remedy=in_python(cause.remedy),
        also=_in_python(cause.also),
    )


def _refuse_settings_of_a_side(options: Collection[str]) -> None:
    """Refuse settings for reading A or B: in the library, they belong to read_attitudes()."""
    for name in options:
        setting = name.removesuffix("_a").removesuffix("_b")
        if setting in READ_ATTITUDES and name not in COMPARE:
            raise UsageError(
                f"there is no setting {quoted(name)}; give compare() what read_attitudes() "
                f"returns with {setting}=..."
            )


def _side(name: str, source: StrPath | AttitudeSeries) -> AttitudeSeries:
    """Return one side of a comparison."""
    from quatprop.propagation.recording import errors_of

    if isinstance(source, AttitudeSeries):
        return _valid(name, source)
    path = path_text(name, source, MAKE_ATTITUDES)
    with errors_of(name):
        return read_attitudes(path)


def _valid(name: str, series: AttitudeSeries) -> AttitudeSeries:
    """Return a series if its quaternions and covariances are valid, as if read from a file."""
    from quatprop.readers.attitude_quality import QuaternionCheck

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
