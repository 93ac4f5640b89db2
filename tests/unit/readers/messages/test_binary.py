"""Columns of binary messages are what a decoder of single messages finds, in every encoding."""

import random
import struct
import time
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from make.messages_reference import (
    NAMES,
    Encoder,
    block_of,
    channel_of,
    definition,
    look_up,
    random_value,
)
from make.ros import ROS2, TF
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop.base.errors import MessageError, SchemaError, UnsupportedLogError
from quatprop.readers.containers.topic_table import as_rows
from quatprop.readers.containers.transforms import TransformDecoder
from quatprop.readers.messages.binary import BinaryDecoder, first_names
from quatprop.readers.messages.blocks import Channel, decoder_of
from quatprop.readers.messages.columns import raw_messages, take_messages
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.messages.schema import (
    Array,
    Primitive,
    Sequence,
    String,
    Struct,
    key_path_of,
    numeric_layout,
)

TF_TEXT, _ = ROS2.generate_msgdef(TF, ros_version=2)
ENCODINGS = [("ros1", "<", 1), ("cdr", "<", 8), ("cdr", ">", 8)]


@st.composite
def types(draw, depth=2):
    """Return a struct with numbers, strings, arrays, sequences and structs inside."""
    leaf = st.sampled_from([*map(Primitive, NAMES), String()])
    inner = st.one_of(leaf, types(depth - 1)) if depth else leaf
    kinds = st.one_of(
        leaf, inner, st.builds(Array, inner, st.integers(1, 4)), st.builds(Sequence, inner)
    )
    parts = draw(st.lists(kinds, min_size=1, max_size=5))
    number = draw(st.integers(0, 10**9))
    return Struct(f"pkg/msg/T{number}", tuple((f"f{k}", part) for k, part in enumerate(parts)))


def paths(kind, place=""):
    """Return every path to equal numbers outside sequences."""
    found = [place] if place and numeric_layout(kind) else []
    if isinstance(kind, Struct):
        for name, part in kind.fields:
            found += paths(part, f"{place}.{name}" if place else name)
    if isinstance(kind, Array):
        for index in range(kind.length):
            found += paths(kind.element, f"{place}[{index}]")
    return found


def distinct(kind, names):
    """Tell whether every type name in a message means one type."""
    if isinstance(kind, Struct):
        if names.setdefault(kind.name, kind) is not kind:
            return False
        return all(distinct(part, names) for _, part in kind.fields)
    return distinct(kind.element, names) if isinstance(kind, Array | Sequence) else True


@st.composite
def cases(draw):
    """Return a type, paths into it, an encoding, values, and gaps between their messages."""
    root = draw(types().filter(lambda kind: paths(kind) and distinct(kind, {})))
    wanted = draw(st.lists(st.sampled_from(paths(root)), min_size=1, max_size=4))
    source = random.Random(draw(st.integers(0, 2**32)))
    values = [random_value(root, source) for _ in range(draw(st.integers(1, 6)))]
    if draw(st.booleans()):
        values = [values[0]] * len(values)
    gaps = draw(st.sampled_from([0, 3]))
    return root, wanted, draw(st.sampled_from(ENCODINGS)), values, lambda _: source.randint(0, gaps)


def decoder(kind, wanted, encoding="cdr"):
    """Return what decodes fields of the messages of a type, or of a definition."""
    return BinaryDecoder(channel_of(kind, encoding), wanted.split(), "log")


@settings(max_examples=40)
@given(cases())
def test_columns_are_the_values_that_were_encoded_and_what_rosbags_decodes(case):
    """Every wanted field of every message comes back, whatever varies before it."""
    root, wanted, encoding, values, gap = case
    messages = [Encoder(*encoding).message(root, value) for value in values]
    columns = decoder(root, " ".join(wanted), encoding[0]).columns(block_of(messages, gap))
    half = len(messages) // 2
    blocks = block_of(messages[:half]), block_of(messages[half:], gap)
    parts = decoder(root, " ".join(wanted), encoding[0]).columns(*blocks)
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(root), root.name))
    read = store.deserialize_ros1 if encoding[0] == "ros1" else store.deserialize_cdr
    decoded = [read(message, root.name) for message in messages]
    for path, column, joined in zip(wanted, columns, parts, strict=True):
        assert column.dtype.isnative
        truth = np.array([look_up(value, path) for value in values], column.dtype)
        np.testing.assert_array_equal(column, truth)
        np.testing.assert_array_equal(joined, truth)
        for row, message in zip(column, decoded, strict=True):
            np.testing.assert_array_equal(row, _flat(_found(message, path)))


def _found(value, path):
    for key in key_path_of(path):
        value = value[key] if isinstance(key, int) else getattr(value, key)
    return value


def _flat(value):
    if is_dataclass(value):
        # The library's classes take their type name for a field.
        names = [own.name for own in fields(value) if not own.name.startswith("__")]
        value = [getattr(value, name) for name in names]
    if isinstance(value, list):
        return np.concatenate([np.atleast_1d(_flat(item)) for item in value])
    return np.asarray(value)


@settings(max_examples=40)
@given(case=cases(), data=st.data())
def test_a_message_cut_short_is_reported_or_not_needed(case, data):
    """A cut message never takes a byte of its neighbour."""
    root, wanted, encoding, values, _ = case
    messages = [Encoder(*encoding).message(root, value) for value in values]
    victim = data.draw(st.integers(0, len(messages) - 1))
    messages[victim] = messages[victim][: data.draw(st.integers(0, len(messages[victim])))]
    columns = []
    try:
        columns = decoder(root, " ".join(wanted), encoding[0]).columns(block_of(messages))
    except MessageError as error:
        assert error.positions == (victim,)  # noqa: PT017
    for path, column in zip(wanted, columns, strict=False):
        truth = np.array([look_up(value, path) for value in values], column.dtype)
        np.testing.assert_array_equal(column, truth)


def test_a_message_is_long_enough_exactly_from_the_end_of_the_wanted_field_on():
    """One byte less than the wanted number is an error, and the number itself is enough."""
    root = Struct("pkg/msg/T", (("name", String()), ("x", Primitive("f8")), ("y", Primitive("f8"))))
    whole = Encoder("cdr", "<", 8).message(root, {"name": "ab", "x": 1.5, "y": 2.5})
    columns = decoder(root, "x").columns
    assert columns(block_of([whole[: 4 + 8 + 8], whole]))[0].tolist() == [1.5, 1.5]
    with pytest.raises(
        MessageError,
        match=r"^log: the message of topic '/topic' recorded at 1000 ns ends, after 19 bytes, "
        r"before the wanted field of 'pkg/msg/T'; the log is damaged or its definition does not "
        r"match its messages$",
    ) as caught:
        columns(block_of([whole, whole[: 4 + 8 + 7], whole]))
    assert caught.value.positions == (1,)
    with pytest.raises(MessageError, match="recorded at 1000 ns and 1 others ends, after 19 bytes"):
        columns(block_of([whole]), block_of([whole, whole[: 4 + 8 + 7], whole[:9]]))


def test_messages_are_taken_from_several_blocks_by_their_positions():
    """Positions go on from one block to the next; a block without any is left out."""
    blocks = [block_of([b"a", b"bc"]), block_of([]), block_of([b"d"]), block_of([b"e", b"f"])]
    taken = take_messages(blocks, np.array([1, 3, 4]))
    assert [*raw_messages(*taken)] == [b"bc", b"e", b"f"]
    assert [len(block) for block in taken] == [1, 2]


@pytest.mark.parametrize(
    "element",
    [Primitive("u1"), Primitive("f8"), String(), Struct("pkg/msg/S", (("t", String()),))],
    ids=["bytes", "doubles", "strings", "structs"],
)
@pytest.mark.parametrize("encoding", ENCODINGS, ids=["ros1", "little", "big"])
def test_a_count_of_four_billion_is_reported_at_once(element, encoding):
    """A length that lies neither overflows nor reads on, and costs no time."""
    root = Struct("pkg/msg/T", (("many", Sequence(element)), ("x", Primitive("f8"))))
    good = Encoder(*encoding).message(root, {"many": [], "x": 1.0})
    header = 0 if encoding[0] == "ros1" else 4
    bad = good[:header] + b"\xff\xff\xff\xff" + good[header + 4 :]
    began = time.process_time()
    with pytest.raises(MessageError) as caught:
        decoder(root, "x", encoding[0]).columns(block_of([good, bad, good]))
    assert caught.value.positions == (1,)
    assert time.process_time() - began < 1.0


def test_a_block_without_messages_gives_empty_columns_of_the_right_kind():
    """Types and shapes do not depend on there being a message."""
    root = Struct("pkg/msg/T", (("x", Array(Primitive("f4"), 3)), ("y", Primitive("u2"))))
    columns = decoder(root, "x y").columns(block_of([]))
    assert [(c.shape, c.dtype) for c in columns] == [((0, 3), np.float32), ((0,), np.uint16)]


@pytest.mark.parametrize("gap", [lambda _: 0, lambda k: k % 3], ids=["even", "uneven"])
def test_columns_do_not_change_with_the_buffer(gap):
    """A reader may use its buffer again as soon as the columns are there."""
    root = Struct("pkg/msg/T", (("x", Primitive("f8")),))
    block = block_of([Encoder("cdr", "<", 8).message(root, {"x": float(k)}) for k in range(5)], gap)
    data = block.data.copy()
    (x,) = decoder(root, "x").columns(replace(block, data=data))
    data[:] = 0
    assert x.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_nans_that_signal_become_rows_without_a_warning():
    """A damaged float32 may be a NaN of which NumPy warns when it becomes float64."""
    signalling = np.array([0x7F800001, 0x3F800000], np.uint32).view(np.float32)
    np.testing.assert_array_equal(as_rows([signalling])[:2], [np.nan, 1.0])


EMPTY = "std_msgs/Empty nothing\nuint8 x\n" + "=" * 80 + "\nMSG: std_msgs/Empty\n"
NOTHING = "S[2] s\nuint8 x\n" + "=" * 80 + "\nMSG: pkg/S\nuint8 a\nfloat64[0] b\nuint8 c\n"
PADDED = "S[3] s\nuint8 x\n" + "=" * 80 + "\nMSG: pkg/S\nuint8 a\nfloat64 b\nuint8 c\n"
TIMES = struct.pack("<IIii", 3_000_000_000, 4_000_000_000, -2, -5)


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
        # An array of no elements takes no bytes, not even padding before it.
        ("cdr", NOTHING, b"\0\1\0\0" + b"\1\2\3\4\x2a", "x", [42]),
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
    columns = decoder(mixed, "stamp rate").columns
    stamp, rate = columns(block_of(messages))
    assert stamp.tolist() == [value["stamp"] for value in values]
    assert rate.tolist() == [value["rate"] for value in values]
    messages[5] = messages[5][:-1]
    with pytest.raises(MessageError) as caught:
        columns(block_of(messages))
    assert caught.value.positions == (5,)


@pytest.mark.parametrize(
    ("identifier", "form"), [(b"\0\3", "0x0003"), (b"\0\x09", "0x0009"), (b"\x12\x34", "0x1234")]
)
def test_encapsulations_with_tags_are_refused(identifier, form):
    """An unsupported encoding is never misread."""
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
    columns = decoder(root, "x").columns
    value = {"names": ["a", "bcd"], "x": 4.0}
    (x,) = columns(block_of([Encoder("cdr", ">", 8).message(root, value)]))
    assert x.tolist() == [4.0]
    reason = (
        r"^log: topic '/topic': a collection of strings or structs lies before or in the wanted "
        r"field, which writers of XCDR2 encode in different ways$"
    )
    with pytest.raises(SchemaError, match=reason):
        columns(block_of([Encoder("cdr", ">", 4).message(root, value)]))
    with pytest.raises(SchemaError, match=reason):
        decoder(PADDED.replace("uint8 a\n", "").replace("uint8 c\n", ""), "s").columns(
            block_of([b"\0\7\0\0" + bytes(32)])
        )


TRANSFORMS = Channel("/tf", "tf2_msgs/msg/TFMessage", "cdr", "ros2msg", TF_TEXT.encode())


@pytest.mark.parametrize(
    ("bad", "error", "reason"),
    [
        (b"\0", MessageError, "recorded at 1000 ns ends before its list of transforms; the log"),
        (b"\0\1\0\0\1\0\0\0", MessageError, "recorded at 1000 ns ends before its list of"),
        (b"\0\7\0\0\0\0\0\0", UnsupportedLogError, "0x0007, in which lists of transforms are not"),
    ],
)
def test_lists_of_transforms_that_cannot_be_read(bad, error, reason):
    """One that is too short is named by its place, and other encapsulations are refused."""
    transforms = TransformDecoder(TRANSFORMS, "log")
    with pytest.raises(error, match=reason) as caught:
        transforms.transforms(block_of([b"\0\1\0\0\0\0\0\0", bad]))
    if error is MessageError:
        assert caught.value.positions == (1,)


@pytest.mark.parametrize(
    ("text", "messages", "texts"),
    [
        ("uint8 a\nstring frame", [b"\0\1\0\0\1\0\0\0\3\0\0\0ab\0", b"\0"], []),
        ("uint8 a\nstring frame", 2 * [b"\0\1\0\0\1\0\0\0\3\0\0\0ab\0"], ["ab"]),
        ("uint8[] a\nstring frame", [b"\0\1\0\0\0\0\0\0\3\0\0\0ab\0"], []),
        (f"A[1] frame\n{'=' * 80}\nMSG: pkg/A\nstring a", [b"\0\1\0\0\3\0\0\0ab\0"], []),
        (f"A frame\n{'=' * 80}\nMSG: pkg/A\nstring a", [b"\0\1\0\0\3\0\0\0ab\0"], ["ab"]),
    ],
)
def test_texts_in_or_behind_lists_or_of_damaged_messages_are_not_found(text, messages, texts):
    """Frames are told by the first messages, if all are intact."""
    channel = channel_of(text, "cdr")
    root = message_type(channel, "log")
    place = "frame[0].a" if "[1]" in text else "frame.a" if "MSG" in text else "frame"
    assert first_names(channel, block_of(messages), root, place, "log") == texts


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
