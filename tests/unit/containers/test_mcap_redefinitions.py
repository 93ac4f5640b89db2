"""MCAP files that define an id anew, which the format forbids, against the library's own reader."""

import struct
import zlib

import pytest
from mcap.reader import NonSeekingReader

from quatprop.containers.mcap.log import McapLog
from quatprop.errors import UnsupportedLogError

MAGIC = b"\x89MCAP0\r\n"


def record(opcode, content):
    """Return a record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def text(content):
    """Return a string with its length before it."""
    return struct.pack("<I", len(content)) + content.encode()


def schema(id_, name, definition="string data"):
    """Return a schema record."""
    return record(3, struct.pack("<H", id_) + text(name) + text("ros2msg") + text(definition))


def channel(id_, topic, schema_id=1):
    """Return a channel record."""
    content = struct.pack("<HH", id_, schema_id) + text(topic) + text("cdr") + bytes(4)
    return record(4, content)


def messages(id_, *stamps):
    """Return messages, of uneven lengths."""
    return b"".join(
        record(5, struct.pack("<HIQQ", id_, 0, stamp, stamp) + bytes(4 + 4 * (stamp % 2)))
        for stamp in stamps
    )


def chunk(*parts, indexed, checked=True):
    """Return a chunk, with a message index and a checksum where wanted."""
    content = b"".join(parts)
    head = struct.pack("<QQQII", 0, 99, len(content), zlib.crc32(content) if checked else 0, 0)
    written = record(6, head + struct.pack("<Q", len(content)) + content)
    entries, position = {}, 0
    while position < len(content):
        opcode, length = struct.unpack_from("<BQ", content, position)
        if opcode == 5:
            id_, _, stamp = struct.unpack_from("<HIQ", content, position + 9)
            entries.setdefault(id_, []).append(struct.pack("<QQ", stamp, position))
        position += 9 + length
    for id_, listed in entries.items() if indexed else ():
        list_size = 16 * len(listed)
        written += record(7, struct.pack("<HI", id_, list_size) + b"".join(listed))
    return written


def saved(tmp_path, *parts):
    """Return the path of a file of these records, which has no summary."""
    header = record(1, text("ros2") + text("test"))
    path = tmp_path / "log.mcap"
    path.write_bytes(
        MAGIC + header + b"".join(parts) + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
    )
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
    found = {}
    with path.open("rb") as stream:
        for kind, of, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
            found.setdefault((of.topic, kind.name), []).append(message.log_time)
    return found


FIRST = (schema(1, "a/msg/A"), channel(1, "/a"), messages(1, 0, 1, 2, 3))


@pytest.mark.parametrize("indexed", [True, False])
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


@pytest.mark.parametrize("indexed", [True, False])
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


@pytest.mark.parametrize("indexed", [True, False])
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


@pytest.mark.parametrize("indexed", [True, False])
def test_topics_beside_an_id_that_is_defined_anew_are_read(tmp_path, indexed):
    """Whichever is read first, one topic is read and the other refused."""
    other = (schema(3, "a/msg/C"), channel(2, "/other", 3), messages(2, 7))
    parts = (*other, *FIRST, messages(2, 8), channel(1, "/b"), messages(1, 4))
    path = saved(tmp_path, chunk(*parts, indexed=indexed))
    log = McapLog(path)
    first, second = log.channels()
    for _ in range(2):
        (block,) = log.blocks(second)
        assert block.log_ns.tolist() == truth(path)["/other", "a/msg/C"] == [7, 8]
        with pytest.raises(UnsupportedLogError, match="redefines channel 1"):
            list(log.blocks(first))


def test_definitions_that_are_repeated_are_no_new_ones(tmp_path):
    """Writers repeat definitions in each chunk, and other metadata makes no other channel."""
    again = channel(1, "/a")[:-4] + struct.pack("<I", 10) + text("k") + text("v")
    again = again[:1] + struct.pack("<Q", len(again) - 9) + again[9:]
    for indexed in (True, False):
        path = saved(tmp_path, chunk(*FIRST, FIRST[0], again, messages(1, 4), indexed=indexed))
        assert read(McapLog(path)) == truth(path) == {("/a", "a/msg/A"): [0, 1, 2, 3, 4]}


def picture(size=200_000):
    """Return a large message of channel 2."""
    return record(5, struct.pack("<HIQQ", 2, 0, 3, 3) + bytes(size))


OTHER = (schema(3, "a/msg/C"), channel(2, "/other", 3))


@pytest.mark.parametrize(
    "parts",
    [
        (*FIRST, picture(), channel(1, "/b"), picture(), messages(1, 4)),
        (*FIRST, channel(1, "/b"), picture(), picture(), messages(1, 4)),
        (*FIRST, picture(), messages(1, 4), picture(), channel(1, "/b")),
    ],
)
def test_an_id_that_is_defined_anew_beside_pictures_is_refused(tmp_path, parts):
    """Also where pictures are passed over, and wherever among them the definition is."""
    log = McapLog(saved(tmp_path, chunk(*OTHER, *parts, indexed=True)))
    with pytest.raises(UnsupportedLogError, match="redefines channel 1"):
        list(log.blocks(log.channels()[0]))


def test_pictures_are_passed_over_behind_definitions(tmp_path):
    """Definitions that a chunk begins with, as they were before, let messages be selected."""
    later = chunk(*OTHER, *FIRST[:2], picture(), messages(1, 4), picture(), indexed=True)
    path = saved(tmp_path, chunk(*OTHER, *FIRST, indexed=True), later)
    log = McapLog(path)
    assert read(log)["/a", "a/msg/A"] == truth(path)["/a", "a/msg/A"] == [0, 1, 2, 3, 4]
    assert log.unchecked_chunks == 1
