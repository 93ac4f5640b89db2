"""MCAP files with attitudes added."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from quatprop.into.mcap_copy import McapCopy
from quatprop.into.topics import refuse_taken
from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.mcap.attitudes import METADATA
from quatprop.writers.mcap.contents import encoded
from quatprop.writers.mcap.file import McapFile
from quatprop.writers.mcap.messages import declared

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any, BinaryIO

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.mcap.log import McapLog
    from quatprop.into import Addition
    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message

_CHUNK_BYTES = 1 << 17
"""Small chunks: each stands between those of its own time."""


class McapPart:
    """A copy of an MCAP file to which messages of one topic are added.

    Parameters
    ----------
    log
        What is copied; it stays open until the part is finished.
    place
        Where the copy goes: a path where nothing is, or a stream.
    message
        What is published where.

    Raises
    ------
    UsageError
        The topic is there already.

    Attributes
    ----------
    encoder
        Encodes the messages as the file has them.
    """

    def __init__(self, log: McapLog, place: Path | BinaryIO, message: Message) -> None:
        with ExitStack() as begun:
            self._copy = McapCopy(log)
            contents, topic = self._copy.contents, message.place
            taken = [channel.topic for channel in contents.channels.values()]
            refuse_taken(topic, taken, log.path)
            told = declared(message, ros1=self._copy.header.profile == "ros1")
            self.encoder = told.encoder
            if isinstance(place, Path):
                place = begun.enter_context(place.open("xb"))
            self._file = McapFile(
                place,
                self._copy.header,
                "zstd",
                contents=contents,
                before=self._before,
                chunk_bytes=_CHUNK_BYTES,
            )
            begun.callback(self._file.abort)
            # Some recorders tell of topics without messages at the end only: all go first.
            self._file.put(encoded([*contents.schemas.values(), *contents.channels.values()]))
            schema = self._file.add_schema(told.schema_name, told.schema_encoding, told.schema)
            self._channel = self._file.add_channel(topic, told.encoding, schema)
            self._begun = begun.pop_all()

    def write(self, log_ns: NDArray[np.int64], messages: NDArray[np.void]) -> None:
        """Append messages, and what the file holds up to their time."""
        self._channel.write(log_ns, messages)

    def rest(self) -> McapFile:
        """Copy everything that is left, and return the file for what comes at its end."""
        self._file.flush()
        self._copy.rest(self._file)
        return self._file

    def finish(self, metadata: str | None = None) -> None:
        """Finish the file, with what metadata.yaml says."""
        file = self.rest()
        if metadata is not None:
            file.add_metadata("rosbag2", {"serialized_metadata": metadata})
        file.finish()
        self.close()

    def close(self) -> None:
        """Let go of both files; harmless after the end."""
        self._begun.close()

    def _before(self, first_ns: int) -> None:
        self._copy.up_to(first_ns, self._file)


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
        self._topic = addition.message.place
        self._times = addition.times
        self._output = Output(target)
        try:
            with reported(target):
                self._part = McapPart(log, self._output.stream, addition.message)
        except BaseException:
            self._output.discard()
            raise

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch, and what the log holds up to its time."""
        messages = self._part.encoder.encode(series, self._output.target)
        log_ns = self._times.of(series.t_ns)
        with reported(self._output.target):
            self._part.write(log_ns, messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Copy the rest, finish the file with its provenance, and put it in its place."""
        told = {"provenance": words_of(provenance), "topic": self._topic}
        with reported(self._output.target):
            file = self._part.rest()
            file.add_metadata(METADATA, told)
            file.finish()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._part.close()
        self._output.discard()
