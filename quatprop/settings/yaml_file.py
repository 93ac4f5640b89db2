"""Files in YAML or JSON that describe a sensor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError
from quatprop.settings import guarded_text
from quatprop.settings.guarded_text import ContentError, read_bytes
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

MAX_BYTES = 1_000_000
"""Largest file that may describe a sensor, bytes."""


def read_yaml(setting: str, path: Path | str) -> Mapping[str, object]:
    """Return the content of a file, by name."""
    try:
        # The first line of files from OpenCV is not YAML.
        text = read_bytes(path, MAX_BYTES).removeprefix(b"%YAML:1.0")
        content = guarded_text.read_yaml(text)
    except ContentError as error:
        raise unusable(setting, path, str(error)) from error
    if not isinstance(content, dict):
        raise unusable(setting, path, "it holds no names with values")
    return content


def unusable(setting: str, path: Path | str, reason: str) -> UsageError:
    """Return the error for the file of a setting."""
    return UsageError(f"{Setting(setting)} {plain(path)}: {reason}")
