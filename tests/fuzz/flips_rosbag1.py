"""Small ROS 1 bags, and the structure of their records."""

import struct
import tempfile
from functools import cache
from pathlib import Path
from typing import NamedTuple

from fuzz.flips import series
from make.bag_doctor import unclosed
from make.formats import IMU, ROS1, imus
from rosbags.rosbag1 import Writer

OPS = {2: "message", 3: "bag header", 4: "index data", 5: "chunk", 6: "chunk info", 7: "connection"}
MESSAGES = 3
"""Messages at each end of a chunk whose heads are structure to look at: the others are alike."""


@cache
def layouts():
    """Return bags in chunks of 60 samples and notes: each compression, no index, no chunks."""
    plain = _bag(None)
    return {
        "none": plain,
        "lz4": _bag("LZ4"),
        "bz2": _bag("BZ2"),
        "one topic": _bag(None, notes=False),
        "no index": unclosed(plain),
    }


class Record(NamedTuple):
    """A record: where it begins, and where its data begin and end."""

    op: str
    start: int
    begin: int
    end: int


TITLE = "ROS 1 bag"
UNNOTICED = {"cut after a chunk": "a bag that was not closed and ends there"}
COUNTED = ("none", "lz4", "bz2", "one topic")


def _bag(compression, *, notes=True):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.bag"
        writer = Writer(path)
        writer.chunk_threshold = 60 * 400
        if compression:
            writer.set_compression(Writer.CompressionFormat[compression])
        with writer:
            imu = writer.add_connection("/imu", IMU, typestore=ROS1)
            note = notes and writer.add_connection("/note", "std_msgs/msg/UInt8", typestore=ROS1)
            for k, (t_ns, data) in enumerate(imus(ROS1, series())):
                writer.write(imu, t_ns, data)
                if notes and k % 10 == 0:
                    writer.write(note, t_ns, b"\0")
        return path.read_bytes()


def heads(data):
    """Return what each byte of the heads of records is: of the bag, and inside plain chunks."""
    names = dict.fromkeys(range(13), "magic")
    for record in _records(data, 13, len(data)):
        _name(names, data, record)
        if record.op == "chunk" and b"compression=none" in data[record.start : record.begin]:
            inside = list(_records(data, record.begin, record.end))
            messages = [each for each in inside if each.op == "message"]
            others = [each for each in inside if each.op != "message"]
            for each in (*others, *messages[:MESSAGES], *messages[-MESSAGES:]):
                _name(names, data, each)
    return names


def ends(data):
    """Return where the chunks end."""
    return [record.end for record in _records(data, 13, len(data)) if record.op == "chunk"]


def _records(data, at, stop):
    """Yield the records from one place to another."""
    while at < stop:
        (length,) = struct.unpack_from("<I", data, at)
        begin = at + 8 + length
        (size,) = struct.unpack_from("<I", data, begin - 4)
        op = OPS[data[data.index(b"op=", at) + 3]]
        yield Record(op, at, begin, begin + size)
        at = begin + size


def _name(names, data, record):
    """Name the bytes of a head; of data that are fields as well, or that count something."""
    op, start, begin, end = record
    names.update(dict.fromkeys(range(start, start + 4), f"{op}: length of the header"))
    names.update(dict.fromkeys(range(begin - 4, begin), f"{op}: length of the data"))
    _name_fields(names, data, op, start + 4, begin - 4)
    if op == "connection":
        _name_fields(names, data, f"{op}: data", begin, end)
    if op in {"chunk info", "index data"}:
        size = 8 if op == "chunk info" else 12
        parts = ("connection", "count") if op == "chunk info" else ("seconds", "ns", "offset")
        for at in (*range(begin, end, size),)[:MESSAGES]:
            for k in range(size):
                names[at + k] = f"{op}: {parts[k // 4]}"


def _name_fields(names, data, op, at, stop):
    while at < stop:
        (length,) = struct.unpack_from("<I", data, at)
        name = data[at + 4 : at + 4 + length].partition(b"=")[0].decode()
        names.update(dict.fromkeys(range(at, at + 4), f"{op}: length of {name}"))
        names.update(dict.fromkeys(range(at + 4, at + 5 + len(name)), f"{op}: name of {name}"))
        names.update(dict.fromkeys(range(at + 5 + len(name), at + 4 + length), f"{op}: {name}"))
        at += 4 + length
