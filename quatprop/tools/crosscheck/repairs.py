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
from quatprop.kinematics.conventions import layout_named, mounting, signed_axes
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import conjugate, from_matrix, multiply
from quatprop.kinematics.signed_axes import axes_text
from quatprop.settings.parsers import Choice, number, signed_duration
from quatprop.settings.quantities import CONVENTIONS, DIRECTIONS, LAYOUTS, RATE_UNITS, RATES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from quatprop.base.arrays import Float64
    from quatprop.tools.crosscheck.sources import Source

    Repair = Callable[[Source, str], Source]

EXACT: Final = 1e-9
"""Elements of a matrix this near to 0 or 1 are that."""


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
            source = replace(source, corrected={**source.corrected, setting: own[setting]})
        elif setting in settings.get(source.name, {}):
            raise UsageError(
                f"{Setting('correct')}: {Setting(setting)} is for {kinds[0]}, and "
                f"{quoted(source.name)} is {source.kind}"
            )
    return source


def _layout(source: Source, value: str) -> Source:
    wanted = layout_named(Choice(*LAYOUTS)(value)).name
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
    return replace(source, values=source.values - _rates_of(value))


def _rates_of(value: str) -> Float64:
    """Return the components of a bias such as ``"0,0.1,0deg/s"``, rad/s."""
    text, unit = re.fullmatch(r"(.*?)\s*(deg/s|rad/s)?", value).groups()  # type: ignore[union-attr]
    bias = np.array([number(each) for each in text.split(",")])
    if bias.shape != (3,):
        raise UsageError(
            f"{quoted(value)} is not a bias; write X,Y,Z with its unit, as 0,0.1,0deg/s"
        )
    return np.asarray(bias * RATES[unit or "rad/s"])


def _axes(source: Source, value: str) -> Source:
    return replace(source, values=source.values @ signed_axes(value).T)


def _mount(source: Source, value: str) -> Source:
    matrix = mounting(value)
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
    "bias": (_RATES, _bias),
    "scale": (_RATES, _scale),
    "axes": (_RATES, _axes),
    "mount": (("rates", "orientation"), _mount),
    "rates": (_RATES, _inertial),
    "time_offset": (("rates", "orientation"), _offset),
}  # fmt: skip
"""Setting -> the kinds of source that it is for, and what it does, in the order in which they are
applied."""


def combined(source: Source, found: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """Return the settings of a source that do what its own and those found after these do.

    `found`: source or device -> setting -> value
    """
    own = dict(source.corrected)
    for name in dict.fromkeys((source.device, source.name)):
        for setting, value in found.get(name, {}).items():
            if source.kind in REPAIRS[setting][0]:
                _add(own, setting, value)
    return own


def together(
    sources: Sequence[Source], found: Mapping[str, Mapping[str, str]]
) -> dict[str, dict[str, str]]:
    """Return :func:`combined` for all sources: source, or device of several, -> settings."""
    every = {one.name: combined(one, found) for one in sources}
    result: dict[str, dict[str, str]] = {}
    for source in sources:
        for setting, value in every[source.name].items():
            values = [
                every[one.name].get(setting)
                for one in sources
                if one.device == source.device and one.kind in REPAIRS[setting][0]
            ]
            is_shared = len(values) > 1 and {*values} == {value}
            result.setdefault(source.device if is_shared else source.name, {})[setting] = value
    return result


def _add(own: dict[str, str], setting: str, value: str) -> None:
    """Add a setting that was found with the others applied."""
    before = own.get(setting)
    if setting in {"from_layout", "from_direction"}:
        own.pop("mount", None)  # that of another reading
        is_twice = before == value or own.pop("from_convention", "") == "jpl"
        if setting == "from_direction" and is_twice:
            own.pop(setting, None)
            return
    elif setting == "scale" and before is not None:
        value = f"{number(before) * number(value):.6g}"
    elif setting == "time_offset" and before is not None:
        value = f"{(signed_duration(before) + signed_duration(value)) * 1e-6:.7g}ms"
    elif setting == "mount" and before is not None:
        value = mounting_text(mounting(value) @ mounting(before))
    elif setting == "axes":
        turn = signed_axes(value)
        if "mount" in own:  # which is after them
            own["mount"] = mounting_text(turn @ mounting(own["mount"]) @ turn.T)
        value = axes_text(turn @ signed_axes(before or "x,y,z"))
    own[setting] = value


def as_recorded(source: Source, bias: Float64, sigma: Float64) -> tuple[Float64, Float64]:
    """Return a bias of corrected rates, and its deviations, as propagate subtracts it, rad/s.

    That is before scale and mounting, and with what is subtracted already.
    """
    own = source.corrected
    turn = mounting(own.get("mount", "x,y,z")) @ signed_axes(own.get("axes", "x,y,z"))
    scale = number(own.get("scale", "1"))
    whole = turn.T @ bias / scale + _rates_of(own.get("bias", "0,0,0"))
    return whole, np.sqrt(turn.T**2 @ sigma**2) / abs(scale)


def mounting_text(matrix: Float64) -> str:
    """Return a rotation as a mounting: three axes if it exchanges them, else a quaternion."""
    if np.abs(np.abs(matrix) - np.rint(np.abs(matrix))).max() < EXACT:
        return axes_text(np.rint(matrix))
    return ",".join(f"{x:.5f}" for x in from_matrix(matrix))
