"""Match the columns of rates and biases, with unit and timestamp.

In files they are found by the vocabulary, by clear names, or named by the user.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.conditioning.mounting import mounting
from quatprop.errors import LogError, NoRatesError, UndeclaredError, UsageError
from quatprop.logs.clocks.stamps import choose_time
from quatprop.logs.matching.find import Found, Match, marks_of
from quatprop.logs.matching.matcher import ColumnMatcher
from quatprop.logs.vocabulary.names import BARE_RATES, BESIDE_BARE_RATES, WITH_RATE_UNIT
from quatprop.logs.vocabulary.rows import RATE_PARTS
from quatprop.logs.vocabulary.sources import GENERIC, ROWS
from quatprop.settings.quantities import RATES, SCALED_RATE_UNITS
from quatprop.tables.column_names import AXIS_FIRST, RATE_UNITS
from quatprop.text import Setting, listed, plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.logs.vocabulary.rows import Row
    from quatprop.settings.selection import RateSelection, SignalSelection


def match_rates(found: Found, selection: RateSelection) -> Match:
    """Return the rates of a table, with unit and timestamp."""
    matcher = ColumnMatcher(found, selection, "rate_cols")
    row = found.row
    if not found.sets:
        row = matcher.row("rate")
        found = _in_file(matcher, row, selection.rate_cols)
    notes, rate = matcher.notes, found.sets[0]
    declared = matcher.unit("rate", rate, {**RATE_UNITS, **SCALED_RATE_UNITS}, found.row.unit)
    unit, scale = SCALED_RATE_UNITS.get(declared, (declared, 1.0))
    marks = marks_of(found)
    stamp, table = choose_time(matcher, found, marks, row)
    if scale != 1.0:
        remark = f"the rates are in {declared}, which is read as {scale:.4g} {unit}"
        matcher.remark("scaled-unit", remark)
    if notes.mount:
        matcher.remark("stated-mount", _mount_remark(notes.mount))
    factor = scale * notes.rate_scale * RATES[unit]
    is_named = selection.rate_field is not None or selection.rate_cols is not None
    found, remarks = found._replace(table=table), tuple(matcher.remarks)
    return Match(*found, stamp, factor, marks, remarks, unit, is_named=is_named)


def _in_file(matcher: ColumnMatcher, row: Row, named: Sequence[str] | None) -> Found:
    """Return the columns of rates in a file, by their names."""
    by_row = matcher.sets(RATE_PARTS, row.rate)
    # Axes with a unit of rates have the same priority as names of a gyroscope.
    units = {*RATE_UNITS, *SCALED_RATE_UNITS}
    with_unit = matcher.sets(RATE_PARTS, *WITH_RATE_UNIT)
    by_unit = (columns for columns in with_unit if matcher.declared(columns) in units)
    sets = [*dict.fromkeys((*by_row, *matcher.sets(RATE_PARTS, AXIS_FIRST), *by_unit))]
    # Bare names such as gx or p are rates, unless axes of other quantities are beside them: then
    # gx may be gravity. The user has to declare their unit.
    others = {k for columns in with_unit for k in columns} - {*matcher.matching(BESIDE_BARE_RATES)}
    bare = (columns for columns in matcher.sets(RATE_PARTS, *BARE_RATES) if others == {*columns})
    sets = sets or [*bare]
    if named is not None:
        rate = matcher.named(named)
    elif not sets:
        raise _no_rates(matcher)
    elif by_row and row.burst is not None:
        rate = by_row[0]
    else:
        rate = matcher.only_set(sets, "set of rates", "x")
    estimates = [one.rate for one in ROWS if one.name == row.name and not one.measured]
    if ignored := matcher.sets(RATE_PARTS, *estimates) if row.measured else []:
        names = listed(map(matcher.spelled, ignored))
        matcher.remark("ignored-signals", f"ignored estimated body rates: {names}")
    own = row if rate in by_row else GENERIC
    samples = (rate,) if own.burst is None else tuple(by_row)
    return matcher.found(own, samples)._replace(field=matcher.spelled(rate))


def _no_rates(matcher: ColumnMatcher) -> LogError:
    """Return the error for a table without rates, or with rates about unknown axes."""
    if angles := matcher.matching(r"(?:.*[._])?(?:roll|pitch|yaw)_?rate")[:3]:
        return UndeclaredError(
            matcher.path,
            f"about which axes {matcher.names(angles)} turn (those of the body, or others, as in "
            "OpenRocket)",
            f"{Setting('rate_cols', 'X,Y,Z')} if they are those of the body",
        )
    return NoRatesError(matcher.path, matcher.seen(), "columns")


def match_bias(found: Found, selection: SignalSelection) -> Match:
    """Return the biases of a gyroscope, with unit and timestamp."""
    matcher = ColumnMatcher(found, selection, "bias")
    if not found.sets:
        row = matcher.row("bias")
        sets = matcher.sets(RATE_PARTS, row.bias)
        if not sets:
            names = listed(column.text for column in matcher.columns)
            raise UsageError(
                f"{Setting('bias')} {plain(matcher.path)}: no columns are named as biases of a "
                f"gyroscope, such as b_w_RS_S_x or gyro_bias_x; there are {names}"
            )
        bias = matcher.only_set(sets, "set of biases", "x")
        found = matcher.found(row, (bias,))._replace(field=matcher.spelled(bias))
    unit = matcher.unit("rate", found.sets[0], RATE_UNITS, found.row.unit)
    if not unit:
        raise UsageError(
            f"{Setting('bias')} {plain(matcher.path)}: the unit of "
            f"{matcher.names(found.sets[0])} is not declared; name it in the header, such as "
            "gyro_bias_x [rad/s]"
        )
    stamp, table = choose_time(matcher, found)
    return Match(*found._replace(table=table), stamp, RATES[unit], unit=unit)


def _mount_remark(mount: str) -> str:
    """Return the remark on a mounting that a file declares."""
    try:
        mounting(mount)
        way_out = f"to turn them into the camera's axes use {Setting('mount', mount)}"
    except UsageError:
        way_out = f"as the mounting {mount} is left-handed, it cannot be right"
    taken = "the file says how its sensor is mounted, and rates are used as they are"
    return f"{taken}; {way_out}"
