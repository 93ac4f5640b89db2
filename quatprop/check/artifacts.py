"""Keep the evidence of a failure: the attitudes, a page with the error, and the commands."""

from __future__ import annotations

import shlex
from html import escape
from typing import TYPE_CHECKING
from urllib.parse import quote

from quatprop.check.case_run import propagate_case
from quatprop.comparison.compare import compare
from quatprop.errors import QuatpropError
from quatprop.logs.attitude_input import AttitudeInput, load_attitudes
from quatprop.plotting.errors import pair_page
from quatprop.plotting.target import PictureFile
from quatprop.writers import open_writer
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.check.case import Case
    from quatprop.check.lock import Pin


def write_artifacts(case: Case, pin: Pin | None, folder: Path) -> Path:
    """Write the evidence of a case that failed, and return its folder.

    It has ``attitude.parquet``, the attitudes as they were compared; ``error.html``, a page with
    the error over time; and ``commands.txt``, the commands that repeat the case.
    """
    place = folder / quote(case.name, safe=" @+").replace(".", "%2E", case.name.startswith("."))
    series, page, commands = (
        place / name for name in ("attitude.parquet", "error.html", "commands.txt")
    )
    for file in (series, page, commands):
        refuse_outside(file, folder)
    place.mkdir(parents=True, exist_ok=True)
    every = pin.every if pin else None
    run = propagate_case(case, every)
    with open_writer(series, "parquet", layout="scalar-first") as writer:
        writer.write(run.series)
        writer.commit(run.report.as_json())
    reference = case.external or AttitudeInput(str(case.reference), "parquet")
    with open_atomic(commands) as stream:
        stream.write(f"{_commands(case, every, str(series), reference.path)}\n".encode())
    try:
        a, b = load_attitudes(AttitudeInput(str(series), "parquet")), load_attitudes(reference)
        comparison = compare(a.series, b.series, case.comparison)
        with PictureFile(str(page), [str(series), reference.path]) as picture:
            picture.commit(pair_page(a, b, comparison))
    except QuatpropError as error:
        # No matplotlib, or nothing to compare: a page of this says so.
        text = escape(str(error), quote=False)
        with open_atomic(page) as stream:
            stream.write(f"<!doctype html>\n<p>{text}</p>\n".encode())
    return place


def _commands(case: Case, every: int | None, series: str, reference: str) -> str:
    """Return the commands that propagate and compare as the case does."""
    options = {key: case.inputs.get(key, value) for key, value in case.options.items()}
    if every is not None:
        options["every"] = str(every)
    compared = {
        f"{key.removeprefix('reference-')}-b" if key.startswith("reference-") else key: value
        for key, value in case.comparison_options.items()
    }
    return "\n".join(
        shlex.join(["quatprop", *command])
        for command in (
            ["propagate", case.log, "-o", series, *_arguments(options)],
            ["compare", series, reference, *_arguments(compared)],
        )
    )


def _arguments(options: Mapping[str, str]) -> list[str]:
    """Return options as the command line has them."""
    return [
        f"--{key}" if value == "True" else f"--{key}={value}"
        for key, value in options.items()
        if value != "False"
    ]
