"""``quatprop convert``: convert an attitude series."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from quatprop.base.text import plain, spelled
from quatprop.cli.commands import Command
from quatprop.cli.options import PATH, QUIET, REPORT, input_of, options_of, with_options
from quatprop.propagation.output_options import EULER, OUTPUT_OPTIONS, output_settings, with_unit
from quatprop.settings.command_options import TERMS
from quatprop.settings.parsers import Choice, Keyword
from quatprop.settings.reading import READ_ATTITUDES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.tools.conversion import ConversionReport


EXAMPLES = (
    "quatprop simulate demo.bag --motion tumbling",
    "quatprop propagate demo.bag -o attitude.csv --method coning",
    "quatprop convert attitude.csv attitude.parquet --layout scalar-last",
    "quatprop convert attitude.parquet attitude.tum",
    "quatprop convert attitude.csv - --as euler-zyx --euler-unit deg",
    "quatprop convert attitude.csv joint.csv --relative-to demo.truth.csv",
    "quatprop convert attitude.csv enu.csv --left ned-to-enu --right frd-to-flu",
)


OPTIONS = {
    "--as representation": Keyword(
        Choice("quaternion", "rotvec", *EULER, "matrix", "body-rates", "inertial-rates"),
        "Representation: quaternions, rotation vectors in rad, yaw, pitch and roll about "
        "z, y' and x'' (or angles of another sequence, such as euler-xyz or euler-zxz), "
        "matrices row by row, or the rates in rad/s that lead from each attitude to the "
        "next: propagated with --method start, they give the attitudes back.", "quaternion",
        "quaternion|rotvec|euler-zyx|matrix|body-rates|inertial-rates", group="Output", common=True,
        preset=True),
    **REPORT,
    **QUIET,
}  # fmt: skip


@click.command(cls=Command, examples=EXAMPLES, no_args_is_help=True)
@click.argument("log", type=PATH, metavar="IN")
@click.argument("output", type=PATH, metavar="OUT")
@with_options(
    options_of(READ_ATTITUDES, log="IN", signal="attitudes"),
    {**OUTPUT_OPTIONS, "--euler-unit": replace(OUTPUT_OPTIONS["--euler-unit"], common=True)},
    options_of(TERMS, log="IN"),
    OPTIONS,
)
def command(*, quiet: bool, **chosen: Any) -> int:
    """Write the attitude series IN as OUT: layout, convention, direction, representation, format.

    IN is a table or a log of messages with attitudes (IN:TOPIC names one), or - for stdin; OUT is a
    file, or - for stdout.
    """
    from quatprop.cli.summary import progress, show
    from quatprop.tools.conversion import Conversion, convert, terms_of

    job = Conversion(
        source=input_of(chosen["log"], chosen),
        output=output_settings(chosen),
        representation=with_unit(chosen["representation"], chosen["euler_unit"]),
        **terms_of(chosen),
    )
    with progress(quiet=quiet):
        report = convert(job)
    if not quiet:
        show(_summary(report), indent=5)
    return 3 if report.data_lost else 0


def _summary(report: ConversionReport) -> Iterator[str]:
    """Yield the lines of the summary."""
    from quatprop.base.places import without_secret
    from quatprop.base.rendering import count_text, loss_lines, source_text

    job, stored, counts = report.job, report.signal, report.counts
    order = stored.layout or stored.representation
    stored_as = f"{stored.meaning.convention} {stored.meaning.direction}, {order}"
    written_as = f"{job.meaning.convention} {job.meaning.direction}, {job.representation}"
    name = source_text(stored.name, stored.type_name)
    yield f"in   {plain(report.path)} ({report.kind}): {name}; {stored_as}, {stored.clock} clock"
    path, rows = plain(without_secret(job.output.path)), count_text(report.written, "row")
    yield f"out  {path}: {rows}; {written_as}, {','.join(report.columns)}"
    if outside := sum(report.outside):
        yield f"omitted: {count_text(outside, 'row')} outside the time range"
    if job.relative_to is not None:
        yield f"relative to {plain(job.relative_to)}"
    if job.axes is not None:
        changed = {"reference": job.left, "body": job.right}
        turned = (f"of the {name} by {plain(str(turn))}" for name, turn in changed.items() if turn)
        yield f"axes {' and '.join(turned)}"
    if counts.normalized:
        yield (
            f"warning: {count_text(counts.normalized, 'row')} scaled to unit length, off by up to "
            f"{counts.worst:.3g}"
        )
    if counts.invalid:
        yield (
            f"lost: {count_text(counts.invalid, 'invalid quaternion')}: {counts.zero} zero, "
            f"{counts.not_unit} not of unit length, {counts.not_finite} absent or not finite; the "
            f"first at {counts.first_ns} ns"
        )
    yield from (f"note: {spelled(remark)}" for remark in report.remarks)
    yield from loss_lines(report.losses)
