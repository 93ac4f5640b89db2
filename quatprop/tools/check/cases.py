"""Parse the tables of a suite into cases.

The keys of a case are the settings of a propagation, of a comparison, and, with ``reference-``, of
reading the reference. The parsers of their values are those of the library and of the command line:
a new setting becomes a key without a change here.
"""

from __future__ import annotations

import datetime as dt
import os
import shlex
from typing import TYPE_CHECKING, Any, NoReturn

from quatprop.check.case import Case, CaseNotRun
from quatprop.check.suite import CaseTable, Suite, read_suite
from quatprop.comparison.settings import COMPARE, ERROR_LIMITS, comparison_settings
from quatprop.errors import QuatpropError, SuiteError, UsageError
from quatprop.logs.attitude_input import attitude_input
from quatprop.pipeline.settings import propagation_settings
from quatprop.settings import PROPAGATE
from quatprop.settings.reading import CHECKS, ONE_SERIES, READ_ATTITUDES
from quatprop.settings.rotations import file_beside
from quatprop.settings.spelling import in_keys, suite_key
from quatprop.text import did_you_mean, plain, quoted, spelling

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path


DEFAULT_TOLERANCE = "1e-9rad"
"""Tolerance for a stored reference, unless the case has its own."""

LIMITS = {name.replace("_", "-") for name in ERROR_LIMITS}
"""Keys of limits on the error; a case with an independent reference needs at least one."""

CRITERIA = LIMITS | {"drift-tol", "min-coverage"}
"""Keys of all limits."""

DEFAULT_COVERAGE = "99"
"""Percentage of the reference that the attitudes must cover if the log may change."""

PROPAGATION_KEYS = {suite_key(name): name for name in PROPAGATE}
# The time range and the rate of a case are those of the attitudes that are propagated.
COMPARISON_KEYS = {suite_key(name): name for name in COMPARE if name not in PROPAGATE}
REFERENCE_KEYS = {suite_key(name, "b"): name for name in (*ONE_SERIES, *CHECKS)}

PARSERS: Mapping[str, Callable[[object], Any]] = {
    **{key: PROPAGATE[name] for key, name in PROPAGATION_KEYS.items()},
    **{key: COMPARE[name] for key, name in COMPARISON_KEYS.items()},
    **{key: READ_ATTITUDES[name] for key, name in REFERENCE_KEYS.items()},
}
"""Key of a setting -> parser of its value."""

OWN_KEYS = {"log", "reference", "reference-log", "pin-log", "skip", "xfail"}
"""Keys of a case that are not settings."""


@spelling(in_keys)
def load_cases(path: Path | str) -> tuple[Suite, list[Case | CaseNotRun]]:
    """Read a suite and parse its cases."""
    suite = read_suite(path)
    for name, value in suite.defaults.items():
        _refuse_unknown(suite, name, value, None)
        if name in {"skip", "xfail"}:
            reason = "the reason belongs to one case, not to all; write it there"
            raise SuiteError(suite.path, reason, None, f"defaults.{name}")
    cases: list[Case | CaseNotRun] = []
    owners: dict[str, str] = {}
    for table in suite.tables:
        try:
            parser = _CaseParser(suite, table)
            if skip := parser.reason("skip"):
                cases.append(CaseNotRun(table.name, skip, "skip", table.line))
                continue
            case = parser.case()
            if case.reference is not None:
                owner = owners.setdefault(os.path.realpath(case.reference), case.name)
                if owner != case.name:
                    reason = f"case {quoted(owner)} has it already; give each case its own"
                    raise SuiteError(suite.path, reason, case.name, "reference")
            cases.append(case)
        except QuatpropError as error:
            cases.append(CaseNotRun(table.name, str(error), line=table.line))
    return suite, cases


def deleted_cases(cases: Iterable[Case | CaseNotRun], pinned: Iterable[str]) -> list[CaseNotRun]:
    """Return the cases that are in the lock, but not in the suite."""
    names = {case.name for case in cases}
    reason = "it is pinned, but not in the suite; restore it, or remove it from the lock with "
    return [
        CaseNotRun(name, f"{reason}--update -k {shlex.quote(plain(name))}", "deleted")
        for name in pinned
        if name not in names
    ]


def same_option(key: str, one: str | None, other: str | None) -> bool:
    """Return whether two texts mean the same value of a key, such as ``50`` and ``50.0``."""
    if one is None or other is None or one == other:
        return one == other
    try:
        return bool(PARSERS[key](one) == PARSERS[key](other))
    except UsageError:
        return False


def _refuse_unknown(suite: Suite, key: str, value: object, case: str | None) -> None:
    known = OWN_KEYS | PARSERS.keys()
    if case is not None and isinstance(value, dict):
        reason = f'a case has no tables; if its name has a dot, quote it: [case."{case}.{key}"]'
        raise SuiteError(suite.path, reason, case, key)
    if key not in known:
        keys = "a case has the options of propagate that determine the attitudes, and of compare"
        place = key if case is not None else f"defaults.{key}"
        hint = did_you_mean(key, sorted(known), keys)
        raise SuiteError(suite.path, f"no such key{hint}", case, place)


class _CaseParser:
    """Parses the table of a case."""

    def __init__(self, suite: Suite, table: CaseTable) -> None:
        self._suite, self._table, self._values = suite, table, table.values
        self._inputs: dict[str, str] = {}

    def case(self) -> Case:
        """Return the case."""
        values = self._values
        for key, value in values.items():
            _refuse_unknown(self._suite, key, value, self._table.name)
        pins_log = values.get("pin-log", True)
        if not isinstance(pins_log, bool):
            self._refuse("this is true or false", "pin-log")
        if "log" not in values:
            self._refuse('there is no log; name it with log = "PATH"')
        log = self._inputs["log"] = self._path("log")
        parsed, texts = self._settings(PROPAGATION_KEYS)
        reference = self._reference()
        reference_settings, reference_texts = self._settings(REFERENCE_KEYS)
        external = None
        if reference is None:
            path = self._path("reference-log") if "reference-log" in values else log
            if path != log:
                self._inputs["reference-log"] = path
            external = attitude_input(path, reference_settings, "b")
        try:
            propagation = propagation_settings(parsed)
        except UsageError as error:
            self._refuse(error.text)
        strict = pins_log and not {"time-offset", "match", "max-dt"} & values.keys()
        stored, defaults = reference is not None, {}
        if not strict and (stored or not pins_log):
            defaults["min-coverage"] = DEFAULT_COVERAGE
        if stored:
            defaults["tol"] = DEFAULT_TOLERANCE
        elif not LIMITS & values.keys():
            self._refuse('there is no tolerance; write tol = "0.5deg" or the like', "tol")
        compared, comparison_texts = self._settings(COMPARISON_KEYS, defaults)
        return Case(
            name=self._table.name,
            log=log,
            propagation=propagation,
            comparison=comparison_settings(**compared),
            reference=reference,
            external=external,
            options=_options(parsed, texts),
            comparison_options={**comparison_texts, **reference_texts},
            inputs=self._inputs,
            strict=strict,
            pins_log=pins_log,
            xfail=self.reason("xfail"),
            # A drift is in deg/h, so angles beside it are shown in degrees.
            in_degrees="drift-tol" in comparison_texts
            or any(comparison_texts.get(key, "").strip().endswith("deg") for key in LIMITS),
            suite=str(self._suite.path),
            line=self._table.line,
        )

    def reason(self, key: str) -> str:
        """Return the reason given for ``skip`` or ``xfail``; empty without that key."""
        if key not in self._values:
            return ""
        reason = self._values[key]
        if not isinstance(reason, str) or not reason.strip():
            self._refuse("write the reason as text", key)
        return reason

    def _reference(self) -> str | None:
        """Return the path of the stored reference; None for an independent series."""
        values = self._values
        others = sorted(key for key in values if key.startswith("reference-"))
        if "reference" not in values:
            if not {"reference-log", "reference-topic"} & values.keys():
                self._refuse(
                    "there is no reference; name the file that an update writes with reference = "
                    '"NAME.parquet", or an independent series with reference-log or reference-topic'
                )
            return None
        if others:
            reason = f"a stored reference cannot be combined with {quoted(others[0])}; omit one"
            self._refuse(reason, "reference")
        reference = self._path("reference")
        if not reference.lower().endswith((".parquet", ".pq")):
            reason = "a stored reference is a .parquet file; name an independent series as "
            self._refuse(f"{reason}reference-log", "reference")
        return reference

    def _path(self, key: str) -> str:
        value = self._values[key]
        if not isinstance(value, str) or not value or value == "-":
            self._refuse("this is not a path; write one as text, relative to the suite", key)
        return str(self._suite.path.parent / value)

    def _text(self, key: str, value: object) -> object:
        if isinstance(value, list):
            return ",".join(str(self._text(key, part)) for part in value)
        if isinstance(value, dt.datetime):
            return value.isoformat()
        if not isinstance(value, str | int | float):
            self._refuse("this takes text, a number or a list of them", key)
        return value if isinstance(value, bool) else str(value)

    def _settings(
        self, keys: Mapping[str, str], defaults: Mapping[str, str] | None = None
    ) -> tuple[dict[str, Any], dict[str, str]]:
        """Return the values of some keys by the name of their setting, and as text by their key.

        Numbers are parsed as text, as on the command line: 5 is not a duration.
        """
        own = {key: self._text(key, value) for key, value in self._values.items() if key in keys}
        texts, parsed = {**(defaults or {}), **own}, {}
        for key, text in texts.items():
            value = text
            if isinstance(text, str):
                path = file_beside(keys[key], text, self._suite.path.parent)
                if path is not None:
                    value = self._inputs[key] = str(path)
            try:
                parsed[keys[key]] = PARSERS[key](value)
            except UsageError as error:
                self._refuse(error.text, key)
        return parsed, {key: str(text) for key, text in texts.items()}

    def _refuse(self, reason: str, key: str | None = None) -> NoReturn:
        raise SuiteError(self._suite.path, reason, self._table.name, key)


def _options(parsed: Mapping[str, object], texts: Mapping[str, str]) -> dict[str, str]:
    """Return the settings that differ from the default, by key, as text."""
    settings = propagation_settings(parsed)

    def differs(name: str) -> bool:
        try:
            return propagation_settings({**parsed, name: None}) != settings
        except UsageError:
            return True

    return {key: text for key, text in sorted(texts.items()) if differs(PROPAGATION_KEYS[key])}
