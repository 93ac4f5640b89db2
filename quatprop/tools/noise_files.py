"""Measure the noise of logs and write it: all of ``quatprop noise``."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import OutputError
from quatprop.stores.objects import split_topics
from quatprop.tools.noise_table import imu_yaml
from quatprop.tools.sensor_noise import measure_logs
from quatprop.writers.atomic import open_atomic
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from quatprop.tools.noise_table import Noise


def measure_files(
    names: Sequence[str],
    values: Mapping[str, Any],
    output: str | None,
    plot: str | None,
    command: str,
) -> Noise:
    """Measure the noise of a log, in one file or several, and write the requested files.

    `names`, `values`: as for :func:`quatprop.tools.sensor_noise.measure_logs`
    `output`, `plot`: where the file for ``--imu`` and the picture go; None is nowhere
    `command`: the command line, for the metadata of the picture
    """
    paths, topic = split_topics(names, values.get("topic"))
    refuse_overlap(paths, [output, plot])
    with ExitStack() as stack:
        if plot is not None:
            from quatprop.tools.plot.contents import allan_page
            from quatprop.tools.plot.page import PictureFile, kind_of

            if kind_of(plot) == "html":
                raise OutputError(plot, "a picture of noise is an image; use .png, .svg or .pdf")
            picture = stack.enter_context(PictureFile(plot, paths, command=command))
        noise = measure_logs(paths, {**values, "topic": topic})
        if plot is not None:
            picture.commit(allan_page(noise))
        if output is not None:
            content = imu_yaml(noise).encode()
            with open_atomic(output) as stream:
                stream.write(content)
    return noise
