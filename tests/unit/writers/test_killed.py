"""A run that is killed leaves the old file, and its leavings go with the next run."""

import os
import random
import subprocess
import sys
import time

import numpy as np
import pytest

from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer
from quatprop.writers.atomic import OutputFile, OutputPath

SERIES = AttitudeSeries(np.arange(40_000), np.tile([1.0, 0.0, 0.0, 0.0], (40_000, 1)))
WRITE_FOREVER = """
import sys
import numpy as np
from quatprop.series import AttitudeSeries
from quatprop.writers import open_writer
series = AttitudeSeries(np.arange(40_000), np.tile([1.0, 0.0, 0.0, 0.0], (40_000, 1)))
while True:
    with open_writer(sys.argv[1]) as writer:
        writer.write(series)
        writer.commit({"n": 40_000})
    print("written", flush=True)
"""


def write(target):
    """Write the series as the other process does."""
    with open_writer(target) as writer:
        writer.write(SERIES)
        writer.commit({"n": 40_000})


@pytest.mark.parametrize(
    "suffix", [".csv", ".parquet", ".feather", ".npy", ".npz", ".mcap", ".bag"]
)
def test_a_killed_run_leaves_a_whole_file_and_the_next_run_tidies_up(tmp_path, suffix):
    """Killed at any moment, the target is whole; writing it again leaves nothing beside it."""
    target = tmp_path / f"a{suffix}"
    write(target)
    whole = target.read_bytes()
    moments = random.Random(suffix)
    for _ in range(2):
        with subprocess.Popen(
            [sys.executable, "-c", WRITE_FOREVER, target], stdout=subprocess.PIPE
        ) as process:
            process.stdout.readline()
            time.sleep(moments.uniform(0, 0.05))
            process.kill()
        assert target.read_bytes() == whole
    (tmp_path / ".quatprop-of-somebody-else.part").touch()
    write(target)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        ".quatprop-of-somebody-else.part",
        target.name,
    ]


def strays(folder):
    """Return the unfinished files and folders of a folder."""
    return [path for path in folder.iterdir() if path.name.endswith(".part")]


def abandoned(make, target):
    """Start to write in a process that ends without a word, and return what it leaves."""
    code = (
        "import os, sys\n"
        "from quatprop.writers.atomic import OutputFile, OutputPath\n"
        f"made = {make}\n"
        "getattr(made, 'path', None) and made.path.mkdir()\n"
        "os._exit(0)\n"
    )
    subprocess.run([sys.executable, "-c", code, target], check=True)
    (stray,) = strays(target.parent)
    return stray


@pytest.mark.parametrize(
    "make", ["OutputFile(sys.argv[1])", "OutputPath(sys.argv[1], folder=True)"]
)
def test_what_was_abandoned_goes_when_the_same_target_is_written(tmp_path, make):
    """Another target leaves it alone; the same one removes it, file or folder."""
    stray = abandoned(make, tmp_path / "a")
    OutputFile(tmp_path / "b").discard()
    assert strays(tmp_path) == [stray]
    OutputPath(tmp_path / "a", folder=True).discard()
    assert strays(tmp_path) == []


def test_two_runs_on_one_target_do_not_disturb_each_other(tmp_path):
    """What is under way is locked: the last to commit wins, and both are whole."""
    first, second = OutputFile(tmp_path / "a"), OutputFile(tmp_path / "a")
    assert len(strays(tmp_path)) == 2
    first.stream.write(b"first")
    second.stream.write(b"second")
    second.commit()
    assert (tmp_path / "a").read_bytes() == b"second"
    first.commit()
    assert (tmp_path / "a").read_bytes() == b"first"
    assert strays(tmp_path) == []


def test_without_locks_files_are_written_all_the_same(tmp_path, monkeypatch):
    """On a system or a disk without locks, only the tidying is missing."""
    monkeypatch.setitem(sys.modules, "fcntl", None)
    output = OutputFile(tmp_path / "a")
    output.stream.write(b"whole")
    output.commit()
    assert os.listdir(tmp_path) == ["a"]  # noqa: PTH208  # names are all it takes
