"""Odd but readable MCAP files: several in one, ids defined anew, records after the data end."""

import struct

import pytest
from click.testing import CliRunner
from make.into_logs import write_mcap
from make.mcap import every_record, read, saved, truth, written
from mcap.writer import CompressionType, Writer

from quatprop.cli.commands import cli
from quatprop.containers.mcap.log import McapLog

MAGIC = b"\x89MCAP0\r\n"
END = struct.pack("<BQ", 15, 4) + bytes(4) + struct.pack("<BQ", 2, 20) + bytes(20) + MAGIC
COMPRESSIONS = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]


def one_topic(path, topic, first_ns, **options):
    """Write a log of one topic, whose channel has id 1; return its bytes."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=300, **options)
        writer.start("", "")
        channel = writer.register_channel(topic, "json", 0)
        for number in range(40):
            stamp = first_ns + number
            writer.add_message(channel, stamp, b'{"n": %d}' % number, stamp, number)
        writer.finish()
    return path.read_bytes()


def data_records(content):
    """Return the records between the header and the data end."""
    parts = []
    for opcode, begin, end in every_record(content):
        if opcode == 15:
            break
        if opcode != 1:
            parts.append(content[begin:end])
    return b"".join(parts)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize(
    "options", [{}, {"use_chunking": False}, {"use_statistics": False, "enable_crcs": False}]
)
def test_logs_one_behind_another_are_all_read(tmp_path, compression, options):
    """What `cat` makes of logs has the messages of each, under its own topics."""
    parts = [
        written(compression=compression, **options),
        one_topic(tmp_path / "b", "/other", 5000, compression=compression, **options),
        written(first_ns=9000, compression=compression, **options),
    ]
    log = McapLog(saved(tmp_path, b"".join(parts)))
    expected = [message for part in parts for message in truth(part)]
    assert sorted(read(log)) == sorted(expected)
    assert log.losses == []
    assert [channel.topic for channel in log.channels()] == ["/bare", "/imu", "/other", "/silent"]


def test_nothing_is_added_to_logs_one_behind_another(tmp_path):
    """Ids that mean several channels cannot be copied as they are."""
    log = write_mcap(tmp_path / "log.mcap")
    log.write_bytes(2 * log.read_bytes())
    result = CliRunner().invoke(cli, ["propagate", str(log), "--into", str(tmp_path / "out.mcap")])
    assert result.exit_code == 2
    assert "it defines channel ids more than once" in result.output
    assert list(tmp_path.iterdir()) == [log]


def test_the_last_of_several_logs_may_be_cut(tmp_path):
    """A log that was appended to another and not closed loses its own end only."""
    first, second = written(), written(first_ns=9000)
    cut = second[: len(second) // 2]
    log = McapLog(saved(tmp_path, first + cut))
    messages = read(log)
    assert set(truth(first)) <= set(messages) < set(truth(first) + truth(second))
    assert log.losses


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_an_id_that_is_defined_anew_is_another_topic(tmp_path, chunked, compression):
    """Each message is of the topic that its id had when it was written."""
    options = {"use_chunking": chunked, "compression": compression}
    first = one_topic(tmp_path / "a", "/one", 1000, **options)
    second = one_topic(tmp_path / "b", "/two", 2000, **options)
    header = first[: 8 + 9 + struct.unpack_from("<Q", first, 9)[0]]
    content = header + data_records(first) + data_records(second) + END
    log = McapLog(saved(tmp_path, content))
    found = read(log)
    assert sorted(found) == sorted(truth(content) if not chunked else truth(first) + truth(second))
    assert [sum(topic == name for topic, *_ in found) for name in ("/one", "/two")] == [40, 40]
    assert log.losses == []


def test_chunks_behind_the_data_end_are_read(tmp_path):
    """Where the data end stands does not decide what is data."""
    first = one_topic(tmp_path / "a", "/one", 1000)
    second = one_topic(tmp_path / "b", "/one", 2000)
    header = first[: 8 + 9 + struct.unpack_from("<Q", first, 9)[0]]
    data_end = struct.pack("<BQ", 15, 4) + bytes(4)
    content = header + data_records(first) + data_end + data_records(second) + END
    log = McapLog(saved(tmp_path, content))
    assert sorted(read(log)) == sorted(truth(first) + truth(second))
    assert log.losses == []


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_chunks_that_state_no_size_are_read(tmp_path, compression):
    """An uncompressed size of 0 states none, where there is data."""
    content = bytearray(one_topic(tmp_path / "a", "/one", 1000, compression=compression))
    for opcode, begin, _ in every_record(bytes(content)):
        if opcode == 6:
            content[begin + 9 + 16 : begin + 9 + 24] = bytes(8)
    log = McapLog(saved(tmp_path, bytes(content)))
    assert len(read(log)) == 40
    assert log.losses == []


def test_log_times_after_the_year_2262_are_remarked_on(tmp_path):
    """They do not fit int64 ns: the messages are kept for their header stamps, and that is said."""
    year_2300 = 10_413_792_000 * 10**9
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("", "")
        channel = writer.register_channel("/one", "json", 0)
        for stamp in (10**9, year_2300, 2 * 10**9):
            writer.add_message(channel, stamp, b"{}", stamp)
        writer.finish()
    log = McapLog(tmp_path / "log.mcap")
    assert [log_ns for _, log_ns, _, _ in read(log)] == [10**9, 2**63 - 1, 2 * 10**9]
    assert log.remarks == [
        "log times after the year 2262 do not fit int64 ns and are read as the last that does"
    ]
