"""``quatprop calibrate``: bias, scale, misalignment, mounting and clock from a reference."""

from __future__ import annotations

from dataclasses import replace
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

    Rotations over windows are compared, so the reference frame does not matter. What the motion
    does not show is named as not determined. The error is shown over a third of the windows, with
    an estimate from the others: as given, with the clock corrected, and with the file too. The file
    contains the mounting; clock offsets are for compare --time-offset.
    """
    from quatprop.base.errors import Loss
    from quatprop.base.rendering import count_text
    from quatprop.cli.summary import progress, show_result
    from quatprop.propagation.attitude_input import load_attitudes
    from quatprop.propagation.recording import open_recording
    from quatprop.settings.reading import RateSelection
    from quatprop.stores.objects import split_topic
    from quatprop.tools.calibration import calibrate, calibration_rows
    from quatprop.writers.targets import refuse_overlap

    refuse_stdin_twice(log, reference)
    refuse_overlap([split_topic(one)[0] for one in (log, reference)], [output])
    settings = {name: chosen[name] for name in CALIBRATE if chosen[name] is not None}
    with (
        progress(quiet=quiet),
        open_recording([log], RateSelection.of(chosen), chosen["kind"]) as recording,
    ):
        wanted = input_of(reference, {**chosen, "start": None, "end": None}, side="ref")
        loaded = load_attitudes(replace(wanted, covariances=False))
        result = calibrate(recording, loaded.series, settings)
        losses = [*recording.losses, *loaded.losses]
    if output is not None:
        result.write(output)
    if dropped := loaded.counts.invalid:
        losses.append(Loss("REFERENCE", f"{count_text(dropped, 'invalid quaternion')}", dropped))
    remarks = [*loaded.signal.remarks, *result.remarks]
    show_result(
        result, calibration_rows(result), 12, remarks, losses,
        as_json=as_json, quiet=quiet, output=output,
    )  # fmt: skip
    return 3 if losses or result.dropped else 0
