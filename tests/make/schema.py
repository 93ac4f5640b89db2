"""A JSON Schema of everything that commands print as JSON, from the fields of its classes."""

import ast
import inspect
import json
import re
import sys
from functools import partial
from typing import Literal, get_args, get_origin

from make.reference import ROOTS, keys_of, part_of, sentences_of

from quatprop.base import __version__
from quatprop.propagation.survey import LogSurvey
from quatprop.tools.calibration import GyroCalibration
from quatprop.tools.check.case import CaseResult
from quatprop.tools.crosscheck.result import EXIT_CODES, LEVELS, SCHEMA, Finding
from quatprop.tools.sensor_noise import Noise

NAME = "schema.json"

TEXT, FLAG, NUMBERS = {"type": "string"}, {"type": "boolean"}, {"$ref": "#/$defs/numbers"}
TIMES = {"type": "array", "items": {"type": "integer"}}
PLAIN = {
    "str": TEXT, "Remark": TEXT, "bool": FLAG, "int": {"type": "integer"},
    "float": {"type": ["number", "null"]}, "None": {"type": "null"}, "Any": {}, "object": {},
    "Float64": NUMBERS, "NDArray[np.float64]": NUMBERS, "Int64": TIMES, "datetime": TEXT,
}  # fmt: skip
"""The types of fields that are no classes; a number that is not finite is null."""


def _object(properties, required=None, **more):
    required = sorted(properties if required is None else required)
    return {"type": "object", "properties": properties, "required": required, **more}


def _list(items):
    return {"type": "array", "items": items}


def _ref(name):
    return {"$ref": f"#/$defs/{name}"}


INPUT = _object({
    **dict.fromkeys(("path", "kind", "name", "clock"), TEXT),
    "type": {"type": ["string", "null"]},
    "quaternion": {},
    "layout": {"type": ["string", "null"]},
    "meaning": _ref("AttitudeConvention"),
    "samples": {"type": "integer"},
    **{key: {"type": ["integer", "null"]} for key in ("first_ns", "last_ns")},
    "rows": _ref("QuaternionCounts"),
    "losses": _list(_ref("Loss")),
    "remarks": _list(TEXT),
})  # fmt: skip
"""An input of `compare`."""

NUMBER, COUNT = {"type": "number"}, {"type": "integer"}
CROSSCHECK = _object({
    "schema": {"const": SCHEMA},
    "state": {"enum": [*EXIT_CODES]},
    "exit": {"enum": [0, 1, 2, 3]},
    "sources": _list(_object({
        **dict.fromkeys(("name", "device", "type"), TEXT),
        "kind": {"enum": ["rates", "orientation"]},
        **dict.fromkeys(("samples", *(f"omitted_{why}" for why in (
            "invalid", "backwards", "repeated"))), COUNT),
        **dict.fromkeys(("interval_s", "span_s"), NUMBER),
        "assumed": _object({}, additionalProperties=TEXT),
        "notes": _list(TEXT),
    })),
    "findings": _list(_ref("Finding")),
    "pairs": _list(_object(
        {
            **dict.fromkeys(("a", "b", "status"), TEXT),
            "axes": _list({"enum": ["body", "reference"]}),
            "rotation": _list(_list(NUMBER)),
            **dict.fromkeys(("rotation_sigma_rad", "bias_rad_s", "bias_sigma_rad_s"),
                            _list(NUMBER)),
            **dict.fromkeys((
                "scale", "scale_sigma", "offset_s", "offset_sigma_s", "clock", "clock_sigma",
                "before_rad_s", "after_rad_s", "motion_rad_s", "window_s"), NUMBER),
            "windows": COUNT,
        },
        ["a", "b", "status"],
    )),
    "agreeing": _list(TEXT),
    "not_shown": _list(TEXT),
    "unread": _list(_object(dict.fromkeys(("name", "reason"), TEXT))),
    "losses": _list(_ref("Loss")),
    "remarks": _list(_object(dict.fromkeys(("code", "text"), TEXT))),
})  # fmt: skip
"""What `crosscheck` prints."""

ADDED = {
    "Finding": {"level": {"enum": [*LEVELS]}},
    "RunReport": {
        "quatprop": TEXT,
        "data_lost": FLAG,
        "timings": _object({"seconds": {"type": "number"}}),
    },
    "ConventionReport": {"side": TEXT},
    "CaseResult": {"reason": {"type": ["string", "null"]}},
    "Comparison": {"quatprop": TEXT, "a": _ref("Input"), "b": _ref("Input")},
}
"""Keys that are no fields, or are not as the field is."""

LEFT_OUT = {"RunReport": {"seconds"}, "CaseResult": {"trace", "pin", "seconds", "line"}}
"""Fields that are no keys."""

OPTIONAL = {"timings", "unchecked_chunks", "etag", "files"}
"""Keys that are left out where they do not apply: an output has no timings, a file no ETag."""

PRINTED = {
    "propagate": _ref("RunReport"),
    "batch": _list(_object({
        "log": TEXT,
        "output": TEXT,
        "error": {"type": ["string", "null"]},
        "unmet": {"type": ["array", "null"], "items": {"type": "string"}},
        "seconds": {"type": "number"},
        "report": {"anyOf": [_ref("RunReport"), {"type": "null"}]},
    })),
    "info": _list(_ref("LogSurvey")),
    "compare": _ref("Comparison"),
    "crosscheck": CROSSCHECK,
    "noise": _ref("Noise"),
    "calibrate": _ref("GyroCalibration"),
    "check": _object({
        "quatprop": TEXT,
        "suite": TEXT,
        "passed": FLAG,
        "counts": _object({}, additionalProperties={"type": "integer"}),
        "cases": _list(_ref("CaseResult")),
    }),
    "convert": _object(
        {
            "quatprop": TEXT, "source": _object({}), "convention": _object({}),
            "conversions": _list(_object({})), "data_lost": FLAG,
        }
    ),
}  # fmt: skip
"""The reports of each command."""


def schema():
    """Return the schema: a definition for each command and for each class."""
    definitions = {
        "numbers": {
            "description": "A number, or an array of any shape; null: not finite.",
            "anyOf": [{"type": ["number", "null"]}, _list(NUMBERS)],
        },
        "Input": {"description": "An input of a comparison.", **INPUT},
    }
    waiting, seen = [*ROOTS, LogSurvey, Noise, GyroCalibration, CaseResult, Finding], set()
    while waiting:
        one = waiting.pop(0)
        if one not in seen:
            seen.add(one)
            definitions[one.__name__], parts = _class(one)
            waiting += parts
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"JSON of quatprop {__version__}",
        "description": "The output of a command is #/$defs/COMMAND, such as #/$defs/compare.",
        "anyOf": [{"$ref": f"#/$defs/{command}"} for command in PRINTED],
        "$defs": {**PRINTED, **dict(sorted(definitions.items()))},
    }


def schema_text():
    """Return the file."""
    return json.dumps(schema(), indent=1) + "\n"


def _class(one):
    """Return the schema of a class, and the classes of its fields."""
    says, parts = sentences_of(one), []
    properties = {}
    for key, hint in keys_of(one):
        if key in LEFT_OUT.get(one.__name__, ()):
            continue
        if hint == "Digest":  # merged into the object that it describes
            properties |= _digest()
            parts.append(part_of("Digest"))
            continue
        names = vars(sys.modules[one.__module__])
        spelled = re.sub(r"\w+", partial(_spelled, names), str(hint))
        parts += [found for word in re.findall(r"\w+", spelled) if (found := part_of(word))]
        text = {"description": says[key]} if key in says else {}
        properties[key] = {**text, **_type(ast.parse(spelled, mode="eval").body)}
    properties |= _digest() if one.__name__ == "Digest" else {}
    properties.pop("changed", None)
    properties |= ADDED.get(one.__name__, {})
    about = inspect.getdoc(one).split("\n\n")[0].replace("\n", " ")
    required = set(properties) - OPTIONAL
    if one.__name__ == "RunReport":
        required |= {"files"}
    return {"description": about, **_object(properties, required)}, parts


def _spelled(names, word):
    """Return a word of a type; the choices themselves where it is a name for them."""
    alias = names.get(word[0])
    return f"Literal{[*get_args(alias)]}" if get_origin(alias) is Literal else word[0]


def _digest():
    """Return the keys of a digest."""
    unknown = {"type": ["string", "null"]}
    files = _object({}, additionalProperties=_ref("Digest"))
    return {"bytes": {"type": ["integer", "null"]}, "sha256": unknown, "etag": TEXT, "files": files}


def _type(tree):
    """Return the schema of a type."""
    text = ast.unparse(tree)
    if text in PLAIN:
        return PLAIN[text]
    if isinstance(tree, ast.BinOp):
        return _either(_type(tree.left), _type(tree.right))
    if isinstance(tree, ast.Name):
        assert part_of(tree.id), text
        return _ref(tree.id)
    inner = tree.slice.elts if isinstance(tree.slice, ast.Tuple) else [tree.slice]
    return _generic(tree.value.id, inner)


def _either(*kinds):
    """Return the schema of a union; plain types are listed."""
    of_any = [kind for one in kinds for kind in one.get("anyOf", [one])]
    names = [kind.get("type") for kind in of_any if kind.keys() == {"type"}]
    if len(names) < len(of_any):
        return {"anyOf": of_any}
    every = [name for one in names for name in ([one] if isinstance(one, str) else one)]
    return {"type": list(dict.fromkeys(every))}


def _generic(name, inner):
    """Return the schema of a type in brackets."""
    if name == "Literal":
        return {"enum": [one.value for one in inner]}
    if name in {"Mapping", "dict"}:
        return _object({}, additionalProperties=_type(inner[1]))
    assert name in {"tuple", "list", "Sequence"}, name
    if name == "tuple" and ast.unparse(inner[-1]) != "...":
        size = {"minItems": len(inner), "maxItems": len(inner)}
        return {"type": "array", "prefixItems": [_type(one) for one in inner], **size}
    return _list(_type(inner[0]))
