"""MCAP files of one topic, with the definition embedded and the provenance as metadata."""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter, provenance_json
from quatprop.writers.mcap.file import McapFile
from quatprop.writers.messages.topics import PROFILES

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.writers.messages.topics import Topic

METADATA = "quatprop"
"""Name of the metadata record of a topic's provenance, with the keys ``provenance``, which is
JSON, and ``topic``."""


class McapWriter(MessageWriter):
    """Write messages to an MCAP file.

    Parameters
    ----------
    target
        A path.
    topic
        The topic and its definition.
    compression
        Of the chunks: ``"zstd"``, ``"lz4"`` or ``"none"``.
    """

    _output: OutputFile

    def __init__(self, target: Path | str, topic: Topic, compression: str) -> None:
        self._topic = topic.name
        super().__init__(OutputFile(target))
        with self._errors():
            profile = PROFILES.get(topic.encoding, "")
            self._file = McapFile(self._output.stream, profile, compression)
            self._channel = self._file.add_channel(topic)

    def _write(self, log_ns: NDArray[np.int64], messages: NDArray[np.void]) -> None:
        self._channel.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        finish_with_provenance(self._file, self._topic, provenance)

    def abort(self) -> None:
        """Remove what was not committed."""
        self._file.abort()
        super().abort()


def finish_with_provenance(file: McapFile, topic: str, provenance: Mapping[str, object]) -> None:
    """Finish an MCAP file with the provenance of a topic, if there is any."""
    if provenance:
        record = {"provenance": provenance_json(provenance), "topic": topic}
        file.add_metadata(METADATA, record)
    file.finish()
