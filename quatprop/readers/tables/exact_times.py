"""Convert the times of tables to int64 nanoseconds exactly, never through float64.

Without its point, a decimal number of seconds with 9 places is an integer in ns. A column is
therefore read as decimal128 with the scale of ns, and the unscaled integers are taken from its
buffer. Other units are integers of their own steps first, which are then multiplied exactly.
"""

from __future__ import annotations

import re
from decimal import ROUND_HALF_EVEN, Context, Decimal, InvalidOperation, Overflow
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from quatprop.base.arrow_arrays import to_numpy
from quatprop.base.errors import UsageError
from quatprop.base.text import Setting
from quatprop.base.times import NS_PER_S, NS_PER_UNIT, numbered_stamps, regular_stamps
from quatprop.readers.tables.time_units import COUNTS, PLACES, TEXTS, TIME_OF_DAY, time_scale

if TYPE_CHECKING:
    from collections.abc import Iterable

    from quatprop.base.arrays import Float64, Int64
    from quatprop.readers.tables.time_units import TimeScale


_PIECE_BYTES = 1 << 16
"""Bytes of text examined at a time, so that they stay in the cache."""

SPARE_PLACES = 9
"""Further places for times finer than 1 ns, such as floats printed in full."""

_NOON, _LAST_HOUR, _SIXTY, _PLACES = 12, 23, 60, 9

_DIGITS = 38
_FROM_2000_NS, _UNTIL_2100_NS = 946_684_800 * NS_PER_S, 4_102_444_800 * NS_PER_S
_LIMITS = np.iinfo(np.int64)
_EXACT = Context(prec=400, rounding=ROUND_HALF_EVEN)


class TimestampRangeError(ValueError):
    """The time does not fit in int64 ns."""


def decimal_type(unit: str, spare: int = 0) -> pa.DataType:
    """Return the decimal type with unscaled integers in ns / 10**spare.

    pyarrow refuses text with more digits than the precision, but does not check that the number
    fits after rescaling. Precision + scale = 38 ensures that it does.
    """
    if unit in TEXTS:
        return pa.string()
    scale = time_scale(unit).places + spare
    return pa.decimal128(_DIGITS - scale, scale)


def refuse_tiny_numbers(data: bytes | memoryview) -> None:
    """Refuse numbers below 1e-39, which pyarrow must not read as decimals.

    It would read powers of ten beyond the end of a table, and crash for a few thousand places.
    """
    if not (may_hold(data, b"e") or may_hold(data, b"E")):
        return
    for begin in range(0, len(data), _PIECE_BYTES):
        piece = bytes(data[begin : begin + _PIECE_BYTES + len("-400")]) + b"   "
        text = np.frombuffer(piece, np.uint8)
        for letter in b"eE":
            # Fast exit: few texts have exponents.
            if letter not in piece:
                continue
            marks = np.flatnonzero(text == letter)
            marks = marks[text[marks + 1] == ord("-")] + 1
            first, second, third = (text[marks + k] - np.uint8(ord("0")) for k in (1, 2, 3))
            if np.any((first <= 9) & (second <= 9) & ((third <= 9) | (first >= 4))):  # noqa: PLR2004  # digits
                raise TimestampRangeError("its time is a number below 1e-39")


def may_hold(data: bytes | memoryview, mark: bytes) -> bool:
    """Return whether a text, or others that share its memory, contain a byte."""
    whole = data.obj if isinstance(data, memoryview) else data
    return not isinstance(whole, bytes | bytearray) or mark in whole


def nanoseconds(column: pa.ChunkedArray | pa.Array, unit: str) -> Int64:
    """Return a time column without nulls in int64 ns.

    `column`: times, or numbers of any type in `unit`, rounded half to even; texts of `TEXTS`
    `unit`: see :func:`quatprop.readers.tables.time_units.time_scale`
    `Returns`: shape ``(N,)``, int64, ns
    """
    if unit == TIME_OF_DAY and pa.types.is_time(column.type):
        return to_numpy(column.cast(pa.time64("ns")).cast(pa.int64()))
    if unit in TEXTS:
        return _of_texts(column, unit)
    scale = time_scale(unit)
    if pa.types.is_decimal128(column.type):
        chunks = column.chunks if isinstance(column, pa.ChunkedArray) else [column]
        parts = [_unscaled(_rounded(chunk, scale.places)) for chunk in chunks]
        return _from_steps(np.concatenate([np.empty(0, np.int64), *parts]), scale)
    if pa.types.is_floating(column.type):
        return from_floats(to_numpy(column.cast(pa.float64())), unit)
    try:
        integers = to_numpy(column.cast(pa.int64()))
    except pa.ArrowInvalid as error:
        raise TimestampRangeError from error
    factor = 10**scale.places
    largest = _LIMITS.max // factor
    if len(integers) and (integers.max() > largest or integers.min() < -largest):
        raise TimestampRangeError
    return _from_steps(integers * factor if factor > 1 else integers, scale)


def _from_steps(steps: Int64, scale: TimeScale) -> Int64:
    """Return whole numbers of steps in ns since the epoch of their unit."""
    if scale.step_ns != 1:
        # First what the epoch is in steps: ticks since 1601 do not fit in int64 ns.
        before, rest = divmod(Fraction(scale.epoch_ns), scale.step_ns)
        scaled = np.asarray(steps)
        if before:
            scaled = _checked_sum(steps, before)
        try:
            stamps = numbered_stamps(scaled, NS_PER_S / scale.step_ns)
        except UsageError as error:
            raise TimestampRangeError from error
        return _checked_sum(stamps, round(rest)) if rest else stamps
    return _checked_sum(steps, scale.epoch_ns) if scale.epoch_ns else steps


def _checked_sum(stamps: Int64, constant: int) -> Int64:
    if not len(stamps):
        return stamps
    low, high = int(stamps.min()) + constant, int(stamps.max()) + constant
    if low < _LIMITS.min or high > _LIMITS.max or abs(constant) > _LIMITS.max:
        raise TimestampRangeError
    total: Int64 = stamps + np.int64(constant)
    return total


def _of_texts(column: pa.ChunkedArray | pa.Array, unit: str) -> Int64:
    """Return times that are text, such as ``10:00:00.5``, in ns since their zero."""
    import pyarrow.compute as pc  # slow to import, and seldom needed

    names = re.compile(TEXTS[unit]).groupindex
    parts = pc.extract_regex(column, f"^{TEXTS[unit]}$")
    if parts.null_count:
        raise TimestampRangeError

    def numbers(name: str, digits: int = 0) -> Int64:
        if name not in names:
            return np.zeros(len(column), np.int64)
        text = pc.struct_field(parts, name)
        if digits:
            text = pc.utf8_slice_codeunits(pc.utf8_rpad(text, digits, "0"), 0, digits)
        return to_numpy(text.cast(pa.int64()))

    if "whole" in names:
        (count,) = names.keys() & COUNTS
        whole = numbers("whole")
        if np.any(whole >= _LIMITS.max // NS_PER_S):
            raise TimestampRangeError
        counted: Int64 = whole * NS_PER_S + numbers(count) * NS_PER_UNIT[count]
        return counted
    hours, minutes, seconds = map(numbers, "hms")
    # Leap seconds are 60.
    is_wrong = (seconds > _SIXTY) & ("m" in names)
    if "h" in names:
        is_wrong |= minutes >= _SIXTY
    if "half" in names:
        half = pc.utf8_lower(pc.struct_field(parts, "half"))
        is_half = to_numpy(pc.not_equal(half, ""))
        is_wrong |= is_half & ((hours < 1) | (hours > _NOON))
        hours = np.where(is_half, hours % _NOON + _NOON * to_numpy(pc.equal(half, "p")), hours)
    if (is_wrong | (hours > _LAST_HOUR)).any():
        raise TimestampRangeError
    whole = (hours * _SIXTY + minutes) * _SIXTY + seconds
    stamps: Int64 = whole * NS_PER_S + numbers("part", _PLACES) + numbers("ms", _PLACES)
    for count in COUNTS:
        stamps += numbers(f"count_{count}") * NS_PER_UNIT[count]
    return stamps


def _rounded(chunk: pa.Array, places: int) -> pa.Array:
    """Return decimals rounded to a number of places."""
    if chunk.type.scale == places:
        return chunk
    import pyarrow.compute as pc  # slow to import, and seldom needed

    wide = chunk.view(pa.decimal128(_DIGITS, chunk.type.scale))
    try:
        if chunk.type.scale > places:
            wide = pc.round(wide, ndigits=places, round_mode="half_to_even")
        return wide.cast(pa.decimal128(_DIGITS, places))
    except pa.ArrowInvalid as error:
        raise TimestampRangeError from error


def _unscaled(chunk: pa.Array) -> Int64:
    halves = np.frombuffer(chunk.buffers()[1], np.int64).reshape(-1, 2)
    low, high = halves[chunk.offset : chunk.offset + len(chunk)].T
    if np.any(high != low >> 63):
        raise TimestampRangeError
    stamps: Int64 = low
    return stamps


def from_text(text: str, unit: str) -> int:
    """Return one time in ns, rounded half to even."""
    if unit in TEXTS:
        return _of_text(text, unit)
    scale = time_scale(unit)
    try:
        number = Decimal(text.strip()).scaleb(scale.places, _EXACT)
        whole = number.to_integral_value(context=_EXACT)
    except Overflow as error:
        raise TimestampRangeError(text) from error
    except InvalidOperation as error:
        raise ValueError(text) from error
    if not whole.is_finite():
        raise ValueError(text)
    if not _LIMITS.min <= whole <= _LIMITS.max:
        raise TimestampRangeError(text)
    if scale.step_ns == 1 and not scale.epoch_ns:
        return int(whole)
    return int(_from_steps(np.array([int(whole)], np.int64), scale)[0])


def _of_text(text: str, unit: str) -> int:
    try:
        return int(_of_texts(pa.array([text]), unit)[0])
    except TimestampRangeError as error:
        raise ValueError(text) from error


def likely_unit(text: str) -> str:
    """Return the unit in which a number is a time in this century; ``""``: none."""
    for unit in PLACES:
        try:
            t_ns = from_text(text, unit)
        except ValueError:
            continue
        if _FROM_2000_NS <= t_ns < _UNTIL_2100_NS:
            return unit
    return ""


def from_floats(values: Float64, unit: str) -> Int64:
    """Return finite floats in ns: their exact value, rounded half to even.

    Integer and fractional parts are scaled separately, so that only the result is rounded.
    """
    scale = time_scale(unit)
    factor = 10**scale.places
    whole = np.floor(values)
    if np.any(np.abs(values) >= _LIMITS.max // factor):
        raise TimestampRangeError
    fraction = (values - whole) * factor
    nanos = np.rint(fraction)
    # A product at exactly one half may have been rounded to it.
    for row in np.flatnonzero(np.abs(fraction - nanos) == 0.5):  # noqa: PLR2004  # the half
        nanos[row] = round(Fraction(float(values[row] - whole[row])) * factor)
    return _from_steps(whole.astype(np.int64) * factor + nanos.astype(np.int64), scale)


def sum_parts(parts: Iterable[Int64]) -> Int64:
    """Return the sum of the parts of a timestamp, each in ns, shape ``(N,)``, int64."""
    first, *others = parts
    for other in others:
        total = first + other
        if np.any((first ^ total) & (other ^ total) < 0):
            raise TimestampRangeError
        first = total
    return first


def row_stamps(first: int, count: int, sample_rate: Fraction | float) -> Int64:
    """Return the timestamps of rows at a constant rate.

    `sample_rate`: Hz; a float is taken as its shortest decimal
    `Returns`: shape ``(count,)``, int64, ns
    """
    try:
        return regular_stamps(first, first + count, Fraction(str(sample_rate)))
    except UsageError as error:
        raise UsageError(f"{error.text}; check {Setting('sample_rate')}") from None
