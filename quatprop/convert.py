"""One attitude series into another file: its layout, convention, direction, sign, representation.

The numbers of a series are never computed anew where only their order or their sign changes, so
that what is converted there and back is the same to the bit.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from quatprop import __version__
from quatprop.conventions import HAMILTON, REPRESENTATIONS, Meaning, Signs
from quatprop.errors import NoSamplesError, OutputError, UsageError, listed, quoted
from quatprop.into import open_into, written_kind
from quatprop.provenance import Fingerprint
from quatprop.readers import open_log
from quatprop.report import ReportFile
from quatprop.series import AttitudeSeries
from quatprop.signals.attitudes import AttitudeSelection, attitude_stamps, choose_attitudes
from quatprop.signals.rotation_check import RotationCheck
from quatprop.writers import WRITERS, has_room, kind_of, layout_of, open_table, open_writer
from quatprop.writers.overlap import refuse_overlap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from quatprop.conventions import Representation
    from quatprop.readers.base import Log, MessageLog, TableLog
    from quatprop.signals.attitudes import AttitudeSource
    from quatprop.writers.base import AttitudeWriter, Uncommitted
    from quatprop.writers.messages import Message

    Put = Callable[[NDArray[np.int64], NDArray[np.float64]], None]

QUATERNION = "quaternion"


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
            job = replace(job, to=written_kind(log, job.output, job.to))
        source = choose_attitudes(log, job.selection)
        check = RotationCheck(job.log, normalize=job.normalize, drop=job.drop)
        signs = Signs(_sign(job))
        # Where nothing keeps it, reading the source once more is not worth its time.
        kept = job.report is not None or has_room(job.output, job.to, comment=job.comment)
        with (
            ReportFile(job.report) as report_file,
            _opened(job, log) as (writer, put),
            Fingerprint(job.log, wanted=kept) as fingerprint,
        ):
            for series in check.apply(source.rows()):
                put(series.t_ns, signs.applied(job.meaning.restated(series.wxyz)))
                tick(check.counts.used)
            if not check.counts.used:
                raise NoSamplesError(job.log, source.name)
            report = _report(job, log, source, check, fingerprint.result())
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


def _sign(job: Conversion) -> str:
    # A rotation vector has no sign to keep; the short one is what everyone expects.
    if job.representation in REPRESENTATIONS and job.sign == "keep":
        return "positive"
    return job.sign


@contextmanager
def _opened(job: Conversion, log: MessageLog | TableLog) -> Iterator[tuple[Uncommitted, Put]]:
    """Give what is to be committed, and a function that takes stamps and quaternions wxyz."""
    kind = kind_of(job.output, job.to)
    if job.representation in REPRESENTATIONS:
        form = REPRESENTATIONS[job.representation]
        with open_table(job.output, form.columns, job.to, comment=job.comment) as table:
            yield table, lambda t_ns, wxyz: table.write(t_ns, list(_columns(form, wxyz)))
    elif job.meaning == HAMILTON:
        with _attitudes(job, log, layout_of(kind, job.layout).name) as writer:
            yield writer, lambda t_ns, wxyz: writer.write(AttitudeSeries(t_ns, wxyz))
    else:
        if not WRITERS[kind].table:
            tables = listed(name for name, known in WRITERS.items() if known.table)
            raise OutputError(
                job.output,
                f"kind {quoted(kind)} holds Hamilton quaternions body to reference by its own "
                f"definition; leave --convention and --direction out, or choose {tables}",
            )
        if job.message is not None:
            raise UsageError(f"{kind} holds no messages; leave --message out")
        order = layout_of(kind, job.layout)
        with open_table(job.output, order.columns, job.to, comment=job.comment) as table:
            yield table, lambda t_ns, wxyz: table.write(t_ns, [wxyz[:, k] for k in order.order])


def _attitudes(job: Conversion, log: MessageLog | TableLog, layout: str) -> AttitudeWriter:
    """Return what takes attitudes as they are: a file of their own, or a copy of the log."""
    options: dict[str, Any] = {"layout": layout, "message": job.message, "comment": job.comment}
    if not job.into:
        return open_writer(job.output, job.to, **options)
    return open_into(log, job.output, partial(attitude_stamps, job.selection), **options)


def _columns(form: Representation, wxyz: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    for column in form.values(wxyz).T:
        yield np.ascontiguousarray(column)


def _report(
    job: Conversion,
    log: Log,
    source: AttitudeSource,
    check: RotationCheck,
    fingerprint: dict[str, Any],
) -> dict[str, Any]:
    """Return the provenance of the source, extended by what was done now."""
    before = source.provenance
    read = {
        "path": job.log,
        "kind": log.kind,
        **fingerprint,
        "name": source.name,
        "type": source.type_name,
        "clock": source.clock,
    }
    counts = check.counts
    terms = _terms(job)
    step = {
        "quatprop": __version__,
        "source": read,
        "from": {"layout": source.layout, **asdict(source.meaning), "field": source.quaternion},
        "to": terms,
        "normalize": job.normalize,
        "counts": asdict(counts),
        "losses": [asdict(loss) for loss in log.losses],
        "remarks": list(source.remarks),
    }
    convention = dict(before.get("convention") or {})
    convention.pop("layout", None)
    return {
        **before,
        "quatprop": __version__,
        "source": before.get("source", read),
        "convention": {
            "time": "int64 nanoseconds",
            **convention,
            "product": "Hamilton, ij = k"
            if job.meaning.convention == "hamilton"
            else "JPL, ij = -k",
            "attitude": job.meaning.words,
            **terms,
        },
        "conversions": [*before.get("conversions", []), step],
        "data_lost": bool(before.get("data_lost") or log.losses or counts.bad),
    }


def _terms(job: Conversion) -> dict[str, Any]:
    """Return what the numbers written are, for whoever reads them."""
    if job.representation == QUATERNION:
        layout = layout_of(kind_of(job.output, job.to), job.layout)
        stored: dict[str, Any] = {"layout": layout.name, "columns": list(layout.columns)}
    else:
        stored = {"columns": list(REPRESENTATIONS[job.representation].columns)}
    return {
        "representation": job.representation,
        **asdict(job.meaning),
        **stored,
        "sign": _sign(job),
    }
