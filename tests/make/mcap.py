"""MCAP files of plain numbers, and what the library's own reader finds in them."""

import io
import struct

from mcap import records
from mcap.stream_reader import StreamReader
from mcap.writer import Writer


def written(*, messages=60, uneven=True, first_ns=1000, **options):
    """Return a log of three topics, the first with two publishers, the third without messages."""
    buffer = io.BytesIO()
    writer = Writer(buffer, **{"chunk_size": 400, **options})
    writer.start("ros2", "test")
    imu = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"Header header")
    one = writer.register_channel("/imu", "cdr", imu)
    two = writer.register_channel("/imu", "cdr", imu, {"publisher": "second"})
    bare = writer.register_channel("/bare", "json", 0)
    writer.register_channel("/silent", "cdr", imu)
    for number in range(messages):
        channel = (one, one, two, bare)[number % 4 if uneven else 0]
        size = 8 * (1 + number % 3) if uneven else 24
        stamp = first_ns + 10 * number
        writer.add_message(channel, stamp, number.to_bytes(size, "little"), stamp - 1, number)
        if number == messages // 2:
            writer.add_attachment(1, 1, "notes", "text/plain", b"m" * 99)
    writer.finish()
    return buffer.getvalue()


def saved(tmp_path, content, name="log.mcap"):
    """Return the path of a file with this content."""
    path = tmp_path / name
    path.write_bytes(content)
    return path


def read(log):
    """Return (topic, log time, publish time, data) of every message, channel after channel."""
    return [
        (channel.topic, int(log_ns), int(publish_ns), block.data[start:end].tobytes())
        for channel in log.channels()
        for block in log.blocks(channel)
        for start, end, log_ns, publish_ns in zip(
            block.starts, block.ends, block.log_ns, block.publish_ns, strict=True
        )
    ]


def truth(content):
    """Return the same from the library's reader."""
    topics, messages = {}, []
    for record in StreamReader(io.BytesIO(content)).records:
        if isinstance(record, records.Channel):
            topics[record.id] = record.topic
        elif isinstance(record, records.Message):
            messages.append(
                (topics[record.channel_id], record.log_time, record.publish_time, record.data)
            )
    return messages


def every_record(content):
    """Yield opcode, begin and end of each record of the file, chunks not opened."""
    position = 8
    while position < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, position)
        yield opcode, position, position + 9 + length
        position += 9 + length
