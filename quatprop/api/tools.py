"""Functions on logs: survey, plot, simulate, measure the noise, calibrate, batch."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Unpack

import numpy as np

from quatprop.api.attitudes import (
    MAKE_ATTITUDES,
    MAKE_RATES,
    path_text,
    paths_of,
    refuse_log_settings,
    warn,
    with_keywords_of,
)
from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, in_python
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.settings import PropagateOptions, parse_all
from quatprop.settings.command_options import CALIBRATE, CalibrateOptions
from quatprop.settings.crosscheck_options import CROSSCHECK, CrossCheckOptions
from quatprop.settings.parsers import InMemory
from quatprop.settings.reading import NOISE, READ_RATES, NoiseOptions, PlotOptions, RateOptions
from quatprop.stores.objects import split_topics
from quatprop.tools.simulation_options import SIMULATE, SimulateOptions

if TYPE_CHECKING:
    from collections.abc import Sequence
    from concurrent.futures import Executor

    from matplotlib.axes import Axes

    from quatprop.api.attitudes import StrPath
    from quatprop.propagation.attitude_input import AttitudeInput
    from quatprop.propagation.job import Job
    from quatprop.propagation.settings import OutputSettings
    from quatprop.propagation.survey import LogSurvey
    from quatprop.settings.command_options import ComparisonSettings
    from quatprop.settings.quantities import Layout
    from quatprop.tools.batch.manifest import ManifestEntry
    from quatprop.tools.calibration import GyroCalibration
    from quatprop.tools.crosscheck.result import CrossCheck
    from quatprop.tools.noise_table import Noise
    from quatprop.tools.plot.picture import Picture
    from quatprop.tools.plot.plotting import View


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
    from quatprop.propagation.survey import survey
    from quatprop.settings.reading import RateSelection

    values = parse_all(options, READ_RATES)
    name = path_text("log", log, "a series has its facts as attributes")
    return survey(name, values.get("kind"), RateSelection.from_settings(values)).in_python()


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
    from quatprop.settings.command_options import ComparisonSettings
    from quatprop.settings.reading import PLOT
    from quatprop.tools.plot.panels import draw_together
    from quatprop.tools.plot.plotting import View

    values, part = parse_all(options, PLOT), (options.get("start"), options.get("end"))
    given = [one if isinstance(one, GyroSeries | AttitudeSeries) else _path(one) for one in sources]
    if reference is None:
        given = [one if isinstance(one, str) else one.between(*part) for one in given]
    against = reference
    if not (reference is None or isinstance(reference, AttitudeSeries)):
        against = _path(reference, "reference")
    _refuse_idle(given, against, values, output=output is not None)
    how = {"show": show, "components": components, "unwrap": unwrap}
    view = View.from_settings({**values, **how})
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
    from quatprop.propagation.attitude_input import attitude_input
    from quatprop.tools.plot.figure import require_matplotlib
    from quatprop.tools.plot.plotting import plot as write_picture
    from quatprop.tools.plot.plotting import read_picture

    require_matplotlib()
    if output is None:
        drawn, inputs_read = read_picture(sources, view, reference, settings)
    else:
        target = path_text("output", output)
        of_error = reference and replace(attitude_input(reference, {}), drop=True)
        _, page, inputs_read = write_picture(sources, view, target, of_error, settings)
        drawn = page.picture
    for one in inputs_read:
        warn(one.name, one.losses, one.remarks, dropped=one.dropped)
    return drawn


def _refuse_idle(
    sources: Sequence[object], reference: object, options: Mapping[str, object], *, output: bool
) -> None:
    """Refuse settings without effect."""
    from quatprop.tools.plot.page import KINDS

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
    from quatprop.tools.simulation import motion_named, record
    from quatprop.tools.simulation_options import simulated

    motion, shape, gyroscope, q0 = simulated(parse_all(options, SIMULATE))
    both = AttitudeSeries.gathered(record(motion_named(motion, shape), gyroscope, q0))
    rates = GyroSeries(both.t_ns, np.asarray(both.rate))
    return Simulation(rates, AttitudeSeries(both.t_ns, both.wxyz))


# Measure the noise of a gyroscope at rest.


@with_keywords_of(NoiseOptions)
def noise(log: StrPath | Sequence[StrPath] | GyroSeries, **options: Unpack[NoiseOptions]) -> Noise:
    """Measure the noise of a gyroscope while it is at rest, by its Allan deviation.

    Periods of rest are found by rate, accelerometer and orientation. The overlapping Allan variance
    over them [1]_ is explained by 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3, and
    a ramp, R^2 tau^2 / 2, so that a drift with temperature is not taken for a random walk. The fit
    is by generalised least squares, with the covariance of the variances that follows from the
    terms [2]_.

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
        use `combined`. A term that the recording does not show has a bound and no value.

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
    from quatprop.propagation.recording import recording_of
    from quatprop.tools.sensor_noise import measure, measure_logs

    values = parse_all(options, NOISE)
    if isinstance(log, GyroSeries):
        path = "series"
        refuse_log_settings(options)
        found = measure(recording_of(log), values)
    else:
        names = paths_of("log", log, MAKE_RATES)
        path = " + ".join(split_topics(names, values.get("topic"))[0])
        found = measure_logs(names, values)
    warn(path, found.losses, found.remarks, dropped=found.dropped)
    return found


# Estimate the calibration of a gyroscope from a reference attitude.


@with_keywords_of(CalibrateOptions)
def calibrate(
    log: StrPath | GyroSeries,
    reference: StrPath | AttitudeSeries,
    **options: Unpack[CalibrateOptions],
) -> GyroCalibration:
    """Estimate bias, scale, misalignment, mounting and clock of a gyroscope from a reference.

    Rotations over windows are compared, so the reference frame is free; outliers are left out. What
    the motion does not show has no standard deviation. A motion that repeats itself shows no offset
    of the clocks, and needs ``time_offset``. Errors are shown over a third of the windows, with an
    estimate from the others.

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

    Warns
    -----
    RemarkWarning
        For each remark, such as on a bias that jumps, with its `code`.
    DataLossWarning
        A part of a file could not be read, or samples were dropped.

    Notes
    -----
    The offset of the clocks and the mounting are searched over all lags and rotations. Gauss-Newton
    then minimises the differences between the rotations by the rates and those of the reference,
    with priors on all parameters, so that the covariance of each contains what is not known of the
    others. It is that of white noise, or larger where parts of the recording differ by more, and
    contains jumps of the bias. Of a recording with more than 200,000 windows, about that many are
    used, evenly spaced.
    """
    from quatprop.propagation.attitude_input import attitude_input
    from quatprop.tools.calibration_inputs import calibrate_inputs

    values = parse_all(options, CALIBRATE)
    rates = log
    if not isinstance(rates, GyroSeries):
        rates = path_text("log", rates, MAKE_RATES)
    wanted: AttitudeInput | AttitudeSeries
    if isinstance(reference, AttitudeSeries):
        wanted = reference
    else:
        path = path_text("reference", reference, MAKE_ATTITUDES)
        wanted = attitude_input(path, {}, "ref")
    result, *inputs = calibrate_inputs(rates, wanted, values)
    for one in filter(None, reversed(inputs)):
        warn(one.name, one.losses, one.remarks, dropped=one.dropped)
    return replace(result, remarks=tuple(one.spelled(in_python) for one in result.remarks))


# Compare every source of rotation with every other.


@with_keywords_of(CrossCheckOptions, "rates", log="the logs")
def crosscheck(
    *logs: StrPath | GyroSeries | AttitudeSeries, **options: Unpack[CrossCheckOptions]
) -> CrossCheck:
    """Compare every source of rotation in logs with every other.

    Every gyroscope and every orientation is a source. Rotations over windows are compared: the
    search over all clock offsets, rotations and mirrors at once is followed by a fit, and by the
    readings of units, layouts and axes that explain what is left.

    Parameters
    ----------
    *logs
        Paths as for :func:`read_rates`, or series in memory.
    **options
        What to read, to tolerate, to allow and to correct.

    Returns
    -------
    CrossCheck
        The findings, each with its remedy; `passed` is whether the sources are consistent.

    Raises
    ------
    QuatpropError
        A log cannot be read.

    Warns
    -----
    DataLossWarning
        A part of a log could not be read, or samples are left out.
    RemarkWarning
        Something in a log looks wrong.

    Examples
    --------
    >>> from quatprop import simulate
    >>> rates, truth = simulate(motion="tumbling", duration="20s")
    >>> crosscheck(rates, truth)
    <CrossCheck: 2 sources of rotation, consistent>
    """
    from quatprop.tools.crosscheck.analysis import crosscheck_logs

    if not logs:
        raise UsageError("there is nothing to compare; give logs or series")
    given = [
        one if isinstance(one, GyroSeries | AttitudeSeries) else path_text("logs", one)
        for one in logs
    ]
    result = crosscheck_logs(given, parse_all(options, CROSSCHECK)).result.in_python()
    warn(" + ".join(one for one in given if isinstance(one, str)), result.losses, result.remarks)
    return result


# Propagate many logs: what ``quatprop batch`` does.


@with_keywords_of(PropagateOptions, log="each log")
def batch(  # noqa: PLR0913  # one keyword for each option
    logs: StrPath | Sequence[StrPath],
    output: StrPath,
    *,
    to: str = "parquet",
    layout: Layout | None = None,
    extra_columns: str | None = None,
    root: StrPath | None = None,
    shard: str | None = None,
    processes: int | None = None,
    executor: Executor | None = None,
    skip_existing: bool = False,
    verify: bool = False,
    retries: int = 0,
    expect: StrPath | Mapping[str, object] | None = None,
    **options: Unpack[PropagateOptions],
) -> list[ManifestEntry]:
    """Turn the body rates of many logs into attitude series in a folder.

    Logs are propagated in child processes, which do not run the calling script; ``processes=1``
    uses this process. An output is named after its log, with the suffix of the format added.

    Parameters
    ----------
    logs
        Logs; folders and store prefixes to search for logs; and patterns (with ``**``).
    output
        The folder, or a prefix such as ``s3://bucket/runs``.
    to, layout, extra_columns
        As for :func:`write`.
    root, shard
        Outputs keep the path of their log below the folder `root`; one of N parts of the logs, as
        ``"1/8"``.
    processes, executor
        Number of processes, by default that of the cores; any executor to use instead, whose
        workers see the same paths. It is left open.
    skip_existing, verify
        Skip logs whose output is up to date; also compare the digests of outputs.
    retries
        Number of retries of a log if its process was killed or its store did not answer.
    expect
        What each log must have, as ``{"rate": "200Hz", "gaps": 0}`` or a TOML file, with the keys
        of ``[case.NAME.expect]`` in a suite; `unmet` of an entry says what is not as expected.
    **options
        Selection of samples and settings of the propagation; only files, no objects in memory.

    Returns
    -------
    list of ManifestEntry
        The entry in the manifest of each log that was propagated now, as named tuples
        (``pandas.DataFrame(entries)`` is a table). A log that cannot be used has the state
        ``"failed"`` and an `error`, and does not stop the others.

    Raises
    ------
    QuatpropError
        There are no logs, or the settings cannot be used.
    """
    from quatprop.base.places import without_file_scheme
    from quatprop.propagation.settings import OutputSettings
    from quatprop.tools.batch.execution import Batch
    from quatprop.tools.batch.log_search import search_logs
    from quatprop.tools.batch.manifest import Manifest
    from quatprop.tools.batch.planning import BatchSettings
    from quatprop.tools.batch.planning import shard as part_of
    from quatprop.tools.check.expect import read_expectations

    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise UsageError(
            "a child process of this script runs it again; call batch() below "
            "if __name__ == '__main__':"
        )
    if executor is not None and processes is not None:
        raise UsageError(f"{Setting('executor')} has its own workers; omit {Setting('processes')}")
    folder = without_file_scheme(path_text("output", output))
    written = OutputSettings("OUT", to=to, layout=layout, extra_columns=extra_columns)
    top = None if root is None else path_text("root", root)
    search = search_logs(paths_of("logs", logs), top, folder, written.kind, options)
    wanted = expect if expect is None or isinstance(expect, Mapping) else os.fspath(expect)
    expected = None if wanted is None else read_expectations(wanted)
    job = _job(written, options)
    settings = BatchSettings.for_job(job, folder, expected, retries=retries, is_library=True)
    part = part_of(shard)
    run = Batch(search, settings, Manifest(folder), part, skip=skip_existing, verify=verify)
    results = sorted(run.results(executor, processes, isolated=processes != 1))
    return [result.entry for _, result in results]


class FoundLog(NamedTuple):
    """A log, and its name in a batch.

    Parameters
    ----------
    path
        Absolute path or address, with ``:TOPIC`` if one was named.
    name
        Path below the root, with ``/``: the name under which a batch records the log, and the
        name of its output without the suffix of the format. A named topic follows it.
    """

    path: str
    name: str


def find_logs(logs: StrPath | Sequence[StrPath], *, root: StrPath | None = None) -> list[FoundLog]:
    """Find the logs of a batch, for systems that run :func:`propagate` on each by themselves.

    Parameters
    ----------
    logs, root
        As for :func:`batch`.

    Returns
    -------
    list of FoundLog
        The path and the name of each, as named tuples.

    Raises
    ------
    QuatpropError
        There are no logs, or two would have one name.
    """
    from quatprop.base.places import is_address
    from quatprop.tools.batch.log_search import search_logs
    from quatprop.tools.batch.planning import refuse_shared_names

    top = None if root is None else path_text("root", root)
    found = []
    tasks = search_logs(paths_of("logs", logs), top, "", "parquet", {}).take()
    refuse_shared_names(tasks, ".")
    for task in tasks:
        path = task.path if is_address(task.path) else str(Path(task.path).absolute())
        path += f":{task.topic}" * bool(task.topic)
        found.append(FoundLog(path, task._replace(suffix="").name))
    return found


def _job(written: OutputSettings, options: PropagateOptions) -> Job:
    """Return the job for each log; files are relative to the current folder."""
    from quatprop.propagation.job import Job

    job = Job.of(["LOG"], options, written, Path.cwd())
    given = job.settings.given
    if held := [name for name, value in given.items() if value == str(InMemory(None))]:
        raise UsageError(f"{Setting(held[0])} of batch() is a file, for all logs")
    return job
