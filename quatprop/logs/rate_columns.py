"""The columns of rates and of biases in a file of rows: by rows, by clear names, or named.

Nothing is guessed: what neither header, row nor user declares is refused, with the setting that
settles it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conditioning.mounting import mounting
from quatprop.errors import LogError, NoRatesError, UndeclaredError, UsageError
from quatprop.logs.matcher import ColumnMatcher
from quatprop.logs.matching import Found, Match, marks_of
from quatprop.logs.names import BARE_RATES, BESIDE_BARE_RATES, WITH_RATE_UNIT
from quatprop.logs.rows import RATE_PARTS
from quatprop.logs.time_columns import choose_time
from quatprop.logs.vocabulary import GENERIC, ROWS
from quatprop.settings.quantities import RATES, SCALED_RATE_UNITS
from quatprop.settings.selection import RateSelection
from quatprop.tables.column_names import AXIS_FIRST, RATE_UNITS
from quatprop.text import Setting, Text, listed, plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.logs.rows import Row
    from quatprop.tables.model import Group, Table


def match_rates(table: Table, selection: RateSelection) -> Match:
    """Return which columns hold time and rates, and their units."""
    matcher = ColumnMatcher(table, selection, "rate_cols", RATE_PARTS)
    row = matcher.row("rate")
    by_row = matcher.sets(row.rate)
    # Axes whose unit says that they are rates are no less a gyroscope than those that are named so.
    units = {**RATE_UNITS, **SCALED_RATE_UNITS}
    by_unit = (k for k in matcher.sets(*WITH_RATE_UNIT) if matcher.declared(k) in units)
    sets = [*dict.fromkeys((*by_row, *matcher.sets(AXIS_FIRST), *by_unit))]
    sets = sets or _bare_sets(matcher)
    if selection.rate_cols is not None:
        rate = matcher.named(selection.rate_cols)
    elif not sets:
        raise _no_rates(matcher)
    elif by_row and row.burst is not None:
        rate = by_row[0]
    else:
        rate = matcher.only_set(sets, "set of rates", "x")
    own = row if rate in by_row else GENERIC
    declared = matcher.unit("rate", rate, units, own.unit)
    unit, scale = SCALED_RATE_UNITS.get(declared, (declared, 1.0))
    samples = (rate,) if own.burst is None else tuple(by_row)
    found = Found(table, own, table.parts[0], samples, matcher.spelled(rate))
    marks = marks_of(found)
    stamp, rows = choose_time(matcher, (*rate, *marks), row)
    return Match(
        found._replace(table=rows),
        stamp,
        scale * table.notes.rate_scale * RATES[unit],
        marks,
        tuple(_remarks(matcher, row, declared)),
        unit,
    )


def _no_rates(matcher: ColumnMatcher) -> LogError:
    """Return the error for a table without rates, or with some whose axes nobody knows."""
    if angles := matcher.matching(r"(?:.*[._])?(?:roll|pitch|yaw)_?rate")[:3]:
        return UndeclaredError(
            matcher.path,
            f"about which axes {matcher.names(angles)} turn (those of the body, or others, as in "
            "OpenRocket)",
            Text(f"{Setting('rate_cols', 'X,Y,Z')} if they are those of the body"),
        )
    return NoRatesError(matcher.path, [column.text for column in matcher.columns], "columns")


def _bare_sets(matcher: ColumnMatcher) -> list[Group]:
    """Return gx or p and the like, whose unit the user has to declare.

    They are rates unless the table has axes of something else: beside those, gx may be gravity.
    """
    sets = matcher.sets(*WITH_RATE_UNIT)
    others = {k for columns in sets for k in columns} - {*matcher.matching(BESIDE_BARE_RATES)}
    return [columns for columns in matcher.sets(*BARE_RATES) if others == {*columns}]


def match_bias(table: Table) -> Match:
    """Return which columns hold time and the biases of a gyroscope, and their units."""
    matcher = ColumnMatcher(table, RateSelection(), "bias", RATE_PARTS)
    row = matcher.row("bias")
    sets = matcher.sets(row.bias)
    if not sets:
        names = listed(column.text for column in table.columns)
        raise UsageError(
            f"{Setting('bias')} {plain(table.path)}: no columns are named as biases of a "
            f"gyroscope, such as b_w_RS_S_x or gyro_bias_x; there are {names}"
        )
    bias = matcher.only_set(sets, "set of biases", "x")
    unit = matcher.unit("rate", bias, RATE_UNITS, row.unit)
    if not unit:
        raise UsageError(
            f"{Setting('bias')} {plain(table.path)}: the unit of {matcher.names(bias)} is not "
            "declared; name it in the header, such as gyro_bias_x [rad/s]"
        )
    found = Found(table, row, table.parts[0], (bias,), matcher.spelled(bias))
    stamp, rows = choose_time(matcher, bias, row)
    return Match(found._replace(table=rows), stamp, RATES[unit], unit=unit)


def _remarks(matcher: ColumnMatcher, row: Row, unit: str) -> Iterator[str | Text]:
    yield from matcher.remarks
    estimates = [one.rate for one in ROWS if one.name == row.name and not one.measured]
    if ignored := matcher.sets(*estimates) if row.measured else []:
        yield f"ignored estimated body rates: {listed(map(matcher.spelled, ignored))}"
    if unit in SCALED_RATE_UNITS:
        read_as, scale = SCALED_RATE_UNITS[unit]
        yield f"the rates are in {unit}, which is read as {scale:.4g} {read_as}"
    if matcher.notes.mount:
        yield _mount_remark(matcher.notes.mount)


def _mount_remark(mount: str) -> Text:
    """Return the remark on a file that says how its sensor is mounted."""
    try:
        mounting(mount)
        way_out = f"to turn them into the camera's axes use {Setting('mount', mount)}"
    except UsageError:
        way_out = f"as the mounting {mount} is left-handed, it cannot be right"
    taken = "the file says how its sensor is mounted, and rates are taken as they are"
    return Text(f"{taken}; {way_out}")
