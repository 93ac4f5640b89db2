"""Find the columns of a quantity in a table, by the vocabulary or by name."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from quatprop.errors import SchemaError
from quatprop.logs.vocabulary.rows import PARTS, Row
from quatprop.logs.vocabulary.sources import GENERIC, TYPES, row_of_type
from quatprop.tables.column_names import rate_unit_of, whole_key
from quatprop.tables.model import TablePart
from quatprop.text import Remark, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.tables.model import Group, Stamp, Table


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

    If names are repeated, there are several sets.

    `components`: spellings of each component in the group ``part`` of the pattern, separated by
        ``|``
    """
    key = (part, pattern, tuple(components))
    known: tuple[Group, ...] | None = table.matches.get(key)
    if known is not None:
        return known
    number = {own: k for k, spellings in enumerate(components) for own in spellings.split("|")}
    found: dict[str, dict[int, list[int]]] = {}
    for k, match in matching(table, part, pattern):
        component, name = number[match["part"].lower()], match.string
        rest = f"{name[: match.start('part')]}*{name[match.end('part') :]}"
        found.setdefault(rest, {}).setdefault(component, []).append(k)
    count = len(components)
    known = table.matches[key] = tuple(
        tuple(places[component][: k + 1][-1] for component in range(count))
        for places in found.values()
        if len(places) == count
        for k in range(max(map(len, places.values())))
    )
    return known


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
        beside = (row.span, *(row.burst or ())) if quantity == "rate" else ()
        is_whole = all(column_beside(table, part, name) for name in beside if name)
        if sets and is_whole and (quantity != "quat" or _are_floats(table, sets[0])):
            outer.append(part.prefix)
            yield Found(table, row, part, sets, field_name(table, sets))


def column_beside(table: Table, part: TablePart, name: str) -> Group:
    """Return the column of a scalar field in a part of a table; empty if there is none."""
    columns = table.columns_of(part.prefix + name) if name else ()
    return columns if columns and len(columns) == 1 else ()


def field_name(table: Table, sets: Sequence[Group]) -> str:
    """Return the names of columns as in settings; for several samples, by component."""
    groups = sets if len(sets) == 1 else [*zip(*sets, strict=True)]
    return ",".join(table.field_of(tuple(group)) for group in groups)


def beside(match: Match, quantity: str) -> list[Found]:
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
