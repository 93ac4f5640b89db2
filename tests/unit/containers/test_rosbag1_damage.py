"""ROS 1 bags damaged in the middle: what comes behind the damage, and the front of torn chunks."""

import random
import struct

import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from quatprop.containers.rosbag1.log import Rosbag1Log
from quatprop.tables.log import Loss

STORE = get_typestore(Stores.ROS1_NOETIC)
NOISE = random.Random(1).randbytes(5000)
MESSAGES = 400
COMPRESSIONS = (None, "BZ2", "LZ4")


def written(path, compression=None, threshold=3000):
    """Write a bag of one topic in chunks of some dozen messages; return its bytes."""
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    writer.chunk_threshold = threshold
    with writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=STORE)
        for number in range(MESSAGES):
            content = f"{number:08d}{hash((number, 1)):032d}".encode()
            writer.write(connection, 1000 * number, struct.pack("<I", len(content)) + content)
    return path.read_bytes()


def chunk_places(path):
    """Return where the chunks begin and how many messages each has, by rosbags' own reader."""
    with Reader(path) as reader:
        infos = sorted(reader.chunk_infos, key=lambda info: info.pos)
        return [(info.pos, sum(info.connection_counts.values())) for info in infos]


def index_place(content):
    """Return where the index of the whole bag begins, from the bag header."""
    at = content.index(b"index_pos=") + 10
    return int.from_bytes(content[at : at + 8], "little")


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


def numbers_of(places, chunk):
    """Return the numbers of the messages in a chunk."""
    before = sum(count for _, count in places[:chunk])
    return set(range(before, before + places[chunk][1]))


HARMS = {
    "a hole in the data": lambda b, place: b[: place + 200] + b[place + 277 :],
    "zeros over the head": lambda b, place: b[:place] + bytes(40) + b[place + 40 :],
    "a length beyond the file": lambda b, place: b[:place] + b"\xff" * 4 + b[place + 4 :],
    "bytes too many": lambda b, place: b[: place + 300] + b"op=\x05" * 30 + b[place + 300 :],
}


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("harm", HARMS)
@pytest.mark.parametrize("indexed", [True, False])
def test_what_follows_damage_is_read(tmp_path, compression, harm, indexed):
    """Damage in one chunk costs no other, whether the bag was closed or not."""
    path = tmp_path / "log.bag"
    intact = written(path, compression)
    places = chunk_places(path)
    content = HARMS[harm](intact, places[4][0])
    if not indexed:
        content = content[: index_place(intact) + len(content) - len(intact)]
    numbers, losses = read(path, content)
    assert numbers == sorted(set(numbers))
    assert set(range(MESSAGES)) - numbers_of(places, 4) <= set(numbers)
    assert losses


def test_messages_of_a_plain_chunk_are_found_without_its_head(tmp_path):
    """The records inside a chunk that is not packed can be followed by themselves."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin = chunk_places(path)[4][0]
    content = intact[: index_place(intact)]
    content = content[:begin] + bytes(8) + content[begin + 8 :]
    numbers, losses = read(path, content)
    assert numbers == list(range(MESSAGES))
    assert losses[0].place == f"byte {begin}"


@pytest.mark.parametrize("indexed", [True, False])
def test_a_damaged_message_in_a_chunk_costs_itself(tmp_path, indexed):
    """The index data behind a chunk tell where its messages go on."""
    path = tmp_path / "log.bag"
    intact = written(path)
    begin, _ = chunk_places(path)[4]
    damaged = min(numbers_of(chunk_places(path), 4)) + 7
    at = intact.index(f"{damaged:08d}".encode()) - 8  # the length of its data
    assert begin < at
    content = bytearray(intact if indexed else intact[: index_place(intact)])
    content[at : at + 4] = b"\xff\xff\xff\x7f"
    numbers, losses = read(path, bytes(content))
    assert numbers == [number for number in range(MESSAGES) if number != damaged]
    assert Loss(f"chunk at byte {begin}", "a record in it is damaged or cut off", 1) in losses


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_damaged_index_data_cost_no_message(tmp_path, compression):
    """Where the index data behind a chunk are damaged, its records are walked."""
    path = tmp_path / "log.bag"
    intact = written(path, compression)
    at = intact.index(b"op=\x04", chunk_places(path)[4][0]) - 8
    content = intact[:at] + bytes(60) + intact[at + 60 : index_place(intact)]
    numbers, losses = read(path, content)
    assert numbers == list(range(MESSAGES))
    assert losses[0].place.startswith("byte ")


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_torn_chunk_gives_what_can_be_unpacked_of_it(tmp_path, compression):
    """Of the chunk that a dying recorder was writing, the front is read."""
    path = tmp_path / "log.bag"
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        writer.chunk_threshold = 1 << 30
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=STORE)
        for number in range(4000):
            content = f"{number:08d}".encode() + NOISE[number : number + 500]
            writer.write(connection, 1000 * number, struct.pack("<I", len(content)) + content)
    begin, _ = chunk_places(path)[0]
    intact = path.read_bytes()
    data = begin + 8 + int.from_bytes(intact[begin : begin + 4], "little")
    size = int.from_bytes(intact[data - 4 : data], "little")
    numbers, losses = read(path, intact[: data + 9 * size // 10])
    assert numbers == list(range(len(numbers)))
    assert 1500 < len(numbers) < 4000
    assert [loss.place for loss in losses] == [f"chunk at byte {begin}"]


def two_topics(path, topics, first):
    """Write a bag with messages of two topics in turn, their connections in the given order."""
    writer = Writer(path)
    writer.chunk_threshold = 2000
    with writer:
        connections = [
            writer.add_connection(topic, "std_msgs/msg/String", typestore=STORE) for topic in topics
        ]
        for number in range(first, first + MESSAGES):
            content = f"{number:08d}".encode()
            connection = connections[number % 2]
            writer.write(connection, 1000 * number, struct.pack("<I", 8) + content)
    return path.read_bytes()


def by_topic(path):
    """Return the log times and contents of each topic of a bag, by rosbags' own reader."""
    found = {}
    with Reader(path) as reader:
        for connection, log_ns, data in reader.messages():
            found.setdefault(connection.topic, []).append((log_ns, bytes(data)))
    return found


JOINTS = {
    "closed": lambda content: (content, b""),
    "not closed": lambda content: (content[: index_place(content)], b""),
    "half an index": lambda content: (content[: index_place(content) + 40], b""),
    "damage between them": lambda content: (content, bytes(30)),
}


@pytest.mark.parametrize("joint", JOINTS)
def test_a_bag_behind_another_is_read(tmp_path, joint):
    """The numbers of its connections are its own, and so are the places in its index."""
    parts = [
        two_topics(tmp_path / "first.bag", ["/a", "/b"], 0),
        two_topics(tmp_path / "second.bag", ["/b", "/c"], MESSAGES - 20),
    ]
    front, between = JOINTS[joint](parts[0])
    path = tmp_path / "log.bag"
    path.write_bytes(front + between + parts[1])
    expected = by_topic(tmp_path / "first.bag")
    for topic, messages in by_topic(tmp_path / "second.bag").items():
        expected[topic] = expected.get(topic, []) + messages
    with Rosbag1Log(path) as log:
        found = {
            channel.topic: sorted(
                (log_ns, block.data[start:end].tobytes())
                for block in log.blocks(channel)
                for start, end, log_ns in zip(
                    block.starts, block.ends, block.log_ns.tolist(), strict=True
                )
            )
            for channel in log.channels()
        }
        counts = {channel.topic: channel.count for channel in log.channels()}
    assert found == {topic: sorted(messages) for topic, messages in expected.items()}
    assert counts == {topic: len(messages) for topic, messages in expected.items()}
    assert bool(log.losses) == (joint in {"half an index", "damage between them"})


@pytest.mark.parametrize("at", [2, 13 + 20])
def test_a_damaged_beginning_of_a_second_bag_gives_no_topic_the_messages_of_another(tmp_path, at):
    """Where it is not clear what a connection number means, its messages are counted as lost."""
    first = two_topics(tmp_path / "first.bag", ["/a", "/b"], 0)
    second = bytearray(two_topics(tmp_path / "second.bag", ["/b", "/c"], MESSAGES))
    second[at : at + 8] = bytes(8)
    path = tmp_path / "log.bag"
    path.write_bytes(first + second)
    with Rosbag1Log(path) as log:
        read = {
            channel.topic: {
                int(block.data[start:end][4:12].tobytes())
                for block in log.blocks(channel)
                for start, end in zip(block.starts, block.ends, strict=True)
            }
            for channel in log.channels()
        }
    assert log.losses
    assert read["/a"] == set(range(0, MESSAGES, 2))
    assert read["/b"] <= set(range(1, MESSAGES, 2)) | set(range(MESSAGES, 2 * MESSAGES, 2))


def chunk_infos(content):
    """Return where the records of chunk infos begin."""
    place = content.index(b"op=\x06", index_place(content))
    found = []
    while place > 0:
        found.append(place - 8)
        place = content.find(b"op=\x06", place + 1)
    return found


def test_an_index_that_lacks_a_chunk_costs_nothing(tmp_path):
    """The bag header said one chunk less: its messages were missing without a word."""
    path = tmp_path / "log.bag"
    content = bytearray(written(path))
    at = content.index(b"chunk_count=") + 12
    content[at] -= 1
    assert read(path, bytes(content)) == ([*range(MESSAGES)], [])


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_that_is_said_to_hold_another_connection_is_read(tmp_path, compression):
    """One damaged bit of a chunk info cost all messages of the chunk without a word."""
    path = tmp_path / "log.bag"
    content = bytearray(written(path, compression))
    at = chunk_infos(content)[3]
    data = at + 8 + int.from_bytes(content[at : at + 4], "little")
    content[data] ^= 1
    assert read(path, bytes(content)) == ([*range(MESSAGES)], [])


def test_a_chunk_whose_head_is_damaged_has_the_amount_of_its_info(tmp_path):
    """What the index says is lost is said, though the records must be walked."""
    path = tmp_path / "log.bag"
    content = bytearray(written(path, "LZ4"))
    begin, count = chunk_places(path)[4]
    content[begin : begin + 4] = bytes(4)
    numbers, losses = read(path, bytes(content))
    assert set(range(MESSAGES)) - {*numbers} == numbers_of_chunk(count, begin, tmp_path)
    assert sum(loss.messages or 0 for loss in losses) == count


def numbers_of_chunk(count, begin, folder):
    """Return the numbers of the messages of a chunk of the intact bag."""
    written(folder / "intact.bag", "LZ4")
    places = chunk_places(folder / "intact.bag")
    (chunk,) = [k for k, (place, _) in enumerate(places) if place == begin]
    assert places[chunk][1] == count
    return numbers_of(places, chunk)


def test_a_closed_bag_that_was_cut_between_two_records_is_not_whole(tmp_path):
    """Its messages were taken for all, though the bag header says that more followed."""
    path = tmp_path / "log.bag"
    content = written(path)
    end = chunk_places(path)[4][0]
    numbers, losses = read(path, content[:end])
    assert numbers == [*range(len(numbers))]
    reason = f"it ends before its index, which should begin at byte {index_place(content)}"
    assert losses == [Loss(f"byte {end}", reason)]
