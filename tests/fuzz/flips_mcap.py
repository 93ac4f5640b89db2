"""MCAP files of which every head of a record can be damaged: seven layouts, and a walk over them.

Written here byte by byte, since no library writes a file without statistics, or without an end.
"""

import struct
import zlib

import numpy as np
from make.formats import PACK
from make.mcap import MAGIC, records
from make.ros import IMU, ROS2

COUNT, MOST, CHUNKS = 200, 6000, 4
T_NS = 1_700_000_000 * 10**9 + 10_000_000 * np.arange(MOST)
RATES = np.stack([np.arange(1.0, MOST + 1), np.zeros(MOST), np.zeros(MOST)], axis=1)
"""The first messages on ``/imu``: all other topics hold nothing that can be read as rates."""

MESSAGE, CHUNK, ATTACHMENT = 5, 6, 9
NAMES = {
    1: "header", 2: "footer", 3: "schema", 4: "channel", MESSAGE: "message", CHUNK: "chunk",
    7: "message index", 8: "chunk index", ATTACHMENT: "attachment", 10: "attachment index",
    11: "statistics", 15: "data end",
}  # fmt: skip
"""Of records, by opcode."""
_COMPRESS = {"": bytes, "lz4": PACK["lz4"], "zstd": PACK["zst"]}


def text(content):
    """Return bytes or a string behind their length."""
    content = content if isinstance(content, bytes) else content.encode()
    return struct.pack("<I", len(content)) + content


def record(opcode, content):
    """Return a record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def message(channel, number, t_ns, data):
    """Return a message record."""
    return record(5, struct.pack("<HIQQ", channel, number, t_ns, t_ns) + data)


def imu(t_ns, rate):
    """Return an Imu in CDR; to encode thousands of them takes a second."""
    head = struct.pack("<iI", *divmod(t_ns, 10**9)) + text(b"imu\0")
    head += bytes(-len(head) % 8) + struct.pack("<13d", 0, 0, 0, 1, -1, *[0] * 8)
    return b"\0\1\0\0" + head + struct.pack("<24d", *rate, *[0] * 21)


def definitions():
    """Return the schemas and channels of the files."""
    out = b""
    for id_, topic, kind in ((1, "/imu", IMU), (2, "/note", "std_msgs/msg/String")):
        content, _ = ROS2.generate_msgdef(kind, ros_version=2)
        out += record(3, struct.pack("<H", id_) + text(kind) + text("ros2msg") + text(content))
        out += record(4, struct.pack("<HH", id_, id_) + text(topic) + text("cdr") + text(b""))
    return out


def messages(begin, end, scale=1.0):
    """Return channel, time and record of the messages of some samples: an Imu, often a note."""
    for k in range(begin, end):
        t_ns = int(T_NS[k])
        yield 1, t_ns, message(1, k, t_ns, imu(t_ns, scale * RATES[k]))
        if k % 10 == 0:
            yield 2, t_ns, message(2, k, t_ns, b"\0\1\0\0" + text(b"abc\0"))


def chunk(some, compression):
    """Return a chunk record, and the entries of the index of each channel."""
    body, entries = bytearray(), {}
    for channel, t_ns, content in some:
        entries.setdefault(channel, []).append((t_ns, len(body)))
        body += content
    times = [t_ns for rows in entries.values() for t_ns, _ in rows]
    data = _COMPRESS[compression](bytes(body))
    head = struct.pack("<QQQI", min(times), max(times), len(body), zlib.crc32(body))
    head += text(compression)
    return record(6, head + struct.pack("<Q", len(data)) + data), entries, len(body), len(data)


def message_index(channel, rows):
    """Return a message index with these times and offsets."""
    entries = b"".join(struct.pack("<QQ", *row) for row in rows)
    return record(7, struct.pack("<H", channel) + text(entries))


def mcap(  # noqa: PLR0913  # each part of a file can be missing
    compression="zstd",
    *,
    count=COUNT,
    closed=True,
    summary=True,
    statistics=True,
    chunk_indexes=True,
    chunked=True,
    has_data_crc=False,
    attached=b"",
):
    """Return a file of samples in four chunks, with some of what it could have.

    `closed`: with data end, summary and footer; `attached`: what comes behind the second chunk
    """
    out = bytearray(MAGIC + record(1, text("ros2") + text("quatprop")))
    out += definitions()
    indexes, counts = [], {1: 0, 2: 0}
    attachment_index = b""
    for number in range(CHUNKS):
        some = list(messages(number * count // CHUNKS, (number + 1) * count // CHUNKS))
        for channel, _, _ in some:
            counts[channel] += 1
        start = len(out)
        if not chunked:
            out += b"".join(content for _, _, content in some)
            continue
        content, entries, size, packed = chunk(some, compression)
        out += content
        length, places = len(content), {}
        for channel, rows in sorted(entries.items(), reverse=True):
            places[channel] = len(out)
            out += message_index(channel, rows)
        index = struct.pack("<QQQQ", some[0][1], some[-1][1], start, length)
        index += text(b"".join(struct.pack("<HQ", *each) for each in places.items()))
        index += struct.pack("<Q", len(out) - start - length) + text(compression)
        indexes.append(record(8, index + struct.pack("<QQ", packed, size)))
        if attached and number == 1:
            named = text("other.mcap") + text("application/octet-stream")
            body = struct.pack("<QQ", *[int(T_NS[0])] * 2) + named
            body += struct.pack("<Q", len(attached)) + attached
            place = len(out)
            out += record(ATTACHMENT, body + struct.pack("<I", zlib.crc32(body)))
            where = place, len(out) - place, *[int(T_NS[0])] * 2, len(attached)
            attachment_index = record(10, struct.pack("<QQQQQ", *where) + named)
    if not closed:
        return bytes(out)
    out += record(15, struct.pack("<I", zlib.crc32(out) if has_data_crc else 0))
    start, end = len(out), b""
    if summary:
        end += definitions()
        if statistics:
            head = struct.pack(
                "<QHIIIIQQ", sum(counts.values()), 2, 2, bool(attached), 0, len(indexes),
                int(T_NS[0]), int(T_NS[count - 1]),
            )  # fmt: skip
            end += record(11, head + text(struct.pack("<HQHQ", 1, counts[1], 2, counts[2])))
        end += b"".join(indexes) * chunk_indexes + attachment_index
    out += end + record(2, struct.pack("<QQI", start if end else 0, 0, 0)) + MAGIC
    return bytes(out)


def embedded():
    """Return an MCAP file whose rates are no samples of the file that it is attached to."""
    out = MAGIC + record(1, text("ros2") + text("quatprop")) + definitions()
    out += b"".join(content for _, _, content in messages(0, 20, scale=-1.0))
    content, entries, _, _ = chunk(list(messages(20, 40, scale=-1.0)), "")
    out += content
    for channel, rows in entries.items():
        out += message_index(channel, rows)
    return out + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def layouts():
    """Return a file in each of several layouts, by name."""
    return {
        "no summary": mcap(summary=False),
        "full": mcap(),
        "no statistics": mcap(statistics=False),
        "no chunk indexes": mcap(chunk_indexes=False),
        "unclosed": mcap(closed=False),
        "attachment": mcap(attached=embedded()),
        "attachment, no summary": mcap(summary=False, attached=embedded()),
        "attachment, unclosed": mcap(closed=False, attached=embedded()),
        "unchunked": mcap(chunked=False, has_data_crc=True),
    }


def heads(data):
    """Return what the bytes are, by position: a file's magic bytes, and the heads of its records.

    Of messages outside chunks, that look alike, the first five are enough.
    """
    places = dict.fromkeys(range(len(MAGIC)), "magic bytes")
    loose = 0
    for opcode, start, end in records(data):
        loose += opcode == MESSAGE
        if opcode == MESSAGE and loose > 5:
            continue
        size = {MESSAGE: 22, CHUNK: 44}.get(opcode, 64)
        head = range(start, min(end, start + 9 + size))
        places |= {at: f"{NAMES[opcode]}, byte {at - start}" for at in head}
        if opcode == ATTACHMENT:
            places |= dict.fromkeys(range(end - 4, end), "checksum of an attachment")
    if data.endswith(MAGIC):
        places |= dict.fromkeys(range(len(data) - len(MAGIC), len(data)), "magic bytes")
    return places
