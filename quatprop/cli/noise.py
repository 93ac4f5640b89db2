"""``quatprop noise``: the noise of a gyroscope at rest."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any

import click

from quatprop.base.errors import OutputError
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
    of each axis, with standard deviations. What the recording is too short to show is stated as a
    bound. Periods of rest are found in LOG; record some hours of rest to see a random walk.
    """
    from quatprop.cli.summary import command_line, progress, show_result
    from quatprop.stores.objects import split_topics
    from quatprop.tools.noise_table import imu_yaml, noise_rows
    from quatprop.tools.sensor_noise import measure_logs
    from quatprop.writers.atomic import open_atomic
    from quatprop.writers.targets import refuse_overlap

    paths, chosen["topic"] = split_topics(logs, chosen["topic"])
    refuse_overlap(paths, [output, plot])
    with progress(quiet=quiet), ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import allan_page
            from quatprop.tools.plot.page import PictureFile, kind_of

            if kind_of(plot) == "html":
                raise OutputError(plot, "a picture of noise is an image; use .png, .svg or .pdf")
            picture = stack.enter_context(PictureFile(plot, paths, command=command_line()))
        noise = measure_logs(paths, {name: chosen[name] for name in NOISE if chosen[name]})
        if plot is not None:
            picture.commit(allan_page(noise))
        if output is not None:
            content = imu_yaml(noise).encode()
            with open_atomic(output) as stream:
                stream.write(content)
    show_result(
        noise, noise_rows(noise), 18, noise.remarks, noise.losses,
        as_json=as_json, quiet=quiet, output=output,
    )  # fmt: skip
    return 3 if noise.losses or noise.dropped else 0
