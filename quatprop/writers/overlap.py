"""No output may replace an input, or another output, of the same run."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.errors import OutputError
from quatprop.text import plain
from quatprop.writers.atomic import is_stdout, is_stream

if TYPE_CHECKING:
    from collections.abc import Iterable


def refuse_overlap(inputs: Iterable[str | None], outputs: Iterable[str | None]) -> None:
    """Refuse outputs that would replace something that the run reads or writes.

    Parameters
    ----------
    inputs
        Files and folders that are read; what lies in a folder is read too. None is passed over.
    outputs
        Where results go; streams replace nothing.

    Raises
    ------
    OutputError
        An output is an input, lies inside one, or is named twice.
    """
    targets = [name for name in outputs if name is not None]
    if sum(map(is_stdout, targets)) > 1:
        raise OutputError("-", "two outputs of the run would go to stdout; name a file for one")
    for name in targets:
        if "://" in name:
            # The address may carry a key.
            raise OutputError(
                name.partition("://")[0] + "://...",
                "outputs are files of this machine; copy them there afterwards",
            )
    read = [Path(os.path.realpath(name)) for name in inputs if name and Path(name).exists()]
    written: list[Path] = []
    for name in targets:
        if is_stdout(name) or is_stream(name):
            continue
        place = Path(os.path.realpath(name))
        for source in read:
            if place == source or (place.exists() and place.samefile(source)):
                raise OutputError(name, "this is an input of the run; choose another output")
            if source in place.parents:
                raise OutputError(
                    name, f"this lies in {plain(source)}, which is an input; choose another output"
                )
        if place in written:
            raise OutputError(name, "two outputs of the run would go here; choose another")
        written.append(place)
