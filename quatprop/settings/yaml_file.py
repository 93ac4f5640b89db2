"""Files in YAML or JSON that describe a sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.errors import UsageError, os_reason
from quatprop.text import Setting, plain

if TYPE_CHECKING:
    from collections.abc import Mapping

MAX_BYTES = 1_000_000
"""A larger file describes no sensor."""


def read_yaml(setting: str, path: Path | str) -> Mapping[str, object]:
    """Return the content of a file, by name.

    Parameters
    ----------
    setting
        The setting that names the file, for errors.
    path
        The file.

    Raises
    ------
    UsageError
        It cannot be read, or is not YAML or JSON with names at the top.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        if Path(path).stat().st_size > MAX_BYTES:
            raise unusable(setting, path, "it is too large to describe a sensor")
        # How OpenCV begins a file is not YAML.
        text = Path(path).read_text(encoding="utf-8").removeprefix("%YAML:1.0")
        # The safe loader creates plain values only, whatever the tags ask for.
        content = YAML(typ="safe").load(text)
    except OSError as error:
        raise unusable(setting, path, os_reason(error)) from error
    except (YAMLError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise unusable(setting, path, "it is neither YAML nor JSON") from error
    if not isinstance(content, dict):
        raise unusable(setting, path, "it holds no names with values")
    return content


def unusable(setting: str, path: Path | str, reason: str) -> UsageError:
    """Return the error of a file that a setting names."""
    return UsageError(f"{Setting(setting)} {plain(path)}: {reason}")
