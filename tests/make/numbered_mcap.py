"""MCAP files whose messages are their own numbers, and what is read of them."""

import io
import struct
import zlib

from mcap.writer import IndexType, Writer

from quatprop.containers.mcap.log import McapLog

MESSAGES = 400


def written(**options):
    """Return a log of one topic in chunks of some twenty messages."""
    buffer = io.BytesIO()
    writer = Writer(buffer, **{"chunk_size": 1500, **options})
    writer.start("ros2", "test")
    schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", b"Header header")
    channel = writer.register_channel("/imu", "cdr", schema)
    for number in range(MESSAGES):
        content = number.to_bytes(8, "little") + zlib.crc32(b"%d" % number).to_bytes(4, "big") * 8
        writer.add_message(channel, number, content, number, number)
    writer.finish()
    return buffer.getvalue()


BARE = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}


def unclosed(content):
    """Return a file as a recorder leaves it that dies: without data end, summary and footer."""
    return content[: next(begin for opcode, begin, _ in records(content) if opcode == 15)]


def records(content):
    """Return opcode, begin and end of each record of the file, chunks not opened."""
    position, found = 8, []
    while position + 9 <= len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


def read(tmp_path, content):
    """Return the numbers in the messages of a file, and what is told as lost."""
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    log = McapLog(path)
    numbers = [
        int.from_bytes(block.data[start:end][:8].tobytes(), "little")
        for channel in log.channels()
        for block in log.blocks(channel)
        for start, end in zip(block.starts, block.ends, strict=True)
    ]
    return numbers, log.losses
