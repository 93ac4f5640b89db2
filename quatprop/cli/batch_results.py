"""The results of a batch, as they come, and its totals."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import click

from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tqdm import tqdm

    from quatprop.batching.logs import BatchTask
    from quatprop.batching.planning import Plan
    from quatprop.batching.tasks import BatchResult, BatchSettings


class ShownResults:
    """Shows results as they arrive; keeps only totals, errors and requested reports."""

    def __init__(
        self,
        tasks: list[BatchTask],
        settings: BatchSettings,
        meter: tqdm[Any],
        *,
        quiet: bool,
        keeps: bool,
    ) -> None:
        self.states: Counter[str] = Counter()
        self.reports: dict[int, Any] = {}
        self._errors: list[str] = []
        self._samples = 0
        self._tasks, self._settings, self._quiet, self._keeps = tasks, settings, quiet, keeps
        self._count = len(tasks)
        self._width = max((len(plain(task.shown)) for task in tasks), default=0)
        self._meter = meter

    def add(self, index: int, result: BatchResult) -> None:
        """Show the result of a log; errors even if quiet."""
        self.states[result.entry.state] += 1
        self._samples += result.entry.samples or 0
        task = self._tasks[index]
        output = self._settings.file_of(task)
        if self._keeps:
            self.reports[index] = _report(task, output, result)
        if result.entry.state == "failed":
            self._errors.append(result.entry.error or "")
            self._say(f"Error: {self._errors[-1]}")
        elif not self._quiet and result.entry.span_s is not None:
            self._say(_line(task, output, result, self._width))
        self._meter.update()

    def _say(self, text: str) -> None:
        """Print lines above the progress bar."""
        self._meter.clear()
        click.echo(text, err=True)

    def finish(self, planned: Plan, ignored: Mapping[str, int], gone: int) -> None:
        """Show the errors again, and the totals."""
        if self._errors and self._count > 1:
            click.echo(f"{len(self._errors)} failed:", err=True)
            for error in self._errors:
                click.echo(f"  {error}", err=True)
        skipped, lost = planned.skipped, planned.lost
        before = f"; data was lost in {lost} of them" * bool(lost)
        what = f"{gone} log{'s are' if gone > 1 else ' is'} no longer there"
        before += f"; {what}, and noted as deleted" * bool(gone)
        if not self._count and skipped:
            what = "its output is" if skipped == 1 else f"all {skipped} outputs are"
            click.echo(f"nothing to do: {what} up to date{before}", err=True)
            return
        logs = self._count - self.states["no rates"]
        text = f"{logs - self.states['failed']} of {logs} logs done, {self._samples:,} samples"
        text += f"; {skipped} skipped, as their outputs are up to date" * bool(skipped) + before
        click.echo(f"{text}; {counted(ignored)}".removesuffix("; "), err=True)


def _line(task: BatchTask, output: str, result: BatchResult, width: int) -> str:
    """Return a line for a result, followed by its warnings and losses."""
    from quatprop.rendering import loss_lines
    from quatprop.stores.objects import without_secret
    from quatprop.times import duration_text

    span = duration_text(round((result.entry.span_s or 0) * 1e9))
    samples = f"{result.entry.samples:>12,} samples over {span:<10}"
    lines = [f"{plain(task.shown):<{width}}  {samples}  -> {plain(without_secret(output))}"]
    lines += [f"  warning: {remark}" for remark in result.entry.remarks]
    return "\n".join(lines + [f"  {line}" for line in loss_lines(result.losses)])


def _report(task: BatchTask, output: str, result: BatchResult) -> dict[str, object]:
    from quatprop.stores.objects import without_secret

    return {
        "log": task.shown,
        "output": without_secret(output),
        "error": result.entry.error,
        "seconds": result.entry.seconds,
        "report": result.report,
    }


def counted(counts: Mapping[str, int]) -> str:
    """Return a text with the numbers of ignored items."""
    words = []
    for name, count in counts.items():
        what, _, which = name.partition("|")
        words += [f"{count} {what}{'s' * (count > 1)}{' ' * bool(which)}{which}"] * bool(count)
    *others, last = words or [""]
    return f"ignored {', '.join(others)}{' and ' * bool(others)}{last}" if last else ""
