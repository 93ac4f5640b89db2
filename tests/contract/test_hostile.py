"""Logs that were made to do harm: bombs, claims, escapes, definitions that unfold without end."""

import os
import re
import shutil
import struct
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import zstandard
from make import formats
from make.commands import refused, run
from make.formats import FORMATS, SAMPLES
from make.mcap import MESSAGES, Topic, numbered, read_numbers, unclosed, write_topics
from make.reading import rates
from make.systems import on_posix
from make.tables import write_rates
from make.ulog import added, record
from pyarrow import feather, parquet

from quatprop.base import threads
from quatprop.base.errors import DamagedLogError, LogError, Loss, SchemaError, UsageError
from quatprop.base.rendering import loss_lines
from quatprop.kinematics.series import GyroSeries
from quatprop.readers.containers import mcap
from quatprop.readers.containers import parts as chunks
from quatprop.readers.containers.mcap import McapLog
from quatprop.readers.messages.blocks import Channel
from quatprop.readers.messages.definitions import message_type
from quatprop.readers.open_log import open_log
from quatprop.readers.rate_signals import choose_rates
from quatprop.settings.reading import RateSelection
from quatprop.stores.compression import MAX_UNPACKED, decompressed_limit

ESCAPES = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e"
"""Clears the screen, names the window, and turns the text around."""


def with_escapes(path):
    """Write a log whose every name holds terminal escapes, and rates of NaN."""
    series = GyroSeries(np.arange(3), np.full((3, 3), [0.0, 0.0, np.nan]))
    if path.suffix == ".mcap":
        topics = {name: formats.ros_topic(series) for name in formats.TOPICS}
        topics[f"/unknown{ESCAPES}"] = Topic(
            f"a/msg/{ESCAPES}", [], ESCAPES.encode(), "ros2msg", ESCAPES
        )
        write_topics(path, topics, profile=ESCAPES)
    elif path.suffix == ".bag":
        FORMATS["none.bag"].write(path, series, series)
    elif path.suffix == ".parquet":
        names = [ESCAPES, *(f"gyro_{axis}{ESCAPES}" for axis in "xyz")]
        parquet.write_table(pa.table({name: [1.0, np.nan] for name in names}), path)
    else:
        write_rates(path, [f"{ESCAPES},1,2,3", f"1,{ESCAPES},2,3"], f"{ESCAPES},wx,wy,wz")


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".parquet", ".csv"])
def test_escapes_in_a_log_never_reach_the_terminal(tmp_path, monkeypatch, suffix):
    """Names of topics, types, frames and columns are shown with everything unprintable escaped."""
    monkeypatch.setattr(formats, "FRAME", ESCAPES)
    monkeypatch.setattr(formats, "TOPICS", (f"/imu{ESCAPES}", f"/other{ESCAPES}"))
    log, target = tmp_path / f"log{suffix}", tmp_path / f"out{ESCAPES}.mcap"
    with_escapes(log)
    propagate = ("propagate", "-v", log, "-o", target)
    named = (*propagate, "-t", f"/imu{ESCAPES}")
    shown = [
        run(*command).output
        for command in (
            ("info", log),
            ("info", "--json", log),
            propagate,
            named,
            (*named, "--on-nonfinite", "hold", "--q0", "log", "--message", "odometry"),
            (*propagate, "-t", ESCAPES),
            (*propagate, "--rate-field", ESCAPES),
            (*propagate, "--rate-cols", f"{ESCAPES},b,c"),
            ("convert", log, target),
            ("compare", log, log),
        )
    ]
    assert [text for text in shown if not text.replace("\n", "").isprintable()] == []
    assert "\\x1b[2J" in "".join(shown)


ROWS = 1234


SIZES = [size.to_bytes(8, "little") for size in (ROWS * 8, 1 << 60)]
CLAIMS = {
    **{
        f"{claimed} rows": ("uncompressed", lambda data, claimed=claimed: data.replace(
            ROWS.to_bytes(8, "little"), claimed.to_bytes(8, "little", signed=True)
        ))
        for claimed in (ROWS + 1, 10_000_000, 1 << 40, 1 << 62, -1)
    },
    "a footer of 4 GB, of a file that is cut": (
        "uncompressed", lambda data: data[:-2000] + (0xF0000000).to_bytes(4, "little") + bytes(6),
    ),
    "a packed buffer of 2**60 bytes": ("zstd", lambda data: data.replace(*SIZES)),
}  # fmt: skip


def address_space():
    """Return what this process has, kB; 0 where that cannot be known."""
    status = Path("/proc/self/status")
    return int(re.search(r"VmSize:\s*(\d+) kB", status.read_text())[1]) if status.exists() else 0


@pytest.mark.parametrize("claim", CLAIMS)
def test_what_a_feather_file_claims_is_not_believed(tmp_path, claim):
    """It is a loss, not other memory of the process, nor is memory taken for it."""
    (compression, change), path = CLAIMS[claim], tmp_path / "log.feather"
    columns = dict.fromkeys(("wx", "wy", "wz"), np.arange(ROWS) * 1e-3) | {"t_ns": np.arange(ROWS)}
    feather.write_feather(pa.table(columns), path, compression=compression)
    path.write_bytes(change(path.read_bytes()))
    count, losses, before = 0, None, address_space()
    with suppress(LogError), open_log(path) as log:
        count = sum(map(len, choose_rates(log, RateSelection(time_unit="ns")).batches()))
        losses = [loss.place for loss in log.losses]
    assert count == 0
    assert losses == (["record batch 0"] if compression == "zstd" else losses)
    assert losses != []
    assert address_space() - before < 1_000_000


LAUGHS = "".join(
    f"b{k}: &b{k} [{', '.join([f'*b{k - 1}' if k else 'ha'] * 9)}]\n" for k in range(12)
)
NAMED = "rosbag2_bagfile_information:\n  relative_file_paths: [db3_ros2.db3]\n"
METADATA = {
    "aliases that unfold to 2 * 10**11 texts as a path": (
        f"{LAUGHS}rosbag2_bagfile_information:\n  relative_file_paths: [db3_ros2.db3, *b11]\n"
    ),
    "such aliases elsewhere": (
        f"{LAUGHS}{NAMED}  compression_mode: *b11\n  files: [{{path: *b11}}]\n"
        "  topics_with_message_count:\n"
        "  - {message_count: 7, topic_metadata: {name: *b11, type: *b11}}\n"
    ),
    "a tag that would run a command": '!!python/object/apply:os.system ["touch owned"]',
    "nesting without end": "[" * 5000,
    "more than anyone writes": f"{NAMED}{'#' * (1 << 22)}",
}


@pytest.mark.parametrize("what", METADATA)
def test_hostile_metadata_does_no_harm(logs, tmp_path, monkeypatch, what):
    """Whatever metadata.yaml holds, the samples of the parts in the folder are read."""
    folder = shutil.copytree(logs / "db3_ros2", tmp_path / "db3_ros2")
    (folder / "metadata.yaml").write_text(METADATA[what])
    monkeypatch.chdir(tmp_path)
    assert len(rates(folder)[1]) == SAMPLES
    assert list(tmp_path.iterdir()) == [folder]


@on_posix
def test_what_is_no_file_in_a_bag_folder_is_passed_over(logs, tmp_path):
    """A pipe in place of the metadata or of a part is not waited for, nor a link to itself."""
    folder = shutil.copytree(logs / "db3_ros2", tmp_path / "db3_ros2")
    (folder / "metadata.yaml").unlink()
    (folder / "db3_ros2_2.db3").symlink_to("db3_ros2_2.db3")
    for name in ("metadata.yaml", "db3_ros2_1.db3"):
        os.mkfifo(folder / name)
    _, series, losses = rates(folder)
    assert len(series) == SAMPLES
    assert losses


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_columns_of_one_name_are_refused(tmp_path, kind):
    """Of several columns with the name of a chosen one, none is taken."""
    log = tmp_path / f"log.{kind}"
    names = ["t_ns", "wx", "wy", "wz", "wx"]
    table = pa.Table.from_arrays([pa.array([1, 2]), *([pa.array([0.1, 0.2])] * 4)], names)
    if kind == "parquet":
        parquet.write_table(table, log)
    else:
        with pa.ipc.new_file(str(log), table.schema) as file:
            file.write_table(table)
    sentence = refused("propagate", log, "-o", "-")
    assert "several columns have the same name; by numbers from 0: 1-2-3, 4-2-3" in sentence
    assert "--rate-cols X,Y,Z" in sentence


def test_definitions_of_megabytes_are_not_parsed():
    """The grammar takes a minute for 200,000 fields; nobody waits for that."""
    schema = b"".join(b"float64 f%d\n" % k for k in range(200_000))
    channel = Channel("/imu", "a/msg/B", "cdr", "ros2msg", schema)
    reason = rf"topic '/imu': the definition of 'a/msg/B' has {len(schema)} bytes, over the limit"
    with pytest.raises(SchemaError, match=reason):
        message_type(channel, "log.mcap")


LEVELS = 40
ROS = "\n".join(
    f"{'=' * 80}\nMSG: a/T{k}\n"
    + (f"T{k + 1} a\nT{k + 1} b" if k < LEVELS else "float64 x\nfloat64 y\nfloat64 z")
    for k in range(LEVELS + 1)
)
IMU = "a/T0 before\ngeometry_msgs/Vector3 angular_velocity\n"
VECTOR = f"\n{'=' * 80}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"


@pytest.mark.parametrize("suffix", [".mcap", ".ulg"])
def test_types_that_double_at_every_level_are_refused(tmp_path, suffix):
    """A definition of a few kilobytes that means 2**40 fields costs nobody any time."""
    log = tmp_path / f"log{suffix}"
    if suffix == ".ulg":
        fields = [f"t{k}:t{k + 1} a;t{k + 1} b;" for k in range(LEVELS)] + [
            f"t{LEVELS}:float x;",
            "sensor_gyro:uint64_t timestamp;t0 before;float x;float y;float z;",
        ]
        messages = record(b"D", b"\1\0" + b"\1" * 100) * 5
        types = b"".join(record(b"F", text.encode()) for text in fields)
        begin = b"ULog\x01\x12\x35\x01" + bytes(8) + record(b"B", bytes(40))
        log.write_bytes(begin + types + added("sensor_gyro", 0, 1) + messages)
    else:
        definition = (IMU + ROS + VECTOR).encode()
        topic = Topic("sensor_msgs/msg/Imu", [bytes(400)], definition, "ros2msg", "cdr")
        write_topics(log, {"/imu": topic})
    assert "the definition is larger than any message" in refused("info", log)


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
        with pytest.raises(UsageError, match="which is not a number of bytes like 64G"):
            decompressed_limit(1)


def test_chunks_that_unpack_to_more_than_a_log_can_have_are_not_unpacked(tmp_path, monkeypatch):
    """Rows before the limit are read, those after it are reported with the remedy."""
    content = unclosed(numbered()) + bombs(12)
    monkeypatch.setenv(MAX_UNPACKED, "100M")
    numbers, losses = read_numbers(tmp_path, content)
    assert numbers == [*range(MESSAGES), *[0] * 7]
    reason = (
        "it decompresses to more than 104857600 bytes; if that is right, set QUATPROP_MAX_UNPACKED "
        "to more"
    )
    assert [loss.reason for loss in losses].count(reason) == 12 - 7
    monkeypatch.setenv(MAX_UNPACKED, "1G")
    assert len(read_numbers(tmp_path, content)[0]) == MESSAGES + 12


@pytest.mark.usefixtures("temporary")
def test_a_packed_file_that_unpacks_to_more_than_a_log_can_have_is_refused(tmp_path, monkeypatch):
    """A file of kilobytes does not fill the disk, and leaves nothing there."""
    monkeypatch.setenv(MAX_UNPACKED, "20M")
    log = tmp_path / "log.mcap.zst"
    log.write_bytes(zstandard.compress(numbered()) + BOMB * 3)
    with pytest.raises(
        DamagedLogError, match=r"log.mcap.zst: it decompresses to more than 20971520"
    ):
        rates(log)


def test_large_chunks_are_not_unpacked_ahead(tmp_path, monkeypatch):
    """However many threads there are, of large chunks there is one at a time."""
    monkeypatch.setattr(threads, "available_cores", lambda: 4)
    path = tmp_path / "log.mcap"
    path.write_bytes(unclosed(numbered()) + bombs(6))
    alone = []
    load = mcap.load_chunk

    def watched(*arguments, **options):
        alone.append(threading.current_thread() is threading.main_thread())
        return load(*arguments, **options)

    monkeypatch.setattr(mcap, "load_chunk", watched)
    for large, expected in ((1 << 30, {False}), (SIZE // 2, {False, True})):
        monkeypatch.setattr(chunks, "LARGE", large)
        alone.clear()
        log = McapLog(path)
        assert sum(len(block) for block in log.blocks(log.channels()[0])) == MESSAGES + 6
        assert set(alone) == expected
    assert alone.count(True) == 6


def test_thousands_of_losses_are_told_in_a_few_lines():
    """Each is in the report; the terminal shows the first and how many more there are."""
    losses = [Loss(f"chunk at byte {k}", "bad\x1b[2J", 1) for k in range(5000)]
    lines = loss_lines(losses)
    assert lines[0] == "lost: chunk at byte 0: bad\\x1b[2J"
    assert lines[-1] == "lost: 4980 more, which the JSON report lists"
    assert len(lines) == 21
    assert len(loss_lines(losses[:20])) == 20
