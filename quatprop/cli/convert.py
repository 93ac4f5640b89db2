"""``quatprop convert``: one attitude series in, the same in other terms out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.options import KINDS, ParamType

if TYPE_CHECKING:
    from quatprop.signals.attitudes import AttitudeSelection

LAYOUTS = ("scalar-first", "scalar-last", "wxyz", "xyzw")
CONVENTIONS = ("hamilton", "jpl")
DIRECTIONS = ("body-to-ref", "ref-to-body")

EULER_DEGREES = {("euler-zyx", "deg"): "euler-zyx-deg"}
"""Representation and unit of angles -> key of :data:`quatprop.conventions.REPRESENTATIONS`."""


class FourNames(ParamType):
    """Four names or numbers of columns separated by commas."""

    name = "A,B,C,D"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the four names."""
        if isinstance(value, tuple):
            return value
        parts = tuple(part.strip() for part in value.split(","))
        if len(parts) != 4 or not all(parts):  # noqa: PLR2004  # components of a quaternion
            self.fail(f"{value!r} does not name four columns A,B,C,D", param, ctx)
        return parts


@click.command(no_args_is_help=True)
@click.argument("log", metavar="IN")
@click.argument("output", metavar="OUT")
@click.option(
    "--from",
    "kind",
    type=click.Choice(KINDS),
    help="Kind of IN.  [default: told by its content, then by its suffix]",
)
@click.option("--to", metavar="KIND", help="Format of OUT.  [default: by its suffix]")
@click.option(
    "-t", "--topic", metavar="NAME", help="Topic to read.  [default: the only one with attitudes]"
)
@click.option(
    "--quat-field",
    metavar="A.B.C",
    help="Field of the message that is the quaternion.  [default: known from its type]",
)
@click.option(
    "--frame",
    metavar="[PARENT:]CHILD",
    help="Which transform of a TF topic.  [default: the only one there is]",
)
@click.option(
    "--quat-cols",
    type=FourNames(),
    help="Columns of the quaternion in the order in which they are stored, by name or number "
    "from 0.  [default: by the header]",
)
@click.option(
    "--time-field",
    metavar="A.B",
    help="Field of the message that is the time.  [default: the header stamp]",
)
@click.option(
    "--time-col",
    metavar="C",
    help="Time column of a table, by name or number from 0.  [default: by the header]",
)
@click.option(
    "--time-unit",
    type=click.Choice(("s", "ms", "us", "ns")),
    help="Unit of the time.  [default: as the log says]",
)
@click.option(
    "--sample-rate",
    type=click.FloatRange(min=0, min_open=True),
    metavar="HZ",
    help="Rows a second of a table without a time.  [default: none]",
)
@click.option(
    "--clock",
    type=click.Choice(("header", "log", "publish")),
    help="Whose stamps.  [default: header where the message has one, else log]",
)
@click.option(
    "--from-layout",
    type=click.Choice(LAYOUTS),
    help="Order of the quaternion in IN.  [default: by names, definitions or metadata; required "
    "where none of them says it]",
)
@click.option(
    "--layout",
    type=click.Choice(LAYOUTS),
    help="Order of the quaternion in OUT.  [default: scalar-first, or what the format prescribes]",
)
@click.option(
    "--from-convention",
    type=click.Choice(CONVENTIONS),
    help="Convention of IN.  [default: by metadata, else hamilton]",
)
@click.option(
    "--convention",
    type=click.Choice(CONVENTIONS),
    default="hamilton",
    show_default=True,
    help="Convention of OUT.",
)
@click.option(
    "--from-direction",
    type=click.Choice(DIRECTIONS),
    help="Which coordinates IN turns into which.  [default: by metadata, else body-to-ref]",
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
@click.option(
    "--normalize",
    is_flag=True,
    help="Scale quaternions to unit length.  [default: refuse those off by more than 0.001]",
)
@click.option(
    "--on-invalid",
    type=click.Choice(("error", "drop")),
    default="error",
    show_default=True,
    help="Rows that are no rotation (zero, NaN, marked absent, not unit): refuse or leave out.",
)
@click.option(
    "--header-comment",
    "comment",
    is_flag=True,
    help="Begin csv, tsv, tum or euroc with the report in a # comment.",
)
@click.option(
    "--report",
    metavar="PATH|-",
    help="Write a JSON report: source, conventions, counts, version.  [default: none]",
)
@click.option("-q", "--quiet", is_flag=True, help="No summary; errors only.")
def command(**chosen: Any) -> None:
    """Write the attitude series IN as OUT: layout, convention, direction, representation, format.

    IN is a table or a log of messages with attitudes, or - for CSV on stdin; OUT is a file, or -
    for CSV on stdout.

    \b
    quatprop convert attitude.parquet attitude.csv --layout scalar-last
    quatprop convert flight.bag vicon.tum -t /vicon/auk/auk
    quatprop convert attitude.csv - --as euler-zyx --euler-unit deg
    """
    from quatprop.cli import words
    from quatprop.conventions import Meaning
    from quatprop.convert import Conversion, convert

    quiet = chosen.pop("quiet")
    unit, representation = chosen.pop("euler_unit"), chosen.pop("representation")
    if unit is not None and representation != "euler-zyx":
        raise click.UsageError("--euler-unit is for --as euler-zyx")
    job = Conversion(
        selection=attitude_selection(chosen),
        meaning=Meaning(chosen.pop("convention"), chosen.pop("direction")),
        representation=EULER_DEGREES.get((representation, unit), representation),
        drop=chosen.pop("on_invalid") == "drop",
        **chosen,
    )
    with words.progress(quiet=quiet) as tick:
        report = convert(job, tick)
    step = report["conversions"][-1]
    if not quiet:
        click.echo("\n".join([_summary(job.output, step), *words.lost(step["losses"])]), err=True)
    if step["losses"] or step["counts"]["read"] != step["counts"]["used"]:
        raise click.exceptions.Exit(3)


def attitude_selection(chosen: dict[str, Any]) -> AttitudeSelection:
    """Take the keywords that choose attitudes out of a command's options."""
    from quatprop.selection import Selection
    from quatprop.signals.attitudes import AttitudeSelection

    samples = ("topic", "time_field", "time_col", "time_unit", "sample_rate", "clock")
    return AttitudeSelection(
        Selection(**{name: chosen.pop(name) for name in samples}),
        **{name: chosen.pop(name) for name in ("quat_field", "quat_cols", "frame")},
        **{name: chosen.pop(f"from_{name}") for name in ("layout", "convention", "direction")},
    )


def _summary(output: str, step: dict[str, Any]) -> str:
    """Return what was done in one or two lines."""
    from quatprop.errors import plain

    source, stored, written, counts = step["source"], step["from"], step["to"], step["counts"]
    said = " ".join(plain(source[key]) for key in ("name", "type") if source[key])
    meant = f"{stored['convention']} {stored['direction']}, {stored['layout']}, {source['clock']}"
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
