"""Definitions as logs carry them, and paths into them."""

import re

import pytest
from make.mcap import Topic, write_topics
from make.reading import rates
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from quatprop.base.errors import SchemaError
from quatprop.readers.containers.transforms import TransformDecoder
from quatprop.readers.messages.binary import BinaryDecoder
from quatprop.readers.messages.blocks import Channel
from quatprop.readers.messages.definitions import definition_of, message_type
from quatprop.readers.messages.schema import (
    Array,
    Primitive,
    Sequence,
    String,
    Struct,
    Unknown,
    find,
    flattened,
    key_path_of,
    numeric_layout,
)

RULE = "=" * 80
IMU = Channel("/imu", "sensor_msgs/msg/Imu", "cdr")


def defined(text, encoding="cdr", grammar="ros2msg", name="pkg/msg/T"):
    """Return a channel with a definition."""
    data = text if isinstance(text, bytes) else text.encode()
    return Channel("/t", name, encoding, grammar, data)


def parsed(*definition):
    """Return the type that a definition defines, as nested tuples."""
    return spelled(message_type(defined(*definition), "log"))


def spelled(kind):
    """Return a type as nested tuples."""
    if isinstance(kind, Struct):
        return tuple((name, spelled(part)) for name, part in kind.fields)
    if isinstance(kind, Array):
        return [spelled(kind.element), kind.length]
    if isinstance(kind, Sequence):
        return [spelled(kind.element)]
    if isinstance(kind, Primitive):
        return kind.code
    return "wide" if isinstance(kind, String) and kind.wide else "text"


def test_every_form_of_a_field_is_read():
    """Scalars, bounds, arrays, sequences, defaults, constants and comments."""
    assert parsed(
        "# a comment\n"
        "bool a\nbyte b\nchar c\nint8 d 5\nfloat32[3] e  # three\nuint16[] f\nint64[<=4] g\n"
        "string h\nstring<=9 i\nstring<=9[<=2] j\nuint8 CONSTANT=3\nint32 lower_case = 4\n"
        "string WORDS= has = and # in it\nfloat64 z 1.5\n"
    ) == (
        ("a", "b1"), ("b", "u1"), ("c", "u1"), ("d", "i1"), ("e", ["f4", 3]), ("f", ["u2"]),
        ("g", ["i8"]), ("h", "text"), ("i", "text"), ("j", ["text"]), ("z", "f8"),
    )  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        f"Part p\n{RULE}\nMSG: pkg/Part\nfloat64 x\n",
        f"pkg/Part p\n{RULE}\nMSG: pkg/msg/Part\nfloat64 x\n",
        f"Part p\r\n\r\n{RULE}\r\nMSG: pkg/Part\r\nfloat64 x\r\n",
        f"\n\nPart p  \n{RULE}  \nMSG: pkg/Part  \nfloat64 x \t\n\n\n",
        f"Part p\n{'=' * 40}\nMSG: pkg/Part\nfloat64 x",
        f"# caf\xe9\nPart p\n{RULE}\nMSG: pkg/Part\n# {RULE}\nfloat64 x\n",
        f"# \xb0/s\nPart p # \xb0\n{RULE}\nMSG: pkg/Part\nfloat64 x\n".encode("latin-1"),
        f"\ufeffPart p\n{RULE}\nMSG: pkg/Part\nfloat64 x\n\0",
    ],
    ids=["bare", "qualified", "CRLF", "blanks", "short rule", "comments", "Latin-1", "mark, NUL"],
)
def test_definitions_are_read_however_they_are_laid_out(text):
    """Line ends, blanks, rules of other lengths and bytes that are not UTF-8 do not matter."""
    assert parsed(text) == (("p", (("x", "f8"),)),)


@pytest.mark.parametrize("head", ["", f"{RULE}\nIDL: pkg/msg/T\n"], ids=["plain", "headed"])
def test_IDL_is_read(head):
    """Modules, fixed arrays by typedef, sequences and strings, alone or in a headed list."""
    assert parsed(
        head + "module pkg { module msg {\n typedef double double__3[3];\n struct T {\n"
        '  @verbatim (language="comment", text="=") uint8 a;\n  string b;\n  wstring c;\n'
        "  sequence<int16> d;\n  pkg::msg::double__3 e;\n }; }; };\n",
        "cdr",
        "ros2idl",
    ) == (("a", "u1"), ("b", "text"), ("c", "wide"), ("d", ["i2"]), ("e", ["f8", 3]))


def test_standard_types_complete_a_definition_and_do_not_replace_it():
    """A header need not be defined with every message; a type may have changed since."""
    stamps = [("stamp", (("sec", sec), ("nanosec", "u4"))) for sec in ("u4", "i4")]
    frame = ("frame_id", "text")
    ros1 = parsed("Header header\n", "ros1", "ros1msg")
    assert ros1 == (("header", (("seq", "u4"), stamps[0], frame)),)
    assert parsed("std_msgs/Header header\n") == (("header", (stamps[1], frame)),)
    assert parsed("float32 only\n", "cdr", "ros2msg", IMU.type_name) == (("only", "f4"),)


@pytest.mark.parametrize(
    ("encoding", "store"), [("cdr", Stores.LATEST), ("ros1", Stores.ROS1_NOETIC)]
)
def test_every_standard_type_has_the_fields_that_its_generated_definition_has(encoding, store):
    """Going through the text of a definition changes nothing."""
    typestore = get_typestore(store)
    version = 1 if encoding == "ros1" else 2
    for name in typestore.fielddefs:
        text, _ = typestore.generate_msgdef(name, ros_version=version)
        bare = message_type(Channel("/t", name, encoding), "log")
        assert parsed(text, encoding, f"ros{version}msg", name) == spelled(bare), name


@pytest.mark.parametrize(("name", "field"), [("other/msg/Mystery", "m"), ("wstring", "w")])
def test_a_field_that_is_not_understood_is_an_error_only_in_the_way(name, field):
    """Fields after the wanted one need not be known; wide strings have several forms."""
    channel = defined(f"float64 x\n{name.replace('/msg', '')} {field}\nfloat64 y\n")
    assert isinstance(find(message_type(channel, "log"), field), Unknown | String)
    BinaryDecoder(channel, ["x"], "log")
    with pytest.raises(
        SchemaError,
        match=rf"^log: topic '/t': a field of type '{name}' lies before the wanted one, "
        r"and how many bytes it takes is not known$",
    ):
        BinaryDecoder(channel, ["y"], "log")


NESTED = "the definition of 'pkg/msg/T' contains itself or is nested deeper than 50 types"
UNPARSED = "the definition of 'pkg/msg/T' that the log carries cannot be parsed as "
ABSENT = "the log carries no definition of 'pkg/msg/T' and it is not a standard type; put its "
FOREIGN = "the definition of 'pkg/msg/T' is written in 'flatbuffer', which this version does not "
DEEP = "T1 a\n" + "".join(f"{RULE}\nMSG: pkg/T{k}\nT{k + 1} a\n" for k in range(1, 500))


@pytest.mark.parametrize(
    ("channel", "reason"),
    [
        (
            Channel("/t", "pkg/msg/T", "cdr"),
            ABSENT + ".msg files next to the log, or name them with msg_path",
        ),
        (defined("float64 x y z\n{}\n"), UNPARSED + "ros2msg"),
        (defined(f"float64 x\n{RULE}\npkg/A\nfloat64 y\n"), UNPARSED + "ros2msg"),
        (defined("struct {", "cdr", "ros2idl"), UNPARSED + "ros2idl"),
        (defined("table", "cdr", "flatbuffer"), FOREIGN + "read for this encoding"),
        (defined("T[] again\n"), NESTED),
        (defined(f"{DEEP}{RULE}\nMSG: pkg/T500\nuint8 a\n"), NESTED),
    ],
    ids=["none", "msg", "heading", "idl", "language", "recursive", "deep"],
)
def test_definitions_that_cannot_be_used_are_named_in_one_sentence(channel, reason):
    """The sentence says which topic and what is wrong; none exhausts the stack."""
    with pytest.raises(SchemaError, match="^" + re.escape(f"log: topic '/t': {reason}") + "$"):
        message_type(channel, "log")


@pytest.mark.parametrize("first", ["uint8[1073741825] a", "T1[] a"])
def test_what_is_larger_than_any_message_is_refused(first):
    """Offsets behind it could overflow, also behind a list of it."""
    text = f"{first}\nfloat64 x\n{RULE}\nMSG: pkg/T1\nuint8[1073741825] b\n"
    with pytest.raises(SchemaError, match=r"the definition is larger than any message$"):
        BinaryDecoder(defined(text), ["x"], "log")


def test_types_that_multiply_by_sharing_are_refused_in_no_time():
    """Forty types of two strings each make a message of a million million strings."""
    levels = "".join(f"{RULE}\nMSG: pkg/T{k}\nT{k + 1} a\nT{k + 1} b\n" for k in range(1, 40))
    text = f"T1 a\nfloat64 x\n{levels}{RULE}\nMSG: pkg/T40\nstring a\nstring b\n"
    with pytest.raises(SchemaError, match=r"the definition is larger than any message$"):
        BinaryDecoder(defined(text), ["x"], "log")
    flat = flattened(message_type(defined(text), "log"))
    assert "x" in [column.text for column in flat.columns]
    assert len(flat.parts) <= 100_000


@pytest.mark.parametrize(
    ("text", "key_path"),
    [("a", ("a",)), ("a.b_2.c", ("a", "b_2", "c")), ("a[0]", ("a", 0)),
     ("a[12].b[3]", ("a", 12, "b", 3)), ("a b.c-d", ("a b", "c-d")),
     *((text, None) for text in ("", ".a", "a..b", "a[x]", "a.", "a[1]b"))],
)  # fmt: skip
def test_field_paths_are_names_with_dots_and_indices(text, key_path):
    """Text that is not a path is not taken for one."""
    assert key_path_of(text) == key_path


NO_FIELD = "'sensor_msgs/msg/Imu' has no field 'PATH'; "
UNEQUAL = "field 'PATH' of 'sensor_msgs/msg/Imu' is not made of equal numbers; name a number, "


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("a..b", "'a..b' is not a field path; write it as a.b.c or a[0].b"),
        ("angular_velocity.w", NO_FIELD + "'geometry_msgs/msg/Vector3' has 'x', 'y', 'z'"),
        (
            "angular_velocity_covariance[9]",
            NO_FIELD + "the array there takes an index from [0] to [8]",
        ),
        ("header.stamp.sec.x", NO_FIELD + "a number or a string has no fields"),
        ("header", UNEQUAL + "or a struct or fixed array of them"),
    ],
)
def test_paths_that_lead_nowhere_say_what_there_is(path, reason):
    """The way out is in the sentence."""
    with pytest.raises(
        SchemaError, match="^" + re.escape(f"log: {reason.replace('PATH', path)}") + "$"
    ):
        BinaryDecoder(IMU, [path], "log")


def test_elements_of_sequences_are_no_columns():
    """An element need not be there in every message."""
    with pytest.raises(SchemaError, match=r"every message: it is a list of any length"):
        BinaryDecoder(defined("float64[] x\n"), ["x[0]"], "log")


def test_structs_and_arrays_of_equal_numbers_are_rows():
    """A matrix of vectors is a row like any other; a mixture is not."""
    vector = Struct("V", (("x", Primitive("f8")), ("y", Primitive("f8"))))
    assert numeric_layout(Array(vector, 3)) == (Primitive("f8"), 6)
    assert numeric_layout(Struct("M", (("a", vector), ("b", Primitive("f4"))))) is None
    assert numeric_layout(Struct("E", ())) is None


def test_the_structs_of_a_message_come_outermost_first():
    """A field at the top is found before a deeper one."""
    parts = [part.prefix for part in flattened(message_type(IMU, "log")).parts]
    vectors = ["orientation.", "angular_velocity.", "linear_acceleration."]
    assert parts == ["", "header.", *vectors, "header.stamp."]


def test_arrays_of_more_than_64_numbers_are_no_columns(tmp_path):
    """Each would be a thousand columns that nobody asked for."""
    text = "int8[64] a\nint8[65] b\nint8 c\n"
    columns = flattened(message_type(defined(text), "log")).columns
    assert [column.text for column in columns] == [*(f"a[{k}]" for k in range(64)), "c"]
    # Each of them may be named.
    data = b"\0\1\0\0" + bytes(64) + bytes(range(64)) + b"\7\6"
    path = write_topics(
        tmp_path / "log.mcap", {"/t": Topic("pkg/msg/T", [data], text.encode(), "ros2msg", "cdr")}
    )
    options = {"rate_field": "b[64],c,b[63]", "rate_unit": "rad/s", "clock": "log"}
    assert rates(path, **options)[1].rate.tolist() == [[7, 6, 63]]


IMU_TEXT, IMU_SUM = get_typestore(Stores.ROS1_NOETIC).generate_msgdef(IMU.type_name, ros_version=1)
CONSTANTS = "int32 A=1  # one\nstring S= a # b \nfloat64 x # metres\n"
OWN = get_typestore(Stores.EMPTY)
OWN.register(get_types_from_msg(CONSTANTS, "pkg/msg/T"))
_, CONSTANTS_SUM = OWN.generate_msgdef("pkg/msg/T", ros_version=1)


@pytest.mark.parametrize(
    ("name", "text", "stated", "found"),
    [
        ("sensor_msgs/Imu", IMU_TEXT, IMU_SUM, IMU_TEXT),
        ("sensor_msgs/Imu", "float64 damaged", IMU_SUM, IMU_TEXT),
        ("sensor_msgs/Imu", "float64 x", "0" * 32, None),
        ("sensor_msgs/Imu", "float64 x", "*", "float64 x"),
        ("sensor_msgs/Imu", "float64 x", None, "float64 x"),
        ("pkg/T", "float64 x", "0" * 32, None),
        # A comment mark in a text is part of it.
        ("pkg/T", CONSTANTS, CONSTANTS_SUM, CONSTANTS),
        *(("pkg/T", text, "0" * 32, text) for text in ("Other o", "T again", "float64 x y")),
    ],
)
def test_a_definition_has_the_sum_that_its_publisher_states(name, text, stated, found):
    """A damaged one is that of the standard type; one that defines not all has no sum."""
    fields = {b"type": name.encode(), b"message_definition": text.encode()}
    if stated is not None:
        fields[b"md5sum"] = stated.encode()
    assert definition_of(fields) == (None if found is None else found.encode())


@pytest.mark.parametrize("definition", ["string data", "string[] data"])
def test_another_definition_is_no_list_of_transforms(definition):
    """The name of the type does not say what the messages hold."""
    with pytest.raises(SchemaError, match="does not describe a list of transforms"):
        TransformDecoder(defined(definition, name="tf2_msgs/msg/TFMessage"), "log")
