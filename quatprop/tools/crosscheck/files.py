"""Cross-check logs and write the requested files: all of ``quatprop crosscheck``."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import OutputError
from quatprop.base.places import without_secret
from quatprop.stores.objects import split_topic
from quatprop.tools.crosscheck.analysis import crosscheck_logs
from quatprop.tools.crosscheck.configuration import write_configuration

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from quatprop.tools.crosscheck.result import CrossCheck


def crosscheck_files(
    logs: Sequence[str],
    values: Mapping[str, Any],
    plot: str | None,
    config: str | None,
    command: str,
) -> CrossCheck:
    """Cross-check logs, and write the requested files.

    `values`: parsed settings of a cross-check
    `plot`, `config`: where the picture and the configuration of propagate go; None is nowhere
    `command`: the command line
    """
    paths = [split_topic(name)[0] for name in logs]
    with ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.page import PictureFile, kind_of

            if kind_of(plot) == "html":
                kinds = "use .png, .svg or .pdf"
                raise OutputError(plot, f"a picture of a cross-check is an image; {kinds}")
            output = stack.enter_context(PictureFile(plot, paths, [config], command=command))
        analysis = crosscheck_logs(logs, values)
        result = analysis.result
        if plot is not None:
            from quatprop.tools.crosscheck.drawing import page_of

            names = [Path(without_secret(path)).name for path in paths]
            if (page := page_of(analysis, names)) is not None:
                output.commit(page)
            else:
                text = "a picture, as no two sources could be compared"
                result = replace(result, not_shown=(*result.not_shown, text))
        if config is not None:
            write_configuration(result, config, logs)
    return result
