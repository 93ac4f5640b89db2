"""Find the columns of a quantity in a table, by the vocabulary or by name."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, cast

from quatprop.base.errors import (
    QuatpropError,
    SchemaError,
    UndeclaredError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.base.text import Remark, Setting, did_you_mean, listed, plain, quoted
from quatprop.readers import vocabulary
from quatprop.readers.tables.model import RowBatch, TablePart
from quatprop.readers.tables.table_log import (
    as_option,
    contradicting_units,
    parse_name,
    rate_unit_of,
    whole_key,
)
from quatprop.readers.vocabulary import GENERIC, PARTS, TYPES, Row, row_of_type
from quatprop.settings.quantities import RATES, SCALED_RATE_UNITS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence

    from quatprop.readers.tables.model import Group, Stamp, Table
    from quatprop.settings.reading import SignalSelection


class Found(NamedTuple):
    """A quantity in a table, by the names of columns alone; nothing was read yet.

    `row`: the row of the vocabulary for its columns
    `sets`: columns of its components, in order; several if a message has several samples, the
        oldest first
    `field`: its name, for the settings ``rate_field`` and ``quat_field``
    """

    table: Table
    row: Row
    part: TablePart
    sets: tuple[Group, ...] = ()
    field: str = ""


class Match(NamedTuple):
    """A quantity of a table with everything needed to read it; extends `Found`.

    `factor`: scale factor of the stored numbers
    `marks`: the column that is -1 (for a bias: false) if the quantity is absent; may be empty
    `remarks`: remarks on the choice
    `unit`: unit of rates or angles, such as ``"deg/s"``; ``""`` for other quantities
    `representation`: of an attitude, such as ``"quaternion"`` or ``"euler-zyx"``
    `layout`: ``"scalar-first"`` or ``"scalar-last"`` as stored; ``""`` if the components have names
        in another order
    `is_named`: whether the user named the rate, which is then read even if marked as absent
    """

    table: Table
    row: Row
    part: TablePart
    sets: tuple[Group, ...]
    field: str
    stamp: Stamp
    factor: float = 1.0
    marks: Group = ()
    remarks: tuple[Remark, ...] = ()
    unit: str = ""
    representation: str = "quaternion"
    layout: str = ""
    is_named: bool = False


def marks_of(found: Found) -> Group:
    """Return the column that is -1 if a quantity is absent; may be empty."""
    table, part = found.table, found.part
    name = re.sub(r"[.\[][^.\[]*$", "", table.columns[found.sets[0][0]].key)
    pattern = found.row.absent and re.escape(name[len(part.prefix) :]) + found.row.absent
    return tuple(k for k, _ in matching(table, part, pattern))


def matching(table: Table, part: TablePart, pattern: str) -> Sequence[tuple[int, re.Match[str]]]:
    """Return the columns of a part that match a pattern, and the matches."""
    if not pattern:
        return ()
    found: list[tuple[int, re.Match[str]]] | None = table.matches.get((part, pattern))
    if found is None:
        fits = re.compile(pattern).fullmatch
        begin = len(part.prefix)
        found = table.matches[part, pattern] = [
            (k, match)
            for k, column in enumerate(table.columns[part.begin : part.end], part.begin)
            for match in [
                fits(column.key[begin:])
                or (column.text != column.key and fits(column.text.strip()[begin:]))
            ]
            if match
        ]
    return found


def sets_of(
    table: Table, part: TablePart, components: Sequence[str], pattern: str
) -> tuple[Group, ...]:
    """Return each complete set of columns of a part whose names differ only in the component.

    If names are repeated, there are several sets. Of a longer list or matrix, nothing tells which
    elements are meant: it is no set.

    `components`: spellings of each component in the group ``part`` of the pattern, separated by
        ``|``. Numbers may also count from 1
    """
    key = (part, pattern, tuple(components))
    known: tuple[Group, ...] | None = table.matches.get(key)
    if known is not None:
        return known
    number = {own: k for k, spellings in enumerate(components) for own in spellings.split("|")}
    found: dict[str, dict[str, list[int]]] = {}
    for k, match in matching(table, part, pattern):
        spelling, name = match["part"].lower(), match.string
        rest = f"{name[: match.start('part')]}\0{name[match.end('part') :]}"
        found.setdefault(rest, {}).setdefault(spelling, []).append(k)
    count = len(components)
    sets: list[Group] = []
    for rest, spelled in found.items():
        first = _first_number(spelled)
        if first is not None and _has(table, part, rest, next(iter(spelled)), first + count):
            continue
        places: dict[int, list[int]] = {}
        for spelling, columns in spelled.items():
            component = number.get(spelling)
            if first is not None:
                component = int(spelling.strip("[]")) - first
            if component is not None:
                places[component] = sorted((*places.get(component, ()), *columns))
        if {*places} >= {*range(count)}:
            longest = max(map(len, places.values()))
            sets += (
                tuple(places[component][: k + 1][-1] for component in range(count))
                for k in range(longest)
            )
    known = table.matches[key] = tuple(sets)
    return known


def _first_number(spelled: Collection[str]) -> int | None:
    """Return the number of the first component, 0 or 1; None if they are not single digits."""
    digits = {spelling.strip("[]") for spelling in spelled}
    if not all(len(digit) == 1 and digit.isdecimal() for digit in digits):
        return None
    return 0 if "0" in digits else 1


def _has(table: Table, part: TablePart, rest: str, spelling: str, number: int) -> bool:
    """Return whether a column has a name that differs from others in its number only."""
    begin = len(part.prefix)
    names: set[str] | None = table.matches.get((part, None))
    if names is None:
        columns = table.columns[part.begin : part.end]
        names = {name[begin:] for one in columns for name in (one.key, one.text.strip())}
        table.matches[part, None] = names
    return rest.replace("\0", re.sub(r"\d", str(number), spelling)) in names


def find(
    table: Table, quantity: str, field: str | None = None, *, by_key: bool = False
) -> list[Found]:
    """Return where a table has a quantity, by its types or in a named field.

    A table without types is returned as such; its columns are matched later, by their names.

    `quantity`: ``"rate"``, ``"quat"``, ``"bias"`` or ``"force"``
    `by_key`: whether the spelling of the field may differ
    """
    if not table.is_typed:
        return [Found(table, GENERIC, table.parts[0])]
    if field is not None:
        return _named(table, quantity, field, by_key=by_key)
    own = row_of_type(table.type)
    is_wanted = own is not None and getattr(own, quantity) != ""
    if not table.is_decodable or not (is_wanted or table.may_contain(TYPES)):
        return []
    try:
        return [*_recognised(table, quantity)]
    except SchemaError:
        if is_wanted:
            raise
        return []


def _recognised(table: Table, quantity: str) -> Iterator[Found]:
    """Yield the quantity in parts of known types, except parts inside such parts."""
    outer: list[str] = []
    for part in table.parts:
        row = row_of_type(part.type)
        pattern = "" if row is None else getattr(row, quantity)
        if row is None or not pattern or part.prefix.startswith(tuple(outer)):
            continue
        sets = sets_of(table, part, PARTS[quantity], pattern)
        if quantity != "rate" or row.burst is None:
            sets = sets[:1]
        scalars = (row.span, *(row.burst or ())) if quantity == "rate" else ()
        is_whole = all(scalar_column(table, part, name) for name in scalars if name)
        if sets and is_whole and (quantity != "quat" or _are_floats(table, sets[0])):
            outer.append(part.prefix)
            yield Found(table, row, part, sets, field_name(table, sets))


def scalar_column(table: Table, part: TablePart, name: str) -> Group:
    """Return the column of a scalar field in a part of a table; empty if there is none."""
    columns = table.columns_of(part.prefix + name) if name else ()
    return columns if columns and len(columns) == 1 else ()


def field_name(table: Table, sets: Sequence[Group]) -> str:
    """Return the names of columns as in settings; for several samples, by component."""
    groups = sets if len(sets) == 1 else [*zip(*sets, strict=True)]
    return ",".join(table.field_of(tuple(group)) for group in groups)


def same_message_signals(match: Match, quantity: str) -> list[Found]:
    """Return where a quantity is in the same part of a table as a match."""
    table, part = match.table, match.part
    row = match.row if match.table.is_typed or getattr(match.row, quantity) else GENERIC
    sets = sets_of(table, part, PARTS[quantity], getattr(row, quantity))
    return [Found(table, row, part, (one,), table.field_of(one)) for one in sets]


def _named(table: Table, quantity: str, field: str, *, by_key: bool) -> list[Found]:
    """Return the quantity in a named field; empty if the table has no such field."""
    names = [name.strip() for name in field.split(",")] if quantity == "rate" else [field]
    if not table.is_decodable:
        return []
    try:
        if by_key:
            names = [_as_spelled(table, name) for name in names]
            field = ",".join(names)
        known = [one for one in _recognised(table, quantity) if one.field == ",".join(names)]
        columns = [table.columns_of(name) for name in names]
    except SchemaError:
        return []
    if known or any(group is None for group in columns):
        return known
    group = tuple(k for own in columns for k in own or ())
    if len(group) != len(PARTS[quantity]) or not all(columns):
        group = ()
    if quantity == "quat":
        group = _quaternion(table, field, group)
    if not group:
        for name in names:
            table.refuse_unknown(name)
        what = "is not three numbers; name a field of x, y, z or three numbers as a,b,c"
        if quantity == "quat":
            what = (
                "is not a quaternion; name a field with parts w, x, y, z or an array of four "
                "numbers"
            )
        raise SchemaError(table.path, f"field {quoted(field)} of {quoted(table.type)} {what}")
    row = Row(unit=rate_unit_of(names) or "", stamps=())
    part = TablePart("", "", 0, len(table.columns))
    return [Found(table, row, part, (group,), ",".join(names))]


def _as_spelled(table: Table, name: str) -> str:
    """Return the only field with a similar spelling, else the name unchanged."""
    texts = [column.text for column in table.columns]
    ends = ((text, [*re.finditer(r"[.\[]|$", text)]) for text in texts)
    fields = {text[: end.start()] for text, every in ends for end in every}
    found = [field for field in fields if whole_key(field) == whole_key(name)]
    return found[0] if len(found) == 1 else name


def _quaternion(table: Table, field: str, group: Group) -> Group:
    """Return the columns of w, x, y, z by name, or those of an array in order."""
    if not group or not _are_floats(table, group):
        return ()
    parts = [table.columns[k].text.removeprefix(field) for k in group]
    if parts[0] == "[0]":
        return group
    return tuple(group[parts.index(f".{c}")] for c in "wxyz") if {*parts} == {*_WXYZ} else ()


_WXYZ = (".w", ".x", ".y", ".z")


def _are_floats(table: Table, group: Group) -> bool:
    return all(table.columns[k].code[0] == "f" for k in group)


# Match the columns of a table: sets of columns, columns named by the user, and units.
#
# Nothing is guessed: what neither the header, a convention nor the user declares is refused, and
# the error names the setting that declares it.


_FILES = tuple(dict.fromkeys(row.file for row in vocabulary.ROWS if row.file))
"""Patterns of the names of files by which rows of the vocabulary are chosen."""

FIRST_ROWS = 1000
"""Number of rows over which clocks are compared."""


class ColumnMatcher:
    """Finds the columns of one quantity in a table.

    `setting`: the setting for these columns, such as ``"rate_cols"``
    `remarks`: remarks on the choice
    `set_labels`: words of the setting ``series`` that choose a set of columns; the chosen one
    `unknown`: undeclared facts and the settings that declare them, which are refused together
    """

    def __init__(self, found: Found, selection: SignalSelection, setting: str) -> None:
        self.table = found.table
        self.part = found.part
        self.path = found.table.path
        self.notes = found.table.notes
        self.columns = found.table.columns
        self.selection = selection
        self.setting = setting
        self.remarks: list[Remark] = []
        self.named_units: dict[int, str] = {}
        self.set_labels: Sequence[str] = ()
        self.unknown: list[tuple[str, str]] = []

    def matching(self, pattern: str) -> list[int]:
        """Return the columns whose names match a pattern."""
        return [k for k, _ in matching(self.table, self.part, pattern)]

    def seen(self) -> list[str]:
        """Return the names of columns for an error; with numbers if they repeat or are numbers."""
        names = [column.text for column in self.columns]
        if names == [*map(str, range(len(names)))] and (rows := self.table.head(range(len(names)))):
            return [f"{k}: {cell}" for k, cell in enumerate(rows[0])]
        if len({*names}) < len(names):  # only their numbers tell them apart
            return [f"{k}: {name}" for k, name in enumerate(names)]
        return names

    def has(self, name: str) -> bool:
        """Return whether a column has this exact name."""
        return any(column.text.strip() == name for column in self.columns)

    def position(self, name: str, setting: str) -> int:
        """Return the index of a column, by its exact name, key or number from 0."""
        name, key = name.strip(), parse_name(name).key
        texts = [column.text.strip() for column in self.columns]
        positions = [k for k, text in enumerate(texts) if text == name] or [
            k
            for k, column in enumerate(self.columns)
            if column.key == key or texts[k].lower() == name.lower()
        ]
        if len(positions) > 1:
            raise UsageError(
                f"{plain(self.path)}: {len(positions)} columns are called {quoted(name)}; "
                f"choose one by its number from 0: {Setting(setting)} takes {positions[0]}, "
                f"{positions[1]}..."
            )
        if positions:
            return positions[0]
        if name.isdecimal() and int(name) < len(self.columns):
            return int(name)
        names = [column.text for column in self.columns]
        there = f"the columns are {listed(names)}{did_you_mean(name, names)}"
        if self.notes.unfit:
            there = f"{self.notes.unfit}: count columns from 0, or correct the header"
        raise UsageError(
            f"{plain(self.path)}: {Setting(setting)} asks for column {quoted(name)}; {there}"
        )

    def first_rows(self, columns: Sequence[int]) -> list[tuple[object, ...]]:
        """Return the cells of the rows over which clocks are compared."""
        return self.table.head(columns)[:FIRST_ROWS]

    def as_option(self, k: int) -> str:
        """Return the name of a column for an option."""
        return as_option([column.text for column in self.columns], k)

    def setting_for(self, positions: Collection[int]) -> str:
        """Return the setting that names columns."""
        return Setting(self.setting, ",".join(map(self.as_option, positions)))

    def spelled(self, positions: Collection[int]) -> str:
        """Return the names of columns for a setting."""
        return ",".join(self.columns[k].text for k in positions)

    def names(self, positions: Collection[int]) -> str:
        """Return the names of columns, quoted."""
        return listed(self.columns[k].text.strip() for k in positions)

    def unit(
        self, quantity: str, positions: Group, units: Collection[str], convention: str = ""
    ) -> str:
        """Return the unit of columns, from the user, the header or a convention.

        `quantity`: ``"rate"`` or ``"time"``
        `convention`: the unit by convention; ``""``: none
        """
        chosen: str | None = getattr(self.selection, f"{quantity}_unit")
        stated = {k: self.declared((k,)) or convention for k in positions}
        found = [unit for unit in dict.fromkeys(stated.values()) if unit]
        facts = []
        for unit in found:
            these = [k for k in positions if stated[k] == unit]
            is_known = unit in units
            are_in = f"{'is' if len(these) == 1 else 'are'} in {unit if is_known else quoted(unit)}"
            facts.append(f"{self.names(these)} {are_in}")
        source = "definition" if self.table.is_typed else "header or convention"
        by_header = f"by {source} {' and '.join(facts)}"
        if chosen is not None:
            # The user's unit takes precedence over the header.
            if {*found} & {*units} - {chosen}:
                given = f"{Setting(f'{quantity}_unit')} says {chosen}"
                text = f"{given}, but {by_header}; read in {chosen}, as requested"
                self.remark("unit-overruled", text)
            other = self.declared(positions)
            if other and other not in units:
                text = (
                    f"{Setting(f'{quantity}_unit')} says {chosen}, but {self.names(positions)} "
                    f"are declared in {quoted(other)}; the numbers are read in {chosen}, as "
                    "requested, and not converted"
                )
                self.remark("unit-overruled", text)
            return chosen
        if facts[1:]:
            raise UsageError(f"{plain(self.path)}: {by_header}; convert them to one unit")
        declared = self.declared(positions) or convention
        self.refuse_unknown(positions, declared, units, f"{quantity}_unit")
        if not declared:
            unstated = [k for k in positions if not stated[k]]
            what = f"{'rates' if quantity == 'rate' else quantity} {self.names(unstated)}"
            what += f", while {facts[0]}," if facts else ""
            choices = _choices([one for one in found if one in units]) or _choices(units)
            setting = Setting(f"{quantity}_unit", "|".join(choices))
            self.unknown.append((f"the unit of the {what}", setting))
        return declared

    def declared(self, positions: Group) -> str:
        """Return the unit that the header declares for columns; ``""``: none, or several."""
        named = self.named_units
        units = {
            self.notes.units.get(k, self.columns[k].unit) or named.get(k, "") for k in positions
        }
        return units.pop() if len(units) == 1 else ""

    def refuse_undeclared(self) -> None:
        """Raise an error for all undeclared facts."""
        if self.unknown:
            unknown, ways = (
                " and ".join(f"{part}" for part in parts)
                for parts in zip(*self.unknown, strict=True)
            )
            raise UndeclaredError(self.path, unknown, ways, several=len(self.unknown) > 1)

    def refuse_unknown(
        self, positions: Group, unit: str, units: Collection[str], setting: str = ""
    ) -> None:
        """Refuse a declared unit that is not supported; `setting`: what overrules it."""
        if both := [one for one in contradicting_units(unit) if one in units]:
            choices = _choices(both) if both[1:] else _choices(units)
            which = f", or name that of the numbers with {Setting(setting, '|'.join(choices))}"
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} {'are' if positions[1:] else 'is'} declared in {unit}; "
                f"correct the wrong unit{which if setting else ''}",
            )
        if unit and unit not in units:
            choices = _choices(units)
            way = f", or if they are, name that with {Setting(setting, '|'.join(choices))}"
            raise UnsupportedLogError(
                self.path,
                f"{self.names(positions)} are declared in {quoted(unit)}; "
                f"convert the numbers to {' or '.join(choices)}{way if setting else ''}",
            )

    def remark(self, code: str, text: str) -> None:
        """Add a remark on the choice."""
        self.remarks.append(Remark(code, text))

    def remark_on_text(self, positions: Group) -> None:
        """Remark on columns whose numbers are written as text."""
        if self.table.holds_text(positions):
            self.remark("numbers-as-text", f"the numbers of {self.names(positions)} are text")

    # Sets of columns.

    def found(self, row: Row, sets: tuple[Group, ...]) -> Found:
        """Return a quantity found by the names of columns."""
        return Found(self.table, row, self.part, sets)

    def sets(self, components: Sequence[str], *patterns: str) -> list[Group]:
        """Return each complete set of columns whose names differ only in the component."""
        every = (sets_of(self.table, self.part, components, pattern) for pattern in patterns)
        return [one for sets in every for one in sets]

    def row(self, quantity: str) -> Row:
        """Return the row of the vocabulary for a table with columns of a quantity."""
        # Many tables have the same columns, and names that tell as little of their kind.
        in_name = tuple(re.search(file, self.path.name) is not None for file in _FILES)
        key = (quantity, self.part, self.notes.title, in_name)
        known: Row | None = self.table.matches.get(key)
        if known is None:
            known = self.table.matches[key] = self._row(quantity)
        return known

    def _row(self, quantity: str) -> Row:
        # Only rostopic needs its comment mark; others are decoration, so names also count without.
        names = {column.key for column in self.columns}
        names |= {column.text.strip("\ufeff ").lower() for column in self.columns}
        names.add(self.notes.title.lower())
        for row in vocabulary.ROWS:
            if (
                row.name
                and names.issuperset(row.needs)
                and re.search(row.file, self.path.name)
                and self.sets(PARTS[quantity], getattr(row, quantity))
                and (not row.stamps or any(map(self.matching, row.stamps)))
            ):
                return row
        return GENERIC

    def only_set(self, sets: Sequence[Group], quantity: str, component: str) -> Group:
        """Return the only set, or the one whose name is that of the series; refuse several."""
        if len(sets) == 1:
            return sets[0]
        labels = self._labels_of(sets)
        # The first is of columns, even if rows have the same labels; the others are of rows.
        parts = (self.selection.series or "").split(",")
        if part := next((part for part in parts if part.strip() in labels), ""):
            parts.remove(part)
            label = part.strip()
            self.set_labels = (label,)
            self.selection = replace(self.selection, series=",".join(parts) or None)
            return sets[labels.index(label)]
        names = [self.columns[positions[0]].text for positions in sets]
        if len(set(names)) < len(names):
            numbers = ", ".join("-".join(map(str, positions)) for positions in sets)
            reason = f"several columns have the same name; by numbers from 0: {numbers}"
        else:
            reason = f"their {component} columns are {listed(names)}"
        which = f"which {quantity} to use ({reason})"
        if self.setting == "bias":
            raise UndeclaredError(self.path, which, "a table that holds one of them")
        if not labels:
            way = Setting(self.setting, "A,B,C,D" if sets[0][3:] else "X,Y,Z")
            raise UndeclaredError(self.path, which, way)
        self.set_labels = labels
        self.unknown.append((which, Setting("series", "|".join(labels))))
        if self.selection.series is not None:
            self.refuse_undeclared()
        return sets[0]  # to find whatever else is not declared

    def _labels_of(self, sets: Sequence[Group]) -> list[str]:
        """Return words that tell sets apart, such as left and right; empty if there are none."""
        words = []
        for positions in sets:
            columns = [self.columns[k] for k in positions]
            has_unit = all(one.unit in {*RATES, *SCALED_RATE_UNITS} for one in columns)
            names = [_WORD.findall(one.key if has_unit else one.text) for one in columns]
            # Those of a component, such as x, differ within the set.
            words.append([word for word in names[0] if all(word in name for name in names)])
        common = set.intersection(*map(set, words))
        labels = ["_".join(word for word in own if word not in common) for own in words]
        return labels if all(labels) and len({*labels}) == len(labels) else []

    # Columns that the user names.

    def named(self, names: Sequence[str]) -> Group:
        """Return the columns that the user names."""
        positions = tuple(self.position(name, self.setting) for name in names)
        if len(set(positions)) != len(positions):
            raise UsageError(f"{plain(self.path)}: {Setting(self.setting)} names a column twice")
        return positions


_WORD = re.compile(r"\d+|[^\W\d_]+")
"""A word or a number in the name of a column."""


def _choices(units: Collection[str]) -> list[str]:
    """Return the units that a user may name."""
    return [unit for unit in units if unit not in SCALED_RATE_UNITS]


# The first rows of a table, decoded once and shared by all checks of the beginning.
#
# They have all columns that may be a time, a rate or an orientation.


ENOUGH_ROWS = 20_000
"""Maximum number of rows held; further rows are read again for each check."""


class FirstBatch:
    """The first rows of some columns of a table.

    `stamps`, `groups`: the columns
    """

    def __init__(self, table: Table, stamps: Sequence[Stamp], groups: Sequence[Group]) -> None:
        self._table, self._stamps, self._groups = table, stamps, groups
        self._held: list[RowBatch] = []
        self._rest = table.peek(stamps, groups, is_strict=True)
        self._is_whole = self._is_misfit = False

    def read(self, stamps: Sequence[Stamp], groups: Sequence[Group]) -> Iterator[RowBatch]:
        """Yield times, ns, and groups of columns, from the first row on, without noting losses.

        Rows that cannot be decoded in these columns are omitted.
        """
        count = 0
        if {*stamps} <= {*self._stamps} and {*groups} <= {*self._groups}:
            places = [self._stamps.index(stamp) for stamp in stamps]
            places += [len(self._stamps) + self._groups.index(group) for group in groups]
            while count < len(self._held) or self._read_on():
                rows = self._held[count]
                count += 1
                # Copied, since they are converted in place.
                values = tuple(rows.values[place].copy("K") for place in places)
                yield RowBatch(rows.log_ns, values, rows.watermark_ns)
            if self._is_whole:
                return
        yield from islice(self._table.peek(stamps, groups), count, None)

    def _read_on(self) -> bool:
        """Hold more rows; False if there are no more, enough, or one cannot be decoded."""
        if self._is_whole or self._is_misfit or sum(map(len, self._held)) >= ENOUGH_ROWS:
            return False
        count = len(self._held)
        try:
            self._held += islice(self._rest, 1)
        except QuatpropError:
            self._is_misfit = True
            return False
        self._is_whole = count == len(self._held)
        return not self._is_whole


def first_batch(table: Table, stamps: Sequence[Stamp]) -> FirstBatch:
    """Return the first rows of a table; `stamps`: its possible timestamps."""
    if table.first is None:
        groups = dict.fromkeys(_candidate_groups(table)) if table.is_typed else ()
        table.first = FirstBatch(table, stamps, [*groups])
    return cast("FirstBatch", table.first)


def _candidate_groups(table: Table) -> Iterator[Group]:
    for quantity in ("rate", "quat"):
        for one in find(table, quantity):
            scalars = scalar_column(table, one.part, one.row.span) or marks_of(one)
            yield from filter(None, (one.sets[0], scalars))
