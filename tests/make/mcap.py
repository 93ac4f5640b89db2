"""MCAP files by the library's own writer, and what it and the package find in them."""

import io
import json
import struct
import zlib
from itertools import count
from typing import NamedTuple

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import IndexType, Writer

from quatprop.readers.containers.mcap import McapLog

MAGIC = b"\x89MCAP0\r\n"
BARE = {
    "index_types": IndexType.NONE,
    "use_statistics": False,
    "use_summary_offsets": False,
    "repeat_channels": False,
    "repeat_schemas": False,
}
"""Options of the writer for a file without what readers can do without."""


class Topic(NamedTuple):
    """A topic: how its messages are encoded and defined, and the messages in order.

    A message is its bytes, or a dictionary for JSON; ``(time, message)`` states its log time, ns.
    """

    type_name: str
    messages: list = ()
    definition: bytes = b"{}"
    schema_encoding: str = "jsonschema"
    encoding: str = "json"
    metadata: tuple = ()


def write(stream, topics, events, *, profile="", **options):
    """Write a file.

    `topics`: pairs of a name, which may come again, and a topic, whose messages do not count
    `events`: messages in order: the place of the topic, the log time in ns, the bytes, and when it
        was published if at another time; or something else that is done with the writer
    `options`: of the writer
    """
    writer = Writer(stream, **options)
    writer.start(profile, "a recorder")
    schemas, channels, numbers = {}, [], count()
    for name, topic in topics:
        schema = topic.type_name, topic.schema_encoding, topic.definition
        if topic.type_name and schema not in schemas:
            schemas[schema] = writer.register_schema(*schema)
        metadata = dict(topic.metadata)
        channels.append(
            writer.register_channel(name, topic.encoding, schemas.get(schema, 0), metadata)
        )
    for event in events:
        if callable(event):
            event(writer)
        else:
            place, log_ns, data, *published = event
            published_ns = published[0] if published else log_ns
            writer.add_message(channels[place], log_ns, data, published_ns, next(numbers))
    writer.finish()


def build(topics, events, **options):
    """Return a file, as :func:`write` writes it."""
    buffer = io.BytesIO()
    write(buffer, topics, events, **options)
    return buffer.getvalue()


def write_topics(path, topics, *, spacing_ns=1000, profile="", **options):
    """Write topics by their names, message after message; return the path.

    Pairs instead of a dictionary may have a name twice, of a topic with two definitions.
    """
    pairs = list(topics.items()) if isinstance(topics, dict) else topics
    events = []
    for place, (_, topic) in enumerate(pairs):
        for position, message in enumerate(topic.messages):
            timed = isinstance(message, tuple)
            at, content = message if timed else (position * spacing_ns, message)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            events.append((place, at, data))
    path.write_bytes(build(pairs, events, profile=profile, **options))
    return path


HEADERS = Topic("sensor_msgs/msg/Imu", (), b"Header header", "ros2msg", "cdr")
"""A topic whose messages are not decoded."""


def written(*, messages=60, uneven=True, first_ns=1000, **options):
    """Return a log of three topics, the first with two publishers, the third without messages."""
    second, bare = HEADERS._replace(metadata=[("publisher", "second")]), Topic("")
    topics = [("/imu", HEADERS), ("/imu", second), ("/bare", bare), ("/silent", HEADERS)]

    def events():
        for number in range(messages):
            place = (0, 0, 1, 2)[number % 4] if uneven else 0
            size = 8 * (1 + number % 3) if uneven else 24
            stamp = first_ns + 10 * number
            yield place, stamp, number.to_bytes(size, "little"), stamp - 1
            if number == messages // 2:
                yield lambda writer: writer.add_attachment(1, 1, "notes", "text/plain", b"m" * 99)

    return build(topics, events(), profile="ros2", **{"chunk_size": 400, **options})


MESSAGES = 400


def numbered_data(number):
    """Return the content of a message that is its own number."""
    return number.to_bytes(8, "little") + zlib.crc32(b"%d" % number).to_bytes(4, "big") * 8


def numbered(**options):
    """Return a log of a topic in chunks of some twenty messages, which are their own numbers."""
    events = ((0, number, numbered_data(number)) for number in range(MESSAGES))
    return build([("/imu", HEADERS)], events, profile="ros2", **{"chunk_size": 1500, **options})


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


def read_numbers(tmp_path, content):
    """Return the numbers in the messages of a file, and what is told as lost."""
    log = McapLog(saved(tmp_path, content))
    return [int.from_bytes(data[:8], "little") for *_, data in read(log)], log.losses


def truth(content):
    """Return what :func:`read` does, from the library's reader."""
    topics, messages = {}, []
    for record in StreamReader(io.BytesIO(content)).records:
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            messages.append(
                (topics[record.channel_id], record.log_time, record.publish_time, record.data)
            )
    return messages


def records(content):
    """Return opcode, begin and end of each record of the file, chunks not opened."""
    position, found = len(MAGIC), []
    while position + 9 <= len(content) - len(MAGIC) * content.endswith(MAGIC):
        opcode, length = struct.unpack_from("<BQ", content, position)
        found.append((opcode, position, position + 9 + length))
        position += 9 + length
    return found


def unclosed(content):
    """Return a file as a recorder leaves it that dies: without data end, summary and footer."""
    return content[: next(begin for opcode, begin, _ in records(content) if opcode == 15)]
