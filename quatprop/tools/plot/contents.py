"""The content of pictures: errors of attitudes, a propagation, an Allan deviation."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.rendering import degrees_text, file_names, instant_text, loss_lines
from quatprop.base.text import spelled
from quatprop.base.times import duration_text
from quatprop.comparison.result import comparison_rows, criterion_text, sigma_text, with_names
from quatprop.propagation.report import conventions, facts
from quatprop.timeline.stamps import GAP_FACTOR
from quatprop.tools.allan import laws
from quatprop.tools.noise_table import UNITS, rest_text
from quatprop.tools.plot.page import PictureFile
from quatprop.tools.plot.picture import (
    ERROR,
    SIGMA_BAND,
    Accumulator,
    AttitudeAccumulator,
    Curve,
    Line,
    Mark,
    Page,
    Panel,
    Picture,
    PlottedFile,
    Quantity,
    RateAccumulator,
    picture,
    topic_text,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.comparison.result import Comparison
    from quatprop.comparison.statistics import ComparedSample
    from quatprop.propagation.attitude_input import ReadAttitudes
    from quatprop.propagation.job import Job
    from quatprop.propagation.report import RunReport
    from quatprop.tools.noise_table import Noise


DIGITS = 4
"""Significant digits of the angles in a picture."""

MATCHES = {
    "exact": "pairs of equal timestamps",
    "nearest": "pairs nearest in time",
    "interpolate": "pairs, interpolated in time",
}
"""How attitudes were matched -> description of the pairs."""


class ComparedFile(NamedTuple):
    """A series and its error against a reference."""

    name: str
    operand: ReadAttitudes
    comparison: Comparison


def pair_page(a: ReadAttitudes, b: ReadAttitudes, comparison: Comparison) -> Page:
    """Return the page on the comparison of A with B; see :func:`error_page`."""
    name, reference = file_names((side.input.path, side.signal.name) for side in (a, b))
    return error_page([ComparedFile(name, a, comparison)], reference, b)


def error_page(
    files: Sequence[ComparedFile], reference_name: str, reference: ReadAttitudes
) -> Page:
    """Return the page on the errors of series against one reference."""
    first, single = files[0].comparison, len(files) == 1
    offset_ns = first.time_offset.added_to_b_ns
    shifted = f", reference {duration_text(offset_ns)} later" if offset_ns else ""
    pairs = f"{len(first.t_ns):,} {MATCHES[first.matching.match]}"
    how = f"alignment {first.alignment.name}{shifted}, {pairs}"
    about = "angle, and rotation vector about the body axes"
    if any(file.comparison.sigmas for file in files):
        about += f" ({SIGMA_BAND})"
    lines = [errors_over_time(file.name, file.comparison) for file in files]
    if single:
        lines += _expected_and_windows(first)
    lines += [line for file in files for line in _sigma_tolerance(file, single=single)]
    return Page(
        title=f"error of {', '.join(file.name for file in files)} against {reference_name}",
        facts=(f"{about}; {how}", _max_and_rms(first) if single else ""),
        lead=tuple(_verdict(file) for file in files),
        picture=_with_tolerance_and_marks(picture(lines), files),
        warnings=tuple(_pair_warnings(files, reference)),
        tables=[
            (
                f"{name} against {reference_name}",
                # The cause is among the warnings.
                [row for row in comparison_rows(side, reference, result) if row[0] != "cause"],
            )
            for name, side, result in files
        ],
    )


def errors_over_time(name: str, comparison: Comparison) -> PlottedFile:
    """Return the errors of a series for a picture."""
    values = np.column_stack([comparison.errors, comparison.error_vectors])
    sigmas = None
    if comparison.sigmas:
        sigmas = np.insert(comparison.sigmas.axes_rad, 0, np.nan, axis=1).T
    return _plotted_line(name, comparison.t_ns, values.T, _max_and_rms(comparison), sigmas)


def _expected_and_windows(comparison: Comparison) -> Iterator[PlottedFile]:
    """Yield the expected size of the error and the error over windows, if any."""
    if (window := comparison.window) is not None:
        text = f"max {degrees_text(window.max_rad, DIGITS)}, from where each begins"
        name = f"over {duration_text(window.window_ns)}"
        yield _plotted_line(name, window.begins_ns, window.errors[None], text)
    if (sigmas := comparison.sigmas) is not None:
        text = f"the final error is {sigma_text(sigmas.final)}"
        yield _plotted_line("expected (1 sigma)", comparison.t_ns, sigmas.one_sigma_rad[None], text)


def _sigma_tolerance(file: ComparedFile, *, single: bool) -> Iterator[PlottedFile]:
    """Yield the largest error that a tolerance in sigma allows, in the direction of each error."""
    for criterion in file.comparison.criteria:
        sigmas, is_largest = file.comparison.sigmas, criterion.setting in {"tol", "max_sigma"}
        if sigmas and criterion.unit == "sigma" and is_largest:
            name = f"tolerance ({criterion.limit:g} sigma{'' if single else f', {file.name}'})"
            angles = criterion.limit * sigmas.one_sigma_rad
            text = f"the largest is {sigma_text(criterion.value)}"
            yield _plotted_line(name, file.comparison.t_ns, angles[None], text)


def _plotted_line(
    name: str, t_ns: Int64, angles: Float64, text: str, sigmas: Float64 | None = None
) -> PlottedFile:
    accumulated = Accumulator(ERROR[: len(angles)], has_sigmas=sigmas is not None)
    accumulated.add(t_ns, np.degrees(angles), None if sigmas is None else np.degrees(sigmas))
    median = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 0
    return PlottedFile(name, (accumulated.group(GAP_FACTOR * median or None),), text)


def _with_tolerance_and_marks(drawn: Picture, files: Sequence[ComparedFile]) -> Picture:
    """Draw the tolerance; for one series also the first sample above it and the worst one."""
    comparison = files[0].comparison
    tolerance, first = comparison.tolerance_rad, comparison.first_exceeding
    worst = comparison.worst
    level = None
    if tolerance is not None:
        level = (math.degrees(tolerance), f"tolerance {degrees_text(tolerance, DIGITS)}")

    def mark(sample: ComparedSample, sign: str, text: str) -> Mark:
        seconds = (sample.t_ns - drawn.starts[0]) * 1e-9
        return Mark(seconds, math.degrees(sample.error_rad), f"{text} at {seconds:.6g} s", sign)

    marks = []
    if len(files) == 1:
        above, text = "first above the tolerance", f"worst: {degrees_text(worst.error_rad, DIGITS)}"
        if first is not None and first != worst:
            marks.append(mark(first, "first", above))
        marks.append(mark(worst, "worst", f"{above}, and {text}" if first == worst else text))
    errors = drawn.panels[0]._replace(level=level, marks=tuple(marks))
    return drawn._replace(panels=(errors, *drawn.panels[1:]))


def _max_and_rms(comparison: Comparison) -> str:
    largest, rms = comparison.error_rad.max, comparison.error_rad.rms
    return f"max {degrees_text(largest, DIGITS)}, RMS {degrees_text(rms, DIGITS)}"


def _verdict(file: ComparedFile) -> str:
    comparison, text = file.comparison, f"{file.name}: {_max_and_rms(file.comparison)}"
    if comparison.tolerance_rad is None:
        return text
    relation = "within" if comparison.first_exceeding is None else "above"
    return f"{text}; {relation} the tolerance of {degrees_text(comparison.tolerance_rad, DIGITS)}"


def _pair_warnings(files: Sequence[ComparedFile], reference: ReadAttitudes) -> Iterator[str]:
    for name, operand, comparison in files:
        named = partial(with_names, a=name, b="the reference series")
        for criterion in comparison.criteria:
            if not criterion.passed:
                yield f"{name}: {named(criterion_text(criterion, comparison))}"
        if cause := comparison.likely_cause:
            for each in cause.chain:
                yield f"{name}: likely cause ({each.name}): {named(spelled(each.advice))}"
        yield from (f"{name}: {named(spelled(remark))}" for remark in comparison.remarks)
        yield from _operand_warnings(operand)
    yield from _operand_warnings(reference)


def _operand_warnings(operand: ReadAttitudes) -> Iterator[str]:
    path = operand.input.path
    yield from (f"{path}: {spelled(remark)}" for remark in operand.signal.remarks)
    if operand.counts.invalid:
        yield f"{path}: {operand.counts.invalid} invalid quaternions were omitted"
    yield from (f"{path}: {line}" for line in loss_lines(operand.losses))


# A picture of a propagation: the rates used and the resulting attitudes.


class PropagationPicture(PictureFile):
    """Accumulates the data of a run, and draws them at its end."""

    def __init__(self, target: str, job: Job, *, command: str = "") -> None:
        settings, output = job.settings, job.output
        inputs = [job.log, *settings.inputs.values()]
        super().__init__(target, inputs, [output.path, output.report], command=command)
        self._rates = RateAccumulator("rad/s")
        self._attitudes = AttitudeAccumulator(has_sigmas=settings.errors.sigma)
        self.rates, self.attitudes = self._rates.passing, self._attitudes.passing
        # Attitudes at times other than those of the samples have different intervals.
        self._resampled = settings.rate is not None or settings.at is not None

    def draw(self, report: RunReport) -> None:
        """Draw the picture and publish it."""
        limit_ns = report.counts.gap_limit_ns
        attitudes = self._attitudes.group(None if self._resampled else limit_ns)
        groups = self._rates.group(limit_ns), attitudes
        source, convention = report.source, report.convention
        (name,) = file_names([(source.path, source.name)])
        topic = topic_text(source.kind, source.name, source.type)
        title = f"{name}: {topic}" if topic else name
        samples = f"{report.result.samples:,} samples, {source.clock} clock"
        method = f"method {convention.method}, {convention.rates} rates"
        band = f" ({SIGMA_BAND})" if self._attitudes.knows_sigmas else ""
        warnings = tuple(map(spelled, report.remarks))
        page = Page(
            title=title,
            facts=(f"{method}; Hamilton q, body to reference, as zyx angles{band}", samples),
            lead=(f"Propagated: {method}; {samples}.",),
            picture=picture([PlottedFile(name, groups)]),
            warnings=(*warnings, *loss_lines(report.losses)),
            tables=[
                ("Result", [("first", instant_text(report.result.first_ns or 0)), *facts(report)]),
                ("Convention and settings", conventions(report)),
            ],
        )
        self.commit(page)


# A picture of the Allan deviation of each axis, with the slopes of the noise terms.


def allan_page(noise: Noise) -> Page:
    """Return the picture of the noise of a log."""
    tau, deviation = noise.tau_s, noise.deviation
    bands = [(tau, noise.low[:, axis], noise.high[:, axis]) for axis in range(3)]
    curves = [Curve(Line(tau, deviation[:, axis]), axis, bands[axis]) for axis in range(3)]
    legend = ["x (confidence interval of 68 % shaded)", "y", "z"]
    for law, (name, unit) in zip(laws(tau).T, UNITS.items(), strict=False):
        value = getattr(noise.combined, name).value
        if value is not None:
            slope = value * np.sqrt(law)
            shown = slope >= deviation.min() / 2
            curves.append(Curve(Line(tau[shown], slope[shown]), len(legend), None))
            legend.append(f"{name.replace('_', ' ')} {value:.3g} {unit}")
    lines = "straight lines: the terms, root mean square of the axes"
    facts = (f"at rest: {rest_text(noise)}", lines)
    return Page(
        title=f"noise of {file_names([(noise.source.rpartition(': ')[0], noise.topic)])[0]}",
        facts=facts,
        lead=facts,
        picture=Picture(
            time="averaging time, s",
            panels=(Panel(Quantity("Allan deviation", "rad/s"), tuple(curves)),),
            gaps=(),
            starts=(),
            bin_s=0.0,
            legend=tuple(legend),
            is_log=True,
        ),
        warnings=tuple(map(spelled, noise.remarks)),
        tables=(),
    )
