"""The report of a conversion, and the provenance of its output: that of the source and a step."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from quatprop import __version__
from quatprop.containers.stores import without_secret
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.conversion.rates import RATE_COLUMNS, RATES
from quatprop.provenance import Digest, as_json
from quatprop.series import SIGMA_COLUMNS
from quatprop.writers import WRITERS, kind_of, layout_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.containers.base import Log, Loss
    from quatprop.conventions import Meaning
    from quatprop.conventions.layout import Layout
    from quatprop.conversion.settings import Conversion
    from quatprop.signals.quaternion_check import QuaternionCounts
    from quatprop.signals.signal import AttitudeSignal
    from quatprop.text import Text


@dataclass(frozen=True, slots=True)
class ConversionSource:
    """Where the attitudes came from.

    Parameters
    ----------
    path, kind
        The file.
    digest
        Its size and SHA-256.
    name, type
        Topic and message type, or columns and dialect.
    clock
        The timestamp source.
    """

    path: str
    kind: str
    digest: Digest
    name: str
    type: str
    clock: str


@dataclass(frozen=True, slots=True)
class AttitudeFormat:
    """How attitudes are stored.

    Parameters
    ----------
    representation
        ``"quaternion"`` or a key of :data:`quatprop.conventions.REPRESENTATIONS`.
    layout
        Order of the components; None where there are none.
    meaning
        What the numbers mean.
    columns
        Field or columns.
    """

    representation: str
    layout: str | None
    meaning: Meaning
    columns: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ConversionReport:
    """What a conversion read and wrote.

    Parameters
    ----------
    source
        Where the attitudes came from.
    stored, written
        How they were stored, and how they are now.
    sign
        The choice between q and -q.
    normalize
        Whether rows were scaled to unit length.
    counts
        Valid and invalid rows.
    losses
        What could not be read.
    remarks
        What a reader should know.
    history
        The provenance of the source.
    """

    source: ConversionSource
    stored: AttitudeFormat
    written: AttitudeFormat
    sign: str
    normalize: bool
    counts: QuaternionCounts
    losses: tuple[Loss, ...]
    remarks: tuple[str | Text, ...]
    history: Mapping[str, Any]

    @property
    def data_lost(self) -> bool:
        """Whether something could not be read or was left out."""
        return bool(self.losses or self.counts.invalid)

    def provenance(self) -> Mapping[str, Any]:
        """Return the provenance of the output, JSON-ready."""
        source, stored, written = as_json(self.source), self.stored, self.written
        layout = {"layout": written.layout} if written.layout else {}
        terms = {
            "representation": written.representation,
            **asdict(written.meaning),
            **layout,
            "columns": list(written.columns),
            "sign": self.sign,
        }
        step = {
            "quatprop": __version__,
            "source": source,
            "from": {
                "representation": stored.representation,
                "layout": stored.layout,
                **asdict(stored.meaning),
                "field": ",".join(stored.columns),
            },
            "to": terms,
            "normalize": self.normalize,
            "counts": as_json(self.counts),
            "losses": as_json(self.losses),
            "remarks": as_json(self.remarks),
        }
        convention = _entry(self.history, "convention", dict)
        hamilton = written.meaning.convention == "hamilton"
        return {
            **self.history,
            "quatprop": __version__,
            "source": self.history.get("source", source),
            "convention": {
                "time": "int64 nanoseconds",
                **{name: value for name, value in convention.items() if name != "layout"},
                "product": "Hamilton, ij = k" if hamilton else "JPL, ij = -k",
                "attitude": written.meaning.description,
                **terms,
            },
            "conversions": [*_entry(self.history, "conversions", list), step],
            "data_lost": bool(self.history.get("data_lost") or self.data_lost),
        }


def written_columns(job: Conversion, sigma: str | None) -> tuple[str, ...]:
    """Return the names of what is written beside timestamps; `sigma` is None without sigmas."""
    if job.representation in RATES:
        return RATE_COLUMNS
    if job.representation != QUATERNION:
        return REPRESENTATIONS[job.representation].columns
    columns, output = _layout(job).columns, job.output
    if output.beside is not None:
        columns += REPRESENTATIONS[output.beside].columns
    has_columns = WRITERS[kind_of(output.path, output.to)].columns
    return columns + (SIGMA_COLUMNS if sigma and has_columns else ())


def _layout(job: Conversion) -> Layout:
    return layout_of(kind_of(job.output.path, job.output.to), job.output.layout)


def conversion_report(  # noqa: PLR0913  # the parts of a conversion
    job: Conversion,
    log: Log,
    source: AttitudeSignal,
    *,
    counts: QuaternionCounts,
    digest: Digest,
    remarks: tuple[str | Text, ...],
    columns: tuple[str, ...],
) -> ConversionReport:
    """Return the report of a conversion."""
    layout = _layout(job).name if job.representation == QUATERNION else None
    path = without_secret(job.log)
    return ConversionReport(
        source=ConversionSource(
            path, log.kind, digest, source.name, source.type_name, source.clock
        ),
        stored=AttitudeFormat(
            source.representation, source.layout, source.meaning, (source.field,)
        ),
        written=AttitudeFormat(job.representation, layout, job.meaning, columns),
        sign=job.applied_sign,
        normalize=job.normalize,
        counts=counts,
        losses=tuple(log.losses),
        remarks=remarks,
        history=source.provenance,
    )


def _entry(provenance: Mapping[str, Any], name: str, kind: type[Any]) -> Any:
    """Return an entry of a provenance, if it has the type that this package writes."""
    entry = provenance.get(name)
    return entry if isinstance(entry, kind) else kind()
