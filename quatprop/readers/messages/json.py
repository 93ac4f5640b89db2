"""Decode JSON messages, whose fields are those of the first messages.

JSON schemas are optional and loose, so the first messages of a channel serve as its definition.
Blocks that match it are parsed at once, as the lines of one document; others message by message,
with the same result.
"""

from __future__ import annotations

import json
import math
import re
from contextlib import suppress
from decimal import Decimal
from functools import reduce
from itertools import islice
from operator import getitem
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.json as pyarrow_json

from quatprop.base.arrow_arrays import nested_schema, to_numpy
from quatprop.base.errors import UsageError
from quatprop.base.times import instant
from quatprop.readers.messages.blocks import NANOSECONDS, SECONDS
from quatprop.readers.messages.columns import ValueDecoder, WantedColumn, raw_messages
from quatprop.readers.messages.schema import (
    TIME,
    Array,
    BadDefinitionError,
    Primitive,
    String,
    Struct,
    TextNumber,
    Unknown,
    key_path_of,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from quatprop.base.arrays import AnyArray
    from quatprop.base.provenance import JsonObject
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.messages.schema import KeyPath, Type


FLOAT = Primitive("f8")
TEXT_FLOAT = TextNumber("f8")
INTEGER = Primitive("i8")
MAX_INTEGER = int(np.iinfo(np.int64).max)

SAMPLED, SAMPLED_BYTES = 50, 1 << 20
"""Maximum number and bytes of the messages that define the others."""

AXES = ("x", "y", "z", "w")
"""The order of vector components: JSON objects have no order."""

NUMBER = re.compile(r"\s*[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\s*", re.ASCII)
"""A number written as text."""
_MANY_PLACES = re.compile(rb"[eE]-\d{3}|\d{200}")


def message_type(channel: Channel) -> Struct:
    """Return the type of a channel's messages, from its sample message."""
    if not channel.sample:
        return Struct(channel.type_name, ())
    try:
        sample = json.loads(channel.sample)
    except (RecursionError, ValueError):
        sample = None
    if not isinstance(sample, dict):
        raise BadDefinitionError("its first message is not a JSON object")
    return Struct(channel.type_name, _fields(sample))


def sample_of(messages: Iterable[bytes]) -> bytes:
    """Merge messages into one with the fields of all, each with its first value.

    Null and an empty list are replaced by the value of a later message. A message that is not a
    JSON object is returned only if there are no others.
    """
    sample, other, room = None, b"", SAMPLED_BYTES
    for raw in islice(messages, SAMPLED):
        try:
            message = json.loads(raw)
        except (RecursionError, ValueError):
            message = None
        if isinstance(message, dict):
            sample = _merged(sample, message)
        else:
            other = other or raw
        room -= len(raw)
        if room < 0:
            break
    return other if sample is None else json.dumps(sample).encode()


def _merged(one: Any, other: Any) -> Any:
    if isinstance(one, dict) and isinstance(other, dict):
        return {name: _merged(one.get(name), other.get(name)) for name in one | other}
    if isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        return list(map(_merged, one, other))
    return other if one is None or one == [] else one


def first_texts(block: MessageBlock, field_path: str) -> list[str]:
    """Return the distinct values of a text field in the first messages of a block."""
    texts: dict[str, None] = {}
    for raw in islice(raw_messages(block), SAMPLED):
        with suppress(LookupError, RecursionError, TypeError, ValueError):
            value = reduce(getitem, key_path_of(field_path) or (), json.loads(raw))
            if isinstance(value, str):
                texts[value] = None
    return [*texts]


def _fields(sample: JsonObject) -> tuple[tuple[str, Type], ...]:
    for seconds in SECONDS:
        for nanoseconds in NANOSECONDS:
            if set(sample) == {seconds, nanoseconds}:
                return (seconds, INTEGER), (nanoseconds, INTEGER)
    names = [name for name in AXES if name in sample] if set(sample) <= set(AXES) else list(sample)
    return tuple((name, _type(sample[name])) for name in names)


def has_order(kind: Type) -> bool:
    """Return whether the parts of a field are ordered: of objects, only vectors and times are."""
    if not isinstance(kind, Struct):
        return True
    return {name for name, _ in kind.fields} <= {*AXES, *SECONDS, *NANOSECONDS}


def _type(sample: Any) -> Type:
    if isinstance(sample, dict):
        return Struct("", _fields(sample))
    if isinstance(sample, list):
        return Array(_type(sample[0]) if sample else Unknown("nothing"), len(sample))
    if isinstance(sample, bool):
        return Primitive("b1")
    if isinstance(sample, int | float):
        return FLOAT
    return _type_of_text(sample) if isinstance(sample, str) else Unknown("null")


def _type_of_text(text: str) -> Type:
    if NUMBER.fullmatch(text):
        return TEXT_FLOAT
    return TIME if _is_time(text) else String()


def _is_time(text: str) -> bool:
    """Return whether a text is a time of RFC 3339."""
    try:
        return not text.isdecimal() and instant(text).origin == "clock"
    except UsageError:
        return False


class JsonDecoder(ValueDecoder):
    """Decodes fields of JSON messages.

    A single number may be a time, so it is kept exact, as a decimal. Null and missing numbers are
    NaN.
    """

    def __init__(self, channel: Channel, field_paths: Sequence[str], path: Path | str) -> None:
        super().__init__(channel, field_paths, path)
        self._schema = _schema(self.wanted)

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks, parsed at once if possible."""
        columns = self._at_once(blocks) if self._schema is not None and any(blocks) else None
        return super().columns(*blocks) if columns is None else columns

    def _at_once(self, blocks: Sequence[MessageBlock]) -> list[AnyArray] | None:
        # A line break in a message is white space: in a string it would be escaped.
        document = b"\n".join(message.replace(b"\n", b" ") for message in raw_messages(*blocks))
        try:
            table = pyarrow_json.read_json(
                pa.BufferReader(document),
                read_options=pyarrow_json.ReadOptions(block_size=len(document) + 1),
                parse_options=pyarrow_json.ParseOptions(
                    explicit_schema=self._schema, unexpected_field_behavior="ignore"
                ),
            )
            if len(table) != sum(map(len, blocks)):
                return None
            columns = [_stacked(table, wanted) for wanted in self.wanted]
        except (pa.ArrowException, _MismatchError):
            return None
        exact = (c for c, wanted in zip(columns, self.wanted, strict=True) if _is_exact(wanted))
        # Arrow reads some decimals of more than 200 places as zero.
        if any((column == 0).any() for column in exact) and _MANY_PLACES.search(document):
            return None
        return columns

    def _parsed(self, raw: bytes) -> Any:
        return json.loads(raw, parse_float=Decimal)

    def _value(self, message: Any, key_path: KeyPath, number: Primitive) -> Any:
        value = message
        for key in key_path:
            if value is None:
                break
            value = value.get(key) if isinstance(value, dict) else value[key]
        if number == TIME:
            return _time(value)
        if value is None and number in {FLOAT, TEXT_FLOAT}:
            return math.nan
        if isinstance(value, bool) != (number.code == "b1"):
            raise ValueError
        if number == TEXT_FLOAT and isinstance(value, str):
            value = Decimal(value.strip())
        elif number == INTEGER and isinstance(value, str):
            value = int(value)  # protobuf writes 64-bit integers so
        if not isinstance(value, int | float | Decimal):
            raise TypeError
        if number == INTEGER and (value != int(value) or not -MAX_INTEGER < value < MAX_INTEGER):
            raise ValueError
        return value

    def _dtype(self, wanted: WantedColumn) -> np.dtype[Any]:
        if wanted.number == TIME:
            return np.dtype(np.int64)
        return np.dtype(object if _is_exact(wanted) else wanted.number.code)


class _MismatchError(Exception):
    """Arrow's columns are not the values that the messages have."""


def _is_exact(wanted: WantedColumn) -> bool:
    return wanted.single and wanted.number in {FLOAT, TEXT_FLOAT}


def _time(value: Any) -> int:
    if not isinstance(value, str):
        raise TypeError
    moment = pa.scalar(value).cast(pa.timestamp("ns", "UTC"))
    return int(moment.cast(pa.int64()).as_py())


def _schema(columns: Sequence[WantedColumn]) -> pa.Schema | None:
    """Return Arrow's schema of the wanted columns; None if it cannot express them."""
    fields: dict[tuple[Any, ...], pa.DataType] = {}
    for wanted in columns:
        for key_path in wanted.key_paths:
            is_list = isinstance(key_path[-1], int)
            names = key_path[:-1] if is_list else key_path
            kind = pa.list_(_element(wanted)) if is_list else _leaf(wanted)
            if (
                any(isinstance(name, int) for name in names)
                or fields.setdefault(names, kind) != kind
            ):
                return None
    return nested_schema(fields)


def _element(wanted: WantedColumn) -> pa.DataType:
    return pa.string() if wanted.number == TEXT_FLOAT else pa.float64()


def _leaf(wanted: WantedColumn) -> pa.DataType:
    if wanted.number == TIME:
        return pa.timestamp("ns", "UTC")
    if _is_exact(wanted):
        # With precision + scale = 76 no number overflows.
        return pa.decimal256(46, 30)
    whole = {"i8": pa.int64(), "b1": pa.bool_()}
    return whole.get(wanted.number.code) or _element(wanted)


def _stacked(table: pa.Table, wanted: WantedColumn) -> AnyArray:
    parts = [_part(table, key_path, wanted) for key_path in wanted.key_paths]
    return parts[0] if wanted.single else np.stack(parts, axis=1)


def _part(table: pa.Table, key_path: KeyPath, wanted: WantedColumn) -> AnyArray:
    """Return one number per message, shape ``(N,)``."""
    column = table.column(key_path[0])
    for key in key_path[1:]:
        if isinstance(key, int):
            column = pc.list_element(column, key)
        else:
            column = pc.struct_field(column, key)
    if wanted.number not in {FLOAT, TEXT_FLOAT} and column.null_count:
        raise _MismatchError
    if pa.types.is_string(column.type):
        column = column.cast(pa.float64())
    if wanted.number == TIME:
        column = column.cast(pa.int64())
    if pa.types.is_decimal(column.type):
        values = [math.nan if value is None else value for value in column.to_pylist()]
        return np.array(values, object)
    return to_numpy(column)
