"""MCAP files with lying indexes, with attachments, and cut ones: the data count."""

import struct
import warnings
import zlib

import numpy as np
import pytest
from fuzz import flips_mcap as mcap

import quatprop
from quatprop.readers.containers.mcap import McapLog

COMPRESSIONS = ("", "lz4", "zstd")
INDEX, CHUNK_INDEX, END = 7, 8, 15


@pytest.fixture(scope="module")
def layouts():
    """Return the intact files."""
    return mcap.layouts()


def read(path, data, **options):
    """Return how many samples are read, all of which must be in the log, and what is lost."""
    path.write_bytes(data)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        series = quatprop.read_rates(path, **options)
    stamps = dict(zip(mcap.RATES[:, 0].tolist(), mcap.T_NS.tolist(), strict=True))
    assert [stamps.get(x) for x in series.rate[:, 0].tolist()] == series.t_ns.tolist()
    assert len(set(series.t_ns.tolist())) == len(series.t_ns)
    lost = [one.message for one in caught if one.category is quatprop.DataLossWarning]
    return len(series.t_ns), [one for one in lost if "without a footer" not in str(one)]


def places(data, kind):
    """Return where the records of a kind begin."""
    return [start for opcode, start, _ in mcap.records(data) if opcode == kind]


@pytest.mark.parametrize("layout", ["full", "no statistics", "no summary", "unclosed"])
@pytest.mark.parametrize("what", ["list", "map"])
def test_no_index_hides_the_samples_of_a_chunk(tmp_path, layouts, layout, what):
    """A chunk was left unread because an index did not list the channel, without a word."""
    data = bytearray(layouts[layout])
    if what == "list":  # what follows keeps its place
        at = [at for at in places(data, INDEX) if data[at + 9] == 1][2]
        (length,) = struct.unpack_from("<Q", data, at + 1)
        data[at : at + 9 + length] = mcap.record(0x90, bytes(length))
    for at in places(data, CHUNK_INDEX)[2:3] if what == "map" else ():
        data[at + 9 + 36 + 10 * (data[at + 9 + 36] != 1)] = 3
    assert read(tmp_path / "log.mcap", data)[0] == mcap.COUNT


@pytest.mark.parametrize("layout", ["full", "no statistics"])
@pytest.mark.parametrize("field", range(5))
def test_a_wrong_number_in_a_chunk_index_costs_nothing(tmp_path, layouts, layout, field):
    """A wrong length in one of them made a file one of no topics with messages."""
    for number in (0, mcap.CHUNKS - 1):
        for value in (0, 100, (1 << 64) - 1):
            data = bytearray(layouts[layout])
            at = places(data, CHUNK_INDEX)[number] + 9
            # Times, place and length of the chunk; then the length of its message indexes.
            struct.pack_into("<Q", data, at + (8 * field if field < 4 else 36 + 20), value)
            assert read(tmp_path / "log.mcap", data)[0] == mcap.COUNT


@pytest.mark.parametrize("has_index", [True, False])
def test_records_of_an_attached_log_are_no_samples(tmp_path, has_index):
    """A damaged length of the attachment, or of its data, leads to any record inside it."""
    intact, inner = (
        bytearray(mcap.mcap(attached=mcap.embedded(), summary=has_index)),
        mcap.embedded(),
    )
    (at,) = places(intact, mcap.ATTACHMENT)
    begin = intact.index(inner)
    stops = [begin + start for _, start, _ in mcap.records(inner)][::7]
    later = [end for _, start, end in mcap.records(intact) if start > at][::5]
    inside = [(at + 1, stop - at - 9) for stop in stops]
    inside += [(begin - 8, stop - begin - 4) for stop in stops]
    for field, value in [*inside, *((at + 1, end - at - 9) for end in later)]:
        data = bytearray(intact)
        struct.pack_into("<Q", data, field, value)
        count, lost = read(tmp_path / "log.mcap", data)
        if has_index or (field, value) in inside:
            assert count == mcap.COUNT
        # Only the index says where it ends: of two lengths, the longer one is taken, and told.
        assert has_index or lost
    if has_index:  # which says where the attachment ends whose head is lost
        intact[at : at + 40] = bytes(40)
        assert read(tmp_path / "log.mcap", intact)[0] == mcap.COUNT


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("attached", ["log", "image", "torn log"])
@pytest.mark.parametrize("length", [341, 7000, 1 << 40])
def test_what_follows_a_damaged_attachment_is_read_without_a_summary(
    tmp_path, closed, attached, length
):
    """All behind it was lost in one note; of an attached log without an end, nobody knows it."""
    content = mcap.embedded()
    if attached == "image":
        content = np.random.default_rng(1).bytes(30_000)
    elif attached == "torn log":
        content = content[: len(content) // 2]
    data = bytearray(mcap.mcap(attached=content, summary=False, closed=closed))
    (at,) = places(data, mcap.ATTACHMENT)
    for field in (at + 1, data.index(content) - 8):
        struct.pack_into("<Q", data, field, length)
    count, lost = read(tmp_path / "log.mcap", data)
    assert count == (mcap.COUNT if attached != "torn log" else mcap.COUNT // 2)
    is_torn = attached == "torn log" and length > len(data)
    reason = "the file ends inside it" if is_torn else "its length is damaged"
    assert any(f"attachment at byte {at}: {reason}" in str(one) for one in lost)


def test_a_file_that_ends_in_an_attached_log_has_no_samples_of_it(tmp_path, layouts):
    """The records of the attachment were read where its end is missing."""
    data = layouts["attachment, unclosed"]
    (at,) = places(data, mcap.ATTACHMENT)
    for cut in range(at + 1, at + 9000, 731):
        count, lost = read(tmp_path / "log.mcap", data[:cut])
        assert count == mcap.COUNT // 2
        assert lost


@pytest.mark.parametrize("layout", [name for name in mcap.layouts() if name != "unchunked"])
def test_what_is_lost_of_a_chunk_is_counted(tmp_path, layouts, layout):
    """Statistics or the message index say it, also where the head of the chunk is damaged."""
    intact = layouts[layout]
    for at in places(intact, mcap.CHUNK)[1::2]:
        for place, width in ((24, 4), (16, 8), (28, 4)):  # checksum, size, length of a name
            data = bytearray(intact)
            data[at + 9 + place : at + 9 + place + width] = b"\x7f" * width
            count, lost = read(tmp_path / "log.mcap", data)
            assert (count, sum(one.messages or 0 for one in lost)) == (150, 50)


def test_times_that_no_checksum_shows_to_be_right_hide_no_chunk(tmp_path, layouts):
    """The last seconds of a log are read by the times in its summary only if that is checked."""
    for crc, is_known in ((False, False), (True, True)):
        data = bytearray(layouts["full"])
        if crc:
            start = places(data, END)[0] + 13
            struct.pack_into("<I", data, len(data) - 12, zlib.crc32(data[start:-12]))
        path = tmp_path / f"{crc}.mcap"
        path.write_bytes(data)
        with McapLog(path) as log:
            spans = [log.recorded_span(channel) for channel in log.channels()]
        assert all((span is not None) == is_known for span in spans)


def chunk_ends(data):
    """Return where the chunks end."""
    return [end for opcode, _, end in mcap.records(data) if opcode == mcap.CHUNK]


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("clock", ["log", "header"])
def test_memory_that_nothing_was_written_to_is_not_read(tmp_path, compression, clock):
    """Half of the samples of a torn chunk were those of chunks before it, or none at all."""
    data = mcap.mcap(compression, count=mcap.MOST)
    count, lost = read(tmp_path / "cut.mcap", data[: chunk_ends(data)[-1] - 4], clock=clock)
    assert lost
    assert count > 0.9 * mcap.MOST
    if compression == "lz4":  # which ends in 4 bytes that hold no data
        assert count == mcap.MOST
