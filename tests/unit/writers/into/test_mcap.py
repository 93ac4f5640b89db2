"""Copies of MCAP files: what is particular to the container, and damage."""

import gzip
import struct

import numpy as np
import pytest
from make.commands import run
from make.into_logs import BOOT, moments, write_mcap
from make.mcap import MAGIC, records, unclosed
from make.mcap_doctor import examine
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Schema
from mcap.writer import IndexType

from quatprop.readers.open_log import open_log
from quatprop.writers.into import mcap_copy
from quatprop.writers.mcap import McapContents


def messages(path):
    """Return channel, sequence, times and data of each message but those that were added."""
    with path.open("rb") as stream:
        return [
            (c.topic, c.metadata, m.sequence, m.log_time, m.publish_time, m.data)
            for _, c, m in NonSeekingReader(stream).iter_messages(log_time_order=False)
            if c.topic != "/attitude"
        ]


def summary_of(path):
    """Return what the library's reader finds at the end of a file."""
    with path.open("rb") as stream:
        return make_reader(stream).get_summary()


def added(log, *options, code=0):
    """Add attitudes to a log; return the copy, which is as its specification says."""
    out = log.with_name("out.mcap")
    run("propagate", log, "--into", out, "-q", *options, code=code)
    examine(out)
    return out


def count(path, topic="/attitude"):
    """Return how many messages of a topic a file has."""
    summary = summary_of(path)
    (id_,) = (id_ for id_, channel in summary.channels.items() if channel.topic == topic)
    return summary.statistics.channel_message_counts[id_]


@pytest.fixture
def log(tmp_path):
    """Return a log with rates, a camera, an attachment and metadata."""
    return write_mcap(tmp_path / "log.mcap")


def test_what_is_added_has_ids_of_its_own_and_shares_its_definition(log, monkeypatch):
    """A second topic uses the definition that is there; the first one's provenance stays."""
    # Of a long attachment only the names are read; everything is copied piece by piece.
    monkeypatch.setattr(mcap_copy, "_NAMES", 58)
    monkeypatch.setattr(mcap_copy, "_PIECE", 50)
    first = added(log)
    ids = {"/imu": 1, "/camera": 2, "/attitude": 3}
    channels = summary_of(first).channels
    assert {c.topic: c.id for c in channels.values()} == ids
    assert channels[3].schema_id not in {0, channels[1].schema_id}
    first.replace(log)
    second = added(log, "-t", "/imu", "--out-topic", "/again")
    channels = summary_of(second).channels
    assert {c.topic: c.id for c in channels.values()} == {**ids, "/again": 4}
    assert channels[4].schema_id == channels[3].schema_id
    with second.open("rb") as stream:
        told = [r.metadata for r in make_reader(stream).iter_metadata() if r.name == "quatprop"]
    assert [one["topic"] for one in told] == ["/attitude", "/again"]


def test_topics_without_messages_are_kept(log):
    """Some recorders tell of them in the summary only; the copy has them in both sections."""
    data, summary = log.read_bytes(), summary_of(log)
    silent = Channel(9, "/silent", "json", {"a": "b"}, 5)
    summary.schemas[5] = Schema(id=5, data=b"{}", encoding="jsonschema", name="Silent")
    summary.channels[9] = silent
    end = data.index(b"\x0f\x04" + bytes(7)) + 13
    contents = McapContents(summary.schemas, summary.channels, summary.chunk_indexes)
    contents.counts.update(summary.statistics.channel_message_counts)
    log.write_bytes(data[:end] + contents.summary(end) + MAGIC)
    assert silent in examine(added(log)).channels.values()


def test_a_file_of_ros1_gets_messages_of_ros1(tmp_path):
    """What stands in a profile keeps to it."""
    out = added(write_mcap(tmp_path / "log.mcap", profile="ros1"))
    with out.open("rb") as stream:
        (schema, channel, message), *_ = make_reader(stream).iter_messages("/attitude")
    assert (schema.encoding, channel.message_encoding) == ("ros1msg", "ros1")
    assert schema.name == "geometry_msgs/QuaternionStamped"
    assert struct.unpack_from("<3I", message.data) == (0, BOOT // 10**9, 0)


@pytest.mark.parametrize("name", ["FrameTransform", "PoseInFrame", "TFMessage"])
def test_any_message_can_be_added(log, name):
    """Foxglove's own beside those of ROS."""
    topic = "/attitude" if name == "PoseInFrame" else "/tf"
    out = added(log, "--message", name)
    assert examine(out).counts == {1: 300, 2: 30, 3: 300}
    assert run("convert", out, "-", "-t", topic, "-q").stdout.splitlines()[1] == f"{BOOT},1,0,0,0"


def test_the_statistics_count_messages_outside_chunks(tmp_path):
    """They begin with the first message of the log, though attitudes begin later."""
    log = write_mcap(tmp_path / "log.mcap", use_chunking=False)
    told = summary_of(added(log, "--start", "+1s", "--end", "-1s")).statistics
    every = [logged for _, logged in moments(300)]
    assert (told.message_start_time, told.message_end_time) == (every[0], every[-1])


def test_a_packed_log_is_copied_unpacked(log):
    """What was packed as a whole is read through, and so is its copy."""
    packed = log.with_name("packed.mcap.gz")
    packed.write_bytes(gzip.compress(log.read_bytes()))
    assert messages(added(packed)) == messages(log)


# Damage


def test_cut_off_logs_give_what_is_left_of_them(tmp_path):
    """At any cut the copy is whole and has what the pieces before the cut hold: exit 3."""
    log = write_mcap(tmp_path / "log.mcap", count=120)
    whole, data = messages(log), log.read_bytes()
    last = summary_of(log).metadata_indexes[-1]
    for cut in np.linspace(len(data) // 4, last.offset + last.length, 12).astype(int):
        log.write_bytes(data[:cut])
        out = added(log, code=3)
        kept = messages(out)
        assert kept == whole[: len(kept)]
        assert count(out) == sum(topic == "/imu" for topic, *_ in kept)
        # What was not torn is kept: a chunk of this log holds 12 messages at most.
        assert len(kept) >= len(whole) * cut // len(data) - 40


def test_bytes_that_are_no_records_are_passed_over(log):
    """Garbage between chunks is lost and told; the chunks after it are kept."""
    third, data = summary_of(log).chunk_indexes[3], bytearray(log.read_bytes())
    at = third.chunk_start_offset
    data[at : at + 60] = bytes(60)
    log.write_bytes(data)
    out = added(log, code=3)
    kept = messages(out)
    assert 300 < len(kept) + third.uncompressed_size // 320 < 345
    assert count(out) == sum(topic == "/imu" for topic, *_ in kept)


def test_an_index_of_other_channels_is_made_anew(log):
    """What a chunk's message index says and the summary does not is not copied."""
    before, data = messages(log), bytearray(log.read_bytes())
    (at, *_) = summary_of(log).chunk_indexes[2].message_index_offsets.values()
    data[at + 9 : at + 11] = (77).to_bytes(2, "little")
    log.write_bytes(data)
    assert messages(added(log, code=None)) == before


@pytest.mark.parametrize("options", [{}, {"index_types": IndexType.NONE}])
def test_a_damaged_chunk_is_copied_as_it_is(tmp_path, options):
    """Its messages are lost in the log and in the copy; a damaged header is left out."""
    log = write_mcap(tmp_path / "log.mcap", **options)
    data = bytearray(log.read_bytes())
    at = [begin for opcode, begin, _ in records(bytes(data)) if opcode == Opcode.CHUNK][5]
    data[at + 100] ^= 0xFF
    data[17:21] = b"\xff" * 4  # the length of the profile
    log.write_bytes(data)
    out = log.with_name("out.mcap")
    run("propagate", log, "--into", out, "-q", code=3)
    assert bytes(data[at : at + 200]) in out.read_bytes()
    with open_log(log) as before, open_log(out) as after:
        counts = [
            {c.topic: sum(map(len, opened.blocks(c))) for c in opened.channels()}
            for opened in (before, after)
        ]
    assert counts[1] == counts[0] | {"/attitude": counts[0]["/imu"]}
    assert 280 < counts[0]["/imu"] < 300


def test_a_chunk_without_messages_is_kept(log):
    """As a recorder leaves that was told to write what it has."""
    before, empty = messages(log), struct.pack("<BQ3QIIQ", Opcode.CHUNK, 40, 0, 0, 0, 0, 0, 0)
    log.write_bytes(unclosed(log.read_bytes()) + empty)
    out = added(log, code=3)
    assert messages(out) == before
    assert empty in out.read_bytes()


def test_a_definition_that_is_none_is_not_copied(tmp_path):
    """The good one of the summary is, so that the copy can be read."""
    log = write_mcap(tmp_path / "log.mcap", use_chunking=False)
    data = bytearray(log.read_bytes())
    at = data.index(b"sensor_msgs/msg/Imu") - 4
    data[at : at + 4] = b"\xff\xff\xff\x7f"
    log.write_bytes(data)
    assert count(added(log, code=None)) == 300


def test_a_log_whose_header_is_damaged_gets_an_empty_one(log):
    """The kind of its first record is unknown; that record is kept."""
    before, data = messages(log), bytearray(log.read_bytes())
    data[8] = 0xFF
    log.write_bytes(data)
    out = added(log, code=None)
    assert messages(out) == before
    with out.open("rb") as stream:
        assert make_reader(stream).get_header().profile == ""


def with_early_data_end(data):
    """Return an MCAP file without an index whose data end record stands amid its chunks."""
    head = struct.Struct("<BQ")
    at, records, opcode = 8, [], 0
    while opcode != Opcode.DATA_END:
        opcode, length = head.unpack_from(data, at)
        records.append((opcode, data[at : at + head.size + length]))
        at += head.size + length
    (*_, third, _, _) = (k for k, (opcode, _) in enumerate(records) if opcode == Opcode.CHUNK)
    *body, end = (record for _, record in records)
    footer = head.pack(Opcode.FOOTER, 20) + bytes(20)
    return b"".join([data[:8], *body[:third], end, *body[third:], footer, data[:8]])


def test_chunks_after_the_data_end_are_copied(log):
    """A reader that goes on finds them, and so does one of the copy."""
    before = messages(log)
    log.write_bytes(with_early_data_end(log.read_bytes()))
    assert messages(log) == before
    out = added(log)
    assert messages(out) == before
    assert count(out) == 300
