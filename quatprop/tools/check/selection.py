"""Which cases of a suite a run is about, what it removes, and what it may write."""

from __future__ import annotations

from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base.errors import UsageError
from quatprop.base.places import is_address
from quatprop.base.rendering import count_text
from quatprop.base.text import listed, plain, quoted
from quatprop.tools.check.case import Case
from quatprop.tools.check.cases import Suite, deleted_cases, load_cases, write_suite
from quatprop.tools.check.changes import orphaned_references
from quatprop.tools.check.judge import Baseline, find_orphans
from quatprop.tools.check.lock import Pin, read_lock
from quatprop.writers.targets import checked_place, refuse_outside, refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from quatprop.propagation.attitude_input import AttitudeInput
    from quatprop.tools.check.case import CaseNotRun


class Wanted(NamedTuple):
    """The request for a run.

    `patterns`: names of cases, parts of names, or patterns; empty for all cases
    `updating`: whether references are written, also those of a new suite
    `force`, `dry_run`: of an update
    """

    patterns: Sequence[str] = ()
    updating: bool = False
    force: bool = False
    dry_run: bool = False


class Selection(NamedTuple):
    """The cases that a run is about.

    `all_cases`: every case of the suite; `cases`: those that are selected, and deleted ones
    `pins`: the lock
    `removed`: the pins that an update removes; `orphans`: references that belong to no case
    """

    suite: Suite
    all_cases: Sequence[Case | CaseNotRun]
    cases: Sequence[Case | CaseNotRun]
    pins: Mapping[str, Pin]
    removed: Mapping[str, Pin]
    orphans: Sequence[Baseline]

    def refuse_targets(self, junit: str | None, *, updating: bool) -> None:
        """Refuse to replace an input of a case or another output, and a lock outside its folder."""
        valid = [case for case in self.all_cases if isinstance(case, Case)]
        inputs = [path for case in valid for path in case.inputs.values()]
        outputs = [str(self.suite.lock), *(case.reference for case in valid), junit]
        refuse_overlap([str(self.suite.path), *inputs], outputs)
        if junit is not None and not is_address(junit):
            checked_place(junit)
        if updating:
            refuse_outside(self.suite.lock, self.suite.lock.parent)

    def removal_lines(self, *, written: bool) -> Iterator[str]:
        """Yield the cases that an update removes from the lock, and references without a case."""
        done = "removed" if written else "would be removed"
        for name, pin in self.removed.items():
            final = ", ".join(f"{angle} {size:g}" for angle, size in pin.final_deg.items())
            pinned = f"{count_text(pin.samples, 'sample')}, total angle {pin.total_angle_deg:g} deg"
            yield f"{done} from the lock: {quoted(name)}, pinned with {pinned}, final {final} deg"
        if not written:
            yield "nothing was written, because of --dry-run"
            return
        folder, gone = self.suite.path.parent, self.removed.values()
        for path in orphaned_references(folder, self.all_cases, gone):
            yield f"no longer used, to be removed: {plain(path)}"


def select_cases(path: str, wanted: Wanted) -> Selection:
    """Read a suite and its lock, and select cases."""
    suite, all_cases = load_cases(path)
    pins = read_lock(suite.lock, anew=wanted.updating)
    cases = _selected([*all_cases, *deleted_cases(all_cases, pins)], wanted, path)
    removed: Mapping[str, Pin] = {}
    orphans: list[Baseline] = []
    if wanted.updating:
        removed = _removed(cases, pins, wanted)
        orphans = [*find_orphans(suite.path, all_cases, pins)]
        cases = [case for case in cases if not _is_deleted(case)]
    return Selection(suite, all_cases, cases, pins, removed, orphans)


def _is_deleted(case: Case | CaseNotRun) -> bool:
    """Return whether a case is pinned, but no longer in the suite."""
    return getattr(case, "verdict", "") == "deleted"


def _selected(
    cases: Sequence[Case | CaseNotRun], wanted: Wanted, suite: str
) -> Sequence[Case | CaseNotRun]:
    """Return the cases whose names match a pattern; all cases without patterns."""
    names = {case.name for case in cases}

    def matches(name: str, pattern: str) -> bool:
        if pattern in names:
            return name == pattern
        return fnmatchcase(name, pattern) if set(pattern) & set("*?[") else pattern in name

    for pattern in wanted.patterns:
        found = [case for case in cases if matches(case.name, pattern)]
        # A deleted case is not judged; it can only be removed, by its full name.
        if all(map(_is_deleted, found)) and not (wanted.updating and pattern in names):
            gone = ": what matches is pinned, but not in the suite" if found else ""
            raise UsageError(f"no case of {suite} matches -k {pattern}{gone}")
    return [
        case for case in cases if any(matches(case.name, one) for one in wanted.patterns or [""])
    ]


def _removed(
    cases: Sequence[Case | CaseNotRun], pins: Mapping[str, Pin], wanted: Wanted
) -> dict[str, Pin]:
    """Return the pins that an update removes: of deleted cases that are named or forced."""
    gone = [case.name for case in cases if _is_deleted(case)]
    names = [name for name in gone if not wanted.patterns or name in wanted.patterns]
    if names and not (wanted.patterns or wanted.force or wanted.dry_run):
        raise UsageError(
            f"the lock pins {listed(names)}, which the suite no longer has; restore what was "
            f"deleted or renamed, or see with --dry-run what was pinned, and remove it with "
            f"--update -k NAME, or all of them with --update --force"
        )
    return {name: pins[name] for name in names}


@contextmanager
def new_suite(
    path: str, logs: Iterable[str], series: AttitudeInput | None = None
) -> Iterator[None]:
    """Write a new suite, and remove it again, with its lock, if no case gets a reference.

    `logs`, `series`: as for :func:`quatprop.tools.check.cases.write_suite`
    """
    write_suite(path, logs, series)
    try:
        yield
    finally:
        lock = Path(path).with_suffix(".lock.json")
        if not read_lock(lock):
            Path(path).unlink()
            lock.unlink(missing_ok=True)
