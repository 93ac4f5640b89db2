"""Copies of ROS 1 bags: what is particular to the container, and damage."""

import re

import numpy as np
import pytest
from make.bag_doctor import examine_bag
from make.commands import refused, run
from make.into_logs import IMU, imu_message, moments, write_bag
from make.ros import ROS1
from rosbags.rosbag1 import Reader, Writer

from quatprop.kinematics.series import AttitudeSeries
from quatprop.readers.open_log import open_log
from quatprop.writers.into import open_into

PACKED = Writer.CompressionFormat
SECOND = 1_000_000_000


def edges(spans):
    """Return where readers see a bag begin and end: in the first and in the last chunk."""
    return spans[0][0], spans[-1][1]


def sent(path):
    """Return all messages but those that were added, in order of time; the bag is whole."""
    messages, _ = examine_bag(path)
    return sorted(message for message in messages if message[0] != "/attitude")


ORDERS = {
    "rising": range(40),
    "falling": range(39, -1, -1),
    "latest before earliest": [*range(20, 40), *range(20)],
}


@pytest.mark.parametrize("compression", [None, PACKED.LZ4, PACKED.BZ2])
@pytest.mark.parametrize("chunk_size", [3_000, 1_000_000])
@pytest.mark.parametrize("order", ORDERS)
def test_a_bag_keeps_its_start_and_end(tmp_path, order, chunk_size, compression):
    """Readers take them from the first and the last chunk, and other topics last longer."""
    log, out = tmp_path / "log.bag", tmp_path / "out.bag"
    times = list(moments(40))
    writer = Writer(log)
    writer.chunk_threshold = chunk_size
    if compression:
        writer.set_compression(compression)
    with writer:
        imu = writer.add_connection("/imu", IMU, typestore=ROS1)
        text = writer.add_connection("/text", "std_msgs/msg/String", typestore=ROS1)
        writer.write(text, times[0][1] - 5 * SECOND, bytes(4))
        for number in ORDERS[order]:
            stamp, logged = times[number]
            writer.write(imu, logged, imu_message(ROS1, stamp))
        for k in range(90):
            writer.write(text, times[-1][1] + (k + 1) * SECOND, bytes(4))
    run("propagate", log, "--into", out, "-q", "--on-backwards", "sort", code=0)
    assert sent(out) == sent(log)
    first, last = times[0][1] - 5 * SECOND, times[-1][1] + 90 * SECOND
    assert edges(examine_bag(out)[1]) == (first, last)
    with Reader(out) as reader:
        assert (reader.start_time, reader.end_time) == (first, last + 1)
        assert reader.message_count == 40 + 91 + 40


@pytest.mark.parametrize("name", ["plain", "packed"])
def test_cut_off_bags_give_what_is_left_of_them(tmp_path, name):
    """At any cut the copy is whole and has what our reader finds in the bag: exit 3."""
    compression = PACKED.LZ4 if name == "packed" else None
    log = write_bag(tmp_path / "log.bag", count=120, compression=compression)
    data, out, whole = log.read_bytes(), tmp_path / "out.bag", examine_bag(log)[0]
    for cut in np.linspace(len(data) // 2, len(data) - 1, 10).astype(int):
        log.write_bytes(data[:cut])
        assert run("propagate", log, "--into", out, "-q").exit_code in {0, 3}
        with open_log(log) as opened:
            left = {c.topic: sum(map(len, opened.blocks(c))) for c in opened.channels()}
        messages = examine_bag(out)[0]
        topics = [topic for topic, *_ in messages]
        assert {topic: topics.count(topic) for topic in left} == left
        kept = [message for message in messages if message[0] != "/attitude"]
        assert kept == whole[: len(kept)]
        assert topics.count("/attitude") == left["/imu"]


@pytest.mark.parametrize(("place", "harm"), [(3, b"\x09"), (34, b"\xff\xff\xff\x7f")])
@pytest.mark.parametrize("chunk_size", [4_000, 1_000_000])
def test_a_damaged_message_costs_itself(tmp_path, chunk_size, place, harm):
    """Of a bag of one chunk the copy lacked all messages behind one of no kind or wrong length."""
    log, out = write_bag(tmp_path / "log.bag", chunk_size=chunk_size), tmp_path / "out.bag"
    whole, data = examine_bag(log)[0], bytearray(log.read_bytes())
    at = [found.start() for found in re.finditer(rb"op=\x02", data)][50] + place
    data[at : at + len(harm)] = harm
    log.write_bytes(data)
    run("propagate", log, "--into", out, "-q", code=3)
    with open_log(out) as opened:
        counts = {c.topic: sum(map(len, opened.blocks(c))) for c in opened.channels()}
    assert whole[50][0] == "/imu"
    assert counts == {"/imu": 299, "/shutter": 30, "/attitude": 299}
    if chunk_size > 4_000:
        assert sent(out) == sorted(whole[:50] + whole[51:])


def test_a_chunk_whose_head_is_lost_is_left_out(tmp_path):
    """What is packed in it cannot be found; the others are kept."""
    log, out = write_bag(tmp_path / "log.bag", compression=PACKED.LZ4), tmp_path / "out.bag"
    whole, data = sent(log), bytearray(log.read_bytes())
    with Reader(log) as reader:
        place = reader.chunk_infos[3].pos
        lost = sum(reader.chunk_infos[3].connection_counts.values())
    data[place : place + 8] = bytes(8)
    log.write_bytes(data)
    run("propagate", log, "--into", out, "-q", code=3)
    kept = sent(out)
    assert {*kept} < {*whole}
    assert len(kept) == len(whole) - lost


def test_a_bag_of_topics_without_messages_may_be_added_to(tmp_path):
    """Its only chunk has no place between messages where it could be split."""
    log, out = write_bag(tmp_path / "log.bag", count=0), tmp_path / "out.bag"
    with open_log(log) as opened, open_into(opened, str(out)) as writer:
        assert len(opened.index.chunks) == 1
        writer.write(AttitudeSeries(np.arange(9), np.eye(4)[[0] * 9]))
        writer.commit({})
    with Reader(out) as reader:
        counts = {name: topic.msgcount for name, topic in reader.topics.items()}
    assert counts == {"/imu": 0, "/shutter": 0, "/attitude": 9}


def test_nothing_is_added_to_joined_bags(tmp_path):
    """A copy has one set of numbers for all its connections."""
    log = write_bag(tmp_path / "log.bag")
    log.write_bytes(2 * log.read_bytes())
    target = tmp_path / "copy.bag"
    assert refused("propagate", log, "--into", target, "--on-backwards", "drop") == (
        f"Error: {log}: several bags are joined in it, and nothing can be added to them; write the "
        "attitudes to a file of their own with --output"
    )
    assert not target.exists()
