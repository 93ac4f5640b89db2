"""Read body rates and attitudes of a log into memory."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from inspect import cleandoc
from itertools import chain
from typing import TYPE_CHECKING, TypeAlias, TypeVar, Unpack, cast

import numpy as np

from quatprop.errors import DataLossWarning, RemarkWarning, UsageError
from quatprop.series import AttitudeSeries, GyroSeries
from quatprop.settings.keyword import parameters
from quatprop.settings.parsers import path as parse_path
from quatprop.settings.reading import RATES_IN_MEMORY, AttitudeOptions, ReadOptions
from quatprop.settings.values import parse_all
from quatprop.text import Remark, Setting, spelled

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from os import PathLike

    from quatprop.errors import QuatpropWarning
    from quatprop.tables.log import Loss

    StrPath: TypeAlias = str | PathLike[str]

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
    from quatprop.logs.joined import open_logs
    from quatprop.logs.signals.rates import choose_rates
    from quatprop.settings.selection import RateSelection
    from quatprop.timeline import Timeline
    from quatprop.timeline.counts import OBSERVE

    paths, values = paths_of("log", log), parse_all(options, RATES_IN_MEMORY)
    path = " + ".join(paths)
    with open_logs(paths, values.get("kind"), msg_path=values.get("msg_path")) as opened:
        signal = choose_rates(opened, RateSelection.of(values))
        batches = signal.batches()
        if values.get("regular_time"):
            batches = Timeline(OBSERVE._replace(regular_time=True), path).apply(batches)
        first = next(batches, GyroSeries(np.zeros(0, np.int64), np.zeros((0, 3))))
        series = GyroSeries.gathered(chain([first], batches))
        warn(path, opened.losses, (*signal.remarks, *opened.remarks))
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
    from quatprop.logs.attitude_input import attitude_input, load_attitudes

    path = path_text("log", log)
    loaded = load_attitudes(replace(attitude_input(path, options), positions=True))
    warn(path, loaded.losses, loaded.signal.remarks, dropped=loaded.counts.invalid)
    return loaded.series


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
    lost = [(f"lost: {loss.place}: {spelled(loss.reason)}", loss.messages) for loss in losses]
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
