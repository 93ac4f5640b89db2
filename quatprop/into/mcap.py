"""MCAP files with attitudes added."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.errors import UsageError, plain, quoted
from quatprop.into.mcap_copy import McapCopy
from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.mcap import METADATA
from quatprop.writers.mcap_contents import encoded
from quatprop.writers.mcap_file import McapFile
from quatprop.writers.mcap_messages import declared

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.into import Addition
    from quatprop.readers.mcap import McapLog
    from quatprop.series import AttitudeSeries

_CHUNK_BYTES = 1 << 17
"""Small chunks: each stands between those of its own time."""


class McapInto(AttitudeWriter):
    """Copy an MCAP file and add attitudes to it.

    Parameters
    ----------
    log
        What is copied.
    target
        Where the copy goes.
    addition
        What is added.

    Raises
    ------
    UsageError
        The topic is there already.
    """

    def __init__(self, log: McapLog, target: Path | str, addition: Addition) -> None:
        message = addition.message
        self._times = addition.times
        self._topic = message.place
        self._copy = McapCopy(log.path)
        contents = self._copy.contents
        if any(channel.topic == self._topic for channel in contents.channels.values()):
            self._copy.close()
            raise UsageError(
                f"{plain(log.path)}: topic {quoted(self._topic)} is there already; choose another "
                "with --out-topic NAME"
            )
        told = declared(message, ros1=self._copy.header.profile == "ros1")
        self._encoder = told.encoder
        self._output = Output(target)
        with reported(target):
            self._file = McapFile(
                self._output.stream,
                self._copy.header,
                "zstd",
                contents=contents,
                before=self._before,
                chunk_bytes=_CHUNK_BYTES,
            )
            # Some recorders tell of topics without messages at the end only: all go first.
            self._file.put(encoded([*contents.schemas.values(), *contents.channels.values()]))
            schema = self._file.add_schema(told.schema_name, told.schema_encoding, told.schema)
            self._channel = self._file.add_channel(self._topic, told.encoding, schema)

    def _before(self, first_ns: int) -> None:
        self._copy.up_to(first_ns, self._file)

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch, and what the log holds up to its time."""
        messages = self._encoder.encode(series, self._output.target)
        log_ns = self._times.of(series.t_ns)
        with reported(self._output.target):
            self._channel.write(log_ns, messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Copy the rest, finish the file with its provenance, and put it in its place."""
        told = {"provenance": words_of(provenance), "topic": self._topic}
        with reported(self._output.target):
            self._file.flush()
            self._copy.rest(self._file)
            self._file.add_metadata(METADATA, told)
            self._file.finish()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._file.abort()
        self._copy.close()
        self._output.discard()
