"""MD5 sums of ROS 1 definitions, by which publishers and subscribers compare their messages.

References
----------
ROS wiki, "roslib/gentools": comments and the names of nested types do not enter the sum.
"""

from __future__ import annotations

import hashlib
import re
from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


_RULE = re.compile(r"^={20,}[ \t]*$", re.MULTILINE)
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
