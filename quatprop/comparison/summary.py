"""A comparison as rows of text, for the command line and the HTML page."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from quatprop.rendering import angle_text, count_text, degrees_text, loss_lines, source_text
from quatprop.text import plain, spelled
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.comparison.accumulator import ComparedSample
    from quatprop.comparison.association import Matching
    from quatprop.comparison.heading import ErrorParts
    from quatprop.comparison.result import Comparison, Criterion
    from quatprop.comparison.statistics import SigmaStatistics, WindowStatistics
    from quatprop.logs.attitude_input import ReadAttitudes
    from quatprop.rendering import Row

STATISTICS = {"rms": "RMS", "p95": "95 %"}
"""Labels of statistics that differ from their names."""


def comparison_rows(a: ReadAttitudes, b: ReadAttitudes, comparison: Comparison) -> Iterator[Row]:
    """Yield rows on what was compared, how, and the result."""
    first_ns = comparison.association.first_ns
    yield "A", _series(a)
    yield "B", _series(b)
    yield from _method(comparison)
    yield from _errors(comparison)
    yield "worst", _sample(comparison.worst, first_ns)
    if comparison.window:
        yield "window", _window(comparison.window, first_ns)
    if parts := comparison.parts:
        yield from _parts(parts)
    if sigmas := comparison.sigmas:
        yield "sigma", _sigmas(sigmas, first_ns)
    for criterion in comparison.criteria:
        yield "passed" if criterion.passed else "failed", criterion_text(criterion, comparison)
    if cause := comparison.likely_cause:
        for each in cause.chain:
            yield "cause", f"likely ({each.name}): {spelled(each.advice)}"
    yield from _remarks("A", a)
    yield from _remarks("B", b)
    for remark in comparison.remarks:
        yield "remark", spelled(remark)


def criterion_text(criterion: Criterion, comparison: Comparison) -> str:
    """Return the measured and the allowed value of a criterion."""
    label, value, limit = criterion.label, criterion.value, criterion.limit
    if criterion.unit == "sigma":
        return f"{label} {sigma_text(value)}, at most {limit:.6g} sigma"
    match criterion.setting:
        case "tol":
            tolerance = f"the tolerance {angle_text(limit)}"
            if comparison.first_exceeding is None:
                return f"no error above {tolerance}"
            first = _sample(comparison.first_exceeding, comparison.association.first_ns)
            return f"above {tolerance}, first at {first}"
        case "drift_tol":
            return f"{label} {value:+.6g} deg/h, at most {limit:.6g} deg/h"
        case "min_coverage":
            covered = comparison.coverage
            share = covered.samples
            samples = "" if share is None else f" and {share:.4g} % of the samples"
            of_a = (
                f" and {covered.time_of_a:.4g} % of the time of A" if value < covered.least else ""
            )
            shares = f"{covered.time:.4g} % of the time{samples} of B{of_a}"
            return f"{label} {shares}, at least {limit:.6g} %"
        case _:
            return f"{label} {angle_text(value)}, at most {angle_text(limit)}"


def sigma_text(count: float) -> str:
    """Return an error in standard deviations."""
    return f"{count:.3g} sigma" if math.isfinite(count) else "infinitely many sigma (sigma is 0)"


def with_names(sentence: str, a: str, b: str) -> str:
    """Return a sentence with A and B replaced by names, for readers who do not know A and B."""

    def named(found: re.Match[str]) -> str:
        name = a if found[1] == "A" else b
        return name + ("" if not found[2] else "'" if name.endswith("s") else "'s")

    return re.sub(r"\b([AB])\b('s)?", named, sentence)


def _series(operand: ReadAttitudes) -> str:
    source = operand.signal
    where = f"{plain(operand.input.path)} ({operand.kind})"
    span = duration_text(operand.last_ns - operand.first_ns)
    samples = f"{operand.samples} samples over {span}"
    layout = source.layout or source.representation
    meaning = f"{source.meaning.convention} {source.meaning.direction}, {layout}"
    return f"{where}: {source_text(source.name, source.type_name)}, {samples}; {meaning}"


def _method(comparison: Comparison) -> Iterator[Row]:
    offset, alignment = comparison.time_offset, comparison.alignment
    if comparison.outside:
        yield "range", f"{count_text(comparison.outside, 'attitude')} outside it omitted"
    matching = comparison.association
    span = duration_text(matching.last_ns - matching.first_ns)
    counts = f"{matching.matched} of {matching.candidates} samples over {span}"
    yield "matched", f"{counts}: {matching_text(matching)}"
    if part := comparison.judged:
        ranges = count_text(len(part.ranges_ns), "time range")
        yield "judged", f"{part.pairs} of them, in {ranges}"
    shifted = f"{duration_text(offset.added_to_b_ns)} added to B's timestamps"
    if found := offset.found:
        shifted += (
            f" +- {duration_text(round(found.std_ns))}, estimated from angular speeds: correlation "
            f"{found.correlation:.4f}, next best elsewhere {found.runner_up:.4f}"
        )
    if offset.added_to_b_ns or found:
        yield "offset", shifted
    rotated = f"{alignment.name}: reference frame rotated by {angle_text(alignment.reference_rad)}"
    if fit := alignment.mounting:
        yield "alignment", f"{rotated}, body frame by {angle_text(alignment.mount_rad)}"
        first, second, third = fit.singular_values
        turned = f"{degrees_text(fit.turn_rad, 3)} RMS"
        axes = f"1 : {second / first:.2g} : {third / first:.2g}"
        std = degrees_text(fit.std_rad, 2)
        yield "", f"from {fit.motions} rotations, {turned}; axes excited as {axes}; +- {std}"
    elif alignment.name != "none":
        yield "alignment", rotated


def matching_text(matching: Matching) -> str:
    """Return how attitudes were matched in time."""
    reach = duration_text(matching.max_dt_ns)
    other = "A" if matching.at == "B" else "B"
    method = {
        "exact": "equal timestamps",
        "nearest": f"{other} nearest to {matching.at} within {reach}, not interpolated",
        "interpolate": (
            f"{other} interpolated at the timestamps of {matching.at}, over at most {reach}"
        ),
    }
    if matching.rate_hz is not None:
        method["interpolate"] = f"interpolated at {matching.rate_hz:.9g} Hz, B over at most {reach}"
    return method[matching.match]


def _errors(comparison: Comparison) -> Iterator[Row]:
    yield "error", "geodesic angle"
    for name, error in comparison.error_rad._asdict().items():
        label = STATISTICS.get(name, name)
        yield f"  {label}", f"{error:14.6e} rad {math.degrees(error):14.6g} deg"
    if comparison.drift_deg_h is not None:
        # Rounding errors are not a drift.
        drift = round(comparison.drift_deg_h, 9) or 0.0
        yield "drift", f"{f'{drift:+.6g}' if drift else '0'} deg/h, slope of the error"


def _window(window: WindowStatistics, first_ns: int) -> str:
    return (
        f"{window.count} of {duration_text(window.window_ns)}: max {angle_text(window.max_rad)}, "
        f"RMS {angle_text(window.rms_rad)}; the worst begins at {window.worst_ns} ns, "
        f"{duration_text(window.worst_ns - first_ns)} after the first"
    )


def _parts(parts: ErrorParts) -> Iterator[Row]:
    for name, extent in parts._asdict().items():
        text = f"max {angle_text(extent.max)}, RMS {angle_text(extent.rms)}"
        yield "parts" if name == "heading" else "", f"{name.replace('_', ' ')}: {text}"


def _sigmas(sigmas: SigmaStatistics, first_ns: int) -> str:
    final, when = sigma_text(sigmas.final), f"at +{duration_text(sigmas.max_ns - first_ns)}"
    if math.isinf(sigmas.max):
        return f"the final error is {final}, the largest {sigma_text(sigmas.max)} {when}"
    return f"the final error is {final}, RMS {sigmas.rms:.3g}, at most {sigmas.max:.3g} {when}"


def _sample(sample: ComparedSample, first_ns: int) -> str:
    since = duration_text(sample.t_ns - first_ns)
    return (
        f"sample {sample.index} of {sample.at}, {sample.t_ns} ns, {since} after the first: "
        f"{angle_text(sample.error_rad)}"
    )


def _remarks(name: str, operand: ReadAttitudes) -> Iterator[Row]:
    for remark in operand.signal.remarks:
        yield "remark", f"{name}: {spelled(remark)}"
    if operand.counts.invalid:
        yield "lost", f"{count_text(operand.counts.invalid, 'invalid quaternion')} of {name}"
    for line in loss_lines(operand.losses):
        yield "", line
