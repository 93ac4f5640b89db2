"""The same samples in every format: a kind of log that has a row in FORMATS has its tests."""

import bz2
import gzip
import json
import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import h5py
import lz4.frame
import numpy as np
import pyarrow as pa
import zstandard
from make import ulog
from make.json_messages import imu as json_imu
from make.mcap import BARE, Topic, write_topics
from make.protobuf import FOXGLOVE, described, made, stamp_file
from make.ros import IMU, ROS1, ROS2, encoded
from mcap.writer import CompressionType
from pyarrow import feather, parquet
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from scipy.io import savemat

from quatprop.kinematics.series import GyroSeries
from quatprop.readers.containers.ulog import SYNC

NS = 1_000_000_000
SAMPLES = 200
"""Samples of a small log: damage meets its structure more often than its numbers."""
NOT_READ = ("kitti", "sto")
"""Formats that are written and not read again with timestamps: rows of matrices have none, and
several numbers in a cell are refused."""
TOPICS = ("/imu", "/other")
FRAME = "imu"
PACK = {
    "gz": lambda data: gzip.compress(data, mtime=0),
    "zst": zstandard.ZstdCompressor().compress,
    "lz4": lz4.frame.compress,
    "bz2": bz2.compress,
}


def samples(count=SAMPLES, first=0):
    """Return rates at uneven stamps, whose numbers have all their digits."""
    k = np.arange(first, first + count)
    t_ns = 1_700_000_000_000_000_000 + 10_000_000 * k + k * 7919 % 100_003
    return GyroSeries(t_ns, np.sin(k[:, None] / 10 + np.arange(3)))


def imus(store, series):
    """Yield log time, and message, of samples; each is logged as it is stamped."""
    for k, (t_ns, rate) in enumerate(zip(series.t_ns.tolist(), series.rate.tolist(), strict=True)):
        yield t_ns, _imu(store, k, t_ns, *rate)


@cache
def _imu(store, k, t_ns, *rate):
    values = {
        "header": {"seq": k, "stamp": t_ns, "frame_id": FRAME},
        "orientation": (0.0, 0.0, 0.0, 1.0),
        "angular_velocity": rate,
        "linear_acceleration": (0.0, 0.0, 9.81),
    }
    return encoded(store, IMU, values)


def ros_topic(series):
    """Return samples as messages of ROS 2."""
    definition, _ = ROS2.generate_msgdef(IMU, ros_version=2)
    return Topic(IMU, list(imus(ROS2, series)), definition.encode(), "ros2msg", "cdr")


def _json_topic(series):
    messages = []
    for t_ns, rate in zip(series.t_ns.tolist(), series.rate.tolist(), strict=True):
        stamp = dict(zip(("sec", "nanosec"), divmod(t_ns, NS), strict=True))
        messages.append((t_ns, json_imu(*rate, stamp=stamp)))
    return Topic("sensor_msgs/Imu", messages)


def protobuf_topic(series):
    """Return a topic of foxglove.Odometry."""
    odometry, messages = made("foxglove.Odometry", FOXGLOVE, stamp_file()), []
    for t_ns, (x, y, z) in zip(series.t_ns.tolist(), series.rate.tolist(), strict=True):
        message = odometry(frame_id="odom", body_frame_id="base")
        message.timestamp.seconds, message.timestamp.nanos = divmod(t_ns, NS)
        message.angular_velocity.x, message.angular_velocity.y = x, y
        message.angular_velocity.z = z
        messages.append((t_ns, message.SerializeToString()))
    schema = described(FOXGLOVE, stamp_file())
    return Topic("foxglove.Odometry", messages, schema, "protobuf", "protobuf")


def _mcap(topic=ros_topic, **options):
    """Return a writer of MCAP; without checksums, so that damage gets further than they."""
    options = {"enable_crcs": False, "chunk_size": 20_000, **options}

    def write(path, *several):
        topics = {name: topic(one) for name, one in zip(TOPICS, several, strict=False)}
        profile = "ros2" if topic is ros_topic else ""
        write_topics(path, topics, profile=profile, **options)

    return write


def _bag(compression=None):
    def write(path, *several):
        writer = BagWriter(path)
        writer.chunk_threshold = 20_000
        if compression:
            writer.set_compression(BagWriter.CompressionFormat[compression])
        _fill(writer, ROS1, several)

    return write


def _fill(writer, store, several):
    with writer:
        for topic, series in zip(TOPICS, several, strict=False):
            connection = writer.add_connection(topic, IMU, typestore=store)
            for t_ns, data in imus(store, series):
                writer.write(connection, t_ns, data)


def _folder(storage):
    def write(path, *several):
        _fill(FolderWriter(path, version=9, storage_plugin=storage), ROS2, several)

    return write


def _db3(path, *several):
    folder = path.with_suffix(".folder")
    _folder(StoragePlugin.SQLITE3)(folder, *several)
    next(folder.glob("*.db3")).rename(path)
    shutil.rmtree(folder)


def _split(path, *several):
    """Write a ROS 2 bag in three files, as a recorder leaves them that dies: without metadata."""
    path.mkdir()
    for number in range(3):
        parts = [one[number * len(one) // 3 : (number + 1) * len(one) // 3] for one in several]
        _mcap(enable_crcs=True)(path / f"split_{number}.mcap", *parts)


def _wal(path, *several):
    """Write a ROS 2 bag whose second half is still in the write-ahead log of SQLite."""
    _folder(StoragePlugin.SQLITE3)(path, *several)
    (file,) = path.glob("*.db3")
    with closing(sqlite3.connect(file)) as database:
        half = len(several[0].t_ns) // 2
        rows = database.execute("SELECT * FROM messages WHERE id > ?", (half,)).fetchall()
        database.execute("DELETE FROM messages WHERE id > ?", (half,))
        database.commit()
        database.execute("VACUUM")
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("PRAGMA wal_autocheckpoint=0")
        for first in range(0, len(rows), 20):
            statement = "INSERT INTO messages VALUES (?, ?, ?, ?)"
            database.executemany(statement, rows[first : first + 20])
            database.commit()
        left = {one: one.read_bytes() for one in (file, Path(f"{file}-wal")) if one.exists()}
    for one, content in left.items():
        one.write_bytes(content)


def _ulog(path, *several):
    """Write gyroscopes, with other records between their messages."""
    between = [
        ulog.record(b"S", SYNC),
        ulog.record(b"L", b"6" + bytes(8) + b"hello"),
        ulog.record(b"D", struct.pack("<HQf", 7, 3, 1.0)),
    ]
    baro = ulog.record(b"F", b"sensor_baro:uint64_t timestamp;float pressure;")
    begins = [ulog.added("sensor_gyro", number, number + 1) for number in range(len(several))]
    records = [baro, *begins, ulog.added("sensor_baro", 0, 7)]
    for id_, series in enumerate(several, 1):
        rows = zip((series.t_ns // 1000).tolist(), series.rate.tolist(), strict=True)
        for k, (t_us, (x, y, z)) in enumerate(rows):
            values = {"timestamp": t_us + 9, "timestamp_sample": t_us, "x": x, "y": y, "z": z}
            records += [ulog.data("sensor_gyro", id_, **values), between[k % len(between)]]
    ulog.write(path, *records)


def _columns(series):
    return {"t_ns": series.t_ns, **dict(zip(("wx", "wy", "wz"), series.rate.T, strict=True))}


def _lines(head, line):
    def write(path, series):
        rows = zip(series.t_ns.tolist(), *series.rate.T.tolist(), strict=True)
        path.write_bytes((head + "".join(f"{line(*row)}\n" for row in rows)).encode())

    return write


def _semicolon_line(t_ns, *rate):
    return ";".join([f"{t_ns // NS}.{t_ns % NS:09d}", *map(str, rate)])


def _quoted_line(t_ns, *rate):
    return "\t".join([str(t_ns), '"a ""b"" \n c"', *map(str, rate)])


def _json_line(t_ns, *rate):
    stamp = dict(zip(("sec", "nanosec"), divmod(t_ns, NS), strict=True))
    gyro = dict(zip("xyz", rate, strict=True))
    return json.dumps({"header": {"stamp": stamp}, "note": 'a "b" \\', "angular_velocity": gyro})


def _saved(save):
    return lambda path, series: save(path, _columns(series))


def _arrow(write, **options):
    return _saved(lambda path, columns: write(pa.table(columns), path, **options))


def _records(path, columns):
    np.save(path, np.asarray(np.rec.fromarrays(list(columns.values()), names=list(columns))))


def _plain_hdf5(path, columns):
    with h5py.File(path, "w") as file:
        file.update(columns)


def _packed_hdf5(path, series):
    """Write packed chunks with names of columns, in a group."""
    with h5py.File(path, "w", libver="latest") as file:
        options = {"compression": "gzip", "fletcher32": True}
        file.create_dataset("imu/t_ns", data=series.t_ns, chunks=(50,), maxshape=(None,), **options)
        gyro = file.create_dataset(
            "imu/gyr", data=series.rate, chunks=(50, 3), maxshape=(None, 3), **options
        )
        gyro.attrs["columns"] = np.array([f"{axis} [rad/s]".encode() for axis in "xyz"])


class Format(NamedTuple):
    """A kind of log, and what it cannot do.

    `write`: writes samples to a path; of further samples, the further topics or instances
    `topics`: the names of those; none where there is one series only
    `joined`: what comes of two logs that `cat` joins: ``"read"``, or ``"lost"``, which is the
        second one, or ``"refused"``
    `indexed`: whether a range of time is read without the rest, by an index that is believed
    `checked`: whether every damaged byte of the samples is noticed, by checksums
    `single`: whether stamps are whole us and rates float32
    """

    write: Callable
    topics: tuple[str, ...] = ()
    joined: str = "read"
    indexed: bool = False
    checked: bool = False
    single: bool = False

    def holds(self, series):
        """Return samples as the format holds them."""
        if not self.single:
            return series
        return GyroSeries(series.t_ns // 1000 * 1000, np.float32(series.rate).astype(float))


SEMICOLONS = "# rates;of;a;gyroscope\ntime [s];gyro_x [rad/s];gyro_y [rad/s];gyro_z [rad/s]\n"
_ros = partial(Format, topics=TOPICS)
_indexed = partial(_ros, indexed=True)
_feather = partial(_arrow, feather.write_feather, chunksize=50)
_parquet = partial(_arrow, parquet.write_table)
_sqlite, _folder_mcap = StoragePlugin.SQLITE3, StoragePlugin.MCAP
FORMATS = {
    "none.mcap": _ros(_mcap(compression=CompressionType.NONE)),
    "lz4.mcap": _ros(_mcap(compression=CompressionType.LZ4)),
    "zstd.mcap": _ros(_mcap()),
    "bare.mcap": _ros(_mcap(compression=CompressionType.NONE, **BARE)),
    "unchunked.mcap": _ros(_mcap(use_chunking=False)),
    "checked.mcap": _indexed(_mcap(enable_crcs=True), checked=True),
    "json.mcap": _ros(_mcap(_json_topic)),
    "protobuf.mcap": _ros(_mcap(protobuf_topic)),
    "none.bag": _indexed(_bag()),
    "bz2.bag": _indexed(_bag("BZ2")),
    "lz4.bag": _indexed(_bag("LZ4")),
    "sqlite.db3": _indexed(_db3, joined="lost"),
    "db3_ros2": _indexed(_folder(_sqlite)),
    "mcap_ros2": _ros(_folder(_folder_mcap)),
    "split_ros2": _indexed(_split),
    "wal_ros2": _indexed(_wal),
    "gyro.ulg": Format(_ulog, ("sensor_gyro/0", "sensor_gyro/1"), "lost", single=True),
    "commas.csv": Format(_lines("t_ns,wx,wy,wz\n", lambda *row: ",".join(map(str, row)))),
    "semicolons.csv": Format(_lines(SEMICOLONS, _semicolon_line)),
    "quoted.tsv": Format(_lines('"t_ns"\t"note"\t"wx"\t"wy"\t"wz"\n', _quoted_line)),
    "rows.jsonl": Format(_lines("", _json_line)),
    "groups.parquet": Format(_parquet(compression="zstd", row_group_size=50), (), "refused", True),
    "plain.parquet": Format(_parquet(compression="none", use_dictionary=False), (), "refused"),
    "uncompressed.feather": Format(_feather(compression="uncompressed"), (), "refused"),
    "lz4.feather": Format(_feather(compression="lz4"), (), "refused"),
    "zstd.feather": Format(_feather(compression="zstd"), (), "refused"),
    "records.npy": Format(_saved(_records), (), "lost"),
    "stored.npz": Format(
        _saved(lambda path, columns: np.savez(path, **columns)), (), "refused", checked=True
    ),
    "packed.npz": Format(
        _saved(lambda path, columns: np.savez_compressed(path, **columns)),
        (),
        "refused",
        checked=True,
    ),
    "plain.h5": Format(_saved(_plain_hdf5), (), "lost"),
    "packed.h5": Format(_packed_hdf5, (), "lost", checked=True),
    "plain.mat": Format(_saved(savemat), (), "lost"),
    "packed.mat": Format(_saved(partial(savemat, do_compression=True)), (), "lost", checked=True),
}


def _packed(name, suffix):
    """Return a format inside one of compressed files."""

    def write(path, *several):
        inside = path.with_name(f"inside-{name}")
        FORMATS[name].write(inside, *several)
        path.write_bytes(PACK[suffix](inside.read_bytes()))
        inside.unlink()

    return FORMATS[name]._replace(write=write, checked=suffix in {"gz", "bz2"})


PACKED = {"commas.csv": PACK, "none.mcap": ("gz", "lz4"), "none.bag": ("zst", "bz2")}
"""Files are unpacked alike whatever they hold: each is packed as what is read from end to end, and
as what is read here and there."""
FORMATS |= {f"{name}.{suffix}": _packed(name, suffix) for name in PACKED for suffix in PACKED[name]}


def write_all(folder, count=SAMPLES):
    """Write a log of every format, with the same samples."""
    given = samples(count)
    for name, form in FORMATS.items():
        form.write(folder / name, form.holds(given))
