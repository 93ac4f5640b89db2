"""The reference of the command line, of Python and of JSON, from what the program itself says."""

import importlib
import inspect
import pkgutil
import re
from dataclasses import fields, is_dataclass
from functools import cache

import click

import quatprop
from quatprop.cli.commands import COMMANDS, GROUPS, OWN, GroupedOption, cli
from quatprop.comparison.result import Comparison
from quatprop.kinematics.conventions import AttitudeConvention
from quatprop.propagation.report import RunReport
from quatprop.readers.attitude_quality import QuaternionCounts
from quatprop.tools.batch.manifest import ManifestEntry

HEAD = "This page is written by `make documents` from the program's own help and docstrings.\n"


def reference():
    """Return the reference of the command line and of JSON, in Markdown."""
    parts = ["# Reference: command line and JSON\n", HEAD, *_commands(), *_options(), *_json()]
    return "\n".join(parts)


def python_reference():
    """Return the reference of the library, in Markdown."""
    parts = ["# Reference: Python\n", HEAD]
    for name in sorted(quatprop.__all__, key=str.swapcase):
        public = getattr(quatprop, name)
        parts += [f"## {name}\n", f"```text\n{inspect.getdoc(public)}\n```\n"]
        parts += _members(name, public) if inspect.isclass(public) else []
    return "\n".join(parts)


def _members(name, public):
    """Yield the methods and properties of a class with the first sentences about them."""
    rows = []
    for member, value in inspect.getmembers(public):
        is_own = inspect.isroutine(value) or isinstance(value, property)
        if is_own and not member.startswith("_") and not _of_builtin(public, member):
            says = " ".join(inspect.getdoc(value).split("\n\n")[0].split())
            call = "" if isinstance(value, property) else "()"
            rows.append((f"`{member}{call}`", says))
    return [_table((name, ""), rows)] if rows else []


def _of_builtin(public, member):
    owner = next(base for base in public.__mro__ if member in vars(base))
    return not owner.__module__.startswith("quatprop") or member in {"count", "index"}


def _commands():
    """Yield how each command is called, and what it does."""
    rows = []
    for name in COMMANDS:
        command = cli.get_command(None, name)
        usage = command.collect_usage_pieces(click.Context(command))
        does = " ".join(inspect.cleandoc(command.help).split("\n\n")[0].split())
        rows.append((f"`quatprop {name} {' '.join(usage)}`", does))
    yield "## Commands\n"
    yield _table(("command", "what it does"), rows)


GENERAL = {"convert": {"IN": "LOG"}, "plot": {"FILE": "LOG", "REF": "B"}}
"""Names that commands have for the inputs that others call LOG and B."""

SIDES = """
Options about attitudes that are read, from `--from` to `--on-invalid`, belong to an input:
`compare` has each with `-a` and `-b` at its end, `plot` with `-ref` for the reference. Limits and
alignment of `plot` need `--reference`.
"""


UNGROUPED = {"check": "`check`", "simulate": "`simulate`"}
"""Commands whose help has no groups -> title of the table of their options."""


def _options():
    """Yield every option once, by group, with the commands that have it."""
    groups = {title: {} for title in (*GROUPS, OWN, *UNGROUPED.values())}
    for name in COMMANDS:
        command = cli.get_command(None, name)
        context = click.Context(command, terminal_width=1000)
        for option in command.params:
            if isinstance(option, click.Option) and (record := option.get_help_record(context)):
                grouped = name not in UNGROUPED and isinstance(option, GroupedOption)
                title = option.group if grouped else UNGROUPED.get(name, OWN)
                if title in groups:
                    texts = groups[title].setdefault(record[0], {})
                    texts.setdefault(_general(record[1], name), []).append(name)
    yield f"## Options\n\n{SIDES}"
    for title, options in groups.items():
        rows = [
            (f"`{names}`", ", ".join(commands), text)
            for names, texts in options.items()
            for text, commands in texts.items()
        ]
        if rows:
            yield f"### {'One command alone' if title == OWN else title}\n"
            yield _table(("option", "of", "meaning"), rows)


def _general(text, command):
    """Return help without what differs between commands: the name of the input."""
    text = text.replace("(with --reference) ", "").replace("  [", " [")
    text = text.replace("] [", "; ")  # two brackets side by side are a link
    for name, general in GENERAL.get(command, {}).items():
        text = re.sub(rf"\b{name}\b", general, text)
    return text


JSON = """## JSON

`propagate --report` and the metadata of outputs have a RunReport, and so has `batch --json` for
each log, as `report` next to `log`, `output`, `error` and `seconds`; `compare --json` has a
Comparison, each line of a batch's manifest a ManifestEntry. Keys are the fields below;
[`schema.json`](schema.json) is the JSON Schema of all of them, with a definition for each command
(`#/$defs/compare`).
Further keys are `quatprop`, the version that wrote it; in a RunReport `data_lost`, `timings`, and
`side` of its convention; in a Comparison its inputs `a` and `b`, each with `path`, `kind`, `name`,
`type`, `quaternion` (field or columns), `layout`, `meaning` (AttitudeConvention), `clock`,
`samples`, `rows` (QuaternionCounts), `losses` and `remarks`. Arrays and tuples are lists; None is
null, and so is a number that is not finite. The fields of a digest are among the others.

`info --json` is a list with a [LogSurvey](api.md) for each log, and `check --json` has `passed`,
`counts` and `cases`, each with its `verdict`, `reason`, `error_rad` and `limits`. Keys may change
from one version to the next until version 1.0, so pin the version.
"""

ROOTS = (RunReport, Comparison, ManifestEntry, AttitudeConvention, QuaternionCounts)


@cache
def _classes():
    """Return the classes of the package by name: no two share one."""
    names = [module.name for module in pkgutil.walk_packages(quatprop.__path__, "quatprop.")]
    return {
        name: value
        for module in names
        if not module.endswith("__main__")
        for name, value in vars(importlib.import_module(module)).items()
        if inspect.isclass(value) and value.__module__.startswith("quatprop")
    }


def _json():
    """Yield the keys of the reports, class by class."""
    yield JSON
    waiting, seen = [*ROOTS], set()
    while waiting:
        one = waiting.pop(0)
        if one in seen:
            continue
        seen.add(one)
        described = sentences_of(one)
        rows = []
        for key, hint in keys_of(one):
            parts = [found for word in re.findall(r"\w+", hint) if (found := part_of(word))]
            waiting += parts
            says = described.get(key, "")
            if parts and list(described.values()).count(says) != 1:
                says = inspect.getdoc(parts[0]).split("\n")[0]
            rows.append((f"`{key}`", f"`{_plain(hint)}`", says))
        yield f"### {one.__name__}\n"
        yield _table(("key", "type", "meaning"), rows)


def _plain(hint):
    """Return a type as JSON has it: arrays are lists, remarks texts."""
    hint = re.sub(r"NDArray\[np\.float64\]|Float64", "list[float]", hint)
    return hint.replace("Int64", "list[int]").replace("Remark", "str")


def part_of(word):
    """Return the class of this name that becomes an object in JSON; None if there is none."""
    found = _classes().get(word)
    is_one = found is not None and (is_dataclass(found) or hasattr(found, "_fields"))
    return found if is_one else None


def keys_of(one):
    """Yield the keys that a class becomes in JSON, and their types."""
    if is_dataclass(one):
        yield from ((field.name, field.type) for field in fields(one) if field.repr)
    else:
        for base in one.__mro__[::-1]:
            for name, hint in inspect.get_annotations(base).items():
                yield name, getattr(hint, "__forward_arg__", hint)


def sentences_of(one):
    """Return the sentence about each field in the docstring of a class."""
    text = inspect.getdoc(one) or ""
    pattern = r"^(`\w+`(?:, `\w+`)*): (.*(?:\n    .*)*)|^(\w[\w, ]*)\n((?:    .*\n?)+)"
    found = {}
    for names, says, numpy_names, numpy_says in re.findall(pattern, text, re.MULTILINE):
        for name in re.findall(r"\w+", names or numpy_names):
            text = re.sub(r":\w+:`~?(?:[\w.]*\.)?(\w+)`", r"`\1`", says or numpy_says)
            found[name] = " ".join(text.replace("``", "`").split())
    return found


def _table(head, rows):
    cells = [head, ["---"] * len(head), *rows]
    lines = ["| " + " | ".join(str(c).replace("|", "\\|") for c in row) + " |" for row in cells]
    return "\n".join(lines) + "\n"
