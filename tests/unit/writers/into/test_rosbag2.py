"""Copies of ROS 2 bags: metadata, parts, databases that are written to."""

import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from make.commands import run
from make.into_logs import BOOT, moments, write_mcap, write_rosbag2
from make.mcap_doctor import examine
from make.ros import ROS2
from mcap.reader import make_reader
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.typesys import get_types_from_msg
from ruamel.yaml import YAML

from quatprop.writers.into.mcap_copy import Added, extended
from quatprop.writers.message_encoders import ros_topic

SUFFIXES = {StoragePlugin.SQLITE3: ".db3", StoragePlugin.MCAP: ".mcap"}
TOPIC = ros_topic("/attitude", "geometry_msgs/msg/QuaternionStamped", ros1=False)


@pytest.fixture
def log(tmp_path):
    """Return a bag in a database."""
    return write_rosbag2(tmp_path / "log", StoragePlugin.SQLITE3)


def copied(log, out, *options, code=0):
    """Add attitudes to a log; return the copy."""
    run("propagate", log, "--into", out, "-q", *options, code=code)
    return out


def beside(folder):
    """Return what metadata.yaml says."""
    text = (folder / "metadata.yaml").read_text()
    return YAML(typ="safe").load(text)["rosbag2_bagfile_information"]


def inside(path):
    """Return the only metadata inside a file of a ROS 2 bag, with the keys that rosbag2 needs."""
    if path.suffix == ".mcap":
        with path.open("rb") as stream:
            found = list(make_reader(stream).iter_metadata())
        texts = [r.metadata["serialized_metadata"] for r in found if r.name == "rosbag2"]
    else:
        with closing(sqlite3.connect(path)) as database:
            texts = [text for (text,) in database.execute("SELECT metadata FROM metadata")]
    (told,) = (YAML(typ="safe", pure=True).load(text) for text in texts)
    keys = {"name", "type", "serialization_format", "offered_qos_profiles", "type_description_hash"}
    for entry in told["topics_with_message_count"]:
        assert keys <= entry["topic_metadata"].keys()
    return told


def check_told(after, before):
    """Assert that counts rise, the topic is told as the others are, and nothing else changes."""
    *others, added = after.pop("topics_with_message_count")
    assert others == before.pop("topics_with_message_count")
    assert added["message_count"] == 300
    topic, like = added["topic_metadata"], others[0]["topic_metadata"]
    assert topic.keys() == like.keys()
    assert (topic["name"], topic["type"], topic["serialization_format"]) == (
        "/attitude",
        "geometry_msgs/msg/QuaternionStamped",
        "cdr",
    )
    assert topic["offered_qos_profiles"] == like["offered_qos_profiles"]
    for told, count in ((before, 330), (after, 630)):
        assert told.pop("message_count") == count
        assert [file.pop("message_count") for file in told["files"]] == [count]
        told.pop("custom_data", None)
    assert after == before


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("storage", SUFFIXES)
def test_the_metadata_tell_of_what_was_added(tmp_path, storage, version):
    """Beside and inside the file of messages, which rosbag2 reads first."""
    log = write_rosbag2(tmp_path / "log", storage, version=version)
    out = copied(log, tmp_path / "out")
    check_told(beside(out), beside(log))
    file = f"log{SUFFIXES[storage]}"
    check_told(inside(out / file), inside(log / file))
    if storage == StoragePlugin.SQLITE3:  # no profiles are a list since version 9
        with closing(sqlite3.connect(out / file)) as database:
            rows = dict(database.execute("SELECT name, offered_qos_profiles FROM topics"))
        assert rows["/attitude"] == rows["/imu"] == {8: "", 9: "[]"}[version]
    single = copied(log / file, tmp_path / f"single{SUFFIXES[storage]}")
    check_told(inside(single), inside(log / file))
    result = run("convert", single, "-", "-t", "/attitude", "-q")
    first, *others = result.stdout.splitlines()[1:]
    assert (first, len(others)) == (f"{BOOT},1,0,0,0", 299)


def test_each_part_gets_the_attitudes_of_its_time(tmp_path):
    """A player reads part after part: an empty part got those of the time of the part before it."""
    whole = write_rosbag2(tmp_path / "whole", StoragePlugin.SQLITE3, 200)
    border = list(moments(200))[120][1]
    (tmp_path / "log").mkdir()
    for k, keep in enumerate(("timestamp < ?", "0 > ?", "timestamp >= ?")):
        file = shutil.copy(whole / "whole.db3", tmp_path / "log" / f"bag_{k}.db3")
        with closing(sqlite3.connect(file)) as database, database:
            query = f"DELETE FROM messages WHERE NOT {keep}"  # noqa: S608  # no input
            database.execute(query, [border])
    for end, expected in (((), [120, 0, 80]), (("--end", "+1s"), [101, 0, 0])):
        out = copied(tmp_path / "log", tmp_path / f"out{len(end)}", *end)
        counts = []
        for k in range(3):
            with closing(sqlite3.connect(out / f"bag_{k}.db3")) as database:
                query = "SELECT name, count(*) FROM messages, topics WHERE topics.id = topic_id "
                counts.append(dict(database.execute(f"{query} GROUP BY name")))
        assert [each.get("/attitude", 0) for each in counts] == expected
        assert [each.get("/imu", 0) for each in counts] == [120, 0, 80]


def test_parts_in_mcap_are_split_as_well(tmp_path):
    """The same with the other storage, whose parts tell their first time in their index."""
    (tmp_path / "log").mkdir()
    for k in range(2):
        write_mcap(tmp_path / "log" / f"bag_{k}.mcap", 200, start=k * 200)
    out = copied(tmp_path / "log", tmp_path / "out")
    assert [examine(out / f"bag_{k}.mcap").counts[3] for k in range(2)] == [200, 200]


@pytest.mark.parametrize("text", [None, "rosbag2_bagfile_information: {}"])
def test_without_metadata_a_copy_has_none(tmp_path, text):
    """The parts are found by their names, in the copy as in the bag; damaged ones are left out."""
    log, out = write_rosbag2(tmp_path / "log", StoragePlugin.MCAP), tmp_path / "out"
    (log / "metadata.yaml").unlink()
    if text:
        (log / "metadata.yaml").write_text(text)
    run("convert", log, "--into", out, "-q", code=3 if text else 0)
    assert sorted(file.name for file in out.iterdir()) == ["log.mcap", "note.txt"]
    result = run("convert", out, "-", "-t", "/attitude", "-q")
    wxyz = np.loadtxt(result.stdout.splitlines()[1:], delimiter=",")[:, 1:]
    np.testing.assert_array_equal(wxyz, np.tile([0.8, 0, 0, 0.6], (300, 1)))


@pytest.mark.parametrize("profiles", [{"offered_qos_profiles": ""}, {}])
def test_metadata_of_old_versions_stay_as_they_are_written(profiles):
    """Version 4 has texts for profiles, no hashes, no place for what others add, and no files."""
    more = "".join(f", {key}: {value!r}" for key, value in profiles.items())
    text = f"""
rosbag2_bagfile_information:
  version: 4
  storage_identifier: sqlite3
  relative_file_paths: [a.db3]
  duration: {{nanoseconds: 100}}
  starting_time: {{nanoseconds_since_epoch: 1000}}
  message_count: 2
  topics_with_message_count:
    - topic_metadata: {{name: /a, type: b, serialization_format: cdr{more}}}
      message_count: 2
  compression_format: ""
  compression_mode: ""
"""
    new = extended(text, TOPIC, [Added(3, 990, 1200), Added()], {"quatprop /attitude": "{}"})
    bag = YAML(typ="safe").load(new)["rosbag2_bagfile_information"]
    assert bag["message_count"] == 5
    assert bag["starting_time"] == {"nanoseconds_since_epoch": 990}
    assert bag["duration"] == {"nanoseconds": 210}
    assert bag["topics_with_message_count"][1] == {
        "message_count": 3,
        "topic_metadata": {
            "name": "/attitude", "type": "geometry_msgs/msg/QuaternionStamped",
            "serialization_format": "cdr", **profiles,
        },
    }  # fmt: skip
    assert "custom_data" not in bag


@pytest.mark.parametrize("storage", SUFFIXES)
def test_what_is_added_is_defined_in_the_copy(tmp_path, storage):
    """A reader that does not know the type takes it from there."""
    out = copied(write_rosbag2(tmp_path / "log", storage), tmp_path / "copy")
    with Reader(out) as reader:
        (added,) = (each for each in reader.connections if each.topic == "/attitude")
    assert added.msgdef.format == MessageDefinitionFormat.MSG
    found = get_types_from_msg(added.msgdef.data, added.msgtype)
    for name in (added.msgtype, "geometry_msgs/msg/Quaternion"):
        assert found[name][1] == ROS2.fielddefs[name][1]


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE metadata SET metadata = ''",
        "UPDATE metadata SET metadata = 'damaged'",
        "DROP TABLE metadata",
        "DELETE FROM metadata",
    ],
)
def test_a_database_without_definitions_gets_none(tmp_path, log, statement):
    """As those of Humble; its own metadata are left as they are where they are damaged or none."""
    with closing(sqlite3.connect(log / "log.db3")) as opened, opened:
        opened.execute("DROP TABLE message_definitions")
        opened.execute(statement)
    out = copied(log / "log.db3", tmp_path / "out.db3")
    tables = []
    for file in (log / "log.db3", out):
        with closing(sqlite3.connect(file)) as opened:
            tables.append([line for line in opened.iterdump() if '"metadata"' in line])
    assert tables[0] == tables[1]
    result = run("convert", out, "-", "-t", "/attitude", "-q", code=0)
    assert result.stdout.splitlines()[1] == f"{BOOT},1,0,0,0"


def test_a_log_in_write_ahead_mode_gets_no_files_beside_it(tmp_path, log):
    """Reading leaves the folder of the log as it was, whoever may write there."""
    with closing(sqlite3.connect(log / "log.db3")) as opened:
        assert opened.execute("PRAGMA journal_mode=WAL").fetchone() == ("wal",)
    before = {path.name: path.read_bytes() for path in log.iterdir()}
    run("info", log, code=0)
    copied(log, tmp_path / "copy")
    assert {path.name: path.read_bytes() for path in log.iterdir()} == before


def test_what_is_not_yet_inside_a_database_is_copied_but_not_its_log(tmp_path, log):
    """A bag that was copied while it was recorded has messages beside its database."""
    with closing(sqlite3.connect(log / "log.db3")) as opened:
        opened.execute("PRAGMA journal_mode=WAL")
        opened.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (2, 7, x'07')")
        opened.commit()
        taken = shutil.copytree(log, tmp_path / "taken")
    wal = taken / "log.db3-wal"
    out = copied(taken, tmp_path / "copy", code=None)
    assert {path.name for path in out.iterdir()} == {"log.db3", "metadata.yaml", "note.txt"}
    with closing(sqlite3.connect(out / "log.db3")) as opened:
        assert len(opened.execute("SELECT 1 FROM messages WHERE timestamp = 7").fetchall()) == 1
    # Where nothing in it is intact, SQLite itself would delete it.
    for shared in taken.glob("*-shm"):
        shared.unlink()
    wal.write_bytes(bytes(wal.stat().st_size))
    copied(taken, tmp_path / "other", code=3)
    assert wal.exists()
