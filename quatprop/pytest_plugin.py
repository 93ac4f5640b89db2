"""Cases of ``quatprop check`` as tests of pytest: ``pytest --quatprop-suite SUITE.toml``.

Each case is an item, so pytest's own ``-k``, ``-x``, ``--junit-xml`` and plugins apply. References
are updated by the command, ``quatprop check SUITE.toml --update``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from quatprop.check.case import BrokenCase, Case
    from quatprop.check.lock import Pin

OPTION = "--quatprop-suite"


class RegressionFailure(Exception):  # noqa: N818  # its name is what pytest shows
    """A case that failed, or could not be judged; its words are the outcome's."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.getgroup("quatprop").addoption(
        OPTION,
        action="append",
        default=[],
        metavar="SUITE.toml",
        help="Collect the cases of a suite of quatprop check, too; can be repeated.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Let pytest look at the suites, beside what it was told to look at."""
    told = {(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args}
    config.args += [str(path) for path in _named(config) if path.resolve() not in told]


def _named(config: pytest.Config) -> list[Path]:
    """Return the suites: relative to where pytest was called, else to its configuration."""
    called, root = config.invocation_params.dir, config.rootpath
    paths: list[str] = config.getoption(OPTION)
    return [called / path if (called / path).exists() else root / path for path in paths]


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> SuiteFile | None:
    """Collect a suite that was named."""
    if file_path.resolve() not in {path.resolve() for path in _named(parent.config)}:
        return None
    suite: SuiteFile = SuiteFile.from_parent(parent, path=file_path)
    return suite


class SuiteFile(pytest.File):
    """A suite."""

    def collect(self) -> Iterable[CaseItem]:
        """Return its cases."""
        from quatprop.check.lock import read_lock
        from quatprop.cli.cases import load_cases
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

    def __init__(self, *, case: Case | BrokenCase, pin: Pin | None, **known: Any) -> None:
        super().__init__(**known)
        self.case, self.pin = case, pin

    def runtest(self) -> None:
        """Judge the case.

        Raises
        ------
        RegressionFailure
            It failed, or could not be judged.
        """
        from quatprop.check.judge import judge, settled

        outcome = settled(self.case, judge, self.pin)
        if outcome.verdict != "pass":
            raise RegressionFailure("; ".join(filter(None, [outcome.figure, outcome.reason])))
        self.add_report_section("call", "quatprop", "\n".join([outcome.figure, *outcome.notes]))

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Say why in words; what is no outcome is shown with its traceback."""
        if isinstance(excinfo.value, RegressionFailure):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Return where the case is written."""
        return self.path, self.case.line - 1, f"case {self.name}"
