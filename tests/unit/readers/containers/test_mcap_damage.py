"""MCAP files damaged in the middle: checksums, holes, torn chunks, and what comes behind them."""

import io
import struct
import zlib

import numpy as np
import pytest
from make.commands import refused
from make.mcap import (
    BARE,
    HEADERS,
    MESSAGES,
    Topic,
    build,
    numbered,
    numbered_data,
    read,
    read_numbers,
    records,
    saved,
    unclosed,
)
from make.places import SAMPLE_LOGS
from make.worn import wear
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, IndexType

from quatprop.base.errors import Loss, UnreadableLogError
from quatprop.readers.containers.mcap import McapLog
from quatprop.stores.file_source import SECTOR

ALL = list(range(MESSAGES))
PLAIN = {"compression": CompressionType.NONE}
COMPRESSIONS = (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)
LAYOUTS = {"whole": {}, "unclosed": {}, "bare": BARE}
every_compression = pytest.mark.parametrize("compression", COMPRESSIONS)
every_layout = pytest.mark.parametrize("layout", LAYOUTS)


def chunks(content):
    """Return begin and end of each chunk record."""
    return [(begin, end) for opcode, begin, end in records(content) if opcode == 6]


def numbers_of_chunks(content):
    """Return the numbers of the messages in each chunk, by the library's own reader."""
    return [
        [record.sequence for record in breakup_chunk(chunk) if isinstance(record, Message)]
        for chunk in StreamReader(io.BytesIO(content), emit_chunks=True).records
        if isinstance(chunk, Chunk)
    ]


def parts_with_numbers(content):
    """Return begin, end and numbers of each chunk, or of each message outside chunks."""
    if places := chunks(content):
        return [
            (*place, each) for place, each in zip(places, numbers_of_chunks(content), strict=True)
        ]
    places = [(begin, end) for opcode, begin, end in records(content) if opcode == 5]
    return [(*place, [number]) for number, place in enumerate(places)]


def without(numbers):
    """Return the numbers of all messages but some."""
    return [number for number in range(MESSAGES) if number not in set(numbers)]


@pytest.fixture
def is_left_out(tmp_path, monkeypatch):
    """Tell whether a chunk is lost with the reason, and read where the user says so."""

    def is_left_out(content, begin, lost, why):
        numbers, losses = read_numbers(tmp_path, content)
        monkeypatch.setenv("QUATPROP_CHECKSUMS", "ignore")
        everything, _ = read_numbers(tmp_path, content)
        way = "with QUATPROP_CHECKSUMS=ignore it is read anyway"
        reason = f"{why}, so it is not what was recorded; {way}"
        is_told = Loss(f"chunk at byte {begin}", reason, len(lost)) in losses
        return is_told and (numbers, everything) == (without(lost), ALL)

    return is_left_out


@every_compression
@pytest.mark.parametrize("closed", [True, False])
def test_a_chunk_whose_checksum_is_wrong_is_left_out_and_told(is_left_out, compression, closed):
    """Nobody can tell which of its samples is wrong, so none is taken, unless the user says so."""
    content = bytearray(numbered(compression=compression))
    begin, _ = chunks(content)[3]
    content[begin + 9 + 24] ^= 1  # in the checksum: the same as a bit in the samples, for any code
    content = bytes(content) if closed else unclosed(content)
    lost = numbers_of_chunks(numbered(compression=compression))[3]
    assert is_left_out(content, begin, lost, "its checksum is wrong")


def test_a_wrong_checksum_of_the_data_section_is_told(tmp_path):
    """Messages outside chunks have no other checksum; it does not say where the damage is."""
    content = bytearray(numbered(use_chunking=False, enable_data_crcs=True))
    assert read_numbers(tmp_path, bytes(content)) == (ALL, [])
    place = next(begin for opcode, begin, _ in records(content) if opcode == 5)
    content[place + 9 + 22 + 8] ^= 1
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == ALL
    assert losses == [
        Loss(
            "data section",
            "its checksum is wrong: it is not what was recorded, and the place is unknown",
        )
    ]


@every_compression
@every_layout
@pytest.mark.parametrize("harm", ["opcode", "length", "packed size", "everything", "hole"])
def test_what_follows_a_damaged_chunk_is_read(tmp_path, compression, layout, harm):
    """A chunk that cannot be followed to its end, or lacks bytes, costs no other."""
    intact = numbered(compression=compression, **LAYOUTS[layout])
    begin, end = chunks(intact)[4]
    name = len({CompressionType.NONE: ""}.get(compression, compression.name))
    first, last, value = {
        "opcode": (0, 1, b"\x55"),
        "length": (1, 9, (2**40).to_bytes(8, "little")),
        "packed size": (41 + name, 49 + name, (2**63).to_bytes(8, "little")),
        "everything": (0, end - begin, bytes(range(100, 160)) * 30),
        "hole": (200, 277, b""),
    }[harm]
    content = intact[: begin + first] + value + intact[begin + last :]
    if layout != "whole":
        content = content[: len(unclosed(intact)) + len(content) - len(intact)]
    numbers, losses = read_numbers(tmp_path, content)
    lost = numbers_of_chunks(intact)[4]
    assert set(without(lost)) <= set(numbers)
    assert numbers == sorted(set(numbers))
    assert losses or numbers == ALL
    # With a checksum, or what follows, its content is enough to tell what it is.
    if harm in {"opcode", "length"}:
        assert numbers == ALL
    if harm in {"packed size", "hole"}:
        assert numbers == without(lost)
        assert layout == "bare" or len(lost) in {loss.messages for loss in losses}
    if layout == "whole":
        assert sum(loss.messages or 0 for loss in losses) == MESSAGES - len(numbers)


@pytest.mark.parametrize("bit", range(8))
def test_a_chunk_whose_kind_is_damaged_is_known_by_its_content(tmp_path, bit):
    """Without it, messages would be missing."""
    content = bytearray(numbered(**BARE))
    content[next(begin for kind, begin, _ in records(content) if kind == 6)] ^= 1 << bit
    assert read_numbers(tmp_path, bytes(content)) == (ALL, [])


@pytest.mark.parametrize("bit", range(8))
def test_messages_of_a_channel_whose_record_is_damaged_are_counted(tmp_path, bit):
    """Nothing else defines it in a file without chunks and summary."""
    content = bytearray(numbered(**BARE, use_chunking=False))
    content[next(begin for kind, begin, _ in records(content) if kind == 4)] ^= 1 << bit
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == []
    assert sum(loss.messages or 0 for loss in losses) >= MESSAGES


def test_what_is_lost_with_a_chunk_that_is_gone_is_counted_by_its_index(tmp_path):
    """No statistics count the messages of a file whose last chunk was overwritten."""
    intact = numbered(use_statistics=False)
    begin, _ = chunks(intact)[-1]
    content = intact[:begin] + bytes(200) + intact[begin + 200 :]
    numbers, losses = read_numbers(tmp_path, content)
    lost = numbers_of_chunks(intact)[-1]
    assert numbers == without(lost)
    reason = "no chunk of the indexed length begins there"
    assert Loss(f"chunk at byte {begin}", reason, len(lost)) in losses


def test_a_chunk_that_the_index_lists_at_another_place_is_not_lost(tmp_path):
    """It is read, and something else that is damaged does not make it a loss."""
    intact = numbered()
    begins = [[begin for kind, begin, _ in records(intact) if kind == each] for each in (7, 8, 15)]
    content, garbage, summary = bytearray(intact), begins[0][7], begins[2][0] + 13
    content[begins[1][3] + 9 + 16] ^= 1  # of the offset of the chunk
    content[garbage : garbage + 9] = b"\xff" * 9
    content[-12:-8] = zlib.crc32(content[summary:-12]).to_bytes(4, "little")
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == ALL
    assert [(loss.place, loss.messages) for loss in losses] == [(f"byte {garbage}", None)]


@pytest.mark.parametrize("length", [0, 5000, 2**40])
def test_a_damaged_length_of_the_header_costs_nothing(tmp_path, length):
    """The next record is found behind it."""
    content = bytearray(numbered())
    content[9:17] = length.to_bytes(8, "little")
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == ALL
    assert [(loss.place, loss.messages) for loss in losses] == [("byte 8", None)]


def test_messages_of_a_plain_chunk_are_found_without_its_head(tmp_path):
    """The records inside a chunk that is not compressed can be followed by themselves."""
    content = bytearray(unclosed(numbered(**PLAIN)))
    begin, _ = chunks(content)[4]
    content[begin : begin + 9] = b"\xff" * 9
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == ALL
    assert losses[0].place == f"byte {begin}"


def test_a_chunk_behind_one_that_lacks_its_end_is_read(tmp_path):
    """The missing part of the chunk before reaches beyond the end of the file."""
    intact = unclosed(numbered(**PLAIN))
    (begin, end), (last, _) = chunks(intact)[-2:]
    content = intact[: begin + 100] + intact[last:]
    assert end > len(content)
    numbers, losses = read_numbers(tmp_path, content)
    lost = numbers_of_chunks(numbered())[-2]
    assert numbers == without(lost)
    assert f"chunk at byte {begin}" in {loss.place for loss in losses}


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
@pytest.mark.parametrize("layout", [*LAYOUTS, "messages"])
def test_a_place_that_cannot_be_read_costs_what_is_near_it(
    tmp_path, monkeypatch, layout, compression
):
    """A log that was not closed was refused as a whole, as was one with such a summary."""
    options = {"use_chunking": False} if layout == "messages" else LAYOUTS[layout]
    content = numbered(**{"compression": compression, **options})
    parts = parts_with_numbers(content)
    content = unclosed(content) if layout in {"unclosed", "messages"} else content
    path = saved(tmp_path, content)
    # Before its end is what defines the channel, if nothing repeats it.
    first = 8 if layout == "whole" else parts[1][1]
    for begin in range(first, len(content), 611):
        bad = range(begin, begin + 300)
        with monkeypatch.context() as patch:
            wear(patch, sector=bad)
            log = McapLog(path)
            found = [data for *_, data in read(log)]
        numbers = [int.from_bytes(data[:8], "little") for data in found]
        assert found == [numbered_data(number) for number in numbers]
        far = [
            number
            for start, end, numbers_of_part in parts
            for number in numbers_of_part
            if end <= bad.start - SECTOR or start >= bad.stop + SECTOR
        ]
        assert far == [number for number in numbers if number in set(far)]
        if len(numbers) < MESSAGES:
            assert any("it cannot be read" in loss.reason for loss in log.losses), begin


def test_a_definition_that_cannot_be_read_is_taken_from_the_summary(tmp_path, monkeypatch):
    """With zeros in it, it would be another one."""
    topic = HEADERS._replace(definition=HEADERS.definition + b"\n#" + b"x" * 10_000)
    events = [(0, number, numbered_data(number)) for number in range(MESSAGES)]
    content = build([("/imu", topic)], events, use_chunking=False)
    path = saved(tmp_path, content)
    begin, end = next(place for opcode, *place in records(content) if opcode == 3)
    wear(monkeypatch, sector=range(begin + 5000, begin + 5001))
    log = McapLog(path)
    assert [channel.schema for channel in log.channels()] == [topic.definition]
    assert [data for *_, data in read(log)] == [data for *_, data in events]
    assert log.losses == [
        Loss(f"byte {begin}", f"it cannot be read; {end - begin} bytes are skipped")
    ]


def test_the_damage_that_leaves_no_samples_is_named(tmp_path):
    """Only the first loss was, which costs no sample."""
    content = bytearray(unclosed((SAMPLE_LOGS / "coning.mcap").read_bytes()))
    ((begin, _),) = chunks(bytes(content))
    content[begin + 10_000] ^= 1
    path = saved(tmp_path, content)
    assert refused("propagate", path, "-o", tmp_path / "out.csv") == (
        f"Error: {path}: no samples in '/imu'; lost: byte {len(content)}: the file ends without a "
        f"footer; it was not closed; chunk at byte {begin}: its checksum is wrong, so it is not "
        "what was recorded; with QUATPROP_CHECKSUMS=ignore it is read anyway"
    )


def test_a_file_that_is_gone_while_it_is_searched_is_refused(tmp_path, monkeypatch):
    """A disk of the network that fails everywhere is not searched to its end."""
    path = saved(tmp_path, unclosed(numbered(use_chunking=False)))
    monkeypatch.setattr("quatprop.stores.file_source.MAX_SECTORS", 3)
    wear(monkeypatch, sector=range(8, 1 << 40))
    with pytest.raises(UnreadableLogError, match=r"it cannot be read: 'Input/output error'$"):
        McapLog(path)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(
    ("length", "which"), [(2**40, 7), (63, 7), (1000, 7), (10, 7), (2**40, -1), (1000, 0)]
)
def test_a_damaged_message_costs_the_rest_of_its_chunk(tmp_path, closed, length, which):
    """Where there is no checksum, its index tells how many messages are behind the damage."""
    intact = numbered(**PLAIN, enable_crcs=False)
    inside, (begin, _) = numbers_of_chunks(intact)[4], chunks(intact)[4]
    damaged = inside[which]
    at = intact.index(struct.pack("<QQ", damaged, damaged), begin + 57) - 15
    content = bytearray(intact)
    content[at + 1 : at + 9] = struct.pack("<Q", length)
    numbers, losses = read_numbers(tmp_path, bytes(content) if closed else unclosed(bytes(content)))
    left = [number for number in inside if number in numbers]
    assert numbers == without([number for number in inside if number not in left])
    assert left == inside[: len(left)]
    assert inside.index(damaged) - 1 <= len(left) <= inside.index(damaged)
    lost = [loss for loss in losses if loss.place == f"chunk at byte {begin}"]
    assert sum(loss.messages for loss in lost) == len(inside) - len(left)


@pytest.mark.parametrize("layout", ["whole", "unclosed", "bare", "without index"])
@pytest.mark.parametrize("which", [[7], slice(None)], ids=["one", "all"])
def test_messages_whose_channel_id_is_damaged_are_counted(tmp_path, layout, which):
    """The message index lists them still; without one, their channel is known to be undefined."""
    options = {
        "bare": BARE,
        "without index": {"index_types": IndexType.NONE, "use_statistics": False},
    }.get(layout, {})
    intact = numbered(**PLAIN, enable_crcs=False, **options)
    begin, _ = chunks(intact)[4]
    damaged = np.array(numbers_of_chunks(intact)[4])[which].tolist()
    content = bytearray(intact)
    for number in damaged:
        at = intact.index(struct.pack("<QQ", number, number), begin + 57) - 6
        content[at : at + 2] = struct.pack("<H", 777)
    if layout == "unclosed":
        content = unclosed(content)
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert numbers == without(damaged)
    reason = "its message index lists messages that are not among its records"
    expected = (
        Loss("channel 777", "no record defines it", len(damaged))
        if options
        else Loss(f"chunk at byte {begin}", reason, len(damaged))
    )
    assert [loss for loss in losses if loss.messages] == [expected]


def test_messages_outside_chunks_are_read_behind_damage(tmp_path):
    """A message whose length is wrong costs itself."""
    whole = numbered(use_chunking=False)
    for intact in (whole, unclosed(whole)):
        content = bytearray(intact)
        begin = [begin for opcode, begin, _ in records(intact) if opcode == 5][200]
        content[begin + 1 : begin + 9] = b"\xff" * 8
        numbers, losses = read_numbers(tmp_path, bytes(content))
        assert numbers == without([200])
        assert losses[0] == Loss(f"byte {begin}", "no record begins there; 71 bytes are skipped")
    short = struct.pack("<BQ", 5, 10) + bytes(10)
    first = next(begin for opcode, begin, _ in records(intact) if opcode == 5)
    chunked = unclosed(numbered())
    chunk, _ = chunks(chunked)[0]
    for content, at, run in ((intact, begin, first), (chunked, chunk, chunk)):
        numbers, losses = read_numbers(tmp_path, content[:at] + short + content[at:])
        assert numbers == ALL
        assert losses[0] == Loss(f"messages at byte {run}", "too short to be messages", 1)


def test_a_message_outside_chunks_beyond_the_limit_of_memory_is_lost_alone(tmp_path, monkeypatch):
    """Of one message as much is allocated as of a chunk, and no more."""
    events = [(0, number, bytes([number, *bytes(5000 * number)])) for number in (1, 0)]
    content = build([("/imu", HEADERS)], events, use_chunking=False)
    begin, end = next(each[1:] for each in records(content) if each[0] == 5)
    for limit, numbers, losses in (
        (end - begin, [1, 0], []),
        (end - begin - 1, [0], [Loss(f"message at byte {begin}", "it is too large")]),
    ):
        monkeypatch.setattr("quatprop.readers.containers.mcap_scan.MAX_SIZE", limit)
        found, told = read_numbers(tmp_path, content)
        assert (found, told[:1]) == (numbers, losses)


def test_bytes_that_look_like_a_record_are_not_one(tmp_path):
    """Behind damage, what has the head of a record but leads nowhere is passed over."""
    fake = b"".join(
        struct.pack("<BQ", opcode, length) + b"\x01\0\0\0zstd" + bytes(range(40))
        for opcode in (3, 4, 5, 6, 7, 9, 12, 15)
        for length in (4, 22, 64, 200, 300)
    )
    intact = numbered(**BARE)
    _, end = chunks(intact)[7]
    fake += struct.pack("<BQ", 0x8F, 4) + b"\1\0\0\0"  # a bit more than the end of the data
    content = intact[:end] + b"\0" * 100 + fake + b"\xff" * 100 + intact[end:]
    numbers, losses = read_numbers(tmp_path, content)
    assert numbers == ALL
    skipped = 200 + len(fake)
    assert losses == [Loss(f"byte {end}", f"no record begins there; {skipped} bytes are skipped")]


def test_records_of_unknown_kinds_are_passed_over(tmp_path):
    """The format may gain some, and what they hold may have the lengths of a chunk."""
    intact = numbered(**BARE)
    _, end = chunks(intact)[7]
    for content in (bytes(3), bytes(28) + b"\3\0\0\0new" + struct.pack("<Q", 5) + bytes(5)):
        record = struct.pack("<BQ", 0x10, len(content)) + content
        assert read_numbers(tmp_path, intact[:end] + record + intact[end:]) == (ALL, [])


def two_topics():
    """Return a log of two topics whose messages alternate."""
    topics = [(name, Topic("", encoding="cdr")) for name in ("/a", "/b")]
    events = [(number % 2, number, number.to_bytes(8, "little") * 5) for number in ALL]
    return build(topics, events, chunk_size=1500)


def test_a_damaged_message_index_hides_no_channel(tmp_path):
    """Where that of one of two channels is damaged, or lists too few, the chunk is walked."""
    intact = two_topics()
    begin = [begin for opcode, begin, _ in records(intact) if opcode == 7][9]
    content = bytearray(unclosed(intact))
    content[begin : begin + 15] = b"\xff" * 15
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert sorted(numbers) == ALL
    assert losses[0].place == f"byte {begin}"
    content = bytearray(intact)
    size = int.from_bytes(content[begin + 11 : begin + 15], "little")
    content[begin + 11 : begin + 15] = (size - 16 * 5).to_bytes(4, "little")
    numbers, losses = read_numbers(tmp_path, bytes(content))
    assert (sorted(numbers), losses) == (ALL, [])


@pytest.mark.parametrize("damaged", [1, 2])
def test_definitions_are_taken_from_a_chunk_whose_checksum_is_wrong(tmp_path, damaged):
    """Where nothing else says what the channels are, the first chunk does, though damaged."""
    content = bytearray(unclosed(numbered(**BARE)))
    begins = [begin for begin, _ in chunks(content)[:damaged]]
    for begin in begins:
        content[begin + 9 + 24] ^= 1
    numbers, losses = read_numbers(tmp_path, bytes(content))
    lost = numbers_of_chunks(numbered(**BARE))[:damaged]
    assert numbers == without([number for each in lost for number in each])
    assert [loss.place for loss in losses][-damaged:] == [f"chunk at byte {k}" for k in begins]


@pytest.mark.parametrize("size", [0, 1, 1 << 27, (1 << 64) - 1])
@every_compression
def test_a_chunk_of_another_size_than_the_index_says_is_read(tmp_path, compression, size):
    """The head of the chunk counts, whatever the summary says that it decompresses to."""
    content = bytearray(numbered(compression=compression))
    ends = [end for opcode, _, end in records(content) if opcode == 8]
    for end in ends[3:5]:
        content[end - 8 : end] = size.to_bytes(8, "little")
    summary = next(begin for opcode, begin, _ in records(content) if opcode == 15) + 13
    crc = zlib.crc32(content[summary:-12])
    content[-12:-8] = crc.to_bytes(4, "little")
    assert len(ends) > 6
    assert read_numbers(tmp_path, bytes(content)) == (ALL, [])


@every_compression
@every_layout
def test_a_chunk_whose_log_times_are_not_as_it_states_is_lost(is_left_out, compression, layout):
    """Without a checksum, they show that what was decompressed is not what was recorded."""
    intact = numbered(compression=compression, enable_crcs=False, **LAYOUTS[layout])
    begin, _ = chunks(intact)[4]
    content = bytearray(intact)
    lost = numbers_of_chunks(intact)[4]
    stated = struct.pack("<QQ", lost[0], lost[-1])
    at = content.index(stated, begin)
    while at > 0:  # in the chunk and in its index
        content[at : at + 16] = struct.pack("<QQ", lost[0], lost[-1] - 1)
        at = content.find(stated, at)
    content = unclosed(bytes(content)) if layout == "unclosed" else bytes(content)
    why = "its log times are outside the range in its header"
    assert is_left_out(content, begin, lost, why)


@pytest.mark.parametrize("checked", [True, False])
def test_times_that_a_chunk_does_not_state_or_that_its_checksum_refutes(tmp_path, checked):
    """A right checksum counts for more than the stated times; times of 0 state nothing."""
    content = bytearray(numbered(enable_crcs=checked, **BARE))
    for begin, _ in chunks(content):
        content[begin + 9 : begin + 25] = struct.pack("<QQ", 0, 1 if checked else 0)
    assert read_numbers(tmp_path, bytes(content)) == (ALL, [])


def test_no_part_of_an_unclosed_log_is_left_unread_for_the_times_in_heads_of_chunks(tmp_path):
    """A head has no checksum: a wrong time in it would hide the messages of its chunk."""
    path = tmp_path / "log.mcap"
    path.write_bytes(unclosed(numbered()))
    log = McapLog(path)
    assert [log.recorded_span(channel) for channel in log.channels()] == [None]
