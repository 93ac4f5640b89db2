"""Read and write suites: TOML with ``[defaults]`` and a table for each case."""

from __future__ import annotations

import json
import os
import re
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.check.lock import conflict_line
from quatprop.check.proposal import propose_limits
from quatprop.errors import SuiteError
from quatprop.settings.guarded_text import ContentError, read_bytes, read_toml
from quatprop.text import listed, quoted
from quatprop.writers.atomic import open_atomic

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

SHAPE = "a suite has a table [defaults] and one table [case.NAME] for each case"


class CaseTable(NamedTuple):
    """The table of a case.

    `values`: key -> TOML value, with the defaults
    `line`: line of the suite where its table begins, from 1
    """

    name: str
    values: Mapping[str, object]
    line: int


class Suite(NamedTuple):
    """A suite of cases.

    `path`: the file, as the user named it
    `defaults`: values of the keys that a case does not have
    `tables`: the cases, in the order of the file
    """

    path: Path
    defaults: Mapping[str, object]
    tables: tuple[CaseTable, ...]

    @property
    def lock(self) -> Path:
        """Path of the lock."""
        return self.path.with_suffix(".lock.json")


def read_suite(path: Path | str) -> Suite:
    """Read a suite; its keys are checked when its cases are parsed."""
    path = Path(path)
    text = b""
    try:
        text = read_bytes(path)
        tables = read_toml(text)
    except ContentError as error:
        reason = str(error)
        if line := conflict_line(text):
            reason = f"line {line} is a conflict marker of a merge; keep one side, or both"
        raise SuiteError(path, reason) from error
    if unknown := tables.keys() - {"defaults", "case"}:
        raise SuiteError(path, f"unknown {listed(sorted(unknown))}; {SHAPE}")
    defaults, cases = tables.get("defaults", {}), tables.get("case", {})
    named = [("defaults", defaults), ("case", cases)]
    if isinstance(cases, dict):
        named += [(f"case.{name}", case) for name, case in cases.items()]
    for name, table in named:
        if not isinstance(table, dict):
            raise SuiteError(path, f"{quoted(name)} is not a table; {SHAPE}")
    if not cases:
        raise SuiteError(path, f"it has no cases; {SHAPE}")
    lines = text.decode("utf-8-sig").splitlines()
    case_tables = (
        CaseTable(name, {**defaults, **case}, _line_of(name, lines)) for name, case in cases.items()
    )
    return Suite(path, defaults, tuple(case_tables))


def write_suite(path: Path | str, logs: Iterable[str], series: str | None = None) -> None:
    """Write a new suite with a case for each log; an update has to write the references.

    `series`: an independent series, with which a second case compares each log
    """
    path = Path(path)
    if path.exists():
        raise SuiteError(path, "there is a suite already; add cases to it, or name another file")
    names: dict[str, str] = {}
    proposed: dict[str, list[str]] = {}
    for log in logs:
        stem = Path(log).stem
        numbered = (f"{stem}-{number}" for number in count(2))
        name = next(name for name in chain([stem], numbered) if name not in names)
        names[name] = log
        if series is not None:
            proposed[name] = [*propose_limits(log, series)]
    text = "# Cases of quatprop check; the keys are options of propagate and compare.\n[defaults]\n"
    for name, log in names.items():
        relative = _quoted(Path(os.path.relpath(log, path.parent)).as_posix())
        reference = _quoted(f"refs/{name}.parquet")
        text += f"\n[case.{_key(name)}]\nlog = {relative}\nreference = {reference}\n"
        if series is not None:
            truth = _quoted(Path(os.path.relpath(series, path.parent)).as_posix())
            text += f"\n[case.{_key(f'{name}-truth')}]\nlog = {relative}\nreference-log = {truth}\n"
            text += "".join(f"{line}\n" for line in proposed[name])
    with open_atomic(path) as stream:
        stream.write(text.encode())


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _line_of(name: str, lines: Iterable[str]) -> int:
    """Return the line where the table of a case begins, from 1; 1 if its header is unusual."""
    header = re.compile(rf"\s*\[\s*case\s*\.\s*([\"']?){re.escape(name)}\1\s*\]")
    return next((k for k, line in enumerate(lines, 1) if header.match(line)), 1)
