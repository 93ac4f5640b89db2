"""Attitude series in files, read into memory or batch by batch."""

from __future__ import annotations

from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from quatprop.conditioning import GyroCorrection
from quatprop.errors import NoSamplesError, QuatpropError
from quatprop.logs.attitude_part import AttitudePart
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.attitudes import choose_attitudes
from quatprop.logs.signals.quaternion_check import QuaternionCheck, QuaternionCounts
from quatprop.series import AttitudeSeries
from quatprop.settings.reading import READ_ATTITUDES
from quatprop.settings.selection import AttitudeSelection
from quatprop.settings.values import parse_all
from quatprop.stores.objects import without_secret
from quatprop.text import Remark, Setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from quatprop.logs.signals.signal import AttitudeSignal
    from quatprop.provenance import JsonObject
    from quatprop.tables.log import Log, Loss


@dataclass(frozen=True, slots=True)
class AttitudeInput:
    """Which attitude series to read.

    `path`: any log or table with attitudes, or ``"-"``
        `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content, then
        suffix
    `normalize`: scale quaternions of any nonzero length to unit length
    `drop`: omit invalid quaternions instead of refusing the series
    `part`: time range to read, ends included
    `side`: side of a comparison, ``"a"`` or ``"b"``, for errors
    `positions`, `covariances`: also read those next to the attitudes, where there are any
    """

    path: str
    kind: str | None = None
    selection: AttitudeSelection = field(default_factory=AttitudeSelection)
    normalize: bool = False
    drop: bool = False
    part: GyroCorrection = field(default_factory=GyroCorrection)
    side: str = ""
    positions: bool = False
    covariances: bool = True


@dataclass(frozen=True, slots=True)
class ReadAttitudes:
    """Facts about an attitude series, after reading it.

    `first_ns`, `last_ns`: earliest and latest timestamp, ns
    `counts`: valid and invalid rows
    """

    input: AttitudeInput
    kind: str
    signal: AttitudeSignal
    samples: int
    first_ns: int
    last_ns: int
    counts: QuaternionCounts
    losses: tuple[Loss, ...]

    @property
    def data_lost(self) -> bool:
        """Whether any attitude was lost or invalid."""
        return bool(self.losses or self.counts.invalid)

    def report(self) -> JsonObject:
        """Return the facts, ready for JSON."""
        return {
            "path": self.input.path,
            "kind": self.kind,
            "name": self.signal.name,
            "type": self.signal.type_name,
            "quaternion": self.signal.field,
            "layout": self.signal.layout,
            "meaning": asdict(self.signal.meaning),
            "clock": self.signal.clock,
            "samples": self.samples,
            "first_ns": self.first_ns,
            "last_ns": self.last_ns,
            "rows": asdict(self.counts),
            "losses": [loss._asdict() for loss in self.losses],
            "remarks": list(self.signal.remarks),
        }


@dataclass(frozen=True, slots=True)
class LoadedAttitudes(ReadAttitudes):
    """An attitude series in memory, with its facts."""

    series: AttitudeSeries


def attitude_input(path: str, options: Mapping[str, object], side: str = "") -> AttitudeInput:
    """Return the attitude series to read, from settings by name."""
    values = parse_all(options, READ_ATTITUDES)
    return AttitudeInput(
        path,
        values.get("kind"),
        AttitudeSelection.of(values),
        normalize=values.get("normalize", False),
        drop=values.get("on_invalid") == "drop",
        part=GyroCorrection(start=values.get("start"), end=values.get("end")),
        side=side,
    )


def load_attitudes(wanted: AttitudeInput) -> LoadedAttitudes:
    """Read an attitude series into memory."""
    with open_attitudes(wanted) as file:
        return file.load(file.batches())


def open_attitudes(wanted: AttitudeInput) -> AttitudeFile:
    """Open an attitude series, to be read batch by batch."""
    with errors_of(wanted.side), ExitStack() as stack:
        log = stack.enter_context(
            open_log(wanted.path, wanted.kind, msg_path=wanted.selection.msg_path)
        )
        signal = choose_attitudes(log, wanted.selection)
        signal.refuse_placeholder(wanted.path, f"choose another {Setting('topic')}")
        return AttitudeFile(wanted, log, signal, stack.pop_all())


class AttitudeFile:
    """An attitude series in an open log, which a ``with`` block closes."""

    def __init__(
        self,
        wanted: AttitudeInput,
        log: Log,
        signal: AttitudeSignal,
        opened: ExitStack,
    ) -> None:
        self._opened = opened
        self.signal = signal
        self.read_once = str(log.path) == "-"
        self._wanted = wanted
        self._log = log
        self._part = AttitudePart(signal, wanted.part)
        self._check = QuaternionCheck(wanted.path)
        self._zeros = self._first_ns = self._last_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._opened.close()

    def batches(self) -> Iterator[AttitudeSeries]:
        """Read the valid attitudes, at least one, batch by batch; each call starts again."""
        wanted, signal = self._wanted, self.signal
        self._check = QuaternionCheck(wanted.path, normalize=wanted.normalize, drop=wanted.drop)
        rows = self._part.read(
            positions=wanted.positions and signal.has_positions,
            covariances=wanted.covariances and signal.may_have_covariances,
        )
        self._zeros = 0
        ends: list[int] = []
        with errors_of(wanted.side):
            for batch in self._check.apply(rows):
                self._zeros += int(np.count_nonzero(batch.t_ns == 0))
                ends += int(batch.t_ns.min()), int(batch.t_ns.max())
                yield batch
            if not ends:
                raise NoSamplesError(
                    wanted.path,
                    signal.name,
                    self._part.outside,
                    losses=self._log.losses,
                    length=self._part.length,
                )
        self._first_ns, self._last_ns = min(ends), max(ends)

    def load(self, batches: Iterator[AttitudeSeries]) -> LoadedAttitudes:
        """Return the series in memory."""
        series = replace(AttitudeSeries.gathered(batches), layout=self.signal.layout)
        facts = self.facts()
        named = {name: getattr(facts, name) for name in ReadAttitudes.__slots__}
        return LoadedAttitudes(**named, series=series)

    def facts(self) -> ReadAttitudes:
        """Return the facts, after all batches were read."""
        counts, signal = self._check.counts, self.signal
        found = *self._part.remarks(), *self._log.remarks
        signal = replace(signal, remarks=(*signal.remarks, *found))
        # One zero may be the start of the series.
        if signal.clock == "header" and self._zeros > 1:
            text = f"{self._zeros} of {counts.used} header timestamps are zero"
            remark = Remark("zero-stamps", text)
            signal = replace(signal, remarks=(*signal.remarks, remark))
        return ReadAttitudes(
            input=replace(self._wanted, path=without_secret(self._wanted.path)),
            kind=self._log.kind,
            signal=signal,
            samples=counts.used,
            first_ns=self._first_ns,
            last_ns=self._last_ns,
            counts=counts,
            losses=tuple(self._log.losses),
        )


@contextmanager
def errors_of(side: str) -> Iterator[None]:
    """Set the ``side`` of errors, which tells several inputs apart."""
    try:
        yield
    except QuatpropError as error:
        error.side = error.side or side
        raise
