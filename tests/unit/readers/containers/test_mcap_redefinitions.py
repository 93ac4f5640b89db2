"""MCAP files that define an id anew, which the format forbids, against the library's own reader."""

import struct
import zlib
from collections import defaultdict

import pytest
from fuzz.flips_mcap import MAGIC, message_index, record, text
from mcap.reader import NonSeekingReader

from quatprop.base.errors import Loss, UnsupportedLogError
from quatprop.readers.containers.mcap import McapLog

HEADER, END = record(1, text("ros2") + text("test")), record(15, bytes(4)) + record(2, bytes(20))
whether_indexed = pytest.mark.parametrize("indexed", [True, False])


def schema(id_, name, definition="string data"):
    """Return a schema record."""
    return record(3, struct.pack("<H", id_) + text(name) + text("ros2msg") + text(definition))


def channel(id_, topic, schema_id=1, metadata=b""):
    """Return a channel record."""
    content = struct.pack("<HH", id_, schema_id) + text(topic) + text("cdr") + text(metadata)
    return record(4, content)


def messages(id_, *stamps):
    """Return messages, of uneven lengths."""
    return b"".join(
        record(5, struct.pack("<HIQQ", id_, 0, stamp, stamp) + bytes(4 + 4 * (stamp % 2)))
        for stamp in stamps
    )


def chunk(*parts, indexed, checked=True):
    """Return a chunk, with a message index and a checksum where wanted."""
    content, entries, position = b"".join(parts), defaultdict(list), 0
    crc = zlib.crc32(content) if checked else 0
    head = struct.pack("<QQQII", 0, 99, len(content), crc, 0)
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 5:
            id_, _, stamp = struct.unpack_from("<HIQ", content, position + 9)
            entries[id_].append((stamp, position))
        position += 9 + length
    index = b"".join(message_index(*each) for each in entries.items()) if indexed else b""
    return record(6, head + struct.pack("<Q", len(content)) + content) + index


def saved(tmp_path, *parts):
    """Return the path of a file of these records, which has no summary."""
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + HEADER + b"".join(parts) + END + MAGIC)
    return path


def read(log):
    """Return the log times of each topic and type."""
    return {
        (channel.topic, channel.type_name): [
            int(stamp) for block in log.blocks(channel) for stamp in block.log_ns
        ]
        for channel in log.channels()
    }


def truth(path):
    """Return the same by the library's own reader."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        for kind, of, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            found[of.topic, kind.name].append(message.log_time)
    return found


FIRST = (schema(1, "a/msg/A"), channel(1, "/a"), messages(1, 0, 1, 2, 3))
OTHER = (schema(3, "a/msg/C"), channel(2, "/other", 3))


@whether_indexed
@pytest.mark.parametrize("anew", [channel(1, "/b"), schema(1, "a/msg/B")])
@pytest.mark.parametrize("chunked", [True, False])
def test_an_id_that_is_defined_anew_between_chunks_is_read_as_the_library_does(
    tmp_path, anew, chunked, indexed
):
    """Messages belong to the last definition before them."""
    parts = [(*FIRST,), (anew, messages(1, 4, 5, 6))]
    if chunked:
        parts = [[chunk(*part, indexed=indexed)] for part in parts]
    path = saved(tmp_path, *parts[0], *parts[1])
    log = McapLog(path)
    assert len(truth(path)) == 2
    assert read(log) == truth(path)
    assert log.losses == []


@whether_indexed
@pytest.mark.parametrize("last", [(), (4, 5, 6)])
@pytest.mark.parametrize(
    ("anew", "told"),
    [
        (channel(1, "/b"), "channel 1 (/a is now /b)"),
        (channel(1, "/\0\x1b[2J"), r"channel 1 (/a is now /\x00\x1b[2J)"),
        (channel(1, "/a", 3), "channel 1 (/a has changed)"),
        (schema(1, "a/msg/B"), "schema 1 (a/msg/A is now a/msg/B)"),
        (schema(1, "a/msg/A", "string text"), "schema 1 (a/msg/A has changed)"),
    ],
)
def test_an_id_that_is_defined_anew_inside_a_chunk_is_refused(tmp_path, anew, told, last, indexed):
    """Nothing is attributed to a topic that it is not of."""
    path = saved(tmp_path, chunk(*FIRST, anew, messages(1, *last), indexed=indexed))
    log = McapLog(path)
    (first,) = log.channels()
    for _ in range(2):
        with pytest.raises(UnsupportedLogError) as refused:
            list(log.blocks(first))
        assert str(refused.value) == (
            f"{path}: chunk at byte {8 + 9 + 16}: it redefines {told}, so it is not certain whose "
            "messages these are; MCAP forbids that; copy the messages with an MCAP library into a "
            "file in which each definition has its own id"
        )


@whether_indexed
def test_a_definition_that_may_be_damaged_costs_its_chunk(tmp_path, indexed):
    """Without a checksum, a new definition may be damage: the other chunks are read."""
    damaged = chunk(FIRST[0], FIRST[1], messages(1, 4, 5), channel(1, "/A"), messages(1, 6),
                    indexed=indexed, checked=False)  # fmt: skip
    before, after = (chunk(messages(1, *stamps), indexed=indexed) for stamps in [(0, 1), (7, 8)])
    path = saved(tmp_path, *FIRST[:2], before, damaged, after)
    log = McapLog(path)
    assert read(log) == {("/a", "a/msg/A"): [0, 1, 7, 8]}
    (loss,) = log.losses
    assert loss.place == f"chunk at byte {path.read_bytes().index(damaged)}"
    assert loss.reason == (
        "it redefines channel 1 (/a is now /A), so it is not certain whose messages these are"
    )
    assert loss.messages == 3


@whether_indexed
def test_topics_next_to_an_id_that_is_defined_anew_are_read(tmp_path, indexed):
    """Whichever is read first, one topic is read and the other refused."""
    parts = (*OTHER, messages(2, 7), *FIRST, messages(2, 8), channel(1, "/b"), messages(1, 4))
    path = saved(tmp_path, chunk(*parts, indexed=indexed))
    log = McapLog(path)
    first, second = log.channels()
    for _ in range(2):
        (block,) = log.blocks(second)
        assert block.log_ns.tolist() == truth(path)["/other", "a/msg/C"] == [7, 8]
        with pytest.raises(UnsupportedLogError, match="redefines channel 1"):
            list(log.blocks(first))


@whether_indexed
def test_definitions_that_are_repeated_are_no_new_ones(tmp_path, indexed):
    """Writers repeat definitions in each chunk, and other metadata makes no other channel."""
    again = channel(1, "/a", metadata=text("k") + text("v"))
    path = saved(tmp_path, chunk(*FIRST, FIRST[0], again, messages(1, 4), indexed=indexed))
    assert read(McapLog(path)) == truth(path) == {("/a", "a/msg/A"): [0, 1, 2, 3, 4]}


@whether_indexed
@pytest.mark.parametrize("chunked", [True, False])
def test_a_damaged_definition_of_an_id_that_is_known_is_no_new_one(tmp_path, chunked, indexed):
    """The messages behind it are those of the definition before."""
    parts = *FIRST, record(4, struct.pack("<HH", 1, 1) + b"\xff" * 9), messages(1, 4)
    path = saved(tmp_path, *([chunk(*parts, indexed=indexed)] if chunked else parts))
    assert read(McapLog(path)) == {("/a", "a/msg/A"): [0, 1, 2, 3, 4]}


@pytest.mark.parametrize(
    "content",
    [b"\1\0" + text("a/msg/A"), b"\1\0" + text("a/msg/A") + text("x") + text("y") + b"rest"],
)
def test_a_damaged_schema_is_told(tmp_path, content):
    """It lacks a part, or text follows its definition, whose length is damaged then."""
    log = McapLog(saved(tmp_path, record(3, content), *FIRST[1:]))
    assert log.losses[0] == Loss(f"schema at byte {8 + len(HEADER)}", "it is damaged")
    assert read(log) == {("/a", ""): [0, 1, 2, 3]}


PICTURE = record(5, struct.pack("<HIQQ", 2, 0, 3, 3) + bytes(200_000))
"""A large message of channel 2."""


@pytest.mark.parametrize(
    "parts",
    [
        (*FIRST, PICTURE, channel(1, "/b"), PICTURE, messages(1, 4)),
        (*FIRST, channel(1, "/b"), PICTURE, PICTURE, messages(1, 4)),
        (*FIRST, PICTURE, messages(1, 4), PICTURE, channel(1, "/b")),
    ],
)
def test_an_id_that_is_defined_anew_next_to_pictures_is_refused(tmp_path, parts):
    """Also where pictures are passed over, and wherever among them the definition is."""
    log = McapLog(saved(tmp_path, chunk(*OTHER, *parts, indexed=True)))
    with pytest.raises(UnsupportedLogError, match="redefines channel 1"):
        list(log.blocks(log.channels()[0]))


def test_pictures_are_passed_over_behind_definitions(tmp_path):
    """Definitions that a chunk begins with, as they were before, let messages be selected."""
    later = chunk(*OTHER, *FIRST[:2], PICTURE, messages(1, 4), PICTURE, indexed=True)
    path = saved(tmp_path, chunk(*OTHER, *FIRST, indexed=True), later)
    log = McapLog(path)
    assert read(log)["/a", "a/msg/A"] == truth(path)["/a", "a/msg/A"] == [0, 1, 2, 3, 4]
    assert log.unchecked_chunks == 1
