"""Logs that were made to do harm: bombs, definitions that unfold without end, endless losses."""

import struct
import tempfile
import threading
import time

import pytest
import zstandard
from click.testing import CliRunner
from make.numbered_mcap import MESSAGES, read, unclosed, written
from make.ulog import added, record
from mcap.writer import Writer

from quatprop.cli.commands import cli
from quatprop.concurrency import threads
from quatprop.containers import chunks
from quatprop.containers.mcap import loading as mcap
from quatprop.containers.mcap.log import McapLog
from quatprop.errors import DamagedLogError, UsageError
from quatprop.logs.open_log import open_log
from quatprop.rendering import loss_lines
from quatprop.stores.limits import MAX_UNPACKED, decompressed_limit
from quatprop.tables.log import Loss

SIZE = 1 << 24
MESSAGE = struct.pack("<BQHIQQ", 5, 22 + 8, 1, 0, 10**9, 10**9) + bytes(8)
FILLER = struct.pack("<BQ", 0x99, SIZE - len(MESSAGE) - 9)
BOMB = zstandard.compress((MESSAGE + FILLER).ljust(SIZE, b"\0"))


def bombs(count):
    """Return chunks that unpack to one message and 16 MiB of nothing each."""
    head = struct.pack("<QQQII", 10**9, 10**9, SIZE, 0, 4) + b"zstd"
    chunk = head + struct.pack("<Q", len(BOMB)) + BOMB
    return (struct.pack("<BQ", 6, len(chunk)) + chunk) * count


def test_the_limit_is_that_of_the_environment(monkeypatch):
    """A number of bytes, with or without a unit; anything else is refused."""
    assert decompressed_limit(1000) == 2 << 30
    assert decompressed_limit(1 << 30) == 200 << 30
    for said, limit in {"123": 123, "7k": 7 << 10, "64 G": 64 << 30, "2TiB": 2 << 40}.items():
        monkeypatch.setenv(MAX_UNPACKED, said)
        assert decompressed_limit(1 << 40) == limit
    for said in ("much", "-1", "1e9", "9" * 30):
        monkeypatch.setenv(MAX_UNPACKED, said)
        with pytest.raises(UsageError, match="which is no number of bytes like 64G"):
            decompressed_limit(1)


def test_chunks_that_unpack_to_more_than_a_log_can_have_are_not_unpacked(tmp_path, monkeypatch):
    """What comes before the limit is read, what comes after is told with the way out."""
    content = unclosed(written()) + bombs(30)
    monkeypatch.setenv(MAX_UNPACKED, "100M")
    numbers, losses = read(tmp_path, content)
    assert numbers == [*range(MESSAGES), *[0] * 7]
    reason = (
        "it decompresses to more than 104857600 bytes; if that is right, set QUATPROP_MAX_UNPACKED "
        "to more"
    )
    refused = [loss for loss in losses if loss.reason == reason]
    assert len(refused) == 30 - 7
    monkeypatch.setenv(MAX_UNPACKED, "1G")
    assert [loss.reason for loss in read(tmp_path, content)[1] if "unpacks" in loss.reason] == []


def test_a_packed_file_that_unpacks_to_more_than_a_log_can_have_is_refused(tmp_path, monkeypatch):
    """A file of kilobytes does not fill the disk, and leaves nothing there."""
    room = tmp_path / "room"
    room.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(room))
    monkeypatch.setenv(MAX_UNPACKED, "20M")
    log = tmp_path / "log.mcap.zst"
    log.write_bytes(zstandard.compress(written()) + BOMB * 3)
    with (
        pytest.raises(
            DamagedLogError, match=r"log.mcap.zst: it decompresses to more than 20971520"
        ),
        open_log(log),
    ):
        pass
    assert list(room.iterdir()) == []


def test_large_chunks_are_not_unpacked_ahead(tmp_path, monkeypatch):
    """However many threads there are, of large chunks there is one at a time."""
    monkeypatch.setattr(threads, "available_cores", lambda: 4)
    path = tmp_path / "log.mcap"
    path.write_bytes(unclosed(written()) + bombs(12))
    alone = []
    load = mcap.load

    def watched(*arguments, **options):
        alone.append(threading.current_thread() is threading.main_thread())
        return load(*arguments, **options)

    monkeypatch.setattr(mcap, "load", watched)
    for large, expected in ((1 << 30, {False}), (SIZE // 2, {False, True})):
        monkeypatch.setattr(chunks, "LARGE", large)
        alone.clear()
        log = McapLog(path)
        assert sum(len(block) for block in log.blocks(log.channels()[0])) == MESSAGES + 12
        assert set(alone) == expected
    assert alone.count(True) == 12


LEVELS = 40
ROS = "\n".join(
    f"{'=' * 80}\nMSG: a/T{k}\n"
    + (f"T{k + 1} a\nT{k + 1} b" if k < LEVELS else "float64 x\nfloat64 y\nfloat64 z")
    for k in range(LEVELS + 1)
)
IMU = "a/T0 before\ngeometry_msgs/Vector3 angular_velocity\n"
VECTOR = f"\n{'=' * 80}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"


def laughing(path):
    """Write a log whose definition is two of two of two..., forty times, before the rate."""
    if path.suffix == ".ulg":
        fields = [f"t{k}:t{k + 1} a;t{k + 1} b;" for k in range(LEVELS)] + [
            f"t{LEVELS}:float x;",
            "sensor_gyro:uint64_t timestamp;t0 before;float x;float y;float z;",
        ]
        messages = record(b"D", b"\1\0" + b"\1" * 100) * 5
        formats = b"".join(record(b"F", text.encode()) for text in fields)
        begin = b"ULog\x01\x12\x35\x01" + bytes(8) + record(b"B", bytes(40))
        path.write_bytes(begin + formats + added("sensor_gyro", 0, 1) + messages)
        return
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        definition = (IMU + ROS + VECTOR).encode()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition)
        channel = writer.register_channel("/imu", "cdr", schema)
        writer.add_message(channel, 0, bytes(400), 0)
        writer.finish()


@pytest.mark.parametrize("suffix", [".mcap", ".ulg"])
def test_types_that_double_at_every_level_are_refused(tmp_path, suffix):
    """A definition of a few kilobytes that means 2**40 fields costs nobody any time."""
    log = tmp_path / f"log{suffix}"
    laughing(log)
    result = CliRunner().invoke(cli, ["info", str(log)])
    assert result.exit_code == 2
    assert "the definition is larger than any message" in result.output


def test_a_folder_of_links_in_a_circle_is_read_past(tmp_path):
    """A part that is a link to itself is no file; the others are read."""
    (tmp_path / "bag_0.mcap").write_bytes(written())
    (tmp_path / "bag_1.mcap").symlink_to("bag_1.mcap")
    with open_log(tmp_path) as log:
        (channel,) = log.channels()
        assert sum(len(block) for block in log.blocks(channel)) == MESSAGES


def test_thousands_of_losses_are_told_in_a_few_lines():
    """Each is in the report; the terminal shows the first and how many more there are."""
    losses = [Loss(f"chunk at byte {k}", "bad\x1b[2J", 1) for k in range(5000)]
    lines = loss_lines(losses)
    assert lines[0] == "lost: chunk at byte 0: bad\\x1b[2J"
    assert lines[-1] == "lost: 4980 more, which the JSON report lists"
    assert len(lines) == 21
    assert len(loss_lines(losses[:20])) == 20


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_twenty_thousand_damaged_chunks_cost_little_time(tmp_path, kind):
    """Each is noted once, without a look through all that were noted before."""
    count = 20_000
    if kind == "mcap":
        chunk = struct.pack("<QQQII", 0, 1, 40, 7, 0) + struct.pack("<Q", 40) + bytes(40)
        content = unclosed(written()) + (struct.pack("<BQ", 6, len(chunk)) + chunk) * count
    else:
        fields = (b"op=\x05", b"compression=bz2", b"size=" + struct.pack("<I", 40))
        header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
        chunk = struct.pack("<I", len(header)) + header + struct.pack("<I", 40) + bytes(40)
        begin = struct.pack("<I", 8) + struct.pack("<I", 4) + b"op=\x03" + struct.pack("<I", 0)
        content = b"#ROSBAG V2.0\n" + begin + chunk * count
    log = tmp_path / f"log.{kind}"
    log.write_bytes(content)
    began = time.process_time()
    with open_log(log) as opened:
        for channel in opened.channels():
            for _ in opened.blocks(channel):
                pass
        losses = list(opened.losses)
    assert len(losses) >= count - 1
    assert time.process_time() - began < 10
