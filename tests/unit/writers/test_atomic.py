"""Nothing half-written, and one clear sentence for every place that cannot be written to."""

import errno
import gc
import os
import re
import stat
import threading
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from quatprop.cli.commands import cli
from quatprop.errors import OutputError
from quatprop.series import AttitudeSeries
from quatprop.stores.temp_files import LockedTemp
from quatprop.writers import open_writer
from quatprop.writers.atomic import OutputPath, open_atomic
from quatprop.writers.formats import WRITERS, kind_of

FOLDERS = ("rosbag2", "rosbag2-mcap")
KINDS = tuple(kind for kind in WRITERS if kind not in FOLDERS)
STREAMED = tuple(kind for kind in KINDS if kind not in {"npy", "bag"})
"""Kinds whose beginning does not depend on their end."""


def attitudes(n=3):
    """Return a short series of identity attitudes."""
    return AttitudeSeries(np.arange(n), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)))


def write(target, kind=None):
    """Write and commit a short series."""
    with open_writer(target, kind) as writer:
        writer.write(attitudes())
        writer.commit({})


@pytest.mark.parametrize("kind", KINDS)
def test_a_failed_run_leaves_the_old_file_and_nothing_else(tmp_path, kind):
    """An exception before the commit leaves the old bytes and no stray file."""
    target = tmp_path / f"a.{kind}"
    target.write_bytes(b"old")

    def fail_midway():
        with open_writer(target, kind) as writer:
            writer.write(attitudes())
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("kind", KINDS)
def test_the_old_file_stands_until_the_commit(tmp_path, kind):
    """While a run is under way, readers of the target see the old file whole."""
    target = tmp_path / f"a.{kind}"
    target.write_bytes(b"old")
    with open_writer(target, kind) as writer:
        writer.write(attitudes())
        assert target.read_bytes() == b"old"
        writer.commit({})
    assert target.read_bytes() != b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path):
    """The umask rules, as for a file made by any other program."""
    before = os.umask(0o027)
    try:
        write(tmp_path / "a.csv")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.csv").stat().st_mode) == 0o640


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("mode", [0o600, 0o640, 0o604])
def test_a_replaced_file_keeps_its_permissions(tmp_path, kind, mode):
    """A file that was private stays private."""
    target = tmp_path / f"a.{kind}"
    target.touch()
    target.chmod(mode)
    write(target, kind)
    assert stat.S_IMODE(target.stat().st_mode) == mode


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("exists", [False, True])
def test_what_is_being_written_is_private(tmp_path, kind, exists):
    """Others could read the temporary file of a private output, and lock it."""
    target = tmp_path / f"a.{kind}"
    if exists and kind not in FOLDERS:
        target.touch(mode=0o600)
    with open_writer(target, kind) as writer:
        writer.write(attitudes())
        (temp,) = set(tmp_path.iterdir()) - {target}
        assert temp.stat().st_mode & 0o077 == 0
        writer.commit({})
    assert list(tmp_path.iterdir()) == [target]


def what_is_there(path, kind):
    """Make what another user could have put in a shared folder."""
    if kind == "link to a pipe":
        os.mkfifo(path.with_name("pipe"))
        path.symlink_to("pipe")
    elif kind == "link to a file":
        path.with_name("file").touch()
        path.symlink_to("file")
    elif kind == "file of another user":
        path.touch()
    else:
        {"pipe": os.mkfifo, "socket": lambda name: os.mknod(name, stat.S_IFSOCK | 0o600)}[kind](
            path
        )


@pytest.mark.parametrize(
    "kind", ["pipe", "socket", "link to a pipe", "link to a file", "file of another user"]
)
def test_what_others_put_in_a_shared_folder_is_left_alone(tmp_path, monkeypatch, kind):
    """A pipe under the name of a temporary file was waited for, by every run in that folder."""
    place = tmp_path / "out.csv"
    first = LockedTemp(place, Path.touch)
    name = first.path.name[:-12]
    first.remove()
    what_is_there(tmp_path / f"{name}00000000.part", kind)
    before = sorted(tmp_path.iterdir())
    if kind == "file of another user":
        monkeypatch.setattr(os, "geteuid", lambda: -1)
    done = threading.Event()

    def run():
        LockedTemp(place, Path.touch).remove()
        done.set()

    threading.Thread(target=run, daemon=True).start()
    assert done.wait(10)
    assert sorted(tmp_path.iterdir()) == before


def test_a_link_stays_a_link(tmp_path):
    """Of a symbolic link, the file behind it is replaced, also one that is not there yet."""
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link.csv"
    link.symlink_to(Path("folder") / "real.csv")
    write(link)
    assert link.is_symlink()
    assert (tmp_path / "folder" / "real.csv").read_bytes().startswith(b"t_ns,")


def test_a_named_pipe_is_written_to(tmp_path):
    """A pipe gets the data and is still a pipe; without a suffix it gets CSV."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write(pipe)
    reader.join(timeout=10)
    assert got == [b"t_ns,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n2,1,0,0,0\n"]
    assert pipe.is_fifo()


@pytest.mark.parametrize("kind", STREAMED)
def test_a_device_is_written_to(kind):
    """The null device takes everything and stays a device."""
    write("/dev/null", kind)
    assert Path("/dev/null").is_char_device()


@pytest.mark.parametrize("kind", STREAMED)
def test_a_full_disk_is_one_sentence(kind):
    """A target without room is an error that names it."""
    with pytest.raises(
        OutputError, match=r"^/dev/full: cannot be written: No space left on device$"
    ):
        write("/dev/full", kind)


@pytest.mark.parametrize("kind", STREAMED)
def test_a_closed_pipe_stays_a_broken_pipe(kind):
    """That the reader has gone is not an output error: the command line ends quietly."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        with pytest.raises(BrokenPipeError):
            write(f"/dev/fd/{writing}", kind)
    finally:
        os.close(writing)


def test_a_file_behind_a_descriptor_keeps_what_it_has(tmp_path):
    """An open file is appended to through its descriptor, not replaced."""
    path = tmp_path / "log.txt"
    path.write_bytes(b"before\n")
    with path.open("ab") as stream:
        inode = path.stat().st_ino
        write(f"/dev/fd/{stream.fileno()}")
    assert path.read_bytes().startswith(b"before\nt_ns,")
    assert path.stat().st_ino == inode


def test_a_folder_is_refused(tmp_path):
    """A target that is a folder is refused before anything is written."""
    target = tmp_path / "there.csv"
    target.mkdir()
    with pytest.raises(
        OutputError, match=f"^{re.escape(str(target))}: is a folder; name a file in it$"
    ):
        write(target)


def test_a_missing_folder_is_refused(tmp_path):
    """A target in a folder that does not exist names the folder."""
    folder = tmp_path / "none"
    with pytest.raises(
        OutputError,
        match=f"^{re.escape(str(folder))}/a.csv: there is no folder {re.escape(str(folder))}; "
        "create it first$",
    ):
        write(folder / "a.csv")


@pytest.mark.parametrize(
    ("mode", "sentence"),
    [
        (os.W_OK, "this file is read-only; choose another"),
        (os.W_OK | os.X_OK, "writing in the folder {folder} is not permitted; choose another"),
    ],
)
def test_missing_permission_is_refused(tmp_path, monkeypatch, mode, sentence):
    """A file or folder without write permission is refused before anything is written."""
    # Tests may run as root, to whom everything is permitted: the system's answer is set here.
    monkeypatch.setattr(os, "access", lambda _path, asked: asked != mode)
    target = tmp_path / "a.csv"
    target.write_bytes(b"old")
    words = re.escape(sentence.format(folder=tmp_path))
    with pytest.raises(OutputError, match=f"^{re.escape(str(target))}: {words}$"):
        write(target)
    assert target.read_bytes() == b"old"


def test_an_unknown_suffix_lists_the_known_ones(tmp_path):
    """A suffix that tells nothing is refused with what would help."""
    target = tmp_path / "a.xyz"
    suffixes = [suffix for form in WRITERS.values() for suffix in form.suffixes if suffix]
    with pytest.raises(OutputError) as raised:
        kind_of(target)
    assert str(raised.value) == (
        f"{target}: the suffix does not tell the output format; "
        f"use one of {', '.join(suffixes)}, none for a ROS 2 bag folder, or say to="
        + " or ".join(map(repr, WRITERS))
    )


def test_an_unknown_kind_is_refused(tmp_path):
    """A kind that does not exist is refused with those that do."""
    with pytest.raises(
        OutputError, match=rf": no output kind 'xls'; choose {'[|]'.join(WRITERS)}$"
    ):
        write(tmp_path / "a.csv", "xls")


@pytest.mark.parametrize("kind", ["rosbag2", "rosbag2-mcap"])
def test_a_folder_does_not_go_to_stdout(kind):
    """Nor does what is written from its end, such as a NumPy file."""
    with pytest.raises(OutputError, match=r"^-: a ROS 2 bag is a folder; name one$"):
        write("-", kind)
    with pytest.raises(OutputError, match=r"^-: a pipe or a device cannot take a NumPy file, "):
        write("-", "npy")


def test_binary_kinds_do_not_go_to_a_terminal(monkeypatch):
    """It would show nothing readable."""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    with pytest.raises(OutputError, match=r"^-: a terminal cannot show parquet; send it to a file"):
        write("-", "parquet")


@pytest.mark.parametrize(
    ("target", "kind"),
    [("a.csv", "csv"), ("A.CSV", "csv"), ("a.b.parquet", "parquet"), ("a.pq", "parquet")],
)
def test_the_suffix_tells_the_kind(target, kind):
    """Suffixes are told in either case."""
    assert kind_of(target) == kind


def test_a_kind_overrules_the_suffix(tmp_path):
    """``--to`` is believed, whatever the name says."""
    write(tmp_path / "a.csv", "parquet")
    assert (tmp_path / "a.csv").read_bytes()[:4] == b"PAR1"


def test_small_files_are_replaced_whole(tmp_path):
    """A block of writes replaces a file at its end; a block that fails leaves it as it was."""
    target = tmp_path / "report.json"
    with open_atomic(target) as file:
        file.write(b"{}\n")
        assert not target.exists()

    def fail_midway():
        with open_atomic(target) as file:
            file.write(b"half")
            raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        fail_midway()
    assert target.read_bytes() == b"{}\n"
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_takes_its_place_only_when_committed(tmp_path):
    """A library that makes its own folder makes it temp, under its own name."""
    target = tmp_path / "bag"
    replacement = OutputPath(target, folder=True)
    replacement.path.mkdir()
    assert replacement.path.name == "bag"
    assert not target.exists()
    replacement.publish()
    assert target.is_dir()
    assert list(tmp_path.iterdir()) == [target]


def test_a_folder_that_is_not_committed_vanishes(tmp_path):
    """Leaving without a commit removes everything that was made temp."""
    replacement = OutputPath(tmp_path / "bag")
    replacement.path.mkdir()
    (replacement.path / "half").touch()
    replacement.discard()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("make", [Path.mkdir, Path.touch])
def test_a_folder_replaces_nothing(tmp_path, make):
    """Where something is already, a folder is refused."""
    target = tmp_path / "bag"
    make(target)
    words = f"^{re.escape(str(target))}: exists already; choose another name, with a suffix "
    with pytest.raises(OutputError, match=words):
        OutputPath(target, folder=True)
    assert list(tmp_path.iterdir()) == [target]


def test_a_signal_while_a_file_is_made_leaves_nothing(tmp_path):
    """Between making a file temp and knowing of it, the end of the run removes it all the same."""

    def interrupted(path):
        path.touch()
        raise SystemExit(143)

    with pytest.raises(SystemExit):
        LockedTemp(tmp_path / "out.csv", interrupted)
    gc.collect()
    assert list(tmp_path.iterdir()) == []


def test_what_was_put_in_its_place_stays(tmp_path):
    """Letting go of a file temp does not reach what has left its place."""
    temp = LockedTemp(tmp_path / "out.csv", Path.touch)
    temp.path.replace(tmp_path / "out.csv")
    temp.remove()
    temp.remove()
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("command", ["propagate", "convert"])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "feather", "npz", "mcap", "bag"])
def test_a_report_that_cannot_be_written_leaves_the_old_output(tmp_path, command, suffix):
    """Everything that can fail comes before the first output is put in its place."""
    log, out = tmp_path / "log.csv", tmp_path / f"out.{suffix}"
    columns = {"propagate": "wx,wy,wz", "convert": "qw,qx,qy,qz"}[command]
    values = {"propagate": "0,0,1", "convert": "1,0,0,0"}[command]
    log.write_text(f"t_ns,{columns}\n" + "".join(f"{k},{values}\n" for k in range(3)))
    out.write_text("old")
    place = ["-o", str(out)] if command == "propagate" else [str(out)]
    result = CliRunner().invoke(cli, [command, str(log), *place, "--report", "/dev/full", "-q"])
    assert result.exit_code == 2
    assert result.stderr == "Error: /dev/full: cannot be written: No space left on device\n"
    assert out.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", out.name]


def test_a_picture_that_cannot_be_drawn_leaves_the_old_output(tmp_path, monkeypatch):
    """The picture of a run is drawn before the attitudes are put in their place."""
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    log.write_text("t_ns,wx,wy,wz\n0,0,0,1\n10,0,0,1\n")
    out.write_text("old")

    def fail(*_arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("quatprop.plot.target.render", fail)
    arguments = ["propagate", str(log), "-o", str(out), "--plot", str(tmp_path / "a.png"), "-q"]
    result = CliRunner().invoke(cli, arguments)
    assert (result.exit_code, out.read_text()) == (2, "old")
