"""Options that say which attitudes to read, and what to do about those that are none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.types import names
from quatprop.settings import CLOCKS, KINDS, LAYOUTS, TIME_UNITS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.cli.options import Option
    from quatprop.selection import AttitudeSelection

CONVENTIONS = ("hamilton", "jpl")
DIRECTIONS = ("body-to-ref", "ref-to-body")

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
            "type": names("A,B,C,D"),
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
    "from_angle_unit": (
        "--from-angle-unit",
        {
            "type": click.Choice(("rad", "deg")),
            "help": "Unit of angles in {side}, a table of yaw, pitch, roll or rotation vectors.  "
            "[default: by names; required where they do not say it]",
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
        help="Invalid quaternions (zero, NaN, marked absent, not of unit length): refuse or leave "
        "out.",
    ),
)


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


def attitude_selection(chosen: Mapping[str, Any], suffix: str = "") -> AttitudeSelection:
    """Return which attitudes to read, from the options of a command."""
    from quatprop.selection import AttitudeSelection

    return AttitudeSelection(
        **{key: chosen[key + suffix] for key in ATTITUDE_OPTIONS if key != "kind"}
    )
