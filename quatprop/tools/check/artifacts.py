"""Keep the evidence of a case: its attitudes, a page, and the commands that repeat it."""

from __future__ import annotations

import shlex
from dataclasses import replace
from html import escape
from shutil import copyfile
from typing import TYPE_CHECKING
from urllib.parse import quote

from quatprop.base.errors import QuatpropError
from quatprop.base.text import plain
from quatprop.settings import option
from quatprop.tools.plot.contents import pair_page
from quatprop.tools.plot.page import PictureFile, document
from quatprop.writers.atomic import write_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.propagation.attitude_input import LoadedAttitudes
    from quatprop.tools.check.case import Case
    from quatprop.tools.check.judge import Judgement

OVERVIEW = "../index.html"
"""Where a page has the list of all."""


def write_artifacts(case: Case, judged: Judgement, folder: Path, *, strict: bool) -> Path:
    """Write the evidence of a judged case, and return its folder.

    The folder contains ``attitude.parquet`` and, for a stored reference, ``reference.parquet``, as
    they were compared; ``error.html``, a page with the verdict and the error over time; and
    ``commands.txt``, the commands that repeat the case, its propagation and its comparison.
    """
    place = folder / quote(case.name, safe=" @+").replace(".", "%2E", case.name.startswith("."))
    files = ("attitude.parquet", "reference.parquet", "error.html", "commands.txt")
    series, copied, page, commands = (place / name for name in files)
    for file in (series, copied, page, commands):
        refuse_outside(file, folder)
    place.mkdir(parents=True, exist_ok=True)
    copyfile(judged.run.attitudes.input.path, series)
    reference = judged.reference
    if reference is not None and case.external is None:
        copyfile(reference.input.path, copied)
        reference = _moved(reference, copied)
    write_atomic(commands, _commands(case, judged, str(series), reference, strict=strict))
    try:
        _write_page(judged, _moved(judged.run.attitudes, series), reference, page)
    except QuatpropError as error:
        # Without matplotlib the page has this sentence instead of a picture.
        sentences = [f"{judged.result.verdict}: {judged.result.reason}", str(error)]
        body = [
            f'<p class="back"><a href="{OVERVIEW}">all cases</a></p>',
            f"<h1>{escape(plain(case.name))}</h1>",
            *(f"<p>{escape(sentence, quote=False)}</p>" for sentence in sentences),
        ]
        write_atomic(page, document(case.name, body))
    return place


def _moved(loaded: LoadedAttitudes, path: Path) -> LoadedAttitudes:
    return replace(loaded, input=replace(loaded.input, path=str(path)))


def _write_page(
    judged: Judgement, series: LoadedAttitudes, reference: LoadedAttitudes | None, page: Path
) -> None:
    """Write the page of a comparison, which begins with the verdict of the case."""
    if reference is None or judged.comparison is None or judged.comparison.result is None:
        raise QuatpropError("there is nothing to draw, as nothing was compared")
    # The likely cause stands among the warnings, with its remedy.
    cause = f"; likely cause: {judged.comparison.cause}"
    reason = judged.result.reason.replace(cause, "")
    verdict = f"{judged.result.verdict}: {reason}".removesuffix(": ")
    with PictureFile(str(page), [series.input.path, reference.input.path]) as picture:
        content = pair_page(series, reference, judged.comparison.result)
        picture.commit(content._replace(lead=(verdict, *content.lead), back=OVERVIEW))


def _commands(
    case: Case, judged: Judgement, series: str, reference: LoadedAttitudes | None, *, strict: bool
) -> str:
    """Return the commands that check the case again, and propagate and compare like it."""
    options = {key: case.inputs.get(key, value) for key, value in case.options.items()}
    if judged.run.every is not None:
        options["every"] = str(judged.run.every)
    compared = {
        f"{key.removeprefix('reference-')}-b" if key.startswith("reference-") else key: value
        for key, value in case.comparison_options.items()
    }
    commands = [
        ["check", case.suite, "-k", case.name, *([option("strict")] if strict else [])],
        ["propagate", *case.logs, "-o", series, *_arguments(options)],
    ]
    if reference is not None:
        commands.append(["compare", series, reference.input.path, *_arguments(compared)])
    return "".join(f"{shlex.join(['quatprop', *command])}\n" for command in commands)


def _arguments(options: Mapping[str, str]) -> list[str]:
    """Return options as command-line arguments."""
    return [
        f"--{key}" if value == "True" else f"--{key}={value}"
        for key, value in options.items()
        if value != "False"
    ]
