"""Survey, plot and simulate logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np

from quatprop.api.reading import issue, path_text, with_keywords_of
from quatprop.errors import DataLossWarning, RemarkWarning, UsageError
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings.reading import ONE_SERIES, READ_RATES, PlotOptions, RateOptions
from quatprop.settings.values import parse_all
from quatprop.simulation.settings import SIMULATE, SimulateOptions
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes

    from quatprop.api.reading import StrPath
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.pipeline.log_survey import LogSurvey
    from quatprop.plotting.files import View
    from quatprop.plotting.picture import Picture


class Simulation(NamedTuple):
    """A simulated recording.

    Parameters
    ----------
    rates
        Measured rates.
    truth
        The true attitudes at its timestamps.
    """

    rates: GyroSeries
    truth: AttitudeSeries


@with_keywords_of(RateOptions)
def info(log: StrPath, **options: Unpack[RateOptions]) -> LogSurvey:
    """Survey every source of body rates and of attitudes in a log.

    Parameters
    ----------
    log
        A file, a ROS 2 bag folder, or an address in an object store.
    **options
        Selection of rates, and their units and timestamps.

    Returns
    -------
    LogSurvey
        `sources` of body rates and `attitudes`, each with its samples, timestamps and remarks.

    Raises
    ------
    QuatpropError
        The log cannot be read.
    """
    from quatprop.pipeline.survey import survey
    from quatprop.settings.selection import RateSelection

    values = parse_all(options, READ_RATES)
    path = path_text("log", log, "a series has its facts as attributes")
    return survey(path, values.get("kind"), RateSelection.of(values)).in_python()


@with_keywords_of(PlotOptions, log="each file")
def plot(  # noqa: PLR0913  # one keyword for each option
    *sources: StrPath | GyroSeries | AttitudeSeries,
    output: StrPath | None = None,
    ax: Axes | None = None,
    show: Literal["rates", "attitude"] | None = None,
    components: bool = False,
    unwrap: bool = False,
    reference: StrPath | AttitudeSeries | None = None,
    **options: Unpack[PlotOptions],
) -> Axes:
    """Draw rates or attitudes, or their error against a reference, against time.

    Parameters
    ----------
    *sources
        Paths, or series in memory; several are overlaid.
    output
        Also write the picture of ``quatprop plot``, with a panel for each quantity: ``.png``,
        ``.svg``, ``.pdf``, or ``.html`` for a report. Only for files.
    ax
        Axes of matplotlib to draw on; by default those of a new figure.
    show
        ``"rates"`` or ``"attitude"``; by default rates, if a file has them.
    components
        Draw the components of quaternions instead of yaw, pitch and roll.
    unwrap
        Draw yaw and roll without jumps at half a turn.
    reference
        Draw the geodesic error of each relative to these attitudes instead, a path or a series.
    **options
        What to read from each file.

    Returns
    -------
    Axes
        The axes, with time in seconds since the first sample; ``.figure`` has ``savefig``.

    Raises
    ------
    QuatpropError
        A file cannot be read as requested, or the picture cannot be written.

    Warns
    -----
    DataLossWarning
        A part of a file could not be read.
    RemarkWarning
        Something looks wrong, such as gaps.
    """
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.plotting.axes import draw_together
    from quatprop.settings.reading import PLOT

    values, part = parse_all(options, PLOT), (options.get("start"), options.get("end"))
    given = [one if isinstance(one, GyroSeries | AttitudeSeries) else _path(one) for one in sources]
    if reference is None:
        given = [one if isinstance(one, str) else one.between(*part) for one in given]
    against = reference
    if not (reference is None or isinstance(reference, AttitudeSeries)):
        against = _path(reference, "reference")
    _refuse_idle(given, against, values, output=output is not None)
    view = _view(values, show, components=components, unwrap=unwrap)
    within = ComparisonSettings(start=values.get("start"), end=values.get("end"))
    drawn = _picture(given, output, view, against, within)
    axes = ax or _new_axes(kept=output is None)
    draw_together(axes, drawn)
    return axes


def _path(source: StrPath, name: str = "sources") -> str:
    return path_text(
        name, source, "make a series from arrays; several files are given as separate arguments"
    )


def _picture(
    sources: list[Any],
    output: StrPath | None,
    view: View,
    reference: Any,
    settings: ComparisonSettings,
) -> Picture:
    """Return the picture of paths and series, after writing it if requested, and warn."""
    from quatprop.logs.attitude_input import AttitudeInput
    from quatprop.plotting.draw import require_matplotlib
    from quatprop.plotting.plot import plot as write_picture
    from quatprop.plotting.plot import read_picture

    require_matplotlib()
    if output is None:
        drawn, remarks, data_lost = read_picture(sources, view, reference, settings)
    else:
        target = path_text("output", output)
        of_error = reference and AttitudeInput(reference, drop=True)
        files = [(path, view) for path in sources]
        _, page, data_lost = write_picture(files, target, of_error, settings)
        drawn, remarks = page.picture, page.warnings
    for remark in remarks:
        issue(RemarkWarning(remark))
    if data_lost:
        names = " + ".join(one for one in sources if isinstance(one, str))
        issue(DataLossWarning(f"{names}: a part was not read or was omitted"))
    return drawn


def _refuse_idle(
    sources: Sequence[object], reference: object, options: Mapping[str, object], *, output: bool
) -> None:
    """Refuse settings without effect."""
    from quatprop.plotting.target import KINDS

    if not sources:
        raise UsageError("there is nothing to draw; give paths or series")
    if not output and isinstance(last := sources[-1], str) and Path(last).suffix.lower() in KINDS:
        raise UsageError(f"name the picture with {Setting('output', last)}")
    of_files = [name for name in options if name not in {"start", "end"}]
    if of_files and not any(isinstance(one, str) for one in sources):
        raise UsageError(f"{Setting(of_files[0])} is for files, not for series in memory")
    if output and not all(isinstance(one, str | None) for one in (*sources, reference)):
        raise UsageError(
            f"{Setting('output')} is for files; of series, save what plot() returns with "
            ".figure.savefig(), or write() them first"
        )


def _new_axes(*, kept: bool) -> Axes:
    """Return axes of a new figure; `kept`: by pyplot, so that notebooks show it."""
    if kept:
        from matplotlib import pyplot as plt

        return plt.subplots()[1]
    from matplotlib.figure import Figure

    return Figure().subplots()


def _view(
    values: Mapping[str, Any],
    show: Literal["rates", "attitude"] | None,
    *,
    components: bool,
    unwrap: bool,
) -> View:
    """Return what to draw; any setting for attitudes selects attitudes."""
    from quatprop.conditioning import GyroCorrection
    from quatprop.plotting.files import View
    from quatprop.settings.selection import AttitudeSelection, RateSelection

    if components and unwrap:
        raise UsageError(f"{Setting('unwrap')} cannot be combined with {Setting('components')}")
    of_attitudes = any(name in values for name in ONE_SERIES if name not in READ_RATES)
    is_attitude = components or unwrap or of_attitudes
    if is_attitude and show == "rates":
        raise UsageError(f"the settings of attitudes require {Setting('show', 'attitude')}")
    return View(
        kind=values.get("kind"),
        show="attitude" if is_attitude else show,
        rates=RateSelection.of(values),
        attitudes=AttitudeSelection.of(values),
        components=components,
        unwrap=unwrap,
        part=GyroCorrection(start=values.get("start"), end=values.get("end")),
    )


@with_keywords_of(SimulateOptions)
def simulate(**options: Unpack[SimulateOptions]) -> Simulation:
    """Simulate a gyroscope on a body whose true attitude is known.

    Parameters
    ----------
    **options
        The motion, and the errors of the gyroscope.

    Returns
    -------
    Simulation
        `rates` and `truth`; the same settings give the same numbers as ``quatprop simulate``.

    Raises
    ------
    QuatpropError
        The settings contradict each other.

    Examples
    --------
    >>> rates, truth = simulate(motion="coning", duration="1s")
    >>> rates
    <GyroSeries: 100 samples over 990 ms from t = 1700000000000000000 ns>
    """
    from quatprop.simulation.gyroscope import record
    from quatprop.simulation.motion import motion_named
    from quatprop.simulation.settings import simulated

    motion, shape, gyroscope, q0 = simulated(parse_all(options, SIMULATE))
    both = AttitudeSeries.gathered(record(motion_named(motion, shape), gyroscope, q0))
    rates = GyroSeries(both.t_ns, np.asarray(both.rate))
    return Simulation(rates, AttitudeSeries(both.t_ns, both.wxyz))
