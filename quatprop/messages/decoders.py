"""Message encodings and their decoders."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final, Protocol

from quatprop.errors import UnsupportedLogError
from quatprop.text import listed, quoted

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from quatprop.arrays import AnyArray
    from quatprop.messages.blocks import Channel, MessageBlock

DECODERS: Final[dict[str, str]] = {
    "cdr": "quatprop.messages.binary:BinaryDecoder",
    "ros1": "quatprop.messages.binary:BinaryDecoder",
    "ulog": "quatprop.messages.binary:BinaryDecoder",
    "json": "quatprop.messages.json:JsonDecoder",
    "protobuf": "quatprop.messages.protobuf:ProtobufDecoder",
}
"""``"module:Class"`` of the decoder by message encoding; imported when a channel is decoded."""


class FieldDecoder(Protocol):
    """Decodes the same fields of every message of a channel."""

    def columns(self, *blocks: MessageBlock) -> list[AnyArray]:
        """Return the wanted fields of all messages in some blocks.

        `Returns`: one array per path: shape ``(N,)`` for a number, ``(N, k)`` for a row of `k`
        """


def decoder_of(channel: Channel, field_paths: Sequence[str], path: Path | str) -> FieldDecoder:
    """Return a decoder of some fields of a channel."""
    if channel.encoding not in DECODERS:
        raise UnsupportedLogError(
            path,
            f"topic {quoted(channel.topic)} is encoded as {quoted(channel.encoding)}; "
            f"this version reads {listed(DECODERS)}",
        )
    module, _, name = DECODERS[channel.encoding].partition(":")
    decoder: FieldDecoder = getattr(import_module(module), name)(channel, field_paths, path)
    return decoder
