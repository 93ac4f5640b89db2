"""Every error quatprop raises on purpose, in one hierarchy.

::

    QuatpropError                      exit code 2: wrong usage or unreadable input
    ├── UsageError                     the options contradict each other or the log
    │   └── SuiteError                 a suite of regressions that cannot be used as written
    ├── SeriesError                    arrays that are not the series they claim to be
    ├── LogError                       a log that cannot be used as asked
    │   ├── UnreadableLogError         missing, empty, not permitted, not a file
    │   ├── UnknownFormatError         no reader recognises the content
    │   ├── UnsupportedLogError        recognised, but a feature of it is not
    │   ├── DamagedLogError            recognised, but nothing can be saved
    │   ├── SchemaError                a message definition that cannot be used
    │   ├── MessageError               a message that does not fit its definition
    │   ├── NoRatesError               nothing in the log carries body rates
    │   ├── NoAttitudesError           nothing in the log carries attitudes
    │   ├── NothingToDrawError         nothing in the log carries either
    │   ├── NotRotationsError          rows that should be attitudes are no rotations
    │   ├── NoSamplesError             the chosen source, or the chosen part of it, is empty
    │   ├── NoSuchTopicError           the topic asked for is not there, or has no rates
    │   ├── AmbiguousTopicError        several topics carry rates and none was chosen
    │   ├── UndeclaredError            unit, column or time that only the user can know
    │   └── TimelineError              stamps or rates that the chosen policy refuses
    ├── StoreError                     an object store does not give what is asked of it
    │   └── ReplacedError              a log that is another one after it was read
    ├── ComparisonError                two attitude series that cannot be compared as asked
    └── OutputError                    the result cannot be written where it was requested

Each is a sentence: where, what, and the way out. A choice of the user's that settles the matter is
a mark in it (:func:`quatprop.text.Setting`), which each interface spells in its own way. Text that
comes from a file goes through :func:`quatprop.text.quoted`, so that it cannot command the terminal.
"""

from __future__ import annotations

from copyreg import __newobj__  # type: ignore[attr-defined]
from typing import TYPE_CHECKING, Any

from quatprop.text import Setting, listed, plain, quoted, spelled

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path


class QuatpropWarning(UserWarning):
    """Base of the warnings that the library's functions issue."""


class DataLossWarning(QuatpropWarning):
    """A part of a log could not be read, or samples were dropped.

    Attributes
    ----------
    messages
        How many messages or rows are lost, if known.
    """

    messages: int | None = None


class RemarkWarning(QuatpropWarning):
    """Something was inferred, or looks wrong.

    Attributes
    ----------
    code
        Names what is said, such as ``"saturated"``; it stays when the sentence changes.
    """

    code = ""


class QuatpropError(Exception):
    """Base of every error that is meant for the user: one sentence, no traceback.

    Parameters
    ----------
    reason
        What is wrong and, after a semicolon, the way out; may mention settings.

    Attributes
    ----------
    side
        Which of several inputs it is about, where there are several with the same settings: ``"a"``
        or ``"b"`` of a comparison, ``"q0"`` or ``"at"`` of a propagation; empty otherwise.
    """

    side = ""

    def __init__(self, reason: str) -> None:
        self.reason = reason

    @property
    def text(self) -> str:
        """The sentence, in which settings are marks; ``str`` spells them."""
        return self.reason

    def __str__(self) -> str:
        return spelled(self.text, self.side)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({str(self)!r})"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what a copy in another process has: what is known, however it was given."""
        return __newobj__, (type(self),), self.__dict__


class UsageError(QuatpropError):
    """The options contradict each other or ask for something that does not exist."""


class SuiteError(UsageError):
    """A suite of regressions that cannot be used as written.

    `reason`: what is wrong and, after a semicolon, the way out
    `case`, `key`: where in it, if it is not about all of it
    """

    def __init__(
        self, suite: Path | str, reason: str, case: str | None = None, key: str | None = None
    ) -> None:
        where = plain(suite)
        where += f", case {quoted(case)}" if case is not None else ""
        where += f", {quoted(key)}" if key is not None else ""
        super().__init__(f"{where}: {reason}")


class SeriesError(QuatpropError, ValueError):
    """Arrays that are not the series they claim to be (shape, dtype, length)."""


class StoreError(QuatpropError):
    """An object store does not give what is asked of it: the log is not damaged."""


class ReplacedError(StoreError):
    """A log was replaced while it was read, so that what was read may be of two logs."""


class LogError(QuatpropError):
    """A log that cannot be used as asked."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(reason)
        self.path = path

    @property
    def text(self) -> str:
        """The sentence, with the file that the user knows."""
        return f"{plain(self.path)}: {self.reason}"


class UnreadableLogError(LogError):
    """The file is missing, empty, not permitted, or not a file at all."""


class UnknownFormatError(LogError):
    """No reader recognises the content."""


class UnsupportedLogError(LogError):
    """The log is recognised, but uses a feature that this version does not read."""


class DamagedLogError(LogError):
    """The log is recognised, but damaged so that nothing can be saved."""


class SchemaError(LogError):
    """A message definition cannot be used to find the wanted fields."""


class MessageError(LogError):
    """A message does not fit its definition.

    `positions`: which messages of the block, so that a caller can go on without them
    """

    def __init__(self, path: Path | str, reason: str, positions: Iterable[int] = ()) -> None:
        super().__init__(path, reason)
        self.positions = tuple(positions)


class _NothingFoundError(LogError):
    """Nothing in the log carries what is wanted.

    `seen`: what it holds instead: topics with their types, or columns
    `what`: ``"topics"`` or ``"columns"``
    """

    wanted: str
    field: str
    columns: str

    def __init__(self, path: Path | str, seen: Iterable[str], what: str = "topics") -> None:
        self.seen, self.what = tuple(seen), what
        held = f"it has no {what} with messages"
        if names := listed(self.seen):
            topic = f"the field with {Setting('topic')} and {self.field}"
            way_out = topic if what == "topics" else f"the columns with {self.columns}"
            held = f"its {what} are {names}; name {way_out}"
        super().__init__(path, f"no {self.wanted} found; {held}")


class NoRatesError(_NothingFoundError):
    """Nothing in the log carries body rates."""

    wanted, field = "body rates", Setting("rate_field")
    columns = f"{Setting('rate_cols')} and {Setting('time_col')}"


class NoAttitudesError(_NothingFoundError):
    """Nothing in the log carries attitudes."""

    wanted, field = "attitudes", Setting("quat_field")
    columns = f"{Setting('quat_cols')}, {Setting('from_layout')} and {Setting('time_col')}"


class NothingToDrawError(_NothingFoundError):
    """Nothing in the log carries body rates or attitudes."""

    wanted, field = "body rates or attitudes", f"{NoRatesError.field} or {NoAttitudesError.field}"
    columns = f"{Setting('rate_cols')} or {Setting('quat_cols')} and {Setting('time_col')}"


class NotRotationsError(LogError):
    """Rows that should be attitudes are no rotations: zero, not of unit length, not numbers."""


class NoSamplesError(LogError):
    """The chosen source holds no samples, or none in the chosen part of the log.

    `source`: the topic or the columns
    `outside`, `dropped`: samples left out: before and after the chosen part, and as not finite
    `losses`: places that could not be read, and why
    `length`: how long the log is, where the part is given in units
    """

    def __init__(  # noqa: PLR0913  # all that may explain it
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
            reason = "; lost: {}: {}".format(*losses[0])
        super().__init__(path, f"no samples in {quoted(source)}{reason}")


class NoSuchTopicError(LogError):
    """The topic asked for is not in the log, or carries nothing of what is wanted."""


class AmbiguousTopicError(LogError):
    """Several topics carry what is wanted and none was chosen."""


class UndeclaredError(LogError):
    """Something that only the user can know is not said anywhere.

    `unknown`: what is not declared, such as "the unit of the rates in columns 'gx', 'gy', 'gz'"
    `way_out`: what declares it, such as ``Setting("rate_unit", "rad/s|deg/s")``
    """

    def __init__(
        self, path: Path | str, unknown: str, way_out: str, *, several: bool = False
    ) -> None:
        reason = "are not declared; specify them" if several else "is not declared; specify it"
        super().__init__(path, f"{unknown} {reason} with {way_out}")


class TimelineError(LogError):
    """Stamps or rates that the chosen policy refuses."""


class ComparisonError(QuatpropError):
    """Two attitude series that cannot be compared as asked."""


class OutputError(QuatpropError):
    """The result cannot be written where it was requested; `reason` as for :class:`LogError`."""

    def __init__(self, path: Path | str, reason: str) -> None:
        super().__init__(f"{plain(path)}: {reason}")
        self.path = path


def os_reason(error: OSError) -> str:
    """Return why a file cannot be read, as the end of a sentence about it."""
    match error:
        case FileNotFoundError():
            return "no such file or folder; check the path"
        case PermissionError():
            return "no permission to read it; check its owner and mode"
        case _:
            return f"it cannot be read: {quoted(error.strerror or error)}"
