"""Message definitions as logs carry them, read into trees of types.

rosbags parses them; this module repairs what real logs do to the grammar, and adds two differences
between the encodings that a definition does not show: a ROS 1 ``time`` is unsigned, and an empty
message takes a byte in CDR and none in ROS 1.
"""

from __future__ import annotations

import re
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING

from quatprop.errors import SchemaError
from quatprop.messages.schema import (
    MAX_DEPTH,
    Array,
    BadDefinitionError,
    Primitive,
    Sequence,
    String,
    Struct,
    Unknown,
)
from quatprop.text import Setting, quoted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from rosbags.interfaces.typing import FieldDesc, Typesdict

    from quatprop.containers.base import Channel
    from quatprop.messages.schema import Type

NUMBERS: Mapping[str, Primitive] = {
    "bool": Primitive("b1"),
    "byte": Primitive("u1"),
    "char": Primitive("u1"),
    "int8": Primitive("i1"),
    "int16": Primitive("i2"),
    "int32": Primitive("i4"),
    "int64": Primitive("i8"),
    "uint8": Primitive("u1"),
    "uint16": Primitive("u2"),
    "uint32": Primitive("u4"),
    "uint64": Primitive("u8"),
    "float32": Primitive("f4"),
    "float64": Primitive("f8"),
}
"""Names of numbers in definitions."""

ROS1_TIMES: Mapping[str, Struct] = {
    name: Struct(name, (("sec", NUMBERS[number]), ("nanosec", NUMBERS[number])))
    for name, number in (
        ("builtin_interfaces/msg/Time", "uint32"),
        ("builtin_interfaces/msg/Duration", "int32"),
    )
}
"""``time`` and ``duration`` of ROS 1, under the names that the grammar gives them."""

GRAMMARS: Mapping[str, str] = {
    "json": "quatprop.messages.json",
    "protobuf": "quatprop.messages.protobuf",
    "ulog": "quatprop.messages.ulog",
}
"""Modules that read the definitions of encodings other than those of ROS."""

PLACEHOLDER = "structure_needs_at_least_one_member"
"""The byte that stands for an empty message in CDR."""

MAX_DEFINITION = 1 << 19
"""Most bytes of a definition: parsing more takes seconds, and no real message needs it."""

_RULE = "=" * 80
_SECTION = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
_COMMENT = re.compile(r"^[ \t]*#.*$", re.MULTILINE)
_CONSTANT = re.compile(r"^[ \t]*\S+[ \t]+\w+[ \t]*=.*$", re.MULTILINE)
_TRAILING = re.compile(r"[ \t]+$", re.MULTILINE)


def message_type(channel: Channel, path: Path | str) -> Struct:
    """Return the type of a channel's messages.

    Parameters
    ----------
    channel
        With its definition, or without one if its type is a standard one.
    path
        The log, for errors.

    Raises
    ------
    SchemaError
        The definition cannot be read, or there is none.
    """
    if channel.encoding not in GRAMMARS and not (channel.type_name or channel.schema.strip()):
        raise SchemaError(
            path,
            f"topic {quoted(channel.topic)}: the log does not say what its messages are, which are "
            f"encoded as {quoted(channel.encoding)}; export them as CSV with a program that knows "
            "it",
        )
    try:
        if channel.encoding in GRAMMARS:
            kind: Struct = import_module(GRAMMARS[channel.encoding]).message_type(channel)
            return kind
        return _message_type(
            channel.type_name, channel.encoding == "ros1", channel.schema_encoding, channel.schema
        )
    except BadDefinitionError as error:
        raise SchemaError(path, f"topic {quoted(channel.topic)}: ", *error.args) from None


@lru_cache(maxsize=256)
def _message_type(type_name: str, ros1: bool, schema_encoding: str, schema: bytes) -> Struct:
    own = _parsed(type_name, schema_encoding, schema) if schema.strip() else {}
    return _Builder(own, ros1).struct(type_name)


def _parsed(type_name: str, schema_encoding: str, schema: bytes) -> Typesdict:
    """Return the definitions that a log carries, by type name."""
    from rosbags.typesys import TypesysError, get_types_from_idl, get_types_from_msg

    if len(schema) > MAX_DEFINITION:
        raise BadDefinitionError(
            f"the definition of {quoted(type_name)} has {len(schema)} bytes, over the limit of "
            f"{MAX_DEFINITION}"
        )
    text = schema.decode("utf-8", "replace").replace("\r\n", "\n").lstrip("\ufeff").strip("\0")
    try:
        if schema_encoding in {"ros1msg", "ros2msg"}:
            types = get_types_from_msg(without_comments(text), type_name)
            # The grammar has its own idea of the spelling of service and action types.
            return {**types, type_name: types.get(type_name) or next(iter(types.values()))}
        if schema_encoding in {"ros2idl", "omgidl"}:
            parts = [get_types_from_idl(part) for part in idl_parts(text)]
            return {name: kind for part in parts for name, kind in part.items()}
    except (TypesysError, AssertionError, LookupError, RecursionError, TypeError, ValueError):
        # The parser's own message would contain the whole definition.
        raise BadDefinitionError(
            f"the definition of {quoted(type_name)} that the log carries cannot be parsed as "
            f"{schema_encoding}"
        ) from None
    raise BadDefinitionError(
        f"the definition of {quoted(type_name)} is written in {quoted(schema_encoding)}, "
        "which this version does not read for this encoding"
    )


def without_comments(text: str) -> str:
    """Return a .msg definition without constants, comments and trailing blanks.

    Real ones break the grammar: lower-case constants, separators of other lengths.
    """
    text = _COMMENT.sub("", _SECTION.sub(_RULE, text))
    return _TRAILING.sub("", _CONSTANT.sub("", text)).strip() + "\n"


def idl_parts(text: str) -> list[str]:
    """Return the IDL documents in a definition: one, or several with headings ``IDL: name``."""
    parts = [part.strip() for part in _SECTION.split(text)]
    return [part.partition("\n")[2] if part.startswith("IDL:") else part for part in parts if part]


@lru_cache(maxsize=2)
def _standard(ros1: bool) -> Typesdict:
    """Return the standard types of ROS 1, or of the latest ROS 2."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST).fielddefs


class _Builder:
    """Builds types from parsed definitions, each type once."""

    def __init__(self, own: Typesdict, ros1: bool) -> None:
        self.own = own
        self.ros1 = ros1
        self.types: dict[str, Struct] = dict(ROS1_TIMES) if ros1 else {}
        self.open: list[str] = []

    def struct(self, name: str) -> Struct:
        """Return the message type of this name."""
        if name not in self.types:
            definition = self._definition(name)
            if definition is None:
                raise BadDefinitionError(
                    f"the log carries no definition of {quoted(name)} and it is not a standard "
                    "type; put its .msg files beside the log, or name them with ",
                    Setting("msg_path"),
                )
            self.types[name] = self._build(name, definition)
        return self.types[name]

    def _build(self, name: str, fields: list[tuple[str, FieldDesc]]) -> Struct:
        if name in self.open or len(self.open) >= MAX_DEPTH:
            raise BadDefinitionError(
                f"the definition of {quoted(self.open[0])} contains itself or is nested deeper "
                f"than {MAX_DEPTH} types"
            )
        self.open.append(name)
        parts = tuple((own, self._type(kind)) for own, kind in fields if own != PLACEHOLDER)
        self.open.pop()
        if not parts and not self.ros1:
            parts = ((PLACEHOLDER, NUMBERS["uint8"]),)
        return Struct(name, parts)

    def _definition(self, name: str) -> list[tuple[str, FieldDesc]] | None:
        # A log's own definition comes first: another distribution's may differ.
        if name in self.own:
            return self.own[name][1]
        standard = _standard(self.ros1)
        return standard[name][1] if name in standard else None

    def _type(self, kind: FieldDesc) -> Type:
        from rosbags.interfaces import Nodetype

        if kind[0] == Nodetype.BASE:
            return self._base(kind[1][0])
        if kind[0] == Nodetype.NAME:
            return self._named(kind[1])
        element, length = kind[1]
        inner = self._type(element)
        return Array(inner, length) if kind[0] == Nodetype.ARRAY else Sequence(inner)

    def _base(self, name: str) -> Type:
        if name in {"string", "wstring"}:
            return String(wide=name == "wstring")
        return NUMBERS.get(name) or Unknown(name)

    def _named(self, name: str) -> Type:
        if name in self.types or self._definition(name) is not None:
            return self.struct(name)
        # The .msg grammar takes wide strings for a message type.
        return String(wide=True) if name.endswith("/wstring") else Unknown(name)
