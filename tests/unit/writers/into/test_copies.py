"""Copies of logs of every kind with attitudes added: everything else is kept, for all readers."""

import sqlite3
from contextlib import closing
from functools import partial

import numpy as np
import pytest
from make.bag_doctor import examine_bag
from make.commands import run
from make.into_logs import BOOT, RATE, START, moments, write_bag, write_mcap, write_rosbag2
from make.mcap import BARE
from make.mcap_doctor import examine
from make.ros import ROS1, ROS2
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, IndexType
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.rosbag2 import StoragePlugin

from quatprop.readers.open_log import open_log

ADDED = "/attitude"
LONG = "m" * 2000
"""A name of a frame with which 300 attitudes fill several chunks."""

PACKED = Rosbag1Writer.CompressionFormat


def without_index(path, **options):
    """Write what a recorder of ROS 1 leaves that died: chunks only."""
    data = write_bag(path, **options).read_bytes()
    at = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[: int.from_bytes(data[at : at + 8], "little")])
    return path


MCAP = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False},
    "no indexes": {"index_types": IndexType.NONE},
    "no message index": {"index_types": IndexType.CHUNK},
    "no chunk index": {"index_types": IndexType.MESSAGE},
    "no chunks, no indexes": {"use_chunking": False, "index_types": IndexType.NONE},
    "no summary": BARE,
    "no checksums": {"enable_crcs": False},
    "one chunk": {"chunk_size": 1 << 20},
    "no profile": {"profile": ""},
}
BAGS = {
    "plain": write_bag,
    "lz4": partial(write_bag, compression=PACKED.LZ4),
    "bz2": partial(write_bag, compression=PACKED.BZ2),
    "one chunk": partial(write_bag, chunk_size=10_000_000),
    "no index": without_index,
    "no index, bz2": partial(without_index, compression=PACKED.BZ2),
}
FOLDERS = {f"{storage.name.lower()} {version}": (storage, version)
           for storage in StoragePlugin for version in (8, 9)}  # fmt: skip
LOGS = {
    **{f"mcap {form}": ("log.mcap", partial(write_mcap, **form_of))
       for form, form_of in MCAP.items()},
    **{f"bag {form}": ("log.bag", write) for form, write in BAGS.items()},
    **{f"rosbag2 {form}": ("log", partial(write_rosbag2, storage=storage, version=version))
       for form, (storage, version) in FOLDERS.items()},
}  # fmt: skip
FORM_LOGS = ["mcap zstd", "bag plain", "rosbag2 sqlite3 9", "rosbag2 mcap 9"]


def made(folder, name):
    """Write a log by its name in LOGS; return it, and where a copy goes."""
    file, write = LOGS[name]
    return write(folder / file), folder / file.replace("log", "out")


def copied(log, out, *options, command="propagate", code=0):
    """Add attitudes to a log, as a user would."""
    assert run(command, log, "--into", out, "-q", *options, code=code).output == "" or code
    return out


# Readers: topic and log time first, then whatever a message has besides


def by_index(path):
    """Read an MCAP file from its index."""
    with path.open("rb") as stream:
        return mcap_messages(make_reader(stream, validate_crcs=True))


def from_front(path):
    """Read an MCAP file record by record."""
    with path.open("rb") as stream:
        return mcap_messages(NonSeekingReader(stream, validate_crcs=True))


def mcap_messages(reader):
    """Return everything that a reader tells of each message."""
    return [
        (c.topic, m.log_time, m.data, m.publish_time, m.sequence, c.message_encoding,
         sorted(c.metadata.items()), s and (s.name, s.encoding, s.data))
        for s, c, m in reader.iter_messages(log_time_order=False)
    ]  # fmt: skip


def by_rosbags(path):
    """Read a bag with rosbags, by its index or the metadata beside it."""
    with (Rosbag2Reader if path.is_dir() else Rosbag1Reader)(path) as reader:
        return [(c.topic, at, bytes(data)) for c, at, data in reader.messages()]


def from_database(path):
    """Read the database of a ROS 2 bag."""
    with closing(sqlite3.connect(path)) as database:
        query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id"
        return list(database.execute(query))


def from_files(path):
    """Read the files of a ROS 2 bag without its metadata."""
    if (path / "log.mcap").exists():
        return [message[:3] for message in from_front(path / "log.mcap")]
    return from_database(path / "log.db3")


READERS = {
    "mcap": [by_index, from_front],
    "bag": [by_rosbags, lambda path: examine_bag(path)[0]],
    "rosbag2": [by_rosbags, from_files],
}


def described(path):
    """Return what a log says besides its messages: of its topics, and beside them."""
    if path.suffix == ".mcap":
        parts = []
        for part in ("get_header", "iter_metadata", "iter_attachments"):
            with path.open("rb") as stream:
                found = getattr(NonSeekingReader(stream), part)()
                parts.append(found if part == "get_header" else list(found))
        parts[1] = [record for record in parts[1] if record.name != "quatprop"]
        return parts
    with (Rosbag2Reader if path.is_dir() else Rosbag1Reader)(path) as reader:
        topics = [
            (c.topic, c.msgtype, c.msgdef.data, c.digest, c.msgcount, *c.ext[:2])
            for c in reader.connections
            if c.topic != ADDED
        ]
    if path.is_dir():
        return topics, {file.name for file in path.iterdir()}, (path / "note.txt").read_text()
    return topics


def attitudes(messages, kind="mcap"):
    """Return stamps, log times and wxyz of the messages that were added."""
    store = ROS1 if kind == "bag" else ROS2
    decode = store.deserialize_ros1 if kind == "bag" else store.deserialize_cdr
    found = []
    for topic, logged, data, *_ in messages:
        if topic == ADDED:
            message = decode(data, "geometry_msgs/msg/QuaternionStamped")
            stamp, q = message.header.stamp, message.quaternion
            found.append((stamp.sec * 10**9 + stamp.nanosec, logged, (q.w, q.x, q.y, q.z)))
    return found


@pytest.mark.parametrize("name", LOGS)
def test_everything_else_is_kept_for_every_reader(tmp_path, name):
    """The body turns about z; an attitude is logged when the message was that it comes from."""
    log, out = made(tmp_path, name)
    kind = name.split()[0]
    copied(log, out, "--frames", f"{LONG},body")
    for file in [out] if kind == "mcap" else tmp_path.glob("out/*.mcap"):
        starts = examine(file).starts
        assert starts == sorted(starts)
    before = sorted(READERS[kind][1](log))
    half = RATE * 0.01 * np.arange(300) / 2
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    for read in READERS[kind]:
        after = read(out)
        assert sorted(message for message in after if message[0] != ADDED) == before
        found = attitudes(after, kind)
        assert [(stamp, logged) for stamp, logged, _ in found] == list(moments(300))
        np.testing.assert_allclose([wxyz for *_, wxyz in found], expected, atol=1e-14)
    if not name.startswith("bag no index"):
        assert described(out) == described(log)


@pytest.mark.parametrize("name", FORM_LOGS)
def test_attitudes_of_the_log_are_converted_into_it(tmp_path, name):
    """The other command adds what it reads, here the orientation of the same messages."""
    log, out = made(tmp_path, name)
    copied(log, out, command="convert")
    kind = name.split()[0]
    found = attitudes(READERS[kind][1](out), kind)
    assert [(stamp, logged) for stamp, logged, _ in found] == list(moments(300))
    assert {wxyz for *_, wxyz in found} == {(0.8, 0.0, 0.0, 0.6)}


@pytest.mark.parametrize("name", FORM_LOGS)
def test_each_topic_has_its_own_provenance(tmp_path, name):
    """What was added first keeps what was told of it."""
    log, first = made(tmp_path, name)
    copied(log, first, "--method", "mean")
    second = first.with_name(first.name.replace("out", "second"))
    copied(first, second, "-t", "/imu", "--method", "coning", "--out-topic", "/coning")
    with open_log(second) as opened:
        told = [opened.provenance(topic) for topic in ("/attitude", "/coning", "/imu")]
    assert [one and one["convention"]["method"] for one in told] == ["mean", "coning", {}]


@pytest.mark.parametrize("name", ["mcap zstd", "bag plain"])
@pytest.mark.parametrize("more", [(), ("--rate", "50"), ("--every", "3")])
def test_sorted_attitudes_have_the_log_times_of_their_messages(tmp_path, name, more):
    """They had those of other messages, where stamps did not rise with log times."""
    random = np.random.default_rng(4)
    stamps = BOOT + np.arange(100) * 10_000_000 + random.integers(-30_000_000, 30_000_000, 100)
    stamps[40] = stamps[41]  # two messages of one stamp
    logged = START + np.arange(100) * 10_000_000
    pairs = list(zip(stamps.tolist(), logged.tolist(), strict=True))
    file, write = LOGS[name]
    log, out = write(tmp_path / file, times=pairs), tmp_path / file.replace("log", "out")
    run("propagate", log, "--into", out, "--on-backwards", "sort", "-q", *more, code=0)
    with AnyReader([out]) as reader:
        found = sorted(
            (stamp.sec * 10**9 + stamp.nanosec, at)
            for connection, at, data in reader.messages()
            if connection.topic == ADDED
            for stamp in [reader.deserialize(data, connection.msgtype).header.stamp]
        )
    pairs.sort()
    if "--rate" in more:
        known = dict(pairs)
        assert all(at in {known.get(stamp), at} for stamp, at in found)
        assert len(found) > 40
    else:
        assert found == pairs[:: 3 if more else 1]


@pytest.mark.parametrize(
    ("command", "steps"),
    [("propagate", [k // 2 for k in range(20)]), ("convert", [0, 1, 2, 2, 9, 3, 4, 4, 5])],
)
def test_messages_of_one_stamp_keep_their_own_log_times(tmp_path, command, steps):
    """Those whose stamps step back or are repeated had the log times of others."""
    times = [(BOOT + t * 10_000_000, START + k * 10_000_000) for k, t in enumerate(steps)]
    log = write_mcap(tmp_path / "log.mcap", times=times)
    out = copied(log, tmp_path / "out.mcap", command=command)
    assert [pair[:2] for pair in attitudes(from_front(out))] == times


def test_fewer_rows_are_logged_between_messages(tmp_path):
    """With --rate, an attitude is logged as long after its message as it is stamped after it."""
    log, out = made(tmp_path, "mcap zstd")
    stamps, logged, _ = zip(*attitudes(from_front(copied(log, out, "--rate", "250"))), strict=True)
    stamps = np.array(stamps)
    assert set(np.diff(stamps)) == {4_000_000}
    before = (stamps - BOOT) // 10_000_000
    np.testing.assert_array_equal(logged, START + (stamps - BOOT) + before % 7 * 1000)


def test_a_copy_has_one_attitude(tmp_path):
    """Gyroscopes whose messages all mark the orientation as absent do not compete with it."""
    log = tmp_path / "spin.bag"
    run("simulate", log, "--samples", "20", code=0)
    compared = run("compare", copied(log, tmp_path / "copy.bag"), tmp_path / "spin.truth.csv")
    assert "copy.bag (bag): /attitude " in compared.stdout, compared.stderr
