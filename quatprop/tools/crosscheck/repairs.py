"""Settings for single sources: how their numbers are to be read instead.

They mean what the options of the same names mean elsewhere, applied to what was read. So a
repair can be tried on a log with several sources, and on those whose layout is fixed by their type.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.base.errors import UsageError
from quatprop.base.text import Setting, did_you_mean, listed, quoted
from quatprop.kinematics import conventions
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, from_matrix, multiply
from quatprop.settings.parsers import Choice, number, signed_duration
from quatprop.settings.quantities import CONVENTIONS, DIRECTIONS, LAYOUTS, RATE_UNITS, RATES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.tools.crosscheck.sources import Source

    Repair = Callable[[Source, str], Source]


def applied(sources: list[Source], settings: Mapping[str, Mapping[str, str]]) -> list[Source]:
    """Return sources with the settings for some of them applied.

    `settings`: source or device -> setting -> value
    """
    for name in settings:
        if not any(name in (each.name, each.device) for each in sources):
            hint = did_you_mean(name, [each.name for each in sources])
            names = listed(each.name for each in sources)
            raise UsageError(
                f"{Setting('correct')}: no source {quoted(name)}{hint}; there are {names}"
            )
    return [_repaired(source, settings) for source in sources]


def _repaired(source: Source, settings: Mapping[str, Mapping[str, str]]) -> Source:
    own = {**settings.get(source.device, {}), **settings.get(source.name, {})}
    for setting in sorted(own, key=[*REPAIRS].index):
        kinds, repair = REPAIRS[setting]
        if source.kind in kinds:
            source = repair(source, own[setting])
        elif setting in settings.get(source.name, {}):
            raise UsageError(
                f"{Setting('correct')}: {Setting(setting)} is for {kinds[0]}, and "
                f"{quoted(source.name)} is {source.kind}"
            )
    return source


def _layout(source: Source, value: str) -> Source:
    wanted = conventions.layout_named(Choice(*LAYOUTS)(value)).name
    if wanted == source.layout or {wanted, source.layout} - {"scalar-first", "scalar-last"}:
        return source
    by = -1 if wanted == "scalar-first" else 1
    # A scalar-last quaternion that was stored scalar first has its w in x, and so on.
    stored = np.roll(source.values, by, axis=1)
    return replace(source, values=stored, layout=wanted)


def _conjugate(source: Source, value: str, *, names: tuple[str, ...], other: str) -> Source:
    is_other = Choice(*names)(value) == other
    return replace(source, values=conjugate(source.values)) if is_other else source


def _unit(source: Source, value: str) -> Source:
    return _scaled(source, RATES[Choice(*RATE_UNITS)(value)])


def _scale(source: Source, value: str) -> Source:
    return _scaled(source, number(value))


def _scaled(source: Source, factor: float) -> Source:
    return replace(source, values=source.values * factor)


def _bias(source: Source, value: str) -> Source:
    text, unit = re.fullmatch(r"(.*?)\s*(deg/s|rad/s)?", value).groups()  # type: ignore[union-attr]
    bias = np.array([number(each) for each in text.split(",")])
    if bias.shape != (3,):
        raise UsageError(
            f"{quoted(value)} is not a bias; write X,Y,Z with its unit, as 0,0.1,0deg/s"
        )
    return replace(source, values=source.values - bias * RATES[unit or "rad/s"])


def _mount(source: Source, value: str) -> Source:
    matrix = conventions.mounting(value)
    if source.is_rates:
        return replace(source, values=source.values @ matrix.T)
    return replace(source, values=multiply(source.values, from_matrix(matrix.T)))


def _offset(source: Source, value: str) -> Source:
    return replace(source, t_ns=source.t_ns + int(signed_duration(value)))


def _inertial(source: Source, value: str) -> Source:
    if Choice("body", "inertial")(value) == "body":
        return source
    wxyz = attitudes(source.t_ns, source.values, method="coning", rates="inertial")
    return replace(source, values=wxyz, kind="orientation", has_axes=False)


_RATES, _ORIENTATION = ("rates",), ("orientation",)

REPAIRS: Final[dict[str, tuple[tuple[str, ...], Repair]]] = {
    "from_layout": (_ORIENTATION, _layout),
    "from_convention": (
        _ORIENTATION, partial(_conjugate, names=CONVENTIONS, other="jpl")),
    "from_direction": (
        _ORIENTATION, partial(_conjugate, names=DIRECTIONS, other="ref-to-body")),
    "rate_unit": (_RATES, _unit),
    "scale": (_RATES, _scale),
    "bias": (_RATES, _bias),
    "mount": (("rates", "orientation"), _mount),
    "rates": (_RATES, _inertial),
    "time_offset": (("rates", "orientation"), _offset),
}  # fmt: skip
"""Setting -> the kinds of source that it is for, and what it does, in the order in which they are
applied."""
