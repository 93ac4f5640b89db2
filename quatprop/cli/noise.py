"""``quatprop noise``: the noise of a gyroscope at rest."""

from __future__ import annotations

from typing import Any

import click

from quatprop.cli.commands import Command
from quatprop.cli.options import JSON, PATH, PLOT, QUIET, with_options, yaml_path
from quatprop.settings.parsers import Keyword
from quatprop.settings.reading import NOISE

EXAMPLES = (
    "quatprop simulate rest.parquet --motion rest --noise 1e-4",
    "quatprop noise rest.parquet",
    "quatprop noise rest.parquet -o imu.yaml --plot allan.png",
)

OUT = {
    "-o --output": Keyword(
        yaml_path,
        "Write noise density and random walk in the format of kalibr, which --imu reads.",
        takes="FILE.yaml|-", group="Output", common=True),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("logs", type=PATH, metavar="LOG...", nargs=-1, required=True)
@with_options(OUT, PLOT, NOISE, {**JSON, **QUIET})
def command(
    logs: tuple[str, ...],
    *,
    output: str | None,
    plot: str | None,
    as_json: bool,
    quiet: bool,
    **chosen: Any,
) -> int:
    """Measure the noise of the gyroscope of LOG while it is at rest.

    By the Allan deviation: angle random walk, bias instability, rate random walk and quantisation
    of each axis, with standard deviations. A term that the recording is too short to show has a
    bound. Periods of rest are found in LOG; record some hours of rest to see a random walk.
    """
    from quatprop.cli.summary import command_line, progress, show_result
    from quatprop.tools.noise_table import noise_rows
    from quatprop.tools.sensor_noise import measure_files

    values = {name: chosen[name] for name in NOISE if chosen[name]}
    with progress(quiet=quiet):
        noise = measure_files(logs, values, output, plot, command_line())
    show_result(
        noise, noise_rows(noise), 18, noise.remarks, noise.losses,
        as_json=as_json, quiet=quiet, output=output,
    )  # fmt: skip
    return 3 if noise.losses or noise.dropped else 0
