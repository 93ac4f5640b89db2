"""Attitudes as a ROS 2 bag folder; a message is logged at the time of its attitude.

The provenance is among the custom data of metadata.yaml, under the key ``quatprop``, as JSON.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.rosbag2 import CompressionMode, StoragePlugin

from quatprop.writers.base import AttitudeWriter, words_of
from quatprop.writers.messages.ros_messages import Encoder
from quatprop.writers.messages.ros_types import ros2_types
from quatprop.writers.rosbag2.folder import BagFolder

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from quatprop.series import AttitudeSeries
    from quatprop.writers.messages.kinds import Message


class SqliteAttitudes(AttitudeWriter):
    """Write attitudes as messages in a ROS 2 bag that stores them in SQLite.

    Parameters
    ----------
    target
        A path where nothing is yet.
    message
        What to write them as.
    """

    storage = StoragePlugin.SQLITE3
    compression = CompressionMode.NONE

    def __init__(self, target: Path | str, message: Message) -> None:
        kind = message.definition
        self._target = target
        self._encoder = Encoder(message)
        self._bag = BagFolder(
            target,
            self.storage,
            self.compression,
            topic=message.place,
            kind=kind.name,
            types=ros2_types(),
        )

    def write(self, series: AttitudeSeries) -> None:
        """Append a batch."""
        self._bag.write(series.t_ns, self._encoder.encode(series, self._target))

    def commit(self, provenance: Mapping[str, Any]) -> None:
        """Finish the folder, with its provenance, and put it in its place."""
        self._bag.commit(words_of(provenance))

    def abort(self) -> None:
        """Remove what was not committed."""
        self._bag.abort()


class McapFolderAttitudes(SqliteAttitudes):
    """Write attitudes as messages in a ROS 2 bag that stores them in MCAP; parameters as above."""

    storage = StoragePlugin.MCAP
    compression = CompressionMode.STORAGE
