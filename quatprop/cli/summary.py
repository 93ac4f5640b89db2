"""The summary of a run, which goes to stderr."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import click

from quatprop.cli.spelling import spelled
from quatprop.provenance import as_json
from quatprop.rendering import Row, degrees_text, lines_of, loss_lines, quaternion_text, source_text
from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.conditioning.static_detection import Rest
    from quatprop.pipeline.gyro_errors import UncertaintyReport
    from quatprop.pipeline.report import ResultReport, RunReport


INDENT = 12
"""Where the text of a summary begins."""


def show(lines: Iterable[str], indent: int = 2, *, err: bool = True) -> None:
    """Print lines; on a terminal those that are too long go on below their text.

    Parameters
    ----------
    lines
        The lines.
    indent
        Where the text begins.
    err
        Whether to stderr rather than stdout.
    """
    stream = sys.stderr if err else sys.stdout
    if stream is not None and stream.isatty():
        from shutil import get_terminal_size
        from textwrap import TextWrapper

        wrapper = TextWrapper(
            width=get_terminal_size().columns,
            subsequent_indent=" " * indent,
            break_long_words=False,
            break_on_hyphens=False,
        )
        lines = [wrapper.fill(line) for line in lines]
    click.echo("\n".join(lines), err=err)


def summary(report: RunReport, *, verbose: bool) -> list[str]:
    """Return what a run did in a few lines.

    Parameters
    ----------
    report
        The report of the run.
    verbose
        Also state conventions, policies and timings.
    """
    rows = [*_facts(report), *(_conventions(report) if verbose else ())]
    lines = lines_of(rows, width=INDENT - 1)
    lines += [f"warning: {spelled(remark)}" for remark in report.remarks]
    return lines + loss_lines(report.losses)


def _facts(report: RunReport) -> Iterator[Row]:
    source, counts, result = report.source, report.counts, report.result
    convention = report.convention
    name = source_text(source.name, source.type)
    yield "source", f"{plain(source.path)} ({source.kind}): {name}"
    yield "rate", f"{plain(source.rate)} in {source.rate_unit}, {source.clock} clock"
    yield "samples", _samples(report)
    why = ""
    if convention.method_from == "log":
        why = f" (the samples are {convention.samples} over the intervals before their stamps)"
    yield "method", f"{convention.method}{why}, {convention.rates} rates: {convention.side}"
    if (bias := report.conditioning.bias_rad_s) is not None:
        yield "bias", _bias(bias, report.conditioning.rest)
    if (series := report.conditioning.bias_series) is not None:
        origin = f"{plain(series.source)} ({plain(series.field)})"
        yield "bias", f"{series.values} values of {origin}, interpolated in time"
    if (matrix := report.conditioning.calibration) is not None:
        yield "calibration", "; ".join(" ".join(f"{x:.6g}" for x in row) for row in matrix)
    if (mount := report.conditioning.mount) is not None:
        yield "mount", _mount(mount, report.conditioning.mount_frames)
    if convention.q0_from not in {"given", "identity"}:
        yield "q0", f"{quaternion_text(convention.q0_wxyz)}, from {plain(convention.q0_from)}"
    if result.method_sensitivity_rad is not None:
        yield "sensitivity", _sensitivity(result)
    if report.uncertainty is not None:
        yield from _uncertainty(report.uncertainty)
    yield "final", quaternion_text(result.final_wxyz)
    rotation = (
        f"{degrees_text(result.net_rotation_rad)} from q0 to the final attitude, "
        f"{degrees_text(result.path_angle_rad)} traversed, "
        f"at most {degrees_text(counts.max_rate)}/s"
    )
    yield "rotation", rotation


def _sensitivity(result: ResultReport) -> str:
    # Rounding errors are no sensitivity.
    by_method, by_sampling = (
        degrees_text(round(angle or 0.0, 12), 3)
        for angle in (result.method_sensitivity_rad, result.sampling_sensitivity_rad)
    )
    return (
        f"the final attitude differs by {by_method} from method {result.next_method}, "
        f"by {by_sampling} from every second sample"
    )


ERRORS = {
    "noise_density": ("noise", "deg/sqrt(h)", 60 * 180 / math.pi),
    "bias_sigma": ("bias", "deg/h", 3600 * 180 / math.pi),
    "random_walk": ("random walk of the bias", "deg/h/sqrt(h)", 60 * 3600 * 180 / math.pi),
    "scale_sigma": ("scale factors", "ppm", 1e6),
}
"""What each error of a gyroscope is called, its usual unit, and how many of it one SI unit is."""


def _uncertainty(uncertainty: UncertaintyReport) -> Iterator[Row]:
    sigma = "x {:.3g}  y {:.3g}  z {:.3g} deg".format(*map(math.degrees, uncertainty.sigma_rad))
    share = f"{uncertainty.largest_share:.0%} of the variance by {ERRORS[uncertainty.largest][0]}"
    yield "1 sigma", f"{sigma} about the body axes of the final attitude, {share}"
    known = (
        f"{name} {getattr(uncertainty.errors, key) * factor:.3g} {unit} "
        f"({plain(uncertainty.origins[key])})"
        for key, (name, unit, factor) in ERRORS.items()
        if key in uncertainty.origins
    )
    yield "", f"from {', '.join(known)}"


def _bias(bias_rad_s: Iterable[float], rest: Rest | None) -> str:
    bias = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*bias_rad_s)
    if rest is None:
        return bias
    return (
        f"{bias}, from {rest.samples} samples at rest over "
        f"{duration_text(rest.last_ns - rest.first_ns)} from t = {rest.first_ns} ns, "
        f"scatter {rest.scatter_rad_s:.3g} rad/s; steady by {', '.join(rest.steady)}; "
        "the whole log was searched"
    )


def _mount(mount: Float64, frames: Sequence[str] | None) -> str:
    if frames is not None:
        return f"{plain(' -> '.join(frames))}, by the static transforms of the log"
    rows = "; ".join(" ".join(f"{x:.6g}" for x in row) for row in mount)
    return f"{rows} (matrix, sensor axes to body axes)"


def _samples(report: RunReport) -> str:
    counts, result = report.counts, report.result
    text = f"{result.samples}"
    if counts.read != counts.used:
        text += f" of {counts.read}"
    if result.span_s:
        text += f" over {duration_text(counts.span_ns)}, {result.sample_rate_hz:.6g} Hz"
    if result.rows != result.samples:
        text += f"; {result.rows} of them written"
    return text


def _conventions(report: RunReport) -> Iterator[Row]:
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
