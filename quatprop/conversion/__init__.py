"""One attitude series into another file: its layout, convention, direction, sign, representation.

The numbers of a series are never computed anew where only their order or their sign changes, so
that what is converted there and back is the same to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from quatprop.conventions import HAMILTON, Meaning, Signs
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.conversion.destination import forgotten, opened, remarks_on
from quatprop.conversion.history import extended
from quatprop.errors import NoSamplesError, UsageError
from quatprop.formats import open_log
from quatprop.into import copy_kind
from quatprop.pipeline.report import ReportFile
from quatprop.provenance import Fingerprint
from quatprop.selection import AttitudeSelection
from quatprop.signals.attitudes import choose_attitudes
from quatprop.signals.quaternion_check import QuaternionCheck
from quatprop.text import listed, quoted
from quatprop.writers import keeps_provenance
from quatprop.writers.targets import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable

    from quatprop.writers.messages.kinds import Message


@dataclass(frozen=True, slots=True)
class Conversion:
    """What to make of one attitude series.

    Parameters
    ----------
    log, output
        Paths, or ``"-"`` for CSV on stdin and stdout.
    into
        The output is a copy of the log with the attitudes added as messages.
    kind, to
        Kinds of the two files; None means told by content and suffix.
    selection
        Which attitudes, and what the user says about their numbers.
    layout
        Order of the columns written; None is that of the format.
    meaning
        What the numbers written shall mean.
    sign
        ``"keep"``, ``"continuous"`` or ``"positive"``. Rotation vectors of ``"keep"`` are the
        short ones, up to half a turn.
    representation
        ``"quaternion"`` or a key of :data:`quatprop.conventions.REPRESENTATIONS`.
    normalize
        Scale rows to unit length.
    drop
        Leave out rows that are no rotations.
    message
        What to write the attitudes as, where they are written as messages.
    comment
        Begin text with the provenance, in a comment.
    report
        Where the provenance goes as JSON, ``"-"`` for stdout; None is nowhere.
    """

    log: str
    output: str
    into: bool = False
    kind: str | None = None
    to: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    layout: str | None = None
    meaning: Meaning = HAMILTON
    sign: str = "keep"
    representation: str = QUATERNION
    normalize: bool = False
    drop: bool = False
    message: Message | None = None
    comment: bool = False
    report: str | None = None

    @property
    def applied_sign(self) -> str:
        """The sign that is chosen."""
        # A rotation vector has no sign to keep; the short one is what everyone expects.
        if self.representation in REPRESENTATIONS and self.sign == "keep":
            return "positive"
        return self.sign


def convert(job: Conversion, tick: Callable[[int], None] = lambda _rows: None) -> dict[str, Any]:
    """Write an attitude series in other terms.

    Parameters
    ----------
    job
        What to do.
    tick
        Called with the number of rows written so far.

    Returns
    -------
    dict
        The provenance of what was written, JSON-ready: that of the source, extended.

    Raises
    ------
    LogError
        The source cannot be used as asked, or holds rows that are no rotations.
    OutputError
        The result cannot be written.
    UsageError
        Options contradict each other.
    """
    _refuse_contradictions(job)
    refuse_overlap([job.log], [job.output, job.report])
    with open_log(job.log, job.kind) as log:
        if job.into:
            job = replace(job, to=copy_kind(log, job.output, job.to))
        source = choose_attitudes(log, job.selection)
        check = QuaternionCheck(job.log, normalize=job.normalize, drop=job.drop)
        signs = Signs(job.applied_sign)
        # Where nothing keeps it, reading the source once more is not worth its time.
        kept = job.report is not None or keeps_provenance(job.output, job.to, comment=job.comment)
        with (
            ReportFile(job.report) as report_file,
            opened(job, log) as (writer, put),
            Fingerprint(job.log, wanted=kept) as fingerprint,
        ):
            singular = 0
            for series in check.apply(source.rows()):
                singular += put(series.t_ns, signs.applied(job.meaning.converted(series.wxyz)))
                tick(check.counts.used)
            if not check.counts.used:
                raise NoSamplesError(job.log, source.name)
            report = extended(job, log, source, check, fingerprint.result())
            report["conversions"][-1]["remarks"] += [*remarks_on(singular), *forgotten(job)]
            writer.commit(report)
            report_file.commit(report)
    return report


def _refuse_contradictions(job: Conversion) -> None:
    if job.representation == QUATERNION:
        return
    if job.representation not in REPRESENTATIONS:
        raise UsageError(
            f"no representation {quoted(job.representation)}; choose one of "
            f"{listed([QUATERNION, *REPRESENTATIONS])}"
        )
    signed = REPRESENTATIONS[job.representation].signed
    for option, given in (
        ("--layout", job.layout is not None),
        ("--convention", job.meaning.convention != HAMILTON.convention),
        ("--sign", job.sign != "keep" and not signed),
        ("--message", job.message is not None),
    ):
        if given:
            raise UsageError(
                f"{option} is about quaternions and {job.representation} has none; leave it out"
            )
