"""Errors of other packages become sentences: all of them, as they are installed."""

import importlib
import inspect
import pkgutil
import struct
import warnings
import zipfile
import zlib

import pytest
from make.commands import refused
from make.tables import write_rates

from quatprop.base.errors import (
    ANYWHERE,
    READING,
    DamagedLogError,
    UnreadableLogError,
    as_errors_of,
    as_user_error,
)
from quatprop.readers.containers import mcap
from quatprop.readers.open_log import open_log

PACKAGES = ("apsw", "google.protobuf", "lz4", "mcap", "pyarrow", "rosbags", "ruamel.yaml")
SKIPPED = ("test", "__main__", "setup", "benchmark", "conftest", "backend_cffi", "shell")
"""Modules that are programs, tests, or another build of one that is looked at."""

UNREACHABLE = {
    "apsw.aio._Cancelled": "of asyncio, which is not used",
    "apsw.fts5query.ParseError": "of full text search, which is not used",
    "apsw.sqlite_extra.NotAvailable": "of extensions, none of which is loaded",
    "google.protobuf.message.FrozenInstanceError": "raised where a message is changed",
    "google.protobuf.runtime_version.VersionError": "raised by generated code; there is none",
    "pyarrow._flight.FlightError": "of a network protocol that is not used",
    "pyarrow.interchange.column.NoBufferPresent": "of the interchange protocol, not used",
    "pyarrow.vendored.docscrape.ParseError": "of its documentation",
    "pyarrow.vendored.version.InvalidVersion": "of version numbers of pandas",
    "rosbags.convert.converter.ConverterError": "of a program next to the library",
}
"""Errors that no run can raise, and why."""

NEW = {
    "apsw.aio._Cancelled",
    "apsw.ext.QueryLimitNoException",
    "apsw.fts5query.ParseError",
    "apsw.sqlite_extra.NotAvailable",
    "google.protobuf.message.FrozenInstanceError",
    "pyarrow._flight.FlightError",
}
"""Classes that the lowest versions, or some builds, do not have."""


def modules(name):
    """Yield a package and all modules in it that can be imported."""
    try:
        module = importlib.import_module(name)
    except ImportError:  # it needs what is not installed, and cannot be used either
        return
    yield module
    for inside in pkgutil.iter_modules(getattr(module, "__path__", [])):
        if not any(part in inside.name for part in SKIPPED):
            yield from modules(f"{name}.{inside.name}")


def name_of(kind):
    """Return the full name of a class."""
    return f"{kind.__module__}.{kind.__qualname__}"


@pytest.mark.parametrize("package", [*PACKAGES, "zstandard.backend_c", "zstandard"])
def test_every_error_of_a_package_is_mapped_or_cannot_come(package):
    """Each exception class of the installed version is in the tables, or in the list with why."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = {
            kind
            for module in modules(package)
            for _, kind in inspect.getmembers(module, inspect.isclass)
            if issubclass(kind, BaseException) and kind.__module__.startswith(package)
        }
    known = READING.keys() | ANYWHERE.keys() | UNREACHABLE.keys() | {"builtins.Warning"}
    assert [
        name_of(kind) for kind in found if not known & {name_of(base) for base in kind.__mro__}
    ] == []


def test_the_tables_name_what_there_is():
    """No entry is of a class that the installed versions do not have, but for new ones."""
    for name in (READING.keys() | ANYWHERE.keys() | UNREACHABLE.keys()) - NEW:
        module, _, kind = name.rpartition(".")
        assert issubclass(getattr(importlib.import_module(module), kind), BaseException), name


@pytest.mark.parametrize(
    ("error", "kind", "sentence"),
    [
        *(
            (error("x"), DamagedLogError, r": it.* \(x\); check that it was copied whole$")
            for error in (struct.error, zlib.error, EOFError, zipfile.BadZipFile)
        ),
        (
            OSError("Expected 8 bytes, got 0"),  # some packages raise it for what is not there
            DamagedLogError,
            r": it cannot be read \(Expected 8 bytes, got 0\); check that",
        ),
        (
            MemoryError("Unable to allocate 8 EiB"),
            UnreadableLogError,
            r": there is not enough memory \(Unable to allocate 8 EiB\); choose fewer",
        ),
    ],
)
def test_errors_while_a_log_is_open_name_it(tmp_path, error, kind, sentence):
    """Errors that only reading raises mean damage of the open log."""
    log = write_rates(tmp_path / "log.csv", [[0, 1, 2, 3]])
    with pytest.raises(kind, match=f"^{log}{sentence}") as caught, open_log(log):
        raise error
    assert type(caught.value) is kind


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (MemoryError(), "LOG: there is not enough memory; choose fewer"),
        (
            TypeError("of all \x1b[2J things"),
            "This is a bug in quatprop (TypeError: of all \\x1b[2J things, ",
        ),
    ],
)
def test_errors_of_a_command_are_one_sentence(tmp_path, monkeypatch, error, sentence):
    """There is no traceback: it says what, where, and whether it should be reported."""

    def survey(_source):
        raise error

    monkeypatch.delenv("QUATPROP_TRACEBACK")
    monkeypatch.setattr(mcap, "build_index", survey)
    log = tmp_path / "log.mcap"
    log.write_bytes(b"\x89MCAP0\r\n")
    said = refused("info", log)
    assert said.startswith(f"Error: {sentence.replace('LOG', str(log))}")
    is_ours = isinstance(error, TypeError)
    assert ("please report it, with the log if you can" in said) == is_ours


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(28, "No space left on device", "/out"), "/out: system error (No space left"),
        (OSError(5, "Input/output error"), "System error (Input/output error)"),
        (PermissionError(13, "Permission denied", "a\x1b[2J"), "a\\x1b[2J: system error"),
        (MemoryError(), "There is not enough memory; choose fewer columns"),
        (
            UnicodeEncodeError("ascii", "\xe4", 0, 1, "no"),
            "It contains text in another encoding ('ascii' codec",
        ),
    ],
)
def test_errors_of_the_system_are_one_sentence(error, sentence):
    """A system error becomes a sentence with the file that it names."""
    assert str(as_user_error(error)).startswith(sentence)


def test_a_bug_is_a_traceback_where_that_is_asked_for(monkeypatch):
    """Otherwise a sentence says where it is."""
    assert as_user_error(TypeError("x")) is None
    monkeypatch.delenv("QUATPROP_TRACEBACK")
    said = "This is a bug in quatprop (TypeError: x, before its first line); please report it, "
    assert str(as_user_error(TypeError("x"))).startswith(said)


def test_unknown_errors_pass(tmp_path):
    """An error of this package is not taken for damage of the log."""
    with pytest.raises(KeyError, match="ours"), as_errors_of(tmp_path):
        raise KeyError("ours")
