"""Parse the message definitions that logs carry into trees of types.

A .msg definition has one field a line and is parsed here: importing a parser would take longer than
propagating a small log. rosbags parses IDL and has the standard types. Two differences between the
encodings are not in a definition: a ROS 1 ``time`` is unsigned, and an empty message takes a byte
in CDR and none in ROS 1.
"""

from __future__ import annotations

import hashlib
import re
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from quatprop.base.errors import SchemaError
from quatprop.base.text import Setting, quoted
from quatprop.readers.messages.schema import (
    MAX_DEPTH,
    Array,
    BadDefinitionError,
    Primitive,
    Sequence,
    String,
    Struct,
    Unknown,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from quatprop.readers.messages.blocks import Channel
    from quatprop.readers.messages.schema import Type

    Kind = tuple[int, Any]
    Fields = Iterable[tuple[str, Kind]]


NUMBERS: Mapping[str, Primitive] = {
    "bool": Primitive("b1"),
    **dict.fromkeys(("byte", "char"), Primitive("u1")),
    **{f"int{bits}": Primitive(f"i{bits // 8}") for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": Primitive(f"u{bits // 8}") for bits in (8, 16, 32, 64)},
    **{f"float{bits}": Primitive(f"f{bits // 8}") for bits in (32, 64)},
}
"""Number types by their names in definitions."""

STRINGS = {"string", "wstring"}

ROS1_TIMES: Mapping[str, Struct] = {
    name: Struct(name, (("sec", NUMBERS[number]), ("nanosec", NUMBERS[number])))
    for name, number in (
        ("builtin_interfaces/msg/Time", "uint32"),
        ("builtin_interfaces/msg/Duration", "int32"),
    )
}
"""``time`` and ``duration`` of ROS 1, under their full names."""

GRAMMARS: Mapping[str, str] = {
    "json": "quatprop.readers.messages.json",
    "protobuf": "quatprop.readers.messages.protobuf",
    "ulog": "quatprop.readers.messages.ulog_definitions",
}
"""Modules that read the definitions of the other encodings."""

PLACEHOLDER = "structure_needs_at_least_one_member"
"""The byte that stands for an empty message in CDR."""

MAX_DEFINITION = 1 << 19
"""Maximum size of a definition, bytes: longer ones take seconds, and no real message has one."""

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of types, numbered as in ``rosbags.interfaces.Nodetype``."""

_SHORT_NAMES = {
    "time": "builtin_interfaces/msg/Time",
    "duration": "builtin_interfaces/msg/Duration",
    "Header": "std_msgs/msg/Header",
}
"""Types that .msg definitions name without their package."""

_RULE = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
_NO_FIELD = re.compile(r"[ \t]*(?:$|#|@[a-z]+[ \t]*$|\S+[ \t]+\w+[ \t]*=)")
"""Blank lines, comments, annotations and constants."""
_FIELD = re.compile(
    r"[ \t]*((?:\w+/)*[A-Za-z]\w*)(?:<=\d+)?(?:\[((?:<=)?\d*)\])?"
    r"[ \t]+([A-Za-z]\w*)(?:[ \t#].*)?",
    re.ASCII,
)
"""Type, array length and name, then a default or a comment."""


def message_type(channel: Channel, path: Path | str) -> Struct:
    """Return the type of a channel's messages."""
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
        raise SchemaError(path, f"topic {quoted(channel.topic)}: {error}") from None


@lru_cache(maxsize=256)
def _message_type(type_name: str, ros1: bool, schema_encoding: str, schema: bytes) -> Struct:
    own = _parsed(type_name, schema_encoding, schema) if schema.strip() else {}
    return TypeBuilder(own, ros1).struct(type_name)


def _parsed(type_name: str, schema_encoding: str, schema: bytes) -> dict[str, Fields]:
    """Return the definitions that a log carries, by type name."""
    if len(schema) > MAX_DEFINITION:
        raise BadDefinitionError(
            f"the definition of {quoted(type_name)} has {len(schema)} bytes, over the limit of "
            f"{MAX_DEFINITION}"
        )
    text = schema.decode("utf-8", "replace").replace("\r\n", "\n").lstrip("\ufeff").strip("\0")
    try:
        if schema_encoding in {"ros1msg", "ros2msg"}:
            return _from_msg(text, type_name)
        if schema_encoding in {"ros2idl", "omgidl"}:
            return _from_idl(text)
    except (AssertionError, LookupError, RecursionError, TypeError, ValueError):
        # The parser's own message would contain the whole definition.
        raise BadDefinitionError(
            f"the definition of {quoted(type_name)} that the log carries cannot be parsed as "
            f"{schema_encoding}"
        ) from None
    raise BadDefinitionError(
        f"the definition of {quoted(type_name)} is written in {quoted(schema_encoding)}, "
        "which this version does not read for this encoding"
    )


def _from_msg(text: str, type_name: str) -> dict[str, Fields]:
    """Return the types of a .msg definition: its own, and those behind ``MSG: name`` headings."""
    own, *others = _RULE.split(text)
    types = {type_name: _fields(type_name, own)}
    for part in others:
        head, _, lines = part.strip().partition("\n")
        if not head.startswith("MSG:"):
            raise ValueError
        name = _full_name(head.removeprefix("MSG:").strip(), type_name)
        types[name] = _fields(name, lines)
    return types


def _fields(type_name: str, lines: str) -> Fields:
    """Return the names and types of the fields in the lines of a .msg definition."""
    fields: list[tuple[str, Kind]] = []
    for line in lines.split("\n"):
        if _NO_FIELD.match(line):
            continue
        if (match := _FIELD.fullmatch(line)) is None:
            raise ValueError
        kind, length, name = match.groups()
        is_base = kind in NUMBERS or kind in STRINGS
        own: Kind = (BASE, (kind, 0)) if is_base else (NAME, _full_name(kind, type_name))
        if length is not None:
            own = (ARRAY, (own, int(length))) if length.isdecimal() else (SEQUENCE, (own, 0))
        fields.append((name, own))
    return fields


def _full_name(name: str, owner: str) -> str:
    """Return the full name of a type that is named in the definition of `owner`."""
    *folders, own = name.split("/")
    if len(folders) > 1:
        return name
    package = folders[0] if folders else owner.partition("/")[0]
    return _SHORT_NAMES.get(name, f"{package}/msg/{own}")


def _from_idl(text: str) -> dict[str, Fields]:
    """Return the types of one IDL document, or of several with headings ``IDL: name``."""
    from rosbags.typesys import TypesysError, get_types_from_idl

    types: dict[str, Fields] = {}
    for part in filter(None, map(str.strip, _RULE.split(text))):
        document = part.partition("\n")[2] if part.startswith("IDL:") else part
        try:
            types |= {name: kind[1] for name, kind in get_types_from_idl(document).items()}
        except TypesysError as error:
            raise ValueError from error
    return types


@lru_cache(maxsize=2)
def _standard(ros1: bool) -> dict[str, Fields]:
    """Return the standard types of ROS 1, or of the latest ROS 2."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.LATEST)
    return {name: kind[1] for name, kind in store.fielddefs.items()}


class TypeBuilder:
    """Builds types from parsed definitions, each once."""

    def __init__(self, own: Mapping[str, Fields], ros1: bool) -> None:
        self.own = own
        self.ros1 = ros1
        self.types: dict[str, Struct] = dict(ROS1_TIMES) if ros1 else {}
        self.open: list[str] = []

    def struct(self, name: str) -> Struct:
        """Return the message type of a name."""
        if name not in self.types:
            definition = self._definition(name)
            if definition is None:
                raise BadDefinitionError(
                    f"the log carries no definition of {quoted(name)} and it is not a standard "
                    "type; put its .msg files next to the log, or name them with "
                    f"{Setting('msg_path')}"
                )
            self.types[name] = self._build(name, definition)
        return self.types[name]

    def _build(self, name: str, fields: Fields) -> Struct:
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

    def _definition(self, name: str) -> Fields | None:
        # The log's own definition has priority: that of another distribution may differ.
        return self.own[name] if name in self.own else _standard(self.ros1).get(name)

    def _type(self, kind: Kind) -> Type:
        form, content = kind
        if form == BASE:
            name = content[0]
            is_text = name in STRINGS
            return String(name == "wstring") if is_text else NUMBERS.get(name) or Unknown(name)
        if form == NAME:
            is_known = content in self.types or self._definition(content) is not None
            return self.struct(content) if is_known else Unknown(content)
        element, length = self._type(content[0]), content[1]
        return Array(element, length) if form == ARRAY else Sequence(element)


# MD5 sums of ROS 1 definitions, by which publishers and subscribers compare their messages.
#
# Reference: ROS wiki, "roslib/gentools": comments and the names of nested types do not enter the
# sum.


_BUILTIN = frozenset(
    {"bool", "byte", "char", "string", "time", "duration", "float32", "float64"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_MOST_TYPES = 1000


def definition_of(connection: Mapping[bytes, bytes]) -> bytes | None:
    """Return a connection's message definition, if it has the MD5 sum that the connection states.

    If its own definition is damaged, the standard one is tried; None if neither has that sum.

    `connection`: the fields ``type``, ``message_definition`` and ``md5sum``; a sum of ``*`` fits
        any type
    """
    definition = connection[b"message_definition"]
    name, text, stated = (
        connection.get(field, b"*").decode(errors="replace")
        for field in (b"type", b"message_definition", b"md5sum")
    )
    actual = definition_md5(name, text)
    if stated in {"*", actual}:
        return definition
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys.msg import normalize_msgtype

    store, kind = get_typestore(Stores.ROS1_NOETIC), normalize_msgtype(name)
    if kind in store.fielddefs:
        standard, _ = store.generate_msgdef(kind, ros_version=1)
        if definition_md5(name, standard) == stated:
            return standard.encode()
    # A definition that lacks that of a nested type has no sum.
    return definition if actual is None else None


@lru_cache(maxsize=256)
def definition_md5(type_name: str, definition: str) -> str | None:
    """Return the MD5 sum of a type with all nested types; None if one is not defined.

    `type_name`: ``package/Name``
    """
    first, *others = _RULE.split(definition.replace("\r\n", "\n"))
    texts = {type_name: first}
    for other in others:
        head, _, text = other.strip().partition("\n")
        texts[head.removeprefix("MSG:").strip()] = text
    try:
        return _md5(type_name, texts, {}) if len(texts) <= _MOST_TYPES else None
    except (KeyError, ValueError, RecursionError):
        return None


def _md5(name: str, texts: Mapping[str, str], known: dict[str, str]) -> str:
    if name not in known:
        constants, fields = [], []
        for line in texts[name].split("\n"):
            bare = line.partition("#")[0].strip()
            if "=" in bare:
                constants.append(_constant(line, bare))
            elif bare:
                kind, field = bare.split()
                fields.append(f"{_summed(kind, name, texts, known)} {field}")
        text = "\n".join([*constants, *fields]).strip()
        known[name] = hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
    return known[name]


def _constant(line: str, bare: str) -> str:
    kind, _, rest = (line.strip() if bare.startswith("string") else bare).partition(" ")
    name, _, value = rest.partition("=")
    return f"{kind} {name.strip()}={value.strip()}"


def _summed(kind: str, within: str, texts: Mapping[str, str], known: dict[str, str]) -> str:
    """Return the summed text of a field's type: of a message, its MD5 sum."""
    element = kind.partition("[")[0]
    if element in _BUILTIN:
        return kind
    if element == "Header":
        element = "std_msgs/Header"
    elif "/" not in element:
        element = f"{within.partition('/')[0]}/{element}"
    return _md5(element, texts, known)
