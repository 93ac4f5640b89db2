"""Where converted attitudes go: into a table, a file of attitudes, or a copy of the log."""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop.conventions import HAMILTON
from quatprop.conventions.representations import NEAR_VERTICAL_DEG, REPRESENTATIONS
from quatprop.errors import OutputError, UsageError
from quatprop.into import open_into
from quatprop.series import AttitudeSeries
from quatprop.signals.attitudes import choose_attitudes
from quatprop.text import listed, quoted
from quatprop.writers import WRITERS, keeps_provenance, kind_of, layout_of, open_table, open_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.containers.base import MessageLog
    from quatprop.conventions.representations import Representation
    from quatprop.conversion import Conversion
    from quatprop.tables.base import TableLog
    from quatprop.writers.base import AttitudeWriter, TableWriter, Transaction

    Put = Callable[[NDArray[np.int64], NDArray[np.float64]], int]
    """Takes stamps and quaternions wxyz; returns how many rows are not unique as written."""


@contextmanager
def opened(job: Conversion, log: MessageLog | TableLog) -> Iterator[tuple[Transaction, Put]]:
    """Give what is to be committed, and a function that takes stamps and quaternions wxyz."""
    kind = kind_of(job.output, job.to)
    if job.representation in REPRESENTATIONS:
        form = REPRESENTATIONS[job.representation]
        with open_table(job.output, form.columns, job.to, comment=job.comment) as table:
            yield table, partial(_put_otherwise, table, form)
    elif job.meaning == HAMILTON:
        with _attitudes(job, log, layout_of(kind, job.layout).name) as writer:
            yield writer, partial(_put_attitudes, writer)
    else:
        if not WRITERS[kind].columns:
            tables = listed(name for name, known in WRITERS.items() if known.columns)
            raise OutputError(
                job.output,
                f"kind {quoted(kind)} holds Hamilton quaternions body to reference by its own "
                f"definition; leave --convention and --direction out, or choose {tables}",
            )
        if job.message is not None:
            raise UsageError(f"{kind} holds no messages; leave --message out")
        order = layout_of(kind, job.layout)
        with open_table(job.output, order.columns, job.to, comment=job.comment) as table:
            yield table, partial(_put_in_order, table, order.order)


def _attitudes(job: Conversion, log: MessageLog | TableLog, layout: str) -> AttitudeWriter:
    """Return what takes attitudes as they are: a file of their own, or a copy of the log."""
    options: dict[str, Any] = {"layout": layout, "message": job.message, "comment": job.comment}
    if not job.into:
        return open_writer(job.output, job.to, **options)

    def stamps(
        again: MessageLog | TableLog,
    ) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        return choose_attitudes(again, job.selection).stamps()

    return open_into(log, job.output, stamps, **options)


def _put_attitudes(
    writer: AttitudeWriter, t_ns: NDArray[np.int64], wxyz: NDArray[np.float64]
) -> int:
    writer.write(AttitudeSeries(t_ns, wxyz))
    return 0


def _put_otherwise(
    table: TableWriter, form: Representation, t_ns: NDArray[np.int64], wxyz: NDArray[np.float64]
) -> int:
    values = form.values(wxyz)
    table.write(t_ns, [np.ascontiguousarray(column) for column in values.T])
    return 0 if form.singular is None else form.singular(values)


def _put_in_order(
    table: TableWriter, order: tuple[int, ...], t_ns: NDArray[np.int64], wxyz: NDArray[np.float64]
) -> int:
    table.write(t_ns, [wxyz[:, place] for place in order])
    return 0


def remarks_on(singular: int) -> list[str]:
    """Return what is to be said of rows whose yaw and roll cannot be told apart."""
    if not singular:
        return []
    said = (
        f"{singular} rows are within {NEAR_VERTICAL_DEG} deg of pitch +-90 deg, where yaw and roll "
        "cannot be told apart: they share the turn equally and jump from row to row; together "
        "they are still the attitude"
    )
    return [said]


def forgotten(job: Conversion) -> list[str]:
    """Return what a file that has no room to say what its numbers mean leaves to its readers."""
    if job.meaning == HAMILTON or keeps_provenance(job.output, job.to, comment=job.comment):
        return []
    said = (
        f"the file cannot say that it is {job.meaning.convention} {job.meaning.direction}: whoever "
        "reads it has to; --header-comment, or Parquet, would"
    )
    return [said]
