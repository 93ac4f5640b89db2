"""ROS 1 bags with attitudes added."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from quatprop.into.rosbag1_copy import BagCopy
from quatprop.into.topics import refuse_taken
from quatprop.writers.atomic import Output, refuse_streams, reported
from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.messages.ros_messages import Encoder
from quatprop.writers.messages.ros_types import ros1_types
from quatprop.writers.rosbag1.file import BagFile

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.containers.rosbag1.log import Rosbag1Log
    from quatprop.into import Addition
    from quatprop.series import AttitudeSeries

_CHUNK_BYTES = 1 << 17
"""Small chunks: each stands between those of its own time."""


class Rosbag1Into(AttitudeWriter):
    """Copy a ROS 1 bag and add attitudes to it.

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
        The topic is there already, or the message is none of ROS.
    """

    def __init__(self, log: Rosbag1Log, target: Path | str, addition: Addition) -> None:
        message = addition.message
        self._times = addition.times
        self._encoder = Encoder(message, ros1=True)
        refuse_streams(target, "a ROS 1 bag")
        name = message.definition.name
        definition, md5sum = ros1_types().generate_msgdef(name)
        with ExitStack() as begun:
            self._copy = BagCopy(log)
            refuse_taken(message.place, self._copy.topics(), log.path)
            self._output = Output(target)
            begun.callback(self._output.discard)
            with reported(target):
                self._bag = BagFile(
                    self._output.stream,
                    "none",
                    topic=message.place,
                    kind=name.replace("/msg/", "/"),
                    definition=definition,
                    md5sum=md5sum,
                    connection=self._copy.free,
                    before=self._before,
                    chunk_bytes=_CHUNK_BYTES,
                )
            begun.pop_all()

    def _before(self, first_ns: int) -> None:
        self._copy.up_to(first_ns, self._bag)

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch, and what the bag holds up to its time."""
        messages = self._encoder.encode(series, self._output.target)
        log_ns = self._times.of(series.t_ns)
        with reported(self._output.target):
            self._bag.write(log_ns, messages)

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Copy the rest, finish the bag with its provenance, and put it in its place."""
        with reported(self._output.target):
            self._bag.flush()
            self._copy.up_to(None, self._bag)
            self._bag.finish(words_of(provenance), self._copy.connections)
        self._output.commit()

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()
        self._output.discard()
