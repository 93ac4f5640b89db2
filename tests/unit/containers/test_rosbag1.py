"""ROS 1 bags, message for message against rosbags' own reader."""

import struct
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from quatprop.containers.rosbag1.log import Rosbag1Log
from quatprop.containers.rosbag1.records import RecordFile
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.messages.blocks import Channel
from quatprop.tables.log import Loss

STORE = get_typestore(Stores.ROS1_NOETIC)
REAL = [
    "auk/auk.bag",
    "auk/auk_bz2.bag",
    "auk/auk_lz4.bag",
    "husky/test1_husky.bag",
    "irregular/test3_2014_ardrone.bag",
    "irregular/tilt_laser.bag",
    "two_imus/test1_2014_xsens.bag",
    "broken/cruise_example-unsorted-chunks.bag",
    "broken/foxglove_example.bag",
    "broken/foxglove_example-bz2.bag",
    "broken/foxglove_example-lz4.bag",
]
T0 = 1_700_000_000_000_000_000


def messages(path):
    """Return (log time, bytes) of each channel, in time order, and what was lost."""
    found = {}
    with Rosbag1Log(path) as log:
        for channel in log.channels():
            rows = []
            for block in log.blocks(channel):
                assert (block.publish_ns == block.log_ns).all()
                data = block.data.tobytes()
                rows += [
                    (log_ns, data[start:end])
                    for log_ns, start, end in zip(
                        block.log_ns.tolist(),
                        block.starts.tolist(),
                        block.ends.tolist(),
                        strict=True,
                    )
                ]
            found[channel] = sorted(rows, key=lambda row: row[0])
        # An index that is damaged is rebuilt on reading, or says that there are fewer.
        for channel in log.channels():
            assert log.losses or channel.count <= len(found.get(channel, []))
        return found, log.losses


def oracle(path):
    """Return the same from rosbags."""
    found = defaultdict(list)
    with Reader(path) as reader:
        channels = {
            connection.id: Channel(
                connection.topic,
                connection.msgtype,
                "ros1",
                "ros1msg",
                connection.msgdef.data.encode(),
            )
            for connection in reader.connections
        }
        for connection, log_ns, data in reader.messages():
            found[channels[connection.id]].append((log_ns, bytes(data)))
    return {channel: found[channel] for channel in channels.values()}


def write_bag(path, *, compression=None, threshold=2000, count=300, disorder=0):
    """Write a bag with two topics, one of them over two connections, and messages of all sizes."""
    rng = np.random.default_rng(7)
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    writer.chunk_threshold = threshold
    with writer:
        imu = [
            writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=STORE, callerid=name)
            for name in ("/a", "/b")
        ]
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=STORE)
        empty = writer.add_connection("/empty", "std_msgs/msg/Empty", typestore=STORE)
        for k in range(count):
            late = int(rng.integers(disorder)) if disorder else 0
            log_ns = T0 + 1_000_000 * k - late
            writer.write(imu[k % 3 == 0], log_ns, rng.bytes(324))
            if k % 5 == 0:
                writer.write(text, log_ns, rng.bytes(int(rng.integers(4, 400))))
            if k % 7 == 0:
                writer.write(empty, log_ns, b"")
    return path


def chunk_infos(path):
    """Return what the index says of each chunk: where it is and what it counts."""
    with Reader(path) as reader:
        return list(reader.chunk_infos)


def header_end(bag: bytes) -> int:
    """Return where the bag header record ends."""
    (length,) = struct.unpack_from("<I", bag, 13)
    (padding,) = struct.unpack_from("<I", bag, 17 + length)
    return 21 + length + padding


def unindexed(path: Path, cut: int | None = None) -> Path:
    """Take the index from a bag, as if it had not been closed, and cut it off."""
    bag = bytearray(path.read_bytes())
    at = bag.index(b"index_pos=") + 10
    (index_pos,) = struct.unpack_from("<Q", bag, at)
    bag[at : at + 8] = bytes(8)
    unclosed = path.with_suffix(".bag.active")
    unclosed.write_bytes(bag[: index_pos if cut is None else cut])
    return unclosed


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
@pytest.mark.parametrize("disorder", [0, 50_000_000])
def test_messages_are_those_of_rosbags(tmp_path, compression, disorder):
    """Every message of a generated bag has the bytes and the time that rosbags gives it."""
    path = write_bag(tmp_path / "a.bag", compression=compression, disorder=disorder)
    assert messages(path) == (oracle(path), [])


@pytest.mark.parametrize("name", REAL)
def test_real_bags_are_read_as_rosbags_reads_them(shared_logs, name):
    """Every message of a real bag has the bytes and the time that rosbags gives it."""
    assert messages(shared_logs / name) == (oracle(shared_logs / name), [])


@pytest.mark.parametrize("name", REAL)
def test_real_bags_without_their_index(shared_logs, tmp_path, name):
    """A bag whose index was never written gives every message all the same."""
    copy = tmp_path / "copy.bag"
    copy.write_bytes((shared_logs / name).read_bytes())
    found, losses = messages(unindexed(copy))
    expected = {channel: rows for channel, rows in oracle(copy).items() if rows}
    assert (found, losses) == (expected, [])


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_connections_of_one_topic_and_type_are_one_channel(tmp_path, compression):
    """Two publishers of a topic make one channel, whose blocks follow the chunk's records."""
    path = write_bag(tmp_path / "a.bag", compression=compression)
    with Rosbag1Log(path) as log:
        channels = log.channels()
        assert [(channel.topic, channel.count) for channel in channels] == [
            ("/empty", 43),
            ("/imu", 300),
            ("/text", 60),
        ]
        assert channels[1].type_name == "sensor_msgs/msg/Imu"
        for block in log.blocks(channels[1]):
            assert (np.diff(block.starts) > 0).all()
            assert (np.diff(block.log_ns) > 0).all()


@pytest.mark.parametrize("name", ["indexed", "unindexed"])
def test_no_later_block_is_earlier_than_promised(tmp_path, name):
    """No block holds a message earlier than an earlier block promised, in disordered chunks too."""
    path = write_bag(tmp_path / "a.bag", disorder=50_000_000)
    with Rosbag1Log(path if name == "indexed" else unindexed(path)) as log:
        blocks = list(log.blocks(log.channels()[1]))
    assert len(blocks) > 20
    promises = [block.watermark_ns for block in blocks]
    assert promises == sorted(promises)
    for promise, later in zip(promises, blocks[1:], strict=False):
        assert later.log_ns.min() >= promise
    assert promises[-2] > blocks[0].log_ns.min()


def test_a_bag_that_ends_anywhere_gives_what_comes_before(tmp_path):
    """Wherever an unclosed bag is cut, its messages are the first ones, and the cut is a loss."""
    path = write_bag(tmp_path / "a.bag", threshold=3000, count=40)
    bag = path.read_bytes()
    whole = oracle(path)
    last = 0
    for cut in range(header_end(bag) + 1, bag.index(b"op=\x07", len(bag) // 2), 97):
        found, losses = messages(unindexed(path, cut))
        assert losses
        total = 0
        for channel, rows in found.items():
            assert rows == whole[channel][: len(rows)]
            total += len(rows)
        assert total >= last
        last = total
    assert last > 50


def test_a_cut_bag_says_what_is_lost(tmp_path):
    """A bag cut off within a chunk gives the messages before the cut and names the chunk."""
    path = write_bag(tmp_path / "a.bag", threshold=100_000, count=100)
    start = header_end(path.read_bytes())
    found, losses = messages(unindexed(path, 20_000))
    assert losses == [Loss(f"chunk at byte {start}", "its end is cut off")]
    assert 40 < sum(len(rows) for rows in found.values()) < 70


def test_a_cut_compressed_chunk_is_a_loss(tmp_path):
    """A bag cut off within a packed chunk gives the chunks before it and names the chunk."""
    path = write_bag(tmp_path / "a.bag", compression="LZ4")
    last = chunk_infos(path)[-1]
    found, losses = messages(unindexed(path, last.pos + 100))
    assert losses == [Loss(f"chunk at byte {last.pos}", "its lz4 data is cut off")]
    missing = sum(last.connection_counts.values())
    assert sum(len(rows) for rows in found.values()) == 403 - missing


def test_a_damaged_chunk_of_an_indexed_bag_loses_only_itself(tmp_path):
    """A packed chunk that does not unpack is a loss with its number of messages; others stay."""
    path = write_bag(tmp_path / "a.bag", compression="BZ2")
    chunk = chunk_infos(path)[3]
    bag = bytearray(path.read_bytes())
    bag[chunk.pos + 200 : chunk.pos + 220] = bytes(20)
    path.write_bytes(bag)
    with Rosbag1Log(path) as log:
        imu = log.channels()[1]
        for _ in range(2):  # reading twice does not count twice
            count = sum(len(block) for block in log.blocks(imu))
        expected = chunk.connection_counts[0] + chunk.connection_counts[1]
        assert log.losses == [
            Loss(f"chunk at byte {chunk.pos}", "its bz2 data is damaged", expected)
        ]
    assert count == 300 - expected


@pytest.mark.parametrize("harm", ["shifted", "repeated", "foreign", "beyond", "fewer"])
def test_an_index_that_lies_is_found_out(tmp_path, harm):
    """Index data that point elsewhere do not change the messages: the chunk is walked instead."""
    path = write_bag(tmp_path / "a.bag", threshold=20_000)
    expected = oracle(path)
    bag = bytearray(path.read_bytes())
    at = bag.index(b"op=\x04")
    record = bag.index(b"count=", at)
    (count,) = struct.unpack_from("<I", bag, record + 6)
    assert count > 1
    entries = record + 14
    (offset,) = struct.unpack_from("<I", bag, entries + 8)
    (second,) = struct.unpack_from("<I", bag, entries + 20)
    lie = {
        "shifted": offset + 1,
        "repeated": second,
        "foreign": 0,
        "beyond": 0xFFFFFFFF,
        "fewer": offset,
    }[harm]
    struct.pack_into("<I", bag, entries + 8, lie)
    if harm == "fewer":
        struct.pack_into("<I", bag, record + 6, count - 1)
    path.write_bytes(bag)
    assert messages(path) == (expected, [])


def test_messages_outside_any_chunk_are_read(tmp_path):
    """Connections and messages directly in the file, which the format allows, are read."""
    path = write_bag(tmp_path / "a.bag", threshold=1 << 20, count=50)
    expected = oracle(path)
    with Reader(path) as reader:
        (chunk,) = reader.chunks.values()
    bag = bytearray(path.read_bytes())
    inner = bag[chunk.datapos : chunk.datapos + chunk.datasize]
    at = bag.index(b"index_pos=") + 10
    bag[at : at + 8] = bytes(8)
    path.write_bytes(bag[: header_end(bag)] + inner)
    assert messages(path) == (expected, [])


@pytest.mark.parametrize("index_pos", [5, 1 << 60])
def test_an_index_that_is_not_there_is_done_without(tmp_path, index_pos):
    """An index position that points nowhere is not believed."""
    path = write_bag(tmp_path / "a.bag")
    expected = oracle(path)
    bag = bytearray(path.read_bytes())
    struct.pack_into("<Q", bag, bag.index(b"index_pos=") + 10, index_pos)
    path.write_bytes(bag)
    assert messages(path) == (expected, [])


def test_every_single_damaged_byte_is_survived(tmp_path):
    """A flipped byte anywhere in a bag never ends in anything but messages, losses or a refusal."""
    path = write_bag(tmp_path / "a.bag", threshold=2000, count=12)
    bag = path.read_bytes()
    rng = np.random.default_rng(3)
    start = header_end(bag)
    places = [*range(13, 90), *rng.integers(start, len(bag), 400).tolist()]
    for place in places:
        harmed = bytearray(bag)
        harmed[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(harmed)
        with suppress(DamagedLogError, UnsupportedLogError):
            messages(path)


def test_a_bag_without_messages_has_no_losses(shared_logs):
    """A valid bag with nothing in it is not damaged."""
    assert messages(shared_logs / "broken/foxglove_no-messages.bag") == ({}, [])


def test_three_compressions_give_the_same_messages(shared_logs):
    """The same content, packed in three ways, gives the same messages."""
    plain, bz2, lz4 = (
        # Their definitions of /tf differ.
        {channel.topic: rows for channel, rows in messages(shared_logs / name)[0].items()}
        for name in REAL[-3:]
    )
    assert plain == bz2 == lz4


def test_other_versions_are_refused(shared_logs, tmp_path):
    """A bag of another format version is refused with the version."""
    with pytest.raises(
        UnsupportedLogError,
        match=r"its bag format is version 2\.1 and only 2\.0 is read; migrate it with `rosbag fix`",
    ):
        Rosbag1Log(shared_logs / "broken/test_future_version_2.1.bag")
    old = tmp_path / "old.bag"
    old.write_bytes(b"#ROSBAG V1.2\n" + bytes(100))
    with pytest.raises(UnsupportedLogError, match=r"version 1\.2 and only 2\.0"):
        Rosbag1Log(old)


def test_an_encrypted_bag_is_refused(tmp_path):
    """An encrypted bag is refused with the name of its encryption."""
    fields = [b"op=\x03", b"index_pos=" + bytes(8), b"encryptor=rosbag/AesCbcEncryptor"]
    header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    path = tmp_path / "secret.bag"
    path.write_bytes(
        b"#ROSBAG V2.0\n" + struct.pack("<I", len(header)) + header + struct.pack("<I", 0)
    )
    with pytest.raises(
        UnsupportedLogError,
        match=r"secret\.bag: it is encrypted with 'rosbag/AesCbcEncryptor'; "
        r"decrypt it with `rosbag decrypt`",
    ):
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


def beside_images(path, *, messages=400, picture=40_000):
    """Write a bag of small messages, each ninth followed by a large one of another topic."""
    writer = Writer(path)
    writer.chunk_threshold = 1 << 20
    with writer:
        text = "std_msgs/msg/String"
        one, two, camera = (
            writer.add_connection(topic, text, typestore=STORE, callerid=who)
            for topic, who in (("/imu", "one"), ("/imu", "two"), ("/camera", "three"))
        )
        for number in range(messages):
            content = STORE.types[text]("x" * (number % 5) + str(number))
            packed = bytes(STORE.serialize_ros1(content, text))
            writer.write(one if number % 3 else two, T0 + number, packed)
            if number % 9 == 0:
                writer.write(camera, T0 + number, struct.pack("<I", picture) + bytes(picture))
    return path


def test_messages_beside_images_are_all_there(tmp_path):
    """What is picked out of a chunk is what reading all of it gives."""
    path = beside_images(tmp_path / "log.bag")
    found, losses = messages(path)
    assert losses == []
    assert found == {key: sorted(rows) for key, rows in oracle(path).items()}


def test_images_beside_messages_are_not_read(tmp_path, monkeypatch):
    """Of a chunk that is not packed, only what is wanted leaves the disk."""
    path = beside_images(tmp_path / "log.bag", messages=2000)
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


def test_index_data_that_lie_about_a_chunk_beside_images_are_found_out(tmp_path):
    """Where they do not lead to messages, the chunk is read whole and walked."""
    path = beside_images(tmp_path / "log.bag")
    truth, _ = messages(path)
    content = bytearray(path.read_bytes())
    entry = struct.pack("<II", T0 // 10**9, 5)
    at = content.rindex(entry) + len(entry)
    (offset,) = struct.unpack_from("<I", content, at)
    struct.pack_into("<I", content, at, offset + 1)
    path.write_bytes(content)
    assert messages(path)[0] == truth


def test_a_bag_beside_images_may_be_cut_anywhere(tmp_path):
    """What is before the cut is there, whatever the index of its last chunk was to say."""
    whole = beside_images(tmp_path / "whole.bag")
    truth = {channel.topic: rows for channel, rows in messages(whole)[0].items()}["/imu"]
    content = whole.read_bytes()
    path = tmp_path / "cut.bag"
    for size in range(len(content) // 40, len(content), len(content) // 40):
        path.write_bytes(content[:size])
        found, losses = messages(path)
        rows = next((rows for channel, rows in found.items() if channel.topic == "/imu"), [])
        assert losses
        assert rows == truth[: len(rows)]
        # The messages of a whole chunk and of the front of the one that is cut.
        assert len(rows) >= len(truth) * (size - 100_000) // len(content) - 9
