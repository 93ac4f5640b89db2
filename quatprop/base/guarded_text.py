"""Content of YAML, TOML and JSON, read within limits.

Few bytes may expand to gigabytes, and their nesting, numbers or characters may be unusable.
Every error in a text is a :class:`ContentError`; the caller, which knows the source, adds it.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from quatprop.base.errors import UsageError, os_reason
from quatprop.base.text import Setting, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from ruamel.yaml.nodes import Node


MAX_BYTES = 1 << 24
"""Default limit for the size of a file, bytes."""

MAX_DEPTH = 64
"""Most levels of nested lists and tables."""

MAX_VALUES = 1 << 18
"""Most values of a text in YAML, with every alias expanded."""

MAX_DIGITS = 300
"""Maximum number of digits of a whole number, so that it fits into a float."""

_LONG_NUMBER = re.compile(rf"\d[\d_]{{{MAX_DIGITS},}}", re.ASCII)


class ContentError(ValueError):
    """An error in a text, as the end of a sentence about it."""


def read_bytes(source: Path | str | IO[bytes], limit: int = MAX_BYTES) -> bytes:
    """Return the content of a file; an open one is closed."""
    try:
        with Path(source).open("rb") if isinstance(source, Path | str) else source as stream:
            data = stream.read(limit + 1)
    except OSError as error:
        raise ContentError(os_reason(error)) from error
    if len(data) > limit:
        raise ContentError(f"it is too large; {limit:,} bytes are read at most")
    return data


def read_toml(text: bytes) -> dict[str, Any]:
    """Return the content of TOML."""
    import tomllib

    decoded = _decoded(text)
    _refuse_long_numbers(decoded)
    for number, line in enumerate(decoded.split("\n"), 1):
        # The library takes quadratic time in the number of parts of a key.
        if max(part.count(".") for part in re.split(r"[,={}]", line)) > MAX_DEPTH * 4:
            raise ContentError(f"line {number}: {_too_deep()}")
    try:
        content = tomllib.loads(decoded)
    except RecursionError as error:
        raise ContentError(_too_deep()) from error
    except tomllib.TOMLDecodeError as error:
        raise ContentError(f"it is not TOML: {plain(error)}") from error
    _check(content)
    return content


def read_json(text: bytes | str) -> Any:
    """Return the content of JSON, without NaN and without repeated names in an object."""
    decoded = _decoded(text, "surrogateescape")
    try:
        content = _JSON.decode(decoded)
    except RecursionError as error:
        raise ContentError(_too_deep()) from error
    except json.JSONDecodeError as error:
        raise ContentError(f"it is not JSON: line {error.lineno}: {error.msg}") from error
    # Text with few brackets and no escapes needs no check: lines of a manifest are many.
    if "\\u" in decoded or decoded.count("[") + decoded.count("{") > MAX_DEPTH:
        _check(content)
    return content


def read_yaml(text: bytes | str) -> Any:
    """Return the content of YAML; tags give plain values only."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    decoded = _decoded(text)
    _refuse_long_numbers(decoded)
    _refuse_deep_brackets(decoded)
    # The parser in C overflows its stack.
    yaml = YAML(typ="safe", pure=True)
    try:
        node = yaml.compose(decoded)
        if node is None:
            return None
        _count_values(node, {})
        content = yaml.constructor.construct_document(node)
    except ContentError:
        raise
    except RecursionError as error:
        raise ContentError(_too_deep()) from error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f"line {mark.line + 1}: " if mark else ""
        reason = f"it is neither YAML nor JSON: {line}{error.problem or error.context}"
        raise ContentError(plain(reason)) from error
    except (
        YAMLError,
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        raise ContentError("it is neither YAML nor JSON") from error
    _check(content)
    return content


def _decoded(text: bytes | str, errors: str = "strict") -> str:
    if isinstance(text, str):
        return text
    try:
        return text.decode("utf-8-sig", errors)
    except UnicodeDecodeError as error:
        raise ContentError(f"it is not UTF-8 text: byte {error.start}") from error


def _refuse_long_numbers(text: str) -> None:
    """Refuse numbers that take long to convert and are useless."""
    if found := _LONG_NUMBER.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise ContentError(f"line {line}: a number of more than {MAX_DIGITS} digits")


def _refuse_deep_brackets(text: str) -> None:
    """Refuse nesting so deep that the library would take seconds to refuse it."""
    depth = 0
    for bracket in re.finditer(r"[][{}]", text):
        depth = depth + 1 if bracket[0] in "[{" else max(depth - 1, 0)
        if depth > MAX_DEPTH * 4:  # some may be in quotes
            line = text.count("\n", 0, bracket.start()) + 1
            raise ContentError(f"line {line}: {_too_deep()}")


def _too_deep() -> str:
    return f"it is nested more than {MAX_DEPTH} levels deep"


def _count_values(node: Node, counts: dict[int, int]) -> int:
    """Return the number of values of a node, with its aliases expanded."""
    if id(node) in counts:
        if not counts[id(node)]:
            raise ContentError(f"line {node.start_mark.line + 1}: a value contains itself")
        return counts[id(node)]
    counts[id(node)] = 0
    parts = node.value if isinstance(node.value, list) else ()
    pairs = (part if isinstance(part, tuple) else (part,) for part in parts)
    count = 1 + sum(_count_values(part, counts) for pair in pairs for part in pair)
    if count > MAX_VALUES:
        line = node.start_mark.line + 1
        raise ContentError(f"line {line}: its aliases stand for more than {MAX_VALUES:,} values")
    counts[id(node)] = count
    return count


def _distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ContentError(f"{quoted(twice)} is there twice")
    return content


def _refuse_constant(name: str) -> NoReturn:
    raise ContentError(f"{name} is not a JSON number")


def _whole(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise ContentError(f"a number of more than {MAX_DIGITS} digits")
    return int(digits)


_JSON = json.JSONDecoder(
    object_pairs_hook=_distinct, parse_int=_whole, parse_constant=_refuse_constant
)


def _check(content: object) -> None:
    """Refuse values that other code cannot use, and name their place."""
    waiting: list[tuple[object, tuple[object, ...]]] = [(content, ())]
    while waiting:
        value, place = waiting.pop()
        if len(place) > MAX_DEPTH:
            raise ContentError(_too_deep())
        if isinstance(value, str):
            if "\0" in value or not _is_unicode(value):
                raise ContentError(
                    f"{_place_text(place)}: text that is not Unicode, or has a zero byte"
                )
        elif isinstance(value, int):
            if abs(value) >= 10**MAX_DIGITS:
                raise ContentError(
                    f"{_place_text(place)}: a number of more than {MAX_DIGITS} digits"
                )
        else:
            waiting += _parts(value, place)


def _parts(value: object, place: tuple[object, ...]) -> Iterator[tuple[object, tuple[object, ...]]]:
    """Yield the items of a list, or the names and values of a table."""
    if isinstance(value, dict):
        yield from ((key, place) for key in value)
        yield from ((part, (*place, key)) for key, part in value.items())
    elif isinstance(value, list | tuple | set):
        yield from ((part, (*place, number)) for number, part in enumerate(value))


def _is_unicode(text: str) -> bool:
    """Return whether text can be encoded; surrogates for bytes of file names are allowed."""
    try:
        text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return False
    return True


def _place_text(place: tuple[object, ...]) -> str:
    return quoted(".".join(map(str, place)))


# Files in YAML or JSON that describe a sensor.


MAX_YAML_BYTES = 1_000_000
"""Largest file that may describe a sensor, bytes."""


def read_yaml_file(setting: str, path: Path | str) -> Mapping[str, object]:
    """Return the content of a file, by name."""
    try:
        # The first line of files from OpenCV is not YAML.
        text = read_bytes(path, MAX_YAML_BYTES).removeprefix(b"%YAML:1.0")
        content = read_yaml(text)
    except ContentError as error:
        raise unusable(setting, path, str(error)) from error
    if not isinstance(content, dict):
        raise unusable(setting, path, "it holds no names with values")
    return content


def unusable(setting: str, path: Path | str, reason: str) -> UsageError:
    """Return the error for the file of a setting."""
    return UsageError(f"{Setting(setting)} {plain(path)}: {reason}")
