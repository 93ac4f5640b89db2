"""How the command line spells the settings that sentences mention: ``--clock log``."""

from __future__ import annotations

import shlex
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from quatprop.settings import CHECKS, OPTION_NAMES, READ_RATES
from quatprop.text import Setting, Text, plain

if TYPE_CHECKING:
    from quatprop.errors import QuatpropError

LOOKUPS = {"at", "q0", "info"}
"""Sides whose attitudes are only looked up; quatprop convert can say everything about them."""

_ELSEWHERE = " of quatprop convert"


def option(setting: Setting, side: str = "") -> str:
    """Return a setting as an option, such as ``--clock log``, or ``--clock-b log`` for side b."""
    side = setting.side or side
    name = OPTION_NAMES.get(setting.name, setting.name).replace("_", "-")
    # What the command has itself, of the settings about what is only looked up.
    own = READ_RATES if side == "info" else {"start"}
    elsewhere = _ELSEWHERE if side in LOOKUPS and setting.name not in own else ""
    if side and side not in LOOKUPS:
        from quatprop.comparison.settings import COMPARE

        if setting.name not in COMPARE and setting.name not in CHECKS:
            name += f"-{side}"
    return (f"--{name} {setting.value}" if setting.value else f"--{name}") + elsewhere


def sentence(error: QuatpropError) -> str:
    """Return what an error says, with options in place of the settings it mentions."""
    return _in_options(error.text, error.side)


def spelled(text: str | Text, side: str = "") -> str:
    """Return a remark on one line, with options in place of the settings it mentions."""
    return plain(_in_options(text, side) if isinstance(text, Text) else text)


def _in_options(text: Text, side: str) -> str:
    """Spell the settings of a text; whose options they are is said once, after the last."""
    sentence, elsewhere, rest = text.spelled(partial(option, side=side)).rpartition(_ELSEWHERE)
    return sentence.replace(_ELSEWHERE, "") + elsewhere + rest


def in_options(value: Any) -> Any:
    """Return what becomes JSON, with options in place of the settings that its texts mention."""
    if isinstance(value, dict):
        return {name: in_options(item) for name, item in value.items()}
    if isinstance(value, list):
        return [in_options(item) for item in value]
    return spelled(value) if isinstance(value, Text) else value


def command_line() -> str:
    """Return the command that runs, as a shell takes it."""
    from quatprop.stores.objects import without_secret

    return shlex.join(["quatprop", *map(without_secret, sys.argv[1:])])
