"""MCAP files of every layout, odd, lying and hostile, against the library's own reader."""

import itertools
import struct
import threading

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from make.mcap import (
    HEADERS,
    MAGIC,
    Topic,
    build,
    read,
    records,
    saved,
    truth,
    unclosed,
    write_topics,
    written,
)
from make.worn import wear
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType

from quatprop.base import threads
from quatprop.base.errors import (
    DamagedLogError,
    Loss,
    UnreadableLogError,
    UnsupportedLogError,
    UsageError,
)
from quatprop.readers.containers import parts
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.containers.mcap_index import LATEST
from quatprop.readers.containers.mcap_records import walk_records
from quatprop.readers.containers.topic_table import TopicTable
from quatprop.readers.messages.blocks import Channel
from quatprop.readers.tables.model import Stamp
from quatprop.stores.file_source import FileSource

IMU = Channel("/imu", "sensor_msgs/msg/Imu", "cdr", "ros2msg", b"Header header")
PLAIN = {"compression": CompressionType.NONE}


LAYOUTS = [
    {
        "use_chunking": compression is not None,
        "compression": compression or CompressionType.NONE,
        "index_types": index,
        "use_statistics": repeat,
        "repeat_channels": repeat,
        "repeat_schemas": repeat,
        "use_summary_offsets": offsets,
    }
    for compression, index, repeat, offsets in itertools.product(
        [None, CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD],
        [IndexType.ALL, IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE],
        [True, False],
        [True, False],
    )
]


@pytest.mark.parametrize("options", LAYOUTS, ids=lambda o: "-".join(str(v) for v in o.values()))
def test_every_layout_gives_the_messages_of_the_library(tmp_path, options):
    """Whatever a writer leaves out, the messages are all there and nothing is lost."""
    for uneven, counts in ((True, (15, 45, 0)), (False, (0, 60, 0))):
        content = written(uneven=uneven, **options)
        log = McapLog(saved(tmp_path, content))
        assert sorted(read(log)) == sorted(truth(content))
        assert log.losses == []
        found = {channel.topic: channel.count for channel in log.channels()}
        for topic, count in zip(("/bare", "/imu", "/silent"), counts, strict=True):
            assert found.get(topic) in {count, None}


def test_channels_say_what_the_log_says(tmp_path):
    """Publishers of one topic are one channel; silent channels and bare ones are listed."""
    silent = Channel("/silent", "sensor_msgs/msg/Imu", "cdr", "ros2msg", b"Header header")
    log = McapLog(saved(tmp_path, written()))
    assert log.channels() == [Channel("/bare", "", "json"), IMU, silent]
    assert [channel.count for channel in log.channels()] == [15, 45, 0]


@pytest.mark.parametrize(
    ("name", "encoding", "expected"),
    [
        ("sensor_msgs/Imu", "ros1", "sensor_msgs/msg/Imu"),
        ("sensor_msgs/msg/Imu", "cdr", "sensor_msgs/msg/Imu"),
        ("sensor_msgs::msg::Imu", "cdr", "sensor_msgs/msg/Imu"),
        ("foxglove.Odometry", "protobuf", "foxglove.Odometry"),
        ("sensor_msgs/Imu", "json", "sensor_msgs/Imu"),
        ("Imu", "cdr", "Imu"),
    ],
)
def test_ros_types_have_one_spelling(tmp_path, name, encoding, expected):
    """Names of ROS types are normalised, others stand."""
    topic = Topic(name, [], b"", "x", encoding)
    (channel,) = McapLog(write_topics(tmp_path / "log.mcap", {"/imu": topic})).channels()
    assert channel.type_name == expected


def test_blocks_promise_what_does_not_come_any_more(tmp_path):
    """Chunks that overlap in time come by their first time, with promises that are kept."""
    stamps = 100 * np.arange(200) // 7 + np.random.default_rng(5).integers(0, 3000, 200)
    topic = Topic("", [(int(stamp), bytes(20)) for stamp in stamps], encoding="cdr")
    log = McapLog(write_topics(tmp_path / "log.mcap", {"/imu": topic}, chunk_size=200))
    blocks = list(log.blocks(log.channels()[0]))
    assert len(blocks) > 10
    firsts = [int(block.log_ns.min()) for block in blocks]
    assert firsts == sorted(firsts)
    assert [block.watermark_ns for block in blocks] == [*firsts[1:], LATEST]


def test_stamps_that_need_the_64th_bit_are_cut_not_wrapped(tmp_path):
    """A log time after 2262 becomes the last ns of int64: the messages are kept, with a remark."""
    stamps = (5, 2**63 - 1, 2**63, 2**64 - 1)
    topic = Topic("", [(stamp, b"") for stamp in stamps], encoding="cdr")
    log = McapLog(write_topics(tmp_path / "log.mcap", {"/imu": topic}))
    (block,) = log.blocks(log.channels()[0])
    assert block.log_ns.tolist() == [5, LATEST, LATEST, LATEST]
    published = TopicTable(log, log.channels()[0]).ns(Stamp(clock="publish"), [], [block])
    assert published.tolist() == [5, LATEST, LATEST, LATEST]
    assert log.remarks == [
        "log times after the year 2262 do not fit int64 ns and are read as the last that does"
    ]


OFFSETS = {
    "next to a message": lambda offset, _: offset + 1,
    "to the beginning": lambda *_: 0,
    "to the first": lambda _, first: first,
    "beyond int64": lambda offset, _: offset + 2**63,
    "outside": lambda offset, _: offset + 10**6,
    "not to the first": lambda offset, first: offset if offset != first else 0,
}
HEADS = {
    "opcode": (0, "<B", 0x90),
    "length": (1, "<Q", 7),
    "channel": (9, "<H", 99),
    "size": (11, "<I", 2**32 - 16),
}
"""Place, form and value of what is damaged in the head of an index record."""


@pytest.mark.parametrize(("uneven", "chunk_size"), [(True, 400), (False, 400), (False, 1)])
@pytest.mark.parametrize("lie", [*OFFSETS, *HEADS])
def test_a_message_index_that_lies_is_not_believed(tmp_path, lie, uneven, chunk_size):
    """Wherever its offsets lead, and whatever its head says, the chunk is walked instead."""
    intact = written(uneven=uneven, chunk_size=chunk_size, **PLAIN)
    content = bytearray(intact)
    for opcode, begin, end in records(intact):
        if opcode == 7 and lie in HEADS:
            place, form, value = HEADS[lie]
            struct.pack_into(form, content, begin + place, value)
        elif opcode == 7:
            places = range(begin + 23, end, 16)
            first = struct.unpack_from("<Q", content, places[0])[0] if places else 0
            for place in places:
                (offset,) = struct.unpack_from("<Q", content, place)
                struct.pack_into("<Q", content, place, OFFSETS[lie](offset, first) % 2**64)
    log = McapLog(saved(tmp_path, content))
    assert sorted(read(log)) == sorted(truth(intact))
    if lie in OFFSETS:
        assert log.losses == []


def test_a_message_index_that_cannot_be_read_is_done_without(tmp_path, monkeypatch):
    """A worn memory card fails at some places only."""
    content = written()
    log = McapLog(saved(tmp_path, content))
    wear(monkeypatch, {end for opcode, _, end in records(content) if opcode == 6})
    assert (sorted(read(log)), log.losses) == (sorted(truth(content)), [])


def test_transforms_of_other_encodings_are_refused_with_the_way_out(tmp_path):
    """Rather than decoded as what they are not."""
    topics = {"/tf_static": Topic("tf2_msgs/msg/TFMessage", [{"transforms": []}])}
    (table,) = McapLog(write_topics(tmp_path / "log.mcap", topics)).tables()
    reason = r"log\.mcap: transforms in 'json' on '/tf_static' are not read; give 1,2,3$"
    with pytest.raises(UsageError, match=reason):
        next(table.transforms("1,2,3"))


def test_a_damaged_summary_is_replaced_by_a_scan(tmp_path):
    """A summary whose CRC is wrong is not used."""
    content = bytearray(written())
    (begin,) = (begin for opcode, begin, _ in records(bytes(content)) if opcode == 11)
    content[begin + 9] ^= 0xFF
    log = McapLog(saved(tmp_path, content))
    assert sorted(read(log)) == sorted(truth(written()))
    assert log.losses == []


@pytest.mark.parametrize("cut", [0, 30])
def test_a_file_that_is_cut_in_its_summary_has_all_messages(tmp_path, cut):
    """They are before the data end record, so nothing is reported lost."""
    content = written()
    data_end = next(end for opcode, _, end in records(content) if opcode == 15)
    log = McapLog(saved(tmp_path, content[: data_end + cut]))
    assert sorted(read(log)) == sorted(truth(content))
    assert log.losses == []


def test_messages_that_the_summary_counts_and_the_chunks_lack_are_a_loss(tmp_path):
    """Messages that the statistics count and no chunk holds are reported."""
    content = bytearray(written(enable_crcs=False))
    (begin,) = (begin for opcode, begin, _ in records(bytes(content)) if opcode == 11)
    struct.pack_into("<Q", content, begin + 9, 67)
    counts_at = begin + 9 + 8 + 2 + 4 * 4 + 8 + 8 + 4
    (channel, count) = struct.unpack_from("<HQ", content, counts_at)
    struct.pack_into("<HQ", content, counts_at, channel, count + 7)
    log = McapLog(saved(tmp_path, content))
    assert len(read(log)) == 60
    assert log.losses == [Loss("summary", "it counts 7 messages more than there are", 7)]


def test_chunks_without_the_channel_are_not_read(tmp_path):
    """Damage in a chunk of other topics does not touch the one that is read."""
    topics = dict.fromkeys(("/imu", "/other"), Topic("", [bytes(40)] * 20, encoding="cdr"))
    path = write_topics(tmp_path / "log.mcap", topics, chunk_size=200)
    content = bytearray(path.read_bytes())
    last = [begin for opcode, begin, _ in records(bytes(content)) if opcode == 6][-1]
    content[last + 60 : last + 64] = b"\xff" * 4
    log = McapLog(saved(tmp_path, content))
    first, second = log.channels()
    assert sum(len(block) for block in log.blocks(first)) == 20
    assert log.losses == []
    found = sum(len(block) for block in log.blocks(second))
    assert log.losses == [Loss(f"chunk at byte {last}", "its zstd data is damaged", 20 - found)]
    list(log.blocks(second))
    assert len(log.losses) == 1


@pytest.mark.parametrize("opcode", [3, 4, 5, 6, 7, 0x99])
def test_a_record_length_is_not_believed(tmp_path, opcode):
    """A record of 2**60 bytes is damage, not an allocation."""
    content = written(index_types=IndexType.NONE)
    data_end = next(begin for op, begin, _ in records(content) if op == 15)
    path = saved(tmp_path, content[:data_end] + struct.pack("<BQ", opcode, 2**60) + bytes(50))
    log = McapLog(path)
    assert sorted(read(log)) == sorted(truth(content))
    kind = "chunk at byte" if opcode == 6 else "byte"
    assert log.losses == [Loss(f"{kind} {data_end}", "the file ends inside it")]


def with_provenance():
    """Return a log of one topic with provenance."""
    recorded = {"topic": "/imu", "provenance": "{}"}
    metadata = [lambda writer: writer.add_metadata("quatprop", recorded)]
    return bytearray(build([("/imu", HEADERS)], metadata, enable_crcs=False))


@pytest.mark.parametrize(
    ("lie", "is_found"),
    [
        ((13, 9, "<Q", 2**40), False),
        ((13, 9, "<Q", 8), False),
        ((12, 1, "<Q", 1 << 24), True),  # what follows the entries is of no concern
        ((12, 1, "<Q", (1 << 24) + 1), False),
        ((12, 9, "<I", 2**32 - 1), False),
    ],
)
def test_provenance_that_is_not_where_the_summary_says_is_none(tmp_path, lie, is_found):
    """The messages are read without it, as where its record is damaged or longer than any is."""
    content, (opcode, place, form, value) = with_provenance(), lie
    (at,) = (begin for each, begin, _ in records(bytes(content)) if each == opcode)
    struct.pack_into(form, content, at + place, value)
    found = McapLog(saved(tmp_path, content)).recorded_provenance()
    assert found == ({"/imu": "{}"} if is_found else {})


def test_provenance_that_cannot_be_read_is_an_error_of_the_log(tmp_path, monkeypatch):
    """It is read last, and a file may be gone by then that is on a disk of the network."""
    log = McapLog(saved(tmp_path, with_provenance()))
    wear(monkeypatch)
    with pytest.raises(
        UnreadableLogError, match=r"log\.mcap: it cannot be read: 'Input/output error'$"
    ):
        log.recorded_provenance()


def test_an_undefined_channel_is_told(tmp_path):
    """Messages of a channel without a record cannot be read, and are reported as lost."""
    content = written(use_chunking=False, index_types=IndexType.NONE, repeat_channels=False)
    kept = b"".join(
        content[begin:end] for opcode, begin, end in records(content) if opcode in {1, 3, 5, 15}
    )
    log = McapLog(saved(tmp_path, content[:8] + kept))
    assert log.channels() == []
    assert Loss("channel 1", "no record defines it", 30) in log.losses


def with_images(tmp_path, *, chunk_size=1 << 20, picture=50_000, messages=400, **options):
    """Return a log of small messages, each ninth followed by a large one of another topic."""
    topics = [
        (topic, HEADERS._replace(metadata=[("publisher", who)]))
        for topic, who in (("/imu", "one"), ("/imu", "two"), ("/camera", ""))
    ]
    events = []
    for number in range(messages):
        size = 24 + number % 5
        events.append((number % 3 == 0, number, number.to_bytes(size, "little")))
        if number % 9 == 0:
            events.append((2, number, bytes([number % 256]) * picture))
    options = {"chunk_size": chunk_size, **PLAIN, **options}
    return saved(tmp_path, build(topics, events, profile="ros2", **options))


def numbers_of(log):
    """Return the number in each message of /imu."""
    return [
        int.from_bytes(block.data[start:end].tobytes(), "little")
        for block in log.blocks(IMU)
        for start, end in zip(block.starts, block.ends, strict=True)
    ]


def test_images_next_to_messages_are_not_read(tmp_path, monkeypatch):
    """Of a chunk that is not compressed, only what is wanted leaves the disk."""
    path = with_images(tmp_path, messages=2000)
    log = McapLog(path)
    read = []
    original = FileSource.read

    def counted(source, start, length):
        data = original(source, start, length)
        read.append(len(data))
        return data

    monkeypatch.setattr(FileSource, "read", counted)
    assert numbers_of(log) == list(range(2000))
    assert log.losses == []
    assert sum(read) < path.stat().st_size / 20


def test_an_index_that_lies_about_a_chunk_next_to_images_is_found_out(tmp_path):
    """Where it does not lead to messages, or to those of another topic, the chunk is walked."""
    path = with_images(tmp_path)
    content = path.read_bytes()
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert chunks
    for lie in ("adjacent", "to images", "swapped", "to the end", "head"):
        lying = bytearray(content)
        for chunk in chunks:
            *others, camera = (at + 23 for _, at in sorted(chunk.message_index_offsets.items()))
            for at in others:
                (own,) = struct.unpack_from("<Q", lying, at)
                (of_image,) = struct.unpack_from("<Q", lying, camera)
                if lie == "swapped":
                    struct.pack_into("<Q", lying, camera, own)
                offset = of_image if lie in {"to images", "swapped"} else own
                offset += 3 * (lie == "adjacent")
                offset = chunk.uncompressed_size - 9 if lie == "to the end" else offset
                struct.pack_into("<Q", lying, at, offset)
                lying[at - 23] = 0x90 if lie == "head" else 7
        path.write_bytes(lying)
        assert numbers_of(McapLog(path)) == list(range(400))
    at = content.index(struct.pack("<QQ", 200, 200)) + 7  # of a log time, which its chunk refutes
    path.write_bytes(content[:at] + b"\1" + content[at + 1 :])
    log = McapLog(path)
    (loss,) = (numbers_of(log), log.losses)[1]
    assert "its checksum is wrong" in loss.reason


def test_stopping_early_ends_the_threads(tmp_path, monkeypatch):
    """A closed iteration leaves no thread and no open file behind."""
    monkeypatch.setattr(threads, "available_cores", lambda: 3)
    monkeypatch.setattr(parts, "GROUP", 1)
    log = McapLog(saved(tmp_path, written(messages=2000)))
    before = set(threading.enumerate())
    blocks = log.blocks(IMU)
    next(blocks)
    assert set(threading.enumerate()) - before
    blocks.close()
    assert set(threading.enumerate()) <= before


@pytest.mark.parametrize(
    ("begin", "error", "reason"),
    [
        (b"#ROSBAG V2.0\n", DamagedLogError, "it does not begin as an MCAP file; check"),
        (b"\x89MCAP1\r\n", UnsupportedLogError, "it is MCAP of version '1' and only version '0'"),
        (MAGIC, DamagedLogError, "nothing of it can be read; byte 8: no record begins"),
    ],
)
def test_files_that_are_no_mcap_are_refused(tmp_path, begin, error, reason):
    """Each refusal is one sentence with the file and the way out."""
    with pytest.raises(error, match=f"log.mcap: {reason}"):
        McapLog(saved(tmp_path, begin + bytes(99)))
    with pytest.raises(UnreadableLogError, match=r"gone.mcap: no such file or folder; check"):
        McapLog(tmp_path / "gone.mcap")
    with pytest.raises(UnreadableLogError, match="it is a folder, not a file"):
        McapLog(tmp_path)


def test_a_file_that_is_removed_is_read_to_its_end(tmp_path):
    """A log that is removed after it was opened is still open, and read whole."""
    path = saved(tmp_path, written())
    with McapLog(path) as log:
        path.unlink()
        assert sorted(read(log)) == sorted(truth(written()))
        assert log.losses == []


@example(lengths=[(261, 20, 5), (261, 3, 4)], rest=0)  # 261 has the opcode as its first byte
@given(
    lengths=st.lists(
        st.tuples(st.integers(22, 40), st.integers(1, 90), st.sampled_from([5, 5, 5, 4, 3, 0x80])),
        max_size=8,
    ),
    rest=st.integers(0, 12),
)
def test_walking_finds_every_message_record(lengths, rest):
    """Runs of equal records, however long and however mixed, are followed exactly."""
    data, expected, others = bytearray(), [], []
    for length, repeat, opcode in lengths:
        for _ in range(repeat):
            if opcode == 5:
                expected.append(len(data))
            elif opcode in {3, 4}:
                others.append((opcode, len(data) + 9, len(data) + 9 + length))
            data += struct.pack("<BQ", opcode, length) + bytes(length)
    whole = len(data)
    data += (struct.pack("<BQ", 5, 22) + bytes(22))[:rest]
    found = walk_records(data)
    assert found.offsets.tolist() == expected
    assert found.definitions == others
    assert found.end == whole


END = struct.pack("<BQ", 15, 4) + bytes(4) + struct.pack("<BQ", 2, 20) + bytes(20) + MAGIC


def one_topic(path, topic, first_ns, **options):
    """Write a log of one topic, whose channel has id 1; return its bytes."""
    messages = [(first_ns + number, {"n": number}) for number in range(40)]
    topics = {topic: Topic("", messages)}
    return write_topics(path, topics, **{"chunk_size": 300, **options}).read_bytes()


@pytest.mark.parametrize("options", [{}, {"use_chunking": False}, {"enable_crcs": False, **PLAIN}])
def test_logs_one_behind_another_are_all_read(tmp_path, options):
    """Logs joined by `cat` have the messages of each, under its own topics; one may be cut."""
    parts = [
        written(**options),
        one_topic(tmp_path / "b", "/other", 5000, **options),
        written(first_ns=9000, **options),
    ]
    log = McapLog(saved(tmp_path, b"".join(parts)))
    expected = [message for part in parts for message in truth(part)]
    assert sorted(read(log)) == sorted(expected)
    assert log.losses == []
    assert [channel.topic for channel in log.channels()] == ["/bare", "/imu", "/other", "/silent"]
    cut = McapLog(saved(tmp_path, b"".join(parts)[: -len(parts[2]) // 2]))
    assert set(truth(parts[0]) + truth(parts[1])) < set(read(cut)) < set(expected)
    assert cut.losses


@pytest.mark.parametrize("end", [b"", struct.pack("<BQ", 15, 4) + bytes(4)])
@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_what_a_chunk_is_told_by_is_what_stands_before_it(tmp_path, compression, end):
    """An id that is defined anew is another topic; where a data end stands decides nothing."""
    parts = [
        one_topic(tmp_path / topic[1:], topic, first_ns, compression=compression)
        for topic, first_ns in (("/one", 1000), ("/two", 2000))
    ]
    header = parts[0][: 8 + 9 + struct.unpack_from("<Q", parts[0], 9)[0]]
    data = []
    for part in parts:
        (_, _, begin), *_ = records(part)
        data.append(unclosed(part)[begin:])
    log = McapLog(saved(tmp_path, header + data[0] + end + data[1] + END))
    assert sorted(read(log)) == sorted(truth(parts[0]) + truth(parts[1]))
    assert log.losses == []


@pytest.mark.parametrize("compression", list(CompressionType))
def test_chunks_that_state_no_size_are_read(tmp_path, compression):
    """An uncompressed size of 0 states none, where there is data."""
    content = bytearray(one_topic(tmp_path / "a", "/one", 1000, compression=compression))
    for opcode, begin, _ in records(bytes(content)):
        if opcode == 6:
            content[begin + 9 + 16 : begin + 9 + 24] = bytes(8)
    log = McapLog(saved(tmp_path, bytes(content)))
    assert len(read(log)) == 40
    assert log.losses == []
