"""A topic in the name of a log, ``LOG:TOPIC``, wherever a command reads a log."""

import json
import ntpath
import os
from pathlib import Path

import numpy as np
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages
from make.tables import write_attitudes

import quatprop
from quatprop.kinematics.quaternion import exp
from quatprop.stores.objects import split_topic

STAMPS = [10**9 + 10_000_000 * k for k in range(40)]
RATES = {"/imu/left": 0.25, "/imu/right": 0.5}


def turn(rate, stamps):
    """Return attitudes that turn about z, rate in rad/s."""
    return exp(np.outer(rate * 1e-9 * (np.array(stamps) - stamps[0]), [0, 0, 1]))


def two_imus(path, stamps=STAMPS):
    """Write a log of two Imu topics that turn about z at their own rates; return it."""
    messages = [
        (topic, *message[1:])
        for topic, rate in RATES.items()
        for message in imu_messages(stamps, [(0, 0, rate)] * len(stamps), turn(rate, stamps))
    ]
    return write_messages(path, sorted(messages, key=lambda one: one[2]))


@pytest.fixture(autouse=True)
def log(tmp_path, monkeypatch):
    """Write ``log.bag`` into the current folder."""
    monkeypatch.chdir(tmp_path)
    return two_imus(tmp_path / "log.bag")


@pytest.mark.parametrize("topic", ["/imu/left", "pose"])
def test_the_initial_attitude_of_a_topic(topic):
    """A topic needs no slash, as in a ULog."""
    messages = imu_messages(STAMPS, [(0, 0, 1.0)] * len(STAMPS), turn(1.0, STAMPS))
    write_messages(Path("other.bag"), [(topic, *message[1:]) for message in messages])
    made = quatprop.propagate("log.bag", topic="/imu/left", q0=f"other.bag:{topic}")
    assert made.report.convention.q0_from == f"other.bag:{topic}"


@pytest.mark.parametrize(
    ("name", "path", "topic"),
    [
        ("log.bag", "log.bag", None),
        ("log.bag:/imu/left", "log.bag", "/imu/left"),
        ("log.bag:vehicle_attitude", "log.bag", "vehicle_attitude"),
        ("log.bag:ns:imu", "log.bag", "ns:imu"),
        ("log.bag:", "log.bag:", None),
        ("12:30.bag:/imu", "12:30.bag", "/imu"),
        ("log.bag:copy", "log.bag:copy", None),
        (":/imu", ":/imu", None),
        ("none.bag:/imu", "none.bag:/imu", None),
        ("C:\\log.bag", "C:\\log.bag", None),
        (f"{'x' * 999}:/imu", f"{'x' * 999}:/imu", None),
        ("s3://bucket/2026-11-23T10:00:00.mcap", "s3://bucket/2026-11-23T10:00:00.mcap", None),
        (
            "s3://bucket/log.mcap?endpoint_override=http://localhost:9000",
            "s3://bucket/log.mcap?endpoint_override=http://localhost:9000",
            None,
        ),
    ],
)
def test_a_name_is_split_after_a_file_that_is_there(tmp_path, name, path, topic):
    """A file that has the whole name wins; colons in names, drives and ports are not taken."""
    for made in ("12:30.bag", "log.bag:copy"):
        (tmp_path / made).write_bytes(b"")
    assert split_topic(name) == (path, topic)


def test_the_letter_of_a_drive_is_no_file(tmp_path, monkeypatch):
    """On Windows, a file `C` next to it made a topic of the rest of the path."""
    monkeypatch.setattr(os.path, "splitdrive", ntpath.splitdrive)
    for name in ("C", r"C:\logs\a.bag"):
        (tmp_path / name).write_bytes(b"")
    assert split_topic(r"C:\logs\a.bag:/imu") == (r"C:\logs\a.bag", "/imu")
    assert split_topic(r"C:\logs\none.bag:/imu") == (r"C:\logs\none.bag:/imu", None)


def test_an_address_is_split_before_a_topic_with_a_slash(tmp_path, log):
    """As in a store: where the whole name is no object."""
    address = log.as_uri()
    assert split_topic(f"{address}:/imu/left") == (address, "/imu/left")
    (tmp_path / "log.bag:").mkdir()
    (tmp_path / "log.bag:" / "imu").write_bytes(b"")
    assert split_topic(f"{address}:/imu") == (f"{address}:/imu", None)
    assert split_topic(f"{tmp_path.as_uri()}/none:/imu") == (f"{tmp_path.as_uri()}/none:/imu", None)


@pytest.mark.parametrize(("topic", "rate"), RATES.items())
def test_each_command_reads_the_topic(tmp_path, topic, rate):
    """As with --topic; the log is ambiguous without."""
    run("propagate", f"log.bag:{topic}", "-o", "a.csv", code=0)
    last = quatprop.read_attitudes("a.csv").wxyz[-1]
    assert last == pytest.approx([np.cos(rate * 0.195), 0, 0, np.sin(rate * 0.195)], abs=1e-12)
    (survey,) = json.loads(run("info", f"log.bag:{topic}", "--json", code=0).stdout)
    assert [source["source"] for source in survey["sources"]] == [topic]
    run("convert", f"log.bag:{topic}", "b.csv", "--report", "r.json", code=0)
    assert json.loads((tmp_path / "r.json").read_text())["source"]["name"] == topic


def test_topics_of_one_log_are_compared_and_drawn(tmp_path):
    """Each with its name: two files of one name had their path alone."""
    both = [f"log.bag:{topic}" for topic in RATES]
    said = run("compare", *both, "--json", "--plot", "c.html", code=0)
    report = json.loads(said.stdout)
    assert [report[side]["name"] for side in "ab"] == [*RATES]
    assert "error of log.bag /imu/left against log.bag /imu/right" in (
        tmp_path / "c.html"
    ).read_text("utf-8")
    said = run("plot", *both, "-o", "p.html", "--show", "rates", code=0).stderr
    drawn = [line.partition(" sensor_msgs/msg/Imu: 40 samples")[0] for line in said.splitlines()]
    assert drawn[:2] == [f"log.bag: {topic}" for topic in RATES]
    run("plot", both[0], "--reference", both[1], "-o", "e.png", code=0)


def test_files_are_drawn_with_topics_of_their_own(tmp_path):
    """-t is for those that name none."""
    write_attitudes(tmp_path / "true.csv", STAMPS, [(1.0, 0.0, 0.0, 0.0)] * len(STAMPS))
    run("plot", "log.bag:/imu/left", "true.csv", "-o", "p.png", "--show", "attitude", code=0)
    two_imus(tmp_path / "more.mcap")
    said = run("plot", "log.bag:/imu/left", "more.mcap:/imu/right", "-o", "q.html", code=0).stderr
    assert "log.bag: /imu/left" in said
    assert "more.mcap: /imu/right" in said


def test_parts_of_a_recording_name_one_topic(tmp_path):
    """It is that of all of them."""
    two_imus(tmp_path / "part.bag", [t + 400_000_000 for t in STAMPS])
    run("propagate", "log.bag:/imu/left", "part.bag", "-o", "a.csv", code=0)
    last = quatprop.read_attitudes("a.csv").wxyz[-1]
    assert last[3] == pytest.approx(np.sin(0.25 * 0.395), abs=1e-12)


@pytest.mark.parametrize(
    ("topic", "output"),
    [("/im\0u", "im%00u"), ("\0", "%00"), ("/a\0/../b", "a%00/b"), ("/i\nmu", "i\nmu")],
)
def test_a_topic_that_is_no_path_has_an_output_in_a_batch(tmp_path, topic, output):
    """A zero byte in its name was called a bug."""
    rows = [(topic, *row[1:]) for row in imu_messages(STAMPS, [(0, 0, 1)] * 40)]
    write_messages(tmp_path / "log.mcap", rows)
    run("batch", "log.mcap", "-o", "out", "--to", "csv", "-t", "*", code=0)
    made = quatprop.read_attitudes(f"out/log.mcap/{output}.csv")
    np.testing.assert_allclose(made.wxyz, turn(1, STAMPS), atol=1e-12)


def test_a_batch_reads_every_topic_with_rates(log, tmp_path):
    """Each into an output of its own; what is no log fails alone."""
    (tmp_path / "bad.bag").write_bytes(b"#ROSBAG V2.0\n")
    words = ["batch", log, "bad.bag", "-o", "out", "--to", "csv", "-t", "*"]
    run(*words, code=2)
    made = {path.relative_to("out").as_posix() for path in Path("out").rglob("*.csv")}
    assert made == {"log.bag/imu/left.csv", "log.bag/imu/right.csv"}
    for topic, rate in RATES.items():
        series = quatprop.read_attitudes(f"out/log.bag{topic}.csv")
        np.testing.assert_allclose(series.wxyz, turn(rate, STAMPS), atol=1e-12)
    again = run(*words, "--skip-existing", code=2).stderr
    assert "0 of 1 series of 1 log done" in again, again
    entries = quatprop.batch([log], "python", topic="*", processes=1)
    assert [entry.output for entry in entries] == [
        "log.bag/imu/left.parquet",
        "log.bag/imu/right.parquet",
    ]
