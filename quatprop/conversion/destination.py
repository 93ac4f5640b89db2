"""The destination of converted attitudes: a table, a file of attitudes, or a copy of the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conventions import HAMILTON
from quatprop.conventions.representations import NEAR_LOCK_DEG, QUATERNION, REPRESENTATIONS
from quatprop.conversion.rates import RATES
from quatprop.errors import OutputError, UsageError
from quatprop.pipeline.job import open_output
from quatprop.text import Remark, Setting, listed, quoted
from quatprop.writers import holds_covariances, open_table, refuse_message
from quatprop.writers.attitudes import AttitudeWriter, column_table
from quatprop.writers.formats import WRITERS, format_remarks

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.conversion.job import Conversion
    from quatprop.logs.signals.signal import AttitudeSignal
    from quatprop.tables.log import Log


def kept_sigma(job: Conversion, source: AttitudeSignal, stored: str | None) -> str | None:
    """Return the axes of the stored standard deviations if they are kept, else None.

    They are kept if the output can store them, and both sides are Hamilton and body to reference:
    another direction or convention has them about other axes, and those about rotated axes cannot
    be computed from three standard deviations.
    """
    axes = source.sigma_axes
    mixes = job.axes is not None and axes is not None and job.axes.mixes(axes)
    if mixes or job.relative_to is not None:
        return None
    has_place = holds_covariances(job.output.kind, job.output.message)
    is_plain = job.meaning == HAMILTON and job.representation == QUATERNION
    return stored if has_place and is_plain and source.may_have_covariances else None


def open_destination(job: Conversion, log: Log, sigma: str | None) -> AttitudeWriter:
    """Open the writer of the output, which takes attitudes, or rates if the output is rates."""
    output = job.output
    if job.representation == QUATERNION:
        if job.meaning == HAMILTON:
            return open_output(output, log, sigma)
        _refuse_other_conventions(job)
    table = open_table(output.path, job.columns(None), output.to, comment=output.comment)
    if job.representation in RATES:
        return column_table(table, lambda series: series.rate)
    if job.representation in REPRESENTATIONS:
        form = REPRESENTATIONS[job.representation]
        return column_table(table, lambda series: form.values(series.wxyz), form.locked)
    order = list(job.layout.order)
    return column_table(table, lambda series: series.wxyz[:, order])


def _refuse_other_conventions(job: Conversion) -> None:
    """Refuse formats that prescribe a convention."""
    output, kind = job.output, job.output.kind
    if not WRITERS[kind].columns:
        raise OutputError(
            output.path,
            f"kind {quoted(kind)} holds Hamilton quaternions body to reference by its own "
            f"definition; omit {Setting('convention')} and {Setting('direction')}, or choose "
            f"{listed(name for name, known in WRITERS.items() if known.columns)}",
        )
    refuse_message(kind, output.message)
    if output.extra_columns is not None:
        raise UsageError(
            f"{Setting('extra_columns')} requires Hamilton quaternions body to reference; omit "
            f"{Setting('convention')} and {Setting('direction')}"
        )


def remarks_on(
    job: Conversion,
    singular: int,
    *,
    positions_lost: bool,
    sigma_lost: bool,
    lost_columns: Sequence[str],
) -> Iterator[Remark]:
    """Yield remarks on the output.

    `positions_lost`: whether the source has positions and the output none
    `sigma_lost`: whether the source has standard deviations or covariances and the output none
    """
    yield from format_remarks(
        job.output.path, job.output.to, positions_lost=positions_lost, sigma_lost=sigma_lost
    )
    if lost_columns:
        yield Remark(
            "columns-lost",
            f"columns {listed(lost_columns)} are not kept; "
            f"{Setting('extra_columns')} writes such ones",
        )
    if singular:
        form = REPRESENTATIONS[job.representation]
        first, second, third = (name.rpartition("_")[0] for name in form.columns)
        yield Remark(
            "gimbal-lock",
            f"{singular} rows are within {NEAR_LOCK_DEG} deg of {second} "
            f"{' or '.join(map(str, form.lock_deg))} deg (gimbal lock), where only the sum or the "
            f"difference of {first} and {third} is determined, and each jumps from row to row; "
            "together they are still the attitude",
        )
    output, meaning = job.output, job.meaning
    if meaning != HAMILTON and not output.keeps_provenance:
        yield Remark(
            "convention-unstated",
            f"the file cannot state that it is {meaning.convention} {meaning.direction}, so its "
            f"reader has to know it; {Setting('header_comment')}, or Parquet, would",
        )
