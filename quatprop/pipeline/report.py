"""What a run says of itself: the JSON report, which is also the metadata of its output."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop import __version__
from quatprop.containers.remote import without_secret
from quatprop.kinematics.quaternion import geodesic_angle
from quatprop.provenance import as_json
from quatprop.timeline.counts import remarks
from quatprop.writers.atomic import Output, reported

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Self

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.base import Log
    from quatprop.pipeline.job import Job
    from quatprop.signals.signal import RateSignal
    from quatprop.text import Text
    from quatprop.timeline import Timeline

CONVENTION = {
    "product": "Hamilton, ij = k",
    "attitude": "body to reference: v_ref = q v_body q*",
    "body": "rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
    "inertial": "rates resolved in the reference frame; q[k+1] = dq[k] * q[k]",
    "step": "dq = cos(|w| dt / 2) + w/|w| sin(|w| dt / 2)",
}
"""What the numbers mean, in the words that every output carries."""


class RunResult(NamedTuple):
    """What a job has come to.

    Parameters
    ----------
    log, source
        Where the samples came from.
    timeline
        What was seen of time.
    conditioned
        What was done to the rates, JSON-ready.
    q0, final
        Attitudes at the first and at the last sample, wxyz.
    method_sensitivity_rad
        Angle between the final attitudes of this and another method, rad; None where nobody asked.
    rows
        Attitudes written.
    remarks
        What looks wrong.
    fingerprint
        Bytes and SHA-256 of the log; see :func:`quatprop.provenance.fingerprint`.
    """

    log: Log
    source: RateSignal
    timeline: Timeline
    conditioned: dict[str, Any]
    q0: NDArray[np.float64]
    final: NDArray[np.float64]
    method_sensitivity_rad: float | None
    rows: int
    remarks: Sequence[str | Text]
    fingerprint: dict[str, Any]


class ReportFile:
    """A report as JSON, in its place only when everything else is.

    Parameters
    ----------
    target
        A path, ``"-"`` for stdout, or None for nowhere.

    Raises
    ------
    OutputError
        The target cannot be written; told before anything is computed.
    """

    def __init__(self, target: str | None) -> None:
        self._output = None if target is None else Output(target)

    def commit(self, report: dict[str, Any]) -> None:
        """Write the report and put it in its place."""
        if self._output is not None:
            with reported(self._output.target):
                self._output.stream.write((json.dumps(as_json(report), indent=2) + "\n").encode())
            self._output.commit()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._output is not None:
            self._output.discard()


def report_on(job: Job, done: RunResult) -> dict[str, Any]:
    """Return the report on a job: what was read, done, counted and lost; JSON-ready."""
    log, source, timeline = done.log, done.source, done.timeline
    counts = timeline.counts
    span_s = counts.span_ns * 1e-9
    return {
        "quatprop": __version__,
        "source": {
            "path": without_secret(job.log),
            "kind": log.kind,
            **done.fingerprint,
            "name": source.name,
            "type": source.type_name,
            "rate": source.field,
            "rate_unit": source.unit,
            "clock": source.clock,
        },
        "convention": {
            "quaternion": "w + x i + y j + z k",
            "product": CONVENTION["product"],
            "attitude": CONVENTION["attitude"],
            "step": CONVENTION["step"],
            "rates": job.rates,
            "side": CONVENTION[job.rates],
            "method": source.integration_rule(job.method),
            "layout": job.layout,
            "time": "int64 nanoseconds",
            "q0_wxyz": done.q0.tolist(),
            "q0_from": job.q0.words or "given",
        },
        "policy": asdict(job.policy),
        "counts": asdict(counts),
        "losses": [asdict(loss) for loss in log.losses],
        "data_lost": bool(log.losses or counts.dropped),
        "remarks": [
            *source.remarks,
            *source.method_remarks(job.method),
            *remarks(counts, job.policy),
            *done.remarks,
            *log.remarks,
        ],
        "conditioning": done.conditioned,
        "result": {
            "samples": counts.used,
            "first_ns": counts.first_ns,
            "last_ns": counts.last_ns,
            "span_s": span_s,
            "sample_rate_hz": (counts.used - 1) / span_s if span_s > 0 else None,
            "rows": done.rows,
            "final_wxyz": done.final.tolist(),
            "net_rotation_rad": float(geodesic_angle(done.q0, done.final)),
            "method_sensitivity_rad": done.method_sensitivity_rad,
            "path_angle_rad": counts.path_angle_rad,
        },
    }
