"""Copies read by others: everything but the attitudes is what it was, for two readers each."""

import bz2
import sqlite3
import struct
from contextlib import closing

import lz4.frame
import pytest
from make.into_logs import run, write_bag, write_mcap, write_rosbag2
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import IndexType
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.rosbag2 import StoragePlugin
from ruamel.yaml import YAML

ADDED = "/attitude"


def copy(log, out):
    """Add attitudes to a log, as a user would."""
    result = run("propagate", log, "--into", out, "-q")
    assert (result.exit_code, result.output) == (0, "")
    return out


def others(messages):
    """Return the messages but those that were added, in order of log time."""
    return sorted(message for message in messages if message[0] != ADDED)


def test_a_copy_has_one_attitude(tmp_path):
    """Gyroscopes whose messages all mark the orientation as absent do not compete with it."""
    log = tmp_path / "spin.bag"
    assert run("simulate", log, "--samples", "20").exit_code == 0
    compared = run("compare", copy(log, tmp_path / "copy.bag"), tmp_path / "spin.truth.csv")
    assert "copy.bag (bag): /attitude " in compared.stdout, compared.stderr


# MCAP


def by_index(path):
    """Read an MCAP file from its index."""
    with path.open("rb") as stream:
        reader = make_reader(stream)
        return [(c.topic, m.log_time, m.publish_time, m.sequence, m.data)
                for _, c, m in reader.iter_messages(log_time_order=False)]  # fmt: skip


def from_front(path):
    """Read an MCAP file record by record."""
    with path.open("rb") as stream:
        reader = NonSeekingReader(stream)
        return [(c.topic, m.log_time, m.publish_time, m.sequence, m.data)
                for _, c, m in reader.iter_messages(log_time_order=False)]  # fmt: skip


MCAP_LAYOUTS = {
    "chunked": {},
    "unchunked": {"use_chunking": False},
    "no message index": {"index_types": IndexType.CHUNK},
    "no chunk index": {"index_types": IndexType.MESSAGE},
    "unindexed": {"index_types": IndexType.NONE},
    "unchunked and unindexed": {"use_chunking": False, "index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False, "use_summary_offsets": False},
}


@pytest.mark.parametrize("layout", MCAP_LAYOUTS)
def test_every_reader_sees_all_messages_of_an_mcap_copy(tmp_path, layout):
    """An indexed and a sequential reader find the same in the copy, and counts and times agree."""
    log = write_mcap(tmp_path / "log.mcap", **MCAP_LAYOUTS[layout])
    before = from_front(log)
    out = copy(log, tmp_path / "out.mcap")
    for read in (by_index, from_front):
        after = read(out)
        assert others(after) == others(before)
        assert len(after) == len(before) + 300
    with out.open("rb") as stream:
        statistics = make_reader(stream).get_summary().statistics
    assert statistics.message_count == len(before) + 300
    times = [message[1] for message in before]
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))


def with_early_data_end(data):
    """Return an MCAP file without an index whose data end record stands amid its chunks."""
    head = struct.Struct("<BQ")
    at, records, end = 8, [], b""
    while at < len(data) - 8:
        opcode, length = head.unpack_from(data, at)
        record = data[at : at + head.size + length]
        at += len(record)
        if opcode == Opcode.DATA_END:
            end = record
            break
        records.append((opcode, record))
    chunks = [k for k, (opcode, _) in enumerate(records) if opcode == Opcode.CHUNK]
    footer = head.pack(Opcode.FOOTER, 20) + bytes(20)
    body = [record for _, record in records]
    return b"".join([data[:8], *body[: chunks[-3]], end, *body[chunks[-3] :], footer, data[:8]])


def test_chunks_after_the_data_end_are_copied(tmp_path):
    """A reader that goes on finds them, and so does one of the copy."""
    log = write_mcap(tmp_path / "log.mcap")
    before = from_front(log)
    log.write_bytes(with_early_data_end(log.read_bytes()))
    assert from_front(log) == before
    out = copy(log, tmp_path / "out.mcap")
    for read in (by_index, from_front):
        assert others(read(out)) == others(before)
        assert len(read(out)) == len(before) + 300


# ROS 1


UNPACK = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}


def records(path):
    """Read the messages of a ROS 1 bag from front to back, whatever its index says."""
    data = path.read_bytes()

    def walk(data, at, end):
        while at < end:
            (size,) = struct.unpack_from("<I", data, at)
            head, fields = data[at + 4 : at + 4 + size], {}
            while head:
                (length,) = struct.unpack_from("<I", head)
                name, _, value = head[4 : 4 + length].partition(b"=")
                fields[name] = value
                head = head[4 + length :]
            (length,) = struct.unpack_from("<I", data, at + 4 + size)
            begin = at + 8 + size
            yield fields, data[begin : begin + length]
            at = begin + length

    topics, messages, spans = {}, [], []
    for fields, content in walk(data, len("#ROSBAG V2.0\n"), len(data)):
        inside = [(fields, content)]
        if fields[b"op"] == b"\5":
            chunk = UNPACK[fields[b"compression"]](content)
            inside = walk(chunk, 0, len(chunk))
        for inner, body in inside:
            if inner[b"op"] == b"\7":
                topics[inner[b"conn"]] = inner[b"topic"].decode()
            elif inner[b"op"] == b"\2":
                seconds, nanoseconds = struct.unpack("<II", inner[b"time"])
                time = seconds * 10**9 + nanoseconds
                messages.append((inner[b"conn"], time, body))
            elif inner[b"op"] == b"\6":
                spans.append([struct.unpack("<II", inner[name])
                              for name in (b"start_time", b"end_time")])  # fmt: skip
    return [(topics[id_], time, body) for id_, time, body in messages], spans


def by_rosbags(path):
    """Read a ROS 1 bag with rosbags, from its index."""
    with Rosbag1Reader(path) as reader:
        return [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]


@pytest.mark.parametrize("chunk_size", [4_000, 10_000_000])
@pytest.mark.parametrize("count", [300, 4_000])
def test_every_reader_sees_all_messages_of_a_bag_copy(tmp_path, chunk_size, count):
    """Readers that take the start from the first and the end from the last chunk are right, too."""
    log = write_bag(tmp_path / "log.bag", chunk_size=chunk_size, count=count)
    before, spans = records(log)
    out = copy(log, tmp_path / "out.bag")
    after, copied_spans = records(out)
    assert others(after) == others(by_rosbags(out)) == others(before)
    assert len(after) == len(by_rosbags(out)) == len(before) + count
    assert (copied_spans[0][0], copied_spans[-1][1]) == (spans[0][0], spans[-1][1])


@pytest.mark.parametrize("compression", [None, Rosbag1Writer.CompressionFormat.BZ2])
def test_every_reader_sees_all_messages_of_a_copy_of_a_bag_without_index(tmp_path, compression):
    """What a recorder that died leaves has chunks only; its copy has an index again."""
    log = write_bag(tmp_path / "log.bag", compression=compression)
    data = log.read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    log.write_bytes(data[: int.from_bytes(data[at : at + 8], "little")])
    before, _ = records(log)
    out = copy(log, tmp_path / "out.bag")
    after, spans = records(out)
    assert others(after) == others(by_rosbags(out)) == others(before)
    assert len(after) == len(by_rosbags(out)) == len(before) + 300
    times = [divmod(time, 10**9) for _, time, _ in before]
    assert (spans[0][0], spans[-1][1]) == (min(times), max(times))


@pytest.mark.parametrize("compression", [None, Rosbag1Writer.CompressionFormat.LZ4,
                                         Rosbag1Writer.CompressionFormat.BZ2])  # fmt: skip
def test_attitudes_that_end_early_leave_the_end_of_a_bag(tmp_path, compression):
    """Rates end before other topics, in the same chunk or in an earlier one."""
    for chunk_size in (3_000, 1_000_000):
        log, early = tmp_path / f"{chunk_size}.bag", tmp_path / f"early_{chunk_size}.bag"
        write_bag(early, count=200)
        writer = Rosbag1Writer(log)
        writer.chunk_threshold = chunk_size
        if compression:
            writer.set_compression(compression)
        with Rosbag1Reader(early) as reader, writer:
            ids = {c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data,
                                               md5sum=c.digest)
                   for c in reader.connections}  # fmt: skip
            shutter = next(c for c in reader.connections if c.topic == "/shutter")
            all_messages = list(reader.messages())
            first, last = all_messages[0][1], all_messages[-1][1]
            body = next(bytes(data) for c, _, data in all_messages if c.id == shutter.id)
            writer.write(ids[shutter.id], first - 5 * 10**9, body)
            for connection, time, data in all_messages:
                writer.write(ids[connection.id], time, data)
            for k in range(90):
                writer.write(ids[shutter.id], last + (k + 1) * 10**9, body)
        before, _ = records(log)
        out = copy(log, tmp_path / f"out_{chunk_size}.bag")
        after, spans = records(out)
        assert others(after) == others(by_rosbags(out)) == others(before)
        with Rosbag1Reader(log) as one, Rosbag1Reader(out) as two:
            assert (one.start_time, one.end_time) == (two.start_time, two.end_time)
            assert two.message_count == one.message_count + 200
        seconds = [divmod(time, 10**9) for time in (first - 5 * 10**9, last + 90 * 10**9)]
        assert [spans[0][0], spans[-1][1]] == seconds


# ROS 2


def rosbag2_metadata(text):
    """Decode the metadata inside a file of messages, with the keys that rosbag2 asks for."""
    node = YAML(typ="safe", pure=True).load(text)
    files = [(str(file["path"]), int(file["starting_time"]["nanoseconds_since_epoch"]),
              int(file["duration"]["nanoseconds"]), int(file["message_count"]))
             for file in node["files"]]  # fmt: skip
    topics = {}
    for entry in node["topics_with_message_count"]:
        topic = entry["topic_metadata"]
        assert {"name", "type", "serialization_format", "offered_qos_profiles",
                "type_description_hash"} <= topic.keys()  # fmt: skip
        topics[topic["name"]] = int(entry["message_count"])
    assert isinstance(node["storage_identifier"], str)
    assert isinstance(node["compression_format"], str)
    assert isinstance(node["compression_mode"], str)
    return {
        "version": int(node["version"]),
        "paths": [str(path) for path in node["relative_file_paths"]],
        "duration": int(node["duration"]["nanoseconds"]),
        "start": int(node["starting_time"]["nanoseconds_since_epoch"]),
        "count": int(node["message_count"]),
        "topics": topics,
        "files": files,
    }


def embedded(path):
    """Return the metadata records inside a file of a ROS 2 bag."""
    if path.suffix == ".mcap":
        with path.open("rb") as stream:
            found = list(make_reader(stream).iter_metadata())
        return [r.metadata["serialized_metadata"] for r in found if r.name == "rosbag2"]
    with closing(sqlite3.connect(path)) as database:
        return [text for (text,) in database.execute("SELECT metadata FROM metadata ORDER BY id")]


def rows(path):
    """Read the messages of a file of a ROS 2 bag, without its metadata.yaml."""
    if path.suffix == ".mcap":
        return [message[:2] + message[4:] for message in from_front(path)]
    with closing(sqlite3.connect(path)) as database:
        query = ("SELECT name, timestamp, data FROM messages JOIN topics "
                 "ON topics.id = messages.topic_id")  # fmt: skip
        return list(database.execute(query))


def by_rosbags2(path):
    """Read a ROS 2 bag with rosbags."""
    with Rosbag2Reader(path) as reader:
        return [(c.topic, time, bytes(data)) for c, time, data in reader.messages()]


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_every_reader_sees_all_messages_of_a_bag_folder(tmp_path, storage, version):
    """Messages, and the metadata beside and inside the file, which rosbag2 reads first."""
    log = write_rosbag2(tmp_path / "log", storage, version=version)
    suffix = ".mcap" if storage is StoragePlugin.MCAP else ".db3"
    (before,) = map(rosbag2_metadata, embedded(log / f"log{suffix}"))
    out = copy(log, tmp_path / "out")
    file = out / f"log{suffix}"
    assert others(by_rosbags2(out)) == others(rows(file)) == others(by_rosbags2(log))
    assert len(by_rosbags2(out)) == len(rows(file)) == 630
    (after,) = map(rosbag2_metadata, embedded(file))
    assert after.pop("topics") == {**before.pop("topics"), ADDED: 300}
    assert after.pop("count") == before.pop("count") + 300
    assert [f[-1] for f in after.pop("files")] == [f[-1] + 300 for f in before.pop("files")]
    assert after == before


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_file_of_a_bag_by_itself_keeps_its_metadata_true(tmp_path, storage):
    """A single database or MCAP file has its metadata inside only."""
    suffix = ".mcap" if storage is StoragePlugin.MCAP else ".db3"
    log = write_rosbag2(tmp_path / "log", storage) / f"log{suffix}"
    out = copy(log, tmp_path / f"out{suffix}")
    assert others(rows(out)) == others(rows(log))
    (metadata,) = map(rosbag2_metadata, embedded(out))
    assert metadata["topics"] == {"/imu": 300, "/shutter": 30, ADDED: 300}
    assert metadata["count"] == 630
