"""``quatprop simulate``: a log with a known true attitude."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.help import Command
from quatprop.cli.options import with_options
from quatprop.cli.types import PATH
from quatprop.errors import UsageError
from quatprop.settings.keyword import Keyword
from quatprop.settings.parsers import Choice, count, flag, frequency, length, number_list
from quatprop.writers.formats import GENERAL_KINDS

if TYPE_CHECKING:
    from collections.abc import Mapping

MOTIONS = ("rest", "spin", "coning", "tumbling", "random-walk")
"""The keys of :data:`quatprop.simulate.motion.MOTIONS`; spelled out to keep help quick."""

SHAPED_BY = {
    "frequency": ("spin", "coning", "tumbling"),
    "axis": ("spin",),
    "angle": ("coning", "tumbling"),
    "spin_frequency": ("tumbling",),
    "walk": ("random-walk",),
}
"""The motions that each option belongs to."""

DEFAULT_DURATION_NS = 20_000_000_000


def _exact(text: object) -> Fraction:
    """Return an exact number: 0.1 is one tenth."""
    try:
        return Fraction(str(text))
    except (ValueError, ZeroDivisionError):
        raise UsageError(f"{text!r} is not a number") from None


def _moment(text: object) -> int:
    """Return an absolute time in ns."""
    from quatprop.times import absolute_ns

    if (ns := absolute_ns(str(text))) is None:
        raise UsageError(
            f"{text!r} is not a time; write RFC 3339 (2024-01-31T12:00:00Z) or integer nanoseconds"
        )
    return ns


EXAMPLES = (
    "quatprop simulate spin.csv --frequency 0.25",
    "quatprop simulate coning.mcap --motion coning --rate 200 --duration 1m",
    "quatprop simulate rest.bag --motion rest --noise 1e-4 --bias 0.01,0,0",
)


OPTIONS = {
    "--to kind": Keyword(
        Choice(*GENERAL_KINDS), "Kind of the log.",
        "by the suffix, else a ROS 2 bag"),
    "--compression": Keyword(
        Choice("none", "lz4", "zstd", "bz2"), "Compression of a message log.",
        "zstd for mcap, else none"),
    "--truth": Keyword(
        PATH, "Where the true attitudes go, or 'none'.",
        "OUT's name with .truth.csv, beside Parquet .truth.parquet, beside - none", "PATH"),
    "--motion": Keyword(Choice(*MOTIONS), "What the body does.", "spin", preset=True),
    "--rate sample_rate": Keyword(frequency, "Samples a second.", "100", "HZ", preset=True),
    "--duration": Keyword(
        length, "How long, such as 20s or 1h; the last sample is just before it.", "20s", "DUR"),
    "--samples": Keyword(count, "How many samples, instead of a duration.", "by duration", "N"),
    "--start start_ns": Keyword(
        _moment, "Time of the first sample, RFC 3339 or ns.", "2023-11-14T22:13:20Z", "TIME"),
    "--seed": Keyword(
        click.IntRange(min=0), "Of noise and random walk: the same seed gives the same log.", "0",
        "N"),
    "--noise": Keyword(click.FloatRange(min=0), "Angle random walk, rad/s/sqrt(Hz).", "0", "X"),
    "--bias": Keyword(
        number_list("X,Y,Z"), "Constant error of the rates, rad/s.", "0,0,0", "X,Y,Z"),
    "--q0": Keyword(
        number_list("W,X,Y,Z"), "True attitude at the first sample, body to reference, scalar "
        "first.", "1,0,0,0", "W,X,Y,Z", preset=True),
    "--frequency": Keyword(
        _exact, "Turns a second: of a spin, of coning, of the precession of tumbling.", "0.5",
        "HZ"),
    "--axis": Keyword(number_list("X,Y,Z"), "Axis of a spin in the body.", "0,0,1", "X,Y,Z"),
    "--angle": Keyword(
        _exact, "Half-angle of the cone, or nutation angle of tumbling.", "10", "DEG"),
    "--spin-frequency": Keyword(
        _exact, "Turns a second of a tumbling body about its own axis.", "0.2", "HZ"),
    "--walk": Keyword(
        click.FloatRange(min=0), "Random walk of the rate, rad/s/sqrt(s).", "0.1", "X"),
    "-q --quiet": Keyword(flag, "Say nothing.", "a line on stderr"),
}  # fmt: skip


@click.command(
    cls=Command,
    examples=EXAMPLES,
    grouped=False,
    short_help="Write a log whose true attitude is known.",
    epilog="Rates are in rad/s, body frame.",
)
@click.argument("out", type=PATH)
@with_options(OPTIONS)
def command(out: str, **options: Any) -> None:
    """Write a log of a known motion to OUT, and the true attitudes beside it.

    The same options give the same bytes.
    """
    from quatprop.cli.progress import progress
    from quatprop.rendering import count_text
    from quatprop.simulate.gyroscope import Gyroscope, samples_in
    from quatprop.simulate.motion import Shape
    from quatprop.simulate.simulate import simulate, truth_beside

    motion = options["motion"]
    _refuse_unused(motion, options)
    if options["samples"] is not None and options["duration"] is not None:
        raise click.UsageError("--samples and --duration exclude each other; give one of them")
    samples = options["samples"] or samples_in(
        options["duration"] or DEFAULT_DURATION_NS, options["sample_rate"]
    )
    truth = options["truth"] or truth_beside(out, options["kind"])
    truth = None if truth == "none" else truth
    given = {name: value for name, value in options.items() if value is not None}
    shape = Shape(**{name: given[name] for name in (*SHAPED_BY, "seed") if name in given})
    gyroscope = Gyroscope(
        options["sample_rate"],
        samples,
        **{name: given[name] for name in ("start_ns", "noise", "bias", "seed") if name in given},
    )
    with progress(quiet=options["quiet"]):
        simulate(
            out,
            motion,
            shape,
            gyroscope,
            q0=options["q0"],
            kind=options["kind"],
            compression=options["compression"],
            truth=truth,
        )
    if not options["quiet"]:
        beside = f"; the truth is in {truth}" if truth else ""
        click.echo(f"{out}: {count_text(samples, 'sample')} of {motion}{beside}", err=True)


def _refuse_unused(motion: str, options: Mapping[str, Any]) -> None:
    """Refuse options of other motions than the chosen one."""
    for name, motions in SHAPED_BY.items():
        if motion not in motions and options[name] is not None:
            option = f"--{name.replace('_', '-')}"
            raise click.UsageError(f"{option} goes with --motion {' or '.join(motions)}")
