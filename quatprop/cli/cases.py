"""Cases of a suite, their keys parsed as the options of ``propagate`` and ``compare`` they are.

The keys of a case are the long names of those commands' options, and click parses their values:
there is one table of options, so names, values and the words of errors are the same everywhere.
"""

from __future__ import annotations

import datetime as dt
import os
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import click

from quatprop.check.case import BrokenCase, Case
from quatprop.check.spelling import sentence
from quatprop.check.suite import read_suite
from quatprop.cli import compare, propagate
from quatprop.cli.types import ANGLE
from quatprop.errors import QuatpropError, SuiteError, UsageError
from quatprop.pipeline.settings import propagation_settings
from quatprop.settings import PROPAGATE as SETTINGS
from quatprop.text import quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from quatprop.check.suite import CaseTable, Suite

OUTPUT_ONLY = {
    "output", "to", "layout", "header-comment", "message", "out-topic", "frames", "into",
    "report", "quiet", "verbose", "plot", "json",
}  # fmt: skip
"""Options of the two commands that are about what they write or say: no keys of a case."""

DEFAULT_TOLERANCE = "1e-9rad"
"""What passes against a stored reference, where the case does not say."""

WORDS = {"level", "log"}
"""Values of ``q0`` that name no file."""


def _options(command: click.Command) -> dict[str, click.Option]:
    """Return key -> option, for the options of a command that can be keys of a case."""
    named = {
        name.removeprefix("--"): option
        for option in command.params
        if isinstance(option, click.Option)
        for name in option.opts
        if name.startswith("--")
    }
    return {key: option for key, option in named.items() if key not in OUTPUT_ONLY}


PROPAGATE = _options(propagate.command)
COMPARE = {
    f"reference-{key.removesuffix('-b')}" if key.endswith("-b") else key: option
    for key, option in _options(compare.command).items()
    if not key.endswith("-a")
}
"""Key -> option of ``compare``; those of its B begin with ``reference-``."""

PIN_LOG = "pin-log"
"""Key of a case whose log is made anew each time, where it is false."""

KEYS = {"log", "reference", "reference-log", PIN_LOG, *PROPAGATE, *COMPARE}


def load_cases(path: Path | str) -> tuple[Suite, list[Case | BrokenCase]]:
    """Read a suite and parse its cases.

    Returns
    -------
    Suite
        As it is written.
    list
        Its cases, in their order; one that cannot be used leaves the others as they are.

    Raises
    ------
    SuiteError
        The suite is not one, or its defaults cannot be used.
    """
    suite = read_suite(path)
    for key in suite.defaults:
        _refuse_unknown(suite, key, None)
    cases: list[Case | BrokenCase] = []
    stored: dict[str, str] = {}
    for table in suite.tables:
        try:
            case = _Parser(suite, table).case()
            if case.reference is not None:
                place = os.path.realpath(case.reference)
                if (other := stored.setdefault(place, case.name)) != case.name:
                    reason = f"case {quoted(other)} has it already; give each case its own"
                    raise SuiteError(suite.path, reason, case.name, "reference")
            cases.append(case)
        except QuatpropError as error:
            cases.append(BrokenCase(table.name, sentence(error), table.line))
    return suite, cases


def _refuse_unknown(suite: Suite, key: str, case: str | None) -> None:
    if key in KEYS:
        return
    place = key if case is not None else f"defaults.{key}"
    if key in OUTPUT_ONLY:
        raise SuiteError(suite.path, "a case writes no such output; leave it out", case, place)
    near = get_close_matches(key, sorted(KEYS), 1)
    way_out = f"did you mean {quoted(near[0])}?" if near else "see quatprop propagate --help"
    raise SuiteError(suite.path, f"no such key; {way_out}", case, place)


def _matters(name: str, values: Mapping[str, object]) -> bool:
    """Return whether a setting is something else than its default."""
    given = {key: value for key, value in values.items() if key in SETTINGS}
    try:
        return propagation_settings(given) != propagation_settings({**given, name: None})
    except UsageError:
        return True


class _Parser:
    """Makes a case of its table."""

    def __init__(self, suite: Suite, table: CaseTable) -> None:
        self.suite, self.table = suite, table
        self.folder = suite.path.parent
        self.inputs: dict[str, str] = {}

    def case(self) -> Case:
        """Return the case.

        Raises
        ------
        SuiteError
            A key or a value cannot be used, or something is missing.
        """
        values = self.table.values
        for key in values:
            _refuse_unknown(self.suite, key, self.table.name)
        if not isinstance(values.get(PIN_LOG, True), bool):
            raise self._error("this is true or false", PIN_LOG)
        log = self._path("log", required=True)
        self.inputs["log"] = log
        job_context = self._parsed(propagate.command, PROPAGATE, ["--output=-", "--", log])
        with job_context:
            chosen = dict(job_context.params)
            del chosen["quiet"], chosen["verbose"]
            try:
                job = propagate.job_of(chosen)
            except UsageError as error:
                raise self._error(sentence(error)) from error
        reference = self._reference()
        external = reference is None
        against = self._path("reference-log") if "reference-log" in values else log
        if external and against != log:
            self.inputs["reference-log"] = against
        chosen = dict(self._parsed(compare.command, COMPARE, ["--", "A", "B"]).params)
        external_input = compare.input_of(against, "b", chosen)
        return Case(
            name=self.table.name,
            job=job,
            settings=compare.settings_of(self._with_tolerance(chosen, external=external)),
            reference=reference,
            external=external_input if external else None,
            options=self._said(job_context),
            inputs=self.inputs,
            strict=not {"time-offset", "match", "max-dt"} & values.keys(),
            pins_log=bool(values.get(PIN_LOG, True)),
            in_degrees=str(values.get("tol", "")).strip().endswith("deg"),
            line=self.table.line,
        )

    def _reference(self) -> str | None:
        """Return where the stored reference is; None where the case names a series."""
        values = self.table.values
        elsewhere = sorted(key for key in values if key.startswith("reference-"))
        if "reference" in values:
            if elsewhere:
                reason = f"a stored reference goes without {quoted(elsewhere[0])}; leave one out"
                raise self._error(reason, "reference")
            reference = self._path("reference")
            if not reference.lower().endswith((".parquet", ".pq")):
                reason = (
                    "a stored reference is Parquet, .parquet; a series from elsewhere is "
                    "reference-log"
                )
                raise self._error(reason, "reference")
            return reference
        if not {"reference-log", "reference-topic"} & values.keys():
            raise self._error(
                'nothing to hold it against; say reference = "NAME.parquet", which --update '
                "writes, or reference-topic or reference-log"
            )
        return None

    def _with_tolerance(self, chosen: dict[str, Any], *, external: bool) -> dict[str, Any]:
        if chosen["tol"] is None:
            if external:
                raise self._error('no tolerance; say tol = "0.5deg" or the like', "tol")
            chosen["tol"] = ANGLE.convert(DEFAULT_TOLERANCE, None, None)
        return chosen

    def _path(self, key: str, *, required: bool = False) -> str:
        value = self.table.values.get(key)
        if value is None and required:
            raise self._error(f'there is no {key}; say {key} = "PATH"')
        if not isinstance(value, str) or not value or value == "-":
            raise self._error("this is no path; write one as text, relative to the suite", key)
        return str(self.folder / value)

    def _parsed(
        self, command: click.Command, options: Mapping[str, click.Option], end: list[str]
    ) -> click.Context:
        """Let click parse the keys of a command, and say its errors as ours."""
        arguments = []
        for key, value in self.table.values.items():
            if key in options:
                arguments += self._argument(key, value, options[key])
        try:
            return command.make_context(command.name, arguments + end)
        except click.BadParameter as error:
            keys = [key for key, option in options.items() if option is error.param]
            raise self._error(error.message, *keys) from error
        except click.UsageError as error:
            raise self._error(error.message) from error

    def _argument(self, key: str, value: Any, option: click.Option) -> list[str]:
        """Return a key and its value as they would stand on the command line."""
        name = next(name for name in option.opts if name.startswith("--"))
        if option.is_flag:
            if not isinstance(value, bool):
                raise self._error("this is true or false", key)
            return [name] if value else []
        text = self._text(key, value)
        if option.name in {"q0", "at"}:
            place = self.folder / text
            if text not in WORDS and ("," not in text or place.exists()):
                text = self.inputs[key] = str(place)
        return [f"{name}={text}"]

    def _text(self, key: str, value: Any) -> str:
        """Return a value of TOML as it is written on the command line."""
        match value:
            case str():
                return value
            case bool():
                raise self._error("this takes a value, not true or false", key)
            case int() | float():
                return str(value)
            case dt.datetime():
                return value.isoformat()
            case list():
                return ",".join(self._text(key, part) for part in value)
            case _:
                raise self._error("this takes text, a number or a list of them", key)

    def _said(self, context: click.Context) -> dict[str, str]:
        """Return what the case says of the propagation, without what is the default."""
        return {
            key: self._text(key, value) if not isinstance(value, bool) else str(value).lower()
            for key, value in sorted(self.table.values.items())
            if (option := PROPAGATE.get(key)) is not None
            and _matters(str(option.name), context.params)
        }

    def _error(self, reason: str, key: str | None = None) -> SuiteError:
        return SuiteError(self.suite.path, reason, self.table.name, key)
