"""``quatprop calibrate``: bias, scale, misalignment, mounting and clock from a reference."""

from __future__ import annotations

import json
from typing import Any

import click

from quatprop.calibration.settings import CALIBRATE
from quatprop.cli.help import Command, GroupedOption
from quatprop.cli.options import JSON, QUIET, input_of, options_of, refuse_stdin_twice, with_options
from quatprop.cli.types import PATH
from quatprop.settings.reading import CHECKS, ONE_SERIES, READ_RATES
from quatprop.text import plain, spelled

EXAMPLES = (
    "quatprop calibrate sample_logs/tumbling.bag sample_logs/tumbling.truth.csv --estimate bias",
)


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("log", type=PATH)
@click.argument("reference", type=PATH)
@click.option(
    "-o",
    "--output",
    type=PATH,
    metavar="FILE",
    cls=GroupedOption,
    group="Output",
    common=True,
    help="Write matrix and bias, for propagate --calibration: YAML.  [default: only shown]",
)
@with_options(
    options_of(CALIBRATE),
    JSON,
    QUIET,
    options_of(READ_RATES),
    options_of(CHECKS),
    options_of(ONE_SERIES, log="REFERENCE", signal="attitudes", side="ref"),
)
def command(
    log: str, reference: str, *, output: str | None, as_json: bool, quiet: bool, **chosen: Any
) -> int:
    """Estimate the calibration of the gyroscope in LOG from the attitudes in REFERENCE.

    Rotations over windows are compared, so the reference frame does not matter. What the motion
    does not show is held and named. A third of the windows is not used for the estimate: the error
    over these is shown without and with the calibration. The file contains the mounting; clock
    offsets are for compare --time-offset.
    """
    from quatprop.calibration.calibrate import calibrate
    from quatprop.calibration.result import calibration_rows
    from quatprop.cli.progress import progress
    from quatprop.cli.summary import show
    from quatprop.logs.attitude_input import load_attitudes
    from quatprop.logs.joined import open_logs
    from quatprop.logs.signals.rates import choose_rates
    from quatprop.provenance import as_json as to_json
    from quatprop.rendering import count_text, lines_of, loss_lines
    from quatprop.series import GyroSeries
    from quatprop.settings.selection import RateSelection
    from quatprop.stores.log_names import split_topic
    from quatprop.writers.targets import is_stdout, refuse_overlap

    refuse_stdin_twice(log, reference)
    path, chosen["topic"] = split_topic(log, chosen["topic"])
    refuse_overlap([path, split_topic(reference, None)[0]], [output])
    settings = {name: chosen[name] for name in CALIBRATE if chosen[name] is not None}
    with (
        progress(quiet=quiet),
        open_logs([path], chosen["kind"], msg_path=chosen["msg_path"]) as opened,
    ):
        signal = choose_rates(opened, RateSelection.of(chosen))
        rates = GyroSeries.gathered(signal.batches())
        whole = input_of(reference, {**chosen, "start": None, "end": None}, side="ref")
        loaded = load_attitudes(whole)
        part = (settings.pop("start", None), settings.pop("end", None))
        result = calibrate(rates.between(*part), loaded.series, settings)
    if output is not None:
        result.write(output)
    if as_json:
        click.echo(json.dumps(to_json(result, spelled), indent=2))
    elif not (quiet or (output is not None and is_stdout(output))):
        show(lines_of(calibration_rows(result), width=12), indent=13, err=False)
    if not quiet:
        remarks = [*signal.remarks, *opened.remarks, *loaded.signal.remarks, *result.remarks]
        lines = [f"warning: {spelled(remark)}" for remark in remarks]
        if dropped := loaded.counts.invalid:
            lines.append(f"lost: {count_text(dropped, 'invalid quaternion')} of REFERENCE")
        for line in [*lines, *loss_lines([*opened.losses, *loaded.losses])]:
            click.echo(plain(line), err=True)
    return 3 if opened.losses or loaded.data_lost else 0
