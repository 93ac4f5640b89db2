"""Definitions as logs carry them, and paths into them."""

import re

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from quatprop.errors import SchemaError
from quatprop.messages.binary import BinaryDecoder
from quatprop.messages.blocks import Channel
from quatprop.messages.definitions import NUMBERS, message_type
from quatprop.messages.flattening import flattened
from quatprop.messages.schema import (
    Array,
    Primitive,
    Sequence,
    String,
    Struct,
    Unknown,
    field_at,
    find,
    numeric_layout,
    steps,
)

RULE = "=" * 80
IMU = Channel("/imu", "sensor_msgs/msg/Imu", "cdr")


def parsed(text, encoding="cdr", grammar="ros2msg", name="pkg/msg/T"):
    """Return the type that a definition defines."""
    return message_type(Channel("/t", name, encoding, grammar, text.encode()), "log")


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
    root = parsed(
        "# a comment\n"
        "bool a\nbyte b\nchar c\nint8 d 5\nfloat32[3] e  # three\nuint16[] f\nint64[<=4] g\n"
        "string h\nstring<=9 i\nstring<=9[<=2] j\nuint8 CONSTANT=3\nint32 lower_case = 4\n"
        "string WORDS= has = and # in it\nfloat64 z 1.5\n"
    )
    assert spelled(root) == (
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
        f"\ufeffPart p\n{RULE}\nMSG: pkg/Part\nfloat64 x\n\0",
    ],
    ids=["bare", "qualified", "CRLF", "blanks", "short rule", "comments", "mark and NUL"],
)
def test_definitions_are_read_however_they_are_laid_out(text):
    """Line ends, blanks and rules of other lengths do not matter."""
    assert spelled(parsed(text)) == (("p", (("x", "f8"),)),)


def test_bytes_that_are_not_UTF8_do_not_matter_in_comments():
    """Old definitions are in Latin-1."""
    channel = Channel("/t", "pkg/msg/T", "ros1", "ros1msg", b"# \xb0/s\nfloat64 x # \xb0\n")
    assert spelled(message_type(channel, "log")) == (("x", "f8"),)


@pytest.mark.parametrize("head", ["", f"{RULE}\nIDL: pkg/msg/T\n"], ids=["plain", "headed"])
def test_IDL_is_read(head):
    """Modules, fixed arrays by typedef, sequences and strings, alone or in a headed list."""
    root = parsed(
        head + "module pkg { module msg {\n typedef double double__3[3];\n struct T {\n"
        '  @verbatim (language="comment", text="=") uint8 a;\n  string b;\n  wstring c;\n'
        "  sequence<int16> d;\n  pkg::msg::double__3 e;\n }; }; };\n",
        grammar="ros2idl",
    )  # fmt: skip
    assert spelled(root) == (
        ("a", "u1"), ("b", "text"), ("c", "wide"), ("d", ["i2"]), ("e", ["f8", 3]),
    )  # fmt: skip


def test_types_missing_from_a_definition_are_completed_from_the_standard_ones():
    """A header need not be defined with every message."""
    ros1 = parsed("Header header\n", "ros1", "ros1msg")
    ros2 = parsed("std_msgs/Header header\n")
    assert spelled(ros1) == (
        ("header", (
            ("seq", "u4"), ("stamp", (("sec", "u4"), ("nanosec", "u4"))), ("frame_id", "text"),
        )),
    )  # fmt: skip
    assert spelled(ros2) == (
        ("header", (("stamp", (("sec", "i4"), ("nanosec", "u4"))), ("frame_id", "text"))),
    )


def test_the_definition_in_the_log_counts_more_than_the_standard_one():
    """A type may have changed since it was recorded."""
    root = parsed("float32 only\n", name="sensor_msgs/msg/Imu")
    assert spelled(root) == (("only", "f4"),)


@pytest.mark.parametrize(
    ("encoding", "store"), [("cdr", Stores.LATEST), ("ros1", Stores.ROS1_NOETIC)]
)
def test_every_standard_type_has_the_fields_that_its_generated_definition_has(encoding, store):
    """Going through the text of a definition changes nothing."""
    typestore = get_typestore(store)
    grammar = "ros1msg" if encoding == "ros1" else "ros2msg"
    for name in typestore.fielddefs:
        text, _ = typestore.generate_msgdef(name, ros_version=1 if encoding == "ros1" else 2)
        bare = message_type(Channel("/t", name, encoding), "log")
        assert spelled(parsed(text, encoding, grammar, name)) == spelled(bare), name


def test_the_numbers_of_definitions_are_those_of_the_library():
    """No name of a number in the standard types is unknown."""
    kinds = {
        kind[1][0]
        for _, fields in get_typestore(Stores.LATEST).fielddefs.values()
        for _, kind in fields
        if kind[0] == Nodetype.BASE
    }
    assert kinds - {"string"} <= set(NUMBERS)


def test_a_type_that_is_defined_nowhere_is_an_error_only_in_the_way():
    """What lies behind the wanted field need not be known."""
    schema = b"float64 x\nother/Mystery m\nfloat64 y\n"
    channel = Channel("/t", "pkg/msg/T", "cdr", "ros2msg", schema)
    assert isinstance(find(message_type(channel, "log"), "m"), Unknown)
    BinaryDecoder(channel, ["x"], "log")
    with pytest.raises(
        SchemaError,
        match=r"^log: topic '/t': a field of type 'other/msg/Mystery' lies before the wanted one, "
        r"and how many bytes it takes is not known$",
    ):
        BinaryDecoder(channel, ["y"], "log")


def test_wide_strings_are_an_error_only_in_the_way():
    """Writers encode them differently, so they are not guessed."""
    channel = Channel("/t", "pkg/msg/T", "cdr", "ros2msg", b"float64 x\nwstring w\nfloat64 y\n")
    BinaryDecoder(channel, ["x"], "log")
    with pytest.raises(SchemaError, match="a field of type 'wstring' lies before the wanted one"):
        BinaryDecoder(channel, ["y"], "log")


@pytest.mark.parametrize(
    ("channel", "reason"),
    [
        (
            Channel("/t", "pkg/msg/T", "cdr"),
            (
                "the log carries no definition of 'pkg/msg/T' and it is not a standard type; "
                "put its .msg files beside the log, or name them with msg_path"
            ),
        ),
        (
            Channel("/t", "pkg/msg/T", "cdr", "ros2msg", b"float64 x y z\n{}\n"),
            "the definition of 'pkg/msg/T' that the log carries cannot be parsed as ros2msg",
        ),
        (
            Channel("/t", "pkg/msg/T", "cdr", "ros2idl", b"struct {"),
            "the definition of 'pkg/msg/T' that the log carries cannot be parsed as ros2idl",
        ),
        (
            Channel("/t", "pkg/msg/T", "cdr", "flatbuffer", b"table"),
            (
                "the definition of 'pkg/msg/T' is written in 'flatbuffer', which this version does "
                "not read for this encoding"
            ),
        ),
        (
            Channel("/t", "pkg/msg/T", "cdr", "ros2msg", b"T[] again\n"),
            "the definition of 'pkg/msg/T' contains itself or is nested deeper than 50 types",
        ),
    ],
    ids=["none", "msg", "idl", "language", "recursive"],
)
def test_definitions_that_cannot_be_used_are_named_in_one_sentence(channel, reason):
    """The sentence says which topic and what is wrong."""
    with pytest.raises(SchemaError, match="^" + re.escape(f"log: topic '/t': {reason}") + "$"):
        message_type(channel, "log")


def test_types_nested_absurdly_deep_are_refused():
    """A definition cannot exhaust the stack."""
    text = "T1 a\n" + "".join(f"{RULE}\nMSG: pkg/T{k}\nT{k + 1} a\n" for k in range(1, 500))
    with pytest.raises(SchemaError, match=r"nested deeper than 50 types$"):
        parsed(text + f"{RULE}\nMSG: pkg/T500\nuint8 a\n")


def test_types_that_multiply_by_sharing_are_refused_in_no_time():
    """Forty types of two strings each make a message of a million million strings."""
    levels = "".join(f"{RULE}\nMSG: pkg/T{k}\nT{k + 1} a\nT{k + 1} b\n" for k in range(1, 40))
    text = f"T1 a\nfloat64 x\n{levels}{RULE}\nMSG: pkg/T40\nstring a\nstring b\n"
    channel = Channel("/t", "pkg/msg/T", "cdr", "ros2msg", text.encode())
    with pytest.raises(SchemaError, match=r"the definition is larger than any message$"):
        BinaryDecoder(channel, ["x"], "log")
    flat = flattened(message_type(channel, "log"))
    assert "x" in [column.text for column in flat.columns]
    assert len(flat.parts) <= 100_000


@pytest.mark.parametrize(
    ("text", "way"),
    [
        ("a", ("a",)),
        ("a.b_2.c", ("a", "b_2", "c")),
        ("a[0]", ("a", 0)),
        ("a[12].b[3]", ("a", 12, "b", 3)),
        ("", None),
        (".a", None),
        ("a..b", None),
        ("a[x]", None),
        ("a.", None),
        ("a b.c-d", ("a b", "c-d")),
        ("a[1]b", None),
    ],
)
def test_field_paths_are_names_with_dots_and_indices(text, way):
    """What is not a path is not taken for one."""
    assert steps(text) == way


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        ("a..b", "'a..b' is not a field path; write it as a.b.c or a[0].b"),
        (
            "angular_velocity.w",
            (
                "'sensor_msgs/msg/Imu' has no field 'angular_velocity.w'; "
                "'geometry_msgs/msg/Vector3' has 'x', 'y', 'z'"
            ),
        ),
        (
            "angular_velocity_covariance[9]",
            (
                "'sensor_msgs/msg/Imu' has no field 'angular_velocity_covariance[9]'; "
                "the array there takes an index from [0] to [8]"
            ),
        ),
        (
            "header.stamp.sec.x",
            (
                "'sensor_msgs/msg/Imu' has no field 'header.stamp.sec.x'; "
                "a number or a string has no fields"
            ),
        ),
        (
            "header",
            (
                "field 'header' of 'sensor_msgs/msg/Imu' is not made of equal numbers; "
                "name a number, or a struct or fixed array of them"
            ),
        ),
    ],
)
def test_paths_that_lead_nowhere_say_what_there_is(path, reason):
    """The way out is in the sentence."""
    with pytest.raises(SchemaError, match="^" + re.escape(f"log: {reason}") + "$"):
        BinaryDecoder(IMU, [path], "log")


def test_elements_of_sequences_are_no_columns():
    """An element need not be there in every message."""
    root = parsed("float64[] x\n")
    with pytest.raises(SchemaError, match=r"a sequence may be empty; name a field outside it$"):
        field_at(root, "x[0]", "log")


def test_structs_and_arrays_of_equal_numbers_are_rows():
    """A matrix of vectors is a row like any other; a mixture is not."""
    vector = Struct("V", (("x", Primitive("f8")), ("y", Primitive("f8"))))
    assert numeric_layout(Array(vector, 3)) == (Primitive("f8"), 6)
    assert numeric_layout(Struct("M", (("a", vector), ("b", Primitive("f4"))))) is None
    assert numeric_layout(Struct("E", ())) is None


def test_the_structs_of_a_message_come_outermost_first():
    """What is at the top is found before what lies deeper."""
    parts = flattened(message_type(IMU, "log")).parts
    assert [(part.prefix, part.type.rpartition("/")[2]) for part in parts] == [
        ("", "Imu"),
        ("header.", "Header"),
        ("orientation.", "Quaternion"),
        ("angular_velocity.", "Vector3"),
        ("linear_acceleration.", "Vector3"),
        ("header.stamp.", "Time"),
    ]
