"""A walk over every byte of a ROS 1 bag, from the specification of the format."""

import bz2
import struct

import lz4.frame

UNPACK = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}
BAG, MESSAGE, INDEX, CHUNK, CHUNK_INFO, CONNECTION = b"\3", b"\2", b"\4", b"\5", b"\6", b"\7"


def walk(data, at=0):
    """Yield place, fields and content of each record."""
    while at < len(data):
        begin = at
        (size,) = struct.unpack_from("<I", data, at)
        head, fields = data[at + 4 : at + 4 + size], {}
        while head:
            (length,) = struct.unpack_from("<I", head)
            name, _, value = head[4 : 4 + length].partition(b"=")
            fields[name.decode()] = value
            head = head[4 + length :]
        (length,) = struct.unpack_from("<I", data, at + 4 + size)
        at += 8 + size + length
        yield begin, fields, data[at - length : at]


def number(data):
    """Return a number of any size."""
    return int.from_bytes(data, "little")


def time(data):
    """Return a time in ns."""
    seconds, nanoseconds = struct.unpack("<II", data)
    return seconds * 10**9 + nanoseconds


def unclosed(data):
    """Return a bag as a recorder leaves it that dies: without its index."""
    at = data.index(b"index_pos=") + 10
    return data[:at] + bytes(8) + data[at + 8 : number(data[at : at + 8])]


def examine_bag(path):
    """Assert that a bag's indexes, if it has any, tell of every message where it is.

    Returns the messages as topic, log time and bytes, in order of the file, and the first and last
    time of each chunk, in order of the index.
    """
    data = path.read_bytes()
    topics, messages, chunks, indexed, spans, connections = {}, [], {}, {}, [], 0
    for place, fields, content in walk(data, len("#ROSBAG V2.0\n")):
        if fields["op"] == BAG:
            header = fields
        elif fields["op"] == CHUNK:
            latest, chunks[place], indexed[place] = place, {}, {}
            for at, inner, body in walk(UNPACK[fields["compression"]](content)):
                if inner["op"] == CONNECTION:
                    topics[inner["conn"]] = inner["topic"].decode()
                else:
                    assert inner["op"] == MESSAGE
                    chunks[place][at] = number(inner["conn"]), time(inner["time"])
                    messages.append((inner["conn"], time(inner["time"]), body))
        elif fields["op"] == INDEX:
            entries = [(time(content[k : k + 8]), number(content[k + 8 : k + 12]))
                       for k in range(0, len(content), 12)]  # fmt: skip
            by_place = sorted(entries, key=lambda entry: entry[1])
            assert entries in (by_place, sorted(by_place, key=lambda entry: entry[0]))
            assert len(entries) == number(fields["count"])
            indexed[latest] |= {at: (number(fields["conn"]), when) for when, at in entries}
        elif fields["op"] == CONNECTION:
            connections += 1
        else:
            assert fields["op"] == CHUNK_INFO
            held = list(chunks[number(fields["chunk_pos"])].values())
            times = [when for _, when in held]
            spans.append((time(fields["start_time"]), time(fields["end_time"])))
            assert spans[-1] == (min(times), max(times))
            told = struct.unpack(f"<{len(content) // 4}I", content)
            ids = [id_ for id_, _ in held]
            counts = dict(zip(told[::2], told[1::2], strict=True))
            assert counts == {id_: ids.count(id_) for id_ in ids}
    if spans:
        assert indexed == chunks
        assert (number(header["conn_count"]), connections) == (connections, len(topics))
        assert number(header["chunk_count"]) == len(spans) == len(chunks)
    return [(topics[id_], when, body) for id_, when, body in messages], spans
