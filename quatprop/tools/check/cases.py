"""Parse the tables of a suite into cases.

The keys of a case are the settings of a propagation, of a comparison, and, with ``reference-``, of
reading the reference. The parsers of their values are those of the library and of the command line:
a new setting becomes a key without a change here.
"""

from __future__ import annotations

import datetime as dt
import json
import math
import os
import re
import shlex
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from quatprop.base.errors import ComparisonError, QuatpropError, SuiteError, UsageError
from quatprop.base.guarded_text import ContentError, read_bytes, read_toml
from quatprop.base.rendering import degrees_text
from quatprop.base.text import did_you_mean, listed, plain, quoted, spelling
from quatprop.base.times import duration_text
from quatprop.comparison.comparison import compare
from quatprop.comparison.result import with_names
from quatprop.propagation.attitude_input import AttitudeInput, attitude_input, load_attitudes
from quatprop.propagation.job import Job, run
from quatprop.propagation.settings import OutputSettings, propagation_settings
from quatprop.settings import PROPAGATE, in_keys, suite_key
from quatprop.settings.command_options import COMPARE, ERROR_LIMITS, comparison_settings
from quatprop.settings.parsers import resolve_path
from quatprop.settings.reading import CHECKS, ONE_SERIES, READ_ATTITUDES
from quatprop.stores.objects import split_topic, split_topics
from quatprop.tools.check.case import MEASURE, Case, CaseNotRun
from quatprop.tools.check.expect import Expectations, expectations
from quatprop.tools.check.lock import conflict_line
from quatprop.writers.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from quatprop.kinematics.series import AttitudeSeries


# Propose the limits of a case with an independent series, from the measured errors.


MARGIN = 1.5
"""Ratio of a proposed limit to the measured error."""

MAX_PROPOSED = math.radians(90.0)
"""Limit, rad, from which on nearly any attitude passes; none is proposed."""

MIN_FRAME_ANGLE = math.radians(2.0)
"""Angle between two frames, rad; a smaller one is taken for an error and not aligned."""

WINDOW_NS = 1_000_000_000
PARTS = 5
"""A window is a second, or in a short log a fifth of its length."""

LEAST_DEG = 1e-6
"""Smallest limit that is proposed, deg; smaller errors are rounding errors."""


def propose_limits(log: str, topic: str | None, reference: AttitudeInput) -> Iterator[str]:
    """Yield the alignment and the limits as lines of a case, with the reasons as comments."""
    with TemporaryDirectory(prefix="quatprop-") as folder:
        output = str(Path(folder, "attitude.parquet"))
        settings = propagation_settings({"topic": topic})
        run(Job(log, OutputSettings(output, to="parquet"), settings))
        a = load_attitudes(AttitudeInput(output, "parquet")).series
    b = load_attitudes(reference).series
    align, why = _alignment(a, b)
    yield f'align = "{align}"  # {why}'
    window_ns = min(WINDOW_NS, max(1, int(a.t_ns.max() - a.t_ns.min()) // PARTS))
    measure = replace(MEASURE, align=align, window=window_ns)
    try:
        result = compare(a, b, measure)
    except ComparisonError:  # in a log of bursts, no two samples may be a window apart
        result = compare(a, b, replace(measure, window=None))
    if MARGIN * result.error_rad.max >= MAX_PROPOSED:
        explained = compare(a, b, replace(measure, window=None, tol=0.0))
        cause = explained.likely_cause
        causes = [f"likely ({each.name}): {each.advice}" for each in cause.chain] if cause else []
        causes += map(str, explained.remarks)
        explanation = with_names("; ".join(causes), "the log", "the reference")
        raise ComparisonError(
            f"{plain(log)} differs from {plain(reference.path)} by up to "
            f"{degrees_text(result.error_rad.max, 3)}, so no limit would find a regression; "
            f"{explanation or 'they may be of two motions'}; correct this first, with the options "
            "of propagate and compare, or write the case and its limits yourself"
        )
    window, covered = duration_text(window_ns).replace(" ", ""), result.coverage
    for key, error, reason in (
        ("tol", result.error_rad.max, "the worst error, with all drift"),
        ("rms-tol", result.error_rad.rms, "what a single sample does not decide"),
    ):
        yield _limit(key, error, reason)
    if result.window is not None:
        yield f'window = "{window}"'
        reason = "the rotation over each window: delays, axes and scales, which drift hides above"
        yield _limit("window-rms-tol", result.window.rms_rad, reason)
    least = covered.least
    yield (
        f"min-coverage = {math.floor(least) - 1}  # {least:.4g} % of the reference "
        "series is compared"
    )


def _limit(key: str, error: float, reason: str) -> str:
    measured = math.degrees(error)
    wanted = max(MARGIN * measured, LEAST_DEG)
    step = 10.0 ** (math.floor(math.log10(wanted)) - 1)
    limit = f"{math.ceil(wanted / step) * step:.2g}"
    return f'{key} = "{limit}deg"  # {measured:.3g} deg is measured: {reason}'


def _alignment(a: AttitudeSeries, b: AttitudeSeries) -> tuple[str, str]:
    """Return the alignment for a rotation between the frames, and the reason for it."""
    # The mounting cannot be determined if the body turns about one axis only.
    with suppress(ComparisonError):
        angle = compare(a, b, replace(MEASURE, align="mount")).alignment.mount_rad
        if angle > MIN_FRAME_ANGLE:
            return "mount", f"the body frames are {math.degrees(angle):.3g} deg apart"
    angle = compare(a, b, replace(MEASURE, align="mean")).alignment.reference_rad
    if angle > MIN_FRAME_ANGLE:
        return "mean", f"the reference frames are {math.degrees(angle):.3g} deg apart"
    return "none", "both are relative to the same frames"


# Read and write suites: TOML with ``[defaults]`` and a table for each case.


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


def write_suite(path: Path | str, logs: Iterable[str], series: AttitudeInput | None = None) -> None:
    """Write a new suite with a case for each log; an update has to write the references.

    `logs`: ``LOG`` or ``LOG:TOPIC``
    `series`: an independent series, with which a second case compares each log
    """
    path = Path(path)
    if path.exists():
        raise SuiteError(path, "there is a suite already; add cases to it, or name another file")
    cases: dict[str, list[str]] = {}
    for named in logs:
        log, topic = split_topic(named)
        stem = Path(log).stem
        numbered = (f"{stem}-{number}" for number in count(2))
        name = next(name for name in chain([stem], numbered) if name not in cases)
        lines = [f"log = {_quoted(_relative(log, path))}"]
        if topic is not None:
            lines.append(f"topic = {_quoted(topic)}")
        cases[name] = [*lines, f"reference = {_quoted(f'refs/{name}.parquet')}"]
        if series is not None:
            truth = [f"reference-log = {_quoted(_relative(series.path, path))}"]
            if series.selection.topic is not None:
                truth.append(f"reference-topic = {_quoted(series.selection.topic)}")
            if series.drop:
                truth.append('on-invalid = "drop"')
            limits = propose_limits(log, topic, series)
            cases[f"{name}-truth"] = [*lines, *truth, *limits]
    text = "# Cases of quatprop check; the keys are options of propagate and compare.\n[defaults]\n"
    for name, lines in cases.items():
        text += "\n".join(["", f"[case.{_key(name)}]", *lines, ""])
    write_atomic(path, text)


def _relative(log: str, suite: Path) -> str:
    """Return the path of a log from the folder of its suite; absolute on another drive."""
    try:
        return Path(os.path.relpath(log, suite.parent)).as_posix()
    except ValueError:
        return Path(log).absolute().as_posix()


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _line_of(name: str, lines: Iterable[str]) -> int:
    """Return the line where the table of a case begins, from 1; 1 if its header is unusual."""
    header = re.compile(rf"\s*\[\s*case\s*\.\s*([\"']?){re.escape(name)}\1\s*\]")
    return next((k for k, line in enumerate(lines, 1) if header.match(line)), 1)


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

OWN_KEYS = {"log", "reference", "reference-log", "pin-log", "skip", "xfail", "expect"}
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
    if key == "expect" and isinstance(value, dict):
        return
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
        parsed, texts = self._settings(PROPAGATION_KEYS)
        logs, topic = self._log("log", values.get("topic"))
        self._inputs |= {f"log-{n}" if n > 1 else "log": path for n, path in enumerate(logs, 1)}
        if topic is not None:
            parsed["topic"] = texts["topic"] = topic
        expect = self._expectations()
        if expect is not None and expect.agree is not None and len(logs) > 1:
            self._refuse("'agree' compares the sources of one file; name one log", "expect")
        is_gate = expect is not None and not self._is_compared()
        reference = None if is_gate else self._reference()
        reference_settings, reference_texts = self._settings(REFERENCE_KEYS)
        external = None
        if reference is None and not is_gate:
            external = self._external(logs, reference_settings)
        try:
            propagation = propagation_settings(parsed)
        except UsageError as error:
            self._refuse(error.text)
        strict = pins_log and not {"time-offset", "match", "max-dt"} & values.keys()
        stored, defaults = reference is not None, {}
        if not strict and (stored or not pins_log) and not is_gate:
            defaults["min-coverage"] = DEFAULT_COVERAGE
        if stored:
            defaults["tol"] = DEFAULT_TOLERANCE
        elif not is_gate and not LIMITS & values.keys():
            self._refuse('there is no tolerance; write tol = "0.5deg" or the like', "tol")
        compared, comparison_texts = self._settings(COMPARISON_KEYS, defaults)
        return Case(
            name=self._table.name,
            log=logs[0],
            more=tuple(logs[1:]),
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
            # A drift is in deg/h, so angles next to it are shown in degrees.
            in_degrees="drift-tol" in comparison_texts
            or any(comparison_texts.get(key, "").strip().endswith("deg") for key in LIMITS),
            suite=str(self._suite.path),
            line=self._table.line,
            expect=expect,
        )

    def _expectations(self) -> Expectations | None:
        """Return what is expected of the log; None without that table."""
        table = self._values.get("expect")
        if table is None:
            return None
        if not isinstance(table, dict):
            self._refuse("this is a table: [case.NAME.expect]", "expect")
        try:
            return expectations(table)
        except UsageError as error:
            self._refuse(error.text)

    def _is_compared(self) -> bool:
        """Return whether the case has a reference, or limits of its own, which need one."""
        own = self._values.keys() - self._suite.defaults.keys()
        named = {"reference", "reference-log", "reference-topic"} & self._values.keys()
        return bool(named or CRITERIA & own)

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
        reference = self._path("reference", values["reference"])
        if not reference.lower().endswith((".parquet", ".pq")):
            reason = "a stored reference is a .parquet file; name an independent series as "
            self._refuse(f"{reason}reference-log", "reference")
        return reference

    def _external(self, logs: Sequence[str], settings: dict[str, Any]) -> AttitudeInput:
        """Return the independent series: of a file, or a topic of the log."""
        path, values = logs[0], self._values
        if "reference-log" in values:
            (path, *others), topic = self._log("reference-log", values.get("reference-topic"))
            if others:
                self._refuse("attitudes are read from one file; name one", "reference-log")
            settings["topic"] = topic
        elif len(logs) > 1:
            reason = "the log is in several files; name that of the attitudes with reference-log"
            self._refuse(reason, "reference-topic")
        if path not in logs:
            self._inputs["reference-log"] = path
        return attitude_input(path, settings, "b")

    def _path(self, key: str, value: object) -> str:
        if not isinstance(value, str) or not value or value == "-":
            self._refuse("this is not a path; write one as text, relative to the suite", key)
        return str(self._suite.path.parent / value)

    def _log(self, key: str, topic: object) -> tuple[list[str], str | None]:
        """Return the paths and the topic of a log, one ``LOG`` or ``LOG:TOPIC`` or a list."""
        value = self._values[key]
        several = value if isinstance(value, list) and value else [value]
        paths = [self._path(key, one) for one in several]
        try:
            return split_topics(paths, None if topic is None else str(topic))
        except UsageError as error:
            self._refuse(error.text, key)

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

        Numbers are parsed as text, as on the command line.
        """
        own = {key: self._text(key, value) for key, value in self._values.items() if key in keys}
        texts, parsed = {**(defaults or {}), **own}, {}
        for key, text in texts.items():
            value = text
            if isinstance(text, str):
                path = resolve_path(keys[key], text, self._suite.path.parent)
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
