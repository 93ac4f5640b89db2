"""Compare, write and convert attitude series."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Unpack

import numpy as np

from quatprop.api.propagation import PropagatedSeries
from quatprop.api.reading import issue, path_text, read_attitudes, warn, with_keywords_of
from quatprop.comparison.settings import COMPARE, CompareOptions
from quatprop.conversion.settings import CONVERT, TERMS, ConvertOptions
from quatprop.errors import DataLossWarning, SeriesError, UsageError
from quatprop.series import AttitudeSeries
from quatprop.settings.reading import READ_ATTITUDES
from quatprop.settings.values import parse_all, refuse_unknown
from quatprop.text import Remark, Setting, in_python, quoted

if TYPE_CHECKING:
    from collections.abc import Collection

    from quatprop.api.reading import StrPath
    from quatprop.comparison.cause import Cause
    from quatprop.comparison.result import Comparison
    from quatprop.conversion.job import ConversionReport
    from quatprop.settings.choices import Layout


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
        Limits on the error, and how the series are aligned and matched.

    Returns
    -------
    Comparison
        The errors, their statistics, and a likely cause; `passed` tells whether all limits are met.

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
    from quatprop.comparison.compare import compare as compare_series
    from quatprop.comparison.settings import comparison_settings

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
    from quatprop.pipeline.report import convention_of
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
        if sigma and report.uncertainty is not None:
            sigma = report.uncertainty.columns_axes or sigma
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
    from quatprop.conversion.convert import convert as convert_file
    from quatprop.conversion.job import Conversion, terms_of
    from quatprop.logs.attitude_input import attitude_input
    from quatprop.pipeline.settings import OutputSettings

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
    from quatprop.logs.attitude_input import errors_of

    if isinstance(source, AttitudeSeries):
        return _valid(name, source)
    path = path_text(name, source, "make an AttitudeSeries from arrays")
    with errors_of(name):
        return read_attitudes(path)


def _valid(name: str, series: AttitudeSeries) -> AttitudeSeries:
    """Return a series if its quaternions and covariances are valid, as if read from a file."""
    from quatprop.logs.signals.quaternion_check import QuaternionCheck

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
