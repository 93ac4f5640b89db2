"""A suite as it is written: TOML with ``[defaults]`` and one table a case."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop.errors import SuiteError
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Iterable

SHAPE = "a suite has a table [defaults] and one table [case.NAME] for each case"


@dataclass(frozen=True, slots=True)
class Table:
    """One case as it is written, the defaults included.

    Parameters
    ----------
    name
        Its name.
    values
        Key -> value, as TOML has them.
    line
        Where its table begins in the suite, from 1.
    """

    name: str
    values: dict[str, Any]
    line: int


@dataclass(frozen=True, slots=True)
class Suite:
    """A suite of cases.

    Parameters
    ----------
    path
        The file, as the user named it.
    defaults
        What holds for every case that does not say otherwise.
    tables
        The cases, in the order of the file.
    """

    path: Path
    defaults: dict[str, Any]
    tables: tuple[Table, ...]

    @property
    def lock(self) -> Path:
        """Where what the cases rest on is pinned."""
        return self.path.with_suffix(".lock.json")


def read_suite(path: Path | str) -> Suite:
    """Read a suite; what its keys mean is for the caller to know.

    Raises
    ------
    SuiteError
        It cannot be read, is not TOML, or is not of a suite's shape.
    """
    path = Path(path)
    try:
        text = path.read_bytes().decode()
        tables = tomllib.loads(text)
    except OSError as error:
        raise SuiteError(path, f"it cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SuiteError(path, f"it is not UTF-8 text: byte {error.start}") from error
    except tomllib.TOMLDecodeError as error:
        raise SuiteError(path, f"it is not TOML: {error}") from error
    if unknown := tables.keys() - {"defaults", "case"}:
        raise SuiteError(path, f"unknown {listed(sorted(unknown))}; {SHAPE}")
    defaults, cases = tables.get("defaults", {}), tables.get("case", {})
    every = [("defaults", defaults), ("case", cases)]
    if isinstance(cases, dict):
        every += [(f"case.{name}", case) for name, case in cases.items()]
    for name, table in every:
        if not isinstance(table, dict):
            raise SuiteError(path, f"{quoted(name)} is no table; {SHAPE}")
    if not cases:
        raise SuiteError(path, f"it has no cases; {SHAPE}")
    lines = text.splitlines()
    return Suite(
        path,
        defaults,
        tuple(
            Table(name, {**defaults, **case}, _line_of(name, lines)) for name, case in cases.items()
        ),
    )


def _line_of(name: str, lines: Iterable[str]) -> int:
    """Return where a case's table begins, from 1; 1 where it is written in another way."""
    header = re.compile(rf"\s*\[\s*case\s*\.\s*([\"']?){re.escape(name)}\1\s*\]")
    return next((k for k, line in enumerate(lines, 1) if header.match(line)), 1)
