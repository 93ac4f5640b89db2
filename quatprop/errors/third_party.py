"""Convert errors of other packages and of the system to sentences.

Readers and writers catch errors that they expect, where they know the record or the column. All
others are converted here: while a log is open (:func:`as_errors_of`), and at the top of a run
(:func:`as_user_error`). An error that is in no table is reported as a bug in quatprop.
"""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.errors import DamagedLogError, QuatpropError, UnreadableLogError
from quatprop.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator

TRACEBACK = "QUATPROP_TRACEBACK"
"""Environment variable: if set, bugs in quatprop are shown with their traceback."""

READING = {
    "apsw.Error": "its database cannot be used",
    "apsw.ext.QueryLimitNoException": "its database cannot be used",
    "google.protobuf.descriptor.Error": "its protobuf definitions cannot be used",
    "google.protobuf.descriptor_database.Error": "its protobuf definitions cannot be used",
    "google.protobuf.json_format.Error": "its protobuf messages cannot be used",
    "google.protobuf.message.Error": "its protobuf messages cannot be used",
    "google.protobuf.text_format.Error": "its protobuf definitions cannot be used",
    "mcap.exceptions.McapError": "its MCAP records cannot be used",
    "mcap.stream_reader.CRCValidationError": "its MCAP records cannot be used",
    "pyarrow._feather.FeatherError": "its columns cannot be used",
    "rosbags.highlevel.anyreader.AnyReaderError": "its bag cannot be used",
    "rosbags.rosbag1.reader.ReaderError": "its bag cannot be used",
    "rosbags.rosbag2.errors.ReaderError": "its bag cannot be used",
    "rosbags.serde.errors.SerdeError": "its messages cannot be used",
    "rosbags.typesys.base.TypesysError": "its message definitions cannot be used",
    "ruamel.yaml.error.YAMLError": "its metadata cannot be used",
    "ruamel.yaml.error.YAMLStreamError": "its metadata cannot be used",
    "zstandard.backend_c.ZstdError": "its compressed data cannot be used",
    "_csv.Error": "its rows cannot be used",
    "_lzma.LZMAError": "its compressed data cannot be used",
    "builtins.EOFError": "it ends early",
    "builtins.RecursionError": "it is nested too deeply",
    "builtins.UnicodeError": "it contains text in another encoding",
    "struct.error": "its records cannot be used",
    "zipfile.BadZipFile": "its archive cannot be used",
    "zlib.error": "its compressed data cannot be used",
}
"""Errors that only reading raises: full name of the class or a base class -> reason."""

ANYWHERE = {
    "builtins.MemoryError": "there is not enough memory",
    "builtins.OSError": "system error",
    "pyarrow.lib.ArrowException": "columns cannot be used",
    "rosbags.rosbag1.writer.WriterError": "a bag cannot be written",
    "rosbags.rosbag2.errors.WriterError": "a bag cannot be written",
}
"""The same for errors that reading or writing raises."""

MEMORY_HINT = "; choose fewer columns or topics, or a machine with more memory"


def _reason(error: BaseException, table: dict[str, str]) -> str | None:
    """Return the reason of an error from a table; None if it is not in it."""
    for kind in type(error).__mro__:
        name = f"{kind.__module__}.{kind.__qualname__}"
        if name in table:
            detail = getattr(error, "strerror", None) or str(error)
            reason = plain(f"{table[name]} ({detail})" if detail else table[name])
            return reason + MEMORY_HINT if isinstance(error, MemoryError) else reason
    return None


@contextmanager
def as_errors_of(path: Path | str) -> Iterator[None]:
    """Convert errors that only reading raises to a :class:`LogError` that names the log."""
    try:
        yield
    except QuatpropError:
        raise
    except OSError as error:
        if error.errno is not None:
            raise  # a system error, which names the file
        reason = plain(f"it cannot be read ({error}); check that it was copied whole")
        raise DamagedLogError(path, reason) from error
    except MemoryError as error:
        raise UnreadableLogError(path, str(_reason(error, ANYWHERE))) from error
    except Exception as error:
        if (read_error := _reason(error, READING)) is None:
            raise
        raise DamagedLogError(path, f"{read_error}; check that it was copied whole") from error


def as_user_error(error: Exception) -> QuatpropError | None:
    """Return an error with one sentence; None: raise the bug with its traceback."""
    if isinstance(error, QuatpropError):
        return error
    reason = _reason(error, READING | ANYWHERE)
    if reason is not None:
        file = getattr(error, "filename", None)
        return QuatpropError(
            f"{plain(file)}: {reason}" if file else reason[:1].upper() + reason[1:]
        )
    if os.environ.get(TRACEBACK):
        return None
    return QuatpropError(
        f"This is a bug in quatprop ({type(error).__name__}: {plain(error)}, "
        f"{_place(error)}); please report it, with the log if you can. {TRACEBACK}=1 shows more"
    )


def _place(error: Exception) -> str:
    """Return the innermost line of quatprop in the traceback of an error."""
    from traceback import extract_tb

    ours = [
        line for line in extract_tb(error.__traceback__) if "quatprop" in Path(line.filename).parts
    ]
    if not ours:
        return "before its first line"
    return f"{'/'.join(Path(ours[-1].filename).parts[-2:])} line {ours[-1].lineno}"
