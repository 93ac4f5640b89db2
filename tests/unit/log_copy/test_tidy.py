"""Copies that cannot be made: nothing stays open, and nothing stays beside the log."""

import errno
import sys
from pathlib import Path

import pytest
from make.into_logs import write_bag, write_mcap, write_rosbag2

from quatprop.errors import OutputError, QuatpropError, UnreadableLogError, UsageError
from quatprop.log_copy import open_into
from quatprop.logs.open_log import open_log
from quatprop.writers import open_writer
from quatprop.writers.messages.kinds import Message

OPEN = Path("/proc/self/fd")

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="only Linux lists what is open"
)

LOGS = {
    "mcap": write_mcap,
    "bag": write_bag,
    "sqlite3": lambda path: write_rosbag2(path, _plugin("SQLITE3")),
    "rosbag2-mcap": lambda path: write_rosbag2(path, _plugin("MCAP")),
}


def _plugin(name):
    from rosbags.rosbag2 import StoragePlugin

    return StoragePlugin[name]


def opened(folder):
    """Return the files below a folder that this process has open."""
    found = []
    for descriptor in OPEN.iterdir():
        try:
            place = descriptor.readlink()
        except OSError:
            continue  # that of the listing itself
        if place.is_relative_to(folder):
            found.append(place)
    return found


def no_room(*_args, **_options):
    """Do as a full disk does."""
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture(params=LOGS)
def log(request, tmp_path):
    """Give a log of each kind that can be added to, in a folder of its own."""
    (tmp_path / "in").mkdir()
    with open_log(LOGS[request.param](tmp_path / "in" / "log")) as opened_log:
        yield opened_log


def refused(log, target, error, **options):
    """Fail to open a copy; return the words, and what the failure has left open."""
    folder = log.path.parent.parent
    before = sorted(opened(folder))
    with pytest.raises(QuatpropError) as raised:
        open_into(log, str(target), **options)
    assert raised.type is error
    assert sorted(opened(folder)) == before
    return str(raised.value)


def test_a_topic_that_is_there(log, tmp_path):
    """It is refused with all files closed."""
    words = refused(log, tmp_path / "copy", UsageError, message=Message(topic="/imu"))
    assert "topic '/imu' exists already" in words
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_folder_that_is_not_there(log, tmp_path):
    """It is refused with all files closed."""
    words = refused(log, tmp_path / "none" / "copy", OutputError)
    assert "there is no folder" in words
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


def test_a_layout_that_messages_do_not_have(log, tmp_path):
    """It is refused as it is for a file of its own."""
    words = refused(log, tmp_path / "copy", UsageError, layout="scalar-first")
    assert "scalar-last" in words


def test_a_disk_that_is_full_at_once(log, tmp_path, monkeypatch):
    """What was begun is removed, and all files are closed."""
    for place in (
        "quatprop.writers.mcap.file.McapFile.__init__",
        "quatprop.writers.rosbag1.file.BagFile",
        "quatprop.log_copy.sqlite.SqlitePart._insert",
    ):
        monkeypatch.setattr(place, no_room)
    words = refused(log, tmp_path / "copy", OutputError)
    assert "cannot be written: No space left on device" in words
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize(
    ("write", "place"),
    [
        (write_mcap, "quatprop.containers.mcap.log.build_index"),
        (write_bag, "quatprop.containers.rosbag1.log.read_index"),
    ],
)
def test_a_disk_that_fails_while_it_is_looked_through(tmp_path, monkeypatch, write, place):
    """The error names the log, which is closed."""
    log = write(tmp_path / "log")
    monkeypatch.setattr(place, no_room)
    with (
        pytest.raises(UnreadableLogError, match=f"{log}: .*No space left on device"),
        open_log(log),
    ):
        pass
    assert opened(tmp_path) == []


@pytest.mark.parametrize(
    ("kind", "place"),
    [
        ("mcap", "quatprop.writers.mcap.file.McapFile.__init__"),
        ("bag", "quatprop.writers.rosbag1.file.BagFile.__init__"),
        ("npy", "quatprop.writers.tables.npy.NpyTable._write_header"),
        ("rosbag2", "quatprop.writers.rosbag2.writer.BulkWriter.open"),
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
