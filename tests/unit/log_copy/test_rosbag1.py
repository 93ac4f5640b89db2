"""Copies of ROS 1 bags with attitudes added: everything else is kept."""

import numpy as np
import pytest
from make.into_logs import IMU, RATE, imu_message, moments, run, write_bag
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from quatprop.containers.rosbag1.records import RecordFile, index_data, walked_records
from quatprop.logs.open_log import open_log
from quatprop.stores.file_source import FileSource

STORE = get_typestore(Stores.ROS1_NOETIC)
Form = Writer.CompressionFormat


def content(path):
    """Return the connections of a bag, and its messages in order of time."""
    with Reader(path) as reader:
        connections = {
            c.topic: (
                c.msgtype, c.msgdef.data, c.digest, c.ext.callerid, c.ext.latching, c.msgcount,
            )
            for c in reader.connections
        }  # fmt: skip
        messages = [(c.topic, logged, bytes(data)) for c, logged, data in reader.messages()]
    return connections, messages


def attitudes(path, topic="/attitude"):
    """Return stamps, log times and wxyz of what was added."""
    found = []
    for name, logged, data in content(path)[1]:
        if name == topic:
            message = STORE.deserialize_ros1(data, "geometry_msgs/msg/QuaternionStamped")
            stamp, q = message.header.stamp, message.quaternion
            found.append((stamp.sec * 10**9 + stamp.nanosec, logged, (q.w, q.x, q.y, q.z)))
    return found


@pytest.mark.parametrize("compression", [None, Form.BZ2, Form.LZ4])
def test_everything_else_is_kept(tmp_path, compression):
    """Connections with all that is told of them, and messages, whatever they are packed in."""
    log = write_bag(tmp_path / "log.bag", compression=compression)
    out = tmp_path / "out.bag"
    result = run("propagate", log, "--into", out, "-q")
    assert (result.exit_code, result.output) == (0, "")
    (connections, messages), (before, sent) = content(out), content(log)
    assert connections.pop("/attitude")[0] == "geometry_msgs/msg/QuaternionStamped"
    assert connections == before
    assert [message for message in messages if message[0] != "/attitude"] == sent
    found = attitudes(out)
    assert [(stamp, logged) for stamp, logged, _ in found] == list(moments(300))
    half = RATE * 0.01 * np.arange(300) / 2
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    np.testing.assert_allclose([wxyz for *_, wxyz in found], expected, atol=1e-14)


def test_chunks_stand_in_order_of_time_and_the_index_tells_them(tmp_path):
    """Every record is where the index says, and has what index data and chunk info say."""
    log, out = write_bag(tmp_path / "log.bag", count=12_000), tmp_path / "out.bag"
    assert run("propagate", log, "--into", out, "-q").exit_code == 0
    starts = []
    with FileSource(out) as source:
        file = RecordFile(source)
        header = file.record(13)
        at, index = header.end, header.number(b"index_pos", 8)
        places = {}
        while at < index:
            record = file.record(at)
            if record.op == 5:
                places[at] = {}
                chunk = np.frombuffer(file.at(record.data, record.end - record.data), np.uint8)
                inside = {r.start: r for r in walked_records(chunk) if r.op == 2}
                latest = at
            else:
                (conn, entries), *_ = index_data(file.at(at, record.end - at))[0].items()
                times = [int(e["sec"]) * 10**9 + int(e["nsec"]) for e in entries]
                places[latest][conn] = times
                for entry, time in zip(entries, times, strict=True):
                    message = inside.pop(int(entry["offset"]))
                    assert (message.number(b"conn"), message.time(b"time")) == (conn, time)
                assert times == sorted(times)
            at = record.end
        assert at == index
        infos = connections = 0
        while at < file.size:
            record = file.record(at)
            connections += record.op == 7
            if record.op == 6:
                infos += 1
                told = places[record.number(b"chunk_pos", 8)]
                every = [time for times in told.values() for time in times]
                assert record.time(b"start_time") == min(every)
                assert record.time(b"end_time") == max(every)
                counts = np.frombuffer(file.at(record.data, record.end - record.data), "<u4")
                assert dict(counts.reshape(-1, 2).tolist()) == {k: len(v) for k, v in told.items()}
                starts.append((record.number(b"chunk_pos", 8), min(every)))
            at = record.end
        assert (connections, infos) == (
            header.number(b"conn_count"), header.number(b"chunk_count"),
        )  # fmt: skip
    assert infos == len(places)
    in_file = [start for _, start in sorted(starts)]
    assert in_file == sorted(in_file)


def test_messages_of_foxglove_are_refused(tmp_path):
    """A bag holds messages of ROS."""
    log = write_bag(tmp_path / "log.bag")
    result = run("propagate", log, "--into", tmp_path / "out.bag", "--message", "PoseInFrame")
    assert result.exit_code == 2
    assert "'PoseInFrame' is Foxglove's own, in protobuf" in result.stderr
    assert list(tmp_path.iterdir()) == [log]


def test_each_topic_has_its_own_provenance(tmp_path):
    """What was added first keeps what was told of it."""
    log = write_bag(tmp_path / "log.bag")
    first, second = tmp_path / "first.bag", tmp_path / "second.bag"
    assert run("propagate", log, "--into", first, "-q").exit_code == 0
    options = ("--method", "coning", "--out-topic", "/coning", "-q")
    assert run("propagate", first, "--into", second, *options).exit_code == 0
    with open_log(second) as opened:
        methods = [opened.provenance(t)["convention"]["method"] for t in ("/attitude", "/coning")]
    assert methods == ["start", "coning"]


@pytest.mark.parametrize("compression", [None, Form.LZ4])
def test_cut_off_bags_give_what_is_left_of_them(tmp_path, compression):
    """At any cut the copy is whole and has what our reader finds in the bag: exit 3."""
    log = write_bag(tmp_path / "log.bag", count=120, compression=compression)
    data, out = log.read_bytes(), tmp_path / "out.bag"
    whole = content(log)[1]
    for cut in np.linspace(len(data) // 2, len(data) - 1, 20).astype(int):
        log.write_bytes(data[:cut])
        result = run("propagate", log, "--into", out, "-q")
        assert result.exit_code in {0, 3}
        with open_log(log) as opened:
            left = {c.topic: sum(map(len, opened.blocks(c))) for c in opened.channels()}
        connections, messages = content(out)
        assert {t: told[-1] for t, told in connections.items() if t != "/attitude"} == left
        kept = [message for message in messages if message[0] != "/attitude"]
        assert kept == whole[: len(kept)]
        assert connections["/attitude"][-1] == left["/imu"]
        out.unlink()


def test_attitudes_of_the_bag_are_converted_into_it(tmp_path):
    """The other command adds what it reads."""
    log, out = write_bag(tmp_path / "log.bag"), tmp_path / "out.bag"
    assert run("convert", log, "--into", out, "-q").exit_code == 0
    assert {wxyz for *_, wxyz in attitudes(out)} == {(0.8, 0.0, 0.0, 0.6)}


@pytest.mark.parametrize("order", ["rising", "falling", "latest before earliest"])
def test_a_bag_of_one_chunk_keeps_its_start_and_end(tmp_path, order):
    """Readers take them from the first and the last chunk of the index."""
    log, out = tmp_path / "log.bag", tmp_path / "out.bag"
    numbers = list(range(40))
    if order == "falling":
        numbers.reverse()
    elif order == "latest before earliest":
        numbers = [*range(20, 40), *range(20)]
    times = list(moments(40))
    with Writer(log) as writer:
        connection = writer.add_connection("/imu", IMU, typestore=STORE)
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=STORE)
        # Other topics begin earlier and end later than the rates.
        edge = {numbers.index(0): times[0][1] - 10**9, numbers.index(39): times[39][1] + 10**9}
        for place, number in enumerate(numbers):
            if place in edge:
                writer.write(text, edge[place], bytes(4))
            stamp, logged = times[number]
            writer.write(connection, logged, imu_message(STORE, stamp, ros1=True))
    with Reader(log) as reader:
        assert len(reader.chunk_infos) == 1
    result = run("propagate", log, "--into", out, "-q")
    assert result.exit_code == 0
    with Reader(log) as before, Reader(out) as after:
        assert after.chunk_infos[0].start_time == before.start_time
        assert after.chunk_infos[-1].end_time == before.end_time
        assert (after.start_time, after.end_time) == (before.start_time, before.end_time)
    others = [message for message in content(out)[1] if message[0] != "/attitude"]
    assert others == content(log)[1]
    assert len(attitudes(out)) == 40


def test_nothing_is_added_to_joined_bags(tmp_path):
    """A copy has one set of numbers for all its connections."""
    log = write_bag(tmp_path / "log.bag")
    log.write_bytes(2 * log.read_bytes())
    target = tmp_path / "copy.bag"
    result = run("propagate", log, "--into", target, "--on-backwards", "drop")
    assert (result.exit_code, target.exists()) == (2, False)
    assert result.stderr == (
        f"Error: {log}: several bags are joined in it, and nothing can be added to them; write the "
        "attitudes to a file of their own with --output\n"
    )
