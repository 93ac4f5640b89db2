"""Recorded gyroscope biases over time: a table, or a topic of a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quatprop.conditioning.calibration import BiasSeries
from quatprop.errors import LogError, UsageError
from quatprop.logs.matching.find import column_beside, find
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rate_columns import match_bias
from quatprop.logs.signals.reading import read_vectors
from quatprop.logs.vocabulary.sources import TYPES
from quatprop.series import GyroSeries
from quatprop.settings.rotations import InMemory
from quatprop.settings.selection import RateSelection, SignalSelection
from quatprop.stores.log_names import split_topic
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.arrays import Float64, Int64
    from quatprop.logs.matching.find import Match
    from quatprop.tables.log import Log


def read_biases(source: str | InMemory, log: Log | None, selection: SignalSelection) -> BiasSeries:
    """Read biases over time.

    `log`: the open log with the rates; None for rates in memory
    `selection`: how the rates were selected
    """
    if isinstance(source, InMemory):
        series = source.value
        if not isinstance(series, GyroSeries) or not len(series):
            raise UsageError(f"{Setting('bias')}: a series of biases is a GyroSeries with rows")
        return BiasSeries(str(source), "rate", series.t_ns, series.rate)
    path, topic = split_topic(source)
    if Path(path).exists():
        with open_log(path) as opened:
            known = [one for table in opened.tables(topic) for one in find(table, "bias")]
            if len(known) != 1:
                names = listed(one.table.name for one in known)
                there = f"several topics with biases: {names}" if known else "no topic with biases"
                raise UsageError(f"{Setting('bias')} {plain(source)}: it has {there}")
            return _of_match(source, match_bias(known[0], RateSelection()))
    if log is None or not (tables := log.tables(source)):
        raise UsageError(
            f"{Setting('bias')} {plain(source)} is neither three numbers X,Y,Z nor static[:DUR], "
            "no such file is there, and the log has no such topic"
        )
    known = [one for table in tables for one in find(table, "bias")]
    if len(known) != 1:
        types = listed(name for name, row in TYPES.items() if row.bias)
        raise LogError(
            log.path,
            f"messages of topic {quoted(source)} are of type {quoted(tables[0].type)}, of "
            f"which no bias is known; types with one are {types}",
        )
    return _of_match(source, match_bias(known[0], RateSelection(clock=selection.clock)))


def _of_match(source: str, match: Match) -> BiasSeries:
    valid = column_beside(match.table, match.part, match.row.valid)
    return _series(source, match.field, read_vectors(match._replace(marks=valid)))


def _series(source: str, name: str, rows: Iterable[tuple[Int64, Float64]]) -> BiasSeries:
    parts = [(np.empty(0, np.int64), np.empty((0, 3))), *rows]
    t_ns, bias = (np.concatenate(column) for column in zip(*parts, strict=True))
    good = np.isfinite(bias).all(axis=1)
    if not good.any():
        raise UsageError(f"{Setting('bias')} {plain(source)}: it has no valid biases")
    return BiasSeries(source, name, t_ns[good], bias[good])
