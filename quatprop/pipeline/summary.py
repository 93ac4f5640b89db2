"""The report of a run in words, for the summary and the HTML page of a plot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from quatprop.rendering import (
    Row,
    count_text,
    degrees_text,
    quaternion_text,
    rate_text,
    source_text,
)
from quatprop.text import plain
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.conditioning import GyroCorrectionReport
    from quatprop.conditioning.static_period import StaticPeriod
    from quatprop.pipeline.gyro_errors import UncertaintyReport
    from quatprop.pipeline.report import ConventionReport, ResultReport, RunReport
    from quatprop.timeline.counts import SteadyClock


def facts(report: RunReport) -> Iterator[Row]:
    """Yield the source, the processing and the result, as labels and texts."""
    source, counts, result = report.source, report.counts, report.result
    convention = report.convention
    name = source_text(source.name, source.type)
    yield "source", f"{plain(source.path)} ({source.kind}): {name}"
    yield "rate", f"{plain(source.rate)} in {source.rate_unit}, {source.clock} clock"
    yield "samples", _samples(report)
    if report.policy.regular_time:
        yield "clock", _clock(counts.steady_clock)
    why = ""
    if convention.method_from == "log":
        why = f" (the samples are {convention.samples} over the intervals before their timestamps)"
    yield "method", f"{convention.method}{why}, {convention.rates} rates: {convention.side}"
    if (bias := report.conditioning.bias_rad_s) is not None:
        yield "bias", _bias(bias, report.conditioning.rest)
    if report.conditioning.rests:
        yield "bias", _bias_of_rests(report.conditioning)
    if (series := report.conditioning.bias_series) is not None:
        origin = f"{plain(series.source)} ({plain(series.field)})"
        yield "bias", f"{series.values} values of {origin}, interpolated in time"
    if (matrix := report.conditioning.calibration) is not None:
        yield "calibration", "; ".join(" ".join(f"{x:.6g}" for x in row) for row in matrix)
    if (mount := report.conditioning.mount) is not None:
        yield "mount", _mount(mount, report.conditioning.mount_frames)
    if convention.q0_from not in {"given", "identity"}:
        yield "q0", f"{quaternion_text(convention.q0_wxyz)}, from {plain(convention.q0_from)}"
    if (earth := convention.earth_rate_rad_s) is not None:
        rates = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*earth)
        yield (
            "earth rate",
            f"{rates} in reference axes, at {report.settings['earth_rate']}: taken off",
        )
    if result.method_sensitivity_rad is not None:
        yield "sensitivity", _sensitivity(result, convention)
    if report.uncertainty is not None:
        yield from _uncertainty(report.uncertainty)
    yield "final", quaternion_text(result.final_wxyz)
    rotation = (
        f"{degrees_text(result.net_rotation_rad)} from q0 to the final attitude, "
        f"{degrees_text(result.path_angle_rad)} traversed, "
        f"at most {degrees_text(counts.max_rate)}/s"
    )
    yield "rotation", rotation


def _clock(clock: SteadyClock | None) -> str:
    """Return the steady clock that replaced the timestamps."""
    if clock is None:
        return "the timestamps already follow a steady clock: used unchanged"
    text = (
        f"steady at {clock.rate_hz:.9g} Hz from t = {clock.offset_ns} ns, instead of timestamps "
        f"that scatter about it by {duration_text(round(clock.residual_rms_ns))} RMS and are at "
        f"most {duration_text(clock.residual_max_ns)} away"
    )
    if clock.missing:
        text += f"; {count_text(clock.missing, 'sample')} missing"
    return f"{text}; {count_text(clock.kept, 'timestamp')} kept" if clock.kept else text


def _sensitivity(result: ResultReport, convention: ConventionReport) -> str:
    # Rounding errors are not a sensitivity.
    by_method, by_sampling = (
        degrees_text(round(angle or 0.0, 12), 3)
        for angle in (result.method_sensitivity_rad, result.sampling_sensitivity_rad)
    )
    is_sum = convention.method == "end" and convention.samples != "rates"
    unless = " (no error if the sensor corrects for coning itself)" if is_sum else ""
    return (
        f"the final attitude differs by {by_method} from method {result.next_method}{unless}, "
        f"by {by_sampling} from the result with every second sample"
    )


ERRORS = {
    "noise_density": ("noise", "deg/sqrt(h)", 60 * 180 / math.pi),
    "bias_sigma": ("bias", "deg/h", 3600 * 180 / math.pi),
    "random_walk": ("random walk of the bias", "deg/h/sqrt(h)", 60 * 3600 * 180 / math.pi),
    "scale_sigma": ("scale factors", "ppm", 1e6),
    "misalignment_sigma": ("misalignments", "mrad", 1e3),
    "q0_sigma": ("q0", "deg", 180 / math.pi),
}
"""Name of each error of a gyroscope, its usual unit, and the factor from SI units to it."""


def _uncertainty(uncertainty: UncertaintyReport) -> Iterator[Row]:
    sigma = "x {:.3g}  y {:.3g}  z {:.3g} deg".format(*map(math.degrees, uncertainty.sigma_rad))
    sigma += " about the body axes of the final attitude"
    if share := uncertainty.largest_share:
        sigma += f", {share:.0%} of the variance by {ERRORS[uncertainty.largest][0]}"
    yield "1 sigma", sigma
    sizes = uncertainty.errors._asdict()
    if (q0 := uncertainty.q0_sigma_rad) is not None:
        sizes["q0_sigma"] = q0.max()
    known = (
        f"{name} {sizes[key] * factor:.3g} {unit} ({plain(uncertainty.origins[key])})"
        for key, (name, unit, factor) in ERRORS.items()
        if key in uncertainty.origins
    )
    yield "", f"from {', '.join(known)}"


def _bias(bias_rad_s: Iterable[float], rest: StaticPeriod | None) -> str:
    bias = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*bias_rad_s)
    if rest is None:
        return bias
    return (
        f"{bias}, from {rest.samples} samples {'at rest ' if rest.steady else ''}over "
        f"{duration_text(rest.last_ns - rest.first_ns)} from t = {rest.first_ns} ns, "
        f"scatter {rest.scatter_rad_s:.3g} rad/s; "
        + (
            f"steady by {', '.join(rest.steady)}; the whole log was searched"
            if rest.steady
            else "as given"
        )
    )


def _bias_of_rests(conditioning: GyroCorrectionReport) -> str:
    rests = conditioning.rests
    means = np.array([rest.mean_rad_s for rest in rests])
    ranges = "  ".join(
        f"{axis} {low:+.6g} to {high:+.6g}"
        for axis, low, high in zip("xyz", means.min(axis=0), means.max(axis=0), strict=True)
    )
    way = "interpolated between" if conditioning.interpolated else "of the nearest in time of"
    length = duration_text(sum(rest.last_ns - rest.first_ns for rest in rests))
    return (
        f"{way} {len(rests)} rests of {length} together, {ranges} rad/s; "
        f"steady by {', '.join(rests[0].steady)}; the whole log was searched"
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
        text += f" over {duration_text(counts.span_ns)}, "
        text += rate_text(counts.used, counts.span_ns, counts.median_dt_ns)
    if result.rows != result.samples:
        text += f"; {count_text(result.rows, 'attitude')} written"
    return text


def conventions(report: RunReport) -> Iterator[Row]:
    """Yield the conventions and the settings of a run, as labels and texts."""
    convention, policy, conditioning = report.convention, report.policy, report.conditioning
    for name in ("quaternion", "product", "attitude", "step", "layout"):
        yield name, str(getattr(convention, name))
    yield "q0", quaternion_text(convention.q0_wxyz)
    for name in ("on_backwards", "on_nonfinite", "on_gap"):
        yield name.replace("_", " "), getattr(policy, name)
    limit = policy.max_gap_ns
    yield "max gap", "10 median intervals" if limit is None else duration_text(limit)
    for name, t_ns in (("start", conditioning.start_ns), ("end", conditioning.end_ns)):
        if t_ns is not None:
            yield name, f"{t_ns} ns"
