"""What is left of damaged logs: never a sample that was not there, never a silent loss."""

import io
import os
import re
import shutil
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from make.logs import SAMPLES, write_logs
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import Writer as McapWriter
from pyarrow import feather, parquet
from rosbags.rosbag1 import Reader as BagReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from quatprop.cli.commands import cli
from quatprop.errors import LogError, SchemaError
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.messages.blocks import Channel
from quatprop.messages.definitions import message_type
from quatprop.settings.selection import RateSelection

CUTS = 120
CUT_LOGS = [
    "small.csv",
    "semicolons.csv",
    "small.csv.gz",
    "small.csv.zst",
    "mcap-none.mcap",
    "mcap-lz4.mcap",
    "mcap-zstd.mcap",
    "mcap-bare.mcap",
    "mcap-unchunked.mcap",
    "mcap-none.mcap.lz4",
    "bag-none.bag",
    "bag-bz2.bag",
    "bag-lz4.bag",
    "bag-none.bag.bz2",
    "small.db3",
    "small_ros2/small_ros2.db3",
    "mcap_ros2/mcap_ros2.mcap",
    "small.parquet",
    "uncompressed.feather",
    "zstd.feather",
    "json.mcap",
    "protobuf.mcap",
    "gyro.ulg",
    "rows.jsonl",
    "records.npy",
    "stored.npz",
]


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Return a folder with an intact log of every kind."""
    folder = tmp_path_factory.mktemp("logs")
    write_logs(folder)
    return folder


def samples(log):
    """Return the stamps and rates of a log, and whether anything of it is told as lost.

    That its last number may be cut, where nobody can tell, is told as well: by None.
    """
    try:
        with open_log(log) as opened:
            batches = list(choose_rates(opened, RateSelection()).batches())
            lost = True if opened.losses else None if opened.remarks else False
    except LogError:
        return np.empty((0, 4)), True
    t_ns = np.concatenate([batch.t_ns for batch in batches] or [np.empty(0)])
    rate = np.concatenate([batch.rate for batch in batches] or [np.empty((0, 3))])
    # A log without any sample is refused by whoever wants them.
    return np.column_stack([t_ns.view(np.float64), rate]), lost if len(t_ns) else True


def held(name, path):
    """Return where parts of a log end and how many samples they end with, by others' count."""
    walk = WALKS.get(f".{name.rpartition('.')[2]}")
    return walk(path) if walk else []


def line_ends(path):
    """Return where each row ends, and how many rows come before there."""
    lines = path.read_bytes().splitlines(keepends=True)
    ends = np.cumsum([len(line) for line in lines])
    return list(zip(ends.tolist(), range(SAMPLES - len(lines) + 1, SAMPLES + 1), strict=True))


def mcap_ends(path):
    """Return where each record ends, and how many messages come before there."""
    parts = []
    file = io.BytesIO(path.read_bytes())
    for record in StreamReader(file, emit_chunks=True).records:
        inside = breakup_chunk(record) if isinstance(record, Chunk) else [record]
        parts.append((file.tell(), sum(isinstance(one, Message) for one in inside)))
    counts = np.cumsum([count for _, count in parts])
    return [(end, int(count)) for (end, _), count in zip(parts, counts, strict=True)]


def chunk_ends(path):
    """Return where each chunk of a ROS 1 bag ends, and how many messages come before there."""
    with BagReader(path) as reader:
        chunks = sorted(reader.chunk_infos, key=lambda chunk: chunk.pos)
    counts = np.cumsum([sum(chunk.connection_counts.values()) for chunk in chunks])
    return list(zip([chunk.pos for chunk in chunks[1:]], counts[:-1].tolist(), strict=True))


def array_ends(path):
    """Return where each row of a NumPy array ends, and how many rows come before there."""
    (header,) = struct.unpack_from("<H", path.read_bytes(), 8)
    return [(10 + header + 4 * 8 * count, count) for count in range(1, SAMPLES + 1)]


def ulog_ends(path):
    """Return where each record ends, and how many samples come before there."""
    return [(end, count) for end, count, _ in ulog_records(path.read_bytes())]


def batch_ends(path):
    """Return where each batch of a Feather file ends, and how many rows come before there."""
    with path.open("rb") as file:
        file.seek(8)
        messages, count, found = pa.ipc.MessageReader.open_stream(file), 0, []
        schema = pa.ipc.read_schema(messages.read_next_message())
        while (message := messages.read_next_message()).type == "record batch":
            count += pa.ipc.read_record_batch(message, schema).num_rows
            found.append((file.tell(), count))
            if count == SAMPLES:
                return found
    return found


def page_ends(path):
    """Return where the page with each message of a database ends, and how many come before."""
    content = path.read_bytes()
    size = int.from_bytes(content[16:18], "big")
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT data FROM messages ORDER BY timestamp").fetchall()
    ends = [(content.index(data) // size + 1) * size for (data,) in rows]
    # A message is among the first that are left where those before it are, too.
    ends = np.maximum.accumulate(ends)
    return list(zip(ends.tolist(), range(1, len(ends) + 1), strict=True))


WALKS = {
    ".csv": line_ends,
    ".jsonl": line_ends,
    ".mcap": mcap_ends,
    ".bag": chunk_ends,
    ".npy": array_ends,
    ".ulg": ulog_ends,
    ".feather": batch_ends,
    ".db3": page_ends,
}
"""Independent walks of intact logs."""


def ulog_records(data):
    """Return where each record ends, how many samples come before there, and its kind."""
    position, count, found = 16, 0, []
    while position < len(data):
        size, kind = struct.unpack_from("<Hc", data, position)
        count += kind == b"D" and data[position + 3 : position + 5] == b"\x01\0"
        position += 3 + size
        found.append((position, count, kind))
    return found


def ends_a_row(name, data, ends):
    """Tell whether a log without an end of its own ends with a whole row, and says no more."""
    return data.endswith(b"\n") if is_text(name) else name.endswith(".ulg") and len(data) in ends


def is_text(name):
    """Tell whether the rows of a log are lines."""
    return name.endswith((".csv", ".jsonl"))


@pytest.mark.parametrize("name", CUT_LOGS)
def test_a_cut_log_gives_the_samples_before_the_cut_and_says_that_it_is_cut(logs, tmp_path, name):
    """Wherever a log ends, its samples are the first of the whole, and nothing is lost silently."""
    folder, _, part = name.partition("/")
    intact = logs / name
    whole, lost = samples(logs / folder)
    assert (len(whole), lost) == (SAMPLES, False)
    data = intact.read_bytes()
    log = tmp_path / folder
    if part:
        shutil.copytree(logs / folder, log)
    parts = held(name, intact)
    ends = {end for end, _ in parts}
    wrong = []
    for size in np.linspace(0, len(data) - 1, CUTS).astype(int).tolist():
        (log / part if part else log).write_bytes(data[:size])
        found, lost = samples(log)
        count = len(found)
        least = max((number for end, number in parts if end <= size), default=0)
        if lost is None:  # what is told then is that the last number may be cut
            found[-1, -1] = whole[count - 1, -1]
        if (
            count < least
            or found.tobytes() != whole[:count].tobytes()
            or (count < len(whole) and lost is False and not ends_a_row(name, data[:size], ends))
        ):
            wrong.append((size, count, least, lost))
    assert wrong == []


@pytest.mark.parametrize("name", ["mcap-zstd.mcap", "bag-none.bag", "gyro.ulg", "small.csv",
                                  "rows.jsonl", "small.db3", "zstd.feather"])  # fmt: skip
def test_the_attitudes_of_a_cut_log_are_a_prefix_of_those_of_the_whole(logs, tmp_path, name):
    """As a CSV to the byte, the first line with the hash of the log aside."""
    data, outputs = (logs / name).read_bytes(), []
    for size in (len(data), *(len(data) * part // 10 for part in (9, 7, 5))):
        log, out = tmp_path / name, tmp_path / "out.csv"
        # A last line that may have lost digits is a sample of its own.
        log.write_bytes(data[: data.rfind(b"\n", 0, size) + 1] if is_text(name) else data[:size])
        result = CliRunner().invoke(cli, ["propagate", str(log), "-o", str(out)])
        assert result.exit_code in ({0} if size == len(data) else {0, 3})
        outputs.append(out.read_bytes().partition(b"\n")[2])
    assert all(outputs[0].startswith(part) for part in outputs[1:])
    assert 1000 < len(outputs[-1]) < len(outputs[0])


ESCAPES = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e"
"""Clears the screen, names the window, and turns the text around."""


def with_escapes(path):
    """Write a log whose every name holds terminal escapes, and rates of NaN."""
    if path.suffix == ".mcap":
        store = get_typestore(Stores.ROS2_HUMBLE)
        imu = imu_in(store)
        with path.open("wb") as file:
            writer = McapWriter(file)
            writer.start(ESCAPES, ESCAPES)
            definition = store.generate_msgdef("sensor_msgs/msg/Imu", ros_version=2)[0]
            schema = writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition.encode())
            for topic in (f"/imu{ESCAPES}", f"/other{ESCAPES}"):
                id_ = writer.register_channel(topic, "cdr", schema)
                for k in range(3):
                    data = bytes(store.serialize_cdr(imu(k), "sensor_msgs/msg/Imu"))
                    writer.add_message(id_, k, data, k)
            other = writer.register_schema(f"a/msg/{ESCAPES}", "ros2msg", ESCAPES.encode())
            writer.register_channel(f"/unknown{ESCAPES}", ESCAPES, other)
            writer.finish()
    elif path.suffix == ".bag":
        store = get_typestore(Stores.ROS1_NOETIC)
        imu = imu_in(store)
        with BagWriter(path) as writer:
            for topic in (f"/imu{ESCAPES}", f"/other{ESCAPES}"):
                one = writer.add_connection(topic, "sensor_msgs/msg/Imu", typestore=store)
                for k in range(3):
                    data = bytes(store.serialize_ros1(imu(k), "sensor_msgs/msg/Imu"))
                    writer.write(one, k, data)
    elif path.suffix == ".parquet":
        names = [ESCAPES, *(f"gyro_{axis}{ESCAPES}" for axis in "xyz")]
        parquet.write_table(pa.table({name: [1.0, np.nan] for name in names}), path)
    else:
        path.write_text(f"{ESCAPES},wx,wy,wz\n{ESCAPES},1,2,3\n1,{ESCAPES},2,3\n")


def imu_in(store):
    """Return a function that makes the message of a stamp."""
    types = store.types
    quaternion = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, np.nan)
    nine = np.zeros(9)

    def imu(k):
        stamp = types["builtin_interfaces/msg/Time"](0, k)
        header = types["std_msgs/msg/Header"]
        sequence = {"seq": 0} if "seq" in header.__dataclass_fields__ else {}
        made = header(stamp=stamp, frame_id=ESCAPES, **sequence)
        return types["sensor_msgs/msg/Imu"](made, quaternion, nine, vector, nine, vector, nine)

    return imu


@pytest.mark.parametrize("suffix", [".mcap", ".bag", ".parquet", ".csv"])
def test_escapes_in_a_log_never_reach_the_terminal(tmp_path, suffix):
    """Names of topics, types, frames and columns are shown with everything unprintable escaped."""
    log = tmp_path / f"log{suffix}"
    with_escapes(log)
    shown = []
    target = tmp_path / f"out{ESCAPES}.mcap"
    for command in (
        ["info", str(log)],
        ["info", "--json", str(log)],
        ["propagate", "-v", str(log), "-o", str(target)],
        ["propagate", "-v", str(log), "-o", str(target), "-t", f"/imu{ESCAPES}"],
        [
            *("propagate", "-v", str(log), "-o", str(target), "-t", f"/imu{ESCAPES}"),
            *("--on-nonfinite", "hold", "--q0", "log", "--message", "odometry"),
        ],
        ["propagate", str(log), "-o", str(target), "-t", ESCAPES],
        ["propagate", str(log), "-o", str(target), "--rate-field", ESCAPES],
        ["propagate", str(log), "-o", str(target), "--rate-cols", f"{ESCAPES},b,c"],
        ["convert", str(log), str(target)],
        ["compare", str(log), str(log)],
    ):
        result = CliRunner().invoke(cli, command)
        assert result.exception is None or isinstance(result.exception, SystemExit)
        shown.append(result.output)
    assert [text for text in shown if not text.replace("\n", "").isprintable()] == []
    assert "\\x1b[2J" in "".join(shown)


ROWS = 1234


@pytest.mark.parametrize("claimed", [ROWS + 1, 10_000_000, 1 << 40, 1 << 62, -1])
def test_feather_rows_that_are_not_there_are_not_read(tmp_path, claimed):
    """Rows that a batch claims beyond its bytes are a loss, not other memory of the process."""
    log = tmp_path / "log.feather"
    table = pa.table({name: np.arange(ROWS) * 1e-3 for name in ("wx", "wy", "wz")})
    table = table.append_column("t_ns", pa.array(range(ROWS)))
    feather.write_feather(table, log, compression="uncompressed")
    right, wrong = (value.to_bytes(8, "little", signed=True) for value in (ROWS, claimed))
    log.write_bytes(log.read_bytes().replace(right, wrong))
    found, lost = samples(log)
    assert (len(found), lost) == (0, True)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc to look at")
def test_no_memory_is_taken_for_the_length_at_the_end_of_a_cut_feather_file(tmp_path):
    """What stands where the length of the footer would be is no length."""
    log = tmp_path / "log.feather"
    table = pa.table({name: np.zeros(ROWS) for name in ("t_ns", "wx", "wy", "wz")})
    feather.write_feather(table, log, compression="uncompressed")
    log.write_bytes(log.read_bytes()[:-2000] + (0xF0000000).to_bytes(4, "little") + bytes(6))

    def address_space():
        status = Path("/proc/self/status").read_text()
        return int(re.search(r"VmSize:\s*(\d+) kB", status)[1])

    before = address_space()
    assert samples(log)[1]
    assert address_space() - before < 1_000_000


def test_feather_buffers_too_large_for_any_memory_are_a_loss(tmp_path):
    """A packed buffer that says it unpacks to 2**60 bytes is damage, told by its place."""
    log = tmp_path / "log.feather"
    table = pa.table({name: np.zeros(ROWS) for name in ("t_ns", "wx", "wy", "wz")})
    feather.write_feather(table, log, compression="zstd")
    size = (ROWS * 8).to_bytes(8, "little")
    log.write_bytes(log.read_bytes().replace(size, (1 << 60).to_bytes(8, "little")))
    with open_log(log) as opened:
        source = choose_rates(opened, RateSelection(time_unit="ns"))
        assert list(source.batches()) == []
        assert [loss.place for loss in opened.losses] == ["record batch 0"]


@pytest.mark.parametrize("write", [feather.write_feather, parquet.write_table])
def test_a_table_without_rows_has_no_samples(tmp_path, write):
    """An empty table is refused with a sentence, as an empty topic is."""
    log = tmp_path / "log"
    write(pa.table({name: np.zeros(0) for name in ("t_ns", "wx", "wy", "wz")}), str(log))
    result = CliRunner().invoke(cli, ["propagate", "--time-unit", "ns", str(log), "-o", "-"])
    assert result.exit_code == 2
    assert "no samples in" in result.output


def test_rates_near_the_largest_number_are_refused_without_a_warning(tmp_path):
    """Finite rates whose sum is not finite are told in a sentence, before which nothing warns."""
    log = tmp_path / "log.csv"
    log.write_text("t_ns,wx,wy,wz\n0,1e308,1e308,0\n1,0,0,0\n")
    result = CliRunner().invoke(cli, ["propagate", str(log), "-o", str(tmp_path / "out.csv")])
    assert result.exit_code == 2
    assert result.output == (
        f"Error: {log}: the attitude of sample 1 is not finite; rates must be finite, and their "
        "squares too; leave others out with --start and --end\n"
    )


LAUGHS = "".join(
    f"b{k}: &b{k} [{', '.join([f'*b{k - 1}' if k else 'ha'] * 9)}]\n" for k in range(12)
)
NAMED = "rosbag2_bagfile_information:\n  relative_file_paths: [small_ros2.db3]\n"
METADATA = {
    "aliases that unfold to 2 * 10**11 texts as a path": (
        f"{LAUGHS}rosbag2_bagfile_information:\n  relative_file_paths: [small_ros2.db3, *b11]\n"
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
def test_hostile_metadata_does_no_harm(logs, tmp_path, what):
    """Whatever metadata.yaml holds, the samples of the parts in the folder are read."""
    folder = tmp_path / "small_ros2"
    shutil.copytree(logs / "small_ros2", folder)
    (folder / "metadata.yaml").write_text(METADATA[what])
    assert len(samples(folder)[0]) == SAMPLES


def test_pipes_in_a_bag_folder_are_not_waited_for(logs, tmp_path):
    """A pipe under the name of the metadata or of a part is no file, and nothing waits for it."""
    folder = tmp_path / "small_ros2"
    shutil.copytree(logs / "small_ros2", folder)
    (folder / "metadata.yaml").unlink()
    for name in ("metadata.yaml", "small_ros2_1.db3"):
        os.mkfifo(folder / name)
    found, lost = samples(folder)
    assert (len(found), lost) == (SAMPLES, True)


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
    result = CliRunner().invoke(cli, ["propagate", str(log), "-o", "-"])
    assert result.exit_code == 2
    assert "several columns have the same name; by numbers from 0: 1-2-3, 4-2-3" in result.output
    assert "--rate-cols X,Y,Z" in result.output


def test_definitions_of_megabytes_are_not_parsed():
    """The grammar takes a minute for 200,000 fields; nobody waits for that."""
    schema = b"".join(b"float64 f%d\n" % k for k in range(200_000))
    channel = Channel("/imu", "a/msg/B", "cdr", "ros2msg", schema)
    reason = rf"topic '/imu': the definition of 'a/msg/B' has {len(schema)} bytes, over the limit"
    with pytest.raises(SchemaError, match=reason):
        message_type(channel, "log.mcap")
