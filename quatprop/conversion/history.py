"""The provenance of what is converted: that of the source, with one more step."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from quatprop import __version__
from quatprop.containers.remote import without_secret
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.writers import kind_of, layout_of

if TYPE_CHECKING:
    from quatprop.containers.base import Log
    from quatprop.conversion import Conversion
    from quatprop.signals.quaternion_check import QuaternionCheck
    from quatprop.signals.signal import AttitudeSignal


def extended(
    job: Conversion,
    log: Log,
    source: AttitudeSignal,
    check: QuaternionCheck,
    fingerprint: dict[str, Any],
) -> dict[str, Any]:
    """Return the provenance of the source, extended by what was done now."""
    before = source.provenance
    read = {
        "path": without_secret(job.log),
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
        "from": {
            "representation": source.representation,
            "layout": source.layout,
            **asdict(source.meaning),
            "field": source.field,
        },
        "to": terms,
        "normalize": job.normalize,
        "counts": asdict(counts),
        "losses": [asdict(loss) for loss in log.losses],
        "remarks": list(source.remarks),
    }
    convention = {name: said for name, said in _kept(before, "convention", dict).items()
                  if name != "layout"}  # fmt: skip
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
            "attitude": job.meaning.description,
            **terms,
        },
        "conversions": [*_kept(before, "conversions", list), step],
        "data_lost": bool(before.get("data_lost") or log.losses or counts.invalid),
    }


def _kept(before: dict[str, Any], name: str, kind: type[Any]) -> Any:
    """Return what a provenance says, if it is what this package writes there."""
    said = before.get(name)
    return said if isinstance(said, kind) else kind()


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
        "sign": job.applied_sign,
    }
