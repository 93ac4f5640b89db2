"""Compare two files of attitudes and draw the error: all of ``quatprop compare``."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base import __version__
from quatprop.base.provenance import as_json
from quatprop.base.rendering import lines_of
from quatprop.base.text import spelled
from quatprop.comparison.file_comparison import compare_files
from quatprop.comparison.result import comparison_rows

if TYPE_CHECKING:
    from quatprop.comparison.result import Comparison
    from quatprop.propagation.attitude_input import AttitudeInput, ReadAttitudes
    from quatprop.settings.command_options import ComparisonSettings


class ComparedFiles(NamedTuple):
    """Two series of attitudes that were read, and their comparison; B is the reference."""

    a: ReadAttitudes
    b: ReadAttitudes
    comparison: Comparison

    @property
    def data_lost(self) -> bool:
        """Whether a part of A or B was omitted."""
        return bool(self.a.data_lost or self.b.data_lost or self.comparison.omitted_duplicates)

    def lines(self) -> list[str]:
        """Return the result as text."""
        return lines_of(comparison_rows(self.a, self.b, self.comparison))

    def report(self) -> dict[str, Any]:
        """Return the result, ready for JSON."""
        return {
            "quatprop": __version__,
            "a": as_json(self.a.report(), spelled),
            "b": as_json(self.b.report(), spelled),
            **as_json(self.comparison, spelled),
        }


def compare_and_draw(
    a: AttitudeInput, b: AttitudeInput, settings: ComparisonSettings, plot: str | None, command: str
) -> ComparedFiles:
    """Compare two files.

    `plot`: where a picture of the error goes; None is nowhere
    `command`: the command line, for the metadata of the picture
    """
    with ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import pair_page
            from quatprop.tools.plot.page import PictureFile

            picture = stack.enter_context(PictureFile(plot, (a.path, b.path), command=command))
        compared = ComparedFiles(*compare_files(a, b, settings, keep=plot is not None))
        if plot is not None:
            picture.commit(pair_page(*compared))
    return compared
