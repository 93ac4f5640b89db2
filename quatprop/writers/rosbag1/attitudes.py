"""Attitudes as a ROS 1 bag; a message is logged at the time of its attitude.

Bags have no place of their own for provenance: it is a field of the connection, as the index
repeats it. Readers pass over fields they do not know.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from quatprop.writers.atomic import Output, refuse_streams, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.messages.ros_messages import Encoder
from quatprop.writers.messages.ros_types import ros1_types
from quatprop.writers.rosbag1.file import BagFile

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


class Rosbag1Attitudes(AttitudeWriter):
    """Write attitudes as messages in a ROS 1 bag.

    Parameters
    ----------
    target
        A path; a bag begins with where its index is, so it cannot be a pipe.
    message
        What to write them as.
    """

    def __init__(self, target: Path | str, message: Message) -> None:
        kind = message.definition
        self._encoder = Encoder(message, ros1=True)
        definition, md5sum = ros1_types().generate_msgdef(kind.name)
        refuse_streams(target, "a ROS 1 bag")
        self._output = Output(target)
        with reported(target):
            self._bag = BagFile(
                self._output.stream,
                "none",
                topic=message.place,
                kind=kind.name.replace("/msg/", "/"),
                definition=definition,
                md5sum=md5sum,
            )

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        messages = self._encoder.encode(series, self._output.target)
        with reported(self._output.target):
            self._bag.write(series.t_ns, messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the bag, with its provenance, and put it in its place."""
        with reported(self._output.target):
            self._bag.finish(words_of(provenance))
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        self._output.discard()
