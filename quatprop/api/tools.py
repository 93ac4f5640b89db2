"""Survey, draw and simulate logs: what the commands of these names do."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np

from quatprop.api.reading import path_text, paths_of, with_keywords_of
from quatprop.errors import DataLossWarning, RemarkWarning, UsageError
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings.reading import ONE_SERIES, READ_RATES, PlotOptions, RateOptions
from quatprop.settings.values import parse_all
from quatprop.simulation.settings import SIMULATE, SimulateOptions
from quatprop.text import Setting

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from quatprop.api.reading import StrPath
    from quatprop.pipeline.log_survey import LogSurvey
    from quatprop.plotting.files import View


class Simulation(NamedTuple):
    """A simulated recording.

    Parameters
    ----------
    rates
        What the gyroscope measured.
    truth
        The true attitudes at its stamps.
    """

    rates: GyroSeries
    truth: AttitudeSeries


@with_keywords_of(RateOptions)
def info(log: StrPath, **options: Unpack[RateOptions]) -> LogSurvey:
    """Survey every source of body rates and of attitudes in a log.

    Parameters
    ----------
    log
        A file, a ROS 2 bag folder, or the address of one in an object store.
    **options
        What to read of it, and what its numbers mean.

    Returns
    -------
    LogSurvey
        `sources` of body rates and `attitudes`, each with its samples, timestamps and remarks, and
        `missing`, the settings that it needs to be read.

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
    files: StrPath | Sequence[StrPath],
    output: StrPath,
    *,
    show: Literal["rates", "attitude"] | None = None,
    components: bool = False,
    unwrap: bool = False,
    reference: StrPath | None = None,
    **options: Unpack[PlotOptions],
) -> None:
    """Draw rates or attitudes of files, or their error against a reference, against time.

    Parameters
    ----------
    files
        One path, or several that are laid over one another.
    output
        Where the picture goes: ``.png``, ``.svg``, ``.pdf``, or ``.html`` for a report with it.
    show
        ``"rates"`` or ``"attitude"``; by default the rates of a file that has some.
    components
        Draw the components of quaternions instead of yaw, pitch and roll.
    unwrap
        Draw yaw and roll beyond half a turn.
    reference
        Draw the geodesic error of each file against this attitude series instead.
    **options
        What to read of each file.

    Returns
    -------
    None

    Raises
    ------
    QuatpropError
        A file cannot be read as asked, or the picture cannot be written.

    Warns
    -----
    DataLossWarning
        A part of a file could not be read.
    RemarkWarning
        Something looks wrong, such as gaps.
    """
    from quatprop.comparison.settings import ComparisonSettings
    from quatprop.logs.attitude_input import AttitudeInput
    from quatprop.plotting.plot import plot as draw
    from quatprop.settings.reading import PLOT

    values = parse_all(options, PLOT)
    paths, target = paths_of("files", files), path_text("output", output)
    against = (
        None if reference is None else AttitudeInput(path_text("reference", reference), drop=True)
    )
    within = ComparisonSettings(start=values.get("start"), end=values.get("end"))
    view = _view(values, show, components=components, unwrap=unwrap)
    _, remarks, data_lost = draw(paths, target, view, against, within)
    for remark in remarks:
        warnings.warn(remark, RemarkWarning, stacklevel=2)
    if data_lost:
        lost = f"{' + '.join(paths)}: a part was not read, or left out"
        warnings.warn(lost, DataLossWarning, stacklevel=2)


def _view(
    values: Mapping[str, Any],
    show: Literal["rates", "attitude"] | None,
    *,
    components: bool,
    unwrap: bool,
) -> View:
    """Return what to draw: a setting of attitudes asks for attitudes."""
    from quatprop.conditioning import GyroCorrection
    from quatprop.plotting.files import View
    from quatprop.settings.selection import AttitudeSelection, RateSelection

    if components and unwrap:
        raise UsageError(f"{Setting('unwrap')} does not go with {Setting('components')}")
    of_attitudes = any(name in values for name in ONE_SERIES if name not in READ_RATES)
    is_attitude = components or unwrap or of_attitudes
    if is_attitude and show == "rates":
        raise UsageError(f"the settings of attitudes go with {Setting('show', 'attitude')}")
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
        How the body moves, and how it is measured.

    Returns
    -------
    Simulation
        `rates` and `truth`; the same settings give the same numbers, as ``quatprop simulate``
        writes them.

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
    both = AttitudeSeries.joined(list(record(motion_named(motion, shape), gyroscope, q0)))
    rates = GyroSeries(both.t_ns, np.asarray(both.rate))
    return Simulation(rates, AttitudeSeries(both.t_ns, both.wxyz))
