"""Body rates of a log: their columns, and their values in rad/s with timestamps in ns."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from quatprop.base.errors import (
    MAX_LOSSES,
    DamagedLogError,
    LogError,
    NoRatesError,
    UndeclaredError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.base.places import without_secret
from quatprop.base.text import Remark, Setting, listed, plain, quoted
from quatprop.kinematics.conventions import mounting
from quatprop.readers.column_readings import ABSENT, absent_at_first, are_marked, refuse_marked
from quatprop.readers.matching import ColumnMatcher, Found, Match, find, marks_of
from quatprop.readers.rate_names import (
    frame_in,
    is_of_another,
    other_meaning_of,
    role_in,
    unknown_word_in,
)
from quatprop.readers.row_stamps import choose_time
from quatprop.readers.signal import BODY_RATES, Candidate, RateSignal, candidates, choose
from quatprop.readers.tables.table_log import (
    AXIS_FIRST,
    BEFORE_WORD,
    GYROSCOPE,
    RATE_UNITS,
    contradicting_units,
    numbers_of,
    parse_name,
    suffix_of,
)
from quatprop.readers.vocabulary import (
    ANGLE_RATES,
    BARE_RATES,
    GENERIC,
    OTHER_BARE_NAMES,
    RATE_PARTS,
    ROWS,
    WITH_RATE_UNIT,
    XYZ,
)
from quatprop.settings.quantities import RATES, SCALED_RATE_UNITS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.kinematics.series import GyroSeries
    from quatprop.readers.tables.model import Group, Log, Table
    from quatprop.readers.vocabulary import Row
    from quatprop.settings.reading import RateSelection, SignalSelection


# Match the columns of rates and biases, with unit and timestamp.
#
# In files they are found by the vocabulary, by clear names, or named by the user.


def match_rates(found: Found, selection: RateSelection) -> Match:
    """Return the rates of a table, with unit and timestamp."""
    matcher = ColumnMatcher(found, selection, "rate_cols")
    row = found.row
    if not found.sets:
        row = matcher.row("rate")
        found = _in_file(matcher, row, selection)
    elif selection.rate_field is not None and not row.types:
        _remark_on_names(matcher, found.sets[0], selection)
    notes, rate = matcher.notes, found.sets[0]
    declared = matcher.unit("rate", rate, {**RATE_UNITS, **SCALED_RATE_UNITS}, found.row.unit)
    unit, scale = SCALED_RATE_UNITS.get(declared, (declared, 1.0))
    matcher.remark_on_text(rate)
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


def _in_file(matcher: ColumnMatcher, row: Row, selection: RateSelection) -> Found:
    """Return the columns of rates in a file, by their names."""
    by_row = matcher.sets(RATE_PARTS, row.rate)
    # Axes with a unit of rates have the same priority as names of a gyroscope.
    with_unit = matcher.sets(RATE_PARTS, *WITH_RATE_UNIT)
    by_unit = (columns for columns in with_unit if _is_rate_unit(matcher.declared(columns)))
    in_frames = (o for o in matcher.sets(RATE_PARTS, BEFORE_WORD) if frame_in(_keys(matcher, o)))
    by_name = (*by_row, *matcher.sets(RATE_PARTS, AXIS_FIRST), *in_frames)
    sets = [one for one in dict.fromkeys((*by_name, *by_unit)) if _is_of_body(matcher, one)]
    # Bare names such as gx or p are rates, unless axes of other quantities are next to them: then
    # gx may be gravity. The user has to declare their unit.
    others = {k for columns in with_unit for k in columns} - {*matcher.matching(OTHER_BARE_NAMES)}
    bare = (columns for columns in matcher.sets(RATE_PARTS, *BARE_RATES) if others == {*columns})
    sets = sets or [*bare]
    if selection.rate_cols is not None:
        rate = matcher.named(selection.rate_cols)
        # Their names may be any, but not the units at their ends.
        matcher.named_units = {k: suffix_of(matcher.columns[k].text) for k in rate}
        _remark_on_names(matcher, rate, selection)
    elif not sets:
        raise _no_rates(matcher)
    elif by_row and row.burst is not None:
        rate = by_row[0]
    else:
        rate = _body_rates(matcher, sets, dict.fromkeys(by_row, row), selection)
    estimates = [one.rate for one in ROWS if one.name == row.name and not one.measured]
    estimated = matcher.sets(RATE_PARTS, *estimates) if row.measured else []
    if ignored := [one for one in estimated if {*one}.isdisjoint(rate)]:
        names = listed(map(matcher.spelled, ignored))
        matcher.remark("ignored-signals", f"ignored estimated body rates: {names}")
    if selection.rate_cols is None and row is GENERIC:
        _remark_on_repeated(matcher, rate)
    own = row if rate in by_row else GENERIC
    samples = (rate,) if own.burst is None else tuple(by_row)
    return matcher.found(own, samples)._replace(field=matcher.spelled(rate))


def _is_rate_unit(unit: str) -> bool:
    """Return whether a unit is one of rates, or contradicted by another one."""
    units = contradicting_units(unit) or (unit,)
    return not {*units}.isdisjoint({*RATE_UNITS, *SCALED_RATE_UNITS})


_REPEATED = r"(?:\.|_|_duplicated_)\d+|[ _.]?copy"
"""What makes a name unique that another column has already."""


def _body_rates(
    matcher: ColumnMatcher, sets: list[Group], by_row: dict[Group, Row], selection: RateSelection
) -> Group:
    """Return the only set of columns that may be the rates; refuse what its names leave open.

    `by_row`: the sets that a row of the vocabulary defines, and the row
    """
    by_program = {one: row for one, row in by_row.items() if row is not GENERIC}
    sets = _present_sets(matcher, sets)
    frames = {
        one: by_program[one].axes if one in by_program else frame_in(_keys(matcher, one))
        for one in sets
    }
    in_frames = [one for one in sets if frames.get(one)]
    of_body = [one for one in sets if one not in in_frames]
    if selection.rates == "inertial":
        return matcher.only_set(in_frames or of_body, "set of rates", "x")
    if not of_body:
        rate = matcher.only_set(in_frames, "set of rates", "x")
        names, frame = matcher.names(rate), quoted(frames[rate])
        named = matcher.setting_for(rate)
        matcher.unknown.append((
            f"whether {names} are about axes of the body or of {frame}",
            f"{Setting('rates', 'inertial')} if of the latter, else with {named}",
        ))  # fmt: skip
        return rate
    rate = matcher.only_set(of_body, "set of rates", "x")
    is_known = rate in by_program or len(of_body) > 1
    if not is_known and (word := unknown_word_in(_keys(matcher, rate))):
        names = matcher.names(rate)
        what = f"whether {names} are the rates of the body ({quoted(word)} does not tell)"
        matcher.unknown.append((what, f"{matcher.setting_for(rate)} if they are"))
    return rate


def _remark_on_repeated(matcher: ColumnMatcher, rate: Group) -> None:
    """Remark on columns with the names of the rates and a number, as of a second sensor."""
    names = [column.text.strip() for column in matcher.columns]
    first = names[rate[0]]
    for end in (name.removeprefix(first) for name in names if name.startswith(first)):
        others = [f"{names[k]}{end}" for k in rate]
        if re.fullmatch(_REPEATED, end) and all(other in names for other in others):
            repeated = tuple(map(names.index, others))
            matcher.remark(
                "repeated-rates",
                f"{matcher.names(repeated)} are not read; to read them instead, name them with "
                f"{matcher.setting_for(repeated)}",
            )


def _present_sets(matcher: ColumnMatcher, sets: list[Group]) -> list[Group]:
    """Return the sets of columns that have numbers in the first rows, and remark on the others.

    If none has, return all.
    """
    names = [matcher.columns[k].text for k in {k for one in sets for k in one}]
    if len(sets) <= 1 or len({*names}) < len(names):  # columns of one name are refused
        return sets
    present = []
    for one in sets:
        (mark,) = marks_of(matcher.found(GENERIC, (one,))) or (one[0],)
        rows = matcher.table.head((*one, mark))
        numbers = np.array([numbers_of(cells) for cells in rows]).reshape(-1, len(one) + 1)
        is_marked = (numbers[:, -1] == ABSENT) & (mark not in one)
        if not rows or (np.isfinite(numbers[:, :-1]).all(axis=1) & ~is_marked).any():
            present.append(one)
    if not present or len(present) == len(sets):
        return sets
    absent = listed(matcher.spelled(one) for one in sets if one not in present)
    text = f"ignored rates that are absent in the first {len(rows)} rows: {absent}"
    matcher.remark("absent-rates", text)
    return present


def _is_of_body(matcher: ColumnMatcher, columns: Group) -> bool:
    return not is_of_another(_keys(matcher, columns))


def _keys(matcher: ColumnMatcher, columns: Group) -> list[str]:
    return [matcher.columns[k].key for k in columns]


def _remark_on_names(matcher: ColumnMatcher, rate: Group, selection: RateSelection) -> None:
    """Remark on columns named by the user whose names tell another order, or another frame."""
    patterns = (*WITH_RATE_UNIT, AXIS_FIRST, *ANGLE_RATES, ".*" + XYZ)
    by_name = next((o for o in matcher.sets(RATE_PARTS, *patterns) if {*o} == {*rate}), rate)
    if by_name != rate:
        order = ", ".join("xyz"[by_name.index(k)] for k in rate)
        matcher.remark(
            "axis-order",
            f"x, y and z are read from {matcher.names(rate)}, which by their names are {order}",
        )
    frame = frame_in(_keys(matcher, rate))
    if frame and selection.rates is None:
        matcher.remark(
            "frame-in-names",
            f"{matcher.names(rate)} are read as rates about axes of the body; if they are about "
            f"those of {quoted(frame)}, use {Setting('rates', 'inertial')}",
        )
    if meaning := other_meaning_of(_keys(matcher, rate)):
        matcher.remark(
            "role-in-names",
            f"{matcher.names(rate)} are read as rates of the body, as requested, but by their "
            f"names they are {meaning}",
        )


def _no_rates(matcher: ColumnMatcher) -> LogError:
    """Return the error for a table without rates, with rates about unknown axes, or too many."""
    about = [
        columns
        for columns in matcher.sets(RATE_PARTS, *ANGLE_RATES)
        if _is_of_body(matcher, columns)
        and (_is_rate_unit(matcher.declared(columns)) or "rate" in matcher.columns[columns[0]].key)
    ]
    if about:
        return UndeclaredError(
            matcher.path,
            f"about which axes {matcher.names(about[0])} turn (those of the body, or others, as in "
            "OpenRocket)",
            f"{matcher.setting_for(about[0])} if they are those of the body",
        )
    listed_in = [matcher.columns[k].text.rpartition("[")[0] for k in matcher.matching(GYROSCOPE)]
    if stem := next(filter(None, listed_in), ""):
        columns = [k for k, one in enumerate(matcher.columns) if one.text.startswith(f"{stem}[")]
        return UndeclaredError(
            matcher.path,
            f"which of {matcher.names(columns)} are the rates about x, y and z",
            Setting("rate_cols", "X,Y,Z"),
        )
    if matcher.notes.unfit:
        remedy = f"correct the header, or count columns from 0 in {Setting('rate_cols', 'X,Y,Z')}"
        return UnsupportedLogError(matcher.path, f"{matcher.notes.unfit}; {remedy}")
    return NoRatesError(matcher.path, matcher.seen(), "columns", matcher.notes.packed)


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
        remedy = f"to turn them into the camera's axes use {Setting('mount', mount)}"
    except UsageError:
        remedy = f"as the mounting {mount} is left-handed, it cannot be right"
    taken = "the file says how its sensor is mounted, and rates are used as they are"
    return f"{taken}; {remedy}"


def choose_rates(log: Log, selection: RateSelection) -> RateSignal:
    """Return the only body rates in a log that match a selection; absent ones are none."""
    try:
        present, remarks = present_rates(rate_candidates(log, selection), selection)
        signal = choose(log, present, BODY_RATES)
    except NoRatesError as error:
        raise unless_damaged(log, error) from None
    remarks += _files_without(log, signal)
    is_named = selection.topic or selection.rate_field
    if not is_named and (word := _command_in(present[0].found)):
        raise UndeclaredError(
            log.path,
            f"whether the rates of topic {quoted(signal.name)} are those of the body "
            f"({quoted(word)} does not tell)",
            f"{Setting('topic', signal.name)} if they are",
        )
    return replace(signal, remarks=(*signal.remarks, *remarks)) if remarks else signal


def _files_without(log: Log, signal: RateSignal) -> list[Remark]:
    """Return the remark on files, of several, that have messages but none of the topic read."""
    read = {match.table.path for match in signal.matches}
    without = {log.path: log.tables() for log in log.joined if log.path not in read}
    names = [
        f"{plain(without_secret(path))}{_other_rates(tables)}"
        for path, tables in without.items()
        if any(table.is_typed and table.row_count() != 0 for table in tables)
    ]
    if not names:
        return []
    text = (
        f"nothing is read from files without messages of topic {quoted(signal.name)}: "
        f"{'; '.join(names)}; propagate each by itself if its rates are wanted"
    )
    return [Remark("files-without-topic", text)]


def _other_rates(tables: Sequence[Table]) -> str:
    """Return the topics of a file that carry rates, in parentheses; empty if there is none."""
    others = [table.name for table in tables if find(table, "rate")]
    return f" (its rates are on {listed(others)})" if others else ""


def _command_in(found: Found | Match) -> str:
    """Return the word for a command or the like in the topic of estimated rates; empty if none."""
    table, row = found.table, found.row
    is_open = table.is_typed and row.types and not row.measured
    return role_in([parse_name(table.name).key]) if is_open else ""


def present_rates(
    found: Sequence[Candidate[RateSignal]], selection: RateSelection
) -> tuple[Sequence[Candidate[RateSignal]], list[Remark]]:
    """Return the candidates whose rates are measured and not all absent; remarks on the others.

    If all are absent, or commanded, all are returned, without remarks.
    """
    of_body = [one for one in found if not _command_in(one.found)]
    remarks = []
    if ignored := [one.topic for one in found if of_body and one not in of_body]:
        text = f"ignored rates that by their names are not measured on the body: {listed(ignored)}"
        remarks.append(Remark("ignored-signals", text))
    found = of_body or found
    names = [(one.topic, one.field) for one in found]
    if len({*names}) <= 1:
        return found, remarks
    # A topic in several files is one.
    reasons: dict[tuple[str, str], list[str]] = {}
    for one, name in zip(found, names, strict=True):
        reasons.setdefault(name, []).append(_how_absent(one.found, selection))
    absent = {name: of_parts[0] for name, of_parts in reasons.items() if all(of_parts)}
    if len(absent) == len(reasons):
        return found, remarks
    of_reason: dict[str, list[str]] = {}
    topics = [topic for topic, _ in reasons]
    for (topic, field), reason in absent.items():
        of_reason.setdefault(reason, []).append(topic if topics.count(topic) == 1 else field)
    texts = (f"ignored rates that are {how}: {listed(them)}" for how, them in of_reason.items())
    kept = [one for one, name in zip(found, names, strict=True) if name not in absent]
    return kept, [*(Remark("absent-rates", text) for text in texts), *remarks]


def _how_absent(found: Found, selection: RateSelection) -> str:
    """Return how all rates of a topic are absent, by its beginning; empty if they are not."""
    with suppress(LogError, UsageError):
        if found.sets:
            match = match_rates(found, selection)
            return "all marked as absent" if are_marked(match) else absent_at_first(match)
    return ""


def unless_damaged(log: Log, error: LogError) -> LogError:
    """Return why a log has no rates: the given error, or that they may be in what it has lost."""
    lost = [f"{place}: {why}" for place, why, *_ in log.losses[:MAX_LOSSES]]
    if log.damage and not lost:
        lost = [f"end of the file: {log.damage}"]
    if not lost:
        return error
    reason = f"no body rates found in the part that can be read; lost: {'; '.join(lost)}"
    return DamagedLogError(log.path, reason)


def signal_of_series(series: GyroSeries) -> RateSignal:
    """Return rates in memory as a signal."""
    return RateSignal(
        name="series",
        type_name="",
        field="rate",
        clock="",
        series=series,
        unit="rad/s",
        method="end" if series.is_interval_average else None,
        increments=series.integration_time_ns is not None,
    )


def rate_candidates(log: Log, selection: RateSelection) -> list[Candidate[RateSignal]]:
    """Return the body rates in a log that match a selection, at least one."""
    return [
        Candidate(found, partial(_signal, found, selection), found.row.measured)
        for found in candidates(log, selection, BODY_RATES)
    ]


def _signal(found: Found, selection: RateSelection) -> RateSignal:
    """Return rates with their unit and timestamp."""
    match = match_rates(found, selection)
    refuse_marked(match)
    table, row = match.table, match.row
    return RateSignal(
        name=table.name or match.field,
        type_name=table.type or row.name,
        field=match.field,
        clock=match.stamp.clock,
        remarks=(*_sample_remarks(match), *match.remarks),
        unit=match.unit,
        unit_is_given=selection.rate_unit is not None,
        method=row.method,
        increments=row.span != "",
        matches=(match,),
        in_sequence=selection.in_sequence,
    )


def _sample_remarks(match: Match) -> tuple[Remark, ...]:
    """Return the remark on increments, bursts, or rates that are not measured."""
    if match.row.span:
        text = "the samples are angle increments: the sensor itself has summed up its rate"
        return (Remark("increments", text),)
    if match.row.burst is not None:
        text = "several samples per message: the time of each is counted back from the timestamp"
        return (Remark("bursts", text),)
    if word := _command_in(match):
        name = quoted(match.table.name)
        text = (
            f"by the name of topic {name} ({quoted(word)}) its rates are not measured on the body"
        )
        return (Remark("role-in-names", text),)
    return ()
