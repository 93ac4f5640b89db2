"""Encapsulations, byte orders and the definitions behind them."""

import struct

import numpy as np
import pytest
from make.messages_reference import Encoder, block_of, channel_of

from quatprop.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.messages.binary import BinaryDecoder
from quatprop.messages.blocks import Channel
from quatprop.messages.decoders import decoder_of
from quatprop.messages.definitions import message_type
from quatprop.messages.schema import Array, Primitive, Sequence, String, Struct

MIXED = Struct(
    "pkg/msg/T",
    (
        ("small", Primitive("u1")),
        ("stamp", Primitive("u8")),
        ("name", String()),
        ("flags", Sequence(Primitive("u2"))),
        ("many", Sequence(Primitive("f8"))),
        ("rate", Array(Primitive("f8"), 3)),
    ),
)


def value_of(k):
    """Return a value whose parts vary in length with `k`."""
    return {
        "small": k,
        "stamp": 1_000_000_007 * k,
        "name": "x" * (k % 5),
        "flags": [7] * (k % 3),
        "many": [0.5] * (k % 2),
        "rate": [float(k), -float(k), k + 0.25],
    }


def test_messages_of_all_plain_encapsulations_in_one_block_come_back_in_order():
    """Byte order and XCDR version are each message's own affair."""
    forms = [("<", 8), (">", 8), ("<", 4), (">", 4)]
    values = [value_of(k) for k in range(40)]
    messages = [
        Encoder("cdr", *forms[k * 7 % 4]).message(MIXED, value) for k, value in enumerate(values)
    ]
    stamp, rate = BinaryDecoder(channel_of(MIXED, "cdr"), ["stamp", "rate"], "log").columns(
        block_of(messages)
    )
    assert stamp.tolist() == [value["stamp"] for value in values]
    assert rate.tolist() == [value["rate"] for value in values]


def test_a_short_message_among_several_encapsulations_is_named_by_its_place_in_the_block():
    """Sorting messages by encapsulation does not lose count of them."""
    messages = [
        Encoder("cdr", "<>"[k % 2], 8).message(MIXED, value_of(k))[: -1 if k == 5 else None]
        for k in range(8)
    ]
    with pytest.raises(MessageError) as caught:
        BinaryDecoder(channel_of(MIXED, "cdr"), ["rate"], "log").columns(block_of(messages))
    assert caught.value.positions == (5,)


def test_eight_byte_numbers_align_to_four_in_XCDR2():
    """The bytes are those of the specification: no padding before a double at offset 4."""
    root = Struct("pkg/msg/T", (("a", Primitive("u4")), ("b", Primitive("f8"))))
    message = b"\0\7\0\0" + struct.pack("<Id", 1, 2.5)
    (b,) = BinaryDecoder(channel_of(root, "cdr"), ["b"], "log").columns(block_of([message]))
    assert b.tolist() == [2.5]


@pytest.mark.parametrize("identifier", [b"\0\x10", b"\0\x11"], ids=["big", "little"])
def test_identifiers_of_earlier_drafts_are_XCDR2_too(identifier):
    """Some writers follow RTPS 2.3, which numbers XCDR2 otherwise."""
    root = Struct("pkg/msg/T", (("a", Primitive("u4")), ("b", Primitive("f8"))))
    order = "><"[identifier[1] & 1]
    message = identifier + b"\0\0" + struct.pack(order + "Id", 1, 2.5)
    (b,) = BinaryDecoder(channel_of(root, "cdr"), ["b"], "log").columns(block_of([message]))
    assert b.tolist() == [2.5]


@pytest.mark.parametrize(
    ("identifier", "form"),
    [(b"\0\3", "0x0003"), (b"\0\x09", "0x0009"), (b"\x12\x34", "0x1234")],
)
def test_encapsulations_with_tags_are_refused(identifier, form):
    """What is not decoded is never misread."""
    root = Struct("pkg/msg/T", (("a", Primitive("u4")),))
    decoder = BinaryDecoder(channel_of(root, "cdr"), ["a"], "log")
    other, plain = identifier + b"\0\0\1\0\0\0", b"\0\1\0\0\1\0\0\0"
    reason = (
        f"^log: messages of topic '/topic' are encapsulated as {form}, which is not read; record "
        "with plain CDR$"
    )
    for messages in ([other], [other, other]):
        with pytest.raises(UnsupportedLogError, match=reason):
            decoder.columns(block_of(messages))
    for messages in ([plain, other, plain], [other, plain, other], [other, plain, b""]):
        with pytest.raises(MessageError, match=reason) as raised:
            decoder.columns(block_of(messages))
        assert raised.value.positions == tuple(k for k, one in enumerate(messages) if one == other)


def test_collections_of_strings_are_refused_in_XCDR2_only():
    """Writers disagree on whether XCDR2 says their size first."""
    root = Struct("pkg/msg/T", (("names", Sequence(String())), ("x", Primitive("f8"))))
    decoder = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log")
    value = {"names": ["a", "bcd"], "x": 4.0}
    (x,) = decoder.columns(block_of([Encoder("cdr", ">", 8).message(root, value)]))
    assert x.tolist() == [4.0]
    with pytest.raises(SchemaError, match=r"^log: topic '/topic': a collection of strings or "):
        decoder.columns(block_of([Encoder("cdr", ">", 4).message(root, value)]))


def test_ROS1_times_are_unsigned_and_durations_signed():
    """A ROS 1 stamp after 2038 is not negative."""
    channel = Channel("/t", "pkg/msg/T", "ros1", "ros1msg", b"time t\nduration d\n")
    message = struct.pack("<IIii", 3_000_000_000, 4_000_000_000, -2, -5)
    paths = ["t.sec", "t.nanosec", "d.sec", "d.nanosec"]
    columns = BinaryDecoder(channel, paths, "log").columns(block_of([message]))
    assert [int(column[0]) for column in columns] == [3_000_000_000, 4_000_000_000, -2, -5]


@pytest.mark.parametrize(("encoding", "size"), [("ros1", 0), ("cdr", 1)])
def test_an_empty_message_takes_a_byte_in_CDR_and_none_in_ROS1(encoding, size):
    """The placeholder of an empty struct is on the wire in one encoding only."""
    schema = b"std_msgs/Empty nothing\nuint8 x\n" + b"=" * 80 + b"\nMSG: std_msgs/Empty\n"
    grammar = {"ros1": "ros1msg", "cdr": "ros2msg"}[encoding]
    channel = Channel("/t", "pkg/msg/T", encoding, grammar, schema)
    header = b"" if encoding == "ros1" else b"\0\1\0\0"
    message = header + bytes(size) + b"\x2a"
    (x,) = BinaryDecoder(channel, ["x"], "log").columns(block_of([message]))
    assert x.tolist() == [42]


def test_bytes_other_than_one_are_true():
    """A bool is whether its byte is not zero."""
    root = Struct("pkg/msg/T", (("x", Array(Primitive("b1"), 3)),))
    (x,) = BinaryDecoder(channel_of(root, "ros1"), ["x"], "log").columns(block_of([b"\0\1\x80"]))
    assert x.dtype == np.bool_
    assert x.tolist() == [[False, True, True]]


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
