"""Attitude series to files: a format is one module and one line of :data:`WRITERS`.

A writer is opened on a target, takes batches in order, and is committed with the provenance of
what it wrote. What is not committed leaves no trace::

    with open_writer("attitude.parquet", layout="scalar-first") as writer:
        for series in attitudes:
            writer.write(series)
        writer.commit(provenance)
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from quatprop.errors import OutputError, listed, quoted
from quatprop.layout import layout_named
from quatprop.writers.atomic import is_stdout, is_stream

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from quatprop.writers.base import AttitudeWriter, Table


@dataclass(frozen=True, slots=True)
class Format:
    """One line of :data:`WRITERS`.

    Parameters
    ----------
    suffixes
        File name endings that mean this format.
    opener
        ``module:function`` of a target and a layout, imported when it is needed.
    text
        Whether it may go to stdout.
    table
        ``module:class`` of a :class:`quatprop.writers.base.Table`, for formats whose columns may
        be called anything; ``""`` for those that can say nothing but attitudes.
    """

    suffixes: tuple[str, ...]
    opener: str
    text: bool = False
    table: str = ""


WRITERS: Mapping[str, Format] = {
    "csv": Format(
        (".csv",),
        "quatprop.writers.csv:attitudes",
        text=True,
        table="quatprop.writers.csv:CsvTable",
    ),
    "parquet": Format(
        (".parquet", ".pq"),
        "quatprop.writers.parquet:attitudes",
        table="quatprop.writers.parquet:ParquetTable",
    ),
}
"""Every kind of attitude file that can be written; the keys are what ``--to`` accepts."""


def open_writer(
    target: Path | str, kind: str | None = None, *, layout: str = "scalar-first"
) -> AttitudeWriter:
    """Open a writer of attitude series.

    Parameters
    ----------
    target
        Where to write; ``"-"`` is stdout.
    kind
        A key of :data:`WRITERS`; without it, the suffix of `target` decides. Stdout, pipes and
        devices have no suffix to speak of and get CSV.
    layout
        A name in :data:`quatprop.layout.LAYOUTS`.

    Returns
    -------
    AttitudeWriter
        A context manager that removes what was not committed.

    Raises
    ------
    OutputError
        The kind or the suffix is unknown, the target is a folder, its folder does not exist,
        writing there is not permitted, or the kind cannot go to stdout.
    UsageError
        The layout is unknown.
    """
    chosen = _format(target, kind)
    order = layout_named(layout)
    writer: AttitudeWriter = _loaded(chosen.opener)(target, order)
    return writer


def open_table(target: Path | str, kind: str | None, names: Sequence[str]) -> Table:
    """Open a table of stamps and other columns than attitudes.

    Parameters
    ----------
    target, kind
        As for :func:`open_writer`.
    names
        Names of the float64 columns that follow ``t_ns``; they must say what is in them.

    Returns
    -------
    Table
        A context manager that removes what was not committed.

    Raises
    ------
    OutputError
        As for :func:`open_writer`; or the format can say nothing but attitudes.
    """
    chosen = _format(target, kind)
    if not chosen.table:
        others = listed(name for name, known in WRITERS.items() if known.table)
        raise OutputError(
            target,
            f"a {kind_of(target, kind)} file holds Hamilton quaternions body to reference and "
            f"nothing else; choose --to {others}",
        )
    table: Table = _loaded(chosen.table)(target, names)
    return table


def _format(target: Path | str, kind: str | None) -> Format:
    chosen = WRITERS[kind_of(target, kind)]
    if is_stdout(target) and not chosen.text:
        raise OutputError(target, "standard output takes CSV only; name a file for this kind")
    return chosen


def _loaded(place: str) -> Any:
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def kind_of(target: Path | str, kind: str | None = None) -> str:
    """Return the kind of file to write: as told, or by the suffix of the target.

    Raises
    ------
    OutputError
        The kind or the suffix is unknown.

    Examples
    --------
    >>> kind_of("attitude.parquet")
    'parquet'
    """
    if kind is not None:
        if kind not in WRITERS:
            raise OutputError(target, f"no output kind {quoted(kind)}; choose {listed(WRITERS)}")
        return kind
    for name, known in WRITERS.items():
        if str(target).lower().endswith(known.suffixes):
            return name
    if is_stdout(target) or is_stream(target):
        return "csv"
    suffixes = ", ".join(suffix for known in WRITERS.values() for suffix in known.suffixes)
    raise OutputError(
        target,
        f"the suffix does not tell the output format; use one of {suffixes} "
        f"or say --to {'|'.join(WRITERS)}",
    )
