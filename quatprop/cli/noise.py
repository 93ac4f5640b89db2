"""``quatprop noise``: the noise of a gyroscope at rest."""

from __future__ import annotations

import json
from contextlib import ExitStack
from typing import Any

import click

from quatprop.cli.help import Command
from quatprop.cli.options import JSON, PLOT, QUIET, options_of, with_options
from quatprop.cli.types import PATH
from quatprop.settings.keyword import Keyword
from quatprop.settings.reading import NOISE
from quatprop.text import plain, spelled

EXAMPLES = (
    "quatprop noise sample_logs/rest.parquet",
    "quatprop noise sample_logs/rest.parquet -o imu.yaml --plot allan.png",
)

OUT = {
    "-o --output": Keyword(
        PATH, "Write noise density and random walk in the format of kalibr, which --imu reads.",
        takes="FILE.yaml|-", group="Output", common=True),
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("logs", type=PATH, metavar="LOG...", nargs=-1, required=True)
@with_options(OUT, PLOT, options_of(NOISE), {**JSON, **QUIET})
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
    of each axis, with standard deviations. What the recording is too short to show is stated as a
    bound. Periods of rest are found in LOG; record some hours of rest to see a random walk.
    """
    from quatprop.cli.progress import progress
    from quatprop.cli.summary import command_line, show
    from quatprop.provenance import as_json as to_json
    from quatprop.rendering import lines_of, loss_lines
    from quatprop.sensor_noise.files import imu_yaml, noise_rows
    from quatprop.sensor_noise.measure import measure_logs
    from quatprop.stores.log_names import split_topic
    from quatprop.writers.atomic import open_atomic
    from quatprop.writers.targets import is_stdout, refuse_overlap

    paths = []
    for log in logs:
        path, chosen["topic"] = split_topic(log, chosen["topic"])
        paths.append(path)
    refuse_overlap(paths, [output, plot])
    with progress(quiet=quiet), ExitStack() as stack:
        if plot is not None:
            from quatprop.plotting.allan import AllanPicture

            picture = stack.enter_context(AllanPicture(plot, paths, command=command_line()))
        noise = measure_logs(paths, {name: chosen[name] for name in NOISE if chosen[name]})
        if plot is not None:
            picture.draw(noise)
        if output is not None:
            content = imu_yaml(noise).encode()
            with open_atomic(output) as stream:
                stream.write(content)
    if as_json:
        click.echo(json.dumps(to_json(noise, spelled), indent=2))
    elif not (quiet or (output is not None and is_stdout(output))):
        show(lines_of(noise_rows(noise), 18), 19, err=False)
    if not quiet:
        warnings = (f"warning: {spelled(remark)}" for remark in noise.remarks)
        for line in (*warnings, *loss_lines(noise.losses)):
            click.echo(plain(line), err=True)
    return 3 if noise.losses or noise.dropped else 0
