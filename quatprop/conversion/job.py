"""The settings of a conversion, its report, and the provenance of its output."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from quatprop.conventions import HAMILTON, AttitudeConvention
from quatprop.conventions.representations import QUATERNION, REPRESENTATIONS
from quatprop.conversion.axes import AxisChange
from quatprop.conversion.rates import RATE_COLUMNS, RATES
from quatprop.provenance import Digest, as_json, entry_of
from quatprop.series import SIGMA_COLUMNS
from quatprop.version import __version__
from quatprop.writers.formats import WRITERS, layout_of

if TYPE_CHECKING:
    from collections.abc import Mapping
    from fractions import Fraction

    from quatprop.conventions.layout import Layout
    from quatprop.logs.attitude_input import AttitudeInput
    from quatprop.logs.signals.quaternion_check import QuaternionCounts
    from quatprop.logs.signals.signal import AttitudeSignal
    from quatprop.pipeline.settings import OutputSettings
    from quatprop.provenance import JsonObject
    from quatprop.tables.log import Loss
    from quatprop.text import Remark


@dataclass(frozen=True, slots=True)
class Conversion:
    """The settings of the conversion of one attitude series.

    `output`: target, format and layout
    `sign`: ``"keep"``, ``"continuous"`` or ``"positive"``. Rotation vectors of ``"keep"`` are the
        short ones, up to half a turn
    `representation`: ``"quaternion"``, a key of :data:`REPRESENTATIONS`, or of
        :data:`quatprop.conversion.rates.RATES`
    `left`, `right`: rotations of the reference axes and of the body axes to those of the output, in
        the notation of :func:`quatprop.conditioning.mounting.mounting`; None for no rotation
    `rate`: rate of interpolated attitudes, Hz; None for the attitudes of the source
    `relative_to`: the log of another body, to which attitudes are made relative before other steps
    """

    source: AttitudeInput
    output: OutputSettings
    meaning: AttitudeConvention = HAMILTON
    sign: str = "keep"
    representation: str = QUATERNION
    left: str | None = None
    right: str | None = None
    rate: Fraction | None = None
    relative_to: str | None = None

    @property
    def axes(self) -> AxisChange | None:
        """The change of axes; None for no change."""
        unchanged = self.left is None and self.right is None
        return None if unchanged else AxisChange.of(self.left, self.right)

    @property
    def layout(self) -> Layout:
        """The layout of quaternions, if the output is quaternions."""
        return layout_of(self.output.kind, self.output.layout)

    @property
    def applied_sign(self) -> str:
        """The sign that is applied: a rotation vector has no sign to keep, and is the short one."""
        if self.representation in REPRESENTATIONS and self.sign == "keep":
            return "positive"
        return self.sign

    def columns(self, sigma: str | None) -> tuple[str, ...]:
        """Return the names of columns besides timestamps; `sigma` is None without sigmas."""
        if self.representation in RATES:
            return RATE_COLUMNS[self.representation]
        if self.representation != QUATERNION:
            return REPRESENTATIONS[self.representation].columns
        columns, extra_columns = self.layout.columns, self.output.extra_columns
        if extra_columns is not None:
            columns += REPRESENTATIONS[extra_columns].columns
        return columns + (SIGMA_COLUMNS if sigma and WRITERS[self.output.kind].columns else ())


def terms_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a :class:`Conversion` on conventions and axes from settings."""
    meaning = AttitudeConvention(
        values.get("convention") or HAMILTON.convention,
        values.get("direction") or HAMILTON.direction,
    )
    turns = {name: values.get(name) for name in ("left", "right", "rate", "relative_to")}
    return {"meaning": meaning, "sign": values.get("sign") or "keep", **turns}


@dataclass(frozen=True, slots=True)
class ConversionReport:
    """The report on a conversion; the result of :func:`quatprop.convert`.

    Parameters
    ----------
    job
        The settings of the conversion.
    path, kind, digest
        The input file, its format, and its size and SHA-256.
    signal
        The attitudes in the file, their storage and their provenance.
    columns
        Names of the output columns besides the timestamps.
    counts
        Rows that were read, used, normalized, and omitted, by reason.
    written
        Rows of the output.
    outside
        Rows before and after the time range.
    losses
        Parts of the file that could not be read.
    remarks
        Further remarks.
    """

    job: Conversion
    path: str
    kind: str
    digest: Digest
    signal: AttitudeSignal
    columns: tuple[str, ...]
    counts: QuaternionCounts
    written: int
    outside: tuple[int, int]
    losses: tuple[Loss, ...]
    remarks: tuple[Remark, ...]

    def __repr__(self) -> str:
        path = self.job.output.path
        return f"<ConversionReport: {self.written:,} of {self.counts.read:,} rows in {path}>"

    @property
    def data_lost(self) -> bool:
        """Whether data could not be read or were omitted."""
        return bool(self.losses or self.counts.invalid)

    def provenance(self) -> Mapping[str, Any]:
        """Return the provenance of the output, JSON-ready."""
        job, signal, history = self.job, self.signal, self.signal.provenance
        source = {
            "path": self.path,
            "kind": self.kind,
            "name": signal.name,
            "type": signal.type_name,
            "clock": signal.clock,
            **self.digest.as_json(),
        }
        is_quaternion = job.representation == QUATERNION
        terms = {
            "representation": job.representation,
            **asdict(job.meaning),
            **({"layout": job.layout.name} if is_quaternion else {}),
            **{
                name: turn
                for name in ("relative_to", "left", "right")
                if (turn := getattr(job, name)) is not None
            },
            **({} if job.rate is None else {"rate_hz": str(job.rate)}),
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
            **self._time_range(),
            "normalize": job.source.normalize,
            "counts": as_json(self.counts),
            "losses": as_json(self.losses),
            "remarks": as_json(self.remarks),
        }
        convention = entry_of(history, "convention", dict)
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
            "conversions": [*entry_of(history, "conversions", list), step],
            "data_lost": bool(history.get("data_lost") or self.data_lost),
        }

    def _time_range(self) -> JsonObject:
        part = self.job.source.part
        if part.start is None and part.end is None:
            return {}
        start, end = (None if one is None else str(one) for one in (part.start, part.end))
        before, after = self.outside
        return {"time_range": {"start": start, "end": end, "before": before, "after": after}}
