"""Copies of ROS 1 bags to which attitudes are added."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from quatprop.into.rosbag1_copy import BagCopy
from quatprop.writers.atomic import OutputFile, output_errors
from quatprop.writers.base import MessageWriter
from quatprop.writers.messages.encoders import attitude_encoder
from quatprop.writers.rosbag1.file import BagFile
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.containers.rosbag1.log import Rosbag1Log
    from quatprop.writers.messages.kinds import Message

_CHUNK_BYTES = 1 << 17
"""Small chunks, so that each is among those of its own time."""


class BagCopyWriter(MessageWriter):
    """Copy a ROS 1 bag and add attitudes to it.

    Parameters
    ----------
    log
        The log to copy.
    target
        Where the copy goes.
    message
        The message to write the attitudes as.

    Raises
    ------
    UsageError
        It is no ROS message.
    """

    _output: OutputFile

    def __init__(self, log: Rosbag1Log, target: Path | str, message: Message) -> None:
        self.encoder = attitude_encoder(message, ("ros1",))
        refuse_streams(target, "a ROS 1 bag")
        self._copy = BagCopy(log)
        self._output = OutputFile(target)
        with ExitStack() as resources:
            resources.callback(self._output.discard)
            with output_errors(target):
                self._bag = BagFile(
                    self._output.stream,
                    self.encoder.topic,
                    "none",
                    connection=self._copy.free_id,
                    before=lambda first_ns: self._copy.up_to(first_ns, self._bag),
                    chunk_bytes=_CHUNK_BYTES,
                )
            resources.pop_all()

    def write(self, log_ns: NDArray[np.int64], messages: NDArray[np.void]) -> None:
        """Append messages, after everything of the log that was logged before them."""
        with output_errors(self._output.target):
            self._bag.write(log_ns, messages)

    def finish(self, provenance: Mapping[str, object]) -> None:
        """Copy the rest, finish the bag with its provenance."""
        with output_errors(self._output.target):
            self._bag.flush()
            self._copy.up_to(None, self._bag)
            self._bag.finish(provenance, self._copy.connections)
        self._output.finish()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        self._output.discard()
