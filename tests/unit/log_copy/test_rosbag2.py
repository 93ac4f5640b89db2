"""Copies of ROS 2 bags with attitudes added: everything else is kept."""

import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from make.into_logs import BOOT, moments, run, write_mcap, write_rosbag2
from make.mcap_doctor import examine
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from quatprop.log_copy.rosbag2_metadata import Added, extended
from quatprop.logs.open_log import open_log
from quatprop.writers.messages.topics import ros_topic

STORE = get_typestore(Stores.ROS2_HUMBLE)
STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]
SUFFIXES = {StoragePlugin.SQLITE3: ".db3", StoragePlugin.MCAP: ".mcap"}

TOPIC = ros_topic("/attitude", "geometry_msgs/msg/QuaternionStamped", ros1=False)


def content(path):
    """Return the connections of a bag, and its messages in order of time."""
    with Reader(path) as reader:
        connections = {c.topic: (c.msgtype, c.msgdef.data, c.msgcount) for c in reader.connections}
        messages = [(c.topic, logged, bytes(data)) for c, logged, data in reader.messages()]
    return connections, messages


def told(path):
    """Return what metadata.yaml says."""
    yaml = YAML(typ="safe").load((path / "metadata.yaml").read_text())
    return yaml["rosbag2_bagfile_information"]


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("storage", STORAGES)
def test_everything_else_is_kept(tmp_path, storage, version):
    """Topics, messages and other files; metadata.yaml tells of all."""
    log, out = write_rosbag2(tmp_path / "log", storage, version=version), tmp_path / "out"
    result = run("propagate", log, "--into", out, "-q")
    assert (result.exit_code, result.output) == (0, "")
    (connections, messages), (before, sent) = content(out), content(log)
    name, _, count = connections.pop("/attitude")
    assert (name, count) == ("geometry_msgs/msg/QuaternionStamped", 300)
    assert connections == before
    assert [message for message in messages if message[0] != "/attitude"] == sent
    found = [
        (STORE.deserialize_cdr(data, name).header.stamp, logged)
        for topic, logged, data in messages
        if topic == "/attitude"
    ]
    assert [(s.sec * 10**9 + s.nanosec, logged) for s, logged in found] == list(moments(300))
    assert sorted(file.name for file in out.iterdir()) == sorted(f.name for f in log.iterdir())
    assert (out / "note.txt").read_text() == "first flight"
    if storage is StoragePlugin.MCAP:
        examine(out / "log.mcap")


@pytest.mark.parametrize("storage", STORAGES)
def test_the_metadata_tell_of_what_was_added(tmp_path, storage):
    """Counts rise, the topic is told as the others are, and the provenance stands beside it."""
    log, out = write_rosbag2(tmp_path / "log", storage), tmp_path / "out"
    assert run("propagate", log, "--into", out, "-q", "--method", "coning").exit_code == 0
    before, after = told(log), told(out)
    assert (before["message_count"], after["message_count"]) == (330, 630)
    assert after["files"][0]["message_count"] == 630
    assert after["duration"] == before["duration"]
    *others, added = after["topics_with_message_count"]
    assert others == before["topics_with_message_count"]
    assert added["message_count"] == 300
    assert added["topic_metadata"].keys() == others[0]["topic_metadata"].keys()
    assert added["topic_metadata"]["offered_qos_profiles"] == []
    with open_log(out) as opened:
        assert opened.provenance("/attitude")["convention"]["method"] == "coning"
        assert opened.provenance("/imu") == {}


def test_each_part_gets_the_attitudes_of_its_time(tmp_path):
    """A player reads part after part: what is added must stand in the right one."""
    log, out = tmp_path / "log", tmp_path / "out"
    log.mkdir()
    whole = write_rosbag2(tmp_path / "whole", StoragePlugin.SQLITE3, 200)
    border = list(moments(200))[120][1]
    for k, keep in enumerate(("<", ">=")):
        shutil.copy(whole / "whole.db3", log / f"bag_{k}.db3")
        with sqlite3.connect(log / f"bag_{k}.db3") as database:
            query = f"DELETE FROM messages WHERE NOT timestamp {keep} ?"  # noqa: S608  # no input
            database.execute(query, [border])
        database.close()
    result = run("propagate", log, "--into", out, "-q")
    assert (result.exit_code, result.output) == (0, "")
    counts = []
    for k in range(2):
        with open_log(out / f"bag_{k}.db3") as opened:
            (added,) = (c for c in opened.channels() if c.topic == "/attitude")
            counts.append(sum(map(len, opened.blocks(added))))
    assert counts == [120, 80]


def test_parts_in_mcap_are_split_as_well(tmp_path):
    """The same with the other storage, whose parts tell their first time in their index."""
    log, out = tmp_path / "log", tmp_path / "out"
    log.mkdir()
    for k in range(2):
        write_mcap(log / f"bag_{k}.mcap", 200, start=k * 200)
    result = run("propagate", log, "--into", out, "-q")
    assert (result.exit_code, result.output) == (0, "")
    assert examine(out / "bag_0.mcap").counts[3] == 200
    assert examine(out / "bag_1.mcap").counts[3] == 200


def test_a_database_by_itself_is_copied(tmp_path):
    """A bare .db3 is a log too; what waits in its -wal file is part of it."""
    log = write_rosbag2(tmp_path / "bag", StoragePlugin.SQLITE3) / "bag.db3"
    out = tmp_path / "out.db3"
    assert run("propagate", log, "--into", out, "-q").exit_code == 0
    result = run("convert", out, "-", "-t", "/attitude", "-q")
    assert len(result.stdout.splitlines()) == 301
    assert result.stdout.splitlines()[1] == f"{BOOT},1,0,0,0"


@pytest.mark.parametrize("storage", STORAGES)
def test_what_is_there_is_not_touched(tmp_path, storage):
    """A folder that exists is refused, a topic that is there too, and nothing is left."""
    log = write_rosbag2(tmp_path / "log", storage)
    (tmp_path / "out").mkdir()
    result = run("propagate", log, "--into", tmp_path / "out")
    assert result.exit_code == 2
    assert "exists already; choose another name, with a suffix" in result.stderr
    result = run("propagate", log, "--into", tmp_path / "new", "--out-topic", "/shutter")
    assert result.exit_code == 2
    assert "topic '/shutter' exists already; choose another with --out-topic" in result.stderr
    result = run("propagate", log, "--into", log / "inside")
    assert result.exit_code == 2
    assert "which is an input; choose another output" in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log", "out"]


def test_packed_files_are_refused_with_the_way_out(tmp_path):
    """Nothing can be added to what is packed as a whole."""
    import zstandard

    log = write_rosbag2(tmp_path / "log", StoragePlugin.SQLITE3)
    database = log / "log.db3"
    (log / "log.db3.zstd").write_bytes(zstandard.compress(database.read_bytes()))
    database.unlink()
    result = run("propagate", log, "--into", tmp_path / "out")
    assert result.exit_code == 2
    assert "are compressed one by one, and nothing can be added to them" in result.stderr
    assert list(tmp_path.iterdir()) == [log]


def test_without_metadata_a_copy_has_none(tmp_path):
    """The parts are found by their names, in the copy as in the bag."""
    log, out = write_rosbag2(tmp_path / "log", StoragePlugin.MCAP), tmp_path / "out"
    (log / "metadata.yaml").unlink()
    assert run("convert", log, "--into", out, "-q").exit_code == 0
    assert sorted(file.name for file in out.iterdir()) == ["log.mcap", "note.txt"]
    result = run("convert", out, "-", "-t", "/attitude", "-q")
    wxyz = np.loadtxt(result.stdout.splitlines()[1:], delimiter=",")[:, 1:]
    np.testing.assert_array_equal(wxyz, np.tile([0.8, 0, 0, 0.6], (300, 1)))


def test_metadata_of_old_versions_stay_as_they_are_written():
    """Version 4 has texts for profiles, no hashes, no place for what others add, and no files."""
    text = """
rosbag2_bagfile_information:
  version: 4
  storage_identifier: sqlite3
  relative_file_paths: [a.db3]
  duration: {nanoseconds: 100}
  starting_time: {nanoseconds_since_epoch: 1000}
  message_count: 2
  topics_with_message_count:
    - topic_metadata: {name: /a, type: b, serialization_format: cdr, offered_qos_profiles: ""}
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
            "serialization_format": "cdr", "offered_qos_profiles": "",
        },
    }  # fmt: skip
    assert "custom_data" not in bag


def test_a_database_in_write_ahead_mode_gets_no_files_beside_it(tmp_path):
    """Reading leaves the folder of the log as it was, whoever may write there."""
    log = write_rosbag2(tmp_path / "log", StoragePlugin.SQLITE3)
    (database,) = log.glob("*.db3")
    with closing(sqlite3.connect(database)) as opened:
        assert opened.execute("PRAGMA journal_mode=WAL").fetchone() == ("wal",)
    before = {path.name: path.read_bytes() for path in log.iterdir()}
    assert run("info", log).exit_code == 0
    assert run("propagate", log, "--into", tmp_path / "copy", "-q").exit_code == 0
    run("plot", log, "-o", tmp_path / "rates.png", "-q")
    assert {path.name: path.read_bytes() for path in log.iterdir()} == before


def test_what_is_not_yet_inside_a_database_is_copied_but_not_its_log(tmp_path):
    """A bag that was copied while it was recorded has messages beside its database."""
    log = write_rosbag2(tmp_path / "log", StoragePlugin.SQLITE3)
    (database,) = log.glob("*.db3")
    with closing(sqlite3.connect(database)) as opened:
        opened.execute("PRAGMA journal_mode=WAL")
        opened.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (2, 7, x'07')")
        opened.commit()
        taken = shutil.copytree(log, tmp_path / "taken")
    (wal,) = (path for path in taken.iterdir() if path.name.endswith("-wal"))
    out = tmp_path / "copy"
    assert run("propagate", taken, "--into", out, "-q").exit_code in {0, 3}
    names = ["metadata.yaml", "note.txt", database.name]
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    with closing(sqlite3.connect(out / database.name)) as opened:
        assert opened.execute("SELECT COUNT(*) FROM messages WHERE timestamp = 7").fetchone() == (
            1,
        )
    # Where nothing in it is intact, SQLite itself would delete it.
    for shared in taken.glob("*-shm"):
        shared.unlink()
    wal.write_bytes(bytes(len(wal.read_bytes())))
    assert run("propagate", taken, "--into", tmp_path / "other", "-q").exit_code == 3
    assert wal.exists()


@pytest.mark.parametrize("version", [8, 9])
def test_profiles_are_written_as_the_bag_has_them(tmp_path, version):
    """No profiles are a list since version 9, and nothing before."""
    log = write_rosbag2(tmp_path / "log", StoragePlugin.SQLITE3, version=version)
    out = tmp_path / "copy"
    assert run("propagate", log, "--into", out, "-q").exit_code == 0
    (database,) = out.glob("*.db3")
    with closing(sqlite3.connect(database)) as opened:
        rows = dict(opened.execute("SELECT name, offered_qos_profiles FROM topics"))
    assert rows["/attitude"] == rows["/imu"] == ("[]" if version == 9 else "")
