"""Lists of transforms as tables: a row per transform, selected by its frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quatprop.containers.topic_table import TEXT_ENCODINGS, TopicTable
from quatprop.errors import LogError, UsageError
from quatprop.messages.schema import TIME
from quatprop.messages.transforms import Frames, TransformDecoder
from quatprop.tables.batches import RowBatch, joined_rows, without_misfits
from quatprop.tables.model import Column, TablePart
from quatprop.text import Setting, listed, plain, quoted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from quatprop.arrays import Float64
    from quatprop.containers.base import MessageLog
    from quatprop.containers.topic_table import Decode
    from quatprop.errors import MessageError
    from quatprop.messages.blocks import Channel, MessageBlock
    from quatprop.tables.model import Group, Stamp

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

    def __init__(self, log: MessageLog, channel: Channel) -> None:
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

    def of_series(self, labels: Sequence[str]) -> TransformTable:
        """Return the table of the chosen, or only, pair of frames; reads the whole topic."""
        decoder = TransformDecoder(self.channel, self.path)
        for block in self.log.blocks(self.channel):
            without_misfits(decoder.transforms, block, _left_out)
        if not decoder.frames:
            none = f"the messages of topic {quoted(self.name)} hold no transforms"
            raise LogError(self.path, f"{none}; choose another {Setting('topic')}")
        if len({*labels}) > 1:
            both = f"{Setting('frame')} and {Setting('series')}"
            raise UsageError(f"{plain(self.path)}: {both} choose different transforms; give one")
        wanted = labels[0] if labels else None
        parent, _, child = (wanted or "").rpartition(":")
        fits = [f for f in decoder.frames if child in ("", f.child) and parent in ("", f.parent)]
        if len(fits) != 1:
            choices = listed(f"{frames.parent}:{frames.child}" for frames in fits or decoder.frames)
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

    def transforms(self, way_out: str) -> Iterator[tuple[Frames, Float64]]:
        """Yield the frames and the rotation of each transform."""
        if self.channel.encoding not in TEXT_ENCODINGS:
            raise UsageError(
                f"{plain(self.path)}: transforms in {quoted(self.channel.encoding)} on "
                f"{quoted(self.name)} are not read; give {way_out}"
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
