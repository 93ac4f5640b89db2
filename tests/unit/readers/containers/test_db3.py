"""SQLite bags, message for message against rosbags' own reader and plain SQL."""

import re
import shutil
import sqlite3
from contextlib import closing

import apsw
import pytest
import zstandard
from make.container_messages import messages_of, rows_of
from make.mcap import Topic, write_topics
from make.ros import ROS2
from rosbags.rosbag2 import StoragePlugin, Writer

from quatprop.base.errors import DamagedLogError, Loss, UnsupportedLogError
from quatprop.readers.containers.db3 import Db3Log
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.containers.rosbag2 import Rosbag2Log
from quatprop.readers.containers.sqlite import open_database
from quatprop.readers.tables.model import TimeRange

T0 = 1_700_000_000_000_000_000
HEADER = b"\x00\x01\x00\x00"
IMU = "/imu", "sensor_msgs/msg/Imu"


OLD_TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
                    serialization_format TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
                      timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO topics VALUES (4, '/imu', 'sensor_msgs/Imu', 'cdr');
"""


def messages(path, **options):
    """Return the messages of each topic, sorted, and what was lost."""
    return messages_of(Db3Log(path, **options))


def write_bag(path):
    """Write a folder with one database, and return the database."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        imu = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=ROS2)
        writer.add_connection("/text", "std_msgs/msg/String", typestore=ROS2)
        for k in range(1500):
            writer.write(imu, k, HEADER + bytes(316))
    return path / f"{path.name}.db3"


def changed(path, statements):
    """Change a database by SQL."""
    with closing(sqlite3.connect(path)) as database:
        database.executescript(statements)
    return path


def old_bag(path, rows, tables=OLD_TABLES):
    """Write a database with the tables of the first ROS 2 releases."""
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(tables)
        insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (4, ?, ?)"
        database.executemany(insert, rows)
    return path


def packed(folder, name, damaged):
    """Write a bag of five packed messages, of which some are damaged."""
    frames = [zstandard.compress(HEADER + bytes([k]) * 100) for k in range(5)]
    frames = [frame[1:] if k in damaged else frame for k, frame in enumerate(frames)]
    if name.endswith(".db3"):
        return old_bag(folder / name, enumerate(frames))
    topics = {"/imu": Topic(IMU[1], list(enumerate(frames)), encoding="cdr")}
    return write_topics(folder / name, topics)


@pytest.mark.parametrize(("kind", "name"), [(Db3Log, "a.db3"), (McapLog, "a.mcap")])
def test_packed_messages_that_are_damaged_are_counted(tmp_path, kind, name):
    """Where the first of a log was damaged, the others were taken for messages as they are."""
    with kind(packed(tmp_path, name, {0, 3})) as log:
        (channel,) = log.channels()
        for _ in range(2):
            rows = rows_of(log, channel)
            assert rows == [(k, HEADER + bytes([k]) * 100) for k in (1, 2, 4)]
        # Once, however often they are read.
        assert log.losses == [Loss("topic '/imu'", "their zstd data is damaged", 2)]


@pytest.mark.parametrize("name", ["a.db3", "a.mcap"])
def test_a_bag_whose_packed_messages_are_all_damaged_has_none(tmp_path, name):
    """A block without any message would be a crash where parts are read in order of time."""
    names = f"relative_file_paths: [{name}]\n  compression_mode: message\n"
    (tmp_path / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  {names}")
    packed(tmp_path, name, range(5))
    reason = "their zstd data is damaged"
    expected = {IMU: []}, [Loss(f"{name}: topic '/imu'", reason, 5)]
    assert messages_of(Rosbag2Log(tmp_path)) == expected


def test_the_definition_comes_from_the_database(tmp_path):
    """A channel has the definition that newer databases carry."""
    with Db3Log(write_bag(tmp_path / "bag")) as log:
        imu, text = log.channels()
    assert (imu.topic, imu.type_name, imu.encoding) == ("/imu", "sensor_msgs/msg/Imu", "cdr")
    assert imu.schema_encoding == "ros2msg"
    assert b"geometry_msgs/Vector3 angular_velocity" in imu.schema
    assert (text.topic, text.schema) == ("/text", b"string data\n")
    assert imu.count is None


@pytest.mark.parametrize("index", ["CREATE INDEX timestamp_idx", "--"])
def test_old_tables_are_read(tmp_path, index):
    """The first layout has no definitions; the order of time does not need the index."""
    tables = OLD_TABLES.replace("CREATE INDEX timestamp_idx", index)
    path = old_bag(tmp_path / "a.db3", [(20, b"late"), (10, b"early"), (20, b"later")], tables)
    with Db3Log(path) as log:
        (channel,) = log.channels()
        assert (channel.type_name, channel.schema_encoding, channel.schema) == (IMU[1], "", b"")
        assert rows_of(log, channel) == [(10, b"early"), (20, b"late"), (20, b"later")]


def test_topic_numbers_of_one_topic_are_one_channel(tmp_path):
    """A topic that was entered twice is one channel, in time order."""
    path = old_bag(tmp_path / "a.db3", [(10, b"a"), (30, b"c")])
    changed(path, "INSERT INTO topics VALUES (9, '/imu', 'sensor_msgs/msg/Imu', 'cdr');"
                  "INSERT INTO messages VALUES (77, 9, 20, CAST('b' AS BLOB))")  # fmt: skip
    assert messages(path) == ({IMU: [(10, b"a"), (20, b"b"), (30, b"c")]}, [])
    with Db3Log(path) as log:
        assert rows_of(log, *log.channels()) == [(10, b"a"), (20, b"b"), (30, b"c")]


def test_blocks_are_as_long_as_is_worth_decoding(tmp_path):
    """Of small messages fetches are put together; of large ones memory does not hold many."""
    rows = [(k, HEADER + k.to_bytes(4, "big")) for k in range(9000)]
    with Db3Log(old_bag(tmp_path / "a.db3", rows)) as log:
        (imu,) = log.channels()
        assert [len(block) for block in log.blocks(imu)] == [64 + 15 * 256, 16 * 256, 1000]
        assert rows_of(log, imu) == rows
    with Db3Log(old_bag(tmp_path / "b.db3", ((k, bytes(1 << 20)) for k in range(75)))) as log:
        sizes = [len(block) for block in log.blocks(log.channels()[0])]
    assert sizes[0] == 64
    assert max(sizes[1:]) <= 8


def test_names_that_an_address_would_misread(tmp_path):
    """Question marks, hashes and percent signs in a file name are part of the name."""
    path = old_bag(tmp_path / "why?#%20.db3", [(1, b"a")])
    assert messages(path) == ({IMU: [(1, b"a")]}, [])
    assert list(tmp_path.iterdir()) == [path]


def test_a_cut_database_gives_what_its_pages_hold(tmp_path):
    """At least 95 in 100 of messages that each take several whole pages are read."""
    path = old_bag(tmp_path / "a.db3", ((k, k.to_bytes(4, "big") * 2250) for k in range(400)))
    data = path.read_bytes()
    ends = [data.rindex(k.to_bytes(4, "big") * 40) // 4096 * 4096 + 4096 for k in range(1, 400)]
    for cut in range(40_000, len(data), len(data) // 19):
        path.write_bytes(data[:cut])
        found, losses = messages(path)
        assert len(found[IMU]) >= 0.95 * sum(end <= cut for end in ends)
        assert found[IMU] == [(k, k.to_bytes(4, "big") * 2250) for k, _ in found[IMU]]
        assert losses


@pytest.mark.parametrize(
    ("definition", "reason"),
    [
        ("", ""),
        ("(timestamp) WHERE id <> 500", "its index 'timestamp_idx' does not list all messages"),
        ("(iif(id = 500, 'x', timestamp))", "its index has values of another type"),
    ],
)
def test_an_index_that_is_wrong_is_told_and_deleted_rows_are_no_damage(
    tmp_path, definition, reason
):
    """Row numbers may have gaps; only rows that an index does not list as they are are damage."""
    path = old_bag(tmp_path / "a.db3", ((k, bytes([k % 251])) for k in range(900)))
    changed(path, "DELETE FROM messages WHERE id BETWEEN 100 AND 199")
    if definition:
        create = "CREATE INDEX timestamp_idx ON messages "
        changed(path, f"DROP INDEX timestamp_idx; {create} {definition}")
        rename = f"UPDATE sqlite_master SET sql = '{create} (timestamp)' WHERE type = 'index'"  # noqa: S608  # no input
        changed(path, f"PRAGMA writable_schema=ON; {rename}")
    with Db3Log(path) as log:
        spans = [log.recorded_span(channel) for channel in log.channels()]
    assert spans == [None if definition else TimeRange(0, 899)]
    found, losses = messages(path)
    if "iif" not in definition:
        assert found[IMU] == [(k, bytes([k % 251])) for k in range(900) if not 99 <= k < 199]
    assert [reason in loss.reason for loss in losses] == [True] * bool(reason)


def leaf_pages(data, text):
    """Return the places of the pages that hold some bytes."""
    return sorted({place.start() // 4096 * 4096 for place in re.finditer(text, data)})


@pytest.mark.parametrize("first", [1, 2**62, 2**63 - 901])
@pytest.mark.parametrize("has_index", [True, False])
@pytest.mark.parametrize("deleted", ["", "NOT BETWEEN 300 AND 499", "% 3 = 0"])
def test_rows_that_were_deleted_before_are_not_lost_to_damage(tmp_path, first, has_index, deleted):
    """A filtered bag has gaps in its row ids, which may be near their end."""
    tables = OLD_TABLES if has_index else OLD_TABLES.replace("CREATE INDEX", "-- CREATE INDEX")
    path = old_bag(tmp_path / "a.db3", (), tables)
    with closing(sqlite3.connect(path)) as database, database:
        for k in range(900):
            row = first + k, 4, k, b"mark" + k.to_bytes(4, "big") * 60
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
        if deleted:
            database.execute(f"DELETE FROM messages WHERE timestamp {deleted}")  # noqa: S608
    with closing(sqlite3.connect(path)) as database:
        database.execute("VACUUM")
        (count,) = database.execute("SELECT count(*) FROM messages").fetchone()
    data = bytearray(path.read_bytes())
    hit = leaf_pages(data, b"mark")[5]
    data[hit : hit + 8] = bytes(8)
    path.write_bytes(data)
    found, (loss,) = messages(path)
    missing = count - len(found[IMU])
    assert 0 < missing < 30
    limit, said = re.search(r"and (at most )?(\d+) messages of any topic", loss.reason).groups()
    assert bool(limit) is not has_index
    if has_index or not deleted:
        assert int(said) == missing
    else:
        assert missing <= int(said) <= 900 - len(found[IMU])


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
    tables = OLD_TABLES.replace("INTEGER NOT NULL", "INTEGER").replace("BLOB NOT NULL", "BLOB")
    path = old_bag(tmp_path / "a.db3", (), tables)
    kinds = [(4, b"a"), (5, b"b"), (4, "text"), (6, b"c"), (5, 1.5), (None, "d"), (4, None),
             ("x", b"f")]  # fmt: skip
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("INSERT INTO topics VALUES (5, '/other', 'std_msgs/Empty', 'cdr')")
        for k in range(800):
            topic, data = kinds[k % 8]
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", (k, topic, k, data))
    found, losses = messages(path)
    assert found == {
        IMU: [(k, b"a") for k in range(0, 800, 8)],
        ("/other", "std_msgs/msg/Empty"): [(k, b"b") for k in range(1, 800, 8)],
    }
    counts = {"topic '/imu'": 200, "topic '/other'": 100}
    counts |= dict.fromkeys(("topic id 6", "topic id None", "topic id X'78'"), 100)
    assert {loss.place: loss.messages for loss in losses} == counts
    assert {loss.reason for loss in losses if " id " in loss.place} == {"no topic has this id"}


def test_zeros_behind_a_database_are_reserved_space(tmp_path):
    """Only other bytes could be another log."""
    path = old_bag(tmp_path / "a.db3", [(k, b"a") for k in range(9)])
    expected = messages(path)
    path.write_bytes(path.read_bytes() + bytes(5000))
    assert messages(path) == expected


def test_topic_ids_of_text_are_read(tmp_path):
    """SQLite compares texts and numbers by the type of the column, and so do we."""
    tables = OLD_TABLES.replace("id INTEGER PRIMARY KEY, name", "id TEXT, name")
    path = changed(
        old_bag(tmp_path / "a.db3", (), tables),
        "INSERT INTO topics VALUES (NULL, '/nothing', 'sensor_msgs/msg/Imu', 'cdr');"
        "INSERT INTO topics VALUES ('imu', '/other', 'sensor_msgs/msg/Imu', 'cdr');"
        "INSERT INTO messages VALUES (0, 4, 0, X'61'), (1, '4', 1, X'61'), (2, 'imu', 2, X'61')",
    )
    other = "/other", IMU[1]
    assert messages(path) == ({IMU: [(0, b"a"), (1, b"a")], other: [(2, b"a")]}, [])


def test_text_that_is_not_utf_8_costs_its_row(tmp_path):
    """A bad cell is the loss of a row, or a strange letter in a name, and not of the log."""
    path = old_bag(tmp_path / "a.db3", [(0, b"a"), (1, b"b")])
    changed(path, "INSERT INTO messages VALUES (9, 4, 2, CAST(X'ff' AS TEXT));"
                  "INSERT INTO topics VALUES (5, CAST(X'2fff' AS TEXT), 'a/b', 'cdr')")  # fmt: skip
    strange = "/\N{REPLACEMENT CHARACTER}", "a/msg/b"
    assert messages(path) == (
        {IMU: [(0, b"a"), (1, b"b")], strange: []},
        [Loss("topic '/imu'", "their log times or contents are of other types", 1)],
    )


def test_tables_without_rowids_are_read(tmp_path):
    """Nothing but the order of messages of one time hangs on them."""
    tables = OLD_TABLES.replace("L);\nCREATE INDEX", "L) WITHOUT ROWID;\nCREATE INDEX")
    rows = "INSERT INTO messages VALUES (2, 4, 5, X'62'), (1, 4, 9, X'61')"
    path = changed(tmp_path / "a.db3", tables + rows)
    assert messages(path) == ({IMU: [(5, b"b"), (9, b"a")]}, [])


def live_copy(tmp_path, count=3, checkpoint=None, before=1):
    """Write a database and its write-ahead log as a dead recorder leaves them."""
    path = old_bag(tmp_path / "live.db3", [(k, bytes([k]) * 3000) for k in range(before)])
    folder = tmp_path / "dead"
    folder.mkdir()
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        for k in range(before, before + count):
            insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (4, ?, ?)"
            database.execute(insert, (k, bytes([k]) * 3000))
            database.commit()
            if k == checkpoint:
                database.execute("PRAGMA wal_checkpoint(RESTART)")
        shutil.copy(path, folder / "log.db3")
        shutil.copy(tmp_path / "live.db3-wal", folder / "log.db3-wal")
    return folder / "log.db3"


def damaged_copy(tmp_path, cut=0, flip=None):
    """Write such a database, with its write-ahead log cut, or with a bit of it flipped."""
    path = live_copy(tmp_path)
    file = path.with_name("log.db3-wal")
    wal = bytearray(file.read_bytes())
    if flip is not None:
        wal[flip] ^= 1
    file.write_bytes(wal[: len(wal) - cut])
    return path


# In the head of the log, in that of a frame, or in its page.
FLIPS = [1, 5, 9, 17, 25, 31, 33, 40, 44, 50, 4200, 4200 + 8, 4200 + 4120, 9000]


@pytest.mark.parametrize(
    ("damage", "count"),
    [({}, 4), ({"cut": 100}, 3), ({"flip": -100}, 3), *(({"flip": flip}, 1) for flip in FLIPS)],
)
def test_what_is_not_applied_of_a_write_ahead_log_is_a_loss(tmp_path, damage, count):
    """Committed messages are read, and a folder is left as it is, whatever is damaged."""
    path = damaged_copy(tmp_path, **damage)
    before = {file.name: file.read_bytes() for file in path.parent.iterdir()}
    assert before.keys() == {"log.db3", "log.db3-wal"}
    found, losses = messages(path)
    assert [k for k, _ in found[IMU]] == [*range(count)]
    assert [loss.place for loss in losses] == ["log.db3-wal"] * (count < 4)
    if count == 3:
        said = "pages of a transaction that was not finished are not read"
        assert said in losses[0].reason
    if damage == {"flip": 50}:  # in the page of the first frame: none that follow is applied
        frames = len(before["log.db3-wal"]) // (24 + 4096)
        assert losses[0].reason.startswith(f"{frames} pages of a transaction")
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == before


def test_frames_of_an_earlier_use_of_a_write_ahead_log_are_none(tmp_path):
    """Pages that SQLite has moved to the database stay in the log until overwritten."""
    found, losses = messages(live_copy(tmp_path, count=9, checkpoint=8))
    assert [k for k, _ in found[IMU]] == list(range(10))
    assert losses == []


def test_damaged_pages_next_to_a_write_ahead_log(tmp_path):
    """Newer pages of the log are read instead of those in the database."""
    path = live_copy(tmp_path, count=20, before=10)
    content = bytearray(path.read_bytes())
    page = content.index(bytes([3]) * 2000) // 4096 * 4096
    content[page : page + 12] = b"\xff" * 12
    path.write_bytes(content)
    found, (loss,) = messages(path)
    assert [k for k, _ in found[IMU]] == [k for k in range(30) if k != 3]
    assert "and 1 messages of any topic are missing" in loss.reason


@pytest.mark.parametrize(
    "content", [b"", b"SQLite format 3\x00" + b"\xff" * 5000, b"time,x\n" * 99]
)
def test_what_is_no_database_is_refused(tmp_path, content):
    """In one sentence; an SQLite database of something else is told from a damaged one."""
    path = tmp_path / "no.db3"
    path.write_bytes(content)
    with pytest.raises((DamagedLogError, UnsupportedLogError)) as caught:
        Db3Log(path)
    assert str(caught.value).startswith(f"{path}: it")
    assert "\n" not in str(caught.value)
    with pytest.raises(
        UnsupportedLogError,
        match=r"other\.db3: it is an SQLite database without the tables of a ROS 2 bag; "
        r"name a database that `ros2 bag` recorded",
    ):
        Db3Log(changed(tmp_path / "other.db3", "CREATE TABLE topics (id INTEGER)"))


@pytest.mark.parametrize("value", [b"\x17", b"17", "soon", 1.5, None])
@pytest.mark.parametrize("column", ["timestamp", "data"])
def test_rows_of_other_types_are_lost_and_told(tmp_path, value, column):
    """SQLite takes anything anywhere; what is no time or no bytes is no message."""
    rows = [{"timestamp": 1000 + k, "data": HEADER + bytes([k % 256])} for k in range(300)]
    rows[200][column] = value
    tables = OLD_TABLES.replace("NOT NULL)", ")").replace("INTEGER NOT NULL", "")
    found, losses = messages(
        old_bag(tmp_path / "a.db3", [(*row.values(),) for row in rows], tables)
    )
    is_right = column == "data" and isinstance(value, bytes)
    kept = [1000 + k for k in range(300) if k != 200 or is_right]
    assert [stamp for stamp, _ in found[IMU]] == kept
    reason = "their log times or contents are of other types"
    assert losses == ([] if is_right else [Loss("topic '/imu'", reason, 1)])


@pytest.mark.parametrize(("indexed", "row"), [(True, 777), (False, 777), (True, 0)])
@pytest.mark.parametrize("damage", [(0, b"\xff" * 12, 0), (3, b"\xff\xff", 0), (3, b"\0\1", 1)])
def test_a_malformed_page_costs_its_own_messages(tmp_path, indexed, row, damage):
    """Of the rows that are fetched together, only those of the page are lost."""
    at, harm, kept = damage
    rows = [(k, HEADER + k.to_bytes(4, "little") * 75) for k in range(1000)]
    path = old_bag(tmp_path / "a.db3", rows, OLD_TABLES.replace("CREATE INDEX timestamp_idx", "--"))
    # Without the index of times SQLite sorts, and reads every page first.
    if indexed:
        changed(path, "CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    content = bytearray(path.read_bytes())
    places = [content.index(data) for _, data in rows]
    page = places[row] // 4096 * 4096
    content[page + at : page + at + len(harm)] = harm
    path.write_bytes(content)
    found, (loss,) = messages(path)
    lost = [k for k in range(1000) if page <= places[k] < page + 4096][kept:]
    expected = [k for k in range(1000) if k not in lost]
    assert [stamp for stamp, _ in found[IMU]] == expected
    limit = "" if indexed else "at most "
    missing = f", and {limit}{1000 - len(expected)} messages of any topic are missing; `sqlite3"
    assert loss.place == "topic '/imu'"
    assert loss.reason.startswith("its database is damaged (")
    assert missing in loss.reason


def test_a_damaged_cell_of_a_damaged_database_gives_no_message_that_was_not_there(tmp_path):
    """Where the pages are read one by one, each length and number in a cell is checked."""
    rows = [(k, HEADER + k.to_bytes(4, "little") * 75) for k in range(100)]
    path = changed(
        old_bag(tmp_path / "a.db3", rows), "INSERT INTO messages VALUES (-7, 4, 100, X'00010000')"
    )
    content = bytearray(path.read_bytes())
    page = content.index(rows[20][1]) // 4096 * 4096
    content[page : page + 12] = b"\xff" * 12
    expected = [*rows, (100, HEADER)]
    blob = content.index(rows[60][1])
    for place in range(blob - 11, blob):
        for bit in (0, 3, 7):
            content[place] ^= 1 << bit
            path.write_bytes(content)
            content[place] ^= 1 << bit
            found, losses = messages(path)
            others = [row for row in found[IMU] if row not in expected]
            assert len(others) <= (place == blob - 1)  # the time, whose damage cannot be noticed
            assert losses
    path.write_bytes(content)
    found, (loss,) = messages(path)
    assert expected[-1] in found[IMU]
    missing = len(expected) - len(found[IMU])
    assert f"and {missing} messages of any topic are missing" in loss.reason


def test_rows_between_damaged_pages_are_read(tmp_path):
    """Of many damaged pages, each costs its own messages; the last ones, too."""
    rows = [(k, HEADER + k.to_bytes(4, "little") * 75) for k in range(1000)]
    path = old_bag(tmp_path / "a.db3", rows)
    content = bytearray(path.read_bytes())
    pages = [content.index(data) // 4096 * 4096 for _, data in rows]
    damaged = {pages[k] for k in (0, 100, 130, 131, 500, 999)}
    for page in damaged:
        content[page : page + 12] = b"\xff" * 12
    path.write_bytes(content)
    found, (loss,) = messages(path)
    assert found[IMU] == [row for row, page in zip(rows, pages, strict=True) if page not in damaged]
    assert f"and {1000 - len(found[IMU])} messages of any topic are missing" in loss.reason


def varint(number):
    """Return a number as SQLite stores its lengths."""
    groups = [number >> shift & 0x7F for shift in range(0, number.bit_length(), 7)][::-1]
    return bytes([*(group | 0x80 for group in groups[:-1]), groups[-1]])


def test_a_message_whose_end_is_cut_off_is_lost_alone(tmp_path):
    """Where none of the messages that are fetched together is whole."""
    path = old_bag(tmp_path / "a.db3", [(5, bytes(range(250)) * 40)])
    path.write_bytes(path.read_bytes()[:-4096])
    found, (loss,) = messages(path)
    assert found == {IMU: []}
    assert "and 1 messages of any topic are missing" in loss.reason


def test_a_message_longer_than_its_database_is_lost_alone(tmp_path):
    """Where its overflow pages are a circle, there would be no end of it."""
    rows = [(k, bytes([k + 1]) * 5000) for k in range(20)]
    content = bytearray(old_bag(tmp_path / "a.db3", rows).read_bytes())
    page = next(
        page
        for page in range(0, len(content), 4096)
        if content[page] == 0x0D and rows[9][1][:400] in content[page : page + 4096]
    )
    lost = [k for k, data in rows if data[:400] in content[page : page + 4096]]
    overflow = content.index(rows[0][1][:4000]) // 4096 + 1
    # One cell at 100: its id, and of NULL, two integers and the bytes the types, and the integers.
    types = b"\0\1\1" + varint(12 + 2 * (len(content) + 5000))
    record = bytes([1 + len(types)]) + types + bytes([4, 9])
    size = len(record) + len(content) + 5000
    local = 489 + (size - 489) % 4092
    cell = varint(size) + b"\x0a" + record.ljust(489 if local > 4061 else local, b"\0")
    content[page : page + 10] = b"\x0d\0\0\0\1\0\x64\0\0\x64"
    content[page + 100 : page + 104 + len(cell)] = cell + overflow.to_bytes(4, "big")
    content[4096 * overflow - 4096 : 4096 * overflow - 4092] = overflow.to_bytes(4, "big")
    (tmp_path / "a.db3").write_bytes(content)
    found, (loss,) = messages(tmp_path / "a.db3")
    assert [k for k, _ in found[IMU]] == [row[0] for row in rows if row[0] not in lost], loss
    assert f"{len(lost)} messages of any topic are missing" in loss.reason


def test_a_journal_that_is_done_with_is_no_loss(tmp_path):
    """Some recorders keep it, with zeros for its head, and it is no write-ahead log."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    changed(path, "PRAGMA journal_mode=PERSIST; INSERT INTO messages VALUES (9, 4, 9, X'00')")
    assert path.with_name("a.db3-journal").stat().st_size
    assert messages(path) == ({IMU: [*((k, HEADER) for k in range(3)), (9, b"\0")]}, [])


def test_a_journal_that_cannot_be_applied_is_a_loss(tmp_path):
    """A transaction that was begun is undone by whoever may write; the database is read."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    journal = path.with_name("a.db3-journal")
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA cache_spill=1")
        database.execute("PRAGMA cache_size=1")
        database.executemany(
            "INSERT INTO messages VALUES (?, 4, ?, ?)", ((k, k, bytes(4000)) for k in range(9, 99))
        )
        left = journal.read_bytes(), path.read_bytes()
    journal.write_bytes(left[0])
    path.write_bytes(left[1])
    found, losses = messages(path)
    assert [(k, HEADER) for k in range(3)] == found[IMU][:3]
    assert losses[0].place == "a.db3-journal"
    assert "it cannot be applied (" in losses[0].reason
    assert journal.read_bytes() == left[0]


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
    changed(path, f"ALTER TABLE messages RENAME TO rows; {statement};")
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
    changed(
        path,
        "CREATE VIEW pragma_page_count AS WITH RECURSIVE r(page_count) AS "
        "(SELECT 1 UNION ALL SELECT 1 FROM r) SELECT * FROM r",
    )
    assert messages(path) == ({IMU: [(k, HEADER) for k in range(3)]}, [])


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


def test_a_bag_whose_first_rows_have_no_topic_gives_the_others(tmp_path):
    """A block without any message was a crash."""
    path = old_bag(tmp_path / "a.db3", [(k, HEADER) for k in range(3)])
    changed(path, "UPDATE messages SET topic_id = 9")
    assert messages(path) == ({IMU: []}, [Loss("topic id 9", "no topic has this id", 3)])
