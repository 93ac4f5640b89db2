"""A recording, opened once for whatever reads it: commands, functions, suites and second inputs.

:class:`quatprop.propagation.rate_stream.RateStream` has its rates after all stages, and
:class:`quatprop.propagation.attitude_input.RecordedAttitudes` its attitudes.
"""

from __future__ import annotations

from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from quatprop.base.errors import (
    LogError,
    Loss,
    Losses,
    NoRatesError,
    QuatpropError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.places import is_address, without_secret
from quatprop.base.text import MARK, Remark, did_you_mean, listed, plain
from quatprop.readers.attitude_signals import choose_attitudes
from quatprop.readers.open_log import open_log, open_logs
from quatprop.readers.rate_signals import choose_rates, signal_of_series
from quatprop.settings.reading import AttitudeSelection, RateSelection
from quatprop.stores.objects import split_topic, split_topics

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.base.provenance import Digest
    from quatprop.kinematics.series import GyroSeries
    from quatprop.readers.signal import AttitudeSignal, RateSignal
    from quatprop.readers.tables.model import Log


class ReadInput(NamedTuple):
    """The losses and remarks of an input that was read.

    `dropped`: number of rows that were left out
    """

    name: str
    losses: Sequence[Loss] = ()
    remarks: Sequence[Remark] = ()
    dropped: int = 0

    @property
    def data_lost(self) -> bool:
        """Whether a part of it was not read, or left out."""
        return bool(self.losses or self.dropped)


class Recording:
    """An open recording, or rates in memory.

    `paths`: its files; none for rates in memory
    `log`: its tables; None for rates in memory
    `selection`: which of its rates and attitudes are read
    `other_losses`, `other_remarks`: losses of files read with it, and remarks on them
    """

    def __init__(
        self,
        paths: Sequence[str],
        log: Log | None,
        selection: RateSelection | None = None,
        series: GyroSeries | None = None,
    ) -> None:
        self.paths, self.log = paths, log
        self.selection = selection or RateSelection()
        self._series = series
        self.other_losses: list[tuple[str, Loss]] = []
        self.other_remarks: list[Remark] = []

    @property
    def name(self) -> str:
        """Its path or paths, for errors and reports."""
        return " + ".join(self.paths) or "series"

    @property
    def kind(self) -> str:
        """Its kind: a key of :data:`quatprop.stores.kinds.READERS`, or ``"series"``."""
        return "series" if self.log is None else self.log.kind

    @property
    def is_stream(self) -> bool:
        """Whether it is text on stdin, which can be read only once; binary logs are copied."""
        return self.log is not None and str(self.log.path) == "-"

    @property
    def log_losses(self) -> Sequence[Loss]:
        """Losses of the recording itself."""
        return () if self.log is None else tuple(self.log.losses)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """Losses of the recording, and of files read with it."""
        told = [] if self.log is None else [*(self.log.joined or (self.log,))]
        of_files = Losses()
        for path, loss in self.other_losses:
            # Those of the log itself, if it is also read next to it, are not told again.
            if not any(loss in part.losses and _is_of(part, path) for part in told):
                place = f"{plain(without_secret(path))}, {loss.place}"
                of_files.note(*loss._replace(place=place))
        return (*self.log_losses, *of_files)

    @property
    def remarks(self) -> tuple[Remark, ...]:
        """Remarks on the recording itself, and on files next to it."""
        return (*(() if self.log is None else self.log.remarks), *self.other_remarks)

    @property
    def unchecked_chunks(self) -> int:
        """Number of chunks whose checksum was not tested."""
        return 0 if self.log is None else self.log.unchecked_chunks

    @property
    def stored_digest(self) -> Digest | None:
        """Size and ETag of the recording in an object store; None if it is not in one."""
        stored = None if self.log is None else self.log.stored
        return None if stored is None else stored.digest

    def confirm(self) -> None:
        """Refuse a recording that was replaced in its store since it was opened."""
        if self.log is not None:
            self.log.confirm()

    @property
    def tables(self) -> Log:
        """The open log; refuses rates in memory, which have none."""
        if self.log is None:
            raise UsageError("rates in memory are no log")
        return self.log

    def rate_signal(self) -> RateSignal:
        """Return the selected body rates as they were recorded."""
        if self.log is not None:
            return choose_rates(self.log, self.selection)
        if self._series is None:
            raise NoRatesError(self.name, (), "series")
        return signal_of_series(self._series)

    def attitude_signal(self, wanted: AttitudeSelection) -> AttitudeSignal:
        """Return attitudes as they were recorded, of the selected topic."""
        topic = wanted.topic or self.selection.topic
        return choose_attitudes(self.tables, replace(wanted, topic=topic))

    @contextmanager
    def second_input(self, name: str, otherwise: str, side: str = "") -> Iterator[Recording]:
        """Open what a setting names: a file or ``LOG:TOPIC``, or a topic of this recording.

        What a file lacks is noted as a loss of this recording, after it was read.

        `otherwise`: the error if there is neither
        `side`: tells errors of this input from those of others
        """
        path, topic = split_topic(name)
        is_own = [*self.paths] == [path]
        is_file = is_own or Path(path).exists() or is_address(path)
        if not is_file and (self.log is None or not self.log.tables(name)):
            raise UsageError(f"{otherwise}a file{self._no_topic(name)}")
        with errors_of(side):
            if is_own or not is_file:
                yield self._of_topic(topic if is_file else name)
                return
            with open_log(path) as log:
                try:
                    yield Recording((path,), log, RateSelection(topic=topic))
                except UndeclaredError as error:
                    # Others name the command that writes the file again.
                    if side or MARK not in error.remedy or is_typed(log):
                        raise
                    raise stated_in_header(error) from None
                place = plain(without_secret(path))
                self.other_losses += ((path, loss) for loss in log.losses)
                self.other_remarks += [Remark(one.code, f"{place}: {one}") for one in log.remarks]

    def _no_topic(self, name: str) -> str:
        """Return the end of the error on what is no topic, with the topics that may be meant."""
        if self.log is None:
            return ""
        topics = [table.name for table in self.log.tables()]
        several = listed(topic for topic in topics if topic.rpartition("/")[0] == name)
        hint = f"; choose one of {several}" if several and name else did_you_mean(name, topics)
        return f" or a topic of the log{hint}"

    def _of_topic(self, topic: str | None) -> Recording:
        """Return another topic of this recording, on the clock of its rates."""
        selection = RateSelection(topic=topic, clock=self.selection.clock)
        return Recording(self.paths, self.log, selection, self._series)


def is_typed(log: Log) -> bool:
    """Return whether a log holds messages."""
    return any(table.is_typed for table in log.tables())


def stated_in_header(error: UndeclaredError) -> LogError:
    """Return the error for a table beside the log of which a fact is not declared."""
    return LogError(
        error.path,
        f"{error.unknown}, and options for the rates do not apply to it; state it in the names of "
        "its columns, such as time_s or gyro_bias_x (rad/s)",
    )


@contextmanager
def errors_of(side: str) -> Iterator[None]:
    """Set the ``side`` of errors, which tells several inputs apart."""
    try:
        yield
    except QuatpropError as error:
        error.side = error.side or side
        raise


@contextmanager
def open_recording(
    names: Sequence[str], selection: RateSelection | None = None, kind: str | None = None
) -> Iterator[Recording]:
    """Open a recording in one file or several, as a context manager.

    `names`: files, ROS 2 bag folders, addresses in object stores, each possibly ``LOG:TOPIC``, or
        ``"-"``
    `selection`: which rates to read, their units and timestamps
    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content, then
        suffix
    """
    selection = selection or RateSelection()
    paths, topic = split_topics(names, selection.topic)
    with open_logs(paths, kind, msg_path=selection.msg_path) as log:
        yield Recording(paths, log, replace(selection, topic=topic))


def recording_of(series: GyroSeries) -> Recording:
    """Return rates in memory as a recording."""
    return Recording((), None, series=series)


def _is_of(log: Log, path: str) -> bool:
    """Return whether a log is that of a file, however its path is spelled."""
    with suppress(OSError):
        return log.path.samefile(path)
    return str(log.path) == path
