"""Fixtures of all tests: the place of the real recordings, and that they are unchanged."""

import collections
import functools
import gc
import itertools
import json
import os
import random
import sqlite3
import sys
import tempfile
from pathlib import Path

import click.testing
import hypothesis
import pytest
from make.places import ROOT, SHARED_LOGS

from quatprop.base.own_process import keep_freed_memory
from quatprop.cli import NEW_OBJECTS

BYTES = json.loads((ROOT / "tests" / "field" / "recordings.json").read_text())
"""The recordings that the tests were written against, with their sizes."""


os.environ["QUATPROP_TRACEBACK"] = "1"
"""Errors of the package itself are not made sentences of, so that no test can pass over one."""

# No test writes into the summary of the CI that runs it, where no update would run; and the many
# processes that tests start would each compile the package anew, which takes longer than what most
# of them do.
for name in ("CI", "GITHUB_STEP_SUMMARY", "GITHUB_ACTIONS", "PYTHONDONTWRITEBYTECODE"):
    os.environ.pop(name, None)
sys.dont_write_bytecode = False

# How long an example takes depends on what else the machine does. Each change is judged by the
# same examples; `make fuzz` draws new ones, and four times as many.
hypothesis.settings.register_profile("fuzz", deadline=None)
hypothesis.settings.register_profile("tests", deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.load_profile("tests")


class Unsynced(sqlite3.Connection):
    """Does not wait for the disk, sixteen times a bag: what tests write outlives no power cut."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self.execute("PRAGMA synchronous = OFF")


sqlite3.connect = functools.partial(sqlite3.connect, factory=Unsynced)


# As in a command: the system clears the pages of memory that is given back, seven times as many.
keep_freed_memory()


def pytest_addoption(parser):
    """Add the option of ``make thorough``."""
    parser.addoption("--thorough", action="store_true", help="run all that is marked thorough")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config, items):
    """Leave what is marked thorough to ``make thorough``, but for some cases of each test."""
    tests = collections.defaultdict(list)
    for item in items:
        if (marker := item.get_closest_marker("thorough")) is not None:
            tests[item.parent, item.originalname].append((item, marker.kwargs.get("keep")))
    if config.getoption("thorough") or not tests:
        return
    left = set()
    for cases in tests.values():
        by_name = {item.nodeid: item for item, _ in cases}
        left |= set(by_name.values()) - {by_name[name] for name in _covering(by_name, cases[0][1])}
    config.hook.pytest_deselected(items=[item for item in items if item in left])
    items[:] = [item for item in items if item not in left]


def _covering(cases, keep):
    """Return the names of `keep` cases; None: so many that each value of a parameter is in one."""
    given = {name: getattr(item, "callspec", None) for name, item in cases.items()}
    values = {
        name: {(key, repr(value)) for key, value in one.params.items()} if one else set()
        for name, one in given.items()
    }
    names = sorted(cases)
    random.Random(0).shuffle(names)
    seen, chosen = collections.Counter(), []
    every = set().union(*values.values())
    while names and (len(chosen) < keep if keep is not None else every - seen.keys()):
        best = min(names, key=lambda name: sum(seen[value] for value in values[name]))
        names.remove(best)
        chosen.append(best)
        seen.update(values[best])
    return chosen


def pytest_collection_finish():
    """Let garbage collections pass over what stays, and come as rarely as in a command."""
    if sys.version_info < (3, 14):  # where hypothesis misses what refers to its random numbers
        gc.freeze()
    gc.set_threshold(NEW_OBJECTS)


class SpelledRunner(click.testing.CliRunner):
    """Runs the command line; no setting in a sentence may be left unspelled, or be escaped."""

    def invoke(self, *args, **kwargs):
        """Run it, and look at what it prints."""
        result = super().invoke(*args, **kwargs)
        assert "ue000" not in result.output
        assert "\ue000" not in result.output
        return result


click.testing.CliRunner = SpelledRunner


@pytest.fixture(autouse=True)
def close_figures():
    """Close what plot() shows: pyplot warns of the twenty-first that one process has opened."""
    yield
    if (pyplot := sys.modules.get("matplotlib.pyplot")) is not None:
        pyplot.close("all")


@pytest.fixture
def causes():
    """Look for the causes of errors, in a module that does without (`no_causes`)."""


@pytest.fixture
def no_causes(request, monkeypatch):
    """Look for no cause of an error, which is most of the work of a comparison that fails."""
    if "causes" not in request.fixturenames:
        monkeypatch.setattr("quatprop.comparison.comparison._claims", lambda *_: iter(()))


class Recordings(type(Path())):
    """A folder of recordings; one that is not the file it was skips the test that asks for it."""

    def __truediv__(self, name):
        """Return a path inside, having looked at it."""
        path = super().__truediv__(name)
        if path.is_file():
            known = BYTES.get(str(path.relative_to(SHARED_LOGS)))
            if known is not None and path.stat().st_size != known:
                pytest.skip(f"{path} is not the recording it was: it should have {known} bytes")
        return path


FOLDERS = itertools.count()


@pytest.fixture
def tmp_path(tmp_path_factory):
    """Return an empty folder; pytest's own lists those of all tests before, and links to it."""
    return tmp_path_factory.mktemp(str(next(FOLDERS)), numbered=False)


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """Let temporary files go to a folder of the test, where none may stay."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


@pytest.fixture(scope="session")
def shared_logs() -> Path:
    """Return the folder of real recordings, or skip the test where it is absent."""
    if not SHARED_LOGS.is_dir():
        pytest.skip(f"no real recordings at {SHARED_LOGS}; set QUATPROP_SHARED_LOGS")
    return Recordings(SHARED_LOGS)


@pytest.fixture(scope="session")
def store_server():
    """Return an object store on this machine, for all tests; the environment names it."""
    pytest.importorskip("moto")
    from make.store_server import StoreServer

    before = dict(os.environ)
    server = StoreServer()
    yield server
    server.stop()
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture
def bucket(store_server, request):
    """Return the address of a new bucket."""
    store_server.drop_after = None
    store_server.before = lambda _method, _path: None
    return store_server.bucket(f"b{abs(hash(request.node.nodeid)):x}")
