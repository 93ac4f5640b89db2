"""MCAP files with one call, by the library's own writer."""

import json
from typing import NamedTuple

from mcap.writer import Writer


class Topic(NamedTuple):
    """A topic: how its messages are encoded and defined, and the messages in order.

    A message is its bytes, or a dictionary for JSON; ``(time, message)`` states its log time, ns.
    """

    type_name: str
    messages: list
    definition: bytes = b"{}"
    schema_encoding: str = "jsonschema"
    encoding: str = "json"


def write_topics(path, topics, *, spacing_ns=1000, profile="", **options):
    """Write topics by their names, message after message; return the path.

    Pairs instead of a dictionary may have a name twice, of a topic with two definitions.
    """
    pairs = topics.items() if isinstance(topics, dict) else topics
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile)
        for name, topic in pairs:
            schema = (
                writer.register_schema(topic.type_name, topic.schema_encoding, topic.definition)
                if topic.type_name
                else 0
            )
            channel = writer.register_channel(name, topic.encoding, schema)
            for position, message in enumerate(topic.messages):
                at, content = (
                    message if isinstance(message, tuple) else (position * spacing_ns, message)
                )
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                writer.add_message(channel, at, data, at, position)
        writer.finish()
    return path
