"""Columns of messages are what a decoder of single messages finds."""

import random
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
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop.containers.topic_table import as_rows
from quatprop.errors import MessageError
from quatprop.messages.binary import BinaryDecoder
from quatprop.messages.columns import take_messages
from quatprop.messages.schema import (
    Array,
    Primitive,
    Sequence,
    String,
    Struct,
    numeric_layout,
    steps,
)
from quatprop.messages.values import raw_messages

ENCODINGS = [("ros1", "<", 1), ("cdr", "<", 8), ("cdr", ">", 8)]

PRIMITIVES = st.sampled_from([Primitive(code) for code in NAMES])


@st.composite
def types(draw, depth=3):
    """Return a struct with numbers, strings, arrays, sequences and structs inside."""
    leaf = st.one_of(PRIMITIVES, st.just(String()))
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
    """Return a type, paths into it, an encoding, values and the gaps between messages."""
    root = draw(types().filter(lambda kind: paths(kind) and distinct(kind, {})))
    wanted = draw(st.lists(st.sampled_from(paths(root)), min_size=1, max_size=4))
    source = random.Random(draw(st.integers(0, 2**32)))
    values = [random_value(root, source) for _ in range(draw(st.integers(1, 6)))]
    if draw(st.booleans()):
        values = [values[0]] * len(values)
    gaps = draw(st.sampled_from([0, 3]))
    return root, wanted, values, lambda _k: source.randint(0, gaps)


@settings(max_examples=150)
@given(case=cases(), encoding=st.sampled_from(ENCODINGS))
def test_columns_equal_the_values_that_were_encoded(case, encoding):
    """Every wanted field of every message comes back, whatever varies before it."""
    root, wanted, values, gap = case
    messages = [Encoder(*encoding).message(root, value) for value in values]
    decoder = BinaryDecoder(channel_of(root, encoding[0]), wanted, "log")
    columns = decoder.columns(block_of(messages, gap))
    half = len(messages) // 2
    parts = decoder.columns(block_of(messages[:half]), block_of(messages[half:], gap))
    for whole, joined in zip(columns, parts, strict=True):
        np.testing.assert_array_equal(whole, joined)
    for path, column in zip(wanted, columns, strict=True):
        truth = np.array([look_up(value, path) for value in values], column.dtype)
        assert column.dtype.isnative
        np.testing.assert_array_equal(column, truth)


@settings(max_examples=80)
@given(case=cases(), encoding=st.sampled_from(ENCODINGS))
def test_columns_equal_what_the_library_decodes_from_each_message(case, encoding):
    """The definition and the bytes mean to the columns what they mean to rosbags."""
    root, wanted, values, gap = case
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition(root), root.name))
    read = store.deserialize_ros1 if encoding[0] == "ros1" else store.deserialize_cdr
    messages = [Encoder(*encoding).message(root, value) for value in values]
    columns = BinaryDecoder(channel_of(root, encoding[0]), wanted, "log").columns(
        block_of(messages, gap)
    )
    for position, message in enumerate(messages):
        decoded = read(message, root.name)
        for path, column in zip(wanted, columns, strict=True):
            there = decoded
            for step in steps(path):
                there = there[step] if isinstance(step, int) else getattr(there, step)
            np.testing.assert_array_equal(column[position], _flat(there))


def _flat(value):
    if is_dataclass(value):
        # The library's classes take their type name for a field.
        names = [own.name for own in fields(value) if not own.name.startswith("__")]
        value = [getattr(value, name) for name in names]
    if isinstance(value, list):
        return np.concatenate([np.atleast_1d(_flat(item)) for item in value])
    return np.asarray(value)


@settings(max_examples=80)
@given(case=cases(), encoding=st.sampled_from(ENCODINGS), data=st.data())
def test_a_message_cut_short_is_reported_or_not_needed(case, encoding, data):
    """A cut message never takes a byte of its neighbour."""
    root, wanted, values, _ = case
    messages = [Encoder(*encoding).message(root, value) for value in values]
    victim = data.draw(st.integers(0, len(messages) - 1))
    messages[victim] = messages[victim][: data.draw(st.integers(0, len(messages[victim])))]
    decoder = BinaryDecoder(channel_of(root, encoding[0]), wanted, "log")
    reported, columns = None, []
    try:
        columns = decoder.columns(block_of(messages))
    except MessageError as error:
        reported = error.positions
    assert reported in (None, (victim,))
    for path, column in zip(wanted, columns, strict=False):
        truth = np.array([look_up(value, path) for value in values], column.dtype)
        np.testing.assert_array_equal(column, truth)


def test_a_message_is_long_enough_exactly_from_the_end_of_the_wanted_field_on():
    """One byte less than the wanted number is an error, and the number itself is enough."""
    root = Struct("pkg/msg/T", (("name", String()), ("x", Primitive("f8")), ("y", Primitive("f8"))))
    whole = Encoder("cdr", "<", 8).message(root, {"name": "ab", "x": 1.5, "y": 2.5})
    decoder = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log")
    assert decoder.columns(block_of([whole[: 4 + 8 + 8], whole]))[0].tolist() == [1.5, 1.5]
    with pytest.raises(
        MessageError,
        match=r"^log: the message of topic '/topic' recorded at 1000 ns ends, after 19 bytes, "
        r"before the wanted field of 'pkg/msg/T'; the log is damaged or its definition is not that "
        r"of its messages$",
    ) as caught:
        decoder.columns(block_of([whole, whole[: 4 + 8 + 7], whole]))
    assert caught.value.positions == (1,)
    with pytest.raises(MessageError, match="recorded at 1000 ns and 1 others ends, after 19 bytes"):
        decoder.columns(block_of([whole]), block_of([whole, whole[: 4 + 8 + 7], whole[:9]]))


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
    decoder = BinaryDecoder(channel_of(root, encoding[0]), ["x"], "log")
    began = time.perf_counter()
    with pytest.raises(MessageError) as caught:
        decoder.columns(block_of([good, bad, good]))
    assert caught.value.positions == (1,)
    assert time.perf_counter() - began < 1.0


def test_empty_sequences_of_doubles_are_not_padded_and_others_are():
    """In CDR the padding before eight-byte elements is there only where an element is."""
    root = Struct("pkg/msg/T", (("many", Sequence(Primitive("f8"))), ("x", Primitive("i4"))))
    messages = [
        b"\0\1\0\0" + bytes([0, 0, 0, 0]) + bytes([7, 0, 0, 0]),
        b"\0\1\0\0" + bytes([1, 0, 0, 0]) + bytes(4) + bytes(8) + bytes([9, 0, 0, 0]),
    ]
    (x,) = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log").columns(block_of(messages))
    assert x.tolist() == [7, 9]


def test_structs_in_an_array_are_padded_by_where_each_begins():
    """The second element begins where the first ends, at another alignment than the first."""
    element = Struct(
        "pkg/msg/S", (("a", Primitive("u1")), ("b", Primitive("f8")), ("c", Primitive("u1")))
    )
    root = Struct("pkg/msg/T", (("s", Array(element, 3)), ("x", Primitive("u1"))))
    # The elements begin at 0, 17 and 33, with b at 8, 24 and 40, and the last ends at 49.
    message = b"\0\1\0\0" + bytes(49) + b"\x2a"
    (x,) = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log").columns(block_of([message]))
    assert x.tolist() == [42]


def test_a_block_without_messages_gives_empty_columns_of_the_right_kind():
    """Types and shapes do not depend on there being a message."""
    root = Struct("pkg/msg/T", (("x", Array(Primitive("f4"), 3)), ("y", Primitive("u2"))))
    columns = BinaryDecoder(channel_of(root, "cdr"), ["x", "y"], "log").columns(block_of([]))
    assert [(c.shape, c.dtype) for c in columns] == [((0, 3), np.float32), ((0,), np.uint16)]


@pytest.mark.parametrize("gap", [lambda _k: 0, lambda k: k % 3], ids=["even", "uneven"])
def test_columns_do_not_change_with_the_buffer(gap):
    """A reader may use its buffer again as soon as the columns are there."""
    root = Struct("pkg/msg/T", (("x", Primitive("f8")),))
    block = block_of([Encoder("cdr", "<", 8).message(root, {"x": float(k)}) for k in range(5)], gap)
    data = block.data.copy()
    (x,) = BinaryDecoder(channel_of(root, "cdr"), ["x"], "log").columns(replace(block, data=data))
    data[:] = 0
    assert x.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_the_reference_keeps_integers_of_64_bits():
    """It is what columns are held against, so it must not round."""
    value = {"f0": {"f0": [7_758_176_404_715_800_194, 15_308_084_094_301_570_617]}}
    assert look_up(value, "f0") == value["f0"]["f0"]


@pytest.mark.filterwarnings("error")
def test_nans_that_signal_become_rows_without_a_warning():
    """A damaged float32 may be a NaN of which NumPy warns when it becomes float64."""
    signalling = np.array([0x7F800001, 0x3F800000], np.uint32).view(np.float32)
    np.testing.assert_array_equal(as_rows([signalling])[:2], [np.nan, 1.0])
