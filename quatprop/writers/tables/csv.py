"""Tables as CSV and TSV: one header line, no quotes, a newline after every row.

The provenance may be written in a comment before the header line, for readers that skip comments.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.writers.tables.text import TextTable, delimited

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class CsvTable(TextTable):
    """Write columns as CSV.

    Parameters
    ----------
    target
        A path, or ``"-"`` for stdout.
    names
        Names of the float64 columns that follow ``t_ns``.
    comment
        Begin with the provenance, in a comment.
    """

    separator = ","

    def __init__(self, target: Path | str, names: Sequence[str], *, comment: bool = False) -> None:
        names = ("t_ns", *names)
        header = self.separator.join(names) + "\n"
        super().__init__(target, header, delimited(self.separator, names), comment=comment)


class TsvTable(CsvTable):
    """Write columns with tabs between them; parameters as above."""

    separator = "\t"
