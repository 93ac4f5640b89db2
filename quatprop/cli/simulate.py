"""``quatprop simulate``: a log with a known true attitude."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import click

from quatprop.cli.help import Command
from quatprop.cli.options import named_option
from quatprop.cli.types import PATH, OneOf
from quatprop.errors import UsageError
from quatprop.settings.parsers import count, duration, frequency, numbers
from quatprop.writers import GENERAL_KINDS

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
    from quatprop.times import instant

    moment = instant(str(text))
    if moment.origin != "clock":
        raise UsageError(f"{text!r} is not absolute; write RFC 3339 or ns")
    return moment.ns


EXAMPLES = (
    "quatprop simulate spin.csv --frequency 0.25",
    "quatprop simulate coning.mcap --motion coning --rate 200 --duration 1m",
    "quatprop simulate rest.bag --motion rest --noise 1e-4 --bias 0.01,0,0",
)


@click.command(
    cls=Command,
    examples=EXAMPLES,
    grouped=False,
    short_help="Write a log whose true attitude is known.",
    epilog="Rates are in rad/s, body frame.",
)
@click.argument("out", type=PATH)
@click.option(
    "--to",
    "kind",
    type=OneOf(GENERAL_KINDS),
    help="Kind of the log.  [default: by the suffix; without one a ROS 2 bag folder]",
)
@click.option(
    "--compression",
    type=OneOf(("none", "lz4", "zstd", "bz2")),
    help="Compression of a message log.  [default: zstd for mcap, else none]",
)
@named_option(
    "--truth PATH",
    PATH,
    "Where the true attitudes go, or 'none'.  [default: OUT's name with .truth.csv, beside "
    "Parquet .truth.parquet, beside - none]",
)
@click.option(
    "--motion", type=OneOf(MOTIONS), default="spin", show_default=True, help="What the body does."
)
@named_option("--rate sample_rate HZ", frequency, "Samples a second.", "100")
@named_option(
    "--duration DUR",
    duration,
    "How long, such as 20s or 1h; the last sample is just before it.  [default: 20s]",
)
@named_option(
    "--samples N", count, "How many samples, instead of a duration.  [default: by duration]"
)
@named_option(
    "--start start_ns TIME",
    _moment,
    "Time of the first sample, RFC 3339 or ns.",
    "2023-11-14T22:13:20Z",
)
@named_option(
    "--seed N",
    click.IntRange(min=0),
    "Of noise and random walk: the same seed gives the same log.",
    0,
)
@named_option("--noise X", click.FloatRange(min=0), "Angular random walk, rad/s/sqrt(Hz).", 0.0)
@named_option("--bias X,Y,Z", numbers("X,Y,Z"), "Constant error of the rates, rad/s.", "0,0,0")
@named_option(
    "--q0 W,X,Y,Z",
    numbers("W,X,Y,Z"),
    "True attitude at the first sample, body to reference, scalar first.",
    "1,0,0,0",
)
@named_option(
    "--frequency HZ",
    _exact,
    "Turns a second: of a spin, of coning, of the precession of tumbling.",
    "0.5",
)
@named_option("--axis X,Y,Z", numbers("X,Y,Z"), "Axis of a spin in the body.", "0,0,1")
@named_option("--angle DEG", _exact, "Half-angle of the cone, or nutation angle of tumbling.", "10")
@named_option(
    "--spin-frequency HZ", _exact, "Turns a second of a tumbling body about its own axis.", "0.2"
)
@named_option("--walk X", click.FloatRange(min=0), "Random walk of the rate, rad/s/sqrt(s).", 0.1)
@click.option("-q", "--quiet", is_flag=True, help="Say nothing.  [default: a line on stderr]")
def command(out: str, **options: Any) -> None:
    """Write a log of a known motion to OUT, and the true attitudes beside it.

    The same options give the same bytes.
    """
    from quatprop.cli.progress import progress
    from quatprop.simulate.gyroscope import Gyroscope, samples_in
    from quatprop.simulate.motion import Shape
    from quatprop.simulate.run import simulate, truth_beside

    _refuse_unused(options["motion"])
    if options["samples"] is not None and options["duration"] is not None:
        raise click.UsageError("--samples and --duration exclude each other; give one of them")
    samples = options["samples"] or samples_in(
        options["duration"] or DEFAULT_DURATION_NS, options["sample_rate"]
    )
    truth = options["truth"] or truth_beside(out, options["kind"])
    truth = None if truth == "none" else truth
    shape = Shape(
        **{
            name: options[name] for name in ("frequency", "axis", "angle", "spin_frequency", "walk")
        },
        seed=options["seed"],
    )
    gyroscope = Gyroscope(
        **{name: options[name] for name in ("sample_rate", "start_ns", "noise", "bias", "seed")},
        samples=samples,
    )
    with progress(quiet=options["quiet"]):
        simulate(
            out,
            options["motion"],
            shape,
            gyroscope,
            q0=options["q0"],
            kind=options["kind"],
            compression=options["compression"],
            truth=truth,
        )
    if not options["quiet"]:
        beside = f"; the truth is in {truth}" if truth else ""
        click.echo(f"{out}: {samples:,} samples of {options['motion']}{beside}", err=True)


def _refuse_unused(motion: str) -> None:
    """Refuse options of other motions than the chosen one."""
    source = click.get_current_context().get_parameter_source
    for name, motions in SHAPED_BY.items():
        if motion not in motions and source(name) is not click.core.ParameterSource.DEFAULT:
            option = f"--{name.replace('_', '-')}"
            raise click.UsageError(f"{option} goes with --motion {' or '.join(motions)}")
