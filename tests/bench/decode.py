"""Messages to columns: every container against the libraries that read it."""

import sqlite3
from functools import partial
from pathlib import Path

import lz4.frame
import zstandard
from make.protobuf import FOXGLOVE, made, stamp_file
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from table import Table, best_of

from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection

CHUNK_HEAD = 9 + 8 + 8 + 8 + 4 + 4 + 8
"""Bytes of a chunk record before its data, but for the name of the compression."""


def ours(path: Path) -> int:
    """Decode every sample with quatprop."""
    with open_log(path) as log:
        return sum(len(batch) for batch in choose_rates(log, RateSelection()).batches())


def with_rosbags(path: Path) -> int:
    """Decode every message with rosbags."""
    count = 0
    with AnyReader([path]) as reader:
        wanted = [connection for connection in reader.connections if "Imu" in connection.msgtype]
        for connection, _, raw in reader.messages(wanted):
            count += reader.deserialize(raw, connection.msgtype).angular_velocity.x is not None
    return count


def with_mcap(path: Path) -> int:
    """Decode every message with the mcap package and mcap-ros2-support."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages())


def with_protobuf(path: Path) -> int:
    """Parse every message with the mcap and the protobuf package."""
    odometry = made("foxglove.Odometry", FOXGLOVE, stamp_file())
    with path.open("rb") as file:
        messages = make_reader(file).iter_messages()
        return sum(1 for *_, message in messages if odometry.FromString(message.data))


def read_and_decompress(path: Path) -> int:
    """Read the chunks of an MCAP file and decompress them: the floor under any reader."""
    unpack = {"zstd": zstandard.ZstdDecompressor().decompress, "lz4": lz4.frame.decompress}
    size = 0
    with path.open("rb") as file:
        for index in make_reader(file).get_summary().chunk_indexes:
            file.seek(index.chunk_start_offset)
            chunk = file.read(index.chunk_length + index.message_index_length)
            packed = memoryview(chunk)[CHUNK_HEAD + len(index.compression) :][
                : index.compressed_size
            ]
            size += len(unpack[index.compression](packed) if index.compression else packed)
    return size


def select_blobs(path: Path) -> int:
    """Fetch stamps and blobs of a bag in order of time: the floor under any reader."""
    (path,) = path.glob("*.db3")
    database = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    rows = database.execute("SELECT timestamp, data FROM messages ORDER BY timestamp")
    count = 0
    while batch := rows.fetchmany(4096):
        count += len(batch)
    return count


LOGS = [
    "imu_zstd.mcap", "imu_none.mcap", "frames_zstd.mcap", "images_zstd.mcap", "images_none.mcap",
    "imu.bag", "imu_db3", "odometry.mcap",
]  # fmt: skip


def measure(folder: Path, _samples: int) -> None:
    """Print one table a log."""
    for path in (folder / name for name in LOGS):
        samples = ours(path)
        readers = {"quatprop": (5, ours)}
        if path.suffix == ".mcap":
            readers["read and decompress alone"] = 5, read_and_decompress
        if path.is_dir():
            readers["SELECT of stamps and blobs alone"] = 5, select_blobs
        if path.name == "odometry.mcap":
            readers["mcap + protobuf"] = 1, with_protobuf
        else:
            readers["rosbags AnyReader + deserialize"] = 1, with_rosbags
        if path.name == LOGS[0]:
            readers["mcap + mcap-ros2-support"] = 1, with_mcap
        table = Table(f"decode {path.name}, {samples:,} messages")
        for name, (repeats, read) in readers.items():
            table.row(name, best_of(repeats, partial(read, path)), samples)
