"""How settings are written in a suite: ``clock = "log"``."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from quatprop.settings import CHECKS, OPTION_NAMES, PROPAGATE, READ_ATTITUDES
from quatprop.settings.parsers import flag
from quatprop.text import Setting, Text

if TYPE_CHECKING:
    from quatprop.errors import QuatpropError

FLAGS = {name for name, row in {**PROPAGATE, **READ_ATTITUDES}.items() if row.parse is flag}
"""Settings that are on or off."""


def suite_key(setting: Setting, side: str = "") -> str:
    """Return a setting as a key of a case, such as ``clock = "log"``; B is the reference."""
    name = OPTION_NAMES.get(setting.name, setting.name).replace("_", "-")
    if name == "update":  # an option of the command, not a key of a case
        return f"--{name}"
    if side == "b" and setting.name not in CHECKS:
        name = f"reference-{name}"
    if side in {"at", "q0"}:
        # Attitudes of a file that is only looked up have no keys of their own.
        return f"--{name} {setting.value} of quatprop convert".replace("  ", " ")
    if not setting.value:
        return name
    return f"{name} = " + " or ".join(f'"{value}"' for value in setting.value.split("|"))


def _spelled_in_sentence(setting: Setting, side: str = "") -> str:
    """Return a setting as a sentence has it: ``sigma = true`` where it is on or off."""
    return suite_key(setting, side) + (" = true" if setting.name in FLAGS else "")


def sentence(error: QuatpropError) -> str:
    """Return the sentence of an error, with keys in place of the settings it mentions."""
    return error.text.spelled(partial(_spelled_in_sentence, side=error.side))


def spelled(text: str | Text) -> str:
    """Return a remark, with keys in place of the settings it mentions."""
    return text.spelled(_spelled_in_sentence) if isinstance(text, Text) else text
