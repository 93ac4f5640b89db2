"""What goes to stderr: the summary of a run, the progress of a long one."""

from __future__ import annotations

import math
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from quatprop.cli.spelling import spelled
from quatprop.provenance import as_json
from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from quatprop.conditioning.static_detection import Rest
    from quatprop.containers.base import Loss
    from quatprop.pipeline.report import RunReport

MAX_LOSSES = 20
"""Losses that are listed one by one."""

PROGRESS_EVERY_S = 0.2
"""How often the progress line changes; nothing shows before the first interval is over."""


@contextmanager
def progress(*, quiet: bool) -> Iterator[Callable[[int], None]]:
    """Give a function to call with the samples done so far; it shows them on a terminal only."""
    # Started without stderr, there is none.
    shows = sys.stderr is not None and sys.stderr.isatty() and not quiet
    shown = time.monotonic()

    def tick(samples: int) -> None:
        nonlocal shown
        if shows and time.monotonic() - shown > PROGRESS_EVERY_S:
            shown = time.monotonic()
            click.echo(f"\r{samples:,} samples", err=True, nl=False)

    try:
        yield tick
    finally:
        if shows:
            click.echo("\r\033[K", err=True, nl=False)


def summary(report: RunReport, *, verbose: bool) -> str:
    """Return what a run did in a few lines.

    Parameters
    ----------
    report
        The report of the run.
    verbose
        Also state conventions, policies and timings.
    """
    lines = [f"{name:<11} {value}" for name, value in _facts(report)]
    if verbose:
        lines += [f"{name:<11} {value}" for name, value in _conventions(report)]
    lines += [f"warning: {spelled(remark)}" for remark in report.remarks]
    return "\n".join(lines + loss_lines(report.losses))


def loss_lines(losses: Sequence[Loss]) -> list[str]:
    """Return a line for each loss in a damaged log, or for the first of many."""
    lines = [f"lost: {plain(loss.place)}: {plain(loss.reason)}" for loss in losses[:MAX_LOSSES]]
    if (more := len(losses) - len(lines)) > 0:
        lines.append(f"lost: {more} more, which the JSON report lists")
    return lines


def _facts(report: RunReport) -> Iterator[tuple[str, str]]:
    source, counts, result = report.source, report.counts, report.result
    convention = report.convention
    name = " ".join(plain(text) for text in (source.name, source.type) if text)
    yield "source", f"{plain(source.path)} ({source.kind}): {name}"
    yield "rate", f"{plain(source.rate)} in {source.rate_unit}, {source.clock} clock"
    yield "samples", _samples(report)
    yield "method", f"{convention.method}, {convention.rates} rates: {convention.side}"
    if (bias := report.conditioning.bias_rad_s) is not None:
        yield "bias", _bias(bias, report.conditioning.rest)
    if convention.q0_from != "given":
        yield "q0", f"{_numbers(convention.q0_wxyz)}, from {plain(convention.q0_from)}"
    other = "start" if convention.method == "coning" else "coning"
    if result.method_sensitivity_rad is not None:
        difference = f"{math.degrees(result.method_sensitivity_rad):.3g} deg"
        yield "sensitivity", f"{difference} between the final attitudes of this method and {other}"
    yield "final", _numbers(result.final_wxyz)
    rotation = (
        f"{math.degrees(result.net_rotation_rad):.6g} deg from q0 to the final attitude, "
        f"{math.degrees(result.path_angle_rad):.6g} deg traversed, "
        f"at most {math.degrees(counts.max_rate):.6g} deg/s"
    )
    yield "rotation", rotation


def _numbers(wxyz: Iterable[float]) -> str:
    return "w {:+.9f}  x {:+.9f}  y {:+.9f}  z {:+.9f}".format(*wxyz)


def _bias(bias_rad_s: Iterable[float], rest: Rest | None) -> str:
    bias = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*bias_rad_s)
    if rest is None:
        return bias
    return (
        f"{bias}, from {rest.samples} samples at rest over "
        f"{duration_text(rest.last_ns - rest.first_ns)} from t = {rest.first_ns} ns, "
        f"scatter {rest.scatter_rad_s:.3g} rad/s"
    )


def _samples(report: RunReport) -> str:
    counts, result = report.counts, report.result
    text = f"{result.samples}"
    if counts.read != counts.used:
        text += f" of {counts.read}"
    if result.span_s:
        text += f" over {duration_text(counts.span_ns)}, {result.sample_rate_hz:.6g} Hz"
    if result.rows != result.samples:
        text += f"; {result.rows} attitudes written"
    return text


def _conventions(report: RunReport) -> Iterator[tuple[str, str]]:
    convention = report.convention
    yield "quaternion", convention.quaternion
    yield "product", convention.product
    yield "attitude", convention.attitude
    yield "step", convention.step
    yield "layout", str(convention.layout)
    yield "q0_wxyz", str(as_json(convention.q0_wxyz))
    for name, value in as_json(report.policy).items():
        yield name, str(value)
    if report.seconds is not None:
        yield "seconds", f"{report.seconds:.3f}"
