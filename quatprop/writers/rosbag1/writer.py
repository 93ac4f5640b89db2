"""ROS 1 bags of one topic.

Bags have no place of their own for provenance: it is a field of the connection, as the index
repeats it. Readers ignore fields they do not know.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.writers.atomic import OutputFile
from quatprop.writers.base import MessageWriter
from quatprop.writers.rosbag1.file import BagFile
from quatprop.writers.targets import refuse_streams

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from quatprop.writers.messages.topics import Topic


class BagWriter(MessageWriter):
    """Write messages to a ROS 1 bag.

    Parameters
    ----------
    target
        A path; a bag begins with the place of its index, so it cannot be a pipe.
    topic
        The topic and its definition.
    compression
        Of the chunks: ``"none"``, ``"lz4"`` or ``"bz2"``.
    """

    _output: OutputFile

    def __init__(self, target: Path | str, topic: Topic, compression: str) -> None:
        refuse_streams(target, "a ROS 1 bag")
        super().__init__(OutputFile(target))
        with self._errors():
            self._bag = BagFile(self._output.stream, topic, compression)

    def _write(self, log_ns: NDArray[np.int64], messages: NDArray[np.void]) -> None:
        self._bag.write(log_ns, messages)

    def _finish(self, provenance: Mapping[str, object]) -> None:
        self._bag.finish(provenance)

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        super().abort()
