"""A picture of a propagation: the rates used and the resulting attitudes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.pipeline.summary import conventions, facts
from quatprop.plotting.accumulators import SIGMA_BAND, AttitudeAccumulator, RateAccumulator
from quatprop.plotting.picture import Page, PlottedFile, picture
from quatprop.plotting.target import PictureFile
from quatprop.rendering import file_names, instant_text, loss_lines, source_text
from quatprop.text import spelled

if TYPE_CHECKING:
    from quatprop.pipeline.job import Job
    from quatprop.pipeline.report import RunReport


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
        title = f"{name}: {source_text(source.name, source.type)}"
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
