"""One recording from log to attitude file: the whole way of the data, once.

This is where all rooms meet: reader, signal, timeline, propagation, writer. The command line and
batches of logs both come through here.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from itertools import chain, tee
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quatprop import __version__
from quatprop.conditioning import Conditioning, condition
from quatprop.errors import NoSamplesError, OutputError, UsageError
from quatprop.propagate import propagate, unit_q0
from quatprop.quaternion import geodesic_angle
from quatprop.readers import open_log
from quatprop.resample import Steady, at_times, every
from quatprop.sanity import Watch, orientation_remarks
from quatprop.selection import Selection
from quatprop.signal import UNITS, Source, choose
from quatprop.timeline import Policy, Timeline, remarks
from quatprop.writers import kind_of, layout_of, open_writer

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from fractions import Fraction

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.readers.base import Log
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.writers.ros_messages import Message

CONVENTION = {
    "product": "Hamilton, ij = k",
    "attitude": "body to reference: v_ref = q v_body q*",
    "body": "rates resolved in the body frame; q[k+1] = q[k] * dq[k]",
    "inertial": "rates resolved in the reference frame; q[k+1] = dq[k] * q[k]",
    "step": "dq = cos(|w| dt / 2) + w/|w| sin(|w| dt / 2)",
}
"""What the numbers mean, in the words that every output carries."""


@dataclass(frozen=True, slots=True)
class Job:
    """What to do with one log.

    Parameters
    ----------
    log
        Path of the log, or ``"-"``.
    output
        Path of the attitude series, or ``"-"`` for CSV on stdout.
    kind, to
        Kind of the log and of the output; None means told by content and suffix.
    selection
        Which samples.
    policy
        What the stamps are allowed to do.
    layout
        ``"scalar-first"`` or ``"scalar-last"``: the order of the columns written; None is what
        the format prescribes, or scalar-first where it leaves the choice.
    message
        What to write the attitudes as, where they are written as messages.
    comment
        Write the report in a comment at the beginning of the output.
    method
        Which samples rule an interval: a key of :data:`quatprop.increments.METHODS`.
    rates
        ``"body"`` or ``"inertial"``: the frame in which the rates are resolved.
    q0
        Attitude body -> reference at the first sample, wxyz.
    conditioning
        Bias, mounting and the part of the log to use.
    every
        Write every so-manieth attitude; None is all.
    rate
        Write attitudes so often a second, Hz, exact at those times; None is at the samples.
    """

    log: str
    output: str
    kind: str | None = None
    to: str | None = None
    selection: Selection = field(default_factory=Selection)
    policy: Policy = field(default_factory=Policy)
    layout: str | None = None
    message: Message | None = None
    comment: bool = False
    method: str = "start"
    rates: str = "body"
    q0: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)
    conditioning: Conditioning = field(default_factory=Conditioning)
    every: int | None = None
    rate: Fraction | None = None


def run(job: Job, tick: Callable[[int], None] = lambda _samples: None) -> dict[str, Any]:
    """Propagate one log and write its attitude series.

    Parameters
    ----------
    job
        What to do.
    tick
        Called with the number of samples written so far.

    Returns
    -------
    dict
        The report: what was read, done, counted and lost; JSON-ready.

    Raises
    ------
    LogError
        The log cannot be used as asked.
    OutputError
        The result cannot be written.
    """
    began = time.perf_counter()
    unit_q0(job.q0)
    _refuse_own_input(job)
    job = replace(job, layout=layout_of(kind_of(job.output, job.to), job.layout).name)
    if job.every is not None and job.rate is not None:
        raise UsageError("--every counts samples and --rate counts seconds; choose one")
    if job.log == "-" and job.conditioning.looks_ahead:
        raise UsageError(
            "stdin can be read only once: --bias static and relative --start and --end need a file"
        )
    with open_log(job.log, job.kind) as log:
        source = choose(log, job.selection)
        batches, conditioned = condition(source.batches, job.conditioning, UNITS[source.unit])
        timeline = Timeline(job.policy, job.log)
        run, watch = _Run(job, timeline), Watch()
        with open_writer(
            job.output, job.to, layout=job.layout, message=job.message, comment=job.comment
        ) as writer:
            rows = 0
            for series in run.attitudes(watch.passing(batches)):
                writer.write(series)
                rows += len(series)
                tick(timeline.counts.used)
            if not timeline.counts.used:
                raise NoSamplesError(job.log, source.name)
            report = _report(job, log, source, timeline, run.final)
            report["result"]["rows"] = rows
            report["result"]["method_difference_rad"] = run.method_difference
            report["remarks"] += watch.remarks(timeline.counts.median_dt_ns)
            if job.log != "-":
                report["remarks"] += orientation_remarks(log, source)
            report["conditioning"] = conditioned
            writer.commit(report)
    report["timings"] = {"seconds": time.perf_counter() - began}
    return report


class _Run:
    """The attitudes of one job as they are to be written, and the last one reached."""

    def __init__(self, job: Job, timeline: Timeline) -> None:
        self._job = job
        self._timeline = timeline
        self._times = None if job.rate is None else Steady(job.rate)
        self._other = "start" if job.method == "coning" else "coning"
        self.final = self._other_final = unit_q0(job.q0)

    def attitudes(self, batches: Iterable[GyroSeries]) -> Iterator[AttitudeSeries]:
        """Yield every attitude, or those that are wanted."""
        series = chain.from_iterable(map(self._wanted, self._timeline.stretches(batches)))
        return series if self._job.every is None else every(series, self._job.every)

    def _wanted(self, stretch: Iterator[GyroSeries]) -> Iterator[AttitudeSeries]:
        if self._times is None:
            return self._propagated(stretch)
        job = self._job
        return at_times(stretch, self._propagated, self._times, method=job.method, rates=job.rates)

    def _propagated(self, stretch: Iterable[GyroSeries]) -> Iterator[AttitudeSeries]:
        """Propagate one stretch; after a gap from q0, or from the attitude before it."""
        job = self._job
        if job.policy.on_gap == "split":
            self.final = self._other_final = unit_q0(job.q0)
        for_this, for_other = tee(stretch)
        this = propagate(for_this, q0=self.final, method=job.method, rates=job.rates)
        other = propagate(for_other, q0=self._other_final, method=self._other, rates=job.rates)
        for series, other_series in zip(this, other, strict=True):
            self.final, self._other_final = series.wxyz[-1], other_series.wxyz[-1]
            yield series

    @property
    def method_difference(self) -> float:
        """Angle between the ends of the coning method and of the one used, rad.

        It tells what the samples leave open: how the body turned between them. For coning it is
        held against start.
        """
        return float(geodesic_angle(self.final, self._other_final))


def _refuse_own_input(job: Job) -> None:
    """Refuse to replace the log by its own result."""
    if job.output == "-" or job.log == "-":
        return
    log, output = Path(job.log), Path(job.output)
    if log.exists() and output.exists() and log.samefile(output):
        raise OutputError(job.output, "this is the log itself; choose another output")


def _report(
    job: Job, log: Log, source: Source, timeline: Timeline, final: NDArray[np.float64]
) -> dict[str, Any]:
    counts = timeline.counts
    span_s = counts.span_ns * 1e-9
    return {
        "quatprop": __version__,
        "source": {
            "path": job.log,
            "kind": log.kind,
            "bytes": _size(job.log),
            "name": source.name,
            "type": source.type_name,
            "rate": source.rate,
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
            "method": job.method,
            "layout": job.layout,
            "time": "int64 nanoseconds",
            "q0_wxyz": unit_q0(job.q0).tolist(),
        },
        "policy": asdict(job.policy),
        "counts": asdict(counts),
        "losses": [asdict(loss) for loss in log.losses],
        "data_lost": bool(log.losses or counts.dropped),
        "remarks": [*source.remarks, *remarks(counts, job.policy)],
        "result": {
            "samples": counts.used,
            "first_ns": counts.first_ns,
            "last_ns": counts.last_ns,
            "span_s": span_s,
            "sample_rate_hz": (counts.used - 1) / span_s if span_s > 0 else None,
            "final_wxyz": final.tolist(),
            "net_rotation_rad": float(geodesic_angle(job.q0, final)),
            "turned_rad": counts.turned,
        },
    }


def _size(log: str) -> int | None:
    """Return the bytes of a log; of all its files where it is a folder."""
    path = Path(log)
    if path.is_dir():
        return sum(part.stat().st_size for part in path.iterdir() if part.is_file())
    return path.stat().st_size if path.is_file() else None
