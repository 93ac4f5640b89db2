"""The cases of ``quatprop check`` as pytest tests: ``pytest --quatprop-suite SUITE.toml``.

Each case is an item, so pytest's own ``-k``, ``-x``, ``--junit-xml`` and plugins apply. The command
updates references: ``quatprop check SUITE.toml --update``.
"""

from __future__ import annotations

from fnmatch import fnmatch
from typing import TYPE_CHECKING, Any

import pytest

from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from quatprop.check.case import Case, CaseNotRun
    from quatprop.check.lock import Pin

OPTION = "--quatprop-suite"


class RegressionFailure(Exception):  # noqa: N818  # its name is what pytest shows
    """A case that did not pass; its text is the reason."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.getgroup("quatprop").addoption(
        OPTION,
        action="append",
        default=[],
        metavar="SUITE.toml",
        help="Also collect the cases of a quatprop check suite; can be repeated.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Add the suites that pytest would not find to the paths that it collects.

    pytest 8 leaves out the rest of a folder of which a file is named too.
    """
    paths = [(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args]
    skipped = config.getini("norecursedirs")
    for suite in _suites(config):
        if not suite.is_file():
            raise pytest.UsageError(f"{OPTION}: {plain(suite)}: no such file; check the path")
        for path in paths:
            if suite.resolve().is_relative_to(path):
                folders = suite.resolve().relative_to(path).parts[:-1]
                if not any(fnmatch(folder, skip) for folder in folders for skip in skipped):
                    break
        else:
            config.args.append(str(suite))


def _suites(config: pytest.Config) -> list[Path]:
    """Return the suites, relative to the current folder, else to the one of the configuration."""
    current, root = config.invocation_params.dir, config.rootpath
    paths: list[str] = config.getoption(OPTION)
    return [current / path if (current / path).exists() else root / path for path in paths]


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> SuiteFile | None:
    """Collect the cases of a suite."""
    if file_path.resolve() not in {path.resolve() for path in _suites(parent.config)}:
        return None
    suite: SuiteFile = SuiteFile.from_parent(parent, path=file_path)
    return suite


class SuiteFile(pytest.File):
    """A suite."""

    def collect(self) -> Iterable[CaseItem]:
        """Return its cases."""
        from quatprop.check.cases import load_cases
        from quatprop.check.lock import read_lock
        from quatprop.errors import QuatpropError

        try:
            suite, cases = load_cases(self.path)
            pins = read_lock(suite.lock)
        except QuatpropError as error:
            raise self.CollectError(str(error)) from None
        for case in cases:
            yield CaseItem.from_parent(self, name=case.name, case=case, pin=pins.get(case.name))


class CaseItem(pytest.Item):
    """A case as a test."""

    def __init__(self, *, case: Case | CaseNotRun, pin: Pin | None, **options: Any) -> None:
        super().__init__(**options)
        self.case, self.pin = case, pin

    def runtest(self) -> None:
        """Judge the case."""
        from quatprop.check.runner import run_case

        result = run_case((self.case, self.pin))
        if result.verdict == "skip":
            pytest.skip(result.reason)
        if result.verdict == "xfail":
            pytest.xfail(result.reason)
        if result.verdict in {"fail", "error"}:
            raise RegressionFailure("; ".join(filter(None, [result.summary, result.reason])))
        notes = [text for text in (result.summary, result.reason, *result.notes) if text]
        self.add_report_section("call", "quatprop", "\n".join(notes))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return the reason; other errors are shown with their traceback."""
        if isinstance(excinfo.value, RegressionFailure):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return where the case is written."""
        return self.path, self.case.line - 1, f"case {self.name}"
