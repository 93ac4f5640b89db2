"""How interfaces spell settings: as options, ``--clock log``, or as keys of a suite.

Output passes through :func:`quatprop.text.spelled`, for which the command line sets
:func:`in_options` and a suite :func:`in_keys`. Keywords of the library are not changed.
"""

from __future__ import annotations

from quatprop.settings import PROPAGATE
from quatprop.settings.parsers import flag
from quatprop.settings.reading import ONE_SERIES, OPTION_NAMES, READ_ATTITUDES, READ_RATES
from quatprop.text import only_last, with_settings

LOOKUPS = {"at": {"start"}, "q0": {"start"}, "info": READ_RATES.keys()}
"""Sides whose attitudes are only looked up, and the settings that the command itself has for them;
quatprop convert has all settings."""

FLAGS = {name for name, row in {**PROPAGATE, **READ_ATTITUDES}.items() if row.parse is flag}
"""Settings that are on or off."""

OF_CHECK = {"update", "strict", "force"}
"""Options of the command check that are not keys of a case."""

_ELSEWHERE = " of quatprop convert"


def option(name: str, side: str = "") -> str:
    """Return a setting as an option, such as ``--clock``, or ``--clock-b`` of side b."""
    key = OPTION_NAMES.get(name, name).replace("_", "-")
    return f"--{key}-{side}" if side and name in ONE_SERIES else f"--{key}"


def suite_key(name: str, side: str = "") -> str:
    """Return a setting as a key of a case, such as ``clock``; B is the reference."""
    key = option(name)[2:]
    return f"reference-{key}" if side == "b" and name in ONE_SERIES else key


def in_options(text: str, side: str = "") -> str:
    """Return a sentence with options; their command is named once, after the last."""

    def spell(name: str, value: str, own: str) -> str:
        about = own or side
        if about in LOOKUPS:
            elsewhere = "" if name in LOOKUPS[about] else _ELSEWHERE
            return f"{option(name)} {value}".rstrip() + elsewhere
        return f"{option(name, about)} {value}".rstrip()

    return only_last(with_settings(text, spell), _ELSEWHERE)


def in_keys(text: str, side: str = "") -> str:
    """Return a sentence with keys of a suite."""

    def spell(name: str, value: str, own: str) -> str:
        about = own or side
        if name not in LOOKUPS.get(about, (name,)):
            # Attitudes that are only looked up have no keys of their own.
            return f"{option(name)} {value}".rstrip() + _ELSEWHERE
        if name in OF_CHECK:
            return option(name)
        values = " or ".join(f'"{one}"' for one in value.split("|")) if value else ""
        on = " = true" if name in FLAGS else ""
        return suite_key(name, about) + (f" = {values}" if values else on)

    return only_last(with_settings(text, spell), _ELSEWHERE)
