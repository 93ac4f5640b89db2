"""The cases of ``quatprop check`` as pytest tests: ``pytest --quatprop-suite SUITE.toml``.

Each case is an item, so pytest's own ``-k``, ``-x``, ``--junit-xml`` and plugins apply. To update
references, use ``quatprop check SUITE.toml --update``.
"""

from __future__ import annotations

import json
from contextlib import suppress
from fnmatch import fnmatch
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pytest

from quatprop.base.text import plain, spelling

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable

    from quatprop.tools.check.case import Case, CaseNotRun, CaseResult
    from quatprop.tools.check.lock import Pin

OPTION = "--quatprop-suite"
STRICT = "--quatprop-strict"
ARTIFACTS = "--quatprop-artifacts"


class RegressionError(Exception):
    """A case does not pass, for the reason in the message."""


class ExpectedFailure(RegressionError):  # noqa: N818  # pytest shows the name
    """A case fails as expected."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("quatprop")
    group.addoption(
        OPTION,
        action="append",
        default=[],
        metavar="SUITE.toml",
        help="Also collect the cases of a quatprop check suite; can be repeated.",
    )
    group.addoption(
        STRICT,
        action="store_true",
        help="Also fail if a pinned case is no longer in its suite, if a case passes that is known "
        "to fail, or if a remark on a log is not pinned.",
    )
    group.addoption(
        ARTIFACTS,
        metavar="DIR",
        help="Keep the evidence of each case that fails in DIR/CASE, and an overview of all cases "
        "in DIR/index.html; of several suites, in a folder of DIR for each.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Add suites outside the collected paths to the arguments of pytest.

    Others are not added: pytest 8 would ignore the rest of their folder, and pytest 9 the argument.
    """
    config.addinivalue_line("markers", "quatprop: a case of a quatprop check suite.")
    if config.getoption(ARTIFACTS) and not hasattr(config, "workerinput"):
        config.pluginmanager.register(OverviewWriter(config), "quatprop-overviews")
    paths = _arguments(config)
    for suite in _suites(config):
        if not suite.is_file():
            raise pytest.UsageError(f"{OPTION}: {plain(suite)}: no such file; check the path")
        if not any(suite.resolve().is_relative_to(path) for path in paths):
            config.args.append(str(suite))


def _arguments(config: pytest.Config) -> list[Path]:
    """Return the paths that are collected, without links."""
    return [(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args]


@pytest.hookimpl(tryfirst=True)
def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Enter folders that pytest skips if a suite is in them, and collect nothing else there."""
    if not (suites := _suites(config)):
        return None
    path = collection_path.resolve()
    below = [path.relative_to(top).parts for top in _arguments(config) if path.is_relative_to(top)]
    folders = min(below, key=len, default=())[: None if path.is_dir() else -1]
    skipped = config.getini("norecursedirs")
    if not any(fnmatch(folder, skip) for folder in folders for skip in skipped):
        return None
    return not any(suite.resolve().is_relative_to(path) for suite in suites)


def _suites(config: pytest.Config) -> list[Path]:
    """Return the suites, relative to the current folder, else to the root folder of pytest."""
    current, root = config.invocation_params.dir, config.rootpath
    paths: list[str] = config.getoption(OPTION)
    return [current / path if (current / path).exists() else root / path for path in paths]


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> SuiteFile | None:
    """Collect the cases of a suite."""
    if file_path.resolve() not in {path.resolve() for path in _suites(parent.config)}:
        return None
    suite: SuiteFile = SuiteFile.from_parent(parent, path=file_path)
    return suite


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(
    session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
) -> Iterable[None]:
    """Add a failing item for each suite without cases; note suites with all cases deselected."""
    found = {item.path.resolve() for item in items if isinstance(item, CaseItem)}
    yield
    left = {item.path.resolve() for item in items if isinstance(item, CaseItem)}
    config.stash[DESELECTED] = sorted(map(str, found - left))
    if hasattr(config, "workeroutput"):
        config.workeroutput["quatprop"] = config.stash[DESELECTED]
    known = {*found, *config.stash.get(BROKEN, ())}
    # With --lf, suites without failures are not collected.
    suites = [] if config.getoption("lf", default=False) else _suites(config)
    # An item instead of an error, since workers of pytest-xdist must not raise; JUnit also has it.
    items += [_uncollected(session, suite) for suite in suites if suite.resolve() not in known]


def _uncollected(session: pytest.Session, suite: Path) -> Any:
    """Return a failing item in place of the cases of a suite."""
    from quatprop.tools.check.case import CaseNotRun

    reason = "none of its cases was collected; is it ignored by an option or a conftest.py?"
    case = CaseNotRun(suite.name, f"{OPTION}: {plain(suite)}: {reason}")
    file = SuiteFile.from_parent(session, path=suite)
    return CaseItem.from_parent(file, name=suite.name, case=case, pin=None)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Get the deselected suites from a worker of pytest-xdist."""
    node.config.stash[DESELECTED] = getattr(node, "workeroutput", {}).get("quatprop", [])


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    """List the suites with all cases deselected."""
    for suite in config.stash.get(DESELECTED, []):
        terminalreporter.write_line(f"quatprop: every case of {plain(suite)} was deselected")


def _artifacts(config: pytest.Config, suite: Path) -> Path:
    """Return the folder for the evidence of a suite, one for each suite if there are several."""
    folder, root = Path(config.getoption(ARTIFACTS)), config.rootpath.resolve()
    suite = suite.resolve()
    if {path.resolve() for path in _suites(config)} == {suite}:
        return folder
    name = suite.relative_to(root) if suite.is_relative_to(root) else suite
    return folder / quote(name.with_suffix("").as_posix(), safe="")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """Attach the result of a case to its report, as text, for other processes."""
    report = yield
    if isinstance(item, CaseItem) and (report.when == "call" or not report.passed):
        from quatprop.base.provenance import as_json

        shown = item.result or item.case
        fields = {name: getattr(shown, name) for name in SHOWN if hasattr(shown, name)}
        facts = {"name": item.name, "suite": item.path, "verdict": "error", **fields}
        report.quatprop = json.dumps(as_json(facts))
    return report


SHOWN = ("verdict", "reason", "summary", "error_rad", "notes", "trace", "evidence")
"""Fields of a result in an overview."""


class OverviewWriter:
    """Writes an overview of the cases of each suite, in the main process."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.results: dict[Path, dict[str, CaseResult]] = {}
        for suite in _suites(config):
            self.results[suite.resolve()] = {}
            with suppress(OSError):  # the overview of an earlier run
                (_artifacts(config, suite) / "index.html").unlink(missing_ok=True)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Store the result of a case, with the verdict of pytest."""
        from quatprop.base.guarded_text import read_json

        told = getattr(report, "quatprop", None)
        if told is None and not report.failed:
            return
        name = report.nodeid.partition("::")[2]
        fields = read_json(told) if told else {"name": name, "verdict": "error"}
        verdict = fields["verdict"]
        if report.failed and verdict not in {"fail", "error"}:
            verdict = "fail"
        elif report.skipped and verdict not in {"skip", "deleted", "xfail"}:
            verdict = "xfail" if hasattr(report, "wasxfail") else "skip"
        fields["reason"] = fields.get("reason") or report.longreprtext
        self._add(report.nodeid, {**fields, "verdict": verdict})

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Store the error of a suite that cannot be read."""
        if report.failed:
            name = Path(report.nodeid).name
            fields = {"name": name, "verdict": "error", "reason": report.longreprtext}
            self._add(report.nodeid, fields)

    def _add(self, nodeid: str, fields: Any) -> None:
        from quatprop.tools.check.case import CaseResult

        suite = fields.pop("suite", nodeid.partition("::")[0])
        results = self.results.get((self.config.rootpath / suite).resolve())
        if results is not None:
            results[fields["name"]] = CaseResult(**fields)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Write the overviews."""
        from quatprop.base.errors import QuatpropError
        from quatprop.tools.check.runner import write_overview

        for suite, results in self.results.items():
            folder = _artifacts(self.config, suite)
            try:
                write_overview(folder, suite, [*results.values()])
            except (OSError, QuatpropError) as error:
                reason = getattr(error, "strerror", None) or error
                line = f"quatprop: the overview in {folder} cannot be written: {reason}"
                terminalreporter.write_line(line)


DESELECTED = pytest.StashKey[list[str]]()
BROKEN = pytest.StashKey[set[Path]]()


class SuiteFile(pytest.File):
    """A suite."""

    def collect(self) -> Iterable[CaseItem]:
        """Return its cases, and deleted cases that are still in its lock."""
        from quatprop.base.errors import QuatpropError
        from quatprop.settings import in_keys
        from quatprop.tools.check.cases import deleted_cases, load_cases
        from quatprop.tools.check.lock import read_lock

        # Settings are spelled when errors are formatted.
        with spelling(in_keys):
            try:
                suite, cases = load_cases(self.path)
                pins = read_lock(suite.lock)
            except QuatpropError as error:
                self.config.stash.setdefault(BROKEN, set()).add(self.path.resolve())
                raise self.CollectError(str(error)) from None
        for case in [*cases, *deleted_cases(cases, pins)]:
            yield CaseItem.from_parent(self, name=case.name, case=case, pin=pins.get(case.name))


class CaseItem(pytest.Item):
    """A case as a test."""

    def __init__(self, *, case: Case | CaseNotRun, pin: Pin | None, **options: Any) -> None:
        super().__init__(**options)
        self.case, self.pin = case, pin
        self.strict: bool = self.config.getoption(STRICT)
        self.result: CaseResult | None = None
        self.add_marker("quatprop")
        if reason := getattr(case, "xfail", ""):
            self.add_marker(pytest.mark.xfail(reason=reason, raises=ExpectedFailure))
        verdict = getattr(case, "verdict", "")
        if verdict == "skip" or (verdict == "deleted" and not self.strict):
            # With a mark, pytest shows the line in the suite.
            self.add_marker(pytest.mark.skip(reason=getattr(case, "reason", "")))

    def runtest(self) -> None:
        """Run the case; an unexpected pass is reported by pytest."""
        from quatprop.tools.check.runner import CheckOptions, run_case

        place = self.config.getoption(ARTIFACTS) and _artifacts(self.config, self.path)
        options = CheckOptions(artifacts=place, strict=self.strict)
        self.result = result = run_case((self.case, self.pin), options)
        if result.verdict in {"fail", "error", "xfail"}:
            failure = ExpectedFailure if result.verdict == "xfail" else RegressionError
            raise failure("\n".join([result.reason, *_table(result)]))
        notes = [text for text in (result.summary, *result.notes) if text]
        self.add_report_section("call", "quatprop", "\n".join(notes))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return the reason; other errors have a traceback."""
        if isinstance(excinfo.value, RegressionError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return the position of the case in the suite."""
        return self.path, self.case.line - 1, f"case {self.name}"


def _table(result: CaseResult) -> list[str]:
    """Return a table of obtained and expected values, as lines."""
    from quatprop.base.rendering import aligned

    if not result.limits:
        return [result.summary] if result.summary else []
    rows = [("", "obtained", "expected"), *((x.label, x.value, x.limit) for x in result.limits)]
    return aligned(rows, len(rows[0]))
