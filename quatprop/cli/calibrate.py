"""``quatprop calibrate``: bias, scale, misalignment, mounting and clock from a reference."""

from __future__ import annotations

from typing import Any

import click

from quatprop.cli.commands import Command
from quatprop.cli.options import (
    JSON,
    PATH,
    QUIET,
    input_of,
    options_of,
    refuse_stdin_twice,
    with_options,
    yaml_path,
)
from quatprop.settings.command_options import CALIBRATE
from quatprop.settings.parsers import Keyword
from quatprop.settings.reading import CHECKS, ONE_SERIES, READ_RATES

EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop calibrate demo.bag demo.truth.csv --estimate bias",
)


OUT = {
    "-o --output": Keyword(
        yaml_path, "Write matrix and bias, for propagate --calibration.", "only shown",
        takes="FILE.yaml|-", group="Output", common=True),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("log", type=PATH)
@click.argument("reference", type=PATH)
@with_options(
    OUT,
    CALIBRATE,
    {**JSON, **QUIET},
    READ_RATES,
    CHECKS,
    options_of(ONE_SERIES, log="REFERENCE", signal="attitudes", side="ref"),
)
def command(
    log: str, reference: str, *, output: str | None, as_json: bool, quiet: bool, **chosen: Any
) -> int:
    """Estimate the calibration of the gyroscope in LOG from the attitudes in REFERENCE.

    Rotations over windows are compared, so the reference frame does not matter. Parameters that the
    motion does not show are named as not determined. The error is shown over a third of the
    windows, with an estimate from the others: as given, with the clock corrected, and with the file
    too. The file contains the mounting; clock offsets are for compare --time-offset.
    """
    from quatprop.cli.summary import progress, show_result
    from quatprop.settings.reading import RateSelection
    from quatprop.tools.calibration import calibration_rows
    from quatprop.tools.calibration_inputs import calibrate_inputs, refuse_to_replace

    refuse_stdin_twice(log, reference)
    refuse_to_replace(log, reference, output)
    values = {name: chosen[name] for name in CALIBRATE if chosen[name] is not None}
    wanted = input_of(reference, {**chosen, "start": None, "end": None}, side="ref")
    with progress(quiet=quiet):
        made = calibrate_inputs(
            log, wanted, values, RateSelection.from_settings(chosen), chosen["kind"]
        )
    show_result(
        made.result, calibration_rows(made.result), 12, made.remarks, made.losses,
        as_json=as_json, quiet=quiet, output=output,
    )  # fmt: skip
    if output is not None:
        made.result.write(output)
    return 3 if made.losses or made.result.dropped else 0
