"""The destination of converted attitudes: a table, a file of attitudes, or a copy of the log."""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conventions import HAMILTON
from quatprop.conventions.representations import NEAR_LOCK_DEG, REPRESENTATIONS
from quatprop.conversion.rates import RATE_COLUMNS, RATES
from quatprop.errors import OutputError, UsageError
from quatprop.into import open_into
from quatprop.signals.attitudes import choose_attitudes
from quatprop.text import Setting, Text, listed, quoted
from quatprop.writers import WRITERS, keeps_provenance, kind_of, layout_of, open_table, open_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.conventions.representations import Representation
    from quatprop.conversion.convert import Conversion
    from quatprop.pipeline.settings import OutputSettings
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.tables.base import TableLog
    from quatprop.writers.base import AttitudeWriter, TableWriter, Transaction

    Write = Callable[[Any], int]
    """Takes attitudes, or rates where those are written; returns how many rows are not unique."""


@contextmanager
def open_destination(
    job: Conversion, log: MessageLog | TableLog
) -> Iterator[tuple[Transaction, Write]]:
    """Give the file to be committed, and a function that writes attitudes."""
    output = job.output
    kind = kind_of(output.path, output.to)
    if job.representation in REPRESENTATIONS:
        form = REPRESENTATIONS[job.representation]
        with open_table(output.path, form.columns, output.to, comment=output.comment) as table:
            yield table, partial(_write_representation, table, form)
    elif job.representation in RATES:
        with open_table(output.path, RATE_COLUMNS, output.to, comment=output.comment) as table:
            yield table, partial(_write_rates, table)
    elif job.meaning == HAMILTON:
        with _open_attitudes(job, log, layout_of(kind, output.layout).name) as writer:
            yield writer, partial(_write_attitudes, writer)
    else:
        _refuse_other_conventions(output, kind)
        layout = layout_of(kind, output.layout)
        with open_table(output.path, layout.columns, output.to, comment=output.comment) as table:
            yield table, partial(_write_columns, table, layout.order)


def _refuse_other_conventions(output: OutputSettings, kind: str) -> None:
    """Refuse formats that define a convention themselves."""
    if not WRITERS[kind].columns:
        raise OutputError(
            output.path,
            f"kind {quoted(kind)} holds Hamilton quaternions body to reference by its own "
            "definition; leave ",
            Setting("convention"),
            " and ",
            Setting("direction"),
            f" out, or choose {listed(name for name, known in WRITERS.items() if known.columns)}",
        )
    if output.message is not None:
        raise UsageError(f"{kind} holds no messages; leave ", Setting("message"), " out")
    if output.beside is not None:
        raise UsageError(
            *(Setting("beside"), " goes with Hamilton quaternions body to reference; leave "),
            *(Setting("convention"), " and ", Setting("direction"), " out"),
        )


def _open_attitudes(job: Conversion, log: MessageLog | TableLog, layout: str) -> AttitudeWriter:
    """Open a file of attitudes, or a copy of the log."""
    output = job.output
    if not output.into:
        return open_writer(
            output.path,
            output.to,
            layout=layout,
            message=output.message,
            comment=output.comment,
            beside=output.beside,
        )

    def stamps(
        again: MessageLog | TableLog,
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        return choose_attitudes(again, job.selection).stamps()

    return open_into(
        log,
        output.path,
        stamps,
        layout=layout,
        message=output.message,
        comment=output.comment,
        beside=output.beside,
    )


def _write_attitudes(writer: AttitudeWriter, series: AttitudeSeries) -> int:
    writer.write(series)
    return 0


def _write_representation(table: TableWriter, form: Representation, series: AttitudeSeries) -> int:
    values = form.values(series.wxyz)
    table.write(series.t_ns, [np.ascontiguousarray(column) for column in values.T])
    return form.locked(values)


def _write_rates(table: TableWriter, series: GyroSeries) -> int:
    table.write(series.t_ns, [np.ascontiguousarray(column) for column in series.rate.T])
    return 0


def _write_columns(table: TableWriter, order: tuple[int, ...], series: AttitudeSeries) -> int:
    table.write(series.t_ns, [series.wxyz[:, place] for place in order])
    return 0


def remarks_on(
    job: Conversion, singular: int, *, positions_lost: bool = False
) -> Iterator[str | Text]:
    """Yield what a reader of the output should know.

    Parameters
    ----------
    job
        The conversion.
    singular
        Rows whose first and third angle cannot be distinguished.
    positions_lost
        Whether the source has positions and the output none.
    """
    if kind_of(job.output.path, job.output.to) == "kitti":
        yield "the timestamps are not kept: kitti has no place for them"
    if positions_lost:
        yield "the positions beside the attitudes are not kept: the output has no place for them"
    if singular:
        form = REPRESENTATIONS[job.representation]
        first, second, third = (name.rpartition("_")[0] for name in form.columns)
        yield (
            f"{singular} rows are within {NEAR_LOCK_DEG} deg of {second} "
            f"{' or '.join(map(str, form.lock_deg))} deg (gimbal lock), where {first} and {third} "
            "cannot be distinguished: they share the rotation equally and jump from row to row; "
            "together they are still the attitude"
        )
    output, meaning = job.output, job.meaning
    if meaning != HAMILTON and not keeps_provenance(output.path, output.to, comment=output.comment):
        yield Text(
            f"the file cannot state that it is {meaning.convention} {meaning.direction}, so its "
            "reader has to know it; ",
            Setting("header_comment"),
            ", or Parquet, would",
        )
