"""The package as a whole: public names, layering, start-up."""

import ast
import doctest
import importlib.util
import inspect
import linecache
import os
import pkgutil
import re
import subprocess
import sys
import tomllib
from dataclasses import is_dataclass
from functools import cache
from graphlib import TopologicalSorter
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from make.places import ROOT, SAMPLE_LOGS

import quatprop

PACKAGE = Path(quatprop.__file__).parent
PATHS = sorted(PACKAGE.rglob("*.py"))
MODULES = {module.name for module in pkgutil.walk_packages([str(PACKAGE)], "quatprop.")}


@cache
def nodes_of(path):
    """Return all nodes of the syntax of a file."""
    return list(ast.walk(ast.parse(path.read_text())))


def imported_by(path):
    """Return every module that a file imports, wherever in the file it does so."""
    names = set()
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules = {f"{node.module}.{alias.name}" for alias in node.names} & MODULES
            names |= modules or {node.module}
    return names


def test_public_names_are_sorted_and_there():
    """Every name of __all__ can be imported; another one is an error, as of any module."""
    assert quatprop.__all__ == sorted(quatprop.__all__)
    for name in quatprop.__all__:
        assert getattr(quatprop, name).__module__.startswith("quatprop.")
    with pytest.raises(AttributeError, match="module 'quatprop' has no attribute 'nonsense'"):
        _ = quatprop.nonsense


@pytest.mark.parametrize("name", quatprop.__all__)
def test_every_field_of_a_public_name_is_described(name):
    """help() showed bare names of the fields of results, and no sentence about some of them."""
    public = getattr(quatprop, name)
    if inspect.isclass(public) and not issubclass(public, Exception):
        text = "\n".join(inspect.getdoc(base) for base in public.__mro__[:-1])
        fields = {*inspect.signature(public).parameters} - {"metadata"}
        heads = re.findall(r"^(\w[\w, *]*)(?: : .*)?\n    ", text, re.MULTILINE)
        described = {word for head in heads for word in head.split(", ")}
        assert fields <= described, fields - described


def part_of(module):
    """Return the package or module in the root of the package that a module belongs to."""
    return ".".join(module.split(".")[:2])


PARTS = {part_of(name) for name in ("quatprop", *MODULES)} - {"quatprop.__main__"}


@pytest.mark.parametrize("part", sorted(PARTS))
def test_every_module_says_what_it_is_with_examples_that_hold(monkeypatch, part):
    """Each module has a docstring; what examples in it show is what they give."""
    monkeypatch.chdir(PACKAGE.parent)
    # Before each docstring, doctest looks whether any file that was ever shown has changed.
    monkeypatch.setattr(linecache, "cache", {})
    for name in [name for name in {"quatprop", *MODULES} if part_of(name) == part]:
        module = importlib.import_module(name)
        assert module.__doc__, name
        assert not doctest.testmod(module).failed, name


def is_found(name):
    """Return whether a dotted name is that of a module, or of something in one."""
    parts = name.split(".")
    own = next(n for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in {"quatprop", *MODULES})
    found = importlib.import_module(".".join(parts[:own]))
    for part in parts[own:]:
        if not hasattr(found, part):
            return False
        found = getattr(found, part)
    return True


REFERENCE = re.compile(r":(?:data|func|class|meth|mod|exc|attr):`(?:[^`<]*<)?~?(quatprop[\w.]*)>?`")
"""A reference of a docstring, to a full name."""


def test_references_in_docstrings_lead_somewhere():
    """Two still named the modules in which something had been before."""
    named = {(path.name, name) for path in PATHS for name in REFERENCE.findall(path.read_text())}
    assert named
    assert [one for one in sorted(named) if not is_found(one[1])] == []


GROWING = {
    *("BagChunk", "BagIndex", "Chunk", "Folder", "LocatedMessages", "McapIndex"),
    *("BiasSeriesReport", "Part", "RangeReader", "Records", "Summary", "WalkedRecords", "_Node"),
    *("Counts", "Event", "FieldTree", "LogSearch", "QuaternionCounts", "_Sums"),
}
"""Records that are filled while a log is read."""


def test_other_records_do_not_change():
    """Settings are shared between runs; slots refuse names that are misspelled."""
    for module in map(importlib.import_module, MODULES - {"quatprop.__main__"}):
        for kind in vars(module).values():
            if isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module.__name__:
                assert kind.__dataclass_params__.frozen == (kind.__name__ not in GROWING), kind
                has_cached = {"ChunkRecords", "RangeReader"}
                assert ("__slots__" in vars(kind)) == (kind.__name__ not in has_cached), kind


LAYERS = re.findall(
    r"^\| `([\w/]+?)(?:/|\.py)` \|",
    (PACKAGE / "docs" / "development.md").read_text().split("\nWhat a sample is")[0],
    re.MULTILINE,
)
"""Folders and modules, from the table of development.md: each imports from itself and above."""


def layer_of(module):
    """Return the number of the layer of a module, without the name of the package."""
    place = module.replace(".", "/") + "/"
    around = [layer for layer in LAYERS if place.startswith(f"{layer}/")]
    return LAYERS.index(max(around, key=len))


def test_layers_import_downwards_only():
    """Every folder imports from itself and from those above it in development.md."""
    parts = {part.split(".")[1] for part in PARTS - {"quatprop"}} | {"__main__"}
    assert {layer.split("/")[0] for layer in LAYERS} == parts
    for path in PATHS:
        own = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        for name in imported_by(path) if own != "__init__" else ():
            assert name != "quatprop", f"{path.relative_to(PACKAGE)} imports the public names"
            if name.startswith("quatprop."):
                other = name.removeprefix("quatprop.")
                assert layer_of(other) <= layer_of(own), f"{own} imports {name}"


def test_one_module_opens_logs():
    """Whatever reads a log has it from there, so that all read it alike."""
    opens = {"quatprop.readers.open_log"}
    for path in PATHS:
        own = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        names = {
            alias.name
            for node in nodes_of(path)
            if isinstance(node, ast.ImportFrom) and node.module in opens
            for alias in node.names
        }
        if names & {"open_log", "open_logs"} and not own.startswith("readers."):
            assert own == "propagation.recording"


def test_the_command_line_imports_what_the_table_allows():
    """It makes settings of options, and text of results: all else has another place."""
    table = (PACKAGE / "docs" / "development.md").read_text()
    row = next(line for line in table.splitlines() if line.startswith("| `cli/` |"))
    allowed = re.findall(r"`(\w+)/`", row)
    assert allowed == ["cli", "api", "tools", "propagation", "settings", "base"]
    for path in (PACKAGE / "cli").glob("*.py"):
        for name in imported_by(path):
            if name.startswith("quatprop."):
                assert name.split(".")[1] in allowed, f"{path.name} imports {name}"


LONGEST = 40
"""Lines of a function of the command line, from def to the last."""


def test_functions_of_the_command_line_are_short():
    """A longer one has a part that a function of the library needs too."""
    for path in (PACKAGE / "cli").glob("*.py"):
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef):
                lines = node.end_lineno - node.lineno + 1
                assert lines <= LONGEST, f"{path.name}: {node.name} has {lines} lines"


def test_no_imports_lead_in_a_circle():
    """Neither as modules load nor later, and not for types alone: each can be read by itself.

    What a package and its own modules import of each other is left out: the names that it offers.
    """
    imports = {}
    for module in MODULES:
        imported = imported_by(Path(importlib.util.find_spec(module).origin))
        imports[module] = {other for other in imported if not f"{module}.".startswith(f"{other}.")}
    TopologicalSorter(imports).prepare()


def test_programs_next_to_the_tests_import_what_is_there():
    """The bench is not run here: what it imports of the package may have moved."""
    for path in chain.from_iterable(
        (ROOT / "tests" / name).glob("*.py") for name in ("bench", "fuzz")
    ):
        for node in nodes_of(path):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("quatprop"):
                module = importlib.import_module(node.module)
                for name in node.names:
                    assert hasattr(module, name.name), f"{path}: {node.module} has no {name.name}"


def test_no_line_end_depends_on_the_system():
    """Windows writes CRLF where neither bytes nor an encoding are asked for, as os.open does."""
    for path in PATHS:
        for node in nodes_of(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "os.open":
                flags = ast.unparse(node.args[1])
                assert flags.startswith("_") or "_BINARY" in flags or "O_NOFOLLOW" in flags, path
                assert "O_BINARY" in path.read_text("utf-8") or "O_NOFOLLOW" in flags, path
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(
                (".read_text", ".write_text")
            ):
                assert "utf-8" in ast.unparse(node), f"{path}:{node.lineno}"


def test_sentences_name_a_log_in_one_way():
    """By its path at the beginning, without quotes."""
    named = re.compile(r"f\"\{quoted\((?:\w+\.)*path\)\}(?::| )")
    paths = (path for path in PATHS if {"readers", "propagation"} & {*path.parts})
    found = ((path.name, line) for path in paths for line in named.findall(path.read_text("utf-8")))
    assert [*found] == []


def test_only_the_command_line_speaks_and_exits():
    """Below cli/ nothing prints, exits, prompts or asserts on input."""
    for path in PATHS:
        if path.parent.name == "cli" or path.name == "__main__.py":
            continue
        for node in nodes_of(path):
            assert not isinstance(node, ast.Assert), f"assert in {path}:{node.lineno}"
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in {"print", "input", "exit"}, f"{path}:{node.lineno}"
        assert not imported_by(path) & {"click"}, path


UNUSED = {
    *("concurrent.futures", "random", "shutil", "tempfile", "tqdm", "click.shell_completion"),
    *(
        "pyarrow.dataset",
        "pyarrow.compute",
        "quatprop.settings.command_options",
    ),
    *(
        "quatprop.propagation.conditioning.biases",
        "quatprop.propagation.conditioning.static_detection",
    ),
    *(
        "quatprop.propagation.conditioning.biases",
        "quatprop.propagation.other_logs",
        "quatprop.readers.range_readers",
    ),
    *(
        "mcap",
        "numpy.ma",
        "rosbags",
        "quatprop.readers.containers.transforms",
        "quatprop.readers.clocks",
    ),
}
"""Modules that a plain run does not need, and that are slow or easily imported by mistake."""


def after(line, expression):
    """Return what an expression is in a process that has run a command line."""
    program = (
        "import os, sys; from quatprop.cli import run; sys.argv = ['quatprop', *sys.argv[1:]]\n"
        "try: run()\n"
        "except SystemExit as end: assert not end.code\n"
        f"print({expression})"
    )
    environment = {name: value for name, value in os.environ.items() if "_NUM_THREADS" not in name}
    command = [sys.executable, "-c", program, *map(str, line)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()[-1]


def test_help_imports_nothing_heavy():
    """`quatprop --help` needs click and nothing else."""
    heavy = {"numpy", "pyarrow", "mcap", "rosbags"}
    assert after(["--help"], f"sorted({heavy!r} & set(sys.modules))") == "[]"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are listed in /proc")
def test_a_short_run_has_one_thread():
    """NumPy's threads for large matrices are not started."""
    threads = "len(os.listdir('/proc/self/task'))"
    assert after(["info", SAMPLE_LOGS / "coning.mcap"], threads) == "1"


def test_a_plain_run_imports_what_it_uses(tmp_path):
    """A short log is propagated in the time that imports take."""
    line = ["propagate", "-q", SAMPLE_LOGS / "coning.mcap", "-o", tmp_path / "a.parquet"]
    unused = UNUSED - ({"numpy.ma", "random"} if np.__version__ < "2" else set())  # its own
    assert after(line, f"sorted({unused!r} & set(sys.modules))") == "[]"


def test_every_dependency_is_pinned_for_development():
    """Tests and sample logs run on the versions of .ci/constraints.txt."""

    def name_of(requirement):
        return re.split(r"[\[>=]", requirement)[0].lower().replace("_", "-")

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    pins = (ROOT / ".ci" / "constraints.txt").read_text().splitlines()
    needed = chain(project["dependencies"], *project["optional-dependencies"].values())
    assert {name_of(one) for one in needed} <= {name_of(pin) for pin in pins}
