"""Words on stderr: the summary of a run, the progress of a long one."""

from __future__ import annotations

import math
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from quatprop.cli.spelling import spelled
from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

MAX_LOST = 20
"""Losses that are told one by one."""

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


def summary(report: dict[str, Any], *, verbose: bool) -> str:
    """Return what a run did in a few lines.

    Parameters
    ----------
    report
        The report of :func:`quatprop.pipeline.job.run`.
    verbose
        Also say conventions, policies and timings.
    """
    lines = [f"{name:<9} {value}" for name, value in _facts(report)]
    if verbose:
        lines += [f"{name:<9} {value}" for name, value in _conventions(report)]
    lines += [f"warning: {spelled(remark)}" for remark in report["remarks"]]
    return "\n".join(lines + lost(report["losses"]))


def lost(losses: list[dict[str, Any]]) -> list[str]:
    """Return a line for each thing that a damaged log has lost, or for the first of many."""
    shown = losses if len(losses) <= MAX_LOST else losses[:MAX_LOST]
    lines = [f"lost: {plain(loss['place'])}: {plain(loss['reason'])}" for loss in shown]
    if len(losses) > len(shown):
        more = len(losses) - len(shown)
        lines.append(f"lost: {more} more like these, which the JSON report lists")
    return lines


def _facts(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    source, counts, result = report["source"], report["counts"], report["result"]
    convention = report["convention"]
    named = " ".join(plain(source[key]) for key in ("name", "type") if source[key])
    yield "source", f"{plain(source['path'])} ({source['kind']}): {named}"
    yield "rate", f"{plain(source['rate'])} in {source['rate_unit']}, {source['clock']} clock"
    yield "samples", _samples(counts, result)
    yield "method", f"{convention['method']}, {convention['rates']} rates: {convention['side']}"
    conditioning = report["conditioning"]
    if conditioning["bias_rad_s"] is not None:
        yield "bias", _bias(conditioning)
    if convention["q0_from"] != "given":
        yield "q0", f"{_numbers(convention['q0_wxyz'])}, from {plain(convention['q0_from'])}"
    other = "start" if convention["method"] == "coning" else "coning"
    spread = math.degrees(result["method_sensitivity_rad"])
    yield "spread", f"{spread:.3g} deg: how far method {other} would end from here"
    yield "final", _numbers(result["final_wxyz"])
    rotation = (
        f"{math.degrees(result['net_rotation_rad']):.6g} deg from q0 to the end, "
        f"{math.degrees(result['path_angle_rad']):.6g} deg traversed in total, "
        f"at most {math.degrees(counts['max_rate']):.6g} deg/s"
    )
    yield "rotation", rotation


def _numbers(wxyz: list[float]) -> str:
    return "w {:+.9f}  x {:+.9f}  y {:+.9f}  z {:+.9f}".format(*wxyz)


def _bias(conditioning: dict[str, Any]) -> str:
    said = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*conditioning["bias_rad_s"])
    if (rest := conditioning["rest"]) is None:
        return said
    return (
        f"{said}, from {rest['samples']} samples of rest over "
        f"{duration_text(rest['last_ns'] - rest['first_ns'])} from t = {rest['first_ns']} ns, "
        f"scatter {rest['scatter_rad_s']:.3g} rad/s"
    )


def _samples(counts: dict[str, Any], result: dict[str, Any]) -> str:
    said = f"{result['samples']}"
    if counts["read"] != counts["used"]:
        said += f" of {counts['read']}"
    if result["span_s"]:
        span = result["last_ns"] - result["first_ns"]
        said += f" over {duration_text(span)}, {result['sample_rate_hz']:.6g} Hz"
    if result["rows"] != result["samples"]:
        said += f"; {result['rows']} attitudes written"
    return said


def _conventions(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    convention = report["convention"]
    for name in ("quaternion", "product", "attitude", "step", "layout", "q0_wxyz"):
        yield name, str(convention[name])
    for name, value in report["policy"].items():
        yield name, str(value)
    yield "seconds", f"{report['timings']['seconds']:.3f}"
