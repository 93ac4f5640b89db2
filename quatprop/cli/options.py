"""Options that several commands share: each is defined once and means the same everywhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

from quatprop.cli.types import Names

Command = TypeVar("Command", bound="Callable[..., Any]")

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from quatprop.selection import Selection
    from quatprop.signals.attitudes import AttitudeSelection
    from quatprop.writers.ros_messages import Message

    class Option(Protocol):
        """Gives a command an option."""

        def __call__(self, command: Command, /) -> Command:
            """Return the command with the option."""


KINDS = ("mcap", "bag", "db3", "rosbag2", "ulog", "parquet", "feather", "csv")
"""The keys of :data:`quatprop.readers.READERS`; spelled out so that help imports no reader."""

OUTPUT_KINDS = (
    "csv",
    "tsv",
    "jsonl",
    "parquet",
    "feather",
    "npy",
    "npz",
    "tum",
    "euroc",
    "mcap",
    "bag",
    "rosbag2",
    "rosbag2-mcap",
)
"""The keys of :data:`quatprop.writers.WRITERS`; spelled out so that help imports no writer."""

MESSAGES = ("QuaternionStamped", "PoseStamped", "TFMessage")
"""The keys of :data:`quatprop.writers.ros_messages.MESSAGES`."""

LAYOUTS = ("scalar-first", "scalar-last", "wxyz", "xyzw")
CONVENTIONS = ("hamilton", "jpl")
DIRECTIONS = ("body-to-ref", "ref-to-body")
RATE_UNITS = ("rad/s", "deg/s")
TIME_UNITS = ("s", "ms", "us", "ns")
CLOCKS = ("header", "log", "publish")

kind_option = click.option(
    "--from",
    "kind",
    type=click.Choice(KINDS),
    help="Kind of the log.  [default: told by its content, then by its suffix]",
)

SELECTION_OPTIONS = (
    kind_option,
    click.option(
        "-t",
        "--topic",
        metavar="NAME",
        help="Topic to read.  [default: the only one that has rates]",
    ),
    click.option(
        "--rate-field",
        metavar="A.B.C",
        help="Field of the message that is the rate.  [default: known from its type]",
    ),
    click.option(
        "--time-field",
        metavar="A.B",
        help="Field of the message that is the time.  [default: the header stamp]",
    ),
    click.option(
        "--rate-cols",
        type=Names("X,Y,Z"),
        help="Rate columns of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--time-col",
        metavar="C",
        help="Time column of a table, by name or number from 0.  [default: by the header]",
    ),
    click.option(
        "--rate-unit",
        type=click.Choice(RATE_UNITS),
        help="Unit of the rates.  [default: as the log says]",
    ),
    click.option(
        "--time-unit",
        type=click.Choice(TIME_UNITS),
        help="Unit of the time.  [default: as the log says]",
    ),
    click.option(
        "--sample-rate",
        type=click.FloatRange(min=0, min_open=True),
        metavar="HZ",
        help="Samples a second of a table without a time.  [default: none]",
    ),
    click.option(
        "--clock",
        type=click.Choice(CLOCKS),
        help="Whose stamps.  [default: header where the message has one, else log]",
    ),
)

ATTITUDE_OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "kind": (
        "--from",
        {
            "type": click.Choice(KINDS),
            "help": "Kind of {side}.  [default: told by its content, then by its suffix]",
        },
    ),
    "topic": (
        "--topic",
        {"metavar": "NAME", "help": "Topic of {side}.  [default: the only one with attitudes]"},
    ),
    "quat_field": (
        "--quat-field",
        {
            "metavar": "A.B.C",
            "help": "Message field of {side} that is the quaternion.  "
            "[default: known from its type]",
        },
    ),
    "quat_cols": (
        "--quat-cols",
        {
            "type": Names("A,B,C,D"),
            "help": "Columns of the quaternion in {side} in the order in which they are stored, "
            "by name or number from 0.  [default: by the header]",
        },
    ),
    "frame": (
        "--frame",
        {
            "metavar": "[PARENT:]CHILD",
            "help": "Which transform of {side}, where it is a list of them.  "
            "[default: the only one there is]",
        },
    ),
    "from_layout": (
        "--from-layout",
        {
            "type": click.Choice(LAYOUTS),
            "help": "Order of the quaternion in {side}.  [default: by names, definitions or "
            "metadata; required where none of them says it]",
        },
    ),
    "from_convention": (
        "--from-convention",
        {
            "type": click.Choice(CONVENTIONS),
            "help": "Convention of {side}.  [default: by metadata, else hamilton]",
        },
    ),
    "from_direction": (
        "--from-direction",
        {
            "type": click.Choice(DIRECTIONS),
            "help": "Which coordinates {side} turns into which.  "
            "[default: by metadata, else body-to-ref]",
        },
    ),
    "clock": (
        "--clock",
        {
            "type": click.Choice(CLOCKS),
            "help": "Whose stamps of {side}.  "
            "[default: header where the message has one, else log]",
        },
    ),
    "time_field": (
        "--time-field",
        {
            "metavar": "A.B",
            "help": "Message field of {side} that is the time.  [default: the header stamp]",
        },
    ),
    "time_col": (
        "--time-col",
        {
            "metavar": "C",
            "help": "Time column of {side}, by name or number from 0.  [default: by the header]",
        },
    ),
    "time_unit": (
        "--time-unit",
        {
            "type": click.Choice(TIME_UNITS),
            "help": "Unit of the time of {side}.  [default: as the log says]",
        },
    ),
    "sample_rate": (
        "--sample-rate",
        {
            "type": click.FloatRange(min=0, min_open=True),
            "metavar": "HZ",
            "help": "Rows a second of {side}, a table without a time.  [default: none]",
        },
    ),
}
"""What to read attitudes from: keyword -> its option, and what click is told of it."""

output_kind_option = click.option(
    "--to",
    type=click.Choice(OUTPUT_KINDS),
    help="Format of the output.  [default: by the suffix; without one a ROS 2 bag folder]",
)
layout_option = click.option(
    "--layout",
    type=click.Choice(LAYOUTS),
    help="Order of the quaternion's columns; a matter of storage only.  [default: scalar-first, "
    "but what the format prescribes for tum, euroc and ROS messages]",
)
comment_option = click.option(
    "--header-comment",
    "comment",
    is_flag=True,
    help="Begin csv, tsv, tum or euroc with the report in a # comment.",
)
MESSAGE_OPTIONS = (
    click.option(
        "--message",
        type=click.Choice(MESSAGES),
        help="What mcap and bags hold: the attitude, a pose, or a transform.  "
        "[default: QuaternionStamped]",
    ),
    click.option(
        "--out-topic",
        metavar="NAME",
        help="Topic of the messages.  [default: /attitude, or /tf for TFMessage]",
    ),
    click.option(
        "--frames",
        metavar="REFERENCE,BODY",
        help="Names of the two frames in the messages.  [default: reference,body]",
    ),
)
OUTPUT_OPTIONS = (output_kind_option, layout_option, comment_option, *MESSAGE_OPTIONS)
"""How an attitude series is written."""

report_option = click.option(
    "--report",
    metavar="PATH|-",
    help="Write a JSON report: source, conventions, counts, policies, version.  [default: none]",
)
quiet_option = click.option("-q", "--quiet", is_flag=True, help="No summary; errors only.")

UNSOUND_OPTIONS = (
    click.option(
        "--normalize",
        is_flag=True,
        help="Scale quaternions to unit length.  [default: refuse those off by more than 0.001]",
    ),
    click.option(
        "--on-invalid",
        type=click.Choice(("error", "drop")),
        default="error",
        show_default=True,
        help="Rows that are no rotation (zero, NaN, marked absent, not of unit length): refuse or "
        "leave out.",
    ),
)


def with_options(options: Iterable[Option]) -> Callable[[Command], Command]:
    """Return a decorator that gives a command these options, in this order."""

    def decorated(command: Command) -> Command:
        for option in reversed(tuple(options)):
            command = option(command)
        return command

    return decorated


def selection(chosen: dict[str, Any]) -> Selection:
    """Take the selection's keywords out of a command's options."""
    from dataclasses import fields

    from quatprop.selection import Selection

    return Selection(**{field.name: chosen.pop(field.name) for field in fields(Selection)})


def attitude_options(side: str, suffix: str = "") -> list[Option]:
    """Return the options that choose attitudes.

    Parameters
    ----------
    side
        What help calls the file.
    suffix
        Ends the names of the options, such as ``"-a"``, and with an underscore those of the
        keywords.
    """
    return [
        click.option(
            *(("-t",) if name == "--topic" and not suffix else ()),
            name + suffix,
            key + suffix.replace("-", "_"),
            **{**facts, "help": facts["help"].format(side=side)},
        )
        for key, (name, facts) in ATTITUDE_OPTIONS.items()
    ]


def attitude_selection(chosen: dict[str, Any], suffix: str = "") -> AttitudeSelection:
    """Take the keywords that choose attitudes, but the kind, out of a command's options."""
    from quatprop.selection import Selection
    from quatprop.signals.attitudes import AttitudeSelection

    said = {key: chosen.pop(key + suffix) for key in ATTITUDE_OPTIONS if key != "kind"}
    samples = ("topic", "clock", "time_field", "time_col", "time_unit", "sample_rate")
    return AttitudeSelection(
        Selection(**{key: said.pop(key) for key in samples}),
        **{key.removeprefix("from_"): value for key, value in said.items()},
    )


def message(chosen: dict[str, Any]) -> Message | None:
    """Take what attitudes are written as out of a command's options; None if nothing was said."""
    from quatprop.writers.ros_messages import Message

    kind, topic, frames = (chosen.pop(key) for key in ("message", "out_topic", "frames"))
    if kind is None and topic is None and frames is None:
        return None
    reference, comma, body = (frames or "reference,body").partition(",")
    if not comma:
        raise click.BadParameter(f"--frames {frames!r} is not two names; write REFERENCE,BODY")
    return Message(kind or MESSAGES[0], topic, reference, body)
