"""Protobuf messages: fields by the descriptors that the log carries."""

import sys

import numpy as np
import pytest
from make.mcap import Topic, write_topics
from make.messages_reference import block_of
from make.protobuf import (
    DOUBLE,
    FIELD,
    FLOAT,
    FOXGLOVE,
    STRING,
    UINT64,
    described,
    file_of,
    made,
    stamp_file,
)
from make.reading import found_in, rates

from quatprop.base.errors import MessageError, SchemaError
from quatprop.readers.messages.blocks import Channel
from quatprop.readers.messages.columns import ValueDecoder
from quatprop.readers.messages.protobuf import ProtobufDecoder
from quatprop.readers.row_stamps import place_of, stamps_of

OWN = file_of(
    "own",
    {
        "Node": {"next": ".own.Node", "others*": ".own.Node", "value": DOUBLE},
        "Gyro": {"us": UINT64, "rate": ".own.Rate", "tree": ".own.Node", "many*": FLOAT},
        "Rate": dict.fromkeys("abc", FLOAT),
    },
)


EVERY = file_of(
    "every",
    {
        "Part": dict.fromkeys("de", DOUBLE),
        "All": {
            "d": DOUBLE, "f": FLOAT, "i64": 3, "u64": UINT64, "i32": 5, "x64": 6, "x32": 7,
            "flag": 8, "text": STRING, "data": 12, "u32": 13, "sx32": 15, "sx64": 16, "s32": 17,
            "s64": 18, "part": ".every.Part", "parts*": ".every.Part", "many*": DOUBLE,
            "packed*": UINT64,
        },
    },
)  # fmt: skip
NUMBERS = [
    *("d", "f", "i64", "u64", "i32", "x64", "x32"),
    *("flag", "u32", "sx32", "sx64", "s32", "s64"),
]


def a_message(rng, made_class):
    """Return a message of the kinds of fields there are, of which some are not set."""
    bits = int(rng.integers(1, 63))
    big = int(rng.integers(0, 1 << bits))
    message = made_class(
        d=rng.choice([0.0, -0.0, np.nan, rng.normal()]), f=rng.normal(), i64=-big, u64=2 * big,
        i32=big % (1 << 31) - (1 << 30), x64=big, x32=big % (1 << 32), flag=bool(big % 2),
        text=rng.choice(["", "a", "b", "é"]), data=rng.bytes(3), u32=big % (1 << 32),
        sx32=-(big % (1 << 31)), sx64=-big, s32=big % 99 - 50, s64=-big,
        parts=[{"d": 1.5}], many=rng.normal(size=2), packed=[big],
    )  # fmt: skip
    if big % 3:
        message.part.d = rng.normal()
    for name in rng.choice(NUMBERS[:13], rng.integers(0, 3)):
        message.ClearField(name)
    return message.SerializeToString()


def write(path, type_name, schema, messages):
    """Write an MCAP file."""
    data = [m if isinstance(m, bytes) else m.SerializeToString() for m in messages]
    return write_topics(path, {"/t": Topic(type_name, data, schema, "protobuf", "protobuf")})


def channel_of(schema, type_name="foxglove.Odometry"):
    """Return a channel of protobuf messages."""
    return Channel("/t", type_name, "protobuf", "protobuf", schema)


def test_an_odometry_of_foxglove_is_a_rate_that_was_estimated(tmp_path):
    """The velocity is optional: what is not set is not finite. A message that is none is lost."""
    files = (FOXGLOVE, stamp_file())
    odometry = made("foxglove.Odometry", *files)
    messages = [odometry(frame_id="a" * position) for position in range(3)]
    for position, message in enumerate(messages):
        message.timestamp.seconds, message.timestamp.nanos = 1_700_000_000, position + 1
    messages[0].angular_velocity.x, messages[0].angular_velocity.z = 0.1, -3
    messages[2].angular_velocity.SetInParent()
    messages += [b"\xff\xff", odometry()]
    path = write(tmp_path / "log.mcap", "foxglove.Odometry", described(*files), messages)
    source, series, (loss,) = rates(path)
    assert (source.field, source.clock) == ("angular_velocity", "header")
    assert series.t_ns.tolist() == [1_700_000_000_000_000_000 + k for k in (1, 2, 3)]
    np.testing.assert_array_equal(series.rate, [[0.1, 0, -3], [np.nan] * 3, [0, 0, 0]])
    assert loss.messages == 2
    assert "recorded at 3000 ns and 1 others cannot be decoded as protobuf" in loss.reason


def test_any_field_can_be_named(tmp_path):
    """Types that contain themselves do no harm."""
    gyro = made("own.Gyro", OWN)
    messages = [gyro(us=k, rate={"a": k, "b": 0.5, "c": 0.25}, many=[1]) for k in (5, 6)]
    path = write(tmp_path / "log.mcap", "own.Gyro", described(OWN), messages)
    options = {"time_field": "us", "time_unit": "us", "rate_unit": "rad/s"}
    for name in ("rate", "rate.a,rate.b,rate.c"):
        _, series, _ = rates(path, rate_field=name, **options)
        assert series.t_ns.tolist() == [5000, 6000]
        assert series.rate.tolist() == [[5, 0.5, 0.25], [6, 0.5, 0.25]]
    with pytest.raises(SchemaError, match=r"'many' of 'own\.Gyro' cannot be used: it is a list"):
        rates(path, rate_field="many", **options)


def test_descriptors_that_lack_an_import_are_refused():
    """The sentence says what was left out."""
    lacking = file_of("foxglove", {"Odometry": {"pose": ".other.Pose"}}, ["other.proto"])
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': the file descriptors that the log carries cannot be read, or do "
        r"not define 'foxglove.Odometry'; record it with all files that it imports$",
    ):
        found_in(channel_of(described(lacking)))


def test_the_time_stamp_of_protobuf_itself_may_be_left_out():
    """As protoc does without --include_imports; every program that reads protobuf knows it."""
    (whole,) = found_in(channel_of(described(FOXGLOVE, stamp_file())))
    assert [place_of(whole.table, stamp) for stamp in stamps_of(whole)] == ["timestamp"]
    (found,) = found_in(channel_of(described(FOXGLOVE)))
    assert found[1:] == whole[1:]


def test_without_the_library_the_extra_is_named(monkeypatch):
    """Other topics can still be read."""
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': 'foxglove.Odometry' is encoded as protobuf, which needs the "
        r"package protobuf; pip install protobuf, or choose another topic$",
    ):
        found_in(channel_of(b"none"))
    assert found_in(channel_of(b"Odometry", "foxglove.Grid")) == []


def decoder(type_name, file, fields):
    """Return a decoder of fields."""
    return ProtobufDecoder(channel_of(described(file), type_name), fields, "log")


def test_messages_of_one_layout_have_the_values_that_the_library_gives():
    """Whatever is set, and of whatever length: the bits are the same."""
    rng = np.random.default_rng(3)
    kinds = [a_message(rng, made("every.All", EVERY)) for _ in range(40)]
    block = block_of([kinds[k] for k in rng.integers(0, 40, 2000)])
    at_once = decoder("every.All", EVERY, [*NUMBERS, "part", "part.d"])
    for ours, theirs in zip(
        at_once.columns(block), ValueDecoder.columns(at_once, block), strict=True
    ):
        assert ours.dtype == theirs.dtype
        assert ours.tobytes() == theirs.tobytes()


def varied(rng, made_class):
    """Return a message whose numbers vary while its layout stays."""
    return made_class(
        d=rng.normal(), f=rng.normal(), i64=-rng.integers(1, 9), u64=rng.integers(128, 9999),
        i32=-rng.integers(1, 9), x64=rng.integers(1, 99), flag=True, text="a", data=rng.bytes(3),
        s32=rng.integers(-60, -1), s64=rng.integers(64, 8000), part={"d": rng.normal()},
        many=rng.normal(size=2),
    ).SerializeToString()  # fmt: skip


def test_the_library_reads_one_message_of_a_layout(monkeypatch):
    """It took 6 us of Python to take the values of each message out of it."""
    rng = np.random.default_rng(3)
    block = block_of([varied(rng, made("every.All", EVERY)) for _ in range(200)])
    at_once = decoder("every.All", EVERY, [*NUMBERS, "part"])
    theirs = ValueDecoder.columns(at_once, block)
    parsed, parse = [], at_once._parsed  # noqa: SLF001  # what is counted
    monkeypatch.setattr(at_once, "_parsed", lambda raw: parsed.append(raw) or parse(raw))
    ours = at_once.columns(block)
    assert len(parsed) < 10
    assert [one.tobytes() for one in ours] == [one.tobytes() for one in theirs]


def test_what_the_library_refuses_is_no_message_of_a_layout():
    """Texts that are not UTF-8, and lengths and ends that do not fit, among good messages."""
    good = made("every.All", EVERY)(d=1, text="abc", u64=300).SerializeToString()
    bad = [
        good.replace(b"abc", b"ab\xff"),
        good.replace(b"\x03abc", b"\x0aabc"),
        good[:-1] + b"\x80",
    ]
    messages = [good] * 50
    for place, raw in zip((0, 20, 40), bad, strict=True):
        messages[place] = raw
    with pytest.raises(MessageError, match="recorded at 0 ns and 2 others cannot") as caught:
        decoder("every.All", EVERY, ["d", "u64"]).columns(block_of(messages))
    assert caught.value.positions == (0, 20, 40)


def test_of_two_values_that_exclude_each_other_the_last_one_counts():
    """So of a field that comes twice: the messages are left to the library."""
    file = file_of("one", {"Of": {"a": DOUBLE, "b": DOUBLE}})
    file.message_type[0].oneof_decl.add(name="either")
    for field in file.message_type[0].field:
        field.oneof_index = 0
    a, b = (made("one.Of", file)(**{name: 2.5}).SerializeToString() for name in "ab")
    for messages, expected in ((a + b, [0, 2.5]), (b + a, [2.5, 0]), (a + a, [2.5, 0])):
        columns = decoder("one.Of", file, ["a", "b"]).columns(block_of([messages] * 20))
        assert [column.tolist() for column in columns] == [[value] * 20 for value in expected]


def test_fields_that_the_descriptor_does_not_know_are_passed_over():
    """Programs write fields that were added later, in messages of one layout or of several."""
    ours, theirs = (file_of("one", {"Of": dict.fromkeys(names, DOUBLE)}) for names in ("a", "ab"))
    messages = [made("one.Of", theirs)(a=k, b=-k).SerializeToString() for k in range(1, 41)]
    (column,) = decoder("one.Of", ours, ["a"]).columns(block_of(messages))
    assert column.tolist() == list(range(1, 41))


def test_an_enumeration_is_a_number():
    """It stands between other fields, and may be the column that tells messages apart."""
    file = file_of("kind", {"Of": {"a": DOUBLE}})
    states = file.enum_type.add(name="State")
    for number, name in enumerate(("OFF", "ON")):
        states.value.add(name=name, number=number)
    label, kind = FIELD.LABEL_OPTIONAL, FIELD.TYPE_ENUM
    file.message_type[0].field.add(
        name="state", number=2, label=label, type=kind, type_name=".kind.State"
    )
    messages = [made("kind.Of", file)(a=k, state=k % 2).SerializeToString() for k in range(4)]
    columns = decoder("kind.Of", file, ["a", "state"]).columns(block_of(messages))
    assert [column.tolist() for column in columns] == [[0, 1, 2, 3], [0, 1, 0, 1]]
