"""Copy MCAP files and add attitudes."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from quatprop.log_copy.mcap_copy import ROSBAG2, SERIALIZED, McapCopy
from quatprop.log_copy.rosbag2_metadata import Added, extended_record
from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter
from quatprop.writers.mcap.contents import encoded
from quatprop.writers.mcap.file import McapFile, finish_with_provenance
from quatprop.writers.messages import attitude_encoder

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from quatprop.arrays import Int64, Records
    from quatprop.containers.mcap.log import McapLog
    from quatprop.writers.messages.kinds import Message

_CHUNK_BYTES = 1 << 17
"""Bytes of a chunk of attitudes: small, so that it is near the log's chunks of its time."""


class McapPart:
    """A copy of an MCAP file to which messages of one topic are added.

    `log`: the file to copy; it stays open until the part is finished
    `place`: the destination: a path that does not exist, or a stream
    `encoder`: the encoder of attitudes for this file
    """

    def __init__(self, log: McapLog, place: Path | BinaryIO, message: Message) -> None:
        with ExitStack() as resources:
            self._copy = McapCopy(log)
            ros = "ros1" if self._copy.header.profile == "ros1" else "cdr"
            self.encoder = attitude_encoder(message, (ros, "protobuf"))
            self.added = Added()
            if isinstance(place, Path):
                place = resources.enter_context(place.open("xb"))
            contents = self._copy.contents
            self._file = McapFile(
                place,
                self._copy.header,
                "zstd",
                contents=contents,
                before=lambda first_ns: self._copy.up_to(first_ns, self._file),
                chunk_bytes=_CHUNK_BYTES,
            )
            resources.callback(self._file.abort)
            # Some recorders declare topics without messages in the summary only.
            self._file.append(encoded([*contents.schemas.values(), *contents.channels.values()]))
            self._file.add_channel(self.encoder.topic)
            self._resources = resources.pop_all()

    def write(self, log_ns: Int64, messages: Records) -> None:
        """Append messages, after the parts of the log that are earlier."""
        self._file.write(log_ns, messages)
        self.added.add(log_ns)

    def finish(
        self, extend: Callable[[str], str], provenance: Mapping[str, object] | None = None
    ) -> None:
        """Copy the rest of the log and finish the file."""
        self._file.flush()
        self._copy.up_to(None, self._file)
        if self._copy.bag_metadata is not None:
            self._file.add_metadata(ROSBAG2, {SERIALIZED: extend(self._copy.bag_metadata)})
        finish_with_provenance(self._file, self.encoder.topic.name, provenance or {})
        self.close()

    def close(self) -> None:
        """Close the copy; may be called twice."""
        self._resources.close()


class McapCopyWriter(MessageWriter):
    """Copy an MCAP file and add attitudes to it."""

    _output: OutputFile

    def __init__(self, log: McapLog, target: Path | str, message: Message) -> None:
        super().__init__(OutputFile(target))
        with self._opening():
            self._part = McapPart(log, self._output.stream, message)
        self.encoder = self._part.encoder

    def _write(self, log_ns: Int64, messages: Records) -> None:
        self._part.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        topic, part = self.encoder.topic, self._part
        part.finish(lambda text: extended_record(text, topic, [part.added]), provenance)

    def abort(self) -> None:
        """Discard uncommitted output."""
        self._part.close()
        super().abort()
