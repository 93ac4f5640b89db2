"""Every message of a log of messages, as the package reads it and as rosbags does."""

from collections import defaultdict
from itertools import pairwise

from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.typesys.msg import normalize_msgtype


def rows_of(log, channel):
    """Return (log time, bytes) of a channel in the order of its blocks, which keep their word."""
    blocks = list(log.blocks(channel))
    for block, later in pairwise(blocks):
        assert later.log_ns.min() >= block.watermark_ns
    rows = []
    for block in blocks:
        if log.kind in {"bag", "db3"}:
            assert (block.publish_ns == block.log_ns).all()
        data = block.data.tobytes()
        places = zip(block.log_ns.tolist(), block.starts, block.ends, strict=True)
        rows += [(log_ns, data[start:end]) for log_ns, start, end in places]
    return rows


def messages_of(log):
    """Return the messages of each topic and type, sorted, and what was lost; close the log."""
    with log:
        found = defaultdict(list)
        for channel in log.channels():
            found[channel.topic, channel.type_name] += rows_of(log, channel)
        for channel in log.channels():
            # An index that is damaged is rebuilt on reading, or says that there are fewer.
            here = found[channel.topic, channel.type_name]
            assert log.losses or (channel.count or 0) <= len(here)
        return {name: sorted(rows) for name, rows in found.items()}, log.losses


def rosbags_messages(path):
    """Return the same by the reader of rosbags."""
    found = defaultdict(list)
    with (Rosbag1Reader if path.suffix == ".bag" else Rosbag2Reader)(path) as reader:
        for connection in reader.connections:
            found[connection.topic, normalize_msgtype(connection.msgtype)] += []
        for connection, log_ns, data in reader.messages():
            name = connection.topic, normalize_msgtype(connection.msgtype)
            found[name].append((log_ns, bytes(data)))
    return {name: sorted(rows) for name, rows in found.items()}
