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
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.conventions.layout import layout_named
from quatprop.errors import OutputError, UsageError
from quatprop.text import listed, quoted
from quatprop.writers.atomic import is_stdout, is_stream
from quatprop.writers.base import AttitudeTable
from quatprop.writers.messages.kinds import Message

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

    from quatprop.conventions.layout import Layout
    from quatprop.writers.base import AttitudeWriter, Table


@dataclass(frozen=True, slots=True)
class Format:
    """One line of :data:`WRITERS`.

    Parameters
    ----------
    suffixes
        File name endings that mean this format; ``""`` is a name without one.
    opener
        ``module:name`` of what writes it, imported when it is needed: of a target and, for a
        table, the names of columns, for messages a :class:`Message`, for others a layout.
    table
        Whether the opener gives a table of any columns.
    text
        Whether it may go to stdout.
    comments
        Whether it has comments, in which the provenance can stand.
    layout
        The layout that the format's own definition prescribes; None where there is a choice.
    messages
        Whether it holds ROS messages, of a type that can be chosen.
    room
        Whether it has a place of its own for the provenance, besides comments.
    """

    suffixes: tuple[str, ...]
    opener: str
    table: bool = False
    text: bool = False
    comments: bool = False
    layout: str | None = None
    messages: bool = False
    room: bool = False


def _ros(suffixes: tuple[str, ...], opener: str) -> Format:
    """Return a format of ROS messages, whose quaternions are x, y, z, w."""
    return Format(suffixes, opener, layout="scalar-last", messages=True, room=True)


WRITERS: Mapping[str, Format] = {
    "csv": Format(
        (".csv",), "quatprop.writers.tables.csv:CsvTable", table=True, text=True, comments=True
    ),
    "tsv": Format(
        (".tsv",), "quatprop.writers.tables.csv:TsvTable", table=True, text=True, comments=True
    ),
    "jsonl": Format(
        (".jsonl", ".ndjson"), "quatprop.writers.tables.jsonl:JsonLinesTable", table=True, text=True
    ),
    "parquet": Format(
        (".parquet", ".pq"), "quatprop.writers.tables.parquet:ParquetTable", table=True, room=True
    ),
    "feather": Format(
        (".feather", ".arrow"),
        "quatprop.writers.tables.feather:FeatherTable",
        table=True,
        room=True,
    ),
    "npy": Format((".npy",), "quatprop.writers.tables.npy:NpyTable", table=True),
    "npz": Format((".npz",), "quatprop.writers.tables.npy:NpzTable", table=True, room=True),
    "tum": Format(
        (".tum",),
        "quatprop.writers.tables.tum:attitudes",
        text=True,
        comments=True,
        layout="scalar-last",
    ),
    "euroc": Format(
        (),
        "quatprop.writers.tables.euroc:attitudes",
        text=True,
        comments=True,
        layout="scalar-first",
    ),
    "mcap": _ros((".mcap",), "quatprop.writers.mcap.attitudes:McapAttitudes"),
    "bag": _ros((".bag",), "quatprop.writers.rosbag1.attitudes:Rosbag1Attitudes"),
    "rosbag2": _ros(("",), "quatprop.writers.rosbag2.attitudes:SqliteAttitudes"),
    "rosbag2-mcap": _ros((), "quatprop.writers.rosbag2.attitudes:McapFolderAttitudes"),
}
"""Every kind of attitude file that can be written; the keys are what ``--to`` accepts."""

DEFAULT_LAYOUT = "scalar-first"


def open_writer(
    target: Path | str,
    kind: str | None = None,
    *,
    layout: str | None = None,
    comment: bool = False,
    message: Message | None = None,
) -> AttitudeWriter:
    """Open a writer of attitude series.

    Parameters
    ----------
    target
        Where to write; ``"-"`` is stdout.
    kind
        A key of :data:`WRITERS`; without it, the suffix of `target` decides. Stdout, pipes and
        devices have no suffix to speak of and get CSV; any other name without one is a ROS 2 bag
        folder.
    layout
        A name in :data:`quatprop.conventions.layout.LAYOUTS`; None is what the format prescribes,
        or scalar-first where it leaves the choice.
    comment
        Write the provenance in a comment at the beginning.
    message
        What to write the attitudes as, where they are written as messages.

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
        The layout is unknown or not that of the format, or the format has no comments or no
        messages.
    """
    kind = kind_of(target, kind)
    if message is not None and not WRITERS[kind].messages:
        raise UsageError(f"{kind} holds no messages; leave --message out")
    order = layout_of(kind, layout)
    opener, options = _opener(target, kind, comment=comment)
    if WRITERS[kind].table:
        return AttitudeTable(opener(target, order.columns, **options), order)
    told = (message or Message()) if WRITERS[kind].messages else order
    writer: AttitudeWriter = opener(target, told, **options)
    return writer


def open_table(
    target: Path | str, names: Sequence[str], kind: str | None = None, *, comment: bool = False
) -> Table:
    """Open a table of any columns, in a format that has tables.

    Parameters
    ----------
    target, kind, comment
        As for :func:`open_writer`.
    names
        Names of the float64 columns that follow ``t_ns``.

    Raises
    ------
    OutputError
        As for :func:`open_writer`, or the kind holds attitudes only.
    UsageError
        The format has no comments.
    """
    kind = kind_of(target, kind)
    if not WRITERS[kind].table:
        tables = [name for name, known in WRITERS.items() if known.table]
        raise OutputError(
            target, f"kind {quoted(kind)} holds quaternions only; choose {listed(tables)}"
        )
    opener, options = _opener(target, kind, comment=comment)
    table: Table = opener(target, names, **options)
    return table


def layout_of(kind: str, layout: str | None = None) -> Layout:
    """Return the layout in which a kind of file is written.

    Parameters
    ----------
    kind
        A key of :data:`WRITERS`.
    layout
        The layout asked for; None where nothing was said.

    Raises
    ------
    UsageError
        The layout is unknown, or the format's definition prescribes the other one.

    Examples
    --------
    >>> layout_of("csv").name, layout_of("tum").name
    ('scalar-first', 'scalar-last')
    """
    prescribed = WRITERS[kind].layout
    if layout is None:
        return layout_named(prescribed or DEFAULT_LAYOUT)
    asked = layout_named(layout)
    if prescribed is not None and asked.name != prescribed:
        raise UsageError(
            f"{kind} is {prescribed} by its own definition, not {asked.name}; leave --layout out"
        )
    return asked


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
            raise OutputError(target, f"no output kind {quoted(kind)}; choose {'|'.join(WRITERS)}")
        return kind
    if is_stdout(target) or is_stream(target):
        return "csv"
    suffix = Path(target).suffix.lower()
    for name, known in WRITERS.items():
        if suffix in known.suffixes:
            return name
    suffixes = ", ".join(s for known in WRITERS.values() for s in known.suffixes if s)
    raise OutputError(
        target,
        f"the suffix does not tell the output format; use one of {suffixes}, none for a ROS 2 bag "
        f"folder, or say --to {'|'.join(WRITERS)}",
    )


def has_room(target: Path | str, kind: str | None = None, *, comment: bool = False) -> bool:
    """Return whether the provenance is kept in a file, in a comment or in a place of its own.

    Parameters
    ----------
    target, kind, comment
        As for :func:`open_writer`.

    Examples
    --------
    >>> has_room("attitude.csv"), has_room("attitude.parquet")
    (False, True)
    """
    return comment or WRITERS[kind_of(target, kind)].room


def _opener(target: Path | str, kind: str, *, comment: bool) -> tuple[Any, dict[str, Any]]:
    """Return what opens a format and the options it is called with."""
    chosen = WRITERS[kind]
    if is_stdout(target) and not chosen.text:
        raise OutputError(target, "standard output takes text only; name a file for this kind")
    if comment and not chosen.comments:
        raise UsageError(f"{kind} has no comments; leave --header-comment out")
    module, _, name = chosen.opener.partition(":")
    return getattr(import_module(module), name), {"comment": True} if comment else {}
