"""The sources of rotation in logs: every gyroscope and every orientation, in memory.

All reading of logs is here. An undeclared property is a hypothesis: a unit is taken as rad/s
and a layout as scalar-first, and the comparison decides.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from quatprop.base.errors import (
    LogError,
    Loss,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    QuatpropError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.places import without_secret
from quatprop.base.rendering import count_text
from quatprop.base.text import Remark, plain
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.propagation.rate_stream import OF_ATTITUDE, RateSettings, RateStream
from quatprop.propagation.recording import open_recording
from quatprop.readers.attitude_quality import QuaternionCheck
from quatprop.readers.attitude_signals import attitude_candidates
from quatprop.readers.containers.transforms import TransformTable
from quatprop.readers.open_log import is_stream
from quatprop.readers.rate_signals import rate_candidates
from quatprop.readers.signal import ATTITUDES, BODY_RATES, choose
from quatprop.settings.reading import AttitudeSelection, RateSelection
from quatprop.stores.objects import split_topic
from quatprop.timeline.counts import Policy
from quatprop.timeline.stamps import marked

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from quatprop.base.arrays import Float64, Int64
    from quatprop.propagation.recording import Recording
    from quatprop.readers.signal import AttitudeSignal, Candidate, RateSignal


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Source:
    """One source of rotation in memory, in the order of its timestamps.

    `name`: unique: the topic or the file, with what it is where that has several sources
    `kind`: ``"rates"`` or ``"orientation"``
    `device`: one rigid body on one clock: the topic, the file or the pair of frames
    `type`: message type, or program that wrote a table; may be ``""``
    `t_ns`: rising timestamps, ns, shape ``(N,)``
    `values`: rates, rad/s, shape ``(N, 3)``, or attitudes, wxyz, shape ``(N, 4)``
    `is_average`: whether each rate is the average over the interval before its timestamp
    `is_message`: whether one message has all sources of the device
    `measured`: whether it is a measurement, not an estimate or a command
    `frames`: parent and child, of a transform
    `has_axes`: whether its body axes are known, up to its mounting
    `layout`: order in which an orientation is stored
    `assumed`: hypotheses where the log declares nothing: setting -> value
    `corrected`: how else than the log says it is read: setting -> value
    `omitted`: rows that are left out: invalid ones, those whose timestamps go backwards or far
        ahead, and those that repeat a timestamp, which nothing depends on
    """

    name: str
    kind: str
    device: str
    t_ns: Int64
    values: Float64
    type: str = ""
    is_average: bool = False
    is_message: bool = True
    measured: bool = True
    frames: tuple[str, str] | None = None
    layout: str = ""
    has_axes: bool = True
    assumed: Mapping[str, str] = field(default_factory=dict)
    corrected: Mapping[str, str] = field(default_factory=dict)
    omitted: tuple[int, int, int] = (0, 0, 0)

    @property
    def is_rates(self) -> bool:
        """Whether these are the rates of a gyroscope."""
        return self.kind == "rates"

    @property
    def interval(self) -> float:
        """The median of the first intervals, s; 0 of fewer than three samples."""
        steps = np.diff(self.t_ns[:INTERVAL_SAMPLES])
        return float(np.median(steps)) * 1e-9 if len(steps) > 1 else 0.0

    @property
    def span(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.t_ns[-1] - self.t_ns[0]) * 1e-9 if len(self.t_ns) else 0.0


INTERVAL_SAMPLES: Final = 1 << 16
"""Samples whose median interval is that of a source."""


class Unread(NamedTuple):
    """A source that could not be read; `reason`: a sentence with the remedy."""

    name: str
    reason: str


class Sources(NamedTuple):
    """All sources of some logs.

    `losses`: parts of the logs that could not be read, and omitted samples
    `remarks`: on logs and sources, each with its name first
    """

    found: list[Source]
    unread: list[Unread]
    losses: list[Loss]
    remarks: list[Remark]


JUDGED: Final = OF_ATTITUDE | {
    *("beyond-range", "unit-by-steps", "rates-off-scale", "rates-contradict", "other-frame"),
    *("other-axes", "orientation-invalid", "zero-rates", "frozen", "held-samples", "too-slow"),
    *("coning-added", "method-unused", "method-differs", "increments", "bursts"),
    *("frames-by-type", "angle-sequence", "ignored-signals", "placeholder"),
    "inverse-orientation",
}
"""Codes of remarks that the comparison itself settles, or does not depend on."""

LEAVE_OUT: Final = RateSettings(Policy(on_backwards="drop", on_nonfinite="drop"))
"""Policies for rates: unusable ones are omitted, and counted."""


def read_sources(names: Sequence[str], values: Mapping[str, Any]) -> Sources:
    """Read every source of rotation of logs, ``LOG`` or ``LOG:TOPIC``.

    `values`: parsed settings for reading
    """
    read = Sources([], [], [], [])
    for name in names:
        if is_stream(name):
            raise UsageError("crosscheck reads a log more than once, so not from stdin; save it")
    paths = [without_secret(split_topic(name)[0]) for name in names]
    for name, label in zip(names, _labels(paths), strict=True):
        with open_recording(
            [name], RateSelection.from_settings(values), values.get("kind")
        ) as recording:
            topic, path = recording.selection.topic, recording.name
            wanted = {**values, "topic": topic}
            of_log = _OfLog(recording, label, wanted, with_path=len(names) > 1)
            found = [*of_log.sources()]
            read.unread.extend(of_log.unread)
            read.remarks.extend(of_log.remarks())
            read.losses.extend(of_log.losses())
        if not found and not of_log.unread and topic is not None:
            raise NoSuchTopicError(path, f"no topic {topic!r} that carries rates or attitudes")
        read.found.extend(found)
    return read._replace(found=_with_unique_names(read.found))


def _labels(paths: Sequence[str]) -> list[str]:
    """Return a name for each log: that of the file, or the path where others have that name."""
    short = {path: Path(path).name or path for path in paths}
    several = Counter(short.values())
    return [path if several[short[path]] > 1 else short[path] for path in paths]


class _OfLog:
    """The sources of one open log."""

    def __init__(
        self, recording: Recording, label: str, values: Mapping[str, Any], *, with_path: bool
    ) -> None:
        self._recording, self._log = recording, recording.tables
        self._label = label
        self._values = values
        self._with_path = with_path
        self.unread: list[Unread] = []
        self._left_out: list[Loss] = []
        self._remarks: dict[str, Remark] = {}

    def losses(self) -> Iterator[Loss]:
        """Yield what could not be read, with the name of the file where several are read."""
        for loss in self._recording.losses:
            place = f"{self._label}, {loss.place}" if self._with_path else loss.place
            yield loss._replace(place=place)
        yield from self._left_out

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on the log, and on its sources."""
        for remark in self._recording.remarks:
            self._remark(self._label, [remark])
        yield from self._remarks.values()

    def _remark(self, place: str, remarks: Iterable[Remark]) -> None:
        """Note remarks on a source, without those on what the comparison decides."""
        of_log = {*self._recording.remarks} if place != self._label else set()
        for one in remarks:
            if one.code not in JUDGED and one not in of_log:
                remark = Remark(one.code, f"{plain(place)}: {one}")
                self._remarks[remark] = remark

    def _omitted(self, source: Source, reason: str = "") -> Source:
        """Note the samples of a source that are left out; return it."""
        invalid, backwards, _ = source.omitted
        count = len(source.t_ns) + sum(source.omitted)
        reasons = [reason or f"{invalid} are not finite"] if invalid else []
        if backwards:
            reasons.append(f"{count_text(backwards, 'timestamp')} out of order")
        if reasons:
            lost = f"{invalid + backwards} of {count} samples are left out: {', '.join(reasons)}"
            self._left_out.append(Loss(f"{source.name} {source.kind}", lost, invalid + backwards))
        return source

    def sources(self) -> Iterator[Source]:
        """Yield every source that can be read; note the others."""
        log = self._log
        rates = RateSelection.from_settings(self._values)
        attitudes = AttitudeSelection.from_settings(self._values)
        for group in _groups(self._candidates(partial(rate_candidates, log, rates))):
            yield from self._rates(*group, rates)
        for group in _groups(self._candidates(partial(attitude_candidates, log, attitudes))):
            yield from self._attitudes(*group, attitudes)

    def _candidates(self, list_them: Callable[[], list[Candidate[Any]]]) -> list[Candidate[Any]]:
        try:
            return list_them()
        except (NoRatesError, NoAttitudesError, NoSuchTopicError):
            return []
        except (LogError, UsageError) as error:
            self._skip(self._label, error)
            return []

    def _skip(self, name: str, error: QuatpropError) -> None:
        """Note a source that is not read; columns that are named are those of another file."""
        is_named = not {"rate_cols", "quat_cols"}.isdisjoint(self._values)
        if self._with_path and is_named and isinstance(error, UsageError):
            return
        reason = error.reason if isinstance(error, LogError) else str(error)
        self.unread.append(Unread(name, reason))

    def _place(self, candidate: Candidate[Any], detail: str = "") -> str:
        """Return the device of a candidate: topic, frames or file."""
        topic = candidate.topic
        name = f"{self._label}:{topic}" if topic and self._with_path else topic or self._label
        return f"{name} {detail}" if detail else name

    def _rates(
        self, group: list[Candidate[RateSignal]], field: str, selection: RateSelection
    ) -> Iterator[Source]:
        place, assumed = self._place(group[0]), {}
        try:
            try:
                signal = choose(self._log, group, BODY_RATES)
            except UndeclaredError:
                if selection.rate_unit is not None:
                    raise
                assumed = {"rate_unit": "rad/s"}
                again = rate_candidates(self._log, replace(selection, rate_unit="rad/s"))
                signal = choose(self._log, _same(again, group[0]), BODY_RATES)
            stream = RateStream(self._recording, LEAVE_OUT, signal)
            series = GyroSeries.gathered(stream)
        except NoRatesError:
            return
        except (LogError, UsageError) as error:
            self._skip(place, error)
            return
        name, counts = f"{place} {field}".strip(), stream.counts
        self._remark(name, stream.remarks())
        backwards = counts.backwards.count + counts.outliers.count
        source = _source(
            series,
            name=name,
            omitted=(counts.nonfinite.count, backwards),
            kind="rates",
            device=place,
            type=signal.type_name,
            is_average=series.is_interval_average or series.integration_time_ns is not None,
            is_message=bool(group[0].topic),
            measured=group[0].preferred,
            assumed=assumed,
        )
        yield self._omitted(source)

    def _attitudes(
        self, group: list[Candidate[AttitudeSignal]], field: str, selection: AttitudeSelection
    ) -> Iterator[Source]:
        table, place = group[0].found.table, self._place(group[0])
        if not isinstance(table, TransformTable) or selection.frame is not None:
            yield from self._orientation(group, field, selection, place)
            return
        try:
            pairs = table.pairs_of_frames()
        except LogError as error:
            self._skip(place, error)
            return
        for frames in pairs:
            chosen = replace(selection, frame=":".join(frames))
            every = self._candidates(partial(attitude_candidates, self._log, chosen))
            place = self._place(group[0], ":".join(frames))
            yield from self._orientation(_same(every, group[0]), "", chosen, place, frames)

    def _orientation(
        self,
        group: list[Candidate[AttitudeSignal]],
        field: str,
        selection: AttitudeSelection,
        place: str,
        frames: tuple[str, str] | None = None,
    ) -> Iterator[Source]:
        assumed: dict[str, str] = {}
        check = QuaternionCheck(self._log.path, drop=True)
        try:
            try:
                signal = choose(self._log, group, ATTITUDES)
            except UndeclaredError:
                if selection.from_layout is not None:
                    raise
                assumed = {"from_layout": "scalar-first"}
                again = replace(selection, from_layout="scalar-first")
                every = attitude_candidates(self._log, again)
                signal = choose(self._log, _same(every, group[0]), ATTITUDES)
            rows = ((t_ns, wxyz) for t_ns, wxyz, *_ in signal.read())
            batches = [*check.apply(rows)]
        except NoAttitudesError:
            return
        except (LogError, UsageError) as error:
            self._skip(place, error)
            return
        if not batches:
            if check.counts.not_finite < check.counts.samples_read:  # else absent throughout
                self.unread.append(Unread(f"{place} {field}".strip(), check.counts.summary))
            return
        name = f"{place} {field}".strip()
        self._remark(name, signal.remarks)
        source = _source(
            AttitudeSeries.joined(batches),
            name=name,
            kind="orientation",
            device=place,
            type=signal.type_name,
            is_message=bool(group[0].topic),
            measured=group[0].preferred,
            frames=frames,
            layout=signal.layout,
            assumed=assumed,
            omitted=(check.counts.invalid, 0),
        )
        yield self._omitted(source, check.counts.reasons)


def _groups(found: Sequence[Candidate[Any]]) -> Iterator[tuple[list[Candidate[Any]], str]]:
    """Yield the definitions of each topic and field, and the field where a topic has several."""
    fields: dict[str, dict[str, list[Candidate[Any]]]] = {}
    for one in found:
        fields.setdefault(one.topic, {}).setdefault(one.field, []).append(one)
    for groups in fields.values():
        for field_name, group in groups.items():
            yield group, field_name if len(groups) > 1 else ""


def _same(every: Iterable[Candidate[Any]], wanted: Candidate[Any]) -> list[Candidate[Any]]:
    return [one for one in every if (one.topic, one.field) == (wanted.topic, wanted.field)]


def _source(series: GyroSeries | AttitudeSeries, **facts: Any) -> Source:
    """Return a source without rows that are not finite, repeat a timestamp or go backwards.

    `omitted`: of the facts: rows that are left out already, invalid and out of order
    """
    t_ns = series.t_ns
    values = series.rate if isinstance(series, GyroSeries) else series.wxyz
    invalid, backwards = facts.pop("omitted", (0, 0))
    # Whole columns first: most logs have nothing to leave out.
    if not np.isfinite(values.sum()):
        finite = np.isfinite(values).all(axis=1)
        t_ns, values = t_ns[finite], values[finite]
        invalid += int((~finite).sum())
    repeated = 0
    if len(t_ns) > 1 and not (t_ns[1:] > t_ns[:-1]).all():
        # First, since all after a timestamp far ahead are earlier than that.
        ((_, outliers, _),) = marked([t_ns], lambda stamps: stamps)
        reached = np.maximum.accumulate(np.where(outliers, t_ns.min(), t_ns))
        back = outliers | (t_ns < reached)
        rising = ~back
        rising[1:] &= t_ns[1:] > reached[:-1]
        backwards += int(back.sum())
        repeated = int((~back & ~rising).sum())
        t_ns, values = t_ns[rising], values[rising]
    return Source(t_ns=t_ns, values=values, omitted=(invalid, backwards, repeated), **facts)


def _with_unique_names(sources: list[Source]) -> list[Source]:
    """Return sources with unique names: with the kind, where a device has several, and a number."""
    several = Counter(one.name for one in sources)
    names = [f"{one.name} {one.kind}" if several[one.name] > 1 else one.name for one in sources]
    seen: Counter[str] = Counter()
    unique = []
    for source, name in zip(sources, names, strict=True):
        seen[name] += 1
        number = f" {seen[name]}" if seen[name] > 1 else ""
        unique.append(replace(source, name=name + number))
    return unique


def sources_of(
    logs: Sequence[str | GyroSeries | AttitudeSeries], values: Mapping[str, Any]
) -> Sources:
    """Return every source of rotation in logs, and series in memory, each a device of its own.

    `values`: parsed settings for reading
    """
    read = read_sources([one for one in logs if isinstance(one, str)], values)
    series = [one for one in logs if not isinstance(one, str)]
    in_memory = [_of_series(one, f"series {k}") for k, one in enumerate(series, 1)]
    return read._replace(found=[*read.found, *in_memory])


def _of_series(series: GyroSeries | AttitudeSeries, name: str) -> Source:
    if not len(series):
        raise UsageError(f"{name} has no samples")
    is_rates = isinstance(series, GyroSeries)
    return _source(
        series,
        name=name,
        kind="rates" if is_rates else "orientation",
        device=name,
        is_average=isinstance(series, GyroSeries) and series.is_integrated("cubic"),
        is_message=False,
        layout="" if is_rates else "scalar-first",
    )
