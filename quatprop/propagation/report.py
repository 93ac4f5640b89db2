"""The report of a run, for the summary, the JSON report and the metadata of outputs."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from quatprop.base import __version__
from quatprop.base.places import is_address, without_secret
from quatprop.base.provenance import Digest, JsonObject, as_json, digest_of
from quatprop.base.rendering import (
    Row,
    count_text,
    degrees_text,
    quaternion_text,
    rate_text,
    source_text,
)
from quatprop.base.text import plain
from quatprop.base.times import duration_text
from quatprop.kinematics.conventions import euler_angles
from quatprop.kinematics.series import MethodSensitivity
from quatprop.settings.quantities import LOOK_AHEAD, METHODS
from quatprop.stores.objects import digest_of_object
from quatprop.writers.atomic import OutputFile
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.base.arrays import Float64
    from quatprop.base.errors import Loss
    from quatprop.base.text import Remark
    from quatprop.propagation.conditioning.corrections import GyroCorrectionReport
    from quatprop.propagation.conditioning.static_period import StaticPeriod
    from quatprop.propagation.gyro_errors import UncertaintyReport
    from quatprop.readers.tables.model import Log
    from quatprop.timeline.counts import Counts, Policy, SteadyClock


CONVENTION = {
    "product": "Hamilton, ij = k",
    "attitude": "body to reference: v_ref = q v_body q*",
    "body": "rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
    "inertial": "rates resolved in the reference frame; q[k+1] = dq[k] * q[k]",
    "step": "dq = cos(|w| dt / 2) + w/|w| sin(|w| dt / 2)",
}
"""The convention in every output."""


class SourceReport(NamedTuple):
    """Where the samples came from.

    `path`: the log
    `kind`: its format
    `digest`: its size and SHA-256
    `name`: topic, or rate columns
    `type`: message type, or dialect of the table
    `rate`: the field or the columns that are the rate
    `rate_unit`: their unit
    `clock`: the source of the timestamps
    """

    path: str
    kind: str
    digest: Digest
    name: str
    type: str
    rate: str
    rate_unit: str
    clock: str


def digests_of_inputs(inputs: Mapping[str, str], log: Log | None) -> dict[str, Digest]:
    """Return the digests of the files that were read besides a log, by path.

    `log`: has the source of its message definitions; None for rates in memory
    """
    definitions = () if log is None else map(str, log.definition_files)
    paths = sorted((*inputs.values(), *definitions))
    return {without_secret(path): digest_of_input(path) for path in paths}


def digest_of_input(path: str) -> Digest:
    """Return the digest of a file, a folder or an object in a store."""
    return digest_of_object(path) if is_address(path) else digest_of(path)


class ConventionReport(NamedTuple):
    """The meaning of the numbers.

    `rates`: ``"body"`` or ``"inertial"``
    `method`: the integration rule that was used
    `method_from`: ``"given"``, ``"log"`` where it follows from what the samples are, or
        ``"default"``
    `samples`: what the samples are: ``"rates"`` at their timestamps, ``"averages"`` or
        ``"increments"`` over the intervals that end at them
    `layout`: order of the columns written; None if nothing was written
    `q0_wxyz`: initial attitude, at the first sample, scalar first
    `q0_from`: ``"given"``, ``"level"``, ``"log"`` or a file
    `earth_rate_rad_s`: the rotation of the reference frame that was removed, in its axes, rad/s;
        None if the reference frame is inertial
    `quaternion`: how the components form the quaternion
    `product`: the quaternion product, by its rule for i and j
    `attitude`: how the quaternion rotates a vector
    `step`: the rotation over one interval
    `time`: type and unit of the timestamps
    """

    rates: str
    method: str
    method_from: str
    samples: str
    layout: str | None
    q0_wxyz: NDArray[np.float64]
    q0_from: str
    earth_rate_rad_s: NDArray[np.float64] | None = None
    quaternion: str = "w + x i + y j + z k"
    product: str = CONVENTION["product"]
    attitude: str = CONVENTION["attitude"]
    step: str = CONVENTION["step"]
    time: str = "int64 nanoseconds"

    @property
    def side(self) -> str:
        """The side on which steps are multiplied, in words."""
        return CONVENTION[self.rates]


LAGS = {
    "rates": {"start": 0.5, "end": -0.5},
    "averages": {"start": 1.0, "mean": 0.5},
    "increments": {},
}
"""Kind of samples -> integration rule -> the time by which attitudes lag, in intervals: from the
middle of an interval back to that of the samples that the rule uses for it. 0 for other rules."""


def lag_ns(samples: str, method: str, median_dt_ns: int | None) -> int | None:
    """Return the time by which attitudes lag because of their integration rule, ns; None: unknown.

    `samples`, `method`: see :class:`ConventionReport`
    """
    if samples not in LAGS or method not in METHODS or median_dt_ns is None:
        return None
    return round(LAGS[samples].get(method, 0.0) * median_dt_ns)


def sensitivity(
    samples: str, method: str, better: str | None, angle_rad: float | None
) -> MethodSensitivity | None:
    """Return by how much a better integration rule changes attitudes; None if it is unknown.

    `samples`, `method`: see :class:`ConventionReport`
    `better`, `angle_rad`: see :class:`ResultReport`
    """
    # A sensor that corrects its increments for coning has no error; of others it is not known.
    is_sum = method == "end" and samples != "rates"
    if not better or angle_rad is None or is_sum or method in LOOK_AHEAD:
        return None
    return MethodSensitivity((samples, method), better, angle_rad)


class ResultReport(NamedTuple):
    """The attitudes written.

    `samples`: number of samples propagated
    `rows`: number of attitudes written
    `first_ns`: timestamp of the first of them, ns
    `last_ns`: timestamp of the last of them, ns
    `span_s`: time from the first to the last sample, s
    `sample_rate_hz`: mean rate of the samples, Hz; None where they span no time
    `final_wxyz`: attitude at the last sample, scalar first
    `net_rotation_rad`: angle from the first to the last attitude, rad
    `method_sensitivity_rad`: method sensitivity: the largest angle between the attitudes of this
        and the next better method, at the first 2048 samples and some of the others, rad; None
        where it was not computed
    `next_method`: that method: for ``"cubic"`` and ``"quintic"`` the next lower one; over intervals
        at which ``"quintic"`` is ``"cubic"``, and where it is that throughout, ``"coning"``
    `sampling_sensitivity_rad`: largest angle between the attitudes from all samples and from every
        second one, at one in 64 of the first samples and one in 512 of the others, rad
    `path_angle_rad`: total angle traversed, rad
    `attitudes_crc32`: digest of timestamps and attitudes, the same in every format and layout: the
        CRC-32 of all int64 ns, then that of all float64 wxyz, little-endian, in hexadecimal digits
    """

    samples: int
    first_ns: int | None
    last_ns: int | None
    span_s: float
    sample_rate_hz: float | None
    rows: int
    final_wxyz: NDArray[np.float64]
    net_rotation_rad: float
    method_sensitivity_rad: float | None
    next_method: str | None
    sampling_sensitivity_rad: float | None
    path_angle_rad: float
    attitudes_crc32: str


@dataclass(frozen=True, slots=True, eq=False)
class RunReport:
    """A run: its input, settings, counts, losses and result.

    Parameters
    ----------
    source, convention, policy, counts, correction, uncertainty, result
        The parts; of the uncertainty None if nothing is known of the gyroscope's errors, or the
        report is kept nowhere.
    settings
        What was requested, by the names of settings, as text.
    files
        Size and SHA-256 of the files that were read next to the log, by path; empty where the
        report is kept nowhere.
    losses
        Parts of the log that could not be read.
    remarks
        Remarks on the log and the result.
    unchecked_chunks
        Chunks of which only selected messages were read, so that their checksums were not compared;
        not part of an output's metadata.
    seconds
        How long the run took, s; not part of an output's metadata.
    """

    source: SourceReport
    convention: ConventionReport
    policy: Policy
    counts: Counts
    losses: tuple[Loss, ...]
    remarks: tuple[Remark, ...]
    correction: GyroCorrectionReport
    uncertainty: UncertaintyReport | None
    result: ResultReport
    settings: Mapping[str, str | bool]
    files: Mapping[str, Digest] = field(default_factory=dict)
    unchecked_chunks: int = 0
    seconds: float | None = None

    def __repr__(self) -> str:
        # The whole report is pages long; as_json() has it.
        result, method = self.result, self.convention.method
        noted = f", {len(self.remarks)} remarks" * bool(self.remarks)
        lost = ", data lost" * self.data_lost
        return (
            f"<RunReport: {result.rows:,} attitudes of {result.samples:,} samples by method "
            f"{method}{noted}{lost}>"
        )

    @property
    def conditioning(self) -> GyroCorrectionReport:
        """The same as `correction`, for scripts that use the earlier name."""
        return self.correction

    @property
    def data_lost(self) -> bool:
        """Whether a part of the log could not be read, or samples were dropped."""
        return bool(self.losses or self.counts.dropped)

    def with_display_names(self, log: str, names: Mapping[str, str]) -> JsonObject:
        """Return the report as JSON with names in place of paths, and without the ETag.

        `log`: name of the log
        `names`: path of another file -> its name
        """
        source = self.source._replace(path=log, digest=Digest(self.source.digest.bytes))
        longest = sorted(names.items(), key=lambda item: -len(item[0]))
        report = replace(self, source=source).as_json()
        return {**_renamed(report, longest)} if names else report

    def as_json(self) -> JsonObject:
        """Return the report as JSON: the content of a report file and of outputs' metadata."""
        report = {"quatprop": __version__, **as_json(self), "data_lost": self.data_lost}
        report["convention"]["side"] = self.convention.side
        unchecked, seconds = report.pop("unchecked_chunks"), report.pop("seconds")
        if seconds is None:
            return report
        return {**report, "unchecked_chunks": unchecked, "timings": {"seconds": seconds}}


def _renamed(value: Any, names: Sequence[tuple[str, str]]) -> Any:
    """Return JSON in which files are renamed, even in sentences."""
    if isinstance(value, dict):
        return {_renamed(key, names): _renamed(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_renamed(item, names) for item in value]
    if isinstance(value, str):
        for path, name in names:
            value = value.replace(path, name)
    return value


def convention_of(layout: str) -> JsonObject:
    """Return the metadata of attitudes of which only the convention is known."""
    stated = ("product", "attitude")
    convention = {name: CONVENTION[name] for name in stated} | {"layout": layout}
    return {"quatprop": __version__, "convention": convention}


class ReportFile:
    """A report as JSON, published only after everything else.

    `target`: a path, ``"-"`` for stdout, or None for nowhere
    """

    def __init__(self, target: str | None) -> None:
        self._output = None if target is None else OutputFile(target)

    def finish(self, report: Mapping[str, Any]) -> None:
        """Write the report."""
        if self._output is not None:
            with output_errors(self._output.target):
                self._output.stream.write((json.dumps(report, indent=2) + "\n").encode())
            self._output.finish()

    def publish(self) -> None:
        """Publish the report."""
        if self._output is not None:
            self._output.publish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._output is not None:
            self._output.discard()


# The report of a run in words, for the summary and the HTML page of a plot.


def facts(report: RunReport) -> Iterator[Row]:
    """Yield the source, the processing and the result, as labels and texts."""
    source, counts, result = report.source, report.counts, report.result
    convention = report.convention
    name = source_text(source.name, source.type)
    yield "source", f"{plain(source.path)} ({source.kind}): {name}"
    yield "rate", f"{plain(source.rate)} in {source.rate_unit}, {source.clock} clock"
    yield "samples", _samples(report)
    if report.policy.regular_time:
        yield "clock", _clock(counts.steady_clock, counts.duplicates.count)
    why = ""
    if convention.method_from == "log":
        why = f" (the samples are {convention.samples} over the intervals before their timestamps)"
    yield "method", f"{convention.method}{why}, {convention.rates} rates: {convention.side}"
    if (bias := report.correction.bias_rad_s) is not None:
        yield "bias", _bias(bias, report.correction.rest)
    if report.correction.rests:
        yield "bias", _bias_of_rests(report.correction)
    if (series := report.correction.bias_series) is not None:
        origin = f"{plain(series.source)} ({plain(series.field)})"
        yield "bias", f"{series.values} values of {origin}, interpolated in time"
    if (matrix := report.correction.calibration) is not None:
        yield "calibration", "; ".join(" ".join(f"{x:.6g}" for x in row) for row in matrix)
    if (mount := report.correction.mount) is not None:
        yield "mount", _mount(mount, report.correction.mount_frames)
    if convention.q0_from not in {"given", "identity"}:
        yield "q0", _q0(convention)
    if (earth := convention.earth_rate_rad_s) is not None:
        rates = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*earth)
        yield (
            "earth rate",
            f"{rates} in reference axes, at {report.settings['earth_rate']}: removed",
        )
    if result.method_sensitivity_rad is not None and result.samples > 1:
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


def _clock(clock: SteadyClock | None, repeated: int) -> str:
    """Return the steady clock that replaced the timestamps."""
    if clock is None:
        but = f", except {repeated} repeated" if repeated else ""
        return f"the timestamps already follow a steady clock{but}: used unchanged"
    text = (
        f"steady at {clock.rate_hz:.9g} Hz from t = {clock.offset_ns} ns, instead of timestamps "
        f"that scatter about it by {duration_text(round(clock.residual_rms_ns))} RMS and are at "
        f"most {duration_text(clock.residual_max_ns)} away"
    )
    if clock.missing_ticks:
        text += f"; {count_text(clock.missing_ticks, 'sample')} missing"
    return (
        f"{text}; {count_text(clock.unchanged_samples, 'timestamp')} kept"
        if clock.unchanged_samples
        else text
    )


def _sensitivity(result: ResultReport, convention: ConventionReport) -> str:
    # Rounding errors are not a sensitivity.
    by_method, by_sampling = (
        degrees_text(round(angle or 0.0, 12), 3)
        for angle in (result.method_sensitivity_rad, result.sampling_sensitivity_rad)
    )
    is_sum = convention.method == "end" and convention.samples != "rates"
    unless = " (no error if the sensor corrects for coning itself)" if is_sum else ""
    lags = convention.method == "start" and convention.samples == "rates" and by_method != NOTHING
    late = "; start lags by half a sample, which mean and coning correct" if lags else ""
    return (
        f"the attitudes change by at most {by_method} with method {result.next_method}{unless}, "
        f"by at most {by_sampling} if every second sample is left out{late}"
    )


NOTHING = degrees_text(0.0, 3)


ERRORS = {
    "noise_density": ("noise", "deg/sqrt(h)", 60 * 180 / math.pi),
    "bias_sigma": ("bias", "deg/h", 3600 * 180 / math.pi),
    "random_walk": ("random walk of the bias", "deg/h/sqrt(h)", 60 * 3600 * 180 / math.pi),
    "scale_sigma": ("scale factors", "ppm", 1e6),
    "misalignment_sigma": ("misalignments", "mrad", 1e3),
    "q0_sigma": ("q0", "deg", 180 / math.pi),
}
"""Name of each error of a gyroscope, its usual unit, and the factor from SI units to it."""


HALF_TURN_DEG = 180.0


def _uncertainty(uncertainty: UncertaintyReport) -> Iterator[Row]:
    sigma = _sigma(uncertainty.sigma_rad)
    if share := uncertainty.largest_share:
        sigma += f", {share:.0%} of the variance due to {ERRORS[uncertainty.largest][0]}"
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


def _sigma(sigma_rad: Iterable[float]) -> str:
    """Return standard deviations, rad; beyond half a turn they say nothing."""
    degrees = {axis: math.degrees(one) for axis, one in zip("xyz", sigma_rad, strict=True)}
    known = {axis: one for axis, one in degrees.items() if one <= HALF_TURN_DEG}
    if not known:
        return "the attitude is unknown: more than half a turn about every axis"
    text = "  ".join(f"{axis} {one:.3g}" for axis, one in known.items())
    text += " deg about the body axes of the final attitude"
    unknown = " and ".join(axis for axis in degrees if axis not in known)
    return f"{text}, unknown about {unknown}" if unknown else text


def _q0(convention: ConventionReport) -> str:
    wxyz = convention.q0_wxyz
    angles = (round(math.degrees(each), 3) + 0.0 for each in euler_angles("zyx", wxyz[None])[0])
    text = "yaw {:g}, pitch {:g}, roll {:g} deg".format(*angles)
    return f"{quaternion_text(wxyz)}, from {plain(convention.q0_from)}: {text}"


def _bias(bias_rad_s: Iterable[float], rest: StaticPeriod | None) -> str:
    bias = "x {:+.6g}  y {:+.6g}  z {:+.6g} rad/s".format(*bias_rad_s)
    bias += f" ({degrees_text(math.hypot(*bias_rad_s), 3)}/s)"
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


def _bias_of_rests(correction: GyroCorrectionReport) -> str:
    rests = correction.rests
    ends = zip("xyz", rests[0].mean_rad_s, rests[-1].mean_rad_s, strict=True)
    ranges = "  ".join(f"{axis} {first:+.6g} to {last:+.6g}" for axis, first, last in ends)
    way = "interpolated between" if correction.interpolated else "of the nearest in time of"
    length = duration_text(sum(rest.last_ns - rest.first_ns for rest in rests))
    return (
        f"{way} {len(rests)} rests of {length} together, from the first to the last {ranges} "
        f"rad/s; "
        f"steady by {', '.join(rests[0].steady)}; the whole log was searched"
    )


def _mount(mount: Float64, frames: Sequence[str] | None) -> str:
    if frames is not None:
        return f"{plain(' -> '.join(frames))}, by the static transforms of the log"
    rows = "; ".join(" ".join(f"{x:.6g}" for x in row) for row in mount.round(12) + 0.0)
    return f"{rows} (matrix, sensor axes to body axes)"


def _samples(report: RunReport) -> str:
    counts, result = report.counts, report.result
    text = f"{result.samples}"
    if counts.samples_read != counts.samples_used:
        text += f" of {counts.samples_read}"
    if result.span_s:
        text += f" over {duration_text(counts.span_ns)}, "
        text += rate_text(counts.samples_used, counts.span_ns, counts.median_dt_ns)
    if result.rows != result.samples:
        text += f"; {count_text(result.rows, 'attitude')} written"
    return text


def conventions(report: RunReport) -> Iterator[Row]:
    """Yield the conventions and the settings of a run, as labels and texts."""
    convention, policy, correction = report.convention, report.policy, report.correction
    for name in ("quaternion", "product", "attitude", "step", "layout"):
        yield name, str(getattr(convention, name))
    yield "q0", quaternion_text(convention.q0_wxyz)
    for name in ("on_backwards", "on_nonfinite", "on_gap"):
        yield name.replace("_", " "), getattr(policy, name)
    limit = policy.max_gap_ns
    yield "max gap", "10 median intervals" if limit is None else duration_text(limit)
    for name, t_ns in (("start", correction.start_ns), ("end", correction.end_ns)):
        if t_ns is not None:
            yield name, f"{t_ns} ns"
