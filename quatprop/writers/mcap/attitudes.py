"""Attitudes as MCAP: ROS 2 or Foxglove's messages, the definition embedded, provenance beside them.

A message is logged at the time of its attitude.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.writers.atomic import Output, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.mcap.file import McapFile
from quatprop.writers.mcap.messages import declared

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message

METADATA = "quatprop"
"""Name of the metadata record that holds the provenance, as JSON under the key ``provenance``.

Under ``topic`` stands which topic it is about.
"""


class McapAttitudes(AttitudeWriter):
    """Write attitudes as messages in an MCAP file.

    Parameters
    ----------
    target
        A path.
    message
        What to write them as.
    """

    def __init__(self, target: Path | str, message: Message) -> None:
        told = declared(message)
        self._encoder = told.encoder
        self._topic = message.place
        self._output = Output(target)
        with reported(target):
            self._file = McapFile(self._output.stream, told.profile, "zstd")
            schema = self._file.add_schema(told.schema_name, told.schema_encoding, told.schema)
            self._channel = self._file.add_channel(self._topic, told.encoding, schema)

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        messages = self._encoder.encode(series, self._output.target)
        with reported(self._output.target):
            self._channel.write(series.t_ns, messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the file, with its provenance, and put it in its place."""
        with reported(self._output.target):
            self._file.add_metadata(
                METADATA, {"provenance": words_of(provenance), "topic": self._topic}
            )
            self._file.finish()
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._file.abort()
        self._output.discard()
