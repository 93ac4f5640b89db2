"""Encapsulations, byte orders and the definitions behind them."""

import struct

import pytest
from make.messages_reference import Encoder, block_of, channel_of

from quatprop.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.messages.binary import BinaryDecoder
from quatprop.messages.blocks import Channel
from quatprop.messages.decoders import decoder_of
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import Array, Primitive, Sequence, String, Struct

EMPTY = "std_msgs/Empty nothing\nuint8 x\n" + "=" * 80 + "\nMSG: std_msgs/Empty\n"
PADDED = "S[3] s\nuint8 x\n" + "=" * 80 + "\nMSG: pkg/S\nuint8 a\nfloat64 b\nuint8 c\n"
TIMES = struct.pack("<IIii", 3_000_000_000, 4_000_000_000, -2, -5)


def decoder(text, wanted, encoding="cdr"):
    """Return what decodes fields of messages that a text defines."""
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    channel = Channel("/topic", "pkg/msg/T", encoding, grammar, text.encode())
    return BinaryDecoder(channel, wanted.split(), "log")


@pytest.mark.parametrize(
    ("encoding", "text", "message", "wanted", "values"),
    [
        # XCDR2 aligns numbers of eight bytes to four; earlier drafts gave it other identifiers.
        ("cdr", "uint32 a\nfloat64 b", b"\0\7\0\0" + struct.pack("<Id", 1, 2.5), "b", [2.5]),
        ("cdr", "uint32 a\nfloat64 b", b"\0\x11\0\0" + struct.pack("<Id", 1, 2.5), "b", [2.5]),
        ("cdr", "uint32 a\nfloat64 b", b"\0\x10\0\0" + struct.pack(">Id", 1, 2.5), "b", [2.5]),
        # The padding before eight-byte elements is there only where an element is.
        ("cdr", "float64[] m\nint32 x", b"\0\1\0\0" + bytes(4) + b"\7\0\0\0", "x", [7]),
        ("cdr", "float64[] m\nint32 x", b"\0\1\0\0\1" + bytes(15) + b"\7\0\0\0", "x", [7]),
        # Elements are padded by where each begins: at 0, 17 and 33, their b at 8, 24 and 40.
        ("cdr", PADDED, b"\0\1\0\0" + bytes(49) + b"\x2a", "x", [42]),
        # An empty struct takes a byte in CDR and none in ROS 1.
        ("cdr", EMPTY, b"\0\1\0\0\0\x2a", "x", [42]),
        ("ros1", EMPTY, b"\x2a", "x", [42]),
        # Stamps of ROS 1 after 2038 are not negative, and durations are signed.
        ("ros1", "time t\nduration d", TIMES, "t.sec t.nanosec", [3_000_000_000, 4_000_000_000]),
        ("ros1", "time t\nduration d", TIMES, "d.sec d.nanosec", [-2, -5]),
        ("ros1", "bool[3] x", b"\0\1\x80", "x", [[False, True, True]]),
    ],
)
def test_bytes_mean_what_the_specifications_say(encoding, text, message, wanted, values):
    """The bytes are those of the specification, not of an encoder."""
    columns = decoder(text, wanted, encoding).columns(block_of([message]))
    assert [column.tolist() for column in columns] == [[value] for value in values]


def test_messages_of_all_plain_encapsulations_in_one_block_come_back_in_order():
    """Byte order and version are each message's own, and a short one is named by its place."""
    parts = {"small": Primitive("u1"), "stamp": Primitive("u8"), "name": String(),
             "flags": Sequence(Primitive("u2")), "many": Sequence(Primitive("f8")),
             "rate": Array(Primitive("f8"), 3)}  # fmt: skip
    mixed = Struct("pkg/msg/T", tuple(parts.items()))
    values = [
        {"small": k, "stamp": 1_000_000_007 * k, "name": "x" * (k % 5), "flags": [7] * (k % 3),
         "many": [0.5] * (k % 2), "rate": [float(k), -float(k), k + 0.25]}
        for k in range(40)
    ]  # fmt: skip
    forms = [("<", 8), (">", 8), ("<", 4), (">", 4)]
    messages = [
        Encoder("cdr", *forms[k * 7 % 4]).message(mixed, value) for k, value in enumerate(values)
    ]
    columns = BinaryDecoder(channel_of(mixed, "cdr"), ["stamp", "rate"], "log").columns
    stamp, rate = columns(block_of(messages))
    assert stamp.tolist() == [value["stamp"] for value in values]
    assert rate.tolist() == [value["rate"] for value in values]
    messages[5] = messages[5][:-1]
    with pytest.raises(MessageError) as caught:
        columns(block_of(messages))
    assert caught.value.positions == (5,)


@pytest.mark.parametrize(
    ("identifier", "form"),
    [(b"\0\3", "0x0003"), (b"\0\x09", "0x0009"), (b"\x12\x34", "0x1234")],
)
def test_encapsulations_with_tags_are_refused(identifier, form):
    """What is not decoded is never misread."""
    columns = decoder("uint32 a", "a").columns
    other, plain = identifier + b"\0\0\1\0\0\0", b"\0\1\0\0\1\0\0\0"
    reason = (
        f"^log: messages of topic '/topic' are encapsulated as {form}, which is not read; record "
        "with plain CDR$"
    )
    for messages in ([other], [other, other]):
        with pytest.raises(UnsupportedLogError, match=reason):
            columns(block_of(messages))
    for messages in ([plain, other, plain], [other, plain, other], [other, plain, b""]):
        with pytest.raises(MessageError, match=reason) as raised:
            columns(block_of(messages))
        assert raised.value.positions == tuple(k for k, one in enumerate(messages) if one == other)


def test_collections_of_strings_are_refused_in_XCDR2_only():
    """Writers disagree on whether XCDR2 says their size first."""
    root = Struct("pkg/msg/T", (("names", Sequence(String())), ("x", Primitive("f8"))))
    columns = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log").columns
    value = {"names": ["a", "bcd"], "x": 4.0}
    (x,) = columns(block_of([Encoder("cdr", ">", 8).message(root, value)]))
    assert x.tolist() == [4.0]
    with pytest.raises(SchemaError, match=r"^log: topic '/topic': a collection of strings or "):
        columns(block_of([Encoder("cdr", ">", 4).message(root, value)]))


@pytest.mark.parametrize("encoding", ["flatbuffer", "msgpack", ""])
def test_other_encodings_are_refused_with_the_topic(encoding):
    """The error says what is read instead."""
    with pytest.raises(
        UnsupportedLogError,
        match=f"^log: topic '/t' is encoded as '{encoding}'; this version reads 'cdr', 'ros1', ",
    ):
        decoder_of(Channel("/t", "pkg/msg/T", encoding), ["x"], "log")


def test_messages_of_which_nothing_is_known_are_refused():
    """No file with definitions could help where there is no type."""
    with pytest.raises(SchemaError) as caught:
        message_type(Channel("/t", "", "msgpack"), "log")
    assert str(caught.value) == (
        "log: topic '/t': the log does not say what its messages are, which are encoded as "
        "'msgpack'; export them as CSV with a program that knows it"
    )
