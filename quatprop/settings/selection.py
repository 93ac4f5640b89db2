"""Which samples of a log to read."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSelection:
    """Which topic to read, and which time base; None means "not given".

    `msg_path`: message definitions for a log that carries none: a ``.msg`` file, or a folder of
        them
    `clock`: ``"header"``, ``"log"`` or ``"publish"``
    `time_field`: dotted path of the message field that is the time
    `time_col`: time column of a table, by name or number from 0
    `time_unit`: ``"s"``, ``"ms"``, ``"us"`` or ``"ns"``
    `sample_rate`: rows a second, Hz, of a table without a time column
    `series`: which of the interleaved series of a table: a label, or column and label with ``=``
        between them; ``"all"`` reads all as one
    """

    topic: str | None = None
    msg_path: str | None = None
    clock: str | None = None
    time_field: str | None = None
    time_col: str | None = None
    time_unit: str | None = None
    sample_rate: Fraction | float | None = None
    series: str | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return a selection from the values for its fields; missing ones are not given."""
        return cls(**{field.name: values.get(field.name) for field in fields(cls)})


@dataclass(frozen=True, slots=True, kw_only=True)
class RateSelection(SignalSelection):
    """Which body rates to read; None means "not given".

    Takes the parameters of :class:`SignalSelection` too.

    `rate_field`: dotted path of the message field, such as ``"imu.angular_velocity"``
    `rate_cols`: the x, y and z columns of a table, by name or number from 0
    `rate_unit`: ``"rad/s"`` or ``"deg/s"``
    `accel_cols`: the columns of the specific force beside the rates, in any unit
    """

    rate_field: str | None = None
    rate_cols: tuple[str, str, str] | None = None
    rate_unit: str | None = None
    accel_cols: tuple[str, str, str] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AttitudeSelection(SignalSelection):
    """Which attitudes to read and what their numbers mean; None means "not given".

    Takes the parameters of :class:`SignalSelection` too.

    `quat_field`: dotted path of the quaternion in a message
    `quat_cols`: the four columns of a table as stored, by name or number from 0; with `from_euler`
        the three angles in the order of its letters
    `frame`: of a list of transforms, ``"child"`` or ``"parent:child"``
    `from_layout`: ``"scalar-first"`` or ``"scalar-last"``, also ``"wxyz"`` or ``"xyzw"``
    `from_convention`: ``"hamilton"`` or ``"jpl"``
    `from_direction`: ``"body-to-ref"`` or ``"ref-to-body"``
    `from_angle_unit`: ``"rad"`` or ``"deg"``, of Euler angles and rotation vectors
    `from_euler`: sequence of Euler angles, one of :data:`quatprop.settings.EULER_SEQUENCES`
    """

    quat_field: str | None = None
    quat_cols: tuple[str, ...] | None = None
    frame: str | None = None
    from_layout: str | None = None
    from_convention: str | None = None
    from_direction: str | None = None
    from_angle_unit: str | None = None
    from_euler: str | None = None

    @classmethod
    def like(cls, other: SignalSelection) -> Self:
        """Return a selection of attitudes with the topic and the time base of another one."""
        return cls(**{f.name: getattr(other, f.name) for f in fields(SignalSelection)})
