"""A file of rows: a log with one table. Subclasses read the rows of a format."""

from __future__ import annotations

import re
from abc import abstractmethod
from contextlib import suppress
from fractions import Fraction
from functools import cached_property, lru_cache
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, Self

import numpy as np

from quatprop.base.errors import MessageError, UnsupportedLogError, UsageError
from quatprop.base.progress import with_progress
from quatprop.base.text import Remark, Setting, listed, plain, quoted
from quatprop.base.times import numbered_stamps
from quatprop.readers.tables.model import (
    Column,
    Log,
    RowBatch,
    Stamp,
    Table,
    TablePart,
    without_misfits,
)
from quatprop.readers.tables.running_times import summed, unwrapped
from quatprop.readers.tables.time_units import DAY_DIGITS, TICKS, since_a_date
from quatprop.readers.tables.turns import RowWatch
from quatprop.settings.quantities import SCALED_RATE_UNITS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray, Float64, Int64
    from quatprop.readers.tables.model import Convert, Group, Within

    Batches = Iterator[tuple[Int64, Float64]]


# Parse column names into a key and a unit.


TIME_NAMES = r"_*(?:t|ts|time|timestamp|time_?stamp|stamp)"
INTERVAL = (
    r"(?!.*(?:exposure|latency|delay))(?:.*[._])?(?:d_?ts?|delta_?t|t_?delta|t_?diff|diff_?t"
    r"|d_?time|(?:delta|diff)_?(?:times?|timestamp|ts|stamp)"
    r"|(?:time|timestamp|ts|stamp)_?(?:delta|diff|difference|interval|step|increment)"
    r"|(?:inter_?)?(?:sample|sampling|update|frame|message|packet|row)?_?interval"
    r"|(?:sample|sampling|frame)_?period"
    r"|(?:(?:time|elapsed|elapsed_?time)_)?since_(?:the_)?(?:last|previous|prev)(?:_[a-z]+)?)"
)
"""Names of columns of intervals between rows."""
MAYBE_INTERVAL = (
    r"(?:.*[._])?(?:delta|diff|difference|step|increment|gap|period|duration"
    r"|(?:loop|cycle|tick|scan|update|step)_?(?:time|duration|period|interval))"
)
"""Names of columns that are intervals if they have a unit of time and such values."""
TIME_OF_WEEK = (
    r"(?:.*[._])?(?:gps_?)?(?:i?tow|sow|time_of_week|seconds?_(?:of|in|into)_(?:the_)?week"
    r"|week_?(?:seconds?|secs?|ms|millis|time))"
)
WEEK_NUMBER = r"(?:.*[._])?(?:gps_?)?(?:week|wn|week_?(?:number|num|no|nr)|weeknum)"
"""Names of the two columns of a GPS time."""
NOT_RATE = r"(?!b_w_|.*(?:bias|cov|std|var|noise|drift|offset|error|setpoint))"
_GYROSCOPE = (
    r"(?:gyro(?:scopes?|_?rate)?|gyr|omega|ang(?:ular)?_?(?:velocity|vel|rate)|rotation_?rate)"
)
_NAMED = rf"{NOT_RATE}(?:(?:.*[._])?{_GYROSCOPE}[._]?|w[._]?)"
GYROSCOPE = _NAMED + r"(?P<part>[xyz]|\[[012]\])"
AXIS_FIRST = rf"{NOT_RATE}(?:.*[._])?(?P<part>[xyz])_?{_GYROSCOPE}(?:_out)?"
BEFORE_WORD = _NAMED + "(?P<part>[xyz])_[a-z0-9]+"
NOT_ATTITUDE = r"(?!.*(?:cov|std|var|noise|sigma|delta|error|setpoint))"
NOT_ROTATION = (
    NOT_ATTITUDE + r"(?!.*(?:rate|speed|vel|acc|omega|gyr))(?!(?:.*[._])?des(?:ired)?[._])"
)
ROTATION_VECTOR = (
    rf"{NOT_ROTATION}(?:.*[._])?(?:rotvec|rotation_?vector|rot_?vec)[._]?(?P<part>[xyz])"
)
EULER = rf"{NOT_ROTATION}(?:.*[._])?(?P<part>yaw|pitch|roll)"
EULER_NUMBERED = NOT_ROTATION + r"(?:.*[._])?euler_{}_(?P<part>[123])"
"""Patterns of names that may have a unit as a suffix; the group ``part`` is the component."""

RATE_UNITS = {
    "rad/s": ("rad/s", "rads^-1", "rads-1", "rad_s", "rad_per_s", "rad_per_sec", "radps"),
    "deg/s": (
        *("deg/s", "degs^-1", "degs-1", "deg_s", "deg_per_s", "deg_per_sec", "degps"),
        *("dps", "d/s", "\u00b0/s", "\u00ba/s"),
    ),
}
"""Unit of a rate -> spellings in headers, in lower case, without spaces and points."""

TIME_UNITS = {
    "s": ("s", "sec", "secs", "second", "seconds"),
    "ms": ("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"),
    "us": ("us", "\u00b5s", "\u03bcs", "usec", "usecs", "micros", "microsecond", "microseconds"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanosec", "nanosecs", "nanosecond", "nanoseconds"),
}
"""Unit of time -> spellings in headers."""

ANGLE_UNITS = {
    "rad": ("rad", "rads", "radian", "radians"),
    "deg": ("deg", "degs", "degree", "degrees", "\u00b0", "\u00ba"),
}
"""Unit of an angle -> spellings in headers."""

_CLOCK_UNITS = {
    TICKS: (TICKS, "100_ns", "hns"),
    DAY_DIGITS: ("hhmmss", "hhmmsss", "hhmmssss", "hhmmsssss"),
}
"""Unit of a clock -> spellings in headers, such as hhmmss.ss without its point."""

UNITS = {
    spelling: unit
    for units in (RATE_UNITS, TIME_UNITS, ANGLE_UNITS, _CLOCK_UNITS)
    for unit, spellings in units.items()
    for spelling in spellings
} | {spelling: unit for unit in SCALED_RATE_UNITS for spelling in (unit, unit.replace("/", "_"))}
"""Spelling -> unit."""

_KNOWN = {*UNITS.values()}
_BUT_ALSO = ", but also "
"""Between two units that a name and a row of units state, and which contradict each other."""

_WORDS = {
    # The degree sign of UTF-8, read as Latin-1.
    r"\u00e2(?=[\u00b0\u00ba])": "",
    r"s(?:ec(?:ond)?s?)?\^?-1$": "/s",
    r"^m(?:illi)?(?=[\u00b0\u00ba]|deg|rad)": "m",
    r"^(m?)(?:degrees?|[\u00b0\u00ba])(?=.)": r"\1deg",
    r"^degs(?=/)": "deg",
    r"^(m?)(?:radians?|rads)(?=/)": r"\1rad",
    r"/sec(?:ond)?s?$": "/s",
}
"""Pattern of a spelling within a unit in brackets -> short spelling."""

_CAPITAL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""Word boundary in camel case."""

_ONE_ROW = ("row of another kind", "was")
_IN_UNIT = re.compile(r"(?i)(.+?)(?:\s+in\s+|,\s*|\s+)(\S+/s|\S+\s+per\s+sec(?:ond)?|dps)")
"""A name and a unit of a rate without brackets."""
_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")
# "sec" and "nanosec" are left out: at the end of a name they are the two halves of a timestamp.
_SUFFIXES = sorted({*UNITS} - {"sec", "secs", "nsec", "nsecs", "nanosec", "nanosecs"})
_SUFFIX = re.compile(rf"(?i)(.+?)_({'|'.join(map(re.escape, _SUFFIXES))})(\.[xyz]|\[[012]\])?")
"""A name, a unit, and an axis if the unit is that of a list or of components."""
_MAY_HAVE_SUFFIX = (
    GYROSCOPE,
    AXIS_FIRST,
    BEFORE_WORD,
    r"(?:.*[._])?g_?[xyz]",
    r"[pqr]|(?:.*[._])?(?:roll|pitch|yaw)_?rate",
    rf"(?:.*[._])?(?:{TIME_NAMES})(?:_[a-z]+)?",
    INTERVAL,
    MAYBE_INTERVAL,
    TIME_OF_WEEK,
    r"(?:.*[._])?(?:epoch|unix|posix|elapsed|uptime|boot|since_(?:re)?boot|since_start)",
    ROTATION_VECTOR,
    EULER,
    EULER_NUMBERED.format("[xyz]{3}"),
)


@lru_cache(maxsize=1024)
def parse_name(text: str) -> Column:
    """Return a column with the key and the unit of its name."""
    name = text.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    bracketed = _BRACKETS.fullmatch(name)
    if bracketed and not bracketed[2].strip().isdecimal():
        if " since " in bracketed[2] and (since := since_a_date(bracketed[2])):
            return Column(text, _key(bracketed[1]), since)
        unit = "".join(bracketed[2].lower().split())
        unit = UNITS.get(_spelling(unit), unit)
        # A unit in the name itself, above a row of units, or next to the attribute of a dataset.
        before = parse_name(bracketed[1])
        first = before.unit if before.unit in _KNOWN else suffix_of(bracketed[1])
        if not first or unit not in _KNOWN:
            return Column(text, _key(bracketed[1]), unit)
        scales = [SCALED_RATE_UNITS.get(one, (one, 1.0)) for one in (first, unit)]
        is_same = scales[0] == scales[1] or unit == f"{first}/s"
        return Column(text, before.key, unit if is_same else f"{first}{_BUT_ALSO}{unit}")
    if (in_unit := _IN_UNIT.fullmatch(name)) and (unit := _rate_unit(in_unit[2])):
        return Column(text, _key(in_unit[1]), unit)
    name = _CAPITAL.sub("_", name)
    if suffixed := _SUFFIX.fullmatch(name):
        stem, suffix, axis = suffixed.groups(default="")
        key, unit = _key(stem + axis), UNITS[suffix.lower()]
        # PX4's gyro_rad[0] is in rad/s.
        may_have_it = unit not in ANGLE_UNITS if axis else True
        if may_have_it and any(re.fullmatch(known, key) for known in _MAY_HAVE_SUFFIX):
            return Column(text, key, unit)
    return Column(text, _key(name))


def suffix_of(text: str) -> str:
    """Return the unit of a rate or an angle at the end of any name; empty if there is none."""
    name = _CAPITAL.sub("_", text.strip("\ufeff \t\"'"))
    suffixed = _SUFFIX.fullmatch(name)
    unit = UNITS[suffixed[2].lower()] if suffixed else ""
    return unit if unit in {*RATE_UNITS, *SCALED_RATE_UNITS, *ANGLE_UNITS} else ""


def contradicting_units(unit: str) -> tuple[str, ...]:
    """Return the two units of a column of which two are stated; else nothing."""
    return tuple(unit.split(_BUT_ALSO)) if _BUT_ALSO in unit else ()


def whole_key(text: str) -> str:
    """Return the key of a name, including a unit that is a suffix."""
    name = text.strip("\ufeff \t\"'").lstrip("#%/ \t").strip()
    # mSec and uSec are one word.
    return _key(re.sub(r"(?i)([munµμ])sec", lambda unit: unit[0].lower(), name))


def as_option(names: Sequence[str], k: int) -> str:
    """Return the name of a column for an option, or its number if the name needs quotes."""
    name = names[k].strip()
    is_plain = re.fullmatch(r"[\w.+-]*[^\W\d][\w.+-]*", name, re.ASCII) and names.count(name) == 1
    return name if is_plain else str(k)


def rate_unit_of(fields: Sequence[str]) -> str | None:
    """Return the unit declared by the names of a rate: three axes or one vector."""
    names = fields if len(fields) > 1 else [f"{fields[0]}[0]"]
    unit, *others = {parse_name(name).unit for name in names}
    return None if others or unit not in {*RATE_UNITS, *SCALED_RATE_UNITS} else unit


def _spelling(unit: str) -> str:
    """Return a unit in brackets in the spelling of :data:`UNITS`."""
    unit = re.sub("\u207b\u00b9|\u2212" + "1", "^-1", unit)
    unit = re.sub(r"[.*\u00b7\u22c5]", "", unit).replace("per", "/")
    for pattern, spelling in _WORDS.items():
        unit = re.sub(pattern, spelling, unit)
    return unit


def _rate_unit(text: str) -> str:
    """Return a unit of rates; empty if it is none."""
    unit = UNITS.get(_spelling("".join(text.lower().split())), "")
    return unit if unit in {*RATE_UNITS, *SCALED_RATE_UNITS} else ""


def _key(name: str) -> str:
    name = _CAPITAL.sub("_", name.strip())
    return re.sub(r"[\s-]+", "_", name.lower()).replace("/", ".").lstrip(".")


# Counters of samples, which with a sample rate are a clock that includes lost samples.


_BITS = (8, 16, 32)
"""Sizes of counters that wrap around, bits."""

_LOST = 4
"""A counter wrapped around if this means a loss of less than 1/4 of its range."""

_TOO_LARGE = 1 << 61

_DOUBTFUL = 20
"""At most one step in so many may be zero or negative in a counter of samples."""

_LARGEST_STEP = 4
"""Maximum median step of a counter of samples that never steps by 1."""


class Counting(NamedTuple):
    """Steps of the first values of a counter.

    `step`: the most frequent step
    `is_by_one`: whether it counts samples one by one, apart from lost ones
    `has_gaps`: whether there are other steps
    """

    step: int
    is_by_one: bool
    has_gaps: bool


def counting(numbers: Float64) -> Counting | None:
    """Return the steps of a counter by its first values; None if it is not a counter."""
    if len(numbers) < 2 or not (np.abs(numbers) < 2**60).all() or (numbers % 1).any():  # noqa: PLR2004
        return None
    steps = np.diff(counted(numbers.astype(np.int64)))
    rising = steps[steps > 0]
    # A single damaged value is tolerated.
    if not len(rising) or len(steps) - len(rising) > max(1, len(steps) // _DOUBTFUL):
        return None
    sizes, times = np.unique(rising, return_counts=True)
    usual = int(sizes[times.argmax()])
    others = np.count_nonzero(rising % usual)
    is_mixed = others * _DOUBTFUL > len(rising) and np.median(rising) <= _LARGEST_STEP
    return Counting(usual, usual == 1 or bool(is_mixed), len(sizes) > 1)


def counted(values: Int64, before: tuple[int, int] | None = None) -> Int64:
    """Return the counts since the first value of a counter, unwrapped, shape ``(N,)``.

    `before`: last value and count of the preceding rows
    """
    if int(values.max()) >= _TOO_LARGE or int(values.min()) <= -_TOO_LARGE:
        raise OverflowError
    last, count = before or (int(values[0]), 0)
    steps = np.diff(values, prepend=last)
    for row in np.flatnonzero(steps < 0):
        highest = int(values[row] - steps[row])
        size = next((1 << bits for bits in _BITS if highest < 1 << bits), 0)
        if 0 < steps[row] + size < size // _LOST:
            steps[row] += size
    return count + np.cumsum(steps)


def counted_rows(
    batches: Iterator[tuple[Int64, Float64]],
    sample_rate: Fraction | float,
    note_lost: Callable[[int], None],
) -> Iterator[tuple[Int64, Float64]]:
    """Yield rows with the timestamps of their counts, the first at 0 ns.

    `sample_rate`: counts per second, Hz
    """
    before: tuple[int, int] | None = None
    rate = Fraction(str(sample_rate))
    lost = 0
    for values, numbers in batches:
        counts = counted(values, before)
        steps = np.diff(counts, prepend=counts[:1] if before is None else before[1])
        # A damaged count steps back as far as it was ahead.
        lost += int((steps[steps != 0] - 1).sum())
        before = int(values[-1]), int(counts[-1])
        try:
            t_ns = numbered_stamps(counts, rate)
        except UsageError as error:
            raise OverflowError from error
        yield t_ns, numbers
    if lost > 0:
        note_lost(lost)


OTHER_DATES = "dates that are not of ISO 8601"
"""The unit of a column of dates in an unknown format."""

_COUNTED = Stamp(sample_rate=1)
"""A timestamp for rows of which the times are not needed."""


@lru_cache(maxsize=16)
def _matches_of(_columns: tuple[Column, ...]) -> dict[object, Any]:
    """Return the shared cache of matches in columns, which many logs have in common."""
    return {}


class TimedColumns(NamedTuple):
    """Columns of a file to read as numbers, and as timestamps.

    `parts`: the parts of :meth:`Table.spans` to read; None: all
    `others`: columns that only rows of other topics have
    `beside`: columns of further numbers, NaN in rows where they do not fit
    `watch`: watches columns of labels or numbers while they are read; None if there are none
    """

    numbers: tuple[int, ...]
    stamp: Stamp
    parts: frozenset[int] | None = None
    others: tuple[int, ...] = ()
    beside: tuple[int, ...] = ()
    watch: RowWatch | None = None

    @property
    def used(self) -> set[int]:
        """All columns that are needed."""
        return {*self.stamp.columns, *self.numbers, *(k for k, _ in self.stamp.series)}

    @property
    def read(self) -> set[int]:
        """All columns to read, with those that are only watched."""
        return {*self.used, *self.beside, *(self.watch.columns() if self.watch else ())}


class TableLog(Log, Table):
    """Rows of named or numbered columns: text, Arrow, NumPy and JSON Lines files.

    `other_rows`: number of rows of other series skipped so far
    `foreign_rows`: number of rows of other kinds, which have none of the numbers, skipped so far
    """

    name = type = ""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._losses_at_opening: int | None = None
        self.other_rows = self.foreign_rows = 0

    def _forget_earlier_reading(self) -> None:
        """Remove the losses of rows that will be read again."""
        self.other_rows = self.foreign_rows = 0
        if self._losses_at_opening is None:
            self._losses_at_opening = len(self.losses)
        self.losses.restart(self._losses_at_opening)

    def tables(self, topic: str | None = None) -> list[Self]:
        """Return the file as the only table, which has no topic."""
        return [] if topic is not None else [self]

    @property
    @abstractmethod
    def names(self) -> list[str]:
        """Column names in order; ``"0"``, ``"1"``... without a header."""

    @cached_property
    def columns(self) -> Sequence[Column]:
        """The columns, parsed from their names."""
        return tuple(map(parse_name, self.names))

    @cached_property
    def matches(self) -> dict[object, Any]:  # type: ignore[override]
        """Cache of matches in the columns, shared by tables with the same columns."""
        return _matches_of(tuple(self.columns))

    @property
    def parts(self) -> Sequence[TablePart]:
        """The only part: the whole file."""
        return (TablePart("", "", 0, len(self.columns)),)

    def are_decoded_with(self, columns: Group, others: Group) -> bool:
        """Return whether columns can be read beside others."""
        return self.are_of_same_rows((*columns, *others))

    def columns_of(self, name: str) -> Group | None:
        """Return a column by its exact name or its key, or None."""
        spelled = (k for k, one in enumerate(self.columns) if one.text.strip() == name)
        by_key = (k for k, one in enumerate(self.columns) if one.key == name)
        found = next(spelled, next(by_key, None))
        return None if found is None else (found,)

    def read(  # noqa: PLR0913, PLR0917  # what is read, and of which rows
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        convert: Convert,
        within: Within = None,
        watched: str = "",  # noqa: ARG002  # labels of files are in their stamps
        beside: Group = (),
    ) -> Iterator[RowBatch]:
        """Yield batches in the order of the file; log times are the timestamps."""
        parts = within if isinstance(within, frozenset) else None
        rows = self._timed_rows(stamp, groups, parts, beside)
        for batch in with_progress(rows, self.row_count()):
            yield without_misfits(convert, batch, self._leave_out)

    def _leave_out(self, rows: RowBatch, error: MessageError) -> RowBatch:
        """Return rows without those that cannot be converted, which are noted as losses."""
        first_ns, count = int(rows.log_ns[error.positions[0]]), len(error.positions)
        self.losses.note("rows", str(error.reason), count, part=first_ns)
        return rows.without(error.positions)

    def peek(
        self,
        stamps: Sequence[Stamp],
        groups: Sequence[Group],
        *,
        is_strict: bool = False,  # noqa: ARG002  # misfits are omitted while reading
    ) -> Iterator[RowBatch]:
        """Yield the first rows, and then all rows, except of stdin."""
        if not stamps and (first := self.head([k for group in groups for k in group])):
            cells = np.array([*map(numbers_of, first)])
            yield RowBatch(np.arange(len(first)), _split(cells, groups))
        # stdin can be read only once.
        if str(self.path) != "-":
            for rows in self._timed_rows((*stamps, _COUNTED)[0], groups):
                times = (rows.log_ns for _ in stamps)
                yield RowBatch(rows.log_ns, (*times, *rows.values[1:]))

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the file; an equal one is replaced."""
        self.remarks = [*(one for one in self.remarks if one != text), Remark(code, text)]

    def _timed_rows(
        self,
        stamp: Stamp,
        groups: Sequence[Group],
        parts: frozenset[int] | None = None,
        beside: Group = (),
    ) -> Iterator[RowBatch]:
        """Yield times, ns, and groups of columns; rows that do not fit are noted as losses."""
        watch = RowWatch(stamp.watched) if stamp.watched else None
        every = tuple(chain.from_iterable(groups))
        columns = TimedColumns(every, stamp, parts, beside=beside, watch=watch)
        groups = (*groups, beside) if beside else groups
        self._forget_earlier_reading()
        batches = self._stored_rows(columns)
        if stamp.series:
            batches = self._of_series(batches, stamp)
        if stamp.columns and stamp.sample_rate is not None:
            batches = self._counted(batches, stamp.columns[0], stamp.sample_rate)
        elif stamp.is_summed:
            batches = summed(batches)
        elif len(stamp.columns) == 1:
            batches = unwrapped(batches, stamp.units[0], self)
        for t_ns, numbers in batches:
            utc_ns = t_ns - stamp.utc_offset_ns if stamp.utc_offset_ns else t_ns
            yield RowBatch(utc_ns, (utc_ns, *_split(numbers, groups)))
        if self.foreign_rows:
            names = listed(self.names[k] for k in columns.numbers)
            rows, were = ("rows of other kinds", "were") if self.foreign_rows > 1 else _ONE_ROW
            text = f"{self.foreign_rows} {rows}, without {names}, {were} not read"
            self.remark("other-kinds", text)
        if watch is not None:
            watch.finish()

    def _counted(self, batches: Batches, counter: int, rate: Fraction | float) -> Batches:
        """Yield rows with counts replaced by times."""
        name = quoted(self.names[counter])

        def note_lost(count: int) -> None:
            self.remark(
                "counter-gaps", f"{count} sample{'s' * (count > 1)} lost by the counter {name}"
            )

        try:
            yield from counted_rows(batches, rate, note_lost)
        except OverflowError:
            raise UnsupportedLogError(
                self.path,
                f"at {float(rate):g} Hz, the counts in column {name} do not fit in int64 ns; count "
                f"rows with {Setting('sample_rate', f'{float(rate):g}')} and "
                f"{Setting('time_col', 'none')}",
            ) from None

    def _of_series(self, batches: Batches, stamp: Stamp) -> Batches:
        """Yield rows of a series, and remark on the number of others."""
        count = 0
        for batch in batches:
            count += len(batch[0])
            yield batch
        each = (f"{quoted(label)} in column {quoted(self.names[k])}" for k, label in stamp.series)
        which = " and ".join(each)
        if not count:
            raise UsageError(
                f"{plain(self.path)}: no row is of the series {which}; check {Setting('series')}"
            )
        remark = f"{self.other_rows} rows of other series than {which} were not read"
        if self.other_rows and remark not in self.remarks:
            self.remarks = [*self.remarks, Remark("other-series", remark)]

    @abstractmethod
    def _stored_rows(self, columns: TimedColumns) -> Batches:
        """Yield timestamps, ns, or counts, ``(N,)``, and stored numbers, ``(N, k)``.

        Rows that do not fit are noted in :attr:`losses`.
        """


def refuse_second_file(path: Path, begin: int) -> NoReturn:
    """Refuse a file with another one joined to it, which begins at a byte."""
    reason = f"another file begins in it at byte {begin}; split it there into two"
    raise UnsupportedLogError(path, reason)


def _split(cells: Float64, groups: Sequence[Group]) -> tuple[AnyArray, ...]:
    """Return columns by group; see :data:`quatprop.readers.tables.model.Group`."""
    ends = pairwise(np.cumsum([0, *map(len, groups)]).tolist())
    return tuple(cells[:, begin if end - begin == 1 else slice(begin, end)] for begin, end in ends)


def numbers_of(cells: Sequence[object]) -> Float64:
    """Return the numbers in cells; NaN for other text."""
    numbers = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        with suppress(ValueError):
            numbers[k] = float(f"{cell}".replace(",", "."))
    return numbers
