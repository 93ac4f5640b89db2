"""`quatprop info`: rates and attitudes of logs, and what is missing to read them."""

import gc
import json
import subprocess
import sys
import weakref

import numpy as np
import pyarrow as pa
import pytest
from click.testing import CliRunner
from make.places import SAMPLE_LOGS
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from pyarrow import parquet as pq
from rosbags.typesys import Stores, get_typestore

from quatprop.cli.commands import cli
from quatprop.containers import first_blocks
from quatprop.containers.chunks import ChunkedLog
from quatprop.containers.first_blocks import FirstBlocks
from quatprop.containers.mcap.log import McapLog
from quatprop.errors import DamagedLogError
from quatprop.messages import protobuf
from quatprop.messages.blocks import MessageBlock
from quatprop.pipeline import plausibility, survey
from quatprop.series import AttitudeSeries
from quatprop.settings.spelling import in_options
from quatprop.text import Setting, in_python
from quatprop.writers import open_writer
from quatprop.writers.formats import WRITERS

HEADS = {
    "unit of the rates": "t_ns,gyro_x,gyro_y,gyro_z",
    "unit of the time": "t,wx_rad_s,wy_rad_s,wz_rad_s",
    "both": "t,wx,wy,wz",
}
RATE_UNIT, TIME_UNIT = Setting("rate_unit", "rad/s|deg/s"), Setting("time_unit", "s|ms|us|ns")
SAY = "is not declared; say it with "
MISSING = {
    "unit of the rates": f"the unit of the rates 'gyro_x', 'gyro_y', 'gyro_z' {SAY}{RATE_UNIT}",
    "unit of the time": f"the unit of the time 't' {SAY}{TIME_UNIT}",
    "both": "the unit of the rates 'wx', 'wy', 'wz' and the unit of the time 't' "
    f"are not declared; say them with {RATE_UNIT} and {TIME_UNIT}",
}


def info(*arguments, code=0):
    """Run `quatprop info --json` and return what it says, and its errors."""
    result = CliRunner().invoke(cli, ["info", "--json", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return json.loads(result.stdout), result.stderr


def text(*arguments, code=0):
    """Run `quatprop info` and return its lines."""
    result = CliRunner().invoke(cli, ["info", *map(str, arguments)])
    assert result.exit_code == code, result.output
    return result.stdout.splitlines()


def table(tmp_path, head, name="log.csv"):
    """Write five rows, 10 ms apart."""
    path = tmp_path / name
    columns = head.count(",")
    rows = [",".join([str(10_000_000 * k), *["0.5"] * columns]) for k in range(5)]
    path.write_text("\n".join([head, *rows]) + "\n")
    return path


@pytest.mark.parametrize("unknown", HEADS)
def test_a_table_whose_units_are_unknown_is_shown(tmp_path, unknown):
    """What can be counted is, what cannot is left open, and the option that is missing is named."""
    path, sentence = table(tmp_path, HEADS[unknown]), MISSING[unknown]
    ((log,), errors) = info(path)
    (source,) = log["sources"]
    assert errors == ""
    assert source["missing"] == in_python(sentence)
    assert source["samples"] == 5
    timed = unknown == "unit of the rates"
    assert (source["rate_hz"], source["span_s"]) == ((100.0, 0.04) if timed else (None, None))
    rated = unknown == "unit of the time"
    assert (source["max_rate_rad_s"] is not None) == rated
    assert (source["rate_unit"] is not None) == rated
    assert text(path)[-1] == f"  {source['source']}: {in_options(sentence)}"


def test_a_column_that_is_not_told_is_asked_for(tmp_path):
    """Where even the time is ambiguous, the sentence stands alone."""
    path = table(tmp_path, "a,b,wx,wy,wz")
    ((log,), _) = info(path)
    (source,) = log["sources"]
    assert source["samples"] is None
    assert source["missing"] == (
        "the time column (one of 'a', 'b') is not declared; say it with "
        "time_col='C', or sample_rate='HZ' for rows at a steady rate"
    )


def test_attitudes_of_a_table_are_listed(tmp_path):
    """Type, layout, count and rate; rows that are no rotation are counted and located."""
    path = tmp_path / "log.csv"
    path.write_text("t_ns,qx,qy,qz,qw\n0,0,0,0,1\n10000000,0,0,0,0\n20000000,nan,0,0,0\n")
    ((log,), _) = info(path)
    assert log["sources"] == []
    (source,) = log["attitudes"]
    assert {key: source[key] for key in ("source", "type", "layout", "convention", "direction",
                                         "samples", "rate_hz", "invalid", "missing")} == {
        "source": "qx,qy,qz,qw", "type": "quatprop", "layout": "scalar-last",
        "convention": "hamilton", "direction": "body-to-ref", "samples": 3, "rate_hz": 100.0,
        "invalid": 2, "missing": None,
    }  # fmt: skip
    (remark,) = source["remarks"]
    assert remark == (
        "2 of 3 rows are invalid quaternions (1 all zero, 1 absent or not finite), the first is "
        "row 1 at 10000000 ns"
    )
    assert text(path)[1].split() == ["attitudes", "type", "samples", "Hz", "span", "s", "gaps",
                                     "dup", "back", "invalid", "layout"]  # fmt: skip


@pytest.mark.parametrize("name", ["out.parquet", "out.mcap", "out.npz"])
def test_how_attitudes_were_made_is_shown(tmp_path, name):
    """Log, method and first attitude, as their file says, and in what terms they are stored."""
    path, log = tmp_path / name, SAMPLE_LOGS / "coning.mcap"
    arguments = ["propagate", log, "-o", path, "--method", "mean", "--q0", "0.6,0,0,0.8"]
    assert CliRunner().invoke(cli, list(map(str, arguments))).exit_code == 0
    (source,) = info(path)[0][0]["attitudes"]
    assert (source["method"], source["made_from"]) == ("mean", str(log))
    assert source["q0_wxyz"] == pytest.approx([0.6, 0.0, 0.0, 0.8], abs=1e-15)
    said = f"from {log}, method mean, q0 0.6,0,0,0.8 (wxyz), stored as hamilton body-to-ref"
    assert text(path)[-1] == f"  {source['source']}: {said}"


@pytest.mark.parametrize("metadata", ["[]", '{"convention": 3, "source": {"path": [1]}}',
                                      '{"convention": {"q0_wxyz": ["a", 1, 2, 3]}}'])  # fmt: skip
def test_what_others_write_as_metadata_does_no_harm(tmp_path, metadata):
    """It is left out, or refused in a sentence."""
    path = tmp_path / "a.parquet"
    columns = {
        name: pa.array([0.0 if name != "qw" else 1.0] * 2) for name in ("qw", "qx", "qy", "qz")
    }
    rows = pa.table({"t_ns": pa.array([0, 10], pa.int64()), **columns})
    pq.write_table(rows.replace_schema_metadata({"quatprop": metadata}), path)
    result = CliRunner().invoke(cli, ["info", str(path)])
    assert result.exit_code in {0, 2}
    assert isinstance(result.exception, SystemExit | None)
    assert "stored as" not in result.output


def test_the_time_of_attitudes_may_be_unknown_too(tmp_path):
    """They are counted, and the option is named."""
    ((log,), _) = info(table(tmp_path, "time,qw,qx,qy,qz"))
    (source,) = log["attitudes"]
    assert (source["samples"], source["rate_hz"]) == (5, None)
    assert (
        "the unit of the time 'time' is not declared; say it with time_unit=" in source["missing"]
    )


def test_several_quaternions_are_not_guessed_between(tmp_path):
    """The sentence says which there are, and the option that chooses."""
    ((log,), _) = info(table(tmp_path, "t_ns,a_qw,a_qx,a_qy,a_qz,b_qw,b_qx,b_qy,b_qz"))
    (source,) = log["attitudes"]
    assert source["missing"] == (
        "which quaternion to use (their scalar columns are 'a_qw', 'b_qw') is not declared; say "
        "it with quat_cols='A,B,C,D'"
    )


@pytest.mark.parametrize("kind", [kind for kind in WRITERS if kind != "kitti"])
def test_every_kind_that_is_written_is_described(tmp_path, kind):
    """The layout is that of the file, the rate that of its stamps."""
    path = tmp_path / "attitude"
    wxyz = np.tile([1.0, 0, 0, 0], (11, 1))
    with open_writer(path, kind) as writer:
        writer.write(AttitudeSeries(np.arange(11) * 5_000_000, wxyz))
        writer.commit({})
    ((log,), _) = info(path)
    (source,) = log["attitudes"]
    layout = "scalar-last" if WRITERS[kind].layout == "scalar-last" else "scalar-first"
    assert (source["layout"], source["samples"], source["rate_hz"]) == (layout, 11, 200.0)


def test_one_log_that_cannot_be_read_hides_no_other(tmp_path):
    """Neither what is damaged nor what holds nothing of use; each has its sentence."""
    good, other = table(tmp_path, "t_ns,wx,wy,wz"), table(tmp_path, "t_ns,qw,qx,qy,qz", "q.csv")
    bad, empty = tmp_path / "bad.mcap", table(tmp_path, "t_ns,a,b", "nothing.csv")
    bad.write_bytes(b"\x89MCAP0\r\n" + bytes(20))
    logs, errors = info(good, bad, empty, other, tmp_path / "none.bag", code=2)
    assert [log["path"] for log in logs] == [str(good), str(other)]
    assert [line.split(":")[1].strip() for line in errors.splitlines()] == [
        str(bad), str(empty), str(tmp_path / "none.bag"),
    ]  # fmt: skip


def test_options_about_rates_hide_attitudes(tmp_path):
    """Who names columns of rates wants to see those, and is told when they are not there."""
    path = table(tmp_path, "t_ns,wx,wy,wz,qw,qx,qy,qz")
    assert [len(info(path)[0][0][key]) for key in ("sources", "attitudes")] == [1, 1]
    ((log,), _) = info(path, "--rate-cols", "wx,wy,wz", "--rate-unit", "deg/s")
    assert (len(log["sources"]), log["attitudes"]) == (1, [])
    _, errors = info(path, "--rate-cols", "a,b,c", code=2)
    assert "--rate-cols asks for column 'a'" in errors


def test_stdin_is_read_once():
    """Rates are looked at; attitudes where there are no rates."""
    for head, key in (("t_ns,wx,wy,wz", "sources"), ("t_ns,qw,qx,qy,qz", "attitudes")):
        rows = "".join(f"{k}{',0.5' * head.count(',')}\n" for k in range(3))
        result = CliRunner().invoke(cli, ["info", "--json", "-"], input=f"{head}\n{rows}")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)[0][key][0]["samples"] == 3


def test_attitude_topics_of_a_recording_are_listed(shared_logs):
    """A real bag: an Imu without orientation, and the poses of a motion capture."""
    ((log,), _) = info(shared_logs / "auk" / "auk.bag")
    found = {one["source"]: one for one in log["attitudes"]}
    assert found["/vicon/auk/auk"]["samples"] == 11161
    assert found["/vicon/auk/auk"]["layout"] == "scalar-last"
    assert {one["source"] for one in log["sources"]} <= {*found}


def test_an_orientation_that_no_message_has_is_not_listed():
    """A gyroscope without an estimate marks every orientation as absent: there are none."""
    (facts,), _ = info(SAMPLE_LOGS / "tumbling.bag")
    assert [one["source"] for one in facts["sources"]] == ["/imu"]
    assert facts["attitudes"] == []


def test_a_topic_that_needs_an_extra_does_not_hide_the_others(tmp_path, monkeypatch):
    """What cannot be read here is said, with the way out, beside what can."""
    copy = tmp_path / "copy.mcap"
    into = ["propagate", str(SAMPLE_LOGS / "coning.mcap"), "--into", str(copy), "-q"]
    assert CliRunner().invoke(cli, [*into, "--message", "FrameTransform"]).exit_code == 0
    monkeypatch.setitem(sys.modules, "google.protobuf", None)
    protobuf._message_class.cache_clear()  # noqa: SLF001  # others may have filled it
    (facts,), _ = info(copy)
    assert [one["source"] for one in facts["sources"]] == ["/imu"]
    ((said,),) = [[one["missing"]] for one in facts["attitudes"]]
    assert "is encoded as protobuf, which needs the package protobuf" in said
    alone = tmp_path / "alone.mcap"
    out = ["propagate", str(SAMPLE_LOGS / "coning.mcap"), "-o", str(alone), "-q"]
    assert CliRunner().invoke(cli, [*out, "--message", "FrameTransform"]).exit_code == 0
    lines = text(alone)
    assert lines[3].startswith(
        f"  /tf: from {SAMPLE_LOGS / 'coning.mcap'}, method start, q0 1,0,0,0 "
    )
    assert lines[3].endswith(", stored as hamilton body-to-ref")


def test_a_topic_of_several_transforms_is_said_in_one_sentence(shared_logs):
    """The sentence stands under the log's name and does not repeat it."""
    log = shared_logs / "irregular" / "tilt_laser.bag"
    assert text(log)[-1].endswith("; choose one with --frame PARENT:CHILD of quatprop convert")
    (facts,), _ = info(log)
    (said,) = [one["missing"] for one in facts["attitudes"] if one["source"] == "/tf"]
    assert str(said).startswith("topic '/tf' has several transforms: '/tilt_axis:/camera', ")


def test_a_topic_without_transforms_is_said_to_be_so(tmp_path):
    """`info` sent who looked at an empty /tf_static to `info`."""
    log, kind = tmp_path / "log.mcap", "tf2_msgs/msg/TFMessage"
    store = get_typestore(Stores.LATEST)
    with log.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        definition, _ = store.generate_msgdef(kind, ros_version=2)
        schema = writer.register_schema(kind, "ros2msg", definition.encode())
        channel = writer.register_channel("/tf_static", "cdr", schema)
        data = bytes(store.serialize_cdr(store.types[kind]([]), kind))
        writer.add_message(channel, 1, data, 1)
        writer.finish()
    said = "the messages of topic '/tf_static' hold no transforms; choose another "
    assert text(log)[-1] == f"  /tf_static: {said}--topic"
    (facts,), _ = info(log)
    assert facts["attitudes"][0]["missing"] == f"{said}topic"
    result = CliRunner().invoke(cli, ["convert", str(log), str(tmp_path / "out.csv")])
    assert (result.exit_code, result.stderr) == (2, f"Error: {log}: {said}--topic\n")


def test_a_binary_log_on_stdin_is_listed_whole():
    """It was copied, so attitudes are looked for, too; text is read once, which is reported."""
    command = [sys.executable, "-m", "quatprop", "info", "--json", "-"]
    with (SAMPLE_LOGS / "tumbling.bag").open("rb") as bag:
        piped = subprocess.run(command, stdin=bag, capture_output=True, check=True)
    (log,), _ = info(SAMPLE_LOGS / "tumbling.bag")
    (copied,) = json.loads(piped.stdout)
    assert {**copied, "path": log["path"]} == log
    with (SAMPLE_LOGS / "spin.csv").open("rb") as rows:
        piped = subprocess.run(command, stdin=rows, capture_output=True, check=True)
    (copied,) = json.loads(piped.stdout)
    assert (
        "text on stdin is read only once: attitudes were not looked for"
        in (copied["sources"][0]["remarks"])
    )


@pytest.mark.parametrize(
    ("room", "apart_whole"), [(1 << 21, [8000] * 2), (1 << 23, [8000])], ids=["long", "short"]
)
def test_rates_and_attitudes_of_a_topic_are_read_together(tmp_path, monkeypatch, room, apart_whole):
    """A log is read once, and what is said of it is what reading each by itself shows."""
    monkeypatch.setattr(plausibility, "COMPARED_SAMPLES", 10)
    monkeypatch.setattr(first_blocks, "ROOM", room)
    monkeypatch.setattr(first_blocks, "ENOUGH_MESSAGES", 2000)
    log = tmp_path / "log.mcap"
    with log.open("wb") as file, (SAMPLE_LOGS / "coning.mcap").open("rb") as stream:
        (schema, channel, message), *_ = make_reader(stream).iter_messages()
        writer = Writer(file, chunk_size=20_000, compression=CompressionType.ZSTD)
        writer.start("ros2")
        own = writer.register_schema(schema.name, schema.encoding, schema.data)
        ids = writer.register_channel(channel.topic, channel.message_encoding, own)
        for k in range(8000):
            t_ns = (k + 1) * 10_000_000
            stamp = np.array(divmod(t_ns, 10**9), "<i4").tobytes()
            data = message.data[:4] + stamp + message.data[12:]
            writer.add_message(ids, t_ns, data, t_ns)
        writer.finish()
    read, original = [], McapLog.blocks

    def blocks(self, channel):
        count = 0
        for block in original(self, channel):
            count += len(block)
            yield block
        read.append(count)

    monkeypatch.setattr(McapLog, "blocks", blocks)
    (surveyed,), _ = info(log)
    assert read == [8000]
    (rates,) = surveyed["sources"]
    assert (rates["samples"], rates["gaps"], rates["backwards"]) == (8000, 0, 0)
    monkeypatch.setattr(survey, "_reading_beside", lambda *_: None)
    (apart,), _ = info(log)
    assert read == [8000, *apart_whole]
    assert apart == surveyed


def test_a_log_is_unpacked_once_for_each_topic(shared_logs, monkeypatch):
    """Whatever is looked for in a topic, its messages are unpacked once if they are few."""
    read, original = [], ChunkedLog.blocks
    monkeypatch.setattr(
        ChunkedLog, "blocks", lambda log, channel: read.append(channel) or original(log, channel)
    )
    (surveyed,), _ = info(shared_logs / "two_imus" / "test1_2014_xsens.bag")
    assert len(surveyed["sources"]) == len(surveyed["attitudes"]) == len(read) == len(set(read))


def test_a_long_topic_is_not_kept(monkeypatch):
    """Once there is no room for a topic, nothing of it is held, by whoever reads on either."""
    monkeypatch.setattr(first_blocks, "ROOM", 1000)
    freed = []

    class Long:
        def blocks(self, _channel):
            for _ in range(100):
                data = np.zeros(100, np.uint8)
                weakref.finalize(data, freed.append, None)
                yield MessageBlock(data, *(np.zeros(0, np.int64) for _ in range(4)))

    blocks = FirstBlocks(Long(), "topic")
    held = [number - len(freed) for number, _ in enumerate(blocks)]
    assert max(held) < 15  # ten have room


def test_an_error_is_not_taken_for_the_end_of_a_topic():
    """Who begins to read a topic after another met an error in it meets the error too."""

    class Broken:
        def blocks(self, _channel):
            yield MessageBlock(*(np.zeros(0, np.int64) for _ in range(5)))
            raise DamagedLogError("log", "broken")

    blocks = FirstBlocks(Broken(), "topic")
    for _ in range(2):
        with pytest.raises(DamagedLogError, match=r"^log: broken"):
            list(blocks)


def test_what_was_held_is_read_on_after_its_release():
    """Who began before and goes on after it reads nothing twice, and holds nothing."""
    read = []

    class Long:
        def blocks(self, _channel):
            for begin in range(50):
                data = np.zeros(1000, np.uint8)
                read.append(weakref.ref(data))
                stamps = np.array([begin])
                yield MessageBlock(data, np.array([0]), np.array([1000]), stamps, stamps)

    first = FirstBlocks(Long(), "topic")
    next(iter(first))
    blocks = iter(first)
    first.release()
    assert [int(block.log_ns[0]) for block in blocks] == list(range(50))
    assert len(read) == 50
    assert sum(data() is not None for data in read) <= 2


def test_a_reading_that_nobody_goes_on_with_ends_at_once():
    """Its threads are not left to the garbage collector, which may run in one of them."""
    closed = []

    class Long:
        def blocks(self, _channel):
            try:
                for _ in range(50):
                    yield MessageBlock(*(np.zeros(0, np.int64) for _ in range(5)))
            finally:
                closed.append(None)

    gc.disable()
    try:
        blocks = FirstBlocks(Long(), "topic")
        next(iter(blocks))
        blocks.release()
        assert closed
    finally:
        gc.enable()
