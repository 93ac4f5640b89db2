"""Typed settings for one log: which rates, how they are propagated, and the output.

:func:`propagation_settings` makes them of the names and values in :mod:`quatprop.settings`, for the
library, the command line and suites alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.errors import UsageError
from quatprop.base.places import is_address, without_secret
from quatprop.base.text import Setting
from quatprop.kinematics.conventions import layout_named
from quatprop.propagation.gyro_errors import ErrorSettings
from quatprop.propagation.initial_attitude import EarthRate, InitialAttitude
from quatprop.propagation.rate_stream import RateSettings
from quatprop.settings import as_text, parse_all
from quatprop.settings.bias import GivenBias, StaticBias
from quatprop.settings.parsers import FROM_THE_LOG, InMemory, resolve_path
from quatprop.settings.reading import GyroCorrection, RateSelection
from quatprop.stores.objects import split_topic
from quatprop.timeline.counts import Policy
from quatprop.writers.formats import keeps_provenance, kind_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from fractions import Fraction

    from quatprop.readers.matching import Match
    from quatprop.writers.formats import Message


@dataclass(frozen=True, slots=True)
class PropagationSettings:
    """Everything that determines the attitudes of a log.

    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content, then suffix
    `policy`: how irregular timestamps are handled
    `method`: integration rule: one of :data:`quatprop.settings.METHODS`; None: what
        the log says of its samples, or else ``"start"``
    `earth_rate`: the rotation of the reference that is removed; None if it is inertial
    `q0`: attitude body -> reference at the first sample, or its source
    `correction`: bias, mounting and the part of the log to use
    `every`: keep every N-th attitude; None for all
    `rate`: attitudes at this rate, Hz, exact at those times; None for the samples
    `at`: attitudes at the stamps of this series, exact at those times; None for the samples
    `threads`: how many threads compute at a time; None is as many as there are cores. The result is
        the same, so that settings that differ in it alone are equal
    `errors`: the known errors of the gyroscope
    `given`: the settings that were given, by name, as text: what is needed to make an output again
    """

    kind: str | None = None
    selection: RateSelection = field(default_factory=RateSelection)
    policy: Policy = field(default_factory=Policy)
    method: str | None = None
    earth_rate: EarthRate | None = None
    q0: InitialAttitude = field(default_factory=InitialAttitude)
    correction: GyroCorrection = field(default_factory=GyroCorrection)
    every: int | None = None
    rate: Fraction | None = None
    at: str | InMemory | None = None
    threads: int | None = field(default=None, repr=False, compare=False)
    errors: ErrorSettings = field(default_factory=ErrorSettings)
    given: Mapping[str, str | bool] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if [self.every, self.rate, self.at].count(None) < 2:  # noqa: PLR2004  # two of three
            raise UsageError(
                f"{Setting('every')}, {Setting('rate')} and {Setting('at')} each say which "
                "attitudes to write; choose one"
            )
        if self.correction.static is None:
            self.errors.refuse_unknown_errors()
        if self.earth_rate is not None:
            self._refuse_with_earth_rate()
        if (
            self.rates == "inertial"
            and self.correction.mount is not None
            and self.q0.source not in FROM_THE_LOG
        ):
            raise UsageError(
                f"rates resolved in the reference frame are not rotated by {Setting('mount')}; "
                f"it rotates what {Setting('q0', 'level|log')} take from the log; or omit it",
            )

    def _refuse_with_earth_rate(self) -> None:
        earth_rate = Setting("earth_rate")
        if self.rates == "inertial":
            rate = ",".join(f"{x:.9g}" for x in self.earth_rate.rate) if self.earth_rate else ""
            raise UsageError(
                f"{earth_rate} is for body rates; from rates resolved in the reference frame "
                f"subtract the Earth rate with {Setting('bias', f'{rate}rad/s')}"
            )
        if self.correction.static is not None:
            raise UsageError(
                f"{Setting('bias', 'static')} subtracts the mean rate at rest, which includes "
                f"the Earth rate that {earth_rate} removes; give {Setting('bias')} as numbers"
            )
        if self.policy.on_gap in {"zero", "split"}:
            raise UsageError(
                f"{earth_rate} counts the time since the first sample, including gaps; choose "
                f"{Setting('on_gap', 'hold')} or {Setting('on_gap', 'error')}"
            )

    @property
    def rates(self) -> str:
        """The frame in which the rates are resolved, ``"body"`` or ``"inertial"``."""
        return self.correction.rates

    @property
    def of_rates(self) -> RateSettings:
        """The handling and correction of the rates before propagation."""
        return RateSettings(self.policy, self.correction, self.method)

    def for_rates_of(self, matches: Iterable[Match]) -> PropagationSettings:
        """Return the settings with the reference's z axis as the type of the rates has it."""
        is_turned = self.correction.mount is not None
        if is_turned or not any(match.row.frames for match in matches):
            return self
        q0, earth_rate = self.q0, self.earth_rate
        if q0.source == "level" and q0.down is None:
            q0 = replace(q0, down=True)
        if earth_rate is not None and earth_rate.down is None:
            earth_rate = earth_rate._replace(down=True)
        return replace(self, q0=q0, earth_rate=earth_rate)

    @property
    def needs_second_read(self) -> bool:
        """Whether the log has to be read before it is propagated; stdin cannot be."""
        named = {"q0": self.q0.source, "at": self.at}
        is_topic = [isinstance(one, str) and one and name not in self.inputs
                    for name, one in named.items()]  # fmt: skip
        return self.correction.looks_ahead or any(is_topic)

    @property
    def inputs(self) -> Mapping[str, str]:
        """Files that are read besides the log, except message definitions: setting -> path."""
        named = {
            "at": self.at,
            "bias": self.correction.bias_from,
            "calibration": self.correction.calibration,
            "imu": self.errors.imu,
            "q0": self.q0.source,
        }
        return {
            name: split_topic(path)[0]
            for name, path in named.items()
            if path
            and isinstance(path, str)
            and (is_address(path) or resolve_path(name, path, Path()))
        }


class OutputSettings(NamedTuple):
    """The output of attitudes.

    `path`: path of the attitude series, or ``"-"`` for CSV on stdout
    `to`: format, a key of :data:`quatprop.writers.formats.WRITERS`; None: detected from the suffix
    `layout`: ``"scalar-first"`` or ``"scalar-last"``: the order of the columns written; None is
        what the format prescribes, or scalar-first where it leaves the choice
    `message`: what to write the attitudes as, where they are written as messages
    `extra_columns`: what else to write of each attitude: a key of
        :data:`quatprop.kinematics.conventions.REPRESENTATIONS`; None for nothing
    `comment`: write the report in a comment at the beginning of the output
    `report`: where the report goes as JSON, ``"-"`` for stdout; None is nowhere
    """

    path: str
    to: str | None = None
    layout: str | None = None
    message: Message | None = None
    extra_columns: str | None = None
    comment: bool = False
    report: str | None = None

    @property
    def kind(self) -> str:
        """The format, a key of :data:`quatprop.writers.formats.WRITERS`."""
        return kind_of(self.path, self.to)

    @property
    def keeps_provenance(self) -> bool:
        """Whether the file of attitudes contains their provenance."""
        return keeps_provenance(self.path, self.to, comment=self.comment)

    @property
    def keeps_report(self) -> bool:
        """Whether a file contains the report; if not, the source is not read again for it."""
        return self.report is not None or self.keeps_provenance

    @property
    def given(self) -> Mapping[str, str | bool]:
        """Settings that determine the file, but its name and format, as text by name."""
        values: dict[str, str | bool | None] = {"layout": self.layout}
        if self.message is not None:
            values |= {
                "message": self.message.type,
                "out_topic": self.message.topic,
                "frames": f"{self.message.frame},{self.message.child}",
            }
        if self.extra_columns is not None:
            values["extra_columns"] = self.extra_columns.removesuffix("-deg")
            values["euler_unit"] = "deg" if self.extra_columns.endswith("-deg") else None
        values["header_comment"] = self.comment or None
        return {name: value for name, value in values.items() if value is not None}


def propagation_settings(options: Mapping[str, object]) -> PropagationSettings:
    """Return settings from their names and values.

    `options`: keys of :data:`quatprop.settings.PROPAGATE`; their values as text or as Python
        values, None for not given
    """
    values = parse_all(options)
    given = {
        name: without_secret(text) if isinstance(text, str) else text
        for name, value in values.items()
        if name != "threads" and (text := as_text(name, options[name], value))
    }
    bias = values.get("bias")
    return PropagationSettings(
        selection=RateSelection.from_settings(values),
        policy=Policy(max_gap_ns=values.get("max_gap"), **_named(Policy, values)),
        correction=GyroCorrection(
            bias_from=bias if isinstance(bias, str | InMemory) else None,
            static=bias if isinstance(bias, StaticBias) else None,
            **{
                **_named(GyroCorrection, values),
                "bias": bias if isinstance(bias, GivenBias) else None,
            },
        ),
        errors=ErrorSettings(**_named(ErrorSettings, values)),
        given=given,
        **{
            **_named(PropagationSettings, values),
            "q0": _initial_attitude(values),
            "earth_rate": _earth_rate(values),
        },
    )


def _named(record: type, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the given values of the settings that are fields of a record."""
    return {name: values[name] for name in record.__annotations__ if name in values}


_DOWN = {"up": False, "down": True}
"""Whether the reference's z axis points down; not given, it is as the type of the rates has it."""


def _earth_rate(values: Mapping[str, Any]) -> EarthRate | None:
    place = values.get("earth_rate")
    if place is None:
        return None
    latitude, azimuth = (*place, None)[:2]
    return EarthRate(latitude, azimuth, down=_DOWN.get(values.get("reference_z", "")))


def _initial_attitude(values: Mapping[str, Any]) -> InitialAttitude:
    q0 = values.get("q0")
    level, earth_rate = Setting("q0", "level"), Setting("earth_rate")
    for name, partner, fits in (
        ("heading", level, q0 == "level"),
        ("reference_z", f"{level} or {earth_rate}", q0 == "level" or "earth_rate" in values),
        ("q0_layout", Setting("q0", "W,X,Y,Z"), isinstance(q0, tuple)),
    ):
        if name in values and not fits:
            raise UsageError(f"{Setting(name)} requires {partner}")
    if q0 is None:
        return InitialAttitude()
    if isinstance(q0, tuple):
        order = layout_named(values.get("q0_layout", "scalar-first")).order
        return InitialAttitude(wxyz=tuple(q0[order.index(part)] for part in range(4)))
    return InitialAttitude(
        source=q0,
        heading=math.radians(values.get("heading", 0.0)),
        down=_DOWN.get(values.get("reference_z", "")),
    )
