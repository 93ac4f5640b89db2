"""Copies that cannot be made: nothing stays open, and nothing stays beside the log."""

import errno
import os
import sqlite3
import sys
import threading
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zstandard
from make.commands import refused, run
from make.into_logs import START, write_bag, write_mcap, write_rosbag2
from make.mcap_doctor import examine
from rosbags.rosbag2 import StoragePlugin

from quatprop.base.errors import (
    LogError,
    OutputError,
    QuatpropError,
    UnreadableLogError,
    UsageError,
)
from quatprop.kinematics.series import AttitudeSeries
from quatprop.readers.open_log import open_log
from quatprop.stores.file_source import FileSource
from quatprop.writers import open_writer
from quatprop.writers.formats import Message
from quatprop.writers.into import open_into

LOGS = {
    "log.mcap": write_mcap,
    "log.bag": write_bag,
    "log": lambda path: write_rosbag2(path, StoragePlugin.SQLITE3),
    "log2": lambda path: write_rosbag2(path, StoragePlugin.MCAP),
}


@pytest.fixture(params=LOGS)
def log(request, tmp_path):
    """Give a log of each kind that can be added to, in a folder of its own."""
    (tmp_path / "in").mkdir()
    return LOGS[request.param](tmp_path / "in" / request.param)


@pytest.fixture
def mcap(tmp_path):
    """Give an MCAP file."""
    return write_mcap(tmp_path / "log.mcap")


def opened(folder):
    """Return the files below a folder that this process has open."""
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux lists what is open")
    places = []
    for descriptor in Path("/proc/self/fd").iterdir():
        try:
            places.append(descriptor.readlink())
        except OSError:
            continue  # that of the listing itself
    return sorted(place for place in places if place.is_relative_to(folder))


def no_room(*_args, **_options):
    """Do as a full disk does."""
    raise OSError(errno.ENOSPC, "No space left on device")


def check_refused(log, target, error, words, **options):
    """Assert that a copy is refused, and that no file is left, nor one open."""
    folder = log.parent.parent
    with open_log(log) as opened_log:
        before = opened(folder)
        with pytest.raises(QuatpropError, match=words) as raised:
            open_into(opened_log, str(folder / target), **options)
        assert raised.type is error
        assert opened(folder) == before
    assert [path.name for path in folder.iterdir()] == ["in"]


def test_what_cannot_be_begun_leaves_nothing_open(log):
    """Neither a file nor a descriptor, whatever is wrong."""
    there = Message(topic="/imu")
    check_refused(log, "copy", UsageError, "topic '/imu' exists already", message=there)
    check_refused(log, "none/copy", OutputError, "there is no folder")
    check_refused(log, "copy", UsageError, "scalar-last", layout="scalar-first")


def test_a_disk_that_is_full_at_once(log, monkeypatch):
    """What was begun is removed, and all files are closed."""
    for place in (
        "quatprop.writers.mcap.McapFile.__init__",
        "quatprop.writers.rosbag1.BagFile",
        "quatprop.writers.into.rosbag2_copy.SqlitePart._insert",
    ):
        monkeypatch.setattr(place, no_room)
    check_refused(log, "copy", OutputError, "cannot be written: No space left on device")


def test_a_copy_that_fails_midway_leaves_nothing(tmp_path, log):
    """Neither a file, nor one that is open, nor a thread."""
    series = AttitudeSeries(START + np.arange(200) * 10_000_000, np.eye(4)[[0] * 200])
    message = Message(frame="m" * 2000)
    with open_log(log) as opened_log:
        before, threads = opened(tmp_path), set(threading.enumerate())
        with open_into(opened_log, str(tmp_path / "copy"), message=message) as writer:
            writer.write(series)
        assert opened(tmp_path) == before
        assert set(threading.enumerate()) <= threads
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


HARMS = {
    "it cannot be read": lambda _, patch: patch.setattr(FileSource, "read", no_room),
    "it became shorter while it was read; copy it first": lambda log, _: os.truncate(log, 9000),
}


def add_and_harm(log, target, harm):
    """Add attitudes to a log that is harmed before the end."""
    with open_into(log, str(target)) as writer:
        writer.write(AttitudeSeries(START + np.arange(9) * 10**9, np.eye(4)[[0] * 9]))
        harm()
        writer.commit({})


@pytest.mark.parametrize("reason", HARMS)
@pytest.mark.parametrize("name", ["log.mcap", "log.bag"])
@pytest.mark.parametrize("is_begun", [True, False])
def test_a_log_that_cannot_be_read_any_more_is_no_copy(
    tmp_path, monkeypatch, name, reason, is_begun
):
    """The copy of a bag was complete without the chunks that could not be read any more."""
    (tmp_path / "in").mkdir()
    log = LOGS[name](tmp_path / "in" / name)
    harm = partial(HARMS[reason], log, monkeypatch)
    with open_log(log) as opened_log:
        list(opened_log.tables("/imu")[0].blocks)
        if not is_begun:
            harm()
        with pytest.raises(LogError, match=f"{name}: {reason}"):
            add_and_harm(opened_log, tmp_path / "copy", harm)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_database_that_takes_no_attitudes_is_no_copy(tmp_path):
    """Rules of its own refuse rows."""
    log = LOGS["log"](tmp_path / "log")
    with closing(sqlite3.connect(log / "log.db3")) as database, database:
        rule = "CREATE UNIQUE INDEX rule ON messages (length(data)) WHERE topic_id > 2"
        database.execute(rule)
    words = f"{log} cannot be copied: UNIQUE constraint failed: index 'rule'; write the attitudes"
    assert words in refused("propagate", log, "--into", tmp_path / "out")


@pytest.mark.parametrize(
    ("write", "place"),
    [
        (write_mcap, "quatprop.readers.containers.mcap.build_index"),
        (write_bag, "quatprop.readers.containers.rosbag1.read_index"),
    ],
)
def test_a_disk_that_fails_while_it_is_looked_through(tmp_path, monkeypatch, write, place):
    """The error names the log, which is closed."""
    log = write(tmp_path / "log")
    monkeypatch.setattr(place, no_room)
    words = f"{log}: .*No space left on device"
    with pytest.raises(UnreadableLogError, match=words), open_log(log):
        pass
    assert opened(tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("mcap", "quatprop.writers.mcap.McapFile.__init__"),
        ("bag", "quatprop.writers.rosbag1.BagFile.__init__"),
        ("npy", "quatprop.writers.npy.NpyTable._write_header"),
        ("rosbag2", "quatprop.writers.rosbag2.BulkWriter.open"),
    ],
)
def test_a_file_of_its_own_on_a_disk_that_is_full_at_once(tmp_path, monkeypatch, kind, place):
    """It is removed and closed while the error is still held, as a notebook holds the last one."""
    monkeypatch.setattr(place, no_room)
    with pytest.raises(OutputError, match="No space left on device") as held:
        open_writer(tmp_path / "out", kind)
    assert held.value.__traceback__ is not None
    assert opened(tmp_path) == []
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_is_not_touched(tmp_path, log):
    """The log and a folder that exists are no targets, and a topic that is there is refused."""
    out = tmp_path / f"out{log.suffix}"
    (tmp_path / f"link{log.suffix}").symlink_to(log)
    before = sorted(tmp_path.rglob("*"))
    for target in (log, tmp_path / f"link{log.suffix}"):
        words = "this is an input of the run; choose another output"
        assert words in refused("propagate", log, "--into", target)
    assert refused("propagate", log, "--into", out, "--out-topic", "/imu").endswith(
        f"{log}: topic '/imu' exists already; choose another with --out-topic NAME"
    )
    if log.is_dir():
        words = "exists already; choose another name, with a suffix"
        (tmp_path / "there").mkdir()
        assert words in refused("propagate", log, "--into", tmp_path / "there")
        (tmp_path / "there").rmdir()
        words = "which is an input; choose another output"
        assert words in refused("propagate", log, "--into", log / "inside")
    if log.suffix != ".mcap":
        words = "'PoseInFrame' is Foxglove's own, in protobuf"
        assert words in refused("propagate", log, "--into", out, "--message", "PoseInFrame")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_name_without_a_suffix_is_the_kind_of_the_log(mcap):
    """The copy is of the log's kind."""
    run("propagate", mcap, "--into", mcap.with_name("out"), "-q", code=0)
    examine(mcap.with_name("out"))


def test_packed_files_are_refused_with_the_way_out(tmp_path):
    """Nothing can be added to what is packed as a whole."""
    log = LOGS["log"](tmp_path / "log")
    (log / "log.db3.zstd").write_bytes(zstandard.compress((log / "log.db3").read_bytes()))
    (log / "log.db3").unlink()
    words = "are compressed one by one, and nothing can be added to them"
    assert words in refused("propagate", log, "--into", tmp_path / "out")
    assert list(tmp_path.iterdir()) == [log]
