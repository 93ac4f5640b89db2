"""ROS 1 bags, message for message against rosbags' own reader: whole, lying and damaged."""

import itertools
import random
import re
import struct

import numpy as np
import pytest
from make.container_messages import messages_of, rosbags_messages, rows_of
from make.places import SAMPLE_LOGS
from make.ros import ROS1
from make.worn import wear
from rosbags.rosbag1 import Reader, Writer

from quatprop.base.errors import DamagedLogError, Loss, UnreadableLogError, UnsupportedLogError
from quatprop.readers.containers import rosbag1_walk
from quatprop.readers.containers.rosbag1 import Rosbag1Log
from quatprop.readers.containers.rosbag1_index import RecordFile, record_at

T0 = 1_700_000_000_000_000_000
TEXT = "std_msgs/msg/String"
COMPRESSIONS = (None, "BZ2", "LZ4")
IMU = ("/imu", "sensor_msgs/msg/Imu")


def messages(path):
    """Return the messages of each topic and type, and what was lost."""
    return messages_of(Rosbag1Log(path))


def writer_of(path, threshold, compression=None):
    """Return rosbags' writer of chunks of a size."""
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    writer.chunk_threshold = threshold
    return writer


def write_bag(path, *, compression=None, threshold=2000, count=300):
    """Write a bag with two topics, one of them over two connections, and messages of all sizes."""
    rng = np.random.default_rng(7)
    with writer_of(path, threshold, compression) as writer:
        imu = [
            writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=ROS1, callerid=name)
            for name in ("/a", "/b")
        ]
        text = writer.add_connection("/text", TEXT, typestore=ROS1)
        empty = writer.add_connection("/empty", "std_msgs/msg/Empty", typestore=ROS1)
        for k in range(count):
            log_ns = T0 + 1_000_000 * k
            writer.write(imu[k % 3 == 0], log_ns, rng.bytes(324))
            if k % 5 == 0:
                writer.write(text, log_ns, rng.bytes(int(rng.integers(4, 400))))
            if k % 7 == 0:
                writer.write(empty, log_ns, b"")
    return path


def chunks_of(path):
    """Return where each chunk begins and how many messages it has, by rosbags."""
    with Reader(path) as reader:
        infos = sorted(reader.chunk_infos, key=lambda info: info.pos)
    return [(info.pos, sum(info.connection_counts.values())) for info in infos]


def header_end(bag):
    """Return where the bag header record ends."""
    (length,) = struct.unpack_from("<I", bag, 13)
    (padding,) = struct.unpack_from("<I", bag, 17 + length)
    return 21 + length + padding


def index_place(content):
    """Return where the index of the whole bag begins, from the bag header."""
    return struct.unpack_from("<Q", content, content.index(b"index_pos=") + 10)[0]


def set_index_place(bag, place):
    """Let the bag header say that the index begins elsewhere."""
    struct.pack_into("<Q", bag, bag.index(b"index_pos=") + 10, place)


def unindexed(path, cut=None):
    """Take the index from a bag, as if it had not been closed, and cut it off."""
    bag = bytearray(path.read_bytes())
    end = index_place(bag) if cut is None else cut
    set_index_place(bag, 0)
    unclosed = path.with_suffix(".bag.active")
    unclosed.write_bytes(bag[:end])
    return unclosed


def head_of(*fields):
    """Return the header of a record."""
    head = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    return struct.pack("<I", len(head)) + head


def test_a_cut_bag_says_what_is_lost(tmp_path):
    """A bag that was not closed and is cut within a chunk gives what is before the cut."""
    path = write_bag(tmp_path / "a.bag", threshold=100_000, count=100)
    start = header_end(path.read_bytes())
    found, losses = messages(unindexed(path, 20_000))
    assert losses == [Loss(f"chunk at byte {start}", "its end is cut off")]
    assert 40 < sum(map(len, found.values())) < 70
    packed = write_bag(tmp_path / "b.bag", compression="LZ4")
    last, missing = chunks_of(packed)[-1]
    found, losses = messages(unindexed(packed, last + 100))
    assert losses == [Loss(f"chunk at byte {last}", "its lz4 data is cut off")]
    assert sum(map(len, found.values())) == 403 - missing


def test_a_damaged_chunk_of_an_indexed_bag_loses_only_itself(tmp_path):
    """A packed chunk that does not unpack is a loss with its number of messages; others stay."""
    path = write_bag(tmp_path / "a.bag", compression="BZ2")
    with Reader(path) as reader:
        chunk = reader.chunk_infos[3]
    bag = bytearray(path.read_bytes())
    bag[chunk.pos + 200 : chunk.pos + 220] = bytes(20)
    path.write_bytes(bag)
    expected = chunk.connection_counts[0] + chunk.connection_counts[1]
    with Rosbag1Log(path) as log:
        imu = log.channels()[1]
        for _ in range(2):  # reading twice does not count twice
            assert sum(len(block) for block in log.blocks(imu)) == 300 - expected
        reason = "its bz2 data is damaged"
        assert log.losses == [Loss(f"chunk at byte {chunk.pos}", reason, expected)]


@pytest.mark.parametrize("harm", ["shifted", "repeated", "foreign", "beyond", "fewer"])
def test_an_index_that_lies_is_found_out(tmp_path, harm):
    """Index data that point elsewhere do not change the messages: the chunk is walked instead."""
    path = write_bag(tmp_path / "a.bag", threshold=20_000)
    expected = rosbags_messages(path)
    bag = bytearray(path.read_bytes())
    at = bag.index(b"op=\x04")
    record = bag.index(b"count=", at)
    (count,) = struct.unpack_from("<I", bag, record + 6)
    assert count > 1
    entries = record + 14
    (offset,) = struct.unpack_from("<I", bag, entries + 8)
    (second,) = struct.unpack_from("<I", bag, entries + 20)
    lies = {"shifted": offset + 1, "repeated": second, "foreign": 0, "beyond": 0xFFFFFFFF}
    if harm == "fewer":
        struct.pack_into("<I", bag, record + 6, count - 1)
    else:
        struct.pack_into("<I", bag, entries + 8, lies[harm])
    path.write_bytes(bag)
    assert messages(path) == (expected, [])


def test_an_index_may_list_no_messages_of_a_topic(tmp_path):
    """As a chunk info may count none: there are none of it in that chunk."""
    path = write_bag(tmp_path / "a.bag", threshold=700)
    expected, bag = rosbags_messages(path), bytearray(path.read_bytes())
    imu, text = 0, 2
    number, *last = struct.unpack("<4I", bag[-16:])  # of connections in the last chunk, its info
    assert (number, last[1]) == (1, imu)
    bag[-16:] = struct.pack("<6I", 2, 16, *last[1:], text, 0)
    empty = head_of(
        b"op=\4", b"ver=\1\0\0\0", b"conn=" + struct.pack("<I", text), b"count=" + bytes(4)
    )
    end = index_place(bag)
    bag[end:end] = empty + bytes(4)
    set_index_place(bag, end + len(empty) + 4)
    path.write_bytes(bag)
    assert messages(path) == (expected, [])


def test_index_data_that_cannot_be_read_are_done_without(tmp_path, monkeypatch):
    """A worn memory card fails at some places only."""
    path = write_bag(tmp_path / "a.bag")
    expected = rosbags_messages(path)
    with Reader(path) as reader:
        wear(monkeypatch, {chunk.datapos + chunk.datasize for chunk in reader.chunks.values()})
    assert messages(path) == (expected, [])


def test_a_sector_that_cannot_be_read_costs_its_chunks_in_a_bag_without_an_index(
    tmp_path, monkeypatch
):
    """It was an error of this program, where a record began in it."""
    path = write_bag(tmp_path / "a.bag")
    expected, chunks = rosbags_messages(path), chunks_of(path)
    path.write_bytes(path.read_bytes()[: chunks[-1][0]])
    begin = chunks[20][0] - 100
    end = begin + 4096
    wear(monkeypatch, sector=range(begin, end))
    found, losses = messages(path)
    assert any("it cannot be read: 'Input/output error'" in loss.reason for loss in losses)
    for name, rows in found.items():
        assert {*rows} <= {*expected[name]}
    # The next record is searched for in steps of as many bytes.
    outside = [
        count
        for (place, count), (after, _) in itertools.pairwise(chunks)
        if after <= begin or place >= end + 4096
    ]
    assert len(chunks) - len(outside) < 7
    assert sum(map(len, found.values())) >= sum(outside)


def test_a_bag_that_is_gone_while_its_index_is_built_anew_is_refused(tmp_path, monkeypatch):
    """The index turns out to be damaged only when messages are read."""
    bag = bytearray((SAMPLE_LOGS / "tumbling.bag").read_bytes())
    bag[bag.rindex(b"op=\6") - 26] ^= 8  # in a chunk info
    (tmp_path / "log.bag").write_bytes(bag)
    log = Rosbag1Log(tmp_path / "log.bag")
    monkeypatch.setattr("quatprop.stores.file_source.MAX_SECTORS", 0)
    wear(monkeypatch)
    with pytest.raises(UnreadableLogError, match=r"it cannot be read: 'Input/output error'$"):
        [*log.blocks(log.channels()[0])]


def test_messages_outside_any_chunk_are_read(tmp_path):
    """Connections and messages directly in the file, which the format allows, are read."""
    path = write_bag(tmp_path / "a.bag", threshold=1 << 20, count=50)
    expected = rosbags_messages(path)
    with Reader(path) as reader:
        (chunk,) = reader.chunks.values()
    bag = bytearray(path.read_bytes())
    inner = bag[chunk.datapos : chunk.datapos + chunk.datasize]
    set_index_place(bag, 0)
    path.write_bytes(bag[: header_end(bag)] + inner)
    assert messages(path) == (expected, [])
    at = inner.rindex(b"op=\2", 0, inner.rindex(b"op=\2"))  # of the last but one, which is damaged
    path.write_bytes(bag[: header_end(bag)] + inner[: at - 30] + bytes(40) + inner[at + 10 :])
    found, (loss,) = messages(path)
    assert sum(map(len, found.values())) == sum(map(len, expected.values())) - 1
    assert "bytes are skipped" in loss.reason


def test_a_bag_that_ends_behind_its_header_is_cut_there(tmp_path):
    """The header has a record of 4096 bytes, most of which is padding and holds no records."""
    content = write_bag(tmp_path / "log.bag").read_bytes()
    (tmp_path / "log.bag").write_bytes(content[: 13 + 4096])
    log = Rosbag1Log(tmp_path / "log.bag")
    assert log.channels() == []
    reason = f"it ends before its index, which should begin at byte {index_place(content)}"
    assert log.losses == [Loss("byte 4109", reason)]


@pytest.mark.parametrize("index_pos", [5, 1 << 60])
def test_an_index_that_is_not_there_is_done_without(tmp_path, index_pos):
    """An index position that points nowhere is not believed."""
    path = write_bag(tmp_path / "a.bag")
    expected = rosbags_messages(path)
    bag = bytearray(path.read_bytes())
    set_index_place(bag, index_pos)
    path.write_bytes(bag)
    assert messages(path) == (expected, [])


def test_messages_of_a_connection_without_a_record_are_counted(tmp_path):
    """Nobody can say what they hold."""
    path = tmp_path / "log.bag"
    content = written(path)
    content = content[: index_place(content)].replace(b"topic=", b"topix=")
    reason = "its connection record is missing"
    assert read(path, content) == ([], [Loss("connection 0", reason, MESSAGES)])


def test_bags_of_another_kind_are_refused(tmp_path):
    """Another version or encryption is named, with the way out."""
    path = tmp_path / "no.bag"
    path.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(UnsupportedLogError, match=r"version 1\.2 and only 2\.0 is read; migrate"):
        Rosbag1Log(path)
    header = head_of(b"op=\3", b"index_pos=" + bytes(8), b"encryptor=rosbag/AesCbcEncryptor")
    path.write_bytes(b"#ROSBAG V2.0\n" + header + bytes(4))
    sentence = (
        r"no\.bag: it is encrypted with 'rosbag/AesCbcEncryptor'; decrypt it with `rosbag decrypt`"
    )
    with pytest.raises(UnsupportedLogError, match=sentence):
        Rosbag1Log(path)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it does not begin like a ROS 1 bag; check kind"),
        (b"time,x,y,z\n", "it does not begin like a ROS 1 bag; check kind"),
        (b"#ROSBAG V2.0\n", "its bag header is damaged; try `rosbag reindex`"),
        (b"#ROSBAG V2.0\n\xff\xff\xff\xff", "its bag header is damaged; try `rosbag reindex`"),
    ],
)
def test_what_is_no_bag_is_refused(tmp_path, content, reason):
    """A file without a bag header is refused in one sentence."""
    path = tmp_path / "no.bag"
    path.write_bytes(content)
    with pytest.raises(DamagedLogError) as caught:
        Rosbag1Log(path)
    assert str(caught.value) == f"{path}: {reason}"


def with_images(path, *, messages=400, picture=40_000):
    """Write a bag of small messages, each ninth followed by a large one of another topic."""
    with writer_of(path, 1 << 20) as writer:
        one, two, camera = (
            writer.add_connection(topic, TEXT, typestore=ROS1, callerid=who)
            for topic, who in (("/imu", "one"), ("/imu", "two"), ("/camera", "three"))
        )
        for number in range(messages):
            content = ROS1.types[TEXT]("x" * (number % 5) + str(number))
            packed = bytes(ROS1.serialize_ros1(content, TEXT))
            writer.write(one if number % 3 else two, T0 + number, packed)
            if number % 9 == 0:
                writer.write(camera, T0 + number, struct.pack("<I", picture) + bytes(picture))
    return path


def test_images_next_to_messages_are_not_read(tmp_path, monkeypatch):
    """Of a chunk that is not packed, only what is wanted leaves the disk."""
    path = with_images(tmp_path / "log.bag", messages=2000)
    read = []
    original = RecordFile.at

    def counted(file, start, size):
        data = original(file, start, size)
        read.append(len(data))
        return data

    monkeypatch.setattr(RecordFile, "at", counted)
    with Rosbag1Log(path) as log:
        (imu,) = (channel for channel in log.channels() if channel.topic == "/imu")
        read.clear()
        assert sum(map(len, log.blocks(imu))) == 2000
    assert sum(read) < path.stat().st_size / 20


def test_messages_next_to_images_are_all_there(tmp_path):
    """Also where the index data do not lead to them, so that the chunk is read whole."""
    path = with_images(tmp_path / "log.bag")
    expected = rosbags_messages(path)
    assert messages(path) == (expected, [])
    content = bytearray(path.read_bytes())
    entry = struct.pack("<II", T0 // 10**9, 10)  # what follows an image is read by itself
    at = content.rindex(entry) + len(entry)
    (offset,) = struct.unpack_from("<I", content, at)
    struct.pack_into("<I", content, at, offset + 1)
    path.write_bytes(content)
    assert messages(path) == (expected, [])
    struct.pack_into("<I", content, at, offset)
    at = content.rindex(b"count=", 0, at) + 6
    (count,) = struct.unpack_from("<I", content, at)
    struct.pack_into("<I", content, at, count - 1)
    path.write_bytes(content)
    assert messages(path) == (expected, [])


def test_a_bag_next_to_images_may_be_cut_anywhere(tmp_path):
    """Messages before the cut are read, whatever the index of the last chunk would have had."""
    path = with_images(tmp_path / "log.bag")
    expected, content = rosbags_messages(path)["/imu", TEXT], path.read_bytes()
    for size in range(len(content) // 12, len(content), len(content) // 12):
        path.write_bytes(content[:size])
        found, losses = messages(path)
        rows = found.get(("/imu", TEXT), [])
        assert losses
        assert rows == expected[: len(rows)]
        # The messages of a whole chunk and of the front of the one that is cut.
        assert len(rows) >= len(expected) * (size - 100_000) // len(content) - 9


MESSAGES = 400


def written(path, compression=None):
    """Write a bag of one topic in chunks of some dozen messages; return its bytes."""
    with writer_of(path, 3000, compression) as writer:
        connection = writer.add_connection("/text", TEXT, typestore=ROS1)
        for number in range(MESSAGES):
            content = f"{number:08d}{hash((number, 1)):032d}".encode()
            writer.write(connection, 1000 * number, struct.pack("<I", len(content)) + content)
    return path.read_bytes()


def read(path, content):
    """Return the numbers in the messages of a bag, and what is told as lost."""
    path.write_bytes(content)
    with Rosbag1Log(path) as log:
        numbers = [
            int(block.data[start:end][4:12].tobytes())
            for channel in log.channels()
            for block in log.blocks(channel)
            for start, end in zip(block.starts, block.ends, strict=True)
        ]
    return numbers, log.losses


def contents(path, content):
    """Return the bytes of the messages of a bag, of which something is told as lost if any is."""
    path.write_bytes(content)
    with Rosbag1Log(path) as log:
        found = [
            block.data[start:end].tobytes()
            for channel in log.channels()
            for block in log.blocks(channel)
            for start, end in zip(block.starts, block.ends, strict=True)
        ]
    assert log.losses or len(found) == MESSAGES
    return found


def numbers_of(chunks, chunk):
    """Return the numbers of the messages in a chunk."""
    before = sum(count for _, count in chunks[:chunk])
    return set(range(before, before + chunks[chunk][1]))


def longer(bag, place):
    """Return a bag whose chunk at a place ends in the middle of one behind it."""
    at = place + 4 + int.from_bytes(bag[place : place + 4], "little")
    size = int.from_bytes(bag[at : at + 4], "little") + 2000
    return bag[:at] + size.to_bytes(4, "little") + bag[at + 4 :]


HARMS = {
    "a length into a later chunk": longer,
    "a hole in the data": lambda b, place: b[: place + 200] + b[place + 277 :],
    "zeros over the head": lambda b, place: b[:place] + bytes(40) + b[place + 40 :],
    "a length beyond the file": lambda b, place: b[:place] + b"\xff" * 4 + b[place + 4 :],
    "bytes too many": lambda b, place: b[: place + 300] + b"op=\x05" * 30 + b[place + 300 :],
    "an unknown kind": lambda b, place: b[:place] + b[place:].replace(b"op=\5", b"op=\x09", 1),
    "no size": lambda b, place: b[:place] + b[place:].replace(b"size=", b"sizf=", 1),
    "no compression": lambda b, place: b[:place] + b[place:].replace(b"compr", b"compq", 1),
}


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("harm", HARMS)
@pytest.mark.parametrize("indexed", [True, False])
def test_what_follows_damage_is_read(tmp_path, compression, harm, indexed):
    """Damage in one chunk costs no other, whether the bag was closed or not.

    Of 30 missing messages 64 were said to be: those outside of the chunk had its index data.
    """
    path = tmp_path / "log.bag"
    intact = written(path, compression)
    places = chunks_of(path)
    content = HARMS[harm](intact, places[4][0])
    if not indexed:
        content = content[: index_place(intact) + len(content) - len(intact)]
    numbers, losses = read(path, content)
    assert numbers == sorted(set(numbers))
    # The messages of a plain chunk are found without its head.
    is_found = not compression and harm not in {"a hole in the data", "bytes too many"}
    missing = set() if is_found else numbers_of(places, 4)
    assert set(range(MESSAGES)) - missing <= set(numbers)
    assert losses
    assert sum(loss.messages or 0 for loss in losses) in {0, MESSAGES - len(numbers)}


@pytest.mark.parametrize(
    ("fields", "size"),
    [
        ((b"op=\3", b"index_pos=" + bytes(8)), 1 << 30),
        ((b"op=\4", b"count=\0\0\1\0"), 12 << 16),
        ((b"op=\6", b"count=\0\0\1\0"), 8 << 16),
        ((b"op=\2", b"time=" + bytes(8)), 0),
        ((b"op=\2", b"conn=" + bytes(4)), 0),
    ],
)
def test_what_ends_behind_the_file_or_lacks_a_field_is_no_record(tmp_path, fields, size):
    """Behind damage, what looks like the header of one is passed over."""
    path = tmp_path / "log.bag"
    content = written(path)
    content, begin = content[: index_place(content)], chunks_of(path)[4][0]
    damage = bytes(50) + head_of(*fields) + struct.pack("<I", size)
    numbers, (loss,) = read(path, content[:begin] + damage + content[begin:])
    assert numbers == list(range(MESSAGES))
    assert loss.place == f"byte {begin}"
    assert loss.reason.endswith(f"; {len(damage)} bytes are skipped")


def test_a_record_in_whose_header_another_seems_to_begin_is_found(tmp_path):
    """Behind damage, where a field that is not known could be the header of a record."""
    path, seeming = tmp_path / "log.bag", b"a=" + struct.pack("<II", 14, 10) + b"b="
    content = written(path)
    content, begin = content[: index_place(content)], chunks_of(path)[4][0]
    field, at = struct.pack("<I", len(seeming)) + seeming, content.index(b"\4\0\0\0op=\5", begin)
    size = int.from_bytes(content[begin : begin + 4], "little") + len(field)
    head = bytes(50) + size.to_bytes(4, "little") + content[begin + 4 : at] + field
    numbers, (loss,) = read(path, content[:begin] + head + content[at:])
    assert numbers == list(range(MESSAGES))
    assert loss.reason.endswith("; 50 bytes are skipped")


@pytest.mark.parametrize("chunk", [0, 4])
def test_messages_of_a_plain_chunk_are_found_without_its_head(tmp_path, chunk):
    """The records inside a chunk that is not packed can be followed by themselves."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin = chunks_of(path)[chunk][0]
    content = intact[: index_place(intact)]
    content = content[:begin] + bytes(8) + content[begin + 8 :]
    numbers, losses = read(path, content)
    assert numbers == list(range(MESSAGES))
    assert losses[0].place == (f"byte {begin}" if chunk else "byte 90")  # in the padding before it


def test_messages_whose_fields_have_other_lengths_are_lost(tmp_path):
    """The index leads to each of them, but not to a number of its connection."""
    path = tmp_path / "log.bag"
    content = written(path)
    wrong = b"\x0d\0\0\0conn=" + bytes(8) + b"\x09\0\0\0time="
    content, count = re.subn(
        rb"\x09\0\0\0conn=\0{4}\x0d\0\0\0time=.{4}", wrong, content, flags=re.DOTALL
    )
    assert count == MESSAGES
    numbers, losses = read(path, content)
    assert numbers == []
    assert {loss.reason for loss in losses} == {"its field conn is missing or damaged"}
    assert sum(loss.messages for loss in losses) == MESSAGES


def test_what_is_missing_of_a_plain_chunk_without_its_head_is_counted(tmp_path):
    """Its messages are found one by one, and its info says how many there were."""
    path = tmp_path / "log.bag"
    content = bytearray(written(path))
    begin, _ = chunks_of(path)[4]
    damaged = min(numbers_of(chunks_of(path), 4)) + 7
    content[begin : begin + 8] = bytes(8)
    content[content.rindex(b"op=\2", 0, content.index(f"{damaged:08d}".encode())) + 3] = 9
    numbers, losses = read(path, bytes(content))
    assert numbers == [number for number in range(MESSAGES) if number != damaged]
    told = [loss for loss in losses if loss.messages]
    assert told == [Loss(f"chunk at byte {begin}", "a part of it is missing", 1)]


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        ("length", "a record in it is damaged or cut off"),
        ("kind", "a record in it is of another kind"),
    ],
)
def test_a_damaged_message_in_a_chunk_costs_itself(tmp_path, indexed, harm, reason):
    """The index data behind a chunk tell where its messages go on."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin, _ = chunks_of(path)[4]
    damaged = min(numbers_of(chunks_of(path), 4)) + 7
    at = intact.index(f"{damaged:08d}".encode()) - 8  # the length of its data
    assert begin < at
    content = bytearray(intact if indexed else intact[: index_place(intact)])
    if harm == "kind":
        content[content.rindex(b"op=\2", 0, at) + 3] = 3
    else:
        content[at : at + 4] = b"\xff\xff\xff\x7f"
    numbers, losses = read(path, bytes(content))
    assert numbers == [number for number in range(MESSAGES) if number != damaged]
    assert Loss(f"chunk at byte {begin}", reason, 1) in losses


@pytest.mark.parametrize("junk", [b"\xaa" * 100, b"\0", bytes(33)], ids=len)
@pytest.mark.parametrize("indexed", [True, False])
def test_bytes_inserted_into_a_plain_chunk_cost_the_messages_that_they_hit(tmp_path, junk, indexed):
    """They cost the rest of the chunk, and the message in which they stood was read with them."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin, end = (chunks_of(path)[k][0] for k in (4, 5))
    expected = contents(path, intact)
    for place in range(begin, end - 400, 233):  # in the messages, not in the index data
        content = intact[:place] + junk + intact[place:]
        found = contents(path, content if indexed else content[: index_place(intact) + len(junk)])
        assert found == [message for message in expected if message in {*found}]
        assert len(found) >= len(expected) - 2


FULL_OF_FIELDS = {
    "messages": b"\4\0\0\0op=\2",
    "chunks": b"\4\0\0\0op=\5",
    "among zeros": bytes(24) + b"\4\0\0\0op=\2",
}


@pytest.mark.parametrize("name", FULL_OF_FIELDS)
@pytest.mark.parametrize("indexed", [True, False])
def test_bytes_full_of_fields_are_passed_over(tmp_path, monkeypatch, name, indexed):
    """Only what may be in a header is tried: the search took a minute, or gave up."""
    path = tmp_path / "log.bag"
    intact, pattern = written(path), FULL_OF_FIELDS[name]
    begin = chunks_of(path)[4][0]
    expected = contents(path, intact)
    junk = pattern * (600_000 // len(pattern))
    place = begin + 500
    content = intact[:place] + junk + intact[place:]
    tried = []

    def counting(data, at, origin=0):
        tried.append(at)
        return record_at(data, at, origin)

    monkeypatch.setattr(rosbag1_walk, "record_at", counting)
    found = contents(path, content if indexed else content[: index_place(intact) + len(junk)])
    assert found == [message for message in expected if message in {*found}]
    assert len(found) >= len(expected) - 2
    assert len(tried) < 10_000


@pytest.mark.parametrize("count", [1, 50, 200])
def test_bytes_lost_from_a_plain_chunk_cost_the_messages_that_they_hit(tmp_path, count):
    """A message whose bytes were lost was completed by those behind it."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin, end = (chunks_of(path)[k][0] for k in (4, 5))
    expected = contents(path, intact)
    for place in range(begin, end - 800, 233):
        found = contents(path, intact[:place] + intact[place + count :])
        assert found == [message for message in expected if message in {*found}]
        assert len(found) >= len(expected) - 3 - count // 80


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_torn_chunk_gives_what_can_be_unpacked_of_it(tmp_path, compression):
    """Of the chunk that a dying recorder was writing, the front is read."""
    path, noise = tmp_path / "log.bag", random.Random(1).randbytes(5000)
    with writer_of(path, 1 << 30, compression) as writer:
        connection = writer.add_connection("/text", TEXT, typestore=ROS1)
        for number in range(4000):
            content = f"{number:08d}".encode() + noise[number : number + 500]
            writer.write(connection, 1000 * number, struct.pack("<I", len(content)) + content)
    ((begin, _),) = chunks_of(path)
    intact = path.read_bytes()
    data = begin + 8 + int.from_bytes(intact[begin : begin + 4], "little")
    size = int.from_bytes(intact[data - 4 : data], "little")
    numbers, losses = read(path, intact[: data + 9 * size // 10])
    assert numbers == list(range(len(numbers)))
    assert 1500 < len(numbers) < 4000
    assert [loss.place for loss in losses] == [f"chunk at byte {begin}"]


def two_topics(path, topics, first):
    """Write a bag with messages of two topics in turn, their connections in the given order."""
    with writer_of(path, 2000) as writer:
        connections = [writer.add_connection(topic, TEXT, typestore=ROS1) for topic in topics]
        for number in range(first, first + MESSAGES):
            content = struct.pack("<I", 8) + f"{number:08d}".encode()
            writer.write(connections[number % 2], 1000 * number, content)
    return path.read_bytes()


JOINTS = {
    "closed": lambda content: (content, b""),
    "not closed": lambda content: (content[: index_place(content)], b""),
    "half an index": lambda content: (content[: index_place(content) + 40], b""),
    "damage between them": lambda content: (content, bytes(30)),
}


@pytest.mark.parametrize("joint", JOINTS)
def test_a_bag_behind_another_is_read(tmp_path, joint):
    """The numbers of its connections are its own, and so are the places in its index."""
    first, second = tmp_path / "first.bag", tmp_path / "second.bag"
    front, between = JOINTS[joint](two_topics(first, ["/a", "/b"], 0))
    path = tmp_path / "log.bag"
    path.write_bytes(front + between + two_topics(second, ["/b", "/c"], MESSAGES - 20))
    expected = rosbags_messages(first)
    for name, rows in rosbags_messages(second).items():
        expected[name] = sorted(expected.get(name, []) + rows)
    found, losses = messages(path)
    assert found == expected
    assert bool(losses) == (joint in {"half an index", "damage between them"})
    with Rosbag1Log(path) as log:
        counts = {(channel.topic, TEXT): channel.count for channel in log.channels()}
    assert counts == {name: len(rows) for name, rows in expected.items()}


@pytest.mark.parametrize("at", [2, 13 + 20])
def test_a_damaged_beginning_of_a_second_bag_gives_no_topic_the_messages_of_another(tmp_path, at):
    """Where it is not clear what a connection number means, its messages are counted as lost."""
    first, second = tmp_path / "first.bag", tmp_path / "second.bag"
    two_topics(first, ["/a", "/b"], 0)
    damaged = bytearray(two_topics(second, ["/b", "/c"], MESSAGES))
    damaged[at : at + 8] = bytes(8)
    path = tmp_path / "log.bag"
    path.write_bytes(first.read_bytes() + damaged)
    found, losses = messages(path)
    front, behind = rosbags_messages(first), rosbags_messages(second)
    assert losses
    assert found["/a", TEXT] == front["/a", TEXT]
    assert set(found["/b", TEXT]) <= set(front["/b", TEXT] + behind["/b", TEXT])


@pytest.mark.parametrize("other", ["/empty", 99])
@pytest.mark.parametrize("harm", [b"", bytes(8)])
def test_a_chunk_whose_info_does_not_name_a_topic_is_read_for_it(tmp_path, other, harm):
    """Its index data name the topic, and its records are there; of no topic nothing is lost.

    Also where its head is damaged, so that nobody knows where its index data begin.
    """
    path = write_bag(tmp_path / "log.bag")
    expected, bag = rosbags_messages(path), bytearray(path.read_bytes())
    with Reader(path) as reader:
        ids = {each.topic: each.id for each in reader.connections}
        text, wrong = ids["/text"], ids.get(other, other)
        info = next(
            info
            for info in reader.chunk_infos
            if text in info.connection_counts and wrong not in info.connection_counts
        )
    at = bag.index(b"chunk_pos=" + struct.pack("<Q", info.pos), index_place(bag))
    at = bag.index(struct.pack("<II", text, info.connection_counts[text]), at)
    struct.pack_into("<I", bag, at, wrong)
    bag[info.pos : info.pos + len(harm)] = harm
    path.write_bytes(bag)
    with Rosbag1Log(path) as log:
        (channel,) = (channel for channel in log.channels() if channel.topic == "/text")
        assert rows_of(log, channel) == expected["/text", TEXT]
    found, losses = messages(path)
    assert (found, len(losses)) == (expected, 2 if harm else other == "/empty")


@pytest.mark.parametrize("harm", ["head", "head and index data", "kind"])
def test_a_chunk_whose_head_is_damaged_has_the_amount_of_its_info(tmp_path, harm):
    """Losses that the index shows are reported, though the records must be walked.

    Also where the first records of the index are damaged: those behind them are found.
    """
    path = tmp_path / "log.bag"
    content = bytearray(written(path, "LZ4"))
    chunks = chunks_of(path)
    begin, count = chunks[4]
    if harm == "kind":
        content[content.index(b"op=\5", begin) + 3] = 9
    else:
        content[begin : begin + 4] = bytes(4)
    if harm == "head and index data":
        end = chunks[5][0]
        at = content.rindex(b"count=", begin, end) - 30
        content[at : at + 20] = bytes(20)
        for kind in (b"op=\7", b"op=\6"):
            at = content.index(kind, index_place(content))
            content[at : at + 4] = bytes(4)
    numbers, losses = read(path, bytes(content))
    assert set(range(MESSAGES)) - {*numbers} == numbers_of(chunks, 4)
    assert sum(loss.messages or 0 for loss in losses) == count
