"""Odd but valid logs of messages, and what other readers find in them."""

import shutil
import sqlite3
import struct

from make.bag_doctor import walk
from make.mcap import MAGIC, Topic, records, write
from make.ros import IMU, ROS1, ROS2
from make.ros import encoded as encoded_message
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, IndexType
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from ruamel.yaml import YAML

TEXT = "std_msgs/msg/String"
T0 = 1_700_000_000_000_000_000


def times(rng):
    """Return (log time, header stamp) of messages in the order of the file."""
    count = rng.choice((1, 2, 40, 90))
    log = [T0 + 10_000_000 * k for k in range(count)]
    stamps = [ns - rng.randrange(9_000_000) for ns in log]
    order = rng.choice(("rising", "falling", "shuffled", "equal", "swapped", "late stamps"))
    if order == "falling":
        log.reverse()
    elif order == "shuffled":
        rng.shuffle(log)
    elif order == "equal":
        log = [T0] * count
    elif order == "swapped":
        log[::2], log[1::2] = log[1::2] + log[2 * (count // 2) :: 2], log[: 2 * (count // 2) : 2]
        log += [T0 + 10_000_000 * count] * (count - len(log))
    elif order == "late stamps":
        rng.shuffle(stamps)
    return list(zip(log, stamps, strict=True))


def encoded(rng, stamp, *, ros1=False):
    """Return an encoded message."""
    values = {
        "header": {"seq": 7, "stamp": stamp, "frame_id": "f" * rng.choice((0, 1, 2, 3, 4, 9))},
        "orientation": (0.0, 0.0, 0.6, 0.8),
        "angular_velocity": [rng.gauss(0, 1) for _ in "xyz"],
        "linear_acceleration": (0.0, 0.0, 9.81),
    }
    if ros1:
        return encoded_message(ROS1, IMU, values)
    return encoded_message(ROS2, IMU, values, little_endian=rng.random() < 0.6)


def sample(data, *, ros1=False):
    """Return header stamp and rates of an encoded message, by rosbags."""
    message = ROS1.deserialize_ros1(data, IMU) if ros1 else ROS2.deserialize_cdr(data, IMU)
    stamp, rate = message.header.stamp, message.angular_velocity
    return stamp.sec * 10**9 + stamp.nanosec, (rate.x, rate.y, rate.z)


def in_time(messages, *, ros1=False):
    """Return the samples of (log time, bytes) in time order, and whether that order is unique."""
    messages = sorted(messages, key=lambda message: message[0])
    unique = len({ns for ns, _ in messages}) == len(messages)
    return [sample(data, ros1=ros1) for _, data in messages], unique


def mcap_log(rng, folder):
    """Write an MCAP file, edit its records, and read it with the library, from front to back."""
    path = folder / "log.mcap"
    ros1 = rng.random() < 0.3
    store, suffix, encoding = (ROS1, "ros1msg", "ros1") if ros1 else (ROS2, "ros2msg", "cdr")
    text, _ = store.generate_msgdef(IMU, ros_version=2 - ros1)
    imu = Topic(IMU.replace("/msg/", "/") if ros1 else IMU, (), b"", suffix, encoding)
    count = rng.choice((1, 1, 3))
    topics = [
        ("/imu", imu._replace(definition=b"# note\n" * k + text.encode(), metadata=[("k", str(k))]))
        for k in range(count)
    ]
    topics += [("/bare", Topic("")), ("/silent", Topic("a/msg/B", (), b"", suffix, "cdr"))]

    def events():
        for log_ns, stamp in times(rng):
            data = encoded(rng, stamp, ros1=ros1)
            for _ in range(rng.choice((1, 1, 1, 2))):
                yield rng.randrange(count), log_ns, data, stamp
            if rng.random() < 0.1:
                yield count, log_ns - 5, b"{}", 0
                yield lambda writer: writer.add_metadata("note", {"k": "v"})
                yield lambda writer: writer.add_attachment(1, 1, "a", "text/plain", MAGIC)

    options = {
        name: rng.random() < 0.7
        for name in ("use_chunking", "use_statistics", "use_summary_offsets", "enable_crcs",
                     "repeat_channels", "repeat_schemas")
    } | {
        "chunk_size": rng.choice((1, 500, 3000, 10**6)),
        "compression": rng.choice(list(CompressionType)),
        "index_types": rng.choice((IndexType.ALL, IndexType.NONE, IndexType.CHUNK)),
        "profile": rng.choice(("", "ros1", "ros2", "other")),
    }  # fmt: skip
    with path.open("wb") as stream:
        write(stream, topics, events(), **options)
    if rng.random() < 0.5:
        path.write_bytes(edited_mcap(rng, path.read_bytes()))
    with path.open("rb") as stream:
        read = NonSeekingReader(stream).iter_messages(topics=["/imu"], log_time_order=False)
        messages = [(message.log_time, message.data) for _, _, message in read]
    return path, {}, *in_time(messages, ros1=ros1)


def edited_mcap(rng, data):
    """Return an MCAP file without summary, its records repeated, exchanged and mixed."""
    every = [data[begin:end] for _, begin, end in records(data)]
    every = every[: [record[0] for record in every].index(15)]
    first, rest = every[0], [record for record in every[1:] if record[0] not in (7, 8)]
    parts = [record for record in rest if record[0] in (5, 6)]
    definitions = [record for record in rest if record[0] in (3, 4)]
    if rng.random() < 0.5 and all(record[0] == 5 for record in parts) and definitions:
        rng.shuffle(parts)
    if parts and rng.random() < 0.5:
        parts += rng.choices(parts, k=2)
    empty_chunk = struct.pack("<QQQIIQ", 0, 0, 0, 0, 0, 0)
    for opcode, content in ((0x06, empty_chunk), (0x80, b"private"), (0x55, b"later")):
        record = bytes([opcode]) + struct.pack("<Q", len(content)) + content
        parts.insert(rng.randrange(len(parts) + 1), record)
    definitions *= rng.choice((1, 2))
    if rng.random() < 0.5:
        parts[len(parts) // 2 : len(parts) // 2] = definitions
    data_end, footer = struct.pack("<BQI", 15, 4, 0), struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    return b"".join((data[:8], first, *definitions, *parts, data_end, footer, data[:8]))


def ros1_bag(rng, folder):
    """Write a ROS 1 bag, turn the fields of its record headers around, and read it by rosbags."""
    path = folder / "log.bag"
    writer = rosbag1.Writer(path)
    writer.chunk_threshold = rng.choice((1, 900, 10**6))
    compression = rng.choice((None, *rosbag1.Writer.CompressionFormat))
    if compression:
        writer.set_compression(compression)
    with writer:
        imu = [
            writer.add_connection("/imu", IMU, typestore=ROS1, callerid=f"/node{k}")
            for k in range(rng.choice((1, 1, 3)))
        ]
        text = writer.add_connection("/text", TEXT, typestore=ROS1)
        for log_ns, stamp in times(rng):
            data = encoded(rng, stamp, ros1=True)
            for _ in range(rng.choice((1, 1, 2))):
                writer.write(rng.choice(imu), log_ns, data)
            if rng.random() < 0.2:
                writer.write(text, log_ns, bytes(4))
    if rng.random() < 0.5:
        content = path.read_bytes()
        path.write_bytes(content[:13] + turned_fields(content[13:]))
    return path, {}, *in_time(read_by(rosbag1.Reader(path)), ros1=True)


def read_by(reader):
    """Return log times and bytes of the messages of /imu."""
    with reader:
        imu = [connection for connection in reader.connections if connection.topic == "/imu"]
        return [(ns, bytes(data)) for _, ns, data in reader.messages(imu)]


def turned_fields(data):
    """Return ROS 1 records with the fields of every header in the opposite order."""
    out = []
    for _, fields, content in walk(data):
        parts = [name.encode() + b"=" + value for name, value in reversed(fields.items())]
        header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
        out += [struct.pack("<I", len(header)), header, struct.pack("<I", len(content)), content]
    return b"".join(out)


def ros2_bag(rng, folder):
    """Write a ROS 2 bag of one or several files, some of them empty; read it by rosbags."""
    path = folder / "log"
    storage = rng.choice(list(StoragePlugin))
    mode = rng.choice((CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE))
    rows = times(rng)
    parts = [rows[k::3] for k in range(3)] if rng.random() < 0.4 else [rows]
    parts += [[]] if rng.random() < 0.3 else []
    for number, part in enumerate(parts):
        writer = rosbag2.Writer(
            folder / f"log_{number}", version=rng.choice((8, 9)), storage_plugin=storage
        )
        if mode is not CompressionMode.NONE:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            imu = writer.add_connection("/imu", IMU, typestore=ROS2)
            text = writer.add_connection("/text", TEXT, typestore=ROS2)
            for log_ns, stamp in part:
                writer.write(imu, log_ns, encoded(rng, stamp))
                if rng.random() < 0.2:
                    writer.write(text, log_ns, b"\0\1\0\0\1\0\0\0\0")
    joined_ros2(rng, folder, path, len(parts))
    return path, {}, *in_time(read_by(rosbag2.Reader(path)))


def joined_ros2(rng, folder, path, count):
    """Join bags into one of several files, and change the databases' layout."""
    path.mkdir()
    yaml = YAML(typ="safe")
    joined = yaml.load(folder / "log_0" / "metadata.yaml")
    total = joined["rosbag2_bagfile_information"]
    for number in range(count):
        part = folder / f"log_{number}"
        told = yaml.load(part / "metadata.yaml")["rosbag2_bagfile_information"]
        if number:
            total["relative_file_paths"] += told["relative_file_paths"]
            total.get("files", []).extend(told.get("files", []))
            topics = "topics_with_message_count"
            pairs = zip(total[topics], told[topics], strict=True)
            for one, more in ((total, told), *pairs):
                one["message_count"] += more["message_count"]
        for file in part.iterdir():
            if file.suffix == ".db3":
                edit_database(rng, file)
            if file.name != "metadata.yaml":
                shutil.copy(file, path)
    yaml.dump(joined, path / "metadata.yaml")


def edit_database(rng, file):
    """Rearrange the rows of a SQLite bag, and what SQLite may store them in."""
    connection = sqlite3.connect(file)
    if rng.random() < 0.5:
        rows = connection.execute("SELECT topic_id, timestamp, data FROM messages").fetchall()
        rng.shuffle(rows)
        connection.execute("DELETE FROM messages")
        numbers = rng.sample(range(-1000, 10**6), len(rows))
        rows = [(number, *row) for number, row in zip(numbers, rows, strict=True)]
        statement = "INSERT INTO messages (id, topic_id, timestamp, data) VALUES (?, ?, ?, ?)"
        connection.executemany(statement, rows)
    for statement in rng.sample(DATABASE_EDITS, 3):
        connection.execute(statement)
    connection.commit()
    connection.execute(f"PRAGMA page_size={rng.choice((512, 4096, 65536))}")
    if rng.random() < 0.5:
        connection.execute("VACUUM")
    connection.close()


DATABASE_EDITS = (
    "DROP INDEX IF EXISTS timestamp_idx",
    "CREATE TABLE notes (id INTEGER PRIMARY KEY, note TEXT)",
    "CREATE VIEW imu AS SELECT * FROM messages WHERE topic_id = 1",
    "CREATE INDEX by_topic ON messages (topic_id, timestamp DESC)",
    "ALTER TABLE messages ADD COLUMN extra TEXT DEFAULT 'x'",
    "INSERT INTO topics SELECT 90, '/empty', 'a/msg/B', 'cdr', '', '' FROM topics LIMIT 1",
    "PRAGMA user_version=7",
)

MESSAGE_LOGS = {"mcap": mcap_log, "bag": ros1_bag, "rosbag2": ros2_bag}
