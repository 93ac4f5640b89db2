"""SQLite bags, message for message against rosbags' own reader and plain SQL."""

import shutil
import sqlite3
from collections import defaultdict
from contextlib import closing

import apsw
import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from quatprop.containers.rosbag2.db3 import Db3Log
from quatprop.containers.rosbag2.sqlite_files import open_database
from quatprop.errors import DamagedLogError, UnsupportedLogError
from quatprop.tables.log import Loss

STORE = get_typestore(Stores.ROS2_HUMBLE)
REAL = [
    "auk/auk_sqlite3/auk_sqlite3.db3",
    "rosbag2/geocam_all_types/test_bag_sqlite3.db3",
    "rosbag2/klintan_sample.db3",
    "rosbag2/plotjuggler_rosbag2_test/rosbag2_test_0.db3",
]
T0 = 1_700_000_000_000_000_000
HEADER = b"\x00\x01\x00\x00"

OLD_TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                    serialization_format TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                      timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO topics VALUES (4, '/imu', 'sensor_msgs/Imu', 'cdr');
"""


def rows_of(log, channel):
    """Return (log time, bytes) of a channel in the order of its blocks; check their promises."""
    rows = []
    bound = 0
    for block in log.blocks(channel):
        assert block.log_ns.min() >= bound
        assert (block.publish_ns == block.log_ns).all()
        bound = block.watermark_ns
        data = block.data.tobytes()
        rows += [
            (log_ns, data[start:end])
            for log_ns, start, end in zip(
                block.log_ns.tolist(), block.starts.tolist(), block.ends.tolist(), strict=True
            )
        ]
    return rows


def messages(path, **options):
    """Return the messages of each topic and what was lost."""
    with Db3Log(path, **options) as log:
        found = {
            (channel.topic, channel.type_name): rows_of(log, channel) for channel in log.channels()
        }
        return found, log.losses


def oracle(path):
    """Return the same from rosbags."""
    found = defaultdict(list)
    with Reader(path) as reader:
        names = {(c.topic, normalize_msgtype(c.msgtype)) for c in reader.connections}
        for connection, log_ns, data in reader.messages():
            found[connection.topic, normalize_msgtype(connection.msgtype)].append(
                (log_ns, bytes(data))
            )
    return {name: found[name] for name in names}


def write_bag(path, mode=CompressionMode.NONE, count=1500):
    """Write a folder with one database, out of order in time, and return the database."""
    rng = np.random.default_rng(5)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=STORE)
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=STORE)
        for k in range(count):
            log_ns = T0 + 1000 * k - int(rng.integers(50_000))
            writer.write(imu, log_ns, HEADER + rng.bytes(316))
            if k % 10 == 0:
                writer.write(text, log_ns, HEADER + rng.bytes(int(rng.integers(4, 9000))))
    return path / f"{path.name}.db3"


def old_bag(path, rows):
    """Write a database with the tables of the first ROS 2 releases."""
    with sqlite3.connect(path) as database:
        database.executescript(OLD_TABLES)
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (4, ?, ?)", rows
        )
    database.close()
    return path


def test_messages_come_in_time_order(tmp_path):
    """Every message has the bytes and the time that rosbags gives it, in the same order."""
    path = write_bag(tmp_path / "bag")
    found, losses = messages(path)
    assert (found, losses) == (oracle(path), [])
    assert len(found["/imu", "sensor_msgs/msg/Imu"]) == 1500


@pytest.mark.parametrize("name", REAL)
def test_real_databases_are_read_as_rosbags_reads_them(shared_logs, name):
    """Every message of a real database has the bytes and the time that rosbags gives it."""
    assert messages(shared_logs / name) == (oracle(shared_logs / name), [])


@pytest.mark.parametrize("options", [{}, {"is_zstd": True}])
def test_messages_packed_one_by_one_are_unpacked(tmp_path, options):
    """Packed messages are told by their first bytes, or by the metadata."""
    path = write_bag(tmp_path / "bag", CompressionMode.MESSAGE)
    assert messages(path, **options) == (oracle(tmp_path / "bag"), [])


def test_a_packed_recording_gives_the_messages_of_the_plain_one(shared_logs):
    """The real recording that is packed message by message is the one that is not."""
    plain, _ = messages(shared_logs / "auk/auk_sqlite3/auk_sqlite3.db3")
    packed, losses = messages(shared_logs / "auk/auk_sqlite3_zstdmsg/auk_sqlite3_zstdmsg.db3")
    assert (packed, losses) == (plain, [])


def test_packed_messages_that_are_damaged_are_counted(tmp_path):
    """Messages that do not unpack are left out and counted, once however often they are read."""
    pack = zstandard.compress
    frames = [pack(HEADER + bytes([k]) * 100) for k in range(5)]
    frames[1] = frames[1][:-3]
    frames[3] = b"\x28\xb5\x2f\xfd" + bytes(20)
    path = old_bag(tmp_path / "a.db3", enumerate(frames))
    with Db3Log(path) as log:
        (channel,) = log.channels()
        for _ in range(2):
            rows = rows_of(log, channel)
            assert rows == [(k, HEADER + bytes([k]) * 100) for k in (0, 2, 4)]
        assert log.losses == [Loss("topic '/imu'", "their zstd data is damaged", 2)]


def test_the_definition_comes_from_the_database(tmp_path):
    """A channel has the definition that newer databases carry."""
    with Db3Log(write_bag(tmp_path / "bag")) as log:
        imu, text = log.channels()
    assert (imu.topic, imu.type_name, imu.encoding) == ("/imu", "sensor_msgs/msg/Imu", "cdr")
    assert imu.schema_encoding == "ros2msg"
    assert b"geometry_msgs/Vector3 angular_velocity" in imu.schema
    assert (text.topic, text.schema) == ("/text", b"string data\n")
    assert imu.count is None


def test_old_tables_are_read(tmp_path):
    """The first table layout has no definitions, and its type names are normalised."""
    path = old_bag(tmp_path / "a.db3", [(20, b"late"), (10, b"early"), (20, b"later")])
    with Db3Log(path) as log:
        (channel,) = log.channels()
        assert (channel.type_name, channel.schema_encoding, channel.schema) == (
            "sensor_msgs/msg/Imu",
            "",
            b"",
        )
        assert rows_of(log, channel) == [(10, b"early"), (20, b"late"), (20, b"later")]


def test_order_does_not_need_the_index(tmp_path):
    """A database without an index of the times gives the same order."""
    path = old_bag(tmp_path / "a.db3", [(20, b"late"), (10, b"early")])
    with sqlite3.connect(path) as database:
        database.execute("DROP INDEX timestamp_idx")
    database.close()
    assert messages(path) == (
        {("/imu", "sensor_msgs/msg/Imu"): [(10, b"early"), (20, b"late")]},
        [],
    )


def test_topic_numbers_of_one_topic_are_one_channel(tmp_path):
    """A topic that was entered twice is one channel, in time order."""
    path = old_bag(tmp_path / "a.db3", [(10, b"a"), (30, b"c")])
    with sqlite3.connect(path) as database:
        database.execute("INSERT INTO topics VALUES (9, '/imu', 'sensor_msgs/msg/Imu', 'cdr')")
        database.execute("INSERT INTO messages VALUES (77, 9, 20, ?)", (b"b",))
    database.close()
    assert messages(path)[0] == {
        ("/imu", "sensor_msgs/msg/Imu"): [(10, b"a"), (20, b"b"), (30, b"c")]
    }


def test_blocks_of_large_messages_are_short(tmp_path):
    """A block of large messages holds few of them, so that memory does not grow with them."""
    path = old_bag(tmp_path / "a.db3", ((k, bytes(1 << 20)) for k in range(80)))
    with Db3Log(path) as log:
        sizes = [len(block) for block in log.blocks(log.channels()[0])]
    assert sizes[0] == 64
    assert max(sizes[1:]) <= 8


def test_blocks_of_small_messages_are_long(tmp_path):
    """Fetches are put together to blocks worth decoding, and each block keeps its promise."""
    path = old_bag(tmp_path / "a.db3", ((k, HEADER + k.to_bytes(4, "big")) for k in range(9000)))
    with Db3Log(path) as log:
        (imu,) = log.channels()
        assert [len(block) for block in log.blocks(imu)] == [64 + 15 * 256, 16 * 256, 1000]
        assert rows_of(log, imu) == [(k, HEADER + k.to_bytes(4, "big")) for k in range(9000)]


def test_names_that_an_address_would_misread(tmp_path):
    """Question marks, hashes and percent signs in a file name are part of the name."""
    path = old_bag(tmp_path / "why?#%20.db3", [(1, b"a")])
    assert messages(path)[0] == {("/imu", "sensor_msgs/msg/Imu"): [(1, b"a")]}


def test_a_write_ahead_log_beside_is_read(tmp_path):
    """Messages that a dead recorder left in the write-ahead log are read too."""
    path = old_bag(tmp_path / "live.db3", [(1, b"a")])
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (4, 2, ?)", (b"b",))
    database.commit()
    for suffix in ("", "-wal"):
        shutil.copy(f"{path}{suffix}", tmp_path / f"dead.db3{suffix}")
    database.close()
    assert messages(tmp_path / "dead.db3") == (
        {("/imu", "sensor_msgs/msg/Imu"): [(1, b"a"), (2, b"b")]},
        [],
    )


def test_nothing_beside_a_closed_database_is_touched(tmp_path):
    """Reading leaves no file beside the database."""
    path = old_bag(tmp_path / "a.db3", [(1, b"a")])
    messages(path)
    assert list(tmp_path.iterdir()) == [path]


def test_damaged_pages_cost_their_own_messages(tmp_path):
    """What is on other pages is read, in order of time, whatever led to it."""
    path = old_bag(tmp_path / "a.db3", ((k, bytes([k % 251]) * 900) for k in range(4000)))
    data = bytearray(path.read_bytes())
    middle = len(data) // 2 // 4096 * 4096
    data[middle : middle + 8192] = b"\xff" * 8192
    path.write_bytes(data)
    found, losses = messages(path)
    rows = found["/imu", "sensor_msgs/msg/Imu"]
    assert len(rows) == 4000 - 8
    assert rows == [(k, bytes([k % 251]) * 900) for k, _ in rows]
    assert [k for k, _ in rows] == sorted(k for k, _ in rows)
    (loss,) = losses
    assert loss.place == "topic '/imu'"
    assert loss.reason.startswith("its database is damaged (")
    assert loss.reason.endswith("and 8 messages of any topic between them are missing")


@pytest.mark.parametrize("large", [False, True])
def test_a_cut_database_gives_what_its_pages_hold(tmp_path, large):
    """Wherever it ends, at least 95 in 100 of the messages on whole pages are read."""
    size = 9000 if large else 900
    path = old_bag(
        tmp_path / "a.db3", ((k, k.to_bytes(4, "big") * (size // 4)) for k in range(1500))
    )
    data = path.read_bytes()
    ends = [data.rindex(k.to_bytes(4, "big") * 40) // 4096 * 4096 + 4096 for k in range(1, 1500)]
    for cut in range(40_000, len(data), len(data) // 19):
        path.write_bytes(data[:cut])
        found, losses = messages(path)
        rows = found["/imu", "sensor_msgs/msg/Imu"]
        assert len(rows) >= 0.95 * sum(end <= cut for end in ends)
        assert rows == [(k, k.to_bytes(4, "big") * (size // 4)) for k, _ in rows]
        assert losses


def test_an_index_that_lacks_rows_hides_none(tmp_path):
    """Rows that an index does not list are found in the table."""
    path = old_bag(tmp_path / "a.db3", ((k, bytes([k % 251]) * 90) for k in range(900)))
    with sqlite3.connect(path) as database:
        database.execute("DROP INDEX timestamp_idx")
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp) WHERE id % 2 = 0")
        database.execute("PRAGMA writable_schema=ON")
        database.execute(
            "UPDATE sqlite_master SET sql = 'CREATE INDEX timestamp_idx ON messages (timestamp)' "
            "WHERE name = 'timestamp_idx'"
        )
    database.close()
    found, losses = messages(path)
    assert found["/imu", "sensor_msgs/msg/Imu"] == [(k, bytes([k % 251]) * 90) for k in range(900)]
    (loss,) = losses
    assert "its index 'timestamp_idx' does not list all messages" in loss.reason


@pytest.mark.parametrize("lacking", [False, True])
def test_deleted_messages_are_no_damage(tmp_path, lacking):
    """Row numbers may have gaps; only rows that an index does not list are damage."""
    path = old_bag(tmp_path / "a.db3", ((k, bytes([k % 251])) for k in range(900)))
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM messages WHERE id BETWEEN 100 AND 199")
        if lacking:
            database.execute("DROP INDEX timestamp_idx")
            database.execute("CREATE INDEX timestamp_idx ON messages (timestamp) WHERE id <> 500")
            database.execute("PRAGMA writable_schema=ON")
            database.execute(
                "UPDATE sqlite_master SET sql = replace(sql, 'WHERE id <> 500', '') "
                "WHERE name = 'timestamp_idx'"
            )
    database.close()
    found, losses = messages(path)
    expected = [(k, bytes([k % 251])) for k in range(900) if not 99 <= k < 199]
    assert found["/imu", "sensor_msgs/msg/Imu"] == expected
    assert ["does not list all messages" in loss.reason for loss in losses] == [True] * lacking


def test_an_intact_table_is_read_once(tmp_path, monkeypatch):
    """Neither rows that are no messages nor rows that the index lacks cost another scan."""
    path = write_bag(tmp_path / "bag")
    statements = []

    def traced(database):
        database.exec_trace = lambda _, sql, __: statements.append(sql) or True

    monkeypatch.setattr(apsw, "connection_hooks", [traced])
    with Db3Log(path) as log:
        channel, _ = log.channels()
        assert len(rows_of(log, channel)) == 1500
    assert ["timestamp, data" in sql or "NOT INDEXED" in sql for sql in statements].count(True) == 0
    assert [sql.count("data") for sql in statements if "ORDER BY timestamp" in sql] == [1]


def test_what_no_topic_has_is_counted_once_and_what_is_no_message_for_its_topic(tmp_path):
    """However many topics are read, and wherever in a topic the odd rows are."""
    path = old_bag(tmp_path / "a.db3", ())
    kinds = [(4, b"a"), (5, b"b"), (4, "text"), (6, b"c"), (5, 1.5), (7, "d"), (4, None)]
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA writable_schema=ON")
        database.execute("UPDATE sqlite_master SET sql = replace(sql, 'BLOB NOT NULL', 'BLOB')")
    database.close()
    with sqlite3.connect(path) as database:
        database.execute("INSERT INTO topics VALUES (5, '/other', 'std_msgs/Empty', 'cdr')")
        for k in range(700):
            row = k, *kinds[k % 7][:1], k, kinds[k % 7][1]
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
    database.close()
    found, losses = messages(path)
    assert found == {
        ("/imu", "sensor_msgs/msg/Imu"): [(k, b"a") for k in range(0, 700, 7)],
        ("/other", "std_msgs/msg/Empty"): [(k, b"b") for k in range(1, 700, 7)],
    }
    assert {(loss.place, loss.messages) for loss in losses} == {
        ("topic '/imu'", 200),
        ("topic '/other'", 100),
        ("topic id 6", 100),
        ("topic id 7", 100),
    }


def test_messages_without_a_topic_are_counted(tmp_path):
    """Messages whose topic id no topic has, or that have none, are lost and located."""
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.executescript(OLD_TABLES.replace("topic_id INTEGER NOT NULL", "topic_id INTEGER"))
        for k, topic in enumerate([4, 7, None, 4, "x", 7]):
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", (k, topic, k, b"a"))
    database.close()
    found, losses = messages(path)
    assert found == {("/imu", "sensor_msgs/msg/Imu"): [(0, b"a"), (3, b"a")]}
    reason = "no topic has this id"
    expected = {"topic id 7": 2, "topic id None": 1, "topic id X'78'": 1}
    assert {loss.place: loss.messages for loss in losses} == expected
    assert {loss.reason for loss in losses} == {reason}


def test_what_follows_a_database_is_reported(tmp_path):
    """SQLite passes over another database behind the first; zeros there are reserved space."""
    path = old_bag(tmp_path / "a.db3", [(k, b"a") for k in range(9)])
    data = path.read_bytes()
    path.write_bytes(data + data)
    found, losses = messages(path)
    assert len(found["/imu", "sensor_msgs/msg/Imu"]) == 9
    reason = f"{len(data)} bytes follow the database and are not read; was another joined to it?"
    assert losses == [Loss(f"byte {len(data)}", reason)]
    path.write_bytes(data + bytes(5000))
    assert messages(path) == (found, [])


def test_topic_ids_of_text_are_read(tmp_path):
    """SQLite compares texts and numbers by the type of the column, and so do we."""
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.executescript(OLD_TABLES.replace("id INTEGER PRIMARY KEY, name", "id TEXT, name"))
        for id_, name in ((None, "/nothing"), ("imu", "/other")):
            row = id_, name, "sensor_msgs/msg/Imu", "cdr"
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
        for k, topic in enumerate([4, "4", "imu", "imu"]):
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", (k, topic, k, b"a"))
    database.close()
    found, losses = messages(path)
    assert found == {
        ("/imu", "sensor_msgs/msg/Imu"): [(0, b"a"), (1, b"a")],
        ("/other", "sensor_msgs/msg/Imu"): [(2, b"a"), (3, b"a")],
    }
    assert losses == []


def test_text_that_is_not_utf_8_costs_its_row(tmp_path):
    """A bad cell is the loss of a row, or a strange letter in a name, and not of the log."""
    path = old_bag(tmp_path / "a.db3", [(0, b"a"), (1, b"b")])
    with sqlite3.connect(path) as database:
        database.execute("INSERT INTO messages VALUES (9, 4, 2, CAST(X'ff' AS TEXT))")
        database.execute("INSERT INTO topics VALUES (5, CAST(X'2fff' AS TEXT), 'a/b', 'cdr')")
    database.close()
    found, losses = messages(path)
    assert found["/imu", "sensor_msgs/msg/Imu"] == [(0, b"a"), (1, b"b")]
    assert found["/\N{REPLACEMENT CHARACTER}", "a/msg/b"] == []
    assert losses == [Loss("topic '/imu'", "their log times or contents are of other types", 1)]


def test_tables_without_rowids_are_read(tmp_path):
    """Nothing but the order of messages of one time hangs on them."""
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.executescript(
            OLD_TABLES.replace("NOT NULL);\nCREATE INDEX", "NOT NULL) WITHOUT ROWID;\nCREATE INDEX")
        )
        database.executemany(
            "INSERT INTO messages VALUES (?, 4, ?, ?)", [(2, 5, b"b"), (1, 9, b"a")]
        )
    database.close()
    found, losses = messages(path)
    assert (found, losses) == ({("/imu", "sensor_msgs/msg/Imu"): [(5, b"b"), (9, b"a")]}, [])


def live_copy(tmp_path, count=3, cut=0, flip=None):
    """Write a database and its write-ahead log as a dead recorder leaves them."""
    path = old_bag(tmp_path / "live.db3", [(0, b"\0" * 3000)])
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    for k in range(1, count + 1):
        data = bytes([k]) * 3000
        database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (4, ?, ?)", (k, data)
        )
        database.commit()
    folder = tmp_path / "dead"
    folder.mkdir()
    shutil.copy(path, folder / "log.db3")
    wal = bytearray((tmp_path / "live.db3-wal").read_bytes())
    database.close()
    if flip is not None:
        wal[flip] ^= 1
    (folder / "log.db3-wal").write_bytes(wal[: len(wal) - cut])
    return folder / "log.db3"


@pytest.mark.parametrize("damage", [{"cut": 100}, {"flip": -100}])
def test_a_write_ahead_log_that_ends_in_a_transaction_says_so(tmp_path, damage):
    """What was committed before is read; the pages that SQLite passes over are a loss."""
    path = live_copy(tmp_path, **damage)
    found, losses = messages(path)
    assert [k for k, _ in found["/imu", "sensor_msgs/msg/Imu"]] == [0, 1, 2]
    (loss,) = losses
    assert loss.place == "log.db3-wal"
    assert "pages of a transaction that was not finished are not read" in loss.reason


@pytest.mark.parametrize(("flip", "count"), [(None, 4), (9000, 1), (-100, 3), (40, 1), (5, 1)])
def test_reading_a_write_ahead_log_leaves_the_folder_as_it_is(tmp_path, flip, count):
    """SQLite's shared memory is not left, and a log that is all damaged is not deleted."""
    path = live_copy(tmp_path, flip=flip)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    assert len(before) == 2
    found, losses = messages(path)
    assert len(found["/imu", "sensor_msgs/msg/Imu"]) == count
    assert bool(losses) == (count < 4)
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


@pytest.mark.parametrize("flip", [1, 9, 17, 25, 31, 33, 40, 44, 50, 4200, 4200 + 8, 4200 + 4120])
def test_a_damaged_write_ahead_log_is_reported(tmp_path, flip):
    """What SQLite does not apply is a loss: the head is damaged, that of a frame, or its page."""
    path = live_copy(tmp_path, flip=flip)
    found, losses = messages(path)
    assert len(found["/imu", "sensor_msgs/msg/Imu"]) < 4
    assert [loss.place for loss in losses] == ["log.db3-wal"]


def test_frames_of_an_earlier_use_of_a_write_ahead_log_are_none(tmp_path):
    """What SQLite has moved to the database stays in the log until it is overwritten."""
    path = old_bag(tmp_path / "a.db3", [(0, b"a")])
    insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (4, ?, ?)"
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    for k in range(1, 9):
        database.execute(insert, (k, b"b" * 3000))
        database.commit()
    database.execute("PRAGMA wal_checkpoint(RESTART)")
    database.execute(insert, (9, b"c"))
    database.commit()
    folder = tmp_path / "copy"
    folder.mkdir()
    for name in ("a.db3", "a.db3-wal"):
        shutil.copy(tmp_path / name, folder)
    database.close()
    found, losses = messages(folder / "a.db3")
    assert [k for k, _ in found["/imu", "sensor_msgs/msg/Imu"]] == list(range(10))
    assert losses == []


def test_damaged_pages_beside_a_write_ahead_log(tmp_path):
    """Newer pages of the log are read instead of those in the database."""
    path = live_copy(tmp_path, count=40)
    content = bytearray(path.read_bytes())
    content[4096 * 3 :] = bytes(len(content) - 4096 * 3)
    path.write_bytes(content)
    found, _ = messages(path)
    assert [k for k, _ in found["/imu", "sensor_msgs/msg/Imu"]][-39:] == list(range(2, 41))


@pytest.mark.parametrize(
    "content", [b"", b"SQLite format 3\x00" + b"\xff" * 5000, b"time,x\n" * 99]
)
def test_what_is_no_database_is_refused(tmp_path, content):
    """A file that is no database, or not a readable one, is refused in one sentence."""
    path = tmp_path / "no.db3"
    path.write_bytes(content)
    with pytest.raises((DamagedLogError, UnsupportedLogError)) as caught:
        Db3Log(path)
    assert str(caught.value).startswith(f"{path}: it")
    assert "\n" not in str(caught.value)


def test_another_database_is_refused(tmp_path):
    """An SQLite database of something else is told from a damaged one."""
    path = tmp_path / "other.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics (id INTEGER)")
    database.close()
    with pytest.raises(
        UnsupportedLogError,
        match=r"other\.db3: it is an SQLite database without the tables of a ROS 2 bag; "
        r"name a database that `ros2 bag` recorded",
    ):
        Db3Log(path)


@pytest.mark.parametrize("value", [b"\x17", b"17", "soon", 1.5, None])
@pytest.mark.parametrize("column", ["timestamp", "data"])
def test_rows_of_other_types_are_lost_and_told(tmp_path, value, column):
    """SQLite takes anything anywhere; what is no time or no bytes is no message."""
    path = tmp_path / "log.db3"
    database = sqlite3.connect(path)
    database.executescript(OLD_TABLES.replace("NOT NULL)", ")").replace("INTEGER NOT NULL", ""))
    for number in range(300):
        row = {"timestamp": 1000 + number, "data": HEADER + bytes([number % 256])}
        if number == 200:
            row[column] = value
        database.execute("INSERT INTO messages VALUES (?, 4, ?, ?)", (number, *row.values()))
    database.commit()
    database.close()
    is_right = column == "data" and isinstance(value, bytes)
    with Db3Log(path) as log:
        (channel,) = log.channels()
        rows = rows_of(log, channel)
        assert [stamp - 1000 for stamp, _ in rows] == [
            number for number in range(300) if number != 200 or is_right
        ]
        reason = "their log times or contents are of other types"
        assert log.losses == ([] if is_right else [Loss("topic '/imu'", reason, 1)])


def test_a_malformed_page_costs_its_own_messages(tmp_path):
    """Of the rows that are fetched together, only those of the page are lost."""
    path = tmp_path / "log.db3"
    database = sqlite3.connect(path)
    database.executescript(OLD_TABLES.replace("CREATE INDEX timestamp_idx", "--"))
    for number in range(1000):
        data = HEADER + number.to_bytes(4, "little") * 75
        database.execute("INSERT INTO messages VALUES (?, 4, ?, ?)", (number, number, data))
    database.commit()
    # Without the index of times SQLite sorts, and reads every page first.
    database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    database.commit()
    database.close()
    content = bytearray(path.read_bytes())
    places = [content.index(HEADER + k.to_bytes(4, "little") * 75) for k in range(1000)]
    page = places[777] // 4096 * 4096
    content[page : page + 12] = b"\xff" * 12
    path.write_bytes(content)
    with Db3Log(path) as log:
        (channel,) = log.channels()
        rows = rows_of(log, channel)
        (loss,) = log.losses
    expected = [k for k in range(1000) if not page <= places[k] < page + 4096]
    assert [stamp for stamp, _ in rows] == expected
    missing = f"{1000 - len(expected)} messages of any topic between them are missing"
    assert loss.reason.endswith(missing)


COMPUTED = {
    "CREATE VIEW messages AS SELECT * FROM rows": "view",
    "CREATE VIEW messages AS SELECT id, topic_id, timestamp, zeroblob(900000000) AS data FROM rows":
        "view",
    "CREATE VIEW Messages AS WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) "
    "SELECT rows.* FROM rows, r": "view",
    "CREATE VIRTUAL TABLE messages USING fts4(topic_id, timestamp, data)": "virtual table",
    "ALTER TABLE rows RENAME TO messages; CREATE TRIGGER endless AFTER INSERT ON messages BEGIN "
    "SELECT 1; END": "trigger",
}  # fmt: skip


@pytest.mark.parametrize("statement", COMPUTED)
def test_what_is_no_table_is_refused(tmp_path, statement):
    """A view that took 23.7 GiB, or never ended: nothing is computed before it is refused."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    with closing(sqlite3.connect(path)) as database:
        database.executescript(f"ALTER TABLE messages RENAME TO rows; {statement};")
    name = {"trigger": "endless"}.get(COMPUTED[statement], statement.split()[2])
    if COMPUTED[statement] == "virtual table":
        name = "messages"
    with pytest.raises(UnsupportedLogError) as refused:
        Db3Log(path)
    assert str(refused.value) == (
        f"{path}: its '{name}' is a {COMPUTED[statement]}, and only tables that hold their rows "
        "are read; name a database that `ros2 bag` recorded"
    )


def test_a_view_with_the_name_of_a_function_is_not_asked(tmp_path):
    """The size of the database was taken from whatever was called `pragma_page_count`."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    with closing(sqlite3.connect(path)) as database:
        database.executescript(
            "CREATE VIEW pragma_page_count AS WITH RECURSIVE r(page_count) AS "
            "(SELECT 1 UNION ALL SELECT 1 FROM r) SELECT * FROM r"
        )
    found, losses = messages(path)
    assert (len(found["/imu", "sensor_msgs/msg/Imu"]), losses) == (3, [])


def test_a_query_that_takes_more_steps_than_its_rows_need_is_interrupted(tmp_path):
    """Whatever makes a database endless, it ends."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    with closing(open_database(path)) as database:
        endless = (
            "WITH RECURSIVE r(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM r) SELECT max(n) FROM r"
        )
        with pytest.raises(apsw.InterruptError):
            database.execute(endless).fetchall()
        with pytest.raises(apsw.TooBigError):
            database.execute("SELECT zeroblob(2000000)").fetchall()


def test_an_index_that_leads_to_a_row_twice_is_not_followed(tmp_path):
    """One row was read twice, and another one not at all, as the index has the right number."""
    path = old_bag(tmp_path / "a.db3", [(T0 + k, HEADER + bytes([k])) for k in range(100)])
    content = bytearray(path.read_bytes())
    entry = (T0 + 40).to_bytes(8, "big") + bytes([41])
    at = content.index(entry) + 8
    content[at] = 43
    path.write_bytes(content)
    found, losses = messages(path)
    rows = found["/imu", "sensor_msgs/msg/Imu"]
    assert rows == [(T0 + k, HEADER + bytes([k])) for k in range(100)]
    (loss,) = losses
    assert loss.reason == (
        "its database is damaged (its index 'timestamp_idx' does not list all messages); "
        "what intact pages hold is read"
    )


def test_a_bag_whose_first_rows_have_no_topic_gives_the_others(tmp_path):
    """A block without any message was a crash."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    with closing(sqlite3.connect(path)) as database:
        database.execute("UPDATE messages SET topic_id = 9")
        database.commit()
    found, losses = messages(path)
    assert found == {("/imu", "sensor_msgs/msg/Imu"): []}
    assert losses == [Loss("topic id 9", "no topic has this id", 3)]
