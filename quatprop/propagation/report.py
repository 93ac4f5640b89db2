"""The report of a run, for the summary, the JSON report and the metadata of outputs."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from quatprop.provenance import Digest, JsonObject, as_json, digest_of
from quatprop.stores.objects import is_address, without_secret
from quatprop.stores.stored import digest_of_object
from quatprop.version import __version__
from quatprop.writers.atomic import OutputFile
from quatprop.writers.targets import output_errors

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.conditioning import GyroCorrectionReport
    from quatprop.pipeline.gyro_errors import UncertaintyReport
    from quatprop.tables.log import Log, Loss
    from quatprop.text import Remark
    from quatprop.timeline.counts import Counts, Policy

CONVENTION = {
    "product": "Hamilton, ij = k",
    "attitude": "body to reference: v_ref = q v_body q*",
    "body": "rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
    "inertial": "rates resolved in the reference frame; q[k+1] = dq[k] * q[k]",
    "step": "dq = cos(|w| dt / 2) + w/|w| sin(|w| dt / 2)",
}
"""The convention in every output."""


class SourceReport(NamedTuple):
    """Where the samples came from.

    `path`, `kind`: the log, and its format
    `digest`: its size and SHA-256
    `name`, `type`: topic and message type, or rate columns and dialect
    `rate`, `rate_unit`: the field or the columns that are the rate, and their unit
    `clock`: the source of the timestamps
    """

    path: str
    kind: str
    digest: Digest
    name: str
    type: str
    rate: str
    rate_unit: str
    clock: str


def digests_of_inputs(inputs: Mapping[str, str], log: Log | None) -> dict[str, Digest]:
    """Return the digests of the files that were read besides a log, by path.

    `log`: has the source of its message definitions; None for rates in memory
    """
    definitions = () if log is None else map(str, log.definition_files)
    paths = sorted((*inputs.values(), *definitions))
    return {without_secret(path): digest_of_input(path) for path in paths}


def digest_of_input(path: str) -> Digest:
    """Return the digest of a file, a folder or an object in a store."""
    return digest_of_object(path) if is_address(path) else digest_of(path)


class ConventionReport(NamedTuple):
    """What the numbers mean.

    `rates`: ``"body"`` or ``"inertial"``
    `method`: the integration rule that was used
    `method_from`: ``"given"``, ``"log"`` where it follows from what the samples are, or
        ``"default"``
    `samples`: what the samples are: ``"rates"`` at their timestamps, ``"averages"`` or
        ``"increments"`` over the intervals that end at them
    `layout`: order of the columns written; None if nothing was written
    `q0_wxyz`: initial attitude, at the first sample, scalar first
    `q0_from`: ``"given"``, ``"level"``, ``"log"`` or a file
    `earth_rate_rad_s`: the rotation of the reference frame that was removed, in its axes, rad/s;
        None if the reference frame is inertial
    `quaternion`: how the components form the quaternion
    `product`: the quaternion product, by its rule for i and j
    `attitude`: how the quaternion rotates a vector
    `step`: the rotation over one interval
    `time`: type and unit of the timestamps
    """

    rates: str
    method: str
    method_from: str
    samples: str
    layout: str | None
    q0_wxyz: NDArray[np.float64]
    q0_from: str
    earth_rate_rad_s: NDArray[np.float64] | None = None
    quaternion: str = "w + x i + y j + z k"
    product: str = CONVENTION["product"]
    attitude: str = CONVENTION["attitude"]
    step: str = CONVENTION["step"]
    time: str = "int64 nanoseconds"

    @property
    def side(self) -> str:
        """The side on which steps are multiplied, in words."""
        return CONVENTION[self.rates]


class ResultReport(NamedTuple):
    """What came out.

    `samples`, `rows`: samples propagated, and attitudes written
    `first_ns`, `last_ns`: their first and last timestamp, ns
    `span_s`: time between them, s
    `sample_rate_hz`: mean rate of the samples, Hz; None where they span no time
    `final_wxyz`: attitude at the last sample, scalar first
    `net_rotation_rad`: angle from the first to the last attitude, rad
    `method_sensitivity_rad`: method sensitivity: the angle between the final attitudes of this and
        the next better method, rad; None where it was not computed
    `next_method`: that method: for ``"cubic"`` and ``"quintic"`` the next lower one; over intervals
        at which ``"quintic"`` is ``"cubic"``, and where it is that throughout, ``"coning"``
    `sampling_sensitivity_rad`: angle between the final attitudes from all samples and from every
        second one, rad
    `path_angle_rad`: total angle traversed, rad
    """

    samples: int
    first_ns: int | None
    last_ns: int | None
    span_s: float
    sample_rate_hz: float | None
    rows: int
    final_wxyz: NDArray[np.float64]
    net_rotation_rad: float
    method_sensitivity_rad: float | None
    next_method: str | None
    sampling_sensitivity_rad: float | None
    path_angle_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class RunReport:
    """What was read, done, counted and lost in one run.

    Parameters
    ----------
    source, convention, policy, counts, conditioning, uncertainty, result
        The parts; of the uncertainty None if nothing is known of the gyroscope's errors, or the
        report is kept nowhere.
    settings
        What was requested, by the names of settings, as text.
    files
        Size and SHA-256 of the files that were read beside the log, by path; empty where the
        report is kept nowhere.
    losses
        What of the log could not be read.
    remarks
        What the user should know of.
    unchecked_chunks
        Chunks of which only selected messages were read, so that their checksums were not compared;
        not part of an output's metadata.
    seconds
        How long the run took, s; not part of an output's metadata.
    """

    source: SourceReport
    convention: ConventionReport
    policy: Policy
    counts: Counts
    losses: tuple[Loss, ...]
    remarks: tuple[Remark, ...]
    conditioning: GyroCorrectionReport
    uncertainty: UncertaintyReport | None
    result: ResultReport
    settings: Mapping[str, str | bool]
    files: Mapping[str, Digest] = field(default_factory=dict)
    unchecked_chunks: int = 0
    seconds: float | None = None

    def __repr__(self) -> str:
        # The whole report is pages long; as_json() has it.
        result, method = self.result, self.convention.method
        noted = f", {len(self.remarks)} remarks" * bool(self.remarks)
        lost = ", data lost" * self.data_lost
        return (
            f"<RunReport: {result.rows:,} attitudes of {result.samples:,} samples by method "
            f"{method}{noted}{lost}>"
        )

    @property
    def data_lost(self) -> bool:
        """Whether a part of the log could not be read, or samples were dropped."""
        return bool(self.losses or self.counts.dropped)

    def named(self, log: str, names: Mapping[str, str]) -> JsonObject:
        """Return the report as JSON without what depends on where files are: their paths, and ETag.

        `log`: name of the log
        `names`: path of another file -> its name
        """
        source = self.source._replace(path=log, digest=Digest(self.source.digest.bytes))
        longest = sorted(names.items(), key=lambda item: -len(item[0]))
        report = replace(self, source=source).as_json()
        return {**_renamed(report, longest)} if names else report

    def as_json(self) -> JsonObject:
        """Return the report as JSON: the content of a report file and of outputs' metadata."""
        report = {"quatprop": __version__, **as_json(self), "data_lost": self.data_lost}
        report["convention"]["side"] = self.convention.side
        unchecked, seconds = report.pop("unchecked_chunks"), report.pop("seconds")
        if seconds is None:
            return report
        return {**report, "unchecked_chunks": unchecked, "timings": {"seconds": seconds}}


def _renamed(value: Any, names: Sequence[tuple[str, str]]) -> Any:
    """Return JSON in which files are renamed, even in sentences."""
    if isinstance(value, dict):
        return {_renamed(key, names): _renamed(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_renamed(item, names) for item in value]
    if isinstance(value, str):
        for path, name in names:
            value = value.replace(path, name)
    return value


def convention_of(layout: str) -> JsonObject:
    """Return the metadata of attitudes of which only the convention is known."""
    stated = ("product", "attitude")
    convention = {name: CONVENTION[name] for name in stated} | {"layout": layout}
    return {"quatprop": __version__, "convention": convention}


class ReportFile:
    """A report as JSON, published only after everything else.

    `target`: a path, ``"-"`` for stdout, or None for nowhere
    """

    def __init__(self, target: str | None) -> None:
        self._output = None if target is None else OutputFile(target)

    def finish(self, report: Mapping[str, Any]) -> None:
        """Write the report."""
        if self._output is not None:
            with output_errors(self._output.target):
                self._output.stream.write((json.dumps(report, indent=2) + "\n").encode())
            self._output.finish()

    def publish(self) -> None:
        """Publish the report."""
        if self._output is not None:
            self._output.publish()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        if self._output is not None:
            self._output.discard()
