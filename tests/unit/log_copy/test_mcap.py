"""Copies of MCAP files with attitudes added: everything else is kept."""

import json
import struct

import numpy as np
import pytest
from make.into_logs import BOOT, RATE, START, moments, run, write_bag, write_mcap
from make.mcap_doctor import MAGIC, examine
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType, IndexType
from rosbags.highlevel import AnyReader

from quatprop.writers.mcap.contents import McapContents

FORMS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False},
    "no indexes": {"index_types": IndexType.NONE},
    "no summary": {
        "use_statistics": False, "use_summary_offsets": False, "repeat_channels": False,
        "repeat_schemas": False, "index_types": IndexType.NONE,
    },
    "no checksums": {"enable_crcs": False},
    "one chunk": {"chunk_size": 1 << 20},
    "no profile": {"profile": ""},
}  # fmt: skip


def added(log, *options):
    """Add attitudes to a log with the command, and return the copy."""
    out = log.with_name("out.mcap")
    result = run("propagate", log, "--into", out, "-q", *options)
    assert (result.exit_code, result.output) == (0, "")
    return out


def messages(path, without=()):
    """Return every message but those of some topics, in order of the file."""
    with path.open("rb") as stream:
        reader = NonSeekingReader(stream, validate_crcs=True)
        return [
            (schema and (schema.name, schema.encoding, schema.data), channel.topic,
             channel.message_encoding, channel.metadata, message.sequence, message.log_time,
             message.publish_time, message.data)
            for schema, channel, message in reader.iter_messages(log_time_order=False)
            if channel.topic not in without
        ]  # fmt: skip


def beside(path, what):
    """Return what the library's reader gives of a file from end to end."""
    with path.open("rb") as stream:
        found = getattr(NonSeekingReader(stream), what)()
        return list(found) if what.startswith("iter") else found


def attitudes(path, topic="/attitude"):
    """Return log times and stamps with wxyz of the messages that were added."""
    with path.open("rb") as stream:
        found = [
            (message.log_time, *struct.unpack_from("<iI", message.data, 4),
             struct.unpack_from("<4d", message.data, len(message.data) - 32))
            for _, _, message in make_reader(stream, validate_crcs=True).iter_messages(topic)
        ]  # fmt: skip
    return [
        (logged, sec * 10**9 + nanosec, (w, x, y, z))
        for logged, sec, nanosec, (x, y, z, w) in found
    ]


@pytest.mark.parametrize("form", FORMS)
def test_everything_else_is_kept(tmp_path, form):
    """Messages, definitions, attachments and metadata are those of the log, whatever its form."""
    log = write_mcap(tmp_path / "log.mcap", **FORMS[form])
    out = added(log)
    examine(out)
    assert messages(out, without=["/attitude"]) == messages(log)
    assert beside(out, "get_header") == beside(log, "get_header")
    *kept, told = beside(out, "iter_metadata")
    assert kept == beside(log, "iter_metadata")
    assert told.name == "quatprop"
    attachments = beside(out, "iter_attachments")
    assert attachments == beside(log, "iter_attachments")
    assert [one.data for one in attachments] == [b"k: [1, 2]"]


def test_attitudes_have_the_stamps_and_the_log_times_of_their_samples(tmp_path):
    """The body turns about z; an attitude is logged when the message was that it comes from."""
    out = added(write_mcap(tmp_path / "log.mcap"))
    found = attitudes(out)
    assert [(stamp, logged) for logged, stamp, _ in found] == list(moments(300))
    half = RATE * 0.01 * np.arange(300) / 2
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    np.testing.assert_allclose([wxyz for *_, wxyz in found], expected, atol=1e-14)


@pytest.mark.parametrize("form", ["zstd", "no indexes", "no chunks"])
def test_chunks_stand_in_order_of_time(tmp_path, form):
    """Attitudes stand among the messages of their time, not all at the end."""
    log = write_mcap(tmp_path / "log.mcap", count=12_000, **FORMS[form])
    out = added(log)
    starts = examine(out).starts
    assert starts == sorted(starts)
    assert len(attitudes(out)) == 12_000


def test_ids_do_not_clash(tmp_path):
    """The new schema and channel have ids of their own, and other readers see both topics."""
    out = added(write_mcap(tmp_path / "log.mcap"))
    with out.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert {c.topic: c.id for c in summary.channels.values()} == {
        "/imu": 1, "/camera": 2, "/attitude": 3,
    }  # fmt: skip
    assert summary.channels[3].schema_id not in {0, summary.channels[1].schema_id}


def test_more_can_be_added_to_what_was_added_to(tmp_path):
    """A second topic uses the definition that is there; the first one's provenance stays."""
    first = added(write_mcap(tmp_path / "log.mcap"))
    second = tmp_path / "second.mcap"
    options = ("-t", "/imu", "--method", "coning", "--out-topic", "/coning", "-q")
    assert run("propagate", first, "--into", second, *options).exit_code == 0
    assert len(examine(second).schemas) == len(examine(first).schemas) == 2
    with second.open("rb") as stream:
        told = [r.metadata for r in make_reader(stream).iter_metadata() if r.name == "quatprop"]
    assert [one["topic"] for one in told] == ["/attitude", "/coning"]
    methods = [json.loads(one["provenance"])["convention"]["method"] for one in told]
    assert methods == ["start", "coning"]


def test_topics_without_messages_are_kept(tmp_path):
    """Some recorders tell of them in the summary only; the copy has them in both sections."""
    log = write_mcap(tmp_path / "log.mcap")
    out = tmp_path / "out.mcap"
    with log.open("rb") as stream, out.open("wb") as copy:
        summary = make_reader(stream).get_summary()
        silent = Channel(9, "/silent", "json", {"a": "b"}, 5)
        summary.schemas[5] = Schema(id=5, data=b"{}", encoding="jsonschema", name="Silent")
        summary.channels[9] = silent
        stream.seek(0)
        end = stream.read().index(b"\x0f\x04" + bytes(7)) + 13
        stream.seek(0)
        copy.write(stream.read(end))
        contents = McapContents(summary.schemas, summary.channels, summary.chunk_indexes)
        contents.counts.update(summary.statistics.channel_message_counts)
        copy.write(contents.summary(end) + MAGIC)
    out.replace(log)
    assert silent in examine(added(log)).channels.values()


def test_a_topic_that_is_there_is_refused(tmp_path):
    """It would be unclear which messages are whose."""
    log = write_mcap(tmp_path / "log.mcap")
    result = run("propagate", log, "--into", tmp_path / "out.mcap", "--out-topic", "/camera")
    assert result.exit_code == 2
    assert result.stderr.endswith(
        "log.mcap: topic '/camera' exists already; choose another with --out-topic NAME\n"
    )
    assert list(tmp_path.iterdir()) == [log]


def test_a_file_of_ros1_gets_messages_of_ros1(tmp_path):
    """What stands in a profile keeps to it."""
    out = added(write_mcap(tmp_path / "log.mcap", profile="ros1"))
    examine(out)
    with out.open("rb") as stream:
        (schema, channel, message), *_ = make_reader(stream).iter_messages("/attitude")
    assert (schema.encoding, channel.message_encoding) == ("ros1msg", "ros1")
    assert schema.name == "geometry_msgs/QuaternionStamped"
    assert struct.unpack_from("<3I", message.data) == (0, BOOT // 10**9, 0)


@pytest.mark.parametrize("name", ["FrameTransform", "PoseInFrame", "TFMessage"])
def test_any_message_can_be_added(tmp_path, name):
    """Foxglove's own beside those of ROS."""
    topic = "/attitude" if name == "PoseInFrame" else "/tf"
    out = added(write_mcap(tmp_path / "log.mcap"), "--message", name)
    assert examine(out).counts == {1: 300, 2: 30, 3: 300}
    result = run("convert", out, "-", "-t", topic, "-q")
    assert result.stdout.splitlines()[1] == f"{BOOT},1,0,0,0"


def test_cut_off_logs_give_what_is_left_of_them(tmp_path):
    """At any cut the copy is whole and has what the pieces before the cut hold: exit 3."""
    log = write_mcap(tmp_path / "log.mcap", count=120)
    whole, data = messages(log), log.read_bytes()
    out = tmp_path / "out.mcap"
    with log.open("rb") as stream:
        (end, *_) = [
            i.offset + i.length for i in make_reader(stream).get_summary().metadata_indexes
        ][-1:]
    for cut in np.linspace(len(data) // 4, end, 25).astype(int):
        log.write_bytes(data[:cut])
        result = run("propagate", log, "--into", out, "-q")
        assert result.exit_code == 3
        examine(out)
        kept = messages(out, without=["/attitude"])
        assert kept == whole[: len(kept)]
        rates = sum(topic == "/imu" for _, topic, *_ in kept)
        assert len(attitudes(out)) == rates
        # What was not torn is kept: a chunk of this log holds 12 messages at most.
        assert len(kept) >= len(whole) * cut // len(data) - 40
        out.unlink()


def test_bytes_that_are_no_records_are_passed_over(tmp_path):
    """Garbage between chunks is lost and told; the chunks after it are kept."""
    log = write_mcap(tmp_path / "log.mcap")
    with log.open("rb") as stream:
        third = make_reader(stream).get_summary().chunk_indexes[3]
    at = third.chunk_start_offset
    data = bytearray(log.read_bytes())
    data[at : at + 60] = bytes(60)
    log.write_bytes(data)
    out = tmp_path / "out.mcap"
    assert run("propagate", log, "--into", out, "-q").exit_code == 3
    kept = messages(out, without=["/attitude"])
    assert 300 < len(kept) + third.uncompressed_size // 320 < 345
    examine(out)
    assert len(attitudes(out)) == sum(topic == "/imu" for _, topic, *_ in kept)


def test_the_statistics_count_messages_outside_chunks(tmp_path):
    """They begin with the first message of the log, though attitudes begin later."""
    log = write_mcap(tmp_path / "log.mcap", use_chunking=False)
    with added(log, "--start", "+1s", "--end", "-1s").open("rb") as stream:
        told = make_reader(stream).get_summary().statistics
    every = [logged for _, logged in moments(300)]
    assert (told.message_start_time, told.message_end_time) == (every[0], every[-1])


def test_an_index_of_other_channels_is_made_anew(tmp_path):
    """What a chunk's message index says and the summary does not is not copied."""
    log = write_mcap(tmp_path / "log.mcap")
    with log.open("rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[2]
    (at, *_) = chunk.message_index_offsets.values()
    data = bytearray(log.read_bytes())
    data[at + 9 : at + 11] = (77).to_bytes(2, "little")
    log.write_bytes(data)
    out = tmp_path / "out.mcap"
    assert run("propagate", log, "--into", out, "-q").exit_code in {0, 3}
    examine(out)
    assert messages(out, without=["/attitude"]) == messages(log)


def test_a_definition_that_is_none_is_not_copied(tmp_path):
    """The good one of the summary is, so that the copy can be read."""
    log = write_mcap(tmp_path / "log.mcap", use_chunking=False)
    data = bytearray(log.read_bytes())
    at = data.index(b"sensor_msgs/msg/Imu") - 4
    data[at : at + 4] = b"\xff\xff\xff\x7f"
    log.write_bytes(data)
    out = tmp_path / "out.mcap"
    assert run("propagate", log, "--into", out, "-q").exit_code in {0, 3}
    examine(out)
    assert len(attitudes(out)) == 300


def test_fewer_rows_are_logged_between_messages(tmp_path):
    """With --rate, an attitude is logged as long after its message as it is stamped after it."""
    out = added(write_mcap(tmp_path / "log.mcap"), "--rate", "250")
    found = attitudes(out)
    stamps = np.array([stamp for _, stamp, _ in found])
    assert set(np.diff(stamps)) == {4_000_000}
    logged = np.array([logged for logged, *_ in found])
    before = (stamps - BOOT) // 10_000_000
    expected = START + (stamps - BOOT) + before % 7 * 1000
    np.testing.assert_array_equal(logged, expected)


def test_attitudes_of_the_log_are_converted_into_it(tmp_path):
    """The other command adds what it reads, here the orientation of the same messages."""
    log = write_mcap(tmp_path / "log.mcap")
    out = tmp_path / "out.mcap"
    result = run("convert", log, "--into", out, "--message", "PoseStamped", "-q")
    assert (result.exit_code, result.output) == (0, "")
    examine(out)
    found = attitudes(out)
    assert [(stamp, logged) for logged, stamp, _ in found] == list(moments(300))
    assert {wxyz for *_, wxyz in found} == {(0.8, 0.0, 0.0, 0.6)}
    assert messages(out, without=["/attitude"]) == messages(log)


def test_an_empty_suffix_or_any_other_is_mcap_all_the_same(tmp_path):
    """The copy is of the log's kind; a suffix that says otherwise is refused."""
    log = write_mcap(tmp_path / "log.mcap")
    assert run("propagate", log, "--into", tmp_path / "out", "-q").exit_code == 0
    examine(tmp_path / "out")
    result = run("propagate", log, "--into", tmp_path / "out.bag")
    assert result.exit_code == 2
    assert "is mcap, whatever its name; name it .mcap" in result.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--to", "csv"], "--into copies the log in its own format; leave --to out"),
        (["--layout", "wxyz"], "mcap is scalar-last by its own definition, not scalar-first"),
        (["--header-comment"], "mcap has no comments; leave --header-comment out"),
        (["-o", "a.csv"], "say where the attitudes go: -o OUT, or --into COPY, not both"),
    ],
)
def test_options_that_do_not_go_with_a_copy_are_refused(tmp_path, options, words):
    """Each with its reason, and nothing is left behind."""
    log = write_mcap(tmp_path / "log.mcap")
    result = run("propagate", log, "--into", tmp_path / "out.mcap", *options)
    assert result.exit_code == 2
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == [log]


def test_a_copy_does_not_go_to_stdout(tmp_path):
    """It is no text."""
    result = run("propagate", write_mcap(tmp_path / "log.mcap"), "--into", "-")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "standard output takes text only; name a file for the copy" in result.stderr


def test_somewhere_must_be_said(tmp_path):
    """Neither -o nor --into is an error that names both."""
    result = run("propagate", write_mcap(tmp_path / "log.mcap"))
    assert result.exit_code == 2
    assert "say where the attitudes go: -o OUT, or --into COPY\n" in result.stderr


def test_the_log_itself_is_not_replaced(tmp_path):
    """Nor by another of its names."""
    log = write_mcap(tmp_path / "log.mcap")
    before = log.read_bytes()
    (tmp_path / "link.mcap").symlink_to(log)
    for name in ("log.mcap", "link.mcap"):
        result = run("propagate", log, "--into", tmp_path / name)
        assert result.exit_code == 2
        assert "this is an input of the run; choose another output" in result.stderr
    assert log.read_bytes() == before


def test_a_table_has_nothing_to_add_to(tmp_path):
    """The error says where attitudes can go instead."""
    table = tmp_path / "log.csv"
    table.write_text("t_ns,wx,wy,wz\n0,0,0,1\n1000000,0,0,1\n")
    result = run("propagate", table, "--into", tmp_path / "out.mcap")
    assert result.exit_code == 2
    assert "this one is 'csv'; write them to a file of their own with --output" in result.stderr


def test_a_packed_log_is_copied_unpacked(tmp_path):
    """What was packed as a whole is read through, and so is its copy."""
    import gzip

    log = write_mcap(tmp_path / "log.mcap")
    packed = tmp_path / "packed.mcap.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    out = tmp_path / "out.mcap"
    assert run("propagate", packed, "--into", out, "-q").exit_code == 0
    assert out.read_bytes()[:8] == MAGIC
    assert messages(out, without=["/attitude"]) == messages(log)


def test_rosbags_reads_the_copy(tmp_path):
    """The library of the field finds both topics."""
    out = added(write_mcap(tmp_path / "log.mcap"))
    with AnyReader([out]) as reader:
        topics = {c.topic: c.msgcount for c in reader.connections if c.topic != "/camera"}
    assert topics == {"/imu": 300, "/attitude": 300}


@pytest.mark.parametrize("kind", ["mcap", "bag"])
@pytest.mark.parametrize("more", [(), ("--rate", "50"), ("--every", "3")])
def test_sorted_attitudes_have_the_log_times_of_their_messages(kind, more, tmp_path):
    """They had those of other messages, where stamps did not rise with log times."""
    random = np.random.default_rng(4)
    stamps = BOOT + np.arange(100) * 10_000_000
    stamps += random.integers(-30_000_000, 30_000_000, 100)
    stamps[40] = stamps[41]  # two messages of one stamp
    logged = START + np.arange(100) * 10_000_000
    log, out = tmp_path / f"log.{kind}", tmp_path / f"out.{kind}"
    times = zip(stamps.tolist(), logged.tolist(), strict=True)
    (write_mcap if kind == "mcap" else write_bag)(log, times=list(times))
    result = run("propagate", log, "--into", out, "--on-backwards", "sort", "-q", *more)
    assert result.exit_code == 0, result.output
    with AnyReader([out]) as reader:
        found = sorted(
            (stamp.sec * 10**9 + stamp.nanosec, at)
            for connection, at, data in reader.messages()
            if connection.topic == "/attitude"
            for stamp in [reader.deserialize(data, connection.msgtype).header.stamp]
        )
    pairs = sorted(zip(stamps.tolist(), logged.tolist(), strict=True))
    if not more:
        assert found == pairs
    elif more[0] == "--every":
        assert found == pairs[::3]
    else:
        known = dict(pairs)
        assert all(at in {known.get(stamp), at} for stamp, at in found)
        assert len(found) > 40


def test_messages_of_one_stamp_keep_their_own_log_times(tmp_path):
    """The second had the log time of the first."""
    times = [(BOOT + k // 2 * 10_000_000, START + k * 10_000_000) for k in range(20)]
    out = added(write_mcap(tmp_path / "log.mcap", times=times))
    assert [(stamp, logged) for logged, stamp, _ in attitudes(out)] == times


def test_converted_messages_keep_their_own_log_times(tmp_path):
    """Those whose stamps step back or are repeated had the log times of others."""
    stamps = [0, 1, 2, 2, 9, 3, 4, 4, 5]
    times = [(BOOT + t * 10_000_000, START + k * 10_000_000) for k, t in enumerate(stamps)]
    log, out = write_mcap(tmp_path / "log.mcap", times=times), tmp_path / "out.mcap"
    assert run("convert", log, "--into", out, "-q").exit_code == 0
    assert [(stamp, logged) for logged, stamp, _ in attitudes(out)] == times
