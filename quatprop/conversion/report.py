"""The report of a conversion, and the provenance of its output: that of the source and a step."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from quatprop import __version__
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.conversion.rates import RATE_COLUMNS, RATES
from quatprop.provenance import Digest, as_json
from quatprop.series import SIGMA_COLUMNS
from quatprop.writers import WRITERS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from quatprop.containers.base import Loss
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
class ConversionReport:
    """What a conversion read and wrote.

    Parameters
    ----------
    job
        What was to be done.
    source
        Where the attitudes came from.
    signal
        How they were stored there, and how they were made.
    columns
        The names of what is written beside timestamps.
    counts
        Valid and invalid rows.
    losses
        What could not be read.
    remarks
        What a reader should know.
    """

    job: Conversion
    source: ConversionSource
    signal: AttitudeSignal
    columns: tuple[str, ...]
    counts: QuaternionCounts
    losses: tuple[Loss, ...]
    remarks: tuple[str | Text, ...]

    @property
    def data_lost(self) -> bool:
        """Whether something could not be read or was left out."""
        return bool(self.losses or self.counts.invalid)

    def provenance(self) -> Mapping[str, Any]:
        """Return the provenance of the output, JSON-ready."""
        job, signal, history = self.job, self.signal, self.signal.provenance
        source = as_json(self.source)
        is_quaternion = job.representation == QUATERNION
        terms = {
            "representation": job.representation,
            **asdict(job.meaning),
            **({"layout": job.layout.name} if is_quaternion else {}),
            "columns": list(self.columns),
            "sign": job.applied_sign,
        }
        step = {
            "quatprop": __version__,
            "source": source,
            "from": {
                "representation": signal.representation,
                "layout": signal.layout,
                **asdict(signal.meaning),
                "field": signal.field,
            },
            "to": terms,
            "normalize": job.source.normalize,
            "counts": as_json(self.counts),
            "losses": as_json(self.losses),
            "remarks": as_json(self.remarks),
        }
        convention = _entry(history, "convention", dict)
        hamilton = job.meaning.convention == "hamilton"
        return {
            **history,
            "quatprop": __version__,
            "source": history.get("source", source),
            "convention": {
                "time": "int64 nanoseconds",
                **{name: value for name, value in convention.items() if name != "layout"},
                "product": "Hamilton, ij = k" if hamilton else "JPL, ij = -k",
                "attitude": job.meaning.description,
                **terms,
            },
            "conversions": [*_entry(history, "conversions", list), step],
            "data_lost": bool(history.get("data_lost") or self.data_lost),
        }


def written_columns(job: Conversion, sigma: str | None) -> tuple[str, ...]:
    """Return the names of what is written beside timestamps; `sigma` is None without sigmas."""
    if job.representation in RATES:
        return RATE_COLUMNS
    if job.representation != QUATERNION:
        return REPRESENTATIONS[job.representation].columns
    columns, beside = job.layout.columns, job.output.beside
    if beside is not None:
        columns += REPRESENTATIONS[beside].columns
    return columns + (SIGMA_COLUMNS if sigma and WRITERS[job.kind].columns else ())


def _entry(provenance: Mapping[str, Any], name: str, kind: type[Any]) -> Any:
    """Return an entry of a provenance, if it has the type that this package writes."""
    entry = provenance.get(name)
    return entry if isinstance(entry, kind) else kind()
