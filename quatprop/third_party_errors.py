"""What other packages and the system raise, and the sentence that each becomes: all in one place.

Readers and writers catch what they expect, where they know the record or the column. Whatever
else comes through them, from the versions installed, is looked up here: first where the log is
known (:func:`as_errors_of`), at last on the command line (:func:`as_user_error`). What is in no
table is an error of this package, and is said to be one.
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
"""Set in the environment: errors of this package itself are shown with their traceback."""

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
    "zstandard.backend_c.ZstdError": "its packed data cannot be used",
    "_csv.Error": "its rows cannot be used",
    "_lzma.LZMAError": "its packed data cannot be used",
    "builtins.EOFError": "it ends early",
    "builtins.RecursionError": "something in it is nested too deeply",
    "builtins.UnicodeError": "a text in it is none",
    "struct.error": "its records cannot be used",
    "zipfile.BadZipFile": "its archive cannot be used",
    "zlib.error": "its packed data cannot be used",
}
"""What only reading a log raises, by the full name of its class or of one it is made from."""

ANYWHERE = {
    "builtins.MemoryError": "there is not enough memory",
    "builtins.OSError": "the system refuses",
    "pyarrow.lib.ArrowException": "columns cannot be used",
    "rosbags.rosbag1.writer.WriterError": "a bag cannot be written",
    "rosbags.rosbag2.errors.WriterError": "a bag cannot be written",
}
"""What reading or writing raises."""

NO_ROOM = "; choose fewer columns or topics, or a machine with more memory"


def _said(error: BaseException, table: dict[str, str]) -> str | None:
    """Return what a table says of an error; None where it is not in it."""
    for kind in type(error).__mro__:
        name = f"{kind.__module__}.{kind.__qualname__}"
        if name in table:
            detail = getattr(error, "strerror", None) or str(error)
            said = plain(f"{table[name]} ({detail})" if detail else table[name])
            return said + NO_ROOM if isinstance(error, MemoryError) else said
    return None


@contextmanager
def as_errors_of(path: Path | str) -> Iterator[None]:
    """Name the log whose reading raises what only reading raises."""
    try:
        yield
    except QuatpropError:
        raise
    except OSError as error:
        if error.errno is not None:
            raise  # of the system, which names the file
        reason = plain(f"it cannot be read ({error}); check that it was copied whole")
        raise DamagedLogError(path, reason) from error
    except MemoryError as error:
        raise UnreadableLogError(path, str(_said(error, ANYWHERE))) from error
    except Exception as error:
        said = _said(error, READING)
        if said is None:
            raise
        raise DamagedLogError(path, f"{said}; check that it was copied whole") from error


def as_user_error(error: Exception) -> QuatpropError | None:
    """Return an error as one sentence.

    Returns
    -------
    QuatpropError or None
        None where it is an error of this package itself and its traceback is wanted.
    """
    said = _said(error, READING | ANYWHERE)
    if said is not None:
        name = getattr(error, "filename", None)
        return QuatpropError(f"{plain(name)}: {said}" if name else said[:1].upper() + said[1:])
    if os.environ.get(TRACEBACK):
        return None
    return QuatpropError(
        f"This is an error of quatprop itself ({type(error).__name__}: {plain(error)}, "
        f"{_place(error)}); please report it, with the log if you can. {TRACEBACK}=1 shows more"
    )


def _place(error: Exception) -> str:
    """Return where in this package an error was raised, or passed last."""
    trace, place = error.__traceback__, "before its first line"
    while trace is not None:
        path = Path(trace.tb_frame.f_code.co_filename)
        if "quatprop" in path.parts:
            place = f"{'/'.join(path.parts[-2:])} line {trace.tb_lineno}"
        trace = trace.tb_next
    return place
