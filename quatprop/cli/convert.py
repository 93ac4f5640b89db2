"""``quatprop convert``: one attitude series in, the same in other terms out."""

from __future__ import annotations

from typing import Any

import click

from quatprop.cli.attitude_options import (
    CONVENTIONS,
    DIRECTIONS,
    UNSOUND_OPTIONS,
    attitude_options,
    attitude_selection,
)
from quatprop.cli.options import quiet_option, report_option, with_options
from quatprop.cli.output_options import OUTPUT_OPTIONS, destination, into_option, message

EULER_DEGREES = {("euler-zyx", "deg"): "euler-zyx-deg"}
"""Representation and unit of angles -> key of :data:`quatprop.conventions.REPRESENTATIONS`."""


@click.command(no_args_is_help=True)
@click.argument("log", metavar="IN")
@click.argument("output", metavar="[OUT]", required=False)
@into_option
@with_options(attitude_options("IN"))
@with_options(OUTPUT_OPTIONS)
@click.option(
    "--convention",
    type=click.Choice(CONVENTIONS),
    default="hamilton",
    show_default=True,
    help="Convention of OUT.",
)
@click.option(
    "--direction",
    type=click.Choice(DIRECTIONS),
    default="body-to-ref",
    show_default=True,
    help="Which coordinates OUT turns into which.",
)
@click.option(
    "--sign",
    type=click.Choice(("keep", "continuous", "positive")),
    default="keep",
    show_default=True,
    help="Of q and -q, which are the same attitude: the one that is there, the one nearer to the "
    "row before, or the one with w >= 0.",
)
@click.option(
    "--as",
    "representation",
    type=click.Choice(("quaternion", "rotvec", "euler-zyx", "matrix")),
    default="quaternion",
    show_default=True,
    help="What to write: quaternions, rotation vectors in rad, yaw, pitch and roll about z, y' "
    "and x'', or matrices row by row.",
)
@click.option(
    "--euler-unit",
    type=click.Choice(("rad", "deg")),
    help="Unit of yaw, pitch and roll.  [default: rad]",
)
@with_options(UNSOUND_OPTIONS)
@report_option
@quiet_option
def command(**chosen: Any) -> None:
    """Write the attitude series IN as OUT: layout, convention, direction, representation, format.

    IN is a table or a log of messages with attitudes, or - for CSV on stdin; OUT is a file, or -
    for CSV on stdout. With --into instead, a copy of IN that holds them too.

    \b
    quatprop convert attitude.parquet attitude.csv --layout scalar-last
    quatprop convert flight.bag vicon.tum -t /vicon/auk/auk
    quatprop convert attitude.csv - --as euler-zyx --euler-unit deg
    """
    from quatprop.cli import summary as words
    from quatprop.containers.base import Loss
    from quatprop.conventions import Meaning
    from quatprop.conversion import Conversion, convert
    from quatprop.rendering import loss_lines

    quiet = chosen.pop("quiet")
    unit, representation = chosen.pop("euler_unit"), chosen.pop("representation")
    if unit is not None and representation != "euler-zyx":
        raise click.UsageError("--euler-unit is for --as euler-zyx")
    job = Conversion(
        log=chosen["log"],
        **destination(chosen, "OUT"),
        kind=chosen["kind"],
        to=chosen["to"],
        selection=attitude_selection(chosen),
        layout=chosen["layout"],
        meaning=Meaning(chosen["convention"], chosen["direction"]),
        sign=chosen["sign"],
        representation=EULER_DEGREES.get((representation, unit), representation),
        normalize=chosen["normalize"],
        drop=chosen["on_invalid"] == "drop",
        message=message(chosen),
        comment=chosen["comment"],
        report=chosen["report"],
    )
    with words.progress(quiet=quiet) as tick:
        report = convert(job, tick)
    step = report["conversions"][-1]
    if not quiet:
        losses = loss_lines([Loss(**loss) for loss in step["losses"]])
        click.echo("\n".join([_summary(job.output, step), *losses]), err=True)
    if step["losses"] or step["counts"]["read"] != step["counts"]["used"]:
        raise click.exceptions.Exit(3)


def _summary(output: str, step: dict[str, Any]) -> str:
    """Return what was done in one or two lines."""
    from quatprop.text import plain

    source, stored, written, counts = step["source"], step["from"], step["to"], step["counts"]
    said = " ".join(plain(source[key]) for key in ("name", "type") if source[key])
    order = stored["layout"] or stored["representation"]
    meant = f"{stored['convention']} {stored['direction']}, {order}, {source['clock']}"
    means = f"{written['convention']} {written['direction']}, {','.join(written['columns'])}"
    form = written["representation"]
    lines = [
        f"in   {plain(source['path'])} ({source['kind']}): {said}; {meant} clock",
        f"out  {plain(output)}: {counts['used']:,} rows of {form}, {means}",
    ]
    if counts["normalized"]:
        lines.append(
            f"warning: {counts['normalized']:,} rows scaled to unit length, off by up to "
            f"{counts['worst']:.3g}"
        )
    if dropped := counts["read"] - counts["used"]:
        lines.append(
            f"lost: {dropped:,} rows that are no rotation: {counts['zero']} zero, "
            f"{counts['not_unit']} not of unit length, {counts['not_finite']} absent or not "
            f"finite; the first at {counts['first_ns']} ns"
        )
    return "\n".join([*lines, *(f"note: {plain(remark)}" for remark in step["remarks"])])
