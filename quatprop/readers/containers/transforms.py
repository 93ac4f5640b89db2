"""Lists of transforms as tables: a row per transform, selected by its frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.errors import LogError, MessageError, SchemaError, UsageError
from quatprop.base.text import Setting, listed, plain, quoted
from quatprop.base.times import NS_PER_S
from quatprop.readers.containers.topic_table import TEXT_ENCODINGS, TopicTable
from quatprop.readers.messages.binary import Cursor, Names, cursors_of
from quatprop.readers.messages.columns import TooShortError
from quatprop.readers.messages.compiler import ROS1
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.messages.schema import TIME, Primitive, Struct, Type, find, numeric_layout
from quatprop.readers.messages.schema import Sequence as SchemaSequence
from quatprop.readers.tables.model import Column, RowBatch, TablePart, joined_rows, without_misfits

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from quatprop.base.arrays import Float64, Int64
    from quatprop.readers.containers.message_source import MessageSource
    from quatprop.readers.containers.topic_table import Decode
    from quatprop.readers.messages.blocks import Channel, MessageBlock
    from quatprop.readers.tables.model import Group, Stamp


# Decode TF messages: lists of transforms between named frames.
#
# Decoding plans only reach fields that every message has, not the elements of a list. So the lists
# are decoded here: the first transform of all messages, then the second, and so on. The message
# type has never changed; the definition that a log carries is checked against it.


_TRANSLATION_AND_ROTATION = Primitive("f8"), 3 + 4


class Frames(NamedTuple):
    """The two frames of a transform, which is the attitude of the child in the parent."""

    parent: str
    child: str


class Transforms(NamedTuple):
    """The transforms of a block, in the order of messages and, within each, of its list.

    `message`: position of its message in the block, shape ``(N,)``, int64
    `t_ns`: header timestamps, shape ``(N,)``, int64 ns
    `frames`: index of its frames in :attr:`TransformDecoder.frames`, shape ``(N,)``, int64
    `wxyz`: rotations child -> parent, shape ``(N, 4)``, float64
    `position`: positions of the child in the parent, shape ``(N, 3)``, float64, m
    """

    message: Int64
    t_ns: Int64
    frames: Int64
    wxyz: Float64
    position: Float64


class TransformDecoder:
    """Decodes the transforms in the messages of a channel.

    `frames`: all pairs of frames so far, in order of appearance
    """

    def __init__(self, channel: Channel, path: Path | str) -> None:
        self.frames: list[Frames] = []
        self._channel = channel
        self._path = path
        if not _is_list_of_transforms(message_type(channel, path)):
            raise SchemaError(
                path,
                f"topic {quoted(channel.topic)} is of type {quoted(channel.type_name)}, but the "
                "definition that the log carries does not describe a list of transforms",
            )

    def transforms(self, block: MessageBlock) -> Transforms:
        """Return all transforms of a block."""
        none = np.empty(0, np.int64)
        elements = [Transforms(none, none, none, np.empty((0, 4)), np.empty((0, 3)))]
        try:
            for cursor in cursors_of(self._channel, block, self._path):
                elements += self._elements(cursor)
        except TooShortError as error:
            raise MessageError(
                self._path,
                f"the message of topic {quoted(self._channel.topic)} recorded at "
                f"{block.log_ns[error.positions[0]]} ns ends before its list of transforms; "
                "the log is damaged",
                error.positions.tolist(),
            ) from None
        columns = [np.concatenate(parts) for parts in zip(*elements, strict=True)]
        # A stable sort keeps the order of the elements within each message.
        order = np.argsort(columns[0], kind="stable")
        return Transforms(*(column[order] for column in columns))

    def _elements(self, cursor: Cursor) -> Iterator[Transforms]:
        """Yield the first transform of every list, then the second, and so on."""
        left = cursor.numbers("u4").astype(np.int64)
        while True:
            # Every element takes bytes, so a wrong count reaches the end of its message.
            cursor.keep(left > 0)
            left = left[left > 0] - 1
            if not len(left):
                return
            yield self._element(cursor)

    def _element(self, cursor: Cursor) -> Transforms:
        if cursor.placement is ROS1:
            cursor.numbers("u4")  # the sequence number, which ROS 2 does not have
        unsigned = cursor.placement is ROS1
        t_ns = cursor.numbers("u4" if unsigned else "i4").astype(np.int64) * NS_PER_S
        t_ns += cursor.numbers("u4")
        frames = self._frames(cursor.block, cursor.name(), cursor.name())
        values = cursor.numbers("f8", _TRANSLATION_AND_ROTATION[1])
        wxyz = values[:, [6, 3, 4, 5]].astype(np.float64)
        position = values[:, :3].astype(np.float64)
        return Transforms(cursor.messages, t_ns, frames, wxyz, position)

    def _frames(self, block: MessageBlock, parent: Names, child: Names) -> Int64:
        """Return the index of each pair of names, adding new pairs."""
        frames = np.full(len(parent.begin), -1)
        number = 0
        while len(waiting := np.flatnonzero(frames < 0)):
            if number == len(self.frames):
                row = int(waiting[0])
                self.frames.append(Frames(parent.text(block, row), child.text(block, row)))
            pair = self.frames[number]
            same = parent.are(pair.parent, block, waiting)
            same &= child.are(pair.child, block, waiting)
            frames[waiting[same]] = number
            number += 1
        return frames


def _is_list_of_transforms(root: Struct) -> bool:
    match root.fields:
        case ((_, SchemaSequence(element=Struct() as element)),):
            return (
                _names(element) == ["header", "child_frame_id", "transform"]
                and _names(find(element, "transform.rotation")) == list("xyzw")
                and numeric_layout(find(element, "transform")) == _TRANSLATION_AND_ROTATION
            )
    return False


def _names(kind: Type | None) -> list[str]:
    return [name for name, _ in kind.fields] if isinstance(kind, Struct) else []


_NAMES = (
    *(f"transform.rotation.{part}" for part in "xyzw"),
    *(f"transform.translation.{part}" for part in "xyz"),
)
_COLUMNS = (
    Column("header.stamp", "header.stamp", code=TIME.code),
    *(Column(name, name, code="f8") for name in _NAMES),
)


class TransformTable(TopicTable):
    """The transforms between two frames in a topic of transform lists."""

    frames: Frames | None = None
    parts = (TablePart("", "geometry_msgs/msg/TransformStamped", 0, len(_COLUMNS)),)

    def __init__(self, log: MessageSource, channel: Channel) -> None:
        super().__init__(log, channel)
        self.columns = [*_COLUMNS]
        self.matches = {}

    def columns_of(self, name: str) -> Group | None:
        """Return the columns of a field of a transform."""
        found = (k for k, one in enumerate(_COLUMNS) if f"{one.text}.".startswith(f"{name}."))
        return tuple(found) or None

    def field_of(self, group: Group) -> str:  # noqa: ARG002  # the table has no other field
        """Return the two frames, if they are chosen."""
        frames = self.frames
        return "transforms" if frames is None else f"{frames.parent} <- {frames.child}"

    def texts(self, name: str) -> list[str]:
        """Return a frame of the transforms, if they are chosen."""
        if self.frames is None:
            return []
        own = {"header.frame_id": self.frames.parent, "child_frame_id": self.frames.child}
        return [own[name]] if name in own else []

    def of_series(self, series: str | None, frame: str | None, field: str) -> TransformTable:  # noqa: ARG002
        """Return the table of the chosen, or only, pair of frames; reads the whole topic."""
        labels = [label for label in (frame, series) if label is not None]
        every = self.pairs_of_frames()
        if not every:
            none = f"the messages of topic {quoted(self.name)} hold no transforms"
            raise LogError(self.path, f"{none}; choose another {Setting('topic')}")
        if len({*labels}) > 1:
            both = f"{Setting('frame')} and {Setting('series')}"
            raise UsageError(f"{plain(self.path)}: {both} choose different transforms; give one")
        wanted = labels[0] if labels else None
        parent, _, child = (wanted or "").rpartition(":")
        fits = [f for f in every if child in ("", f.child) and parent in ("", f.parent)]
        if len(fits) != 1:
            choices = listed(f"{frames.parent}:{frames.child}" for frames in fits or every)
            what = "has several transforms:" if wanted is None else f"has, for {quoted(wanted)},"
            if not fits:
                what = f"has no transform {quoted(wanted)}, but"
            raise UsageError(
                f"{plain(self.path)}: topic {quoted(self.name)} {what} {choices}; choose one with "
                f"{Setting('frame', 'PARENT:CHILD')}"
            )
        chosen = TransformTable(self.log, self.channel)
        chosen.frames, chosen.blocks = fits[0], self.blocks
        return chosen

    def pairs_of_frames(self) -> list[Frames]:
        """Return all pairs of frames, in order of appearance; reads the whole topic."""
        decoder = TransformDecoder(self.channel, self.path)
        for block in self.log.blocks(self.channel):
            without_misfits(decoder.transforms, block, _left_out)
        return decoder.frames

    def transforms(self, remedy: str) -> Iterator[tuple[Frames, Float64]]:
        """Yield the frames and the rotation of each transform."""
        if self.channel.encoding not in TEXT_ENCODINGS:
            raise UsageError(
                f"{plain(self.path)}: transforms in {quoted(self.channel.encoding)} on "
                f"{quoted(self.name)} are not read; give {remedy}"
            )
        decoder = TransformDecoder(self.channel, self.path)
        for block in self.log.blocks(self.channel):
            found = decoder.transforms(block)
            for number, wxyz in zip(found.frames.tolist(), found.wxyz, strict=True):
                yield decoder.frames[number], wxyz

    def decoder(self, stamps: Sequence[Stamp], groups: Sequence[Group]) -> Decode:
        """Return a function that decodes the transforms between the two frames."""
        transforms = TransformDecoder(self.channel, self.path)
        if self.frames is not None:
            transforms.frames.append(self.frames)

        def decode(blocks: Sequence[MessageBlock]) -> RowBatch:
            return joined_rows([decode_one(block) for block in blocks])

        def decode_one(block: MessageBlock) -> RowBatch:
            found = transforms.transforms(block)
            ours = found.frames == 0
            message = found.message[ours]
            times = [
                found.t_ns[ours]
                if stamp.clock == "header"
                else self.ns(stamp, (), [block])[message]
                for stamp in stamps
            ]
            # The columns are x, y, z, w and the position.
            numbers = np.column_stack((found.wxyz[ours][:, [1, 2, 3, 0]], found.position[ours]))
            values = (numbers[:, [k - 1 for k in group]] for group in groups)
            return RowBatch(block.log_ns[message], (*times, *values), block.watermark_ns)

        return decode


def _left_out(block: MessageBlock, error: MessageError) -> MessageBlock:
    return block.without(error.positions)
