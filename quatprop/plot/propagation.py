"""A propagation in a picture: the rates that were used and the attitudes they gave."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from quatprop.plot.accumulators import AttitudeSketch, RateSketch
from quatprop.plot.names import names_of, noted
from quatprop.plot.page import Page, Table
from quatprop.plot.picture import Group, Part, instant_text, picture
from quatprop.plot.target import MADE_BY, PictureFile
from quatprop.provenance import as_json
from quatprop.times import duration_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import Self

    from quatprop.containers.base import Loss
    from quatprop.pipeline.report import ConventionReport, RunReport
    from quatprop.series import AttitudeSeries, GyroSeries


CONDITIONING = {
    "bias_rad_s": "bias, rad/s",
    "rest": "rest",
    "mount": "sensor to body",
    "start_ns": "from, ns",
    "end_ns": "to, ns",
}
"""Key of what was done to the rates -> its name in the table."""


class PropagationPicture:
    """Looks at a run as it goes by, and draws it when it is done.

    Parameters
    ----------
    target
        Where the picture goes.
    inputs, outputs
        What the run reads and writes besides.
    resampled
        Whether attitudes are written at other times than the samples: their intervals are no gaps.

    Raises
    ------
    OutputError
        The suffix is that of no picture, or the file cannot be written.
    UsageError
        matplotlib is not installed.
    """

    def __init__(
        self,
        target: str,
        inputs: Iterable[str | None],
        outputs: Iterable[str | None],
        *,
        resampled: bool = False,
    ) -> None:
        self._file = PictureFile(target, inputs, outputs)
        self._rates, self._attitudes = RateSketch("rad/s", 1.0), AttitudeSketch()
        self._resampled = resampled

    def rates(self, batches: Iterable[GyroSeries]) -> Iterator[GyroSeries]:
        """Yield the rates as they are, having looked at them."""
        return self._rates.passing(batches)

    def attitudes(self, batches: Iterable[AttitudeSeries]) -> Iterator[AttitudeSeries]:
        """Yield the attitudes as they are, having looked at them."""
        return self._attitudes.passing(batches)

    def commit(self, report: RunReport) -> None:
        """Draw the picture and put it in its place.

        Parameters
        ----------
        report
            The report of :func:`quatprop.pipeline.job.run`.
        """
        limit_ns = report.counts.gap_limit_ns
        attitudes = self._attitudes.reduced()
        groups = [Group(self._rates.rows, self._rates.reduced(), limit_ns)]
        if len(attitudes):
            between = None if self._resampled else limit_ns
            groups.append(Group(self._attitudes.rows, attitudes, between))
        source, convention = report.source, report.convention
        (name,) = names_of([source.path])
        title = " ".join(text for text in (f"{name}:", source.name, source.type) if text)
        samples = f"{report.result.samples:,} samples, {source.clock} clock"
        method = f"method {convention.method}, {convention.rates} rates"
        warnings = tuple(map(str, report.remarks))
        page = Page(
            heading=title,
            lead=(f"Propagated: {method}; {samples}.",),
            picture=picture(
                [Part(name, tuple(groups))],
                title=title,
                facts=(f"{method}; Hamilton q, body to reference, as zyx angles", samples),
                notes=noted(warnings),
            ),
            warnings=(*warnings, *_lost(report.losses)),
            tables=(
                Table("Result", tuple(_result(report))),
                Table("Convention", tuple(_convention(convention))),
                Table("What was done", tuple(_done(report))),
            ),
            made_by=MADE_BY,
        )
        self._file.commit(page)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._file.discard()


def _lost(losses: Iterable[Loss]) -> Iterator[str]:
    yield from (f"lost: {loss.place}: {loss.reason}" for loss in losses)


def _result(report: RunReport) -> Iterator[tuple[str, str]]:
    source, counts, result = report.source, report.counts, report.result
    yield "file", f"{source.path} ({source.kind})"
    yield "rate", f"{source.rate} in {source.rate_unit}, {source.clock} clock"
    yield "samples", f"{counts.used:,} used of {counts.read:,} read"
    span = duration_text(counts.span_ns)
    yield "time", f"{instant_text(result.first_ns or 0)}, {span}"
    yield "attitudes", f"{result.rows:,} written"
    yield "final", "w {:+.9f}  x {:+.9f}  y {:+.9f}  z {:+.9f}".format(*result.final_wxyz)
    yield "net rotation", f"{math.degrees(result.net_rotation_rad):.6g} deg"
    yield "total angle traversed", f"{math.degrees(result.path_angle_rad):.6g} deg"
    yield "largest rate", f"{math.degrees(counts.max_rate):.6g} deg/s"


def _convention(convention: ConventionReport) -> Iterator[tuple[str, str]]:
    for key in ("quaternion", "product", "attitude", "step", "side", "method", "layout"):
        yield key, str(getattr(convention, key))
    yield "q0", f"{as_json(convention.q0_wxyz)} (w, x, y, z), {convention.q0_from}"


def _done(report: RunReport) -> Iterator[tuple[str, str]]:
    for name, value in as_json(report.policy).items():
        yield name.replace("_", " "), "10 median intervals" if value is None else str(value)
    for name, words in CONDITIONING.items():
        if (value := as_json(getattr(report.conditioning, name))) is not None:
            yield words, str(value)
