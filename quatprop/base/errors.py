"""The hierarchy of all errors that quatprop raises on purpose.

::

    QuatpropError                      exit code 2: wrong usage or unreadable input
    ├── UsageError                     the options contradict each other or the log
    │   └── SuiteError                 a suite of regressions that cannot be used as written
    ├── SeriesError                    arrays that are not a valid series
    ├── LogError                       a log that cannot be used as requested
    │   ├── UnreadableLogError         missing, empty, not permitted, not a file
    │   ├── UnknownFormatError         no reader recognises the content
    │   ├── UnsupportedLogError        recognised, but a feature of it is not
    │   ├── DamagedLogError            recognised, but nothing can be saved
    │   ├── SchemaError                a message definition that cannot be used
    │   ├── MessageError               a message that does not fit its definition
    │   ├── NoRatesError               nothing in the log carries body rates
    │   │   └── NoSignalsError         nothing carries attitudes either
    │   ├── NoAttitudesError           nothing in the log carries attitudes
    │   ├── NothingToDrawError         nothing in the log carries either
    │   ├── NotRotationsError          attitudes that are not rotations
    │   ├── NoSamplesError             the selected source, or the selected part, is empty
    │   ├── NoSuchTopicError           the requested topic is missing, or has no rates
    │   ├── AmbiguousTopicError        several topics carry rates and none was chosen
    │   ├── UndeclaredError            an undeclared unit, column or time
    │   └── TimelineError              timestamps or rates that a policy refuses
    ├── StoreError                     an object store cannot be used
    │   └── ReplacedError              a log was replaced while it was read
    ├── ComparisonError                two series cannot be compared as requested
    └── OutputError                    the output cannot be written

Each is a sentence with the place, the problem and the remedy. Settings in it are marks
(:func:`quatprop.base.text.Setting`), which each interface spells in its own way. Text from files is
escaped by :func:`quatprop.base.text.quoted`, so that it cannot control the terminal.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from copyreg import __newobj__  # type: ignore[attr-defined]
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from quatprop.base.text import Setting, listed, plain, quoted, spelled

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Iterator, Sequence


class QuatpropWarning(UserWarning):
    """Base class of the library's warnings."""


class DataLossWarning(QuatpropWarning):
    """A part of a log could not be read, or samples were dropped.

    Attributes
    ----------
    messages
        Number of lost messages or rows; None: unknown.
    """

    messages: int | None = None


class RemarkWarning(QuatpropWarning):
    """Something was inferred, or looks wrong.

    Attributes
    ----------
    code
        Kind of remark, such as ``"saturated"``; stable when the sentence changes.
    """

    code = ""


class QuatpropError(Exception):
    """Base class of all errors for the user: one sentence, no traceback.

    Parameters
    ----------
    reason
        The problem and, after a semicolon, the remedy; may contain marks of settings.

    Attributes
    ----------
    side
        The input that it is about, if several have the same settings: ``"a"`` or ``"b"`` of a
        comparison, ``"q0"`` or ``"at"`` of a propagation; empty otherwise.
    """

    side = ""

    def __init__(self, reason: str) -> None:
        self.reason = reason

    @property
    def text(self) -> str:
        """The sentence with marks of settings, which ``str`` spells."""
        return self.reason

    def __str__(self) -> str:
        return spelled(self.text, self.side)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the state for unpickling, independent of the arguments of ``__init__``."""
        return __newobj__, (type(self),), self.__dict__


class UsageError(QuatpropError):
    """The options contradict each other or ask for something that does not exist."""


class SuiteError(UsageError):
    """A suite of regressions that cannot be used as written.

    `reason`: the problem and, after a semicolon, the remedy
    `case`, `key`: the place in the suite, if any
    """

    def __init__(
        self, suite: Path | str, reason: str, case: str | None = None, key: str | None = None
    ) -> None:
        where = plain(suite)
        where += f", case {quoted(case)}" if case is not None else ""
        where += f", {quoted(key)}" if key is not None else ""
        super().__init__(f"{where}: {reason}")


class SeriesError(QuatpropError, ValueError):
    """Arrays are not a valid series (shape, dtype, length)."""


class StoreError(QuatpropError):
    """An object store cannot be used; the log is not damaged."""


class ReplacedError(StoreError):
    """A log was replaced while it was read, so the data may be a mixture of two logs."""


class LogError(QuatpropError):
    """A log cannot be used as requested."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(reason)
        self.path = path

    @property
    def text(self) -> str:
        """The sentence with the path of the log."""
        return f"{plain(self.path)}: {self.reason}"


class UnreadableLogError(LogError):
    """The file is missing, empty, not permitted, or not a file at all."""


class UnknownFormatError(LogError):
    """No reader recognises the content."""


class UnsupportedLogError(LogError):
    """The log is recognised, but uses a feature that this version does not read."""


class DamagedLogError(LogError):
    """The log is recognised, but so damaged that nothing can be read."""


class SchemaError(LogError):
    """A message definition cannot be used to find the requested fields."""


class MessageError(LogError):
    """A message does not fit its definition.

    `positions`: indices of the messages in the block, so that the caller can omit them
    """

    def __init__(self, path: Path | str, reason: str, positions: Iterable[int] = ()) -> None:
        super().__init__(path, reason)
        self.positions = tuple(positions)


class _NothingFoundError(LogError):
    """The log has no signal of the requested kind.

    `seen`: topics with their types, or columns, in the log
    `what`: ``"topics"`` or ``"columns"``
    `packed`: columns with several samples a row, which are not read
    """

    wanted: str
    field: str
    columns: str

    def __init__(
        self,
        path: Path | str,
        seen: Iterable[str],
        what: str = "topics",
        packed: Sequence[str] = (),
    ) -> None:
        self.seen, self.what, self.packed = tuple(seen), what, packed
        held = f"it has no {what} with messages"
        if names := listed(self.seen):
            topic = f"the field, or three as x,y,z, with {Setting('topic')} and {self.field}"
            remedy = topic if what == "topics" else f"the columns with {self.columns}"
            held = f"its {what} are {names}; name {remedy}"
        if packed:
            held = (
                f"its {what} are {names}; {listed(packed)} {'hold' if packed[1:] else 'holds'} "
                "several samples a row, which is not read: write one sample a row, each with its "
                "own time"
            )
        super().__init__(path, f"no {self.wanted} found; {held}")


class NoRatesError(_NothingFoundError):
    """The log has no body rates."""

    wanted, field = "body rates", Setting("rate_field")
    columns = f"{Setting('rate_cols')} and {Setting('time_col')}"


class NoSignalsError(NoRatesError):
    """The log has neither body rates nor attitudes."""

    wanted = "body rates or attitudes"
    columns = (
        f"{NoRatesError.columns}, or those of attitudes in convert, with {Setting('quat_cols')}"
    )


class NoAttitudesError(_NothingFoundError):
    """The log has no attitudes."""

    wanted, field = "attitudes", Setting("quat_field")
    columns = f"{Setting('quat_cols')}, {Setting('from_layout')} and {Setting('time_col')}"


class NothingToDrawError(_NothingFoundError):
    """The log has neither body rates nor attitudes."""

    wanted, field = "body rates or attitudes", f"{NoRatesError.field} or {NoAttitudesError.field}"
    columns = f"{Setting('rate_cols')} or {Setting('quat_cols')} and {Setting('time_col')}"


class NotRotationsError(LogError):
    """Attitudes are not rotations: zero, not of unit length, not numbers."""


MAX_LOSSES = 3
"""Number of losses that are named if there are no samples, as any of them may be the cause."""


class NoSamplesError(LogError):
    """The selected source has no samples, or none in the selected part of the log.

    `source`: topic or columns
    `outside`: number of samples before and after the part
    `dropped`: number of non-finite samples
    `losses`: places that could not be read, and why
    `length`: length of the log, if the part is relative to its ends
    """

    def __init__(  # noqa: PLR0913  # possible reasons
        self,
        path: Path | str,
        source: str,
        outside: Sequence[int] = (0, 0),
        dropped: int = 0,
        losses: Sequence[tuple[str, str, object]] = (),
        *,
        length: str = "",
    ) -> None:
        reason = "; look with info"
        if dropped:
            reason = f"; {dropped} with rates that are not finite were dropped"
        elif any(outside):
            hint = f"the log is {length} long" if length else "a number without a unit is in ns"
            reason = f" between {Setting('start')} and {Setting('end')}: {outside[0]} are before, "
            reason += f"{outside[1]} after; {hint}"
        elif losses:
            named = [f"{place}: {why}" for place, why, *_ in losses[:MAX_LOSSES]]
            reason = "; lost: " + "; ".join(named)
        super().__init__(path, f"no samples in {quoted(source)}{reason}")


class NoSuchTopicError(LogError):
    """The requested topic is not in the log, or has no signal of the requested kind."""


class AmbiguousTopicError(LogError):
    """Several topics have a signal of the requested kind, and none was selected."""


class UndeclaredError(LogError):
    """A fact that only the user knows is not declared.

    `unknown`: the fact, such as "the unit of the rates in columns 'gx', 'gy', 'gz'"; then also
        that it is not declared
    `remedy`: the setting that declares it, such as ``Setting("rate_unit", "rad/s|deg/s")``
    """

    def __init__(
        self, path: Path | str, unknown: str, remedy: str, *, several: bool = False
    ) -> None:
        self.unknown = f"{unknown} {'are' if several else 'is'} not declared"
        self.remedy = remedy
        them = "them" if several else "it"
        super().__init__(path, f"{self.unknown}; specify {them} with {remedy}")


class TimelineError(LogError):
    """Timestamps or rates are refused by a policy."""


class ComparisonError(QuatpropError):
    """Two attitude series cannot be compared as requested."""


class OutputError(QuatpropError):
    """The output cannot be written; `reason` as for :class:`LogError`."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"{plain(path)}: {reason}")
        self.path = path


def os_reason(error: OSError) -> str:
    """Return why a file cannot be read, as the end of a sentence."""
    match error:
        case FileNotFoundError():
            return "no such file or folder; check the path"
        case PermissionError():
            return "no permission to read it; check its owner and mode"
        case _:
            return f"it cannot be read: {quoted(error.strerror or error)}"


class Loss(NamedTuple):
    """A part of a damaged log that could not be read.

    `place`: where it is, such as "chunk at byte 4096" or "line 17"
    `reason`: why it could not be read
    `messages`: number of lost messages or rows; None: unknown
    """

    place: str
    reason: str
    messages: int | None = None


class Losses(list[Loss]):
    """Losses, each noted once even if the log is read several times."""

    def __init__(self) -> None:
        super().__init__()
        self._entries: dict[tuple[str, str], tuple[int, dict[Hashable, int]]] = {}

    def note(
        self, place: str, reason: str, messages: int | None = None, part: Hashable = None
    ) -> None:
        """Add a loss; with the same place and reason, messages of different parts add up."""
        number, counts = self._entries.setdefault((place, reason), (len(self), {}))
        if messages is not None:
            counts[part] = max(messages, counts.get(part, 0))
        loss = Loss(place, reason, sum(counts.values()) if counts else None)
        self[number : number + 1] = [loss]

    def restart(self, count: int) -> None:
        """Remove all but the first losses, before the log is read again."""
        earlier = self[:count]
        self.clear()
        self._entries.clear()
        for loss in earlier:
            self.note(loss.place, loss.reason, loss.messages)


# Convert errors of other packages and of the system to sentences.
#
# Readers and writers catch errors that they expect, where they know the record or the column. All
# others are converted here: while a log is open (:func:`as_errors_of`), and at the top of a run
# (:func:`as_user_error`). An error that is in no table is reported as a bug in quatprop.


TRACEBACK = "QUATPROP_TRACEBACK"
"""Environment variable: if set, bugs in quatprop are shown with their traceback."""

READING = {
    "apsw.Error": "its database cannot be used",
    "apsw.ext.QueryLimitNoException": "its database cannot be used",
    "google.protobuf.descriptor.Error": "its protobuf definitions cannot be used",
    "google.protobuf.descriptor_database.Error": "its protobuf definitions cannot be used",
    "google.protobuf.json_format.Error": "its protobuf messages cannot be used",
    "google.protobuf.message.Error": "its protobuf messages cannot be used",
    "google.protobuf.text_format.Error": "its protobuf definitions cannot be used",
    "mcap.exceptions.McapError": "its MCAP records cannot be used",
    "mcap.stream_reader.CRCValidationError": "its MCAP records cannot be used",
    "pyarrow._feather.FeatherError": "its columns cannot be used",
    "rosbags.highlevel.anyreader.AnyReaderError": "its bag cannot be used",
    "rosbags.rosbag1.reader.ReaderError": "its bag cannot be used",
    "rosbags.rosbag2.errors.ReaderError": "its bag cannot be used",
    "rosbags.serde.errors.SerdeError": "its messages cannot be used",
    "rosbags.typesys.base.TypesysError": "its message definitions cannot be used",
    "ruamel.yaml.error.YAMLError": "its metadata cannot be used",
    "ruamel.yaml.error.YAMLStreamError": "its metadata cannot be used",
    "zstandard.backend_c.ZstdError": "its compressed data cannot be used",
    "_csv.Error": "its rows cannot be used",
    "_lzma.LZMAError": "its compressed data cannot be used",
    "builtins.EOFError": "it ends early",
    "builtins.RecursionError": "it is nested too deeply",
    "builtins.UnicodeError": "it contains text in another encoding",
    "struct.error": "its records cannot be used",
    "zipfile.BadZipFile": "its archive cannot be used",
    "zlib.error": "its compressed data cannot be used",
}
"""Errors that only reading raises: full name of the class or a base class -> reason."""

ANYWHERE = {
    "builtins.MemoryError": "there is not enough memory",
    "builtins.OSError": "system error",
    "pyarrow.lib.ArrowException": "columns cannot be used",
    "rosbags.rosbag1.writer.WriterError": "a bag cannot be written",
    "rosbags.rosbag2.errors.WriterError": "a bag cannot be written",
}
"""The same for errors that reading or writing raises."""

MEMORY_HINT = "; choose fewer columns or topics, or a machine with more memory"


def _reason(error: BaseException, table: dict[str, str]) -> str | None:
    """Return the reason of an error from a table; None if it is not in it."""
    for kind in type(error).__mro__:
        name = f"{kind.__module__}.{kind.__qualname__}"
        if name in table:
            detail = getattr(error, "strerror", None) or str(error)
            reason = plain(f"{table[name]} ({detail})" if detail else table[name])
            return reason + MEMORY_HINT if isinstance(error, MemoryError) else reason
    return None


@contextmanager
def as_errors_of(path: Path | str) -> Iterator[None]:
    """Convert errors that only reading raises to a :class:`LogError` that names the log."""
    try:
        yield
    except QuatpropError:
        raise
    except OSError as error:
        if error.errno is not None:
            raise  # a system error, which names the file
        reason = plain(f"it cannot be read ({error}); check that it was copied whole")
        raise DamagedLogError(path, reason) from error
    except MemoryError as error:
        raise UnreadableLogError(path, str(_reason(error, ANYWHERE))) from error
    except Exception as error:
        if (read_error := _reason(error, READING)) is None:
            raise
        raise DamagedLogError(path, f"{read_error}; check that it was copied whole") from error


def as_user_error(error: Exception) -> QuatpropError | None:
    """Return an error with one sentence; None: raise the bug with its traceback."""
    if isinstance(error, QuatpropError):
        return error
    reason = _reason(error, READING | ANYWHERE)
    if reason is not None:
        file = getattr(error, "filename", None)
        return QuatpropError(
            f"{plain(file)}: {reason}" if file else reason[:1].upper() + reason[1:]
        )
    if os.environ.get(TRACEBACK):
        return None
    return QuatpropError(
        f"This is a bug in quatprop ({type(error).__name__}: {plain(error)}, "
        f"{_place(error)}); please report it, with the log if you can. {TRACEBACK}=1 shows more"
    )


def _place(error: Exception) -> str:
    """Return the innermost line of quatprop in the traceback of an error."""
    from traceback import extract_tb

    ours = [
        line for line in extract_tb(error.__traceback__) if "quatprop" in Path(line.filename).parts
    ]
    if not ours:
        return "before its first line"
    return f"{'/'.join(Path(ours[-1].filename).parts[-2:])} line {ours[-1].lineno}"
