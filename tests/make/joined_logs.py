"""One MCAP file with the messages of several, in order of log time, by the library's own writer."""

from contextlib import ExitStack
from heapq import merge
from itertools import repeat

from mcap.reader import make_reader
from mcap.writer import Writer


def join_mcap(target, *sources):
    """Write the messages of MCAP files into one; return its path."""
    with ExitStack() as stack:
        readers = [make_reader(stack.enter_context(source.open("rb"))) for source in sources]
        writer = Writer(stack.enter_context(target.open("wb")))
        writer.start(readers[0].get_header().profile)
        channels = {}
        streams = (zip(repeat(k), reader.iter_messages()) for k, reader in enumerate(readers))
        for k, (schema, channel, message) in merge(*streams, key=lambda row: row[1][2].log_time):
            if (k, channel.id) not in channels:
                id_ = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[k, channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, id_, channel.metadata
                )
            writer.add_message(
                channels[k, channel.id],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()
    return target
