"""Nothing half-written, and one clear sentence for every place that cannot be written to."""

import contextlib
import errno
import gc
import itertools
import os
import pathlib
import random
import stat
import subprocess
import sys
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest
from make.commands import refused
from make.systems import on_posix
from make.tables import write_attitudes, write_rates
from make.writing import write_series

from quatprop.base.errors import OutputError
from quatprop.kinematics.series import AttitudeSeries
from quatprop.stores import temp_files
from quatprop.stores.temp_files import LockedTemp
from quatprop.writers import atomic, open_writer, targets
from quatprop.writers.atomic import OutputFile, OutputPath, open_atomic
from quatprop.writers.formats import WRITERS

FOLDERS = ("rosbag2", "rosbag2-mcap")
KINDS = tuple(kind for kind in WRITERS if kind not in FOLDERS)
STREAMED = tuple(kind for kind in KINDS if kind not in {"npy", "bag"})
"""Kinds whose beginning does not depend on their end."""


def write(target, kind=None, n=3):
    """Write and commit a series of identity attitudes."""
    series = AttitudeSeries(np.arange(n), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)))
    write_series(target, series, kind=kind, told={"n": n})


def names(folder):
    """Return the names in a folder."""
    return sorted(path.name for path in folder.iterdir())


def refusal(target, kind=None):
    """Return what the sentence of a target that cannot be written says of it."""
    with pytest.raises(OutputError) as raised:
        write(target, kind)
    return str(raised.value).removeprefix(f"{target}: ")


# Until the commit


@pytest.mark.thorough
@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("mode", [None, 0o600, 0o604])
def test_the_old_file_stands_until_the_commit(tmp_path, kind, mode):
    """A file being written is private and next to the target; then it has the old permissions."""
    target = tmp_path / "a"
    is_old = mode is not None and kind not in FOLDERS
    if is_old:
        target.write_bytes(b"old")
        target.chmod(mode)
    left, threads = names(tmp_path), set(threading.enumerate())
    for fails in (True, False):
        with open_writer(target, kind) as writer:
            writer.write(AttitudeSeries(np.arange(20_000), np.eye(4)[[0] * 20_000]))
            (temp,) = set(tmp_path.iterdir()) - {target}
            assert temp.stat().st_mode & 0o077 == 0
            if not fails:
                writer.commit({})
        assert set(threading.enumerate()) <= threads
        assert names(tmp_path) == (left if fails else ["a"])
        if is_old:
            assert (target.read_bytes() == b"old") == fails
            assert stat.S_IMODE(target.stat().st_mode) == mode


def test_a_new_file_has_the_permissions_of_any_new_file(tmp_path):
    """The umask rules, as for a file made by any other program."""
    before = os.umask(0o027)
    try:
        write(tmp_path / "a.csv")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.csv").stat().st_mode) == 0o640


def test_a_new_file_is_private_from_its_creation(tmp_path, monkeypatch):
    """It had the mode of any file for an instant, in which others could open what came later."""
    created, opened = {}, os.open

    def watched(path, flags, *arguments, **options):
        file = opened(path, flags, *arguments, **options)
        if flags & os.O_CREAT:
            status = os.fstat(file)
            created[status.st_ino] = stat.S_IMODE(status.st_mode)
        return file

    monkeypatch.setattr(os, "open", watched)
    write(tmp_path / "a.csv")
    assert created[(tmp_path / "a.csv").stat().st_ino] == 0o600


@on_posix
def test_a_folder_that_another_run_removed_before_it_was_locked_is_made_again(
    tmp_path, monkeypatch
):
    """The lock of the first one was held until the end of the run."""
    locks, lock = [], temp_files._lock  # noqa: SLF001  # what happens in between shows nowhere else

    def late(path, *, wait):
        locks.append((path, lock(path, wait=wait)))
        if len(locks) == 1:
            path.rmdir()
        return locks[-1][1]

    closed, close = [], os.close
    monkeypatch.setattr(temp_files, "_lock", late)
    monkeypatch.setattr(os, "close", lambda number: closed.append(number) or close(number))
    made = LockedTemp(tmp_path / "out", Path.mkdir)
    (first, descriptor), (second, _) = locks
    assert (made.path, list(tmp_path.iterdir())) == (second, [second])
    assert (first != second, closed) == (True, [descriptor])
    made.remove()


def test_small_files_are_replaced_whole(tmp_path):
    """A block of writes replaces a file at its end; a block that fails leaves it as it was."""
    target = tmp_path / "report.json"
    with open_atomic(target) as file:
        file.write(b"{}\n")
        assert not target.exists()
    with pytest.raises(RuntimeError, match="midway"), open_atomic(target) as file:  # noqa: PT012
        file.write(b"half")
        raise RuntimeError("midway")
    assert target.read_bytes() == b"{}\n"
    assert names(tmp_path) == ["report.json"]


def test_a_folder_takes_its_place_only_when_committed(tmp_path):
    """A library that makes its own folder makes it aside, under its own name; or it vanishes."""
    for is_committed in (False, True):
        output = OutputPath(tmp_path / "bag", folder=True)
        output.path.mkdir()
        (output.path / "half").touch()
        assert output.path.name == "bag"
        assert not (tmp_path / "bag").exists()
        if is_committed:
            output.publish()
        output.discard()
        assert names(tmp_path) == ["bag"] * is_committed


def test_a_file_that_a_library_makes_takes_the_permissions_of_the_old(tmp_path):
    """It is made aside as well, and in private."""
    (tmp_path / "a.db3").write_bytes(b"old")
    (tmp_path / "a.db3").chmod(0o604)
    output = OutputPath(tmp_path / "a.db3")
    output.path.write_bytes(b"new")
    output.publish()
    assert (tmp_path / "a.db3").read_bytes() == b"new"
    assert stat.S_IMODE((tmp_path / "a.db3").stat().st_mode) == 0o604


@pytest.mark.parametrize("kind", FOLDERS)
@pytest.mark.parametrize("make", [Path.mkdir, Path.touch])
def test_a_folder_replaces_nothing(tmp_path, kind, make):
    """Where something is already, a folder is refused."""
    make(tmp_path / "bag")
    words = "exists already; choose another name, with a suffix unless it is to be a ROS 2 bag"
    assert refusal(tmp_path / "bag", kind) == f"{words} folder"
    assert names(tmp_path) == ["bag"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("command", ["propagate", "convert"])
@pytest.mark.parametrize("suffix", ["csv", "parquet", "feather", "npz", "mcap", "bag"])
def test_a_report_that_cannot_be_written_leaves_the_old_output(tmp_path, command, suffix):
    """Everything that can fail comes before the first output is put in its place."""
    log, out = tmp_path / "log.csv", tmp_path / f"out.{suffix}"
    if command == "propagate":
        write_rates(log, [(0, 0, 0, 1), (10, 0, 0, 1)])
    else:
        write_attitudes(log, [0, 10], np.eye(4)[[0, 0]])
    out.write_text("old")
    place = ["-o", out] if command == "propagate" else [out]
    told = refused(command, log, *place, "--report", "/dev/full", "-q")
    assert told == "Error: /dev/full: cannot be written: No space left on device"
    assert out.read_text() == "old"
    assert names(tmp_path) == ["log.csv", out.name]


def test_a_picture_that_cannot_be_drawn_leaves_the_old_output(tmp_path, monkeypatch):
    """The picture of a run is drawn before the attitudes are put in their place."""
    log, out = write_rates(tmp_path / "log.csv", [(0, 0, 0, 1), (10, 0, 0, 1)]), tmp_path / "a.csv"
    out.write_text("old")

    def fail(*_arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("quatprop.tools.plot.page.render", fail)
    refused("propagate", log, "-o", out, "--plot", tmp_path / "a.png", "-q")
    assert out.read_text() == "old"


# Places


def test_a_link_stays_a_link(tmp_path):
    """Of a symbolic link, the file behind it is replaced, also one that is not there yet."""
    (tmp_path / "folder").mkdir()
    link = tmp_path / "link.csv"
    link.symlink_to(Path("folder") / "real.csv")
    write(link)
    assert link.is_symlink()
    assert (tmp_path / "folder" / "real.csv").read_bytes().startswith(b"t_ns,")


@on_posix
def test_a_named_pipe_is_written_to(tmp_path):
    """A pipe gets the data and is still a pipe; without a suffix it gets CSV."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write(pipe)
    reader.join(timeout=120)
    assert got == [b"t_ns,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n2,1,0,0,0\n"]
    assert pipe.is_fifo()


@on_posix
@pytest.mark.parametrize("kind", STREAMED)
def test_devices_and_pipes_are_written_to_as_they_are(kind):
    """The null device takes everything, one without room is named, a closed pipe ends quietly."""
    write("/dev/null", kind)
    assert Path("/dev/null").is_char_device()
    assert refusal("/dev/full", kind) == "cannot be written: No space left on device"
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


@on_posix
@pytest.mark.parametrize("target", ["-", "/dev/null", "pipe"])
@pytest.mark.parametrize(("kind", "what"), [("bag", "a ROS 1 bag"), ("npy", "a NumPy file")])
def test_what_begins_with_its_end_refuses_pipes_and_devices(tmp_path, target, kind, what):
    """The beginning is written last, so it must still be there."""
    os.mkfifo(tmp_path / "pipe")
    target = tmp_path / target if target == "pipe" else target
    assert refusal(target, kind) == (
        f"a pipe or a device cannot take {what}, whose beginning is written last; name a file"
    )


def test_standard_output_takes_neither_folders_nor_what_a_terminal_cannot_show(monkeypatch):
    """The sentences say what would do."""
    for kind in FOLDERS:
        assert refusal("-", kind) == "a ROS 2 bag is a folder; name one"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    words = "a terminal cannot show parquet; send it to a file or a program"
    assert refusal("-", "parquet") == words


def test_folders_are_not_files(tmp_path):
    """A target that is a folder, or lies in none, is refused before anything is written."""
    (tmp_path / "there.csv").mkdir()
    assert refusal(tmp_path / "there.csv") == "is a folder; name a file in it"
    folder = tmp_path / "none"
    assert refusal(folder / "a.csv") == f"there is no folder {folder}; create it first"


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
    assert refusal(target) == sentence.format(folder=tmp_path)
    assert target.read_bytes() == b"old"


# Temporary files, and those of others and of runs that were killed

WRITE_FOREVER = """
import sys
import numpy as np
from make.systems import on_posix
from quatprop.kinematics.series import AttitudeSeries
from quatprop.writers import open_writer
series = AttitudeSeries(np.arange(40_000), np.tile([1.0, 0.0, 0.0, 0.0], (40_000, 1)))
while True:
    for target in sys.argv[1:]:
        with open_writer(target) as writer:
            writer.write(series)
            writer.commit({"n": 40_000})
    print("written", flush=True)
"""


@on_posix
def test_a_killed_run_leaves_whole_files_and_the_next_run_tidies_up(tmp_path):
    """Killed at any moment, every target is whole; writing it again leaves nothing next to it."""
    targets = [tmp_path / f"a{WRITERS[kind].suffixes[0]}" for kind in
               ("csv", "parquet", "feather", "npy", "npz", "mcap", "bag")]  # fmt: skip
    for target in targets:
        write(target, n=40_000)
    whole = [target.read_bytes() for target in targets]
    with subprocess.Popen(
        [sys.executable, "-c", WRITE_FOREVER, *targets], stdout=subprocess.PIPE
    ) as process:
        process.stdout.readline()
        process.kill()
    assert [target.read_bytes() for target in targets] == whole
    other = tmp_path / ".quatprop-of-somebody-else.part"
    other.touch()
    for target in targets:
        write(target)
    assert sorted(tmp_path.iterdir()) == sorted([other, *targets])


ABANDON = """
import os, sys
from quatprop.writers.atomic import OutputFile, OutputPath
made = OutputPath(sys.argv[1]) if sys.argv[2:] else OutputFile(sys.argv[1])
getattr(made, "path", None) and made.path.mkdir()
os._exit(0)
"""


@on_posix
@pytest.mark.parametrize("options", [[], ["folder"]])
def test_what_was_abandoned_goes_when_the_same_target_is_written(tmp_path, options):
    """Another target leaves it alone; the same one removes it, file or folder."""
    subprocess.run([sys.executable, "-c", ABANDON, tmp_path / "a", *options], check=True)
    (stray,) = names(tmp_path)
    OutputFile(tmp_path / "b").discard()
    assert names(tmp_path) == [stray]
    OutputPath(tmp_path / "a", folder=True).discard()
    assert names(tmp_path) == []


def test_two_runs_on_one_target_do_not_disturb_each_other(tmp_path):
    """Outputs under way are locked: the last to commit wins, and both are whole."""
    first, second = OutputFile(tmp_path / "a"), OutputFile(tmp_path / "a")
    assert len(names(tmp_path)) == 2
    first.stream.write(b"first")
    second.stream.write(b"second")
    second.commit()
    assert (tmp_path / "a").read_bytes() == b"second"
    first.commit()
    assert (tmp_path / "a").read_bytes() == b"first"
    assert names(tmp_path) == ["a"]


def test_without_locks_files_are_written_all_the_same(tmp_path, monkeypatch):
    """On a system or a disk without locks, only the tidying is missing."""
    monkeypatch.setitem(sys.modules, "fcntl", None)
    write(tmp_path / "a.csv")
    assert names(tmp_path) == ["a.csv"]


FOREIGN = {
    "pipe": lambda path: os.mkfifo(path),  # noqa: PLW0108  # not everywhere
    "socket": lambda path: os.mknod(path, stat.S_IFSOCK | 0o600),
    "link to a pipe": lambda path: path.symlink_to("pipe"),
    "link to a file": lambda path: path.symlink_to("file"),
    "file of another user": Path.touch,
}


@on_posix
@pytest.mark.parametrize("kind", FOREIGN)
def test_what_others_put_in_a_shared_folder_is_left_alone(tmp_path, monkeypatch, kind):
    """A pipe under the name of a temporary file was waited for, by every run in that folder."""
    place = tmp_path / "out.csv"
    first = LockedTemp(place, Path.touch)
    name = first.path.name[:-12]
    first.remove()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").touch()
    FOREIGN[kind](tmp_path / f"{name}00000000.part")
    before = names(tmp_path)
    if kind == "file of another user":
        monkeypatch.setattr(os, "geteuid", lambda: -1)
    done = threading.Event()

    def run():
        LockedTemp(place, Path.touch).remove()
        done.set()

    threading.Thread(target=run, daemon=True).start()
    assert done.wait(60)
    assert names(tmp_path) == before


TIDYING = {module.__file__ for module in (temp_files, atomic, pathlib, contextlib, weakref)}


def interrupted_at(step, task):
    """Run a task that is interrupted before one of its instructions; return whether it was."""
    steps = 0

    def trace(frame, event, _argument):
        nonlocal steps
        if frame.f_code.co_filename not in TIDYING:
            return None
        frame.f_trace_opcodes = True
        steps += event == "opcode"
        if steps == step:
            sys.settrace(None)
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        task()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def replace_file(place):
    """Write a file."""
    with open_atomic(place) as file:
        file.write(b"{}\n")


def make_folder(place):
    """Make a folder with a file in it."""
    output = OutputPath(place, folder=True)
    try:
        output.path.mkdir()
        (output.path / "file").touch()
        output.publish()
    finally:
        output.discard()


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("task", [replace_file, make_folder])
def test_nothing_is_left_wherever_a_run_is_interrupted(tmp_path, task):
    """A signal at the end of the block that renames errors could leave its folder behind.

    Every third instruction is interrupted, from a random one on.
    """
    gc.collect()
    gc.freeze()  # so that a whole collection looks at what an interrupted run has left alone
    for step in itertools.count(random.randint(1, 3), 3):
        folder = tmp_path / str(step)
        folder.mkdir()
        is_interrupted = interrupted_at(step, lambda folder=folder: task(folder / "out"))
        if not set(names(folder)) <= {"out"}:
            gc.collect()
        assert set(names(folder)) <= {"out"}
        if not is_interrupted:
            break
    assert step > 1000


def test_what_was_put_in_its_place_stays(tmp_path):
    """Letting go of a temporary file does not reach what has left its place."""
    temp = LockedTemp(tmp_path / "out.csv", Path.touch)
    temp.path.replace(tmp_path / "out.csv")
    temp.remove()
    temp.remove()
    assert names(tmp_path) == ["out.csv"]


@pytest.mark.parametrize("is_blind", [True, False])
def test_names_that_differ_in_case_are_one_file_where_the_system_says_so(
    tmp_path, monkeypatch, is_blind
):
    """On Windows and macOS, the report replaced the attitudes."""
    monkeypatch.setattr(targets, "CASE_BLIND", is_blind)
    outputs = [str(tmp_path / "Out.csv"), str(tmp_path / "out.csv")]
    if is_blind:
        with pytest.raises(OutputError, match="two outputs of the run would go here"):
            targets.refuse_overlap([], outputs)
    else:
        targets.refuse_overlap([], outputs)
    targets.refuse_overlap([], ["s3://bucket/A.csv", "s3://bucket/a.csv"])
